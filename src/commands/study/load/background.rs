//! Load on purpose: threads of ordinary priority that compute, stream through memory and write files beside a loop.
//!
//! Responsible for what a soak or a study needs to see a loop among other programs. It asks for no priority and no
//! core, so a loop with real-time privileges may always push it aside; what it takes besides the cores (caches, memory
//! bandwidth, the disc) no priority protects.

use std::fs::File;
use std::io::{self, Seek as _, Write as _};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::JoinHandle;

use clap::ValueEnum;
use loopbound_shared::clock;
use loopbound_shared::spawn;
use serde::{Deserialize, Serialize};

/// Words of memory that a streaming thread goes through: 32 MiB, more than the caches that a core has for itself.
const WORDS: usize = 1 << 22;
/// Bytes that are written at a time.
const CHUNK_BYTES: usize = 1 << 20;
/// Chunks after which a file is forced to the disc and begun again, so that it never takes more room.
const CHUNKS_EACH: u32 = 16;
/// Steps of the computation between two looks at the clock.
const STEPS: u32 = 10_000;

/// What runs beside a loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Nothing.
    #[default]
    None,
    /// One thread a core that computes.
    Cpu,
    /// One thread a core, at least two: by turns one that streams through memory and one that writes a file.
    MemoryIo,
}

impl Kind {
    /// The word on the command line and in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Cpu => "cpu",
            Self::MemoryIo => "memory-io",
        }
    }

    fn works(self) -> Vec<Work> {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        match self {
            Self::None => Vec::new(),
            Self::Cpu => vec![Work::Compute; cores],
            Self::MemoryIo => {
                (0..cores.max(2)).map(|at| if at % 2 == 0 { Work::Stream } else { Work::Write }).collect()
            }
        }
    }
}

/// What one thread does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// Integer arithmetic in registers.
    Compute,
    /// Reads and writes all of a memory that no cache holds.
    Stream,
    /// Writes a file in the folder and forces it to the disc.
    Write,
}

/// When a thread works.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rhythm {
    /// All the time.
    Steady,
    /// For 0.1 to 0.8 s, then it rests as long.
    OnAndOff,
}

/// A load that goes on until it is dropped.
#[derive(Debug)]
pub struct Background {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Background {
    /// Starts a load of this kind, all the time; files go to `folder`, and are gone before the load is.
    ///
    /// # Errors
    /// If a file can't be made there, or a thread not be started.
    pub fn of(kind: Kind, folder: &Path) -> io::Result<Self> {
        Self::start(&kind.works(), Rhythm::Steady, folder)
    }

    /// Starts one thread for each of `works`.
    ///
    /// # Errors
    /// If a file can't be made in `folder`, or a thread not be started.
    pub fn start(works: &[Work], rhythm: Rhythm, folder: &Path) -> io::Result<Self> {
        let mut background = Self { stop: Arc::new(AtomicBool::new(false)), threads: Vec::new() };
        for (number, work) in works.iter().enumerate() {
            let mut tool = Tool::new(*work, folder, number)?;
            let (stop, seed) = (Arc::clone(&background.stop), number as u64);
            let run = move || {
                let mut random = 0x9e37_79b9 + seed;
                while !stop.load(Relaxed) {
                    random = next(random);
                    let length_ns = 100_000_000 + (random >> 33) % 700_000_000;
                    let until_ns = clock::now_ns() + length_ns;
                    while clock::now_ns() < until_ns && !stop.load(Relaxed) {
                        tool.work();
                    }
                    if rhythm == Rhythm::OnAndOff && !stop.load(Relaxed) {
                        clock::sleep_ns(length_ns);
                    }
                }
            };
            background.threads.push(spawn::thread("background", run)?);
        }
        Ok(background)
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        self.stop.store(true, Relaxed);
        self.threads.drain(..).for_each(|thread| drop(thread.join()));
    }
}

/// What a thread works with.
enum Tool {
    Compute(u64),
    Stream(Vec<u64>),
    Write { file: File, chunk: Vec<u8>, chunks: u32 },
}

impl Tool {
    fn new(work: Work, folder: &Path, number: usize) -> io::Result<Self> {
        Ok(match work {
            Work::Compute => Self::Compute(number as u64 + 1),
            Work::Stream => Self::Stream(vec![1; WORDS]),
            Work::Write => {
                let path = folder.join(format!("background-{}-{number}", std::process::id()));
                let file = File::options().write(true).create_new(true).open(&path)?;
                // Without a name it vanishes with its last descriptor, however this process ends.
                std::fs::remove_file(&path)?;
                Self::Write { file, chunk: vec![0x5a; CHUNK_BYTES], chunks: 0 }
            }
        })
    }

    /// Some milliseconds of it.
    fn work(&mut self) {
        match self {
            Self::Compute(state) => {
                for _ in 0..STEPS {
                    *state = std::hint::black_box(next(*state));
                }
            }
            Self::Stream(memory) => memory.iter_mut().for_each(|word| *word = word.wrapping_mul(3).wrapping_add(1)),
            Self::Write { file, chunk, chunks } => {
                // A full disc is load enough: what can't be written is tried again.
                let _ = file.write_all(chunk);
                *chunks += 1;
                if *chunks >= CHUNKS_EACH {
                    *chunks = 0;
                    let _ = file.sync_data().and_then(|()| file.rewind());
                }
            }
        }
    }
}

/// The next state of a linear congruential generator (Knuth's constants).
fn next(state: u64) -> u64 {
    state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407)
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbound_shared::clock::NS_PER_S;

    #[test]
    fn every_kind_keeps_threads_busy_until_it_is_dropped_and_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let names = || std::fs::read_dir("/proc/self/task").unwrap().flatten();
        let busy = || {
            let comms = names().filter_map(|task| std::fs::read_to_string(task.path().join("comm")).ok());
            comms.filter(|comm| comm.trim() == "background").count()
        };
        // A thread that was joined stays in the list for a moment, and a new one is not in it at once.
        let wait_until_busy = |threads: usize| {
            let until_ns = clock::now_ns() + 20 * NS_PER_S;
            while busy() != threads && clock::now_ns() < until_ns {
                clock::sleep_ns(1_000_000);
            }
            assert_eq!(busy(), threads);
        };
        for kind in [Kind::Cpu, Kind::MemoryIo] {
            let load = Background::of(kind, folder.path()).unwrap();
            wait_until_busy(kind.works().len());
            drop(load);
            wait_until_busy(0);
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "{kind:?}");
        }
        assert!(Background::of(Kind::None, folder.path()).unwrap().threads.is_empty());
    }

    #[test]
    fn a_folder_that_does_not_exist_is_an_error_and_not_a_load_without_files() {
        assert!(Background::of(Kind::MemoryIo, Path::new("/nowhere")).is_err());
    }
}
