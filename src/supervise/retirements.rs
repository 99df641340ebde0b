//! Which controllers are to go, and when: those that were replaced, after a time as standbys, and those that were refused.

/// Time between two looks whether a dismissed controller has lost its authority.
const ASK_AGAIN_NS: u64 = 200_000_000;

#[derive(Debug)]
struct Retirement {
    id: u32,
    at_ns: u64,
    /// Goes as soon as it is not active; otherwise one that is active again by then stays.
    insist: bool,
}

/// A controller that is to go now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Due {
    pub(super) id: u32,
    insist: bool,
}

/// Those whose time is set.
#[derive(Debug, Default)]
pub(super) struct Retirements {
    list: Vec<Retirement>,
}

impl Retirements {
    /// `id` has been replaced: it stays as a standby for `after_ns`.
    pub(super) fn plan(&mut self, now_ns: u64, id: u32, after_ns: u64) {
        self.list.push(Retirement { id, at_ns: now_ns.saturating_add(after_ns), insist: false });
    }

    /// `id` was refused: it goes at the next look, or when it has lost the authority that a failover gave it.
    pub(super) fn dismiss(&mut self, now_ns: u64, id: u32) {
        self.list.push(Retirement { id, at_ns: now_ns + 1, insist: true });
    }

    /// The next one that goes now.
    pub(super) fn look(&mut self, now_ns: u64, active: u32) -> Option<Due> {
        while let Some(at) = self.list.iter().position(|retirement| retirement.at_ns <= now_ns) {
            let Retirement { id, insist, .. } = self.list.remove(at);
            let due = Due { id, insist };
            if id != active {
                return Some(due);
            }
            self.is_active(now_ns, due);
        }
        None
    }

    /// One that was due is active: it stays, or is asked again if it is to go in any case.
    pub(super) fn is_active(&mut self, now_ns: u64, due: Due) {
        if due.insist {
            self.list.push(Retirement { id: due.id, at_ns: now_ns + ASK_AGAIN_NS, insist: true });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_that_was_replaced_goes_after_its_time_and_stays_if_it_is_active_again() {
        let mut retirements = Retirements::default();
        retirements.plan(10, 1, 100);
        assert_eq!(retirements.look(109, 2).map(|due| due.id), None);
        assert_eq!(retirements.look(110, 2).map(|due| due.id), Some(1));
        retirements.plan(200, 1, 100);
        assert_eq!(retirements.look(300, 1).map(|due| due.id), None, "it is active again");
        assert_eq!(retirements.look(u64::MAX, 2).map(|due| due.id), None, "and is not to go any more");
    }

    #[test]
    fn one_that_was_refused_goes_as_soon_as_it_is_not_active() {
        let mut retirements = Retirements::default();
        retirements.dismiss(10, 2);
        assert_eq!(retirements.look(10, 1).map(|due| due.id), None, "not before the next look");
        assert_eq!(retirements.look(11, 2).map(|due| due.id), None);
        assert_eq!(retirements.look(11 + ASK_AGAIN_NS - 1, 1).map(|due| due.id), None);
        assert_eq!(retirements.look(11 + ASK_AGAIN_NS, 1).map(|due| due.id), Some(2));
    }
}
