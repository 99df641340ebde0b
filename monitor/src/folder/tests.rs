use std::fs;
use std::path::Path;

use loopbound_shared::run_id::RunId;

use super::*;

fn begin(run_id: RunId) -> Begin<'static> {
    Begin { run_id, group: "g", scenario: Some("[loop]\n"), waypoints: Some(b"0,0\n1,1\n") }
}

/// Takes the folder and writes what a run would.
fn run_into(folder: &Path, run_id: RunId) -> Results {
    let mut results = Claim::prepare(folder, Kind::Run).unwrap().begin(&begin(run_id)).unwrap();
    results.write(known::SUMMARY, b"{\n  \"schema\": 1,\n  \"build\": \"0\",\n  \"latency_ns\": {}}\n").unwrap();
    results.write("latency/compute.hgrm", b"  Value  Percentile  TotalCount  1/(1-Percentile)\n").unwrap();
    results.write("changes/500.csv", b"tick,t_s,q1,V\n").unwrap();
    results
}

fn there(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// The refusal of a run there.
fn refusal(folder: &Path) -> String {
    Claim::prepare(folder, Kind::Run).unwrap_err().0
}

#[test]
fn what_is_refused_leaves_the_earlier_run_whole_and_what_begins_leaves_nothing_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (RunId::draw(), RunId::draw());
    run_into(folder.path(), first).finish().unwrap();
    fs::write(folder.path().join("notes.txt"), "mine").unwrap();
    // Prepared and given up: as a run that is refused before it starts.
    drop(Claim::prepare(folder.path(), Kind::Run).unwrap());
    let look = Look::at(folder.path()).unwrap();
    assert!(look.is_whole(), "{look:?}");
    assert!(look.whose().contains(&first.to_string()), "{}", look.whose());

    let results = Claim::prepare(folder.path(), Kind::Run).unwrap().begin(&begin(second)).unwrap();
    assert_eq!(there(folder.path()), ["manifest.json", "notes.txt", "scenario.toml", "waypoints.csv"]);
    drop(results);
    let look = Look::at(folder.path()).unwrap();
    assert!(!look.is_whole() && look.headline().contains(&second.to_string()), "{}", look.headline());
    // An unfinished one gives way too.
    run_into(folder.path(), first).finish().unwrap();
    assert!(Look::at(folder.path()).unwrap().is_whole());
}

#[test]
fn what_is_not_ours_is_refused_by_name_and_stays() {
    for name in ["summary.json", "samples.mcap", "scenario.toml", "waypoints.csv", "latency/compute.hgrm", "junit.xml"]
    {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir_all(folder.path().join(name).parent().unwrap()).unwrap();
        fs::write(folder.path().join(name), "somebody else's").unwrap();
        let said = refusal(folder.path());
        assert!(said.contains(name) && said.contains("not of loopbound's"), "{said}");
        assert_eq!(fs::read_to_string(folder.path().join(name)).unwrap(), "somebody else's");
    }
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("changes")).unwrap();
    fs::write(folder.path().join("changes/500.csv"), "a,b\n").unwrap();
    assert!(refusal(folder.path()).contains("changes/500.csv"));
    fs::rename(folder.path().join("changes/500.csv"), folder.path().join("changes/mine.csv")).unwrap();
    drop(Claim::prepare(folder.path(), Kind::Run).unwrap().begin(&begin(RunId::draw())).unwrap());
    assert!(folder.path().join("changes/mine.csv").exists(), "a name that no run writes");
}

#[test]
fn a_scenario_that_was_edited_in_the_folder_is_not_thrown_away() {
    let folder = tempfile::tempdir().unwrap();
    run_into(folder.path(), RunId::draw()).finish().unwrap();
    fs::write(folder.path().join("scenario.toml"), "# mine\n[loop]\n").unwrap();
    let said = refusal(folder.path());
    assert!(said.contains("scenario.toml was changed since its run wrote it"), "{said}");
}

#[test]
fn links_are_not_followed() {
    let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    run_into(folder.path(), RunId::draw()).finish().unwrap();
    let precious = elsewhere.path().join("500.csv");
    fs::write(&precious, "tick,t_s,q1,precious\n").unwrap();
    let link = |target: &Path, name: &str| {
        let path = folder.path().join(name);
        let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
        std::os::unix::fs::symlink(target, path).unwrap();
    };
    link(elsewhere.path(), "changes");
    assert!(refusal(folder.path()).contains("changes"), "{}", refusal(folder.path()));
    fs::remove_file(folder.path().join("changes")).unwrap();
    link(&precious, "samples.csv");
    assert!(refusal(folder.path()).contains("samples.csv is a symbolic link"), "{}", refusal(folder.path()));
    assert!(precious.exists());
}

