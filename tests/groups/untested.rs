//! What a test could not try on this machine is written down; `shared/tests/untested.rs` lists it at the end of the run.

use std::path::Path;

/// Notes that `what` was not tested, and `why`.
///
/// # Panics
/// In CI (`CI=true`), where everything has to be there.
pub(crate) fn not_tested(what: &str, why: &str) {
    assert!(std::env::var_os("CI").is_none(), "{what} can't be tested here, and CI has to: {why}");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("untested");
    let written = std::fs::create_dir_all(&folder)
        .and_then(|()| std::fs::write(folder.join(what.replace('/', "-")), format!("{what}: {why}")));
    written.expect("a note of what was not tested");
}
