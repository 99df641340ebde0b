use super::*;
use crate::commands::doctor::Stalls;
use crate::commands::doctor::wakeup::Lateness;

/// Mounts as a host with both versions shows them.
const MOUNTS: &str = "\
31 23 0:28 / /sys/fs/cgroup rw,relatime - tmpfs tmpfs rw,mode=755
32 31 0:29 / /sys/fs/cgroup/cpu,cpuacct rw,relatime shared:9 - cgroup cgroup rw,cpu,cpuacct
33 31 0:31 / /sys/fs/cgroup/cpuset rw,relatime - cgroup cgroup rw,cpuset
41 31 0:38 / /sys/fs/cgroup/unified rw,relatime - cgroup2 cgroup2 rw
";
/// Files, and what they have to be found to mean.
type Case<'a> = (&'a [(&'a str, &'a str)], Status, &'a str);

const V1: &str = "sys/fs/cgroup/cpu,cpuacct";
const V2: &str = "sys/fs/cgroup/unified";

fn live(fifo: Outcome) -> Live {
    Live {
        fifo,
        fifo_priority: 80,
        lockable_bytes: None,
        tick_ns: None,
        stalls: Stalls::default(),
        wake_up: Lateness { min_ns: 0, mean_ns: 0, max_ns: 0 },
        cyclictest: None,
    }
}

/// A machine with these mounts, groups of the process and files.
fn machine(mounts: &str, groups: &str, files: &[(&str, &str)]) -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    for (path, text) in [("proc/self/mountinfo", mounts), ("proc/self/cgroup", groups)].iter().chain(files) {
        let path = root.path().join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    root
}

fn quota(mounts: &str, groups: &str, files: &[(&str, &str)]) -> Finding {
    cpu_quota(&Tree::new(machine(mounts, groups, files).path()))
}

fn in_group(mount: &str, group: &str, file: &str) -> String {
    format!("{mount}{group}/{file}")
}

#[test]
fn a_quota_is_that_of_the_own_group_or_of_one_above_whichever_is_least() {
    let of = |group: &str| in_group(V2, group, "cpu.max");
    let cases: [Case; 6] = [
        (&[], Status::Good, "none"),
        (&[("/s/a", "max 100000\n")], Status::Good, "none"),
        (&[("/s/a", "300000 100000\n")], Status::Warn, "3.00 cores"),
        (&[("/s/a", "50000 100000\n")], Status::Bad, "0.50 cores"),
        (&[("/s", "50000 100000\n"), ("/s/a", "max 100000\n")], Status::Bad, "0.50 cores"),
        (&[("/s", "100000 100000\n"), ("/s/a", "300000 100000\n"), ("/t", "1 100000\n")], Status::Bad, "1.00 cores"),
    ];
    for (files, status, words) in cases {
        let files: Vec<(String, &str)> = files.iter().map(|(group, text)| (of(group), *text)).collect();
        let files: Vec<(&str, &str)> = files.iter().map(|(path, text)| (path.as_str(), *text)).collect();
        let found = quota(MOUNTS, "1:name=systemd:/x\n0::/s/a\n", &files);
        assert!(found.status == status && found.found.starts_with(words), "{files:?}: {found:?}");
    }
    let files = [
        (in_group(V1, "/a", "cpu.cfs_quota_us"), "150000"),
        (in_group(V1, "/a", "cpu.cfs_period_us"), "100000"),
        (in_group(V1, "", "cpu.cfs_quota_us"), "-1"),
        (in_group(V1, "", "cpu.cfs_period_us"), "100000"),
    ];
    let files: Vec<(&str, &str)> = files.iter().map(|(path, text)| (path.as_str(), *text)).collect();
    let found = quota(MOUNTS, "5:cpuset:/b\n4:cpu,cpuacct:/a\n0::/\n", &files);
    assert!(found.found.starts_with("1.50 cores") && found.found.contains("/a/cpu.cfs_quota_us"), "{found:?}");
}

