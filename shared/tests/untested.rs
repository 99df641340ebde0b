//! The last test of `cargo test --workspace`: says what the others could not try on this machine.
//!
//! Tests whose tools or rights are missing leave a note in a folder of the target (`tests/groups/untested.rs`). Packages
//! are tested in the order of their names, and this is the last one's.

use std::path::Path;

use loopbound_shared::say;

#[test]
fn what_could_not_be_tested_is_listed() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("untested");
    let notes = std::fs::read_dir(&folder).into_iter().flatten().flatten();
    let mut lines: Vec<String> = notes.filter_map(|note| std::fs::read_to_string(note.path()).ok()).collect();
    lines.sort();
    // The next run writes its own.
    let _ = std::fs::remove_dir_all(&folder);
    if !lines.is_empty() {
        let list = lines.join("\nNOT TESTED: ");
        // Past the test runner, which shows nothing of a test that passes.
        say::err!("\nNOT TESTED: {list}");
    }
    assert!(std::env::var_os("CI").is_none() || lines.is_empty(), "CI has to test everything");
}
