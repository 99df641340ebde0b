//! The group's control block: doorbells (futex words) that wake a process for a fraction of what an event costs, and
//! the few numbers that lockstep paces itself by, the board of injected faults, and the list of who may say what.
//!
//! It lies in a file of the group's folder in memory, mapped by every process of the loop. A doorbell says only
//! "look again"; what there is to see travels by iceoryx2.
//!
//! Who waits has a place. It holds a lock on one byte of the file, which the kernel gives up when its owner dies, however it
//! dies and in whatever PID namespace: so a place whose lock can be had is free, and a dead owner's can be taken at once.
//!
//! No wake-up is lost: the ringer publishes first, then changes the word, then looks for waiters; the waiter marks
//! itself, reads the word, looks for a sample, and only then sleeps *on the word it has read*. All of this is
//! sequentially consistent, so either the ringer sees the mark or the waiter sees the sample or the changed word.

use std::fs::File;
use std::io;
use std::os::fd::AsRawFd as _;
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::SeqCst};

use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use rustix::thread::futex;

use crate::alarm::{Alarm, BACKSTOP_NS};
use crate::clock;
use crate::event::Role;
use crate::fault::board::Board;
use crate::layout::{FNV_START, fnv1a};
use crate::writers::Writers;

/// Processes of a group that can wait at a doorbell, each with a place of its own.
pub const PLACES: usize = u32::BITS as usize;

/// Which doorbell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bell {
    /// Rung by the plant after each state; controllers wait.
    State = 0,
    /// Rung by controllers after each torque; the plant waits.
    Torque = 1,
    /// Rung when the lockstep's pace changes: by the plant for the reference, by reference and monitor for the plant.
    Pace = 2,
}

const BELLS: usize = 3;
const MAGIC: u64 = fnv1a(FNV_START, b"loopbound control block 4: bells 3, places 32, pace, faults 6, writers 64 and 7");

#[repr(C, align(64))]
struct BellWords {
    word: AtomicU32,
    /// One bit a place, so that the mark of a killed waiter can be cleared without touching a live one's; in one word
    /// beside the other, so that a ring looks at one cache line.
    waiting: AtomicU32,
}

#[repr(C, align(64))]
struct Shared {
    magic: AtomicU64,
    places: [AtomicU32; PLACES],
    bells: [BellWords; BELLS],
    pace: Pace,
    faults: Board,
    writers: Writers,
}

/// Numbers that lockstep is paced by; in realtime mode they only inform.
#[repr(C, align(64))]
pub struct Pace {
    /// The tick the plant is in.
    pub plant_tick: AtomicU64,
    /// Ticks below this may close: the launcher's monitor has room for their records.
    pub credit: AtomicU64,
    /// Nonzero when the plant has ended, one way or the other.
    pub plant_ended: AtomicU64,
}

/// The mapped control block and this process's place in it.
pub struct ControlBlock {
    shared: *const Shared,
    place: usize,
    /// The end of this process's waits at a doorbell, where it is set beforehand.
    alarm: OnceLock<(Bell, Alarm)>,
    /// Holds the lock on the place.
    file: File,
}

// SAFETY: everything behind the pointer is atomic, and the mapping lives as long as the value.
#[expect(unsafe_code, reason = "a pointer to a shared mapping of atomics")]
unsafe impl Send for ControlBlock {}
// SAFETY: as above.
#[expect(unsafe_code, reason = "a pointer to a shared mapping of atomics")]
unsafe impl Sync for ControlBlock {}

