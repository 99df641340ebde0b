//! The documents say what the tree says: the code map of ARCHITECTURE.md, the keys of docs/scenario.md, and the headlines of
//! docs/exit-codes.md. Every command has its line, each that is shown can be typed, every line of the screen is explained, every
//! link leads somewhere, and one thing has one word.
//!
//! The map is made of the files' own first sentences. After a change, `UPDATE_DOCUMENTS=1 cargo test --test documents`
//! writes it, the table of headlines and the tables of keys anew.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::{CommandFactory as _, Parser as _};
use loopbound::args::Cli;
use loopbound_monitor::cause::Cause;
use loopbound_monitor::hops::Hop;
use loopbound_scenario::Scenario;
use loopbound_scenario::key::Placed;
use loopbound_shared::counters::Counters;
use loopbound_shared::headline::Headline;

const CRATES: [&str; 8] =
    ["model/src", "scenario/src", "shared/src", "plant/src", "controller/src", "reference/src", "monitor/src", "src"];
/// Folders with a map of their own: their files are not repeated beside the module that holds them.
const FOLDERS: [&str; 2] = ["src/commands", "src/supervise"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The entries of a folder in the order of their names; none if there is no such folder.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> =
        std::fs::read_dir(folder).into_iter().flatten().map(|entry| entry.expect("an entry").path()).collect();
    found.sort();
    found
}

fn is_rust(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "rs")
}

fn stem(path: &Path) -> &str {
    path.file_stem().and_then(|stem| stem.to_str()).expect("a name in UTF-8")
}

/// The first sentence of a module's own description, without its full stop and without links.
fn first_sentence(text: &str) -> String {
    let lines = text.lines().map_while(|line| line.strip_prefix("//!")).map(str::trim);
    let paragraph = lines.take_while(|line| !line.is_empty()).collect::<Vec<_>>().join(" ");
    let end = paragraph.find(". ").unwrap_or(paragraph.len());
    paragraph[..end].trim_end_matches('.').replace("[`", "`").replace("`]", "`")
}

/// The modules below a module's own folder, but for its tests, as paths without extension.
fn parts(folder: &Path, prefix: &str, found: &mut Vec<String>) {
    for path in entries(folder) {
        let name = format!("{prefix}{}", stem(&path));
        if path.is_dir() {
            parts(&path, &format!("{name}/"), found);
        } else if is_rust(&path) && !matches!(stem(&path), "tests" | "testing") {
            found.push(name);
        }
    }
}

fn map_of(source: &str) -> String {
    let mut map = format!("| `{source}/` | |\n|---|---|\n");
    for path in entries(&root().join(source)).into_iter().filter(|path| is_rust(path)) {
        let sentence = first_sentence(&read(&path));
        assert!(!sentence.is_empty(), "{} does not say what it is responsible for", path.display());
        let mut inside = Vec::new();
        if !FOLDERS.iter().any(|folder| root().join(folder) == path.with_extension("")) {
            parts(&path.with_extension(""), "", &mut inside);
        }
        let inside = inside.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
        let inside = if inside.is_empty() { inside } else { format!(" ({inside})") };
        writeln!(map, "| `{}.rs` | {sentence}{inside} |", stem(&path)).expect("a string takes all");
    }
    map
}

#[test]
fn the_code_map_lists_every_file_with_its_own_first_sentence() {
    let file = root().join("ARCHITECTURE.md");
    let written = read(&file);
    let mut right = written.clone();
    for source in CRATES.into_iter().chain(FOLDERS) {
        let begin = format!("<!-- map: {source} -->\n");
        let from = right.find(&begin).unwrap_or_else(|| panic!("no map of {source}")) + begin.len();
        let to = from + right[from..].find("<!-- end of map -->").expect("the map ends");
        right.replace_range(from..to, &map_of(source));
    }
    if std::env::var_os("UPDATE_DOCUMENTS").is_some() {
        std::fs::write(&file, &right).expect("it can be written");
    } else {
        assert!(written == right, "the code map is out of date: UPDATE_DOCUMENTS=1 cargo test --test documents");
    }
}