#[test]
fn a_container_is_shown_its_own_group_as_the_root() {
    // Without a namespace of control groups the mount's root says which group it is; with one the path is "/".
    let bound = "32 31 0:29 /docker/f /sys/fs/cgroup ro - cgroup2 cgroup rw\n";
    let own = "32 31 0:29 / /sys/fs/cgroup ro - cgroup2 cgroup rw\n";
    let file = [("sys/fs/cgroup/cpu.max", "50000 100000")];
    for (mounts, groups) in [(bound, "0::/docker/f\n"), (own, "0::/\n"), (own, "0::/../../elsewhere\n")] {
        assert_eq!(quota(mounts, groups, &file).status, Status::Bad, "{groups}");
    }
    let nothing = quota("1 0 0:1 / / rw - ext4 /dev/vda rw\n", "0::/docker/f\n", &[]);
    assert_eq!(nothing.status, Status::Unknown, "{nothing:?}");
}

#[test]
fn where_the_control_group_forbids_real_time_the_remedies_are_those_that_help() {
    let refused = live(Outcome::Refused(1));
    let files = [("sys/fs/cgroup/cpu,cpuacct/a/cpu.rt_runtime_us", "0\n")];
    let root = machine(MOUNTS, "4:cpu,cpuacct:/a\n0::/\n", &files);
    let tree = Tree::new(root.path());
    let finding = rt_budget(&tree, &refused);
    assert!(finding.status == Status::Bad && finding.found.contains("/a/cpu.rt_runtime_us is 0"), "{finding:?}");
    let mend = |tree: &Tree| {
        let (fifo, budget) = (super::super::privileges::sched_fifo(tree, &refused), rt_budget(tree, &refused));
        assert_eq!(fifo.mend, budget.mend);
        fifo.mend.unwrap()
    };
    assert_eq!(mend(&tree), "echo $$ | sudo tee /sys/fs/cgroup/cpu,cpuacct/cgroup.procs  # this shell");
    std::fs::write(root.path().join(".dockerenv"), "").unwrap();
    assert!(mend(&tree).contains("--cpu-rt-runtime=950000") && !mend(&tree).contains("tee"), "{}", mend(&tree));
    // Granted all the same, or a budget that is not 0: nothing to say.
    assert_eq!(rt_budget(&tree, &live(Outcome::Had)).status, Status::Good);
    std::fs::write(root.path().join(files[0].0), "950000\n").unwrap();
    assert!(mend_of_user(&tree, &refused).contains("SYS_NICE"));
}

fn mend_of_user(tree: &Tree, live: &Live) -> String {
    assert_eq!(rt_budget(tree, live).status, Status::Good);
    super::super::privileges::sched_fifo(tree, live).mend.unwrap()
}

#[test]
fn version_2_gives_no_real_time_below_the_root_where_the_kernel_budgets_it() {
    let config = "boot/config-6.12";
    let base: [(&str, &str); 2] = [("proc/sys/kernel/osrelease", "6.12\n"), (config, "CONFIG_RT_GROUP_SCHED=y\n")];
    let status = |groups: &str, more: &[(&str, &str)]| {
        let files: Vec<_> = base.iter().chain(more).copied().collect();
        let root = machine(MOUNTS, groups, &files);
        rt_budget(&Tree::new(root.path()), &live(Outcome::Refused(1)))
    };
    let own = ("sys/fs/cgroup/unified/s/cpu.max", "max 100000\n");
    let found = status("0::/s\n", &[own]);
    assert!(found.status == Status::Bad && found.mend.as_ref().unwrap().contains("rt_group_sched=0"), "{found:?}");
    let disabled = (config, "CONFIG_RT_GROUP_SCHED=y\nCONFIG_RT_GROUP_SCHED_DEFAULT_DISABLED=y\n");
    let cases: [(&str, &[(&str, &str)]); 5] = [
        ("0::/\n", &[("sys/fs/cgroup/unified/cpu.max", "max 100000\n")]),
        ("0::/s\n", &[]),
        ("0::/s\n", &[own, ("proc/cmdline", "quiet rt_group_sched=0\n")]),
        ("0::/s\n", &[own, (config, "# CONFIG_RT_GROUP_SCHED is not set\n")]),
        ("0::/s\n", &[own, disabled]),
    ];
    for (groups, more) in cases {
        assert_eq!(status(groups, more).status, Status::Good, "{groups}: {more:?}");
    }
}