impl ControlBlock {
    /// Makes the block of a new group.
    ///
    /// # Errors
    /// If the file can't be made.
    pub fn create(path: &Path) -> io::Result<Self> {
        use std::os::unix::fs::OpenOptionsExt as _;
        // Made beside its place: whoever sees it there sees a whole block.
        let unfinished = path.with_extension("new");
        let file = File::options().read(true).write(true).create_new(true).mode(0o600).open(&unfinished)?;
        // Not merely as long as that: a page that can't be had later would be a SIGBUS.
        rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, size_of::<Shared>() as u64)?;
        let block = Self::map(file)?.take_place()?;
        block.shared().magic.store(MAGIC, SeqCst);
        block.writers().enlist(Role::Supervisor, 0, std::process::id());
        std::fs::rename(&unfinished, path)?;
        Ok(block)
    }

    /// Opens the block of a running group and takes a place.
    ///
    /// # Errors
    /// If it is not there, of another build, or full.
    pub fn open(path: &Path) -> io::Result<Self> {
        Self::view(path)?.take_place()
    }

    /// Opens the block of a running group without a place: to read and to count, not to wait.
    ///
    /// # Errors
    /// If it is not there, or of another build.
    pub fn view(path: &Path) -> io::Result<Self> {
        let file = File::options().read(true).write(true).open(path)?;
        if file.metadata()?.len() != size_of::<Shared>() as u64 {
            return Err(io::Error::other("the control block is of another build of loopbound"));
        }
        let block = Self::map(file)?;
        if block.shared().magic.load(SeqCst) != MAGIC {
            return Err(io::Error::other("the control block is of another build of loopbound"));
        }
        Ok(block)
    }

    fn map(file: File) -> io::Result<Self> {
        // SAFETY: a fresh shared mapping of a file of this length; nothing else refers to the address. All access is
        // by atomics, for which any bytes are values. The file is truncated by nobody: it is only ever unlinked.
        #[expect(unsafe_code, reason = "shared memory")]
        let address = unsafe {
            mmap(
                std::ptr::null_mut(),
                size_of::<Shared>(),
                ProtFlags::READ | ProtFlags::WRITE,
                MapFlags::SHARED | MapFlags::POPULATE,
                &file,
                0,
            )?
        };
        Ok(Self { shared: address.cast(), place: PLACES, alarm: OnceLock::new(), file })
    }

    fn take_place(mut self) -> io::Result<Self> {
        for place in 0..PLACES {
            if lock_place(&self.file, place, true)? {
                self.empty(place);
                self.shared().places[place].store(std::process::id(), SeqCst);
                self.place = place;
                return Ok(self);
            }
        }
        Err(io::Error::other(format!("the group has no room for more than {PLACES} processes")))
    }

    /// Clears the marks of a place whose lock this process holds.
    fn empty(&self, place: usize) {
        for bell in &self.shared().bells {
            bell.waiting.fetch_and(!(1 << place), SeqCst);
        }
        self.shared().places[place].store(0, SeqCst);
    }

    fn shared(&self) -> &Shared {
        // SAFETY: mapped in `map`, unmapped only in drop.
        #[expect(unsafe_code, reason = "shared memory")]
        unsafe {
            &*self.shared
        }
    }

    /// The numbers that lockstep is paced by.
    #[must_use]
    pub fn pace(&self) -> &Pace {
        &self.shared().pace
    }

    /// The faults that were injected by command.
    #[must_use]
    pub fn faults(&self) -> &Board {
        &self.shared().faults
    }

    /// Who may say what in this run.
    #[must_use]
    pub fn writers(&self) -> &Writers {
        &self.shared().writers
    }

    /// Frees the places and the marks of all who have died; how many there were. The supervisor's: a mark of a dead waiter
    /// costs every ring a system call.
    pub fn clear_places_of_the_dead(&self) -> usize {
        let mut cleared = 0;
        for place in (0..PLACES).filter(|place| *place != self.place) {
            let taken = self.shared().places[place].load(SeqCst) != 0;
            // What can't be asked now is asked at the next look.
            if taken && lock_place(&self.file, place, true).unwrap_or(false) {
                self.empty(place);
                cleared += 1;
                let _ = lock_place(&self.file, place, false);
            }
        }
        cleared
    }

    /// Wakes whoever waits at `bell`. Without a waiter it costs no system call. Publish first, then ring.
    pub fn ring(&self, bell: Bell) {
        let bell = &self.shared().bells[bell as usize];
        bell.word.fetch_add(1, SeqCst);
        if bell.waiting.load(SeqCst) != 0 {
            // A failed wake-up has no waiter to miss it; every wait has a timeout besides.
            let _ = futex::wake(&bell.word, futex::Flags::empty(), ALL);
        }
    }

    /// Opens the alarm of the calling thread's waits at `bell`: their end can then be set off the path, by
    /// [`Self::set_alarm`]. Without it every wait programs a timer of its own.
    ///
    /// # Errors
    /// If this process has one already, or the kernel refuses the timer.
    pub fn open_alarm(&self, bell: Bell) -> io::Result<()> {
        // SAFETY: mapped in `map`; a block whose alarm was opened is never unmapped.
        #[expect(unsafe_code, reason = "the signal's handler may come at any time")]
        let word = unsafe { &(*self.shared).bells[bell as usize].word };
        self.alarm.set((bell, Alarm::open(word)?)).map_err(|_| io::Error::other("the alarm is open already"))
    }

    /// Sets when a wait at the alarm's doorbell is to look at the clock; does nothing without an alarm.
    pub fn set_alarm(&self, at_ns: u64) {
        if let Some((_, alarm)) = self.alarm.get() {
            alarm.set(at_ns);
        }
    }

    /// When a wait at `bell` that begins now may end by itself: not before `until_ns`, and long after an alarm that will end it.
    fn timeout_ns(&self, bell: Bell, now_ns: u64, until_ns: u64) -> u64 {
        let alarm = self.alarm.get().filter(|(of, _)| *of == bell).map_or(0, |(_, alarm)| alarm.at_ns());
        if now_ns < alarm { until_ns.max(alarm) + BACKSTOP_NS } else { until_ns }
    }

    /// Looks by `look` until it finds something or the clock passes `until_ns`, sleeping at `bell` in between.
    pub fn wait<R>(&self, bell: Bell, until_ns: u64, mut look: impl FnMut() -> Option<R>) -> Option<R> {
        let words = &self.shared().bells[bell as usize];
        let mark = 1 << self.place;
        words.waiting.fetch_or(mark, SeqCst);
        let found = loop {
            let seen = words.word.load(SeqCst);
            if let Some(found) = look() {
                break Some(found);
            }
            let now_ns = clock::now_ns();
            if now_ns >= until_ns {
                break None;
            }
            let timeout = clock::timespec(self.timeout_ns(bell, now_ns, until_ns));
            // Woken, changed, timed out or interrupted: in any case look again. The bitset form takes an absolute time.
            let _ = futex::wait_bitset(&words.word, futex::Flags::empty(), seen, Some(&timeout), ANY);
        };
        words.waiting.fetch_and(!mark, SeqCst);
        found
    }
}