/// The table between the marks of this name is this one, or becomes it.
#[track_caller]
fn hold_table(document: &str, mark: &str, table: &str) {
    let file = root().join(document);
    let written = read(&file);
    let (begin, end) = (format!("<!-- {mark} -->\n"), format!("<!-- end of {mark} -->"));
    let from = written.find(&begin).expect("the table begins") + begin.len();
    let to = from + written[from..].find(&end).expect("the table ends");
    let mut right = written.clone();
    right.replace_range(from..to, table);
    if std::env::var_os("UPDATE_DOCUMENTS").is_some() {
        std::fs::write(&file, &right).expect("it can be written");
    } else {
        assert!(written == right, "{document} is out of date: UPDATE_DOCUMENTS=1 cargo test --test documents");
    }
}

#[test]
fn the_tables_of_hops_counters_and_causes_are_those_that_the_code_is_made_from() {
    let mut timing = String::from("| hop | from → to | includes |\n|---|---|---|\n");
    let mut screen = String::from("| row | from → to |\n|---|---|\n");
    for hop in Hop::ALL {
        let [ends, includes] = hop.defined();
        writeln!(timing, "| `{}` | {ends} | {includes} |", hop.name()).expect("a string takes all");
        writeln!(screen, "| {} | {} |", hop.words(), hop.reads()).expect("a string takes all");
    }
    hold_table("docs/timing.md", "hops", &timing);
    hold_table("docs/screen.md", "hops", &screen);
    let mut counters = String::from("| counter | counts |\n|---|---|\n");
    for counter in Counters::ALL {
        writeln!(counters, "| `{}` | {} |", counter.name, counter.sentence.trim_end_matches('.'))
            .expect("a string takes all");
    }
    hold_table("docs/screen.md", "counters", &counters);
    let mut causes = String::from("| cause | on the screen | meaning |\n|---|---|---|\n");
    for cause in Cause::ALL {
        let sentence = cause.sentence().trim_end_matches('.');
        writeln!(causes, "| `{}` | {} | {sentence} |", cause.name(), cause.words()).expect("a string takes all");
    }
    hold_table("docs/screen.md", "causes", &causes);
}

#[test]
fn the_document_of_exit_codes_holds_the_table_that_the_code_is_made_from() {
    let mut table = String::from("| headline | exit code | meaning |\n|---|---|---|\n");
    for headline in Headline::ALL {
        let (word, code, sentence) = (headline.screen_word(), headline.exit_code(), headline.sentence());
        writeln!(table, "| {word} | {code} | {sentence} |").expect("a string takes all");
    }
    hold_table("docs/exit-codes.md", "headlines", &table);
    assert!(read(&root().join("README.md")).contains("(docs/exit-codes.md)"), "README links the table");
}

/// The table of one section: of each key its default, what it may be, and its whole description.
fn table_of(placed: &Placed) -> String {
    let mut table = String::from("| key | default | allowed | meaning |\n|---|---|---|---|\n");
    for key in placed.section.own_keys() {
        let default = Scenario::default_of(&placed.path, key.name).map(|value| format!("`{value}`"));
        let default = default.unwrap_or_else(|| key.default_in_words());
        let allowed = key.allowed().replace(" | ", ", ");
        let kinds = key.kinds().join(", ");
        let kinds = if kinds.is_empty() { kinds } else { format!("{kinds}: ") };
        let meaning = key.description();
        let meaning = meaning.strip_suffix('.').filter(|text| !text.contains(". ")).unwrap_or(&meaning);
        assert!(!default.is_empty() && !meaning.is_empty(), "{}.{} says too little", placed.path, key.name);
        writeln!(table, "| `{}` | {default} | {allowed} | {kinds}{meaning} |", key.name).expect("a string takes all");
    }
    table
}

#[test]
fn the_document_of_keys_holds_the_tables_that_are_made_from_the_declarations() {
    let file = root().join("docs/scenario.md");
    let written = read(&file);
    let mut right = written.clone();
    for placed in Placed::all() {
        let heading = format!("## `{}`", placed.header());
        assert!(right.lines().any(|line| line == heading), "docs/scenario.md has no heading {heading}");
        let begin = format!("<!-- keys: {} -->\n", placed.path);
        let from = right.find(&begin).unwrap_or_else(|| panic!("no table of {}", placed.path)) + begin.len();
        let to = from + right[from..].find("<!-- end of keys -->").expect("the table ends");
        right.replace_range(from..to, &table_of(&placed));
    }
    let tables = right.matches("<!-- keys: ").count();
    assert_eq!(tables, Placed::all().len(), "a table of a section that there is not");
    if std::env::var_os("UPDATE_DOCUMENTS").is_some() {
        std::fs::write(&file, &right).expect("it can be written");
    } else {
        assert!(written == right, "docs/scenario.md is out of date: UPDATE_DOCUMENTS=1 cargo test --test documents");
    }
}

