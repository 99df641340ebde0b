//! The launcher's end of the keeper: started before all others, started again if it dies, let go last.

use std::process::{Child, Command, Stdio};

use loopbound_shared::clock::{NS_PER_S, now_ns, sleep_ns};
use loopbound_shared::group::Group;
use loopbound_shared::spawn;

/// It ends within less: what ignores it by then is the kernel's affair.
const LEAVE_NS: u64 = 8 * NS_PER_S;
/// Between two starts.
const AGAIN_NS: u64 = NS_PER_S;
const LOOK_NS: u64 = 500_000;

/// The keeper process. When this is dropped it ends whatever is left of the run, and this waits for that.
pub(in crate::supervise) struct Keeper {
    child: Child,
    started_ns: u64,
}

impl Keeper {
    pub(in crate::supervise) fn start(group: &Group) -> std::io::Result<Self> {
        use std::os::unix::process::CommandExt as _;
        let (run, parent) = (group.run_id().to_string(), std::process::id().to_string());
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["keeper", "--group", group.name(), "--run", &run, "--parent", &parent]);
        // Its standard input ends when this process does. The terminal's signals are the launcher's.
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).process_group(0);
        Ok(Self { child: spawn::process(&mut command)?, started_ns: now_ns() })
    }

    /// Starts another one in place of one that was killed; not all the time, if it can't live.
    pub(in crate::supervise) fn ensure(&mut self, group: &Group) {
        if now_ns() >= self.started_ns + AGAIN_NS {
            self.renew(group);
        }
    }

    /// The same at once: before the run ends.
    pub(in crate::supervise) fn renew(&mut self, group: &Group) {
        if matches!(self.child.try_wait(), Ok(Some(_)))
            && let Ok(another) = Self::start(group)
        {
            // The old one has ended: nothing is waited for.
            *self = another;
        }
    }
}

impl Drop for Keeper {
    fn drop(&mut self) {
        drop(self.child.stdin.take());
        let until_ns = now_ns() + LEAVE_NS;
        while matches!(self.child.try_wait(), Ok(None)) {
            if now_ns() >= until_ns {
                let _ = self.child.kill();
                let _ = self.child.wait();
                return;
            }
            sleep_ns(LOOK_NS);
        }
    }
}
