//! A close look at every change of the controller in charge: `changes/TICK.csv`, the rows of `samples.csv` for a while
//! before and after the tick in which another one took over.
//!
//! Runs on the thread that writes the files. A swap, a failover and a rollback are all the same here.

use std::collections::VecDeque;
use std::fs;
use std::io::{self, Write as _};
use std::path::PathBuf;

use loopbound_scenario::TRACE_TICKS_MAX;

use crate::folder::{Stamp, Stream};

/// Changes that get a file of their own; the samples have them all.
const CHANGES_MAX: usize = 1024;
/// Lines that are remembered before a change.
const BEFORE_MAX: usize = TRACE_TICKS_MAX as usize + 1;

/// Writes a file for every change that it sees go by.
pub(crate) struct Traces {
    folder: PathBuf,
    header: String,
    window_s: f64,
    before: VecDeque<(f64, String)>,
    open: Vec<(f64, String, Stream)>,
    closed: Vec<(String, Stamp)>,
    active: u32,
    changes: usize,
}

impl Traces {
    /// Files go into `folder`, made at the first change, with `window_s` on either side.
    pub(crate) fn new(folder: PathBuf, header: String, window_s: f64) -> Self {
        Self {
            folder,
            header,
            window_s,
            before: VecDeque::new(),
            open: Vec::new(),
            closed: Vec::new(),
            active: 0,
            changes: 0,
        }
    }

    /// Takes the next line of the samples.
    pub(crate) fn line(&mut self, tick: u64, t_s: f64, active: u32, line: &str) -> io::Result<()> {
        let changed = active != 0 && self.active != 0 && active != self.active;
        self.active = if active == 0 { self.active } else { active };
        if changed && self.changes < CHANGES_MAX {
            self.changes += 1;
            self.begin(tick, t_s)?;
        }
        for (_, _, file) in &mut self.open {
            file.write_all(line.as_bytes())?;
            file.checkpoint()?;
        }
        while let Some(over) = self.open.iter().position(|(until_s, ..)| t_s >= *until_s) {
            let (_, name, file) = self.open.remove(over);
            self.close_one(name, file)?;
        }
        while self.before.front().is_some_and(|(at_s, _)| *at_s < t_s - self.window_s)
            || self.before.len() >= BEFORE_MAX
        {
            self.before.pop_front();
        }
        self.before.push_back((t_s, line.to_owned()));
        Ok(())
    }

    fn begin(&mut self, tick: u64, t_s: f64) -> io::Result<()> {
        fs::create_dir_all(&self.folder)?;
        let name = format!("{tick}.csv");
        let path = self.folder.join(&name);
        // A monitor of the same run that had to be started again may have written it.
        let _ = fs::remove_file(&path);
        let mut file = Stream::create(&path)?;
        file.write_all(self.header.as_bytes())?;
        for (_, line) in self.before.iter().filter(|(at_s, _)| *at_s >= t_s - self.window_s) {
            file.write_all(line.as_bytes())?;
        }
        self.open.push((t_s + self.window_s, name, file));
        Ok(())
    }

    fn close_one(&mut self, name: String, mut file: Stream) -> io::Result<()> {
        file.push()?;
        self.closed.push((name, file.stamp()));
        Ok(())
    }

    /// Closes what is still open; the name, size and hash of every file.
    pub(crate) fn close(mut self) -> io::Result<Vec<(String, Stamp)>> {
        for (_, name, file) in std::mem::take(&mut self.open) {
            self.close_one(name, file)?;
        }
        Ok(self.closed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_of_the_controller_in_charge_leaves_a_file_with_both_sides_of_it() {
        let folder = std::env::temp_dir().join(format!("loopbound-changes-{}", std::process::id()));
        let mut traces = Traces::new(folder.clone(), "tick\n".to_owned(), 0.0035);
        for tick in 0..30_u64 {
            let active = match tick {
                0..2 => 0,
                2..10 => 1,
                10..12 => 2,
                _ => 3,
            };
            traces.line(tick, tick as f64 * 1e-3, active, &format!("{tick}\n")).unwrap();
        }
        let closed = traces.close().unwrap();
        let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
        assert_eq!(read("10.csv"), "tick\n7\n8\n9\n10\n11\n12\n13\n14\n");
        assert_eq!(read("12.csv"), "tick\n9\n10\n11\n12\n13\n14\n15\n16\n");
        assert_eq!(closed[0], ("10.csv".to_owned(), Stamp::of(read("10.csv").as_bytes())));
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 2, "the first one in charge is no change");
        fs::remove_dir_all(folder).unwrap();
    }
}