/// A file without its comments, its tests, and its declarations of sections.
fn code_of(path: &Path) -> String {
    let (mut code, mut declares) = (String::new(), false);
    for line in read(path).lines().take_while(|line| *line != "mod tests {") {
        declares = (declares || line == "section! {") && line != "}";
        if !declares {
            code.push_str(line.split("//").next().unwrap_or(line));
            code.push('\n');
        }
    }
    code
}

/// The code of all crates but for what only declares, checks and writes out the keys, as one text.
fn code_that_reads_keys() -> String {
    let mut open: Vec<PathBuf> = CRATES.iter().map(|source| root().join(source)).collect();
    let mut code = String::new();
    let not_a_reader = ["scenario/src/validate", "scenario/src/key", "scenario/src/keys"].map(|path| root().join(path));
    while let Some(folder) = open.pop() {
        for path in entries(&folder) {
            if not_a_reader.contains(&path.with_extension("")) || matches!(stem(&path), "tests" | "testing") {
                continue;
            }
            if path.is_dir() {
                open.push(path);
            } else if is_rust(&path) {
                code.push_str(&code_of(&path));
            }
        }
    }
    code
}

/// Whether a field of this name is read: no method, and no part of a longer name.
fn is_read(code: &str, field: &str) -> bool {
    let goes_on = |c: char| c.is_alphanumeric() || c == '_' || c == '(';
    code.match_indices(&format!(".{field}")).any(|(at, found)| !code[at + found.len()..].starts_with(goes_on))
}

#[test]
fn every_key_of_a_scenario_is_read_by_somebody() {
    let code = code_that_reads_keys();
    assert!(!is_read(&code, "nobody_reads_this") && !is_read("a.grace_ns() + a.grace()", "grace"));
    for placed in Placed::all() {
        for key in placed.section.own_keys() {
            let field = if key.name == "for" { "for_" } else { key.name };
            assert!(is_read(&code, field), "nobody reads {} {}", placed.path, key.name);
        }
    }
}

/// The documents, each without its blocks of code, by their paths from the root.
fn documents() -> BTreeMap<String, String> {
    let pages = entries(&root().join("docs"));
    let pages = pages.into_iter().filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    let pages = pages.map(|path| format!("docs/{}.md", stem(&path)));
    let names = ["README.md", "ARCHITECTURE.md", "CHANGELOG.md"].map(str::to_owned);
    names.into_iter().chain(pages).map(|name| (name.clone(), without_code(&read(&root().join(name))))).collect()
}

fn without_code(text: &str) -> String {
    let mut inside = false;
    let mut outside = String::new();
    for line in text.lines() {
        if line.starts_with("```") {
            inside = !inside;
        } else if !inside {
            outside.push_str(line);
            outside.push('\n');
        }
    }
    outside
}

/// The name by which a heading is linked: as GitHub makes it.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    let kept = kept.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

fn anchors(text: &str) -> Vec<String> {
    let headings = text.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#'));
    headings.map(anchor).collect()
}

/// What is wrong with a link from one document to a place in the tree; nothing for a link that leads somewhere.
fn broken(from: &str, target: &str, documents: &BTreeMap<String, String>) -> Option<String> {
    if target.starts_with("http") {
        return None;
    }
    let (path, heading) = target.split_once('#').map_or((target, None), |(path, heading)| (path, Some(heading)));
    let folder = root().join(from).parent().expect("a document lies in a folder").to_owned();
    let file = if path.is_empty() { root().join(from) } else { folder.join(path) };
    let Ok(file) = file.canonicalize() else { return Some(format!("{from}: there is no {path}")) };
    let name = file.strip_prefix(root().canonicalize().expect("the root is there")).ok()?.display().to_string();
    let heading = heading?;
    let text = documents.get(&name)?;
    let missing = !anchors(text).iter().any(|anchor| anchor == heading);
    missing.then(|| format!("{from}: {name} has no heading #{heading}"))
}