#[test]
fn a_second_run_into_the_same_folder_is_refused_while_anyone_of_the_first_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let run_id = RunId::draw();
    let claim = Claim::prepare(folder.path(), Kind::Run).unwrap();
    assert!(refusal(folder.path()).contains("is writing there"));
    let launcher = claim.begin(&begin(run_id)).unwrap();
    let monitor = Results::join(folder.path(), run_id).unwrap();
    assert!(Results::join(folder.path(), RunId::draw()).is_err(), "of another run");
    drop(launcher);
    let said = refusal(folder.path());
    assert!(said.contains("is writing there") && said.contains(&run_id.to_string()), "{said}");
    assert!(Look::at(folder.path()).unwrap().headline().contains("still under way"));
    drop(monitor);
    drop(Claim::prepare(folder.path(), Kind::Run).unwrap());
}

#[test]
fn every_file_that_is_not_as_written_is_named() {
    let folder = tempfile::tempdir().unwrap();
    run_into(folder.path(), RunId::draw()).finish().unwrap();
    let text = fs::read_to_string(folder.path().join("summary.json")).unwrap();
    fs::write(folder.path().join("summary.json"), text.replace("\"build\": \"0\"", "\"build\": \"1\"")).unwrap();
    fs::write(folder.path().join("changes/500.csv"), "").unwrap();
    fs::remove_file(folder.path().join("latency/compute.hgrm")).unwrap();
    let said = Look::at(folder.path()).unwrap().headline();
    for named in ["summary.json is not what its run wrote", "changes/500.csv has 0 bytes", "compute.hgrm is missing"] {
        assert!(said.contains(named), "{said}");
    }
}

#[test]
fn a_file_that_was_written_again_on_purpose_is_as_written() {
    let folder = tempfile::tempdir().unwrap();
    run_into(folder.path(), RunId::draw()).finish().unwrap();
    Look::rewrite(folder.path(), "report.html", b"<title>again</title>").unwrap();
    Look::rewrite(folder.path(), "report.html", b"<title>and again</title>").unwrap();
    let look = Look::at(folder.path()).unwrap();
    assert!(look.is_whole() && look.manifest.unwrap().files.contains_key("report.html"));
    for name in ["samples.mcap", "summary.json", "changes/500.csv", "manifest.json", "latency"] {
        let path = folder.path().join(name);
        let listed = path.exists();
        assert_eq!(refuse_file_of_a_run(&path, "report.html").is_err(), listed, "{name}");
    }
    refuse_file_of_a_run(&folder.path().join("report.html"), "report.html").unwrap();
    refuse_file_of_a_run(&folder.path().join("compared.html"), "report.html").unwrap();
}

#[test]
fn a_folder_that_was_made_for_a_run_that_is_refused_goes_again() {
    let folder = tempfile::tempdir().unwrap();
    let deep = folder.path().join("a/b/c");
    drop(Claim::prepare(&deep, Kind::Run).unwrap());
    assert!(!folder.path().join("a").exists());
    drop(Claim::prepare(&deep, Kind::Run).unwrap().begin(&begin(RunId::draw())).unwrap());
    assert!(deep.join("manifest.json").exists());
    let file = folder.path().join("file");
    fs::write(&file, "x").unwrap();
    let dangling = folder.path().join("link");
    std::os::unix::fs::symlink("nowhere", &dangling).unwrap();
    assert!(refusal(&dangling).contains("leads nowhere"), "{}", refusal(&dangling));
    assert!(refusal(&file).contains("it is a file"), "{}", refusal(&file));
    assert!(refusal(&file.join("below")).contains("file/below"), "{}", refusal(&file.join("below")));
}

#[test]
fn a_study_s_folder_takes_no_run_and_a_run_s_no_study() {
    let folder = tempfile::tempdir().unwrap();
    let study = Begin { scenario: None, waypoints: None, ..begin(RunId::draw()) };
    let mut results = Claim::prepare(folder.path(), Kind::Study).unwrap().begin(&study).unwrap();
    results.write("table.csv", b"n\n1\n").unwrap();
    results.finish().unwrap();
    assert!(refusal(folder.path()).contains("it holds study"), "{}", refusal(folder.path()));
    assert!(Look::at(folder.path()).is_err());
    fs::write(folder.path().join("mine.csv"), "n\n").unwrap();
    drop(Claim::prepare(folder.path(), Kind::Study).unwrap().begin(&study).unwrap());
    assert_eq!(there(folder.path()), ["manifest.json", "mine.csv"], "the earlier study's table goes");
}

#[test]
fn a_folder_without_any_recording_is_none() {
    let folder = tempfile::tempdir().unwrap();
    assert!(Look::at(folder.path()).unwrap_err().0.contains("no recording"));
    assert!(Look::at(&folder.path().join("absent")).unwrap_err().0.contains("no such folder"));
    fs::write(folder.path().join("samples.mcap"), "").unwrap();
    assert!(!Look::at(folder.path()).unwrap().is_whole(), "a version without manifests was killed");
}