/// Takes the lock on a place, or gives it up; whether it could. It belongs to the open file, not to the process: two blocks in
/// one process have two places.
fn lock_place(file: &File, place: usize, take: bool) -> io::Result<bool> {
    let kind = if take { libc::F_WRLCK } else { libc::F_UNLCK };
    // SAFETY: a struct of integers, for which zeroed memory is a value.
    #[expect(unsafe_code, reason = "the library's structure has fields that differ between architectures")]
    let mut lock: libc::flock = unsafe { std::mem::zeroed() };
    lock.l_type = libc::c_short::try_from(kind).unwrap_or(0);
    lock.l_whence = libc::c_short::try_from(libc::SEEK_SET).unwrap_or(0);
    (lock.l_start, lock.l_len) = (libc::off_t::try_from(place).unwrap_or(0), 1);
    // SAFETY: fcntl reads one `struct flock` from the pointer, which outlives the call; the descriptor is open.
    #[expect(unsafe_code, reason = "rustix has no locks of open files")]
    let result = unsafe { libc::fcntl(file.as_raw_fd(), libc::F_OFD_SETLK, &raw const lock) };
    match io::Error::last_os_error() {
        _ if result == 0 => Ok(true),
        e if matches!(e.raw_os_error(), Some(libc::EAGAIN | libc::EACCES)) => Ok(false),
        e => Err(e),
    }
}

/// As many waiters as there can be. The kernel counts in a signed number: `u32::MAX` would be −1, and wake one alone.
const ALL: u32 = i32::MAX.cast_unsigned();
const ANY: std::num::NonZeroU32 = std::num::NonZeroU32::MAX;