#[test]
fn every_link_of_the_documents_leads_somewhere() {
    let documents = documents();
    let mut links = 0;
    let mut wrong = Vec::new();
    for (name, text) in &documents {
        for (at, _) in text.match_indices("](") {
            let target = text[at + 2..].split(')').next().expect("a split has a first part");
            links += 1;
            wrong.extend(broken(name, target, &documents));
        }
    }
    assert!(links > 60, "only {links} links: they are not where this test looks");
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn a_link_to_a_missing_page_or_heading_is_found() {
    let documents = documents();
    for wrong in ["docs/no-such-page.md", "docs/limits.md#no-such-heading", "#no-such-heading"] {
        assert!(broken("README.md", wrong, &documents).is_some(), "{wrong}");
    }
    for right in ["docs/limits.md", "docs/limits.md#transport", "#set-up", "docs/img/report-light.png"] {
        assert_eq!(broken("README.md", right, &documents), None);
    }
}

#[test]
fn every_command_has_an_example_in_the_page_of_commands() {
    let page = read(&root().join("docs/commands.md"));
    for command in Cli::command().get_subcommands().filter(|command| !command.is_hide_set()) {
        let name = command.get_name();
        assert!(page.contains(&format!("loopbound {name}")), "docs/commands.md does not show `loopbound {name}`");
    }
}

/// What a reader may write in the place of a word in capitals.
const FOR_EXAMPLE: [(&str, &str); 5] =
    [("ADDR", "8765"), ("COMMAND", "run"), ("KIND", "delay"), ("LAW", "ctc"), ("SHELL", "bash")];

/// The words of a command as it stands in a document, up to a remark; none if it is no command of this program.
fn words_of_a_command(text: &str) -> Option<Vec<String>> {
    let text = text.strip_prefix("loopbound ")?;
    let text = text.split("  ").next().expect("a split has a first part");
    let words = text.split_whitespace().take_while(|word| !matches!(*word, "&" | "#"));
    let example =
        |word: &str| FOR_EXAMPLE.iter().find(|(place, _)| *place == word).map_or(word, |(_, value)| value).to_owned();
    Some(std::iter::once("loopbound".to_owned()).chain(words.map(|word| example(word.trim_matches('"')))).collect())
}

/// The commands between backticks, and those that have a line of their own.
fn commands_of(text: &str) -> Vec<Vec<String>> {
    let known: Vec<String> = Cli::command().get_subcommands().map(|command| command.get_name().to_owned()).collect();
    let lines = text.lines().filter_map(|line| words_of_a_command(line.trim_start()));
    let lines = lines.filter(|words| words.get(1).is_some_and(|name| known.contains(name)));
    let outside = without_code(text).split_whitespace().collect::<Vec<_>>().join(" ");
    let spans = outside.split('`').skip(1).step_by(2).filter_map(words_of_a_command);
    lines.chain(spans).collect()
}

/// What the program itself would say against a command; what a sentence leaves out of it is not asked for.
fn refused(words: &[String]) -> Option<String> {
    use clap::error::ErrorKind::{DisplayHelp, DisplayHelpOnMissingArgumentOrSubcommand, MissingRequiredArgument};
    let error = Cli::try_parse_from(words).err()?;
    let left_out =
        matches!(error.kind(), DisplayHelp | DisplayHelpOnMissingArgumentOrSubcommand | MissingRequiredArgument);
    (!left_out).then(|| error.to_string())
}

#[test]
fn every_command_that_a_document_shows_can_be_typed() {
    let mut commands = 0;
    for name in documents().into_keys().filter(|name| name != "CHANGELOG.md") {
        for words in commands_of(&read(&root().join(&name))) {
            commands += 1;
            assert_eq!(refused(&words), None, "{name} shows `{}`", words.join(" "));
        }
    }
    assert!(commands > 50, "only {commands} commands: they are not where this test looks");
    for wrong in
        ["loopbound runn", "loopbound run --rat 1kHz", "loopbound run --rate 1", "loopbound fault --group g shake"]
    {
        assert!(refused(&words_of_a_command(wrong).expect("a command")).is_some(), "{wrong}");
    }
}

/// Words that a reader has to guess at, each with the word that is used for the same thing.
const SAID_OTHERWISE: [(&str, &str); 12] = [
    ("befall", "target, inject"),
    ("put down to", "attribute to"),
    ("laid to", "attribute to"),
    ("in charge", "active"),
    ("on watch", "standby"),
    ("taken back", "rolled back"),
    ("takes it back", "rolls it back"),
    ("take back", "roll back"),
    ("sweep up", "clean up"),
    ("swept", "removed"),
    (" mends", "fixes"),
    ("goes wrong on purpose", "injected fault"),
];

/// A word that is wanted may be broken over two lines.
fn words_said_otherwise(text: &str) -> Vec<String> {
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ").to_lowercase();
    let found = SAID_OTHERWISE.iter().filter(|(word, _)| text.contains(word));
    found.map(|(word, right)| format!("\"{}\" is said as: {right}", word.trim())).collect()
}

fn without_maps(text: &str) -> String {
    let parts = text.split("<!-- map: ").enumerate();
    parts
        .map(
            |(i, part)| if i == 0 { part } else { part.split_once("<!-- end of map -->").map_or("", |(_, rest)| rest) },
        )
        .collect()
}

#[test]
fn one_thing_has_one_word_in_the_documents() {
    for (name, text) in documents() {
        // What has changed is told by the words of its time, and the code map by those of the files.
        if name == "CHANGELOG.md" {
            continue;
        }
        assert_eq!(words_said_otherwise(&without_maps(&text)), Vec::<String>::new(), "{name}");
    }
    assert_eq!(words_said_otherwise("The fault befalls it, and is put\ndown to the host").len(), 2);
}

/// The labels of the screen of a run, as the code writes them.
fn labels_of_the_screen() -> Vec<String> {
    let code = ["render.rs", "render/bound.rs"].map(|file| read(&root().join("monitor/src").join(file))).concat();
    let literals = |before: &'static str| {
        let after = code.match_indices(before).map(|(at, found)| &code[at + found.len()..]).collect::<Vec<_>>();
        after.into_iter().filter_map(|rest| rest.split_once('"').map(|(label, _)| label.to_owned())).collect::<Vec<_>>()
    };
    let mut labels: Vec<String> = ["entry(\"", "let mut label = \""].into_iter().flat_map(literals).collect();
    labels.extend(Hop::ALL.map(|hop| hop.words().to_owned()));
    labels.retain(|label| !label.is_empty());
    labels
}

