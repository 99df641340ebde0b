//! The end of a wait, set before the wait begins: a timer of the kernel that changes a futex word when its time has come.
//!
//! A futex wait can end by a timeout, but a timeout that comes before the kernel's next timer event makes every wait program
//! the timer hardware, and every wake-up program it back: on the path from a sample to its torque, several microseconds each
//! way on a virtual machine. So the plant sets its alarm in the slack, for the grace deadline of the next tick, and waits with
//! a timeout so far off that it costs nothing. A wait that has not begun yet when the alarm goes off finds the word
//! changed and does not begin; one that has begun is interrupted. If the signal can't come, the far timeout ends the wait.

#![expect(unsafe_code, reason = "a timer of the kernel and its signal handler; each with its proof")]

use std::io;
use std::sync::atomic::{AtomicPtr, AtomicU32, AtomicU64, Ordering::SeqCst};

use crate::clock;

/// How long after the alarm a wait ends by itself, ns.
pub(crate) const BACKSTOP_NS: u64 = 20_000_000;

/// The word that the handler changes; null while no alarm is open.
static WORD: AtomicPtr<AtomicU32> = AtomicPtr::new(std::ptr::null_mut());

/// A timer whose signal comes to the thread that opened it.
pub(crate) struct Alarm {
    timer: libc::timer_t,
    at_ns: AtomicU64,
}

// SAFETY: the pointer is the kernel's number of the timer and is never dereferenced; any thread may set a timer.
unsafe impl Send for Alarm {}
// SAFETY: as above.
unsafe impl Sync for Alarm {}

impl Alarm {
    /// Opens the one alarm of this process, for waits of the calling thread on `word`, which stays mapped for ever.
    ///
    /// # Errors
    /// If one is open already, or the kernel refuses the timer (`RLIMIT_SIGPENDING`, a sandbox).
    pub(crate) fn open(word: &'static AtomicU32) -> io::Result<Self> {
        let word = std::ptr::from_ref(word).cast_mut();
        if WORD.compare_exchange(std::ptr::null_mut(), word, SeqCst, SeqCst).is_err() {
            return Err(io::Error::other("this process has an alarm already"));
        }
        create().inspect_err(|_| WORD.store(std::ptr::null_mut(), SeqCst))
    }

    /// Lets it go off at `at_ns` of `CLOCK_MONOTONIC` and at no other time; at once if that has passed.
    pub(crate) fn set(&self, at_ns: u64) {
        let time = clock::timespec(at_ns.max(1));
        let never = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        let once = libc::itimerspec {
            it_interval: never,
            it_value: libc::timespec { tv_sec: time.tv_sec, tv_nsec: time.tv_nsec },
        };
        // SAFETY: the timer is open as long as self, and the call reads one structure that outlives it.
        let result =
            unsafe { libc::timer_settime(self.timer, libc::TIMER_ABSTIME, &raw const once, std::ptr::null_mut()) };
        self.at_ns.store(if result == 0 { at_ns } else { 0 }, SeqCst);
    }

    /// When it goes off; 0 if it is not set.
    pub(crate) fn at_ns(&self) -> u64 {
        self.at_ns.load(SeqCst)
    }
}

impl Drop for Alarm {
    fn drop(&mut self) {
        // SAFETY: the timer was created by `create` and is deleted once.
        unsafe { libc::timer_delete(self.timer) };
        WORD.store(std::ptr::null_mut(), SeqCst);
    }
}

/// A signal that nothing else of this process uses.
fn signal() -> libc::c_int {
    libc::SIGRTMIN() + 5
}

extern "C" fn go_off(_signal: libc::c_int) {
    // SAFETY: null, or a word that stays mapped for ever; an atomic addition may stand in a signal handler.
    if let Some(word) = unsafe { WORD.load(SeqCst).as_ref() } {
        word.fetch_add(1, SeqCst);
    }
}

fn create() -> io::Result<Alarm> {
    let checked = |result: libc::c_int| if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) };
    // SAFETY: structures of the C library, for which zeroed memory is a value.
    let (mut action, mut event, mut signals) =
        unsafe { (std::mem::zeroed::<libc::sigaction>(), std::mem::zeroed::<libc::sigevent>(), std::mem::zeroed()) };
    action.sa_sigaction = go_off as *const () as usize;
    // A sleep or a read that it interrupts goes on; a futex wait ends, since its word has changed.
    action.sa_flags = libc::SA_RESTART;
    // SAFETY: the handler touches nothing but an atomic word; all pointers outlive the calls.
    unsafe {
        checked(libc::sigemptyset(&raw mut action.sa_mask))?;
        checked(libc::sigaction(signal(), &raw const action, std::ptr::null_mut()))?;
        checked(libc::sigemptyset(&raw mut signals))?;
        checked(libc::sigaddset(&raw mut signals, signal()))?;
        // Whoever started this process may have blocked it.
        checked(libc::pthread_sigmask(libc::SIG_UNBLOCK, &raw const signals, std::ptr::null_mut()))?;
    }
    event.sigev_notify = libc::SIGEV_THREAD_ID;
    event.sigev_signo = signal();
    event.sigev_notify_thread_id = rustix::thread::gettid().as_raw_nonzero().get();
    let mut timer: libc::timer_t = std::ptr::null_mut();
    // SAFETY: the call reads the event and writes the timer's number; both outlive it.
    checked(unsafe { libc::timer_create(libc::CLOCK_MONOTONIC, &raw mut event, &raw mut timer) })?;
    Ok(Alarm { timer, at_ns: AtomicU64::new(0) })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// One process has one alarm.
    pub(crate) static ALONE: std::sync::Mutex<()> = std::sync::Mutex::new(());

    /// Keeps the signal from the calling thread, or lets it through again.
    pub(crate) fn mask(how: libc::c_int) {
        // SAFETY: the set is initialised by the first call and outlives the last.
        unsafe {
            let mut signals = std::mem::zeroed();
            libc::sigemptyset(&raw mut signals);
            libc::sigaddset(&raw mut signals, signal());
            libc::pthread_sigmask(how, &raw const signals, std::ptr::null_mut());
        }
    }

    #[test]
    fn it_goes_off_at_its_time_once_and_may_be_set_anew() {
        let _alone = ALONE.lock();
        let word: &'static AtomicU32 = Box::leak(Box::new(AtomicU32::new(0)));
        let alarm = Alarm::open(word).unwrap();
        assert!(Alarm::open(word).is_err(), "one process has one alarm");
        let at_ns = clock::now_ns() + 3_000_000;
        alarm.set(at_ns);
        clock::sleep_until_ns(at_ns - 1_500_000);
        let before = word.load(SeqCst);
        // A thread that did not run for so long looked too late.
        assert!(before == 0 || clock::now_ns() >= at_ns, "it went off before its time");
        clock::sleep_until_ns(at_ns + 20_000_000);
        assert_eq!(word.load(SeqCst), 1);
        let given_up_ns = clock::now_ns() + 50_000_000;
        alarm.set(given_up_ns);
        alarm.set(clock::now_ns() + 3_600_000_000_000);
        let in_time = clock::now_ns() < given_up_ns;
        clock::sleep_ns(60_000_000);
        let so_far = word.load(SeqCst);
        assert!(so_far == 1 || !in_time, "the earlier time was given up");
        alarm.set(1);
        clock::sleep_ns(5_000_000);
        assert_eq!(word.load(SeqCst), so_far + 1, "a time that has passed is now");
        drop(alarm);
        drop(Alarm::open(word).unwrap());
    }
}
