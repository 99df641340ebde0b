//! Reads the small text files by which the kernel shows its state, below a root that tests can fake.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The files below a root; any of them may be missing, as in a container.
#[derive(Debug)]
pub(super) struct Tree {
    root: PathBuf,
}

impl Tree {
    pub(super) fn new(root: &Path) -> Self {
        Self { root: root.to_owned() }
    }

    pub(super) fn root(&self) -> &Path {
        &self.root
    }

    pub(super) fn path(&self, path: &str) -> PathBuf {
        self.root.join(path)
    }

    /// A file's whole text.
    pub(super) fn text(&self, path: &str) -> Option<String> {
        let bytes = std::fs::read(self.path(path)).ok()?;
        Some(String::from_utf8_lossy(&bytes).into_owned())
    }

    /// A file's text without the blanks around it; none if nothing is left.
    pub(super) fn line(&self, path: &str) -> Option<String> {
        let text = self.text(path)?;
        let line = text.trim();
        (!line.is_empty()).then(|| line.to_owned())
    }

    /// The names in a folder that begin with `prefix` and go on with a number, by that number.
    pub(super) fn numbered(&self, folder: &str, prefix: &str) -> Vec<String> {
        let Ok(entries) = std::fs::read_dir(self.path(folder)) else { return Vec::new() };
        let mut numbered: Vec<(u32, String)> = entries
            .filter_map(|entry| {
                let name = entry.ok()?.file_name().into_string().ok()?;
                Some((name.strip_prefix(prefix)?.parse().ok()?, name))
            })
            .collect();
        numbered.sort();
        numbered.into_iter().map(|(_, name)| name).collect()
    }

    /// The configuration that the kernel was built with: its own copy, or the one of the distribution.
    pub(super) fn kernel_config(&self) -> Option<String> {
        if let Ok(packed) = std::fs::File::open(self.path("proc/config.gz")) {
            // gzip is on every machine that could have built this program; without it the next source is tried.
            let unpacked = Command::new("gzip").arg("-dc").stdin(packed).stderr(Stdio::null()).output();
            if let Some(output) = unpacked.ok().filter(|output| output.status.success()) {
                return Some(String::from_utf8_lossy(&output.stdout).into_owned());
            }
        }
        let release = self.line("proc/sys/kernel/osrelease")?;
        self.text(&format!("boot/config-{release}")).or_else(|| self.text(&format!("lib/modules/{release}/config")))
    }

    /// Whether the usual container engines have left their mark.
    pub(super) fn is_container(&self) -> bool {
        [".dockerenv", "run/.containerenv", "run/systemd/container", "var/run/secrets/kubernetes.io"]
            .iter()
            .any(|path| self.path(path).exists())
    }

    /// A value on the kernel's command line: of `name=value`.
    pub(super) fn boot_option(&self, name: &str) -> Option<String> {
        let line = self.line("proc/cmdline")?;
        let value = line.split_whitespace().find_map(|word| word.strip_prefix(name)?.strip_prefix('='));
        value.map(str::to_owned)
    }
}

/// The number of cores in a list such as `0-3,8`; none if malformed.
pub(super) fn count_cores(list: &str) -> Option<u32> {
    list.trim().split(',').try_fold(0_u32, |sum, range| {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        let (first, last): (u32, u32) = (first.parse().ok()?, last.parse().ok()?);
        sum.checked_add(last.checked_sub(first)?.checked_add(1)?)
    })
}

/// The word in brackets of a choice such as `always [madvise] never`.
pub(super) fn chosen(choice: &str, open: char, close: char) -> Option<&str> {
    choice.split(open).nth(1)?.split(close).next()
}
