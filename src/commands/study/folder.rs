//! The folder of a study is one study's, by the rules of a run's: asked for before anything is computed, marked unfinished
//! and cleared of an earlier study's files once it is taken, and finished with every file's size and hash in its manifest.

use loopbound_model::quote;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use loopbound_monitor::chart::{Figure, Theme, to_png, to_svg};
use loopbound_monitor::folder::{Begin, Claim, Kind, Results};
use loopbound_shared::run_id::RunId;

use crate::exit::Failure;

/// Pixels of a PNG for each px of its SVG: sharp on paper at the width of a page.
const PNG_SCALE: f32 = 2.0;

/// A folder that is locked for a study and not touched yet.
#[derive(Debug)]
pub struct Asked {
    claim: Claim,
    study: &'static str,
}

/// The folder of a study that writes.
#[derive(Debug)]
pub struct Folder {
    results: Results,
}

/// The names of a picture's files.
pub fn picture_files(name: &str) -> [String; 2] {
    ["svg", "png"].map(|kind| format!("{name}.{kind}"))
}

impl Asked {
    /// Asks for the folder in which `study` will write `files`.
    ///
    /// # Errors
    /// Whatever a study there has to be refused for: it can't be written, it is a run's, or holds such a file of
    /// somebody else's.
    pub fn new(path: &Path, study: &'static str, files: &[String]) -> Result<Self, Failure> {
        let claim = Claim::prepare(path, Kind::Study).and_then(|claim| claim.for_files(files));
        let claim = claim.map_err(|error| Failure::usage(format!("--out {error}")))?;
        Ok(Self { claim, study })
    }

    /// Takes it: what an earlier study wrote there is gone after this.
    ///
    /// # Errors
    /// If the folder can't be written.
    pub fn take(self) -> Result<Folder, Failure> {
        let begin = Begin { run_id: RunId::draw(), group: self.study, scenario: None, waypoints: None };
        let results = self.claim.begin(&begin).map_err(|error| Failure::usage(format!("--out {error}")))?;
        Ok(Folder { results })
    }
}

impl Folder {
    /// Writes a file. The manifest knows of it first, so that even one that a kill left there is known for the study's.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn write(&mut self, name: &str, content: impl AsRef<[u8]>) -> anyhow::Result<()> {
        let path = self.path().join(name);
        self.results.announce(name, content.as_ref());
        let saved = self.results.save();
        saved.and_then(|()| self.results.write(name, content.as_ref())).with_context(|| quote::path(&path))
    }

    /// Writes a picture as SVG, which follows the reader's light or dark theme, and as PNG.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn picture(&mut self, name: &str, figure: &Figure) -> anyhow::Result<()> {
        let [svg, png] = picture_files(name);
        self.write(&svg, to_svg(figure, Theme::Auto))?;
        self.write(&png, to_png(figure, PNG_SCALE).context(name.to_owned())?)
    }

    /// All files are there.
    ///
    /// # Errors
    /// If that can't be written: then the folder stays unfinished.
    pub fn finish(self) -> anyhow::Result<PathBuf> {
        let path = self.path().to_owned();
        self.results.finish().with_context(|| quote::path(&path))?;
        Ok(path)
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.results.path()
    }
}

#[cfg(test)]
mod tests {
    use loopbound_monitor::folder::{Look, Manifest, State};

    use super::*;
    use crate::exit::Exit;

    const TABLE: &str = "table.csv";

    fn ask(path: &Path) -> Result<Asked, Failure> {
        Asked::new(path, "test", &[TABLE.to_owned(), "report.md".to_owned()])
    }

    #[test]
    fn a_study_removes_what_an_earlier_one_wrote_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        let mut first = ask(path).unwrap().take().unwrap();
        first.write(TABLE, "1").unwrap();
        first.write("report.md", "one").unwrap();
        let unfinished = Manifest::read(path).unwrap().unwrap();
        assert!(unfinished.state == State::Unfinished && unfinished.files.len() == 2, "{unfinished:?}");
        first.finish().unwrap();
        std::fs::write(path.join("mine.txt"), "mine").unwrap();
        // Until it is taken, the earlier study is whole.
        let asked = ask(path).unwrap();
        assert_eq!(Manifest::read(path).unwrap().unwrap().state, State::Finished);
        let mut second = asked.take().unwrap();
        assert!(!path.join("report.md").exists() && path.join("mine.txt").exists());
        second.write(TABLE, "2").unwrap();
        second.finish().unwrap();
        let manifest = Manifest::read(path).unwrap().unwrap();
        assert!(manifest.kind == Kind::Study && manifest.group == "test" && manifest.run_id != unfinished.run_id);
        assert_eq!(manifest.files.keys().collect::<Vec<_>>(), [TABLE]);
        assert!(Look::at(path).unwrap_err().to_string().contains("it holds study"));
    }

    #[test]
    fn a_study_that_was_killed_leaves_files_that_the_next_one_may_remove() {
        let folder = tempfile::tempdir().unwrap();
        let mut killed = ask(folder.path()).unwrap().take().unwrap();
        killed.write(TABLE, "1").unwrap();
        drop(killed);
        drop(ask(folder.path()).unwrap().take().unwrap());
        assert!(!folder.path().join(TABLE).exists());
    }

    #[test]
    fn a_file_of_somebody_else_s_a_run_and_a_study_at_work_are_refused_and_stay() {
        let folder = tempfile::tempdir().unwrap();
        let refusal = |path: &Path| {
            let failure = ask(path).unwrap_err();
            assert_eq!(failure.exit, Exit::Usage);
            failure.message
        };
        let foreign = folder.path().join("foreign");
        std::fs::create_dir(&foreign).unwrap();
        std::fs::write(foreign.join(TABLE), "mine").unwrap();
        assert!(refusal(&foreign).contains("table.csv is not of loopbound's"), "{}", refusal(&foreign));
        assert_eq!(std::fs::read_to_string(foreign.join(TABLE)).unwrap(), "mine");
        assert!(!foreign.join("manifest.json").exists());

        let edited = folder.path().join("edited");
        let mut study = ask(&edited).unwrap().take().unwrap();
        study.write(TABLE, "1").unwrap();
        assert!(refusal(&edited).contains("is writing there"), "{}", refusal(&edited));
        study.finish().unwrap();
        std::fs::write(edited.join(TABLE), "edited").unwrap();
        assert!(refusal(&edited).contains("was changed since its study wrote it"), "{}", refusal(&edited));

        let run = folder.path().join("run");
        let begin = Begin { run_id: RunId::draw(), group: "g", scenario: None, waypoints: None };
        drop(Claim::prepare(&run, Kind::Run).unwrap().begin(&begin).unwrap());
        assert!(refusal(&run).contains("it holds run"), "{}", refusal(&run));
        assert!(refusal(&run.join("manifest.json")).contains("it is a file"));
        drop(ask(&folder.path().join("new")).unwrap());
        assert!(!folder.path().join("new").exists(), "what was made for a refused study goes again");
    }
}