impl Drop for ControlBlock {
    fn drop(&mut self) {
        if self.place < PLACES {
            self.empty(self.place);
        }
        if self.alarm.get().is_some() {
            // A signal of the alarm may be under way to another thread: the mapping stays.
            return;
        }
        // SAFETY: mapped in `map` with this size, and no reference outlives self.
        #[expect(unsafe_code, reason = "shared memory")]
        // Unmapping can only fail for a bad range, which this is not.
        let _ = unsafe { munmap(self.shared.cast_mut().cast(), size_of::<Shared>()) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_ring_is_lost_between_two_threads_that_answer_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bell");
        let plant = ControlBlock::create(&path).unwrap();
        let controller = ControlBlock::open(&path).unwrap();
        assert_ne!(plant.place, controller.place);
        let (asked, answered) = (AtomicU64::new(0), AtomicU64::new(0));
        let far_ns = clock::now_ns() + 60_000_000_000;
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for k in 1..=20_000 {
                    let seen = controller.wait(Bell::State, far_ns, || (asked.load(SeqCst) == k).then_some(()));
                    assert!(seen.is_some(), "state {k} was not seen");
                    answered.store(k, SeqCst);
                    controller.ring(Bell::Torque);
                }
            });
            for k in 1..=20_000 {
                asked.store(k, SeqCst);
                plant.ring(Bell::State);
                let seen = plant.wait(Bell::Torque, far_ns, || (answered.load(SeqCst) == k).then_some(()));
                assert!(seen.is_some(), "torque {k} was not seen");
            }
        });
    }

    #[test]
    fn places_of_those_who_left_and_of_those_who_died_are_taken_again_and_those_of_the_living_never() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bell");
        let block = ControlBlock::create(&path).unwrap();
        for _ in 0..3 {
            let others: Vec<_> = (1..PLACES).map(|_| ControlBlock::open(&path).unwrap()).collect();
            let mut places: Vec<_> = others.iter().map(|other| other.place).collect();
            places.sort_unstable();
            assert_eq!(places, (1..PLACES).collect::<Vec<_>>());
            assert!(ControlBlock::open(&path).is_err(), "all places are taken");
            assert_eq!(block.clear_places_of_the_dead(), 0, "all of them live");
        }
        let mut others: Vec<_> = (1..PLACES).map(|_| ControlBlock::open(&path).unwrap()).collect();
        // As a killed process leaves it: the lock is gone, the place and the mark are not.
        for other in others.drain(..5) {
            other.shared().bells[0].waiting.fetch_or(1 << other.place, SeqCst);
            assert!(lock_place(&other.file, other.place, false).unwrap());
            std::mem::forget(other);
        }
        let again = ControlBlock::open(&path).unwrap();
        assert_eq!(block.clear_places_of_the_dead(), 4);
        assert_eq!(block.shared().bells[0].waiting.load(SeqCst), 0);
        drop(again);
    }

    #[test]
    fn one_ring_wakes_everyone_who_waits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bell");
        let plant = ControlBlock::create(&path).unwrap();
        let (round, seen) = (AtomicU64::new(0), AtomicU64::new(0));
        let far_ns = clock::now_ns() + 60_000_000_000;
        std::thread::scope(|scope| {
            for _ in 0..4 {
                let block = ControlBlock::open(&path).unwrap();
                let (round, seen) = (&round, &seen);
                scope.spawn(move || {
                    for k in 1..=100 {
                        let woken = block.wait(Bell::State, far_ns, || (round.load(SeqCst) >= k).then_some(()));
                        assert!(woken.is_some(), "round {k} was slept through");
                        seen.fetch_add(1, SeqCst);
                    }
                });
            }
            for k in 1..=100 {
                // Long enough that all four are asleep as a rule: then the ring alone can wake them.
                clock::sleep_ns(300_000);
                round.store(k, SeqCst);
                plant.ring(Bell::State);
                let all_ns = clock::now_ns() + 10_000_000_000;
                while seen.load(SeqCst) < 4 * k {
                    assert!(clock::now_ns() < all_ns, "one ring woke {} of 4", seen.load(SeqCst) - 4 * (k - 1));
                    clock::sleep_ns(50_000);
                }
            }
        });
    }

    #[test]
    fn a_wait_ends_by_its_alarm_also_if_that_went_off_before_it_and_if_its_signal_never_comes() {
        let _alone = crate::alarm::tests::ALONE.lock();
        let folder = tempfile::tempdir().unwrap();
        let block = ControlBlock::create(&folder.path().join("bell")).unwrap();
        block.open_alarm(Bell::Torque).unwrap();
        let wait = |alarm_ns: u64, until_ns: u64| {
            block.set_alarm(alarm_ns);
            let looks = std::cell::Cell::new(0);
            let nothing = block.wait(Bell::Torque, until_ns, || {
                looks.set(looks.get() + 1);
                // As a host that stops this thread between its look and its sleep.
                clock::sleep_until_ns(if looks.get() == 1 { alarm_ns.min(until_ns) } else { 0 });
                None::<()>
            });
            assert!(nothing.is_none() && clock::now_ns() >= until_ns);
            clock::now_ns() - until_ns
        };
        let soon = || clock::now_ns() + 2_000_000;
        let quickest = |wait: &dyn Fn() -> u64| (0..20).map(|_| wait()).min().unwrap();
        let at_its_time = quickest(&|| {
            let at = soon();
            wait(at, at)
        });
        assert!(at_its_time < BACKSTOP_NS / 2, "{at_its_time} ns late: not by the alarm");
        // The grace deadline counts from the publication, so it comes a little after the alarm.
        let a_little_later = quickest(&|| {
            let at = soon();
            wait(at, at + 300_000)
        });
        assert!(a_little_later < BACKSTOP_NS / 2, "{a_little_later} ns late: not by its own timeout");
        crate::alarm::tests::mask(libc::SIG_BLOCK);
        let without = {
            let at = soon();
            block.set_alarm(at);
            let none = block.wait(Bell::Torque, at, || None::<()>);
            assert!(none.is_none());
            clock::now_ns() - at
        };
        crate::alarm::tests::mask(libc::SIG_UNBLOCK);
        assert!(without >= BACKSTOP_NS / 2, "it ended {without} ns late: the signal was not kept back");
    }

    #[test]
    fn a_wait_without_a_ring_ends_at_its_time_and_a_block_of_another_build_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bell");
        let block = ControlBlock::create(&path).unwrap();
        let until_ns = clock::now_ns() + 2_000_000;
        assert_eq!(block.wait(Bell::Pace, until_ns, || None::<()>), None);
        assert!(clock::now_ns() >= until_ns);
        block.shared().magic.store(1, SeqCst);
        assert!(ControlBlock::open(&path).is_err());
    }
}
