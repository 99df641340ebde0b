//! Findings on the control group that this process is in: what a container or a service manager lets it have of the
//! processors. Both versions are read, where the kernel says that they are mounted.

use loopbound_model::quote;
use std::path::{Path, PathBuf};

use loopbound_shared::realtime::Outcome;

use super::live::Live;
use super::tree::Tree;
use super::{Finding, Status};

/// What one of the two versions shows of the own group's share of the processors.
struct Group {
    /// Where the hierarchy is mounted, below the root of the tree.
    mount: PathBuf,
    /// The own group's folder, or the nearest that can be seen of it: a container may not see its own.
    own: PathBuf,
    unified: bool,
}

impl Group {
    /// The groups of this process that have to do with processors: of version 1, of version 2, or of both.
    fn all(tree: &Tree) -> Vec<Self> {
        let (Some(groups), Some(mounts)) = (tree.text("proc/self/cgroup"), tree.text("proc/self/mountinfo")) else {
            return Vec::new();
        };
        groups.lines().filter_map(|line| Self::of(line, &mounts)).collect()
    }

    /// Of a line such as `4:cpu,cpuacct:/path`, or `0::/path` in version 2.
    fn of(line: &str, mounts: &str) -> Option<Self> {
        let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
        let unified = controllers.is_empty();
        if !unified && !has_word(controllers, "cpu") {
            return None;
        }
        // id, parent, device, root, mount point, options, fields, "-", type, source, options
        mounts.lines().find_map(|mount| {
            let (before, after) = mount.split_once(" - ")?;
            let (before, after): (Vec<_>, Vec<_>) = (before.split(' ').collect(), after.split(' ').collect());
            let fits = match *after.first()? {
                "cgroup2" => unified,
                "cgroup" => !unified && has_word(after.get(2)?, "cpu"),
                _ => false,
            };
            // A path that leads out of what is mounted means a group that can't be seen.
            let below = Path::new(path).strip_prefix(before.get(3)?).ok().filter(|below| !below.starts_with(".."));
            let mount = PathBuf::from(before.get(4)?.trim_start_matches('/'));
            let own = below.map_or_else(|| mount.clone(), |below| mount.join(below));
            fits.then_some(Self { mount, own, unified })
        })
    }

    fn own_value(&self, tree: &Tree, file: &str) -> Option<String> {
        tree.line(self.own.join(file).to_str()?)
    }

    /// The least share of cores that the group or one above it may use, with what its file says.
    fn quota(&self, tree: &Tree) -> Option<(f64, String)> {
        let folders = self.own.ancestors().take_while(|folder| folder.starts_with(&self.mount));
        let quotas = folders.filter_map(|folder| quota_of(tree, folder));
        quotas.min_by(|(a, _), (b, _)| a.total_cmp(b))
    }

    /// How it looks from the root of the tree.
    fn file(folder: &Path, name: &str) -> String {
        format!("/{}", quote::path(&folder.join(name)))
    }
}

fn has_word(list: &str, word: &str) -> bool {
    list.split(',').any(|each| each == word)
}

/// The quota of one group in cores; none where there is none.
fn quota_of(tree: &Tree, folder: &Path) -> Option<(f64, String)> {
    let line = |file: &str| tree.line(folder.join(file).to_str()?);
    let of_v2 = || {
        let line = line("cpu.max")?;
        let (quota, period) = line.split_once(' ')?;
        Some((quota.parse().ok()?, period.trim().parse().ok()?, "cpu.max"))
    };
    let of_v1 = || {
        Some((line("cpu.cfs_quota_us")?.parse().ok()?, line("cpu.cfs_period_us")?.parse().ok()?, "cpu.cfs_quota_us"))
    };
    let (quota, period, file): (f64, f64, &str) = of_v2().or_else(of_v1)?;
    let text = || format!("{quota:.0} us of each {period:.0} us ({})", Group::file(folder, file));
    (quota > 0.0 && period > 0.0).then(|| (quota / period, text()))
}

/// Why the own group's budget alone forbids `SCHED_FIFO`, whatever rights the user has; and what helps.
pub(super) fn forbids_fifo(tree: &Tree, live: &Live) -> Option<(String, String)> {
    if live.fifo == Outcome::Had {
        return None;
    }
    Group::all(tree).into_iter().find_map(|group| {
        let to_root = format!("echo $$ | sudo tee {}  # this shell", Group::file(&group.mount, "cgroup.procs"));
        if group.unified {
            let held = group.own != group.mount && group.own_value(tree, "cpu.max").is_some();
            return (held && groups_budget_real_time(tree)).then(|| {
                let found = "the kernel gives real time to its root control group alone (CONFIG_RT_GROUP_SCHED)";
                (found.to_owned(), format!("boot with rt_group_sched=0; or: {to_root}"))
            });
        }
        let none_left = group.own_value(tree, "cpu.rt_runtime_us")? == "0";
        let mend = if tree.is_container() {
            "docker run --cpu-rt-runtime=950000 --cap-add=SYS_NICE …  # dockerd likewise".to_owned()
        } else {
            to_root
        };
        none_left.then(|| (format!("{} is 0", Group::file(&group.own, "cpu.rt_runtime_us")), mend))
    })
}

/// Whether the kernel has budgets of real time by control group, and has them switched on.
fn groups_budget_real_time(tree: &Tree) -> bool {
    let Some(config) = tree.kernel_config() else { return false };
    let set = |name: &str| config.lines().any(|line| line == format!("CONFIG_{name}=y"));
    let on = tree.boot_option("rt_group_sched").map_or(!set("RT_GROUP_SCHED_DEFAULT_DISABLED"), |value| value != "0");
    set("RT_GROUP_SCHED") && on
}

pub(super) fn rt_budget(tree: &Tree, live: &Live) -> Finding {
    let key = "rt_budget";
    if let Some((found, mend)) = forbids_fifo(tree, live) {
        let cost = "SCHED_FIFO is refused to every process in it, root too: other processes can preempt the loop";
        return Finding::new(key, Status::Bad, found, cost, &mend);
    }
    let groups = Group::all(tree);
    let budget = groups.iter().find_map(|group| {
        let us = group.own_value(tree, "cpu.rt_runtime_us")?;
        Some(format!("{us} us a period ({})", Group::file(&group.own, "cpu.rt_runtime_us")))
    });
    Finding::good(key, budget.unwrap_or_else(|| "no budget of the control group's own".to_owned()))
}

pub(super) fn cpu_quota(tree: &Tree) -> Finding {
    let key = "cpu_quota";
    let cost =
        "a process of ordinary priority that has used it up stands still until the period ends; SCHED_FIFO is exempt";
    let groups = Group::all(tree);
    if groups.is_empty() && tree.line("proc/self/cgroup").is_some() {
        return Finding::unknown(key, "the control groups are not mounted here", cost);
    }
    let least = groups.iter().filter_map(|group| group.quota(tree)).min_by(|(a, _), (b, _)| a.total_cmp(b));
    let Some((cores, text)) = least else { return Finding::good(key, "none") };
    let mend = "docker run without --cpus and --cpu-quota; systemd: CPUQuota= (of the slice too)";
    // The plant and the active controller want a core each.
    let status = if cores < 2.0 { Status::Bad } else { Status::Warn };
    Finding::new(key, status, format!("{cores:.2} cores: {text}"), cost, mend)
}

#[cfg(test)]
mod tests;
