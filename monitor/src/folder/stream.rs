//! A file that is written while a run lasts: it ends at a whole entry whatever happens, and its hash is known at its end.

use std::cell::RefCell;
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::rc::Rc;

use sha2::{Digest as _, Sha256};

use super::manifest::{Stamp, hexadecimal};

/// Entries are gathered until they fill this.
const GATHERED_BYTES: usize = 8192;

/// Gathers what is written until [`Self::checkpoint`] says that the last entry is whole.
pub(crate) struct Stream {
    file: File,
    hash: Sha256,
    gathered: Vec<u8>,
    written: u64,
}

impl Stream {
    /// Makes the file, which must not be there: a symbolic link is none either.
    pub(crate) fn create(path: &Path) -> io::Result<Self> {
        let file = File::create_new(path)?;
        Ok(Self { file, hash: Sha256::new(), gathered: Vec::with_capacity(2 * GATHERED_BYTES), written: 0 })
    }

    /// After a whole entry: now it may go to the disk.
    pub(crate) fn checkpoint(&mut self) -> io::Result<()> {
        if self.gathered.len() < GATHERED_BYTES { Ok(()) } else { self.push() }
    }

    /// What was gathered goes to the disk now. If it does not fit there, the file keeps its last whole entry.
    pub(crate) fn push(&mut self) -> io::Result<()> {
        if self.gathered.is_empty() {
            return Ok(());
        }
        if let Err(error) = self.file.write_all(&self.gathered) {
            // What a full disk has room for is no whole entry; its room may be needed for the summary.
            let _ = self.file.set_len(self.written);
            return Err(error);
        }
        self.hash.update(&self.gathered);
        self.written += self.gathered.len() as u64;
        self.gathered.clear();
        Ok(())
    }

    /// Bytes in the file.
    pub(crate) fn written(&self) -> u64 {
        self.written
    }

    /// Size and hash of what is in the file.
    pub(crate) fn stamp(&self) -> Stamp {
        Stamp { bytes: self.written, sha256: hexadecimal(&self.hash.clone().finalize()) }
    }
}

impl Write for Stream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.gathered.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    /// An entry may be under way: see [`Stream::checkpoint`].
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A stream that a container's writer holds too.
#[derive(Clone)]
pub(crate) struct Shared(Rc<RefCell<Stream>>);

impl Shared {
    pub(crate) fn new(stream: Stream) -> Self {
        Self(Rc::new(RefCell::new(stream)))
    }

    /// The stream, while no write to it is under way.
    pub(crate) fn with<T>(&self, act: impl FnOnce(&mut Stream) -> T) -> T {
        act(&mut self.0.borrow_mut())
    }
}

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.borrow_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stamp_is_that_of_the_file_and_a_file_that_is_there_is_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("samples.csv");
        let mut stream = Stream::create(&path).unwrap();
        for line in 0..5000 {
            writeln!(stream, "{line},0.5").unwrap();
            stream.checkpoint().unwrap();
        }
        let on_disc = std::fs::read_to_string(&path).unwrap();
        assert!(on_disc.ends_with("5\n") && on_disc.len() > GATHERED_BYTES, "whole lines, long before the end");
        stream.push().unwrap();
        assert_eq!(stream.stamp(), Stamp::of(&std::fs::read(&path).unwrap()));
        assert!(Stream::create(&path).is_err());
    }
}
