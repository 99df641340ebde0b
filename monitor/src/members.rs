//! Who takes part, by what each process said of itself, and whether it lives.

use loopbound_shared::event::{Phase, Role};
use loopbound_shared::realtime::ProcessHandle;
use loopbound_shared::sample::Announce;

use crate::summary::{ProcessSummary, missing_privileges};

/// Processes that are remembered.
const MEMBERS_MAX: usize = 64;

/// The processes of a group as they announced themselves, each by its last word.
#[derive(Default)]
pub(crate) struct Members {
    list: Vec<Member>,
}

struct Member {
    announce: Announce,
    /// None: it was gone when its announcement came.
    handle: Option<ProcessHandle>,
}

impl Members {
    /// Takes an announcement; the later of two of one process counts.
    pub(crate) fn learn(&mut self, announce: &Announce) {
        let same = |member: &&mut Member| {
            (member.announce.pid, member.announce.role, member.announce.id)
                == (announce.pid, announce.role, announce.id)
        };
        if let Some(member) = self.list.iter_mut().find(same) {
            if announce.published_ns >= member.announce.published_ns {
                member.announce = *announce;
            }
        } else if self.list.len() < MEMBERS_MAX {
            self.list.push(Member { announce: *announce, handle: ProcessHandle::open(announce.pid).ok() });
        }
    }

    /// Whether any process of a role lives; none if none ever announced itself.
    #[must_use]
    pub(crate) fn is_alive(&self, role: Role) -> Option<bool> {
        let mut of_role = self.list.iter().filter(|member| member.announce.role == role.code()).peekable();
        of_role.peek()?;
        Some(of_role.any(Member::is_alive))
    }

    /// One entry a process, by role and id.
    #[must_use]
    pub(crate) fn summaries(&self) -> Vec<ProcessSummary> {
        let mut all: Vec<_> = self.list.iter().map(|member| summary(&member.announce)).collect();
        all.sort_by(|a, b| (&a.role, a.id, a.pid).cmp(&(&b.role, b.id, b.pid)));
        all
    }
}

impl Member {
    fn is_alive(&self) -> bool {
        self.handle.as_ref().is_some_and(|handle| !handle.wait_end(0).unwrap_or(false))
    }
}

/// What a process calls itself: its law, its executable, or whatever a controller of one's own says.
pub(crate) fn name_of(announce: &Announce) -> String {
    let end = announce.name.iter().position(|byte| *byte == 0).unwrap_or(announce.name.len());
    String::from_utf8_lossy(&announce.name[..end]).into_owned()
}

fn summary(announce: &Announce) -> ProcessSummary {
    ProcessSummary {
        role: Role::from_code(announce.role).map_or("unknown", Role::name).to_owned(),
        id: announce.id,
        pid: announce.pid,
        name: name_of(announce),
        phase: Phase::from_code(announce.phase).map_or("unknown", Phase::name).to_owned(),
        privileges: serde_json::to_value(announce.privileges).unwrap_or_default(),
        missing: missing_privileges(&announce.privileges),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_that_lives_and_one_that_is_gone_are_told_apart() {
        let mut members = Members::default();
        assert_eq!(members.is_alive(Role::Plant), None);
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let plant = Announce { role: Role::Plant.code(), pid: child.id(), phase: 1, ..Announce::zeroed() };
        members.learn(&plant);
        assert_eq!(members.is_alive(Role::Plant), Some(true));
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(members.is_alive(Role::Plant), Some(false));
        let mut ended = Announce { phase: 2, published_ns: 5, ..plant };
        ended.name[..3].copy_from_slice(b"abc");
        members.learn(&ended);
        let summaries = members.summaries();
        assert_eq!((summaries.len(), summaries[0].phase.as_str(), summaries[0].name.as_str()), (1, "ended", "abc"));
    }
}
