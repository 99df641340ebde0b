//! The page that both ends of the bench share: orders for the echo, and the raw baselines (spin and futex).
//!
//! The baselines are what the machine itself can do with the same payloads: copy, bump a word, look at it or sleep on
//! it. Nothing of the project's wake-ups is used here, so that they can be compared with it.

#![expect(unsafe_code, reason = "shared memory; each use with its proof")]

use std::cell::UnsafeCell;
use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use loopbound_shared::sample::{State, Torque};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use rustix::thread::futex;

/// What the echo is to do next. The plant writes the fields, then `number`; the echo reports by `ready`.
#[repr(C, align(64))]
pub(crate) struct Orders {
    /// Counts orders from 1.
    pub(crate) number: AtomicU32,
    /// The number of the order that the echo carries out.
    pub(crate) ready: AtomicU32,
    /// Index into `Mechanism::ALL`, or anything beyond it: end.
    pub(crate) mechanism: AtomicU32,
    /// The other end has died: nobody will answer any more.
    pub(crate) abandoned: AtomicU32,
    /// Exchanges to answer.
    pub(crate) count: AtomicU64,
    /// The tick of the first.
    pub(crate) first_tick: AtomicU64,
    /// The period in ns, 0: back to back.
    pub(crate) period_ns: AtomicU64,
}

/// One direction of the raw exchange: a payload and the word that says which.
#[repr(C, align(64))]
pub(crate) struct Slot<T> {
    word: AtomicU32,
    payload: UnsafeCell<T>,
}

impl<T: Copy> Slot<T> {
    /// Writes the payload and says so by `word`.
    pub(crate) fn put(&self, payload: T, word: u32) {
        // SAFETY: the two ends take strict turns: this end writes only after it has acquired the other's answer to
        // the payload before (which the other released after its read), so no one reads now.
        unsafe { self.payload.get().write(payload) };
        self.word.store(word, Ordering::Release);
    }

    /// The payload, if the word is `word`.
    pub(crate) fn get(&self, word: u32) -> Option<T> {
        // SAFETY: the word was released after the payload, and is acquired here; the writer writes again only after
        // this end has answered. Any bytes are a value of these plain types.
        (self.word.load(Ordering::Acquire) == word).then(|| unsafe { self.payload.get().read() })
    }

    /// Wakes the one that sleeps, without looking whether one does.
    pub(crate) fn wake(&self) {
        // It can't fail for a valid address; the sleeper would see the word in any case.
        let _ = futex::wake(&self.word, futex::Flags::empty(), 1);
    }

    /// The payload once the word is `word`, asleep until then. None if the other end has died.
    pub(crate) fn sleep_for(&self, word: u32, orders: &Orders) -> Option<T> {
        loop {
            let seen = self.word.load(Ordering::Acquire);
            if seen == word {
                return self.get(word);
            }
            if orders.abandoned.load(Ordering::Relaxed) != 0 {
                return None;
            }
            // Woken, changed or interrupted: look again.
            let _ = futex::wait(&self.word, futex::Flags::empty(), seen, None);
        }
    }
}

/// What is shared. All zeros is its first value.
#[repr(C)]
pub(crate) struct Shared {
    pub(crate) orders: Orders,
    pub(crate) states: Slot<State>,
    pub(crate) torques: Slot<Torque>,
}

/// The mapped page.
pub(crate) struct Page {
    shared: *const Shared,
}

// SAFETY: behind the pointer are atomics and the payloads of slots, whose turns are kept as said there; the mapping
// lives as long as the value.
unsafe impl Send for Page {}
// SAFETY: as above.
unsafe impl Sync for Page {}

impl Page {
    /// Makes the page of a new group, all zeros.
    pub(crate) fn create(path: &Path) -> io::Result<Self> {
        let file = File::options().read(true).write(true).create_new(true).open(path)?;
        file.set_len(size_of::<Shared>() as u64)?;
        Self::map(&file)
    }

    /// Opens the page of a running group.
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        Self::map(&File::options().read(true).write(true).open(path)?)
    }

    fn map(file: &File) -> io::Result<Self> {
        let (protection, flags) = (ProtFlags::READ | ProtFlags::WRITE, MapFlags::SHARED | MapFlags::POPULATE);
        // SAFETY: the address is left to the kernel, so no mapping is replaced; the file is as long as the mapping
        // and nobody truncates it.
        let start = unsafe { mmap(std::ptr::null_mut(), size_of::<Shared>(), protection, flags, file, 0)? };
        Ok(Self { shared: start.cast() })
    }
}

impl std::ops::Deref for Page {
    type Target = Shared;

    fn deref(&self) -> &Shared {
        // SAFETY: mapped in `map`, unmapped only in drop; page-aligned, and any bytes are a value.
        unsafe { &*self.shared }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        // SAFETY: mapped in `map` with this size, and no reference outlives self.
        let _ = unsafe { munmap(self.shared.cast_mut().cast(), size_of::<Shared>()) };
    }
}
