use std::fs;
use std::os::unix::fs::PermissionsExt as _;

use super::*;

fn unique(what: &str) -> String {
    format!("test-{what}-{}", std::process::id())
}

fn folder_of(name: &str) -> PathBuf {
    runtime_folder().unwrap().join(name)
}

/// What is left of a group whose members were all killed.
fn dies(group: Group) {
    flock(&group.alive, FlockOperation::Unlock).unwrap();
    std::mem::forget(group);
}

#[test]
fn a_running_group_is_refused_a_second_time_and_gone_when_the_last_member_leaves() {
    let name = unique("twice");
    let group = Group::create(&name).unwrap();
    assert!(matches!(Group::create(&name), Err(GroupError::Running(_))));
    let member = Group::join(&name).unwrap();
    assert_eq!(member.run_id(), group.run_id());
    assert_eq!(member.prefix(), group.prefix());
    let folder = folder_of(&name);
    drop(group);
    assert!(folder.exists(), "a member is still in it");
    drop(member);
    assert!(!folder.exists(), "the last one sweeps");
    assert!(matches!(Group::join(&name), Err(GroupError::NotRunning { .. })));
}

#[test]
fn a_look_at_the_groups_neither_refuses_a_new_one_nor_keeps_a_last_member_from_sweeping() {
    let done = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(std::sync::atomic::Ordering::Relaxed) {
                let _ = list();
            }
        });
        let outcome = (0..200).find_map(|round| {
            let name = unique(&format!("looked-{round}"));
            let created = Group::create(&name).map(drop).err().map(|e| e.to_string());
            created.or_else(|| folder_of(&name).exists().then(|| format!("{name} is still there")))
        });
        done.store(true, std::sync::atomic::Ordering::Relaxed);
        assert_eq!(outcome, None);
    });
}

#[test]
fn what_a_dead_group_left_is_swept_by_the_next_of_that_name() {
    let name = unique("dead");
    let dead = Group::create(&name).unwrap();
    let (transport, object) = (dead.transport_root(), Path::new(SHARED_MEMORY).join(format!("{}left", dead.prefix())));
    fs::create_dir_all(transport.join("nodes/one")).unwrap();
    fs::write(transport.join("nodes/one/x"), "x").unwrap();
    fs::write(&object, "x").unwrap();
    dead.write("scenario.toml", b"x").unwrap();
    dies(dead);
    assert!(list().unwrap().contains(&Found { name: name.clone(), alive: false }));
    let group = Group::create(&name).unwrap();
    assert!(!object.exists() && !transport.exists() && !group.file("scenario.toml").exists());
    assert!(group.transport_root().exists());
    assert_ne!(group.transport_root(), transport, "nobody can know the names of its objects beforehand");
    drop(group);
    assert!(!folder_of(&name).exists());
}

#[test]
fn a_folder_without_the_mark_is_no_group_and_keeps_its_contents() {
    // Somebody's own folder, one with a file that happens to be called like ours, and one with a longer one.
    for (case, alive) in [("none", None), ("empty", Some("")), ("longer", Some("loopbound group\nand more"))] {
        let name = unique(&format!("unmarked-{case}"));
        // Makes the runtime directory.
        let other = Group::create(&unique(&format!("beside-{case}"))).unwrap();
        let folder = folder_of(&name);
        fs::create_dir(&folder).unwrap();
        fs::write(folder.join("data"), "mine").unwrap();
        if let Some(text) = alive {
            fs::write(folder.join("alive"), text).unwrap();
        }
        assert!(!list().unwrap().iter().any(|found| found.name == name), "{case}");
        assert!(!clean().unwrap().contains(&name), "{case}");
        let refused = Group::create(&name).unwrap_err();
        assert!(matches!(&refused, GroupError::NotOurs { .. }), "{case}: {refused}");
        assert!(matches!(Group::join(&name), Err(GroupError::NotRunning { .. })), "{case}");
        assert_eq!(fs::read_to_string(folder.join("data")).unwrap(), "mine", "{case}");
        drop(other);
        fs::remove_dir_all(&folder).unwrap();
        // What was kept for the folder that has gone by hand.
        drop(Group::create(&name).unwrap());
    }
}