#[test]
fn every_line_of_the_screen_is_explained() {
    let page = read(&root().join("docs/screen.md"));
    let labels = labels_of_the_screen();
    assert!(labels.len() > 20, "only {labels:?}: they are not where this test looks");
    for label in labels {
        let explained = page.lines().any(|line| line.strip_prefix("| ").is_some_and(|row| row.starts_with(&label)));
        assert!(explained, "docs/screen.md does not say what the line \"{label}\" means");
    }
}

#[test]
fn the_twelve_lines_of_the_first_page_are_of_the_whole_screen_and_have_a_note_each() {
    let readme = read(&root().join("README.md"));
    let screen = readme.split("```text\n").nth(1).and_then(|rest| rest.split("```").next()).expect("a screen");
    let whole = read(&root().join("docs/screen.md"));
    for line in screen.lines() {
        let (shown, note) = line.split_once('←').unwrap_or_else(|| panic!("no note: {line}"));
        let shown = shown.split('…').next().expect("a split has a first part").trim_end();
        assert!(whole.contains(shown), "docs/screen.md has no line {shown}");
        assert!(!note.trim().is_empty(), "an empty note: {line}");
    }
    assert_eq!(screen.lines().count(), 12);
}

#[test]
fn the_page_of_swaps_draws_the_states_of_authority_as_the_code_does() {
    let code = read(&root().join("plant/src/authority.rs"));
    let prose: String = code
        .lines()
        .filter_map(|line| line.strip_prefix("//!"))
        .flat_map(|line| [line.strip_prefix(' ').unwrap_or(line), "\n"])
        .collect();
    let drawings: Vec<&str> = prose.split("```").skip(1).step_by(2).collect();
    assert_eq!(drawings.len(), 3, "members, a swap, the fallback");
    let page = read(&root().join("docs/swap.md"));
    for drawing in drawings {
        assert!(page.contains(&format!("```{drawing}```")), "docs/swap.md lacks this drawing:\n{drawing}");
    }
}