#[test]
fn a_link_in_place_of_a_group_is_not_followed() {
    let name = unique("link");
    let other = Group::create(&unique("beside-link")).unwrap();
    let target = tempfile::tempdir().unwrap();
    // Even a target that has the mark: it is not in our runtime directory.
    fs::write(target.path().join("alive"), MARK).unwrap();
    fs::write(target.path().join("data"), "mine").unwrap();
    std::os::unix::fs::symlink(target.path(), folder_of(&name)).unwrap();
    assert!(!clean().unwrap().contains(&name));
    let refused = Group::create(&name).unwrap_err().to_string();
    assert!(refused.contains("symbolic link") && refused.contains(RUNTIME_VARIABLE), "{refused}");
    assert_eq!(fs::read_to_string(target.path().join("data")).unwrap(), "mine");
    fs::remove_file(folder_of(&name)).unwrap();
    drop(other);
}

#[test]
fn links_and_folders_in_a_dead_groups_folder_cost_nobody_anything() {
    let name = unique("inside");
    let target = tempfile::tempdir().unwrap();
    fs::write(target.path().join("data"), "mine").unwrap();
    let dead = Group::create(&name).unwrap();
    std::os::unix::fs::symlink(target.path(), dead.file("to-folder")).unwrap();
    std::os::unix::fs::symlink(target.path().join("data"), dead.file("to-file")).unwrap();
    fs::create_dir(dead.file("own")).unwrap();
    fs::write(dead.file("own/data"), "mine").unwrap();
    // The same below the transport's folder.
    let transport = dead.transport_root();
    std::os::unix::fs::symlink(target.path(), transport.join("to-folder")).unwrap();
    let own = dead.file("own");
    dies(dead);
    drop(Group::create(&name).unwrap());
    assert!(!transport.exists());
    assert_eq!(fs::read_to_string(target.path().join("data")).unwrap(), "mine");
    assert_eq!(fs::read_to_string(own.join("data")).unwrap(), "mine", "a group makes no folders: it is somebody's");
    assert!(!folder_of(&name).join("to-file").is_symlink());
    fs::remove_dir_all(own).unwrap();
    fs::remove_dir(folder_of(&name)).unwrap();
}

#[test]
fn what_a_group_makes_is_the_users_alone() {
    let group = Group::create(&unique("private")).unwrap();
    group.write("summary.json", b"{}").unwrap();
    drop(group.append("plant-1.log").unwrap());
    let mode = |path: &Path| fs::symlink_metadata(path).unwrap().permissions().mode() & 0o777;
    for folder in [runtime_folder().unwrap(), folder_of(group.name()), group.transport_root()] {
        assert_eq!(mode(&folder), 0o700, "{}", folder.display());
    }
    for file in ["alive", "run-id", "summary.json", "plant-1.log"] {
        assert_eq!(mode(&group.file(file)), 0o600, "{file}");
    }
}

#[test]
fn an_object_that_others_may_write_is_closed_and_a_file_with_a_second_name_is_not_touched() {
    let group = Group::create(&unique("closed")).unwrap();
    let object = |name: &str| Path::new(SHARED_MEMORY).join(format!("{}{name}", group.prefix()));
    fs::write(object("open"), "x").unwrap();
    fs::write(object("first"), "x").unwrap();
    fs::hard_link(object("first"), object("second")).unwrap();
    for name in ["open", "first"] {
        fs::set_permissions(object(name), fs::Permissions::from_mode(0o666)).unwrap();
    }
    group.close_objects();
    let mode = |name: &str| fs::metadata(object(name)).unwrap().permissions().mode() & 0o777;
    assert_eq!((mode("open"), mode("first")), (0o600, 0o666));
}

#[test]
fn a_bad_name_is_refused() {
    for name in ["", "a/b", "..", "a b", &"x".repeat(33)] {
        assert!(matches!(Group::create(name), Err(GroupError::Name(_))), "{name}");
        assert!(matches!(file_of(name, "control"), Err(GroupError::Name(_))), "{name}");
    }
}
