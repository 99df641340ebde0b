//! The file of waypoints: comma-separated values, whose first line may name the columns.
//!
//! Names are names: time (`t_s`, `t_ms`) and joints (`q1`, `q1_rad`, `q1_deg`) stand in any order, and what is none of
//! them is refused. Without a line of names the columns are `t_s, q1 … qn`, in s and rad. Lines that begin with `#` are
//! comments.

use crate::chain::{LINKS_MAX, Vector};
use crate::quote;

/// What separates values, and what others take for it.
const SEPARATORS: [(char, &str); 3] = [(';', "';'"), ('\t', "a tab"), ('|', "'|'")];

/// The largest time (s) or angle (rad), as of every number of a scenario.
const VALUE_MAX: f64 = 1e12;

/// A refusal: the line, counted from 1, and what is wrong with it.
pub(super) type Refusal = (usize, String);

/// The waypoints of a text.
pub(super) struct Read<const N: usize> {
    /// Times (s) and angles (rad), times increasing.
    pub(super) points: Vec<(f64, Vector<N>)>,
    /// The last line that is not empty, from 1.
    pub(super) last_line: usize,
}

/// What a column holds.
#[derive(Clone, Debug)]
struct Column {
    /// As the file calls it, or would.
    name: String,
    /// The time, or the link from 0.
    what: What,
    /// What its values are multiplied and divided by to be s or rad.
    scale: (f64, f64),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum What {
    Time,
    Link(usize),
}

/// Reads a text.
pub(super) fn read<const N: usize>(text: &str) -> Result<Read<N>, Refusal> {
    const { assert!(N <= LINKS_MAX, "the wire format carries 1 to 7 links") };
    let text = text.trim_start_matches('\u{feff}').trim_end();
    let mut columns: Option<Vec<Column>> = None;
    let mut read = Read { points: Vec::new(), last_line: text.lines().count().max(1) };
    for (index, row) in text.lines().enumerate() {
        let refuse = |problem: String| (index + 1, problem);
        if row.trim_start().starts_with('#') {
            continue;
        }
        check_separator(row, N).map_err(refuse)?;
        let Some(columns) = &columns else {
            if is_header(row) {
                columns = Some(header(row, N).map_err(refuse)?);
                continue;
            }
            let given = columns.insert(in_order(N));
            read.points.push(parse_row(row, given).map_err(refuse)?);
            continue;
        };
        let point = parse_row(row, columns).map_err(refuse)?;
        if let Some((before_s, _)) = read.points.last()
            && point.0 <= *before_s
        {
            let (found, before) = (quote::number(point.0), quote::number(*before_s));
            return Err(refuse(format!("t_s is {found}, allowed: more than {before}, that of the line before")));
        }
        read.points.push(point);
    }
    if read.points.len() < 2 {
        let found = read.points.len();
        return Err((read.last_line, format!("the file ends after {found} waypoints, allowed: 2 or more")));
    }
    Ok(read)
}

/// `t_s, q1 … qn`.
fn in_order(links: usize) -> Vec<Column> {
    let time = Column { name: "t_s".to_owned(), what: What::Time, scale: (1.0, 1.0) };
    let link = |i: usize| Column { name: format!("q{}", i + 1), what: What::Link(i), scale: (1.0, 1.0) };
    std::iter::once(time).chain((0..links).map(link)).collect()
}

/// Whether the first line of a text that is no comment names its columns.
pub(super) fn has_names(text: &str) -> bool {
    let text = text.trim_start_matches('\u{feff}');
    text.lines().find(|row| !row.trim_start().starts_with('#')).is_some_and(is_header)
}

/// Whether a line holds names: what it begins with is neither a number nor begins like one.
fn is_header(row: &str) -> bool {
    let row = row.trim();
    let first = row.split(',').next().unwrap_or(row).trim();
    let like_a_number = first.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '-' | '+' | '.'));
    !row.is_empty() && first.parse::<f64>().is_err() && !like_a_number
}

fn check_separator(row: &str, links: usize) -> Result<(), String> {
    for (separator, shown) in SEPARATORS {
        if row.trim().contains(separator) {
            return Err(format!("{shown} separates nothing here, allowed: ',' between the values"));
        }
    }
    let words = row.split_whitespace().count();
    if words > links && !row.contains(',') {
        return Err("blanks separate nothing here, allowed: ',' between the values".to_owned());
    }
    Ok(())
}

/// The columns that a line names.
fn header(row: &str, links: usize) -> Result<Vec<Column>, String> {
    let mut columns: Vec<Column> = Vec::new();
    let allowed = format!("t_s or t_ms, and q1 … q{links}, each with _rad or _deg or neither (rad)");
    for (index, cell) in row.split(',').enumerate() {
        let name = cell.trim().trim_matches('"').trim();
        let place = format!("column {}", index + 1);
        if name.is_empty() {
            return Err(format!("{place} has no name, allowed: {allowed}"));
        }
        let (what, scale) = meaning(name).ok_or_else(|| {
            let known = std::iter::once("t_s".to_owned()).chain((1..=links).map(|link| format!("q{link}")));
            let known: Vec<String> = known.collect();
            let near = crate::quote::nearest(name, known.iter().map(String::as_str));
            let hint = near.map(|near| format!(", did you mean {near}?")).unwrap_or_default();
            format!("{place} is named \"{}\", allowed: {allowed}{hint}", quote::text(name))
        })?;
        if let What::Link(link) = what
            && link >= links
        {
            let of = if links == 1 {
                "q1: the chain has 1 link".to_owned()
            } else {
                format!("q1 … q{links}: the chain has {links} links")
            };
            return Err(format!("{place} is named \"{}\", allowed: {of}", quote::text(name)));
        }
        if let Some(first) = columns.iter().position(|column| column.what == what) {
            let before = &columns[first].name;
            return Err(format!("{place}, {name}, is the same as column {}, {before}, allowed: each once", first + 1));
        }
        columns.push(Column { name: name.to_owned(), what, scale });
    }
    let missing = in_order(links).into_iter().find(|wanted| columns.iter().all(|column| column.what != wanted.what));
    match missing {
        Some(column) if column.what == What::Time => Err(format!("no column is the time, allowed: {allowed}")),
        Some(column) => Err(format!("no column is {}, allowed: {allowed}", column.name)),
        None => Ok(columns),
    }
}

/// What a name stands for, and its unit as a factor and a divisor.
fn meaning(name: &str) -> Option<(What, (f64, f64))> {
    match name {
        "t_s" => return Some((What::Time, (1.0, 1.0))),
        "t_ms" => return Some((What::Time, (1.0, 1e3))),
        _ => {}
    }
    let (link, unit) = name.split_once('_').unwrap_or((name, "rad"));
    let digits = link.strip_prefix('q').filter(|digits| !digits.starts_with(['0', '+']))?;
    let link = digits.parse::<usize>().ok()?.checked_sub(1)?;
    let scale = match unit {
        "rad" => (1.0, 1.0),
        "deg" => (std::f64::consts::PI, 180.0),
        _ => return None,
    };
    Some((What::Link(link), scale))
}

/// A row's time (s) and angles (rad), or what is wrong with it.
fn parse_row<const N: usize>(row: &str, columns: &[Column]) -> Result<(f64, Vector<N>), String> {
    let names = || columns.iter().map(|column| column.name.as_str()).collect::<Vec<_>>().join(", ");
    if row.trim().is_empty() {
        return Err(format!("the line is empty, allowed: {}", names()));
    }
    let found = row.split(',').count();
    if found == N + 2 && row.trim_end().ends_with(',') {
        return Err(format!("the line ends with a ',', allowed: {} values ({})", N + 1, names()));
    }
    if found != N + 1 {
        return Err(format!("{found} columns, allowed: {} ({})", N + 1, names()));
    }
    let (mut t_s, mut q_rad) = (0.0, Vector::zeros());
    for (cell, column) in row.split(',').zip(columns) {
        let cell = cell.trim();
        let (factor, divisor) = column.scale;
        let value = cell.parse::<f64>().ok().map(|value| value * factor / divisor);
        let value = value.filter(|value| value.abs() <= VALUE_MAX);
        let value = value.ok_or_else(|| {
            format!("{} is \"{}\", allowed: a finite number, -1e12 to 1e12", column.name, quote::text(cell))
        })?;
        match column.what {
            What::Time => t_s = value,
            What::Link(link) => q_rad[link] = value,
        }
    }
    Ok((t_s, q_rad))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(text: &str) -> Vec<(f64, [f64; 3])> {
        let read = read::<3>(text).unwrap_or_else(|(line, problem)| panic!("line {line}: {problem}"));
        read.points.into_iter().map(|(t_s, q)| (t_s, q.into())).collect()
    }

    #[test]
    fn columns_are_what_they_are_called_in_any_order_and_unit() {
        let expected = [(0.0, [0.1, 0.2, 0.3]), (1.5, [0.4, 0.5, 0.6])];
        for text in [
            "t_s,q1,q2,q3\n0,0.1,0.2,0.3\n1.5,0.4,0.5,0.6\n",
            "t_s,q3,q2,q1\n0,0.3,0.2,0.1\n1.5,0.6,0.5,0.4\n",
            "q2_rad, t_ms ,q1,q3\n0.2,0,0.1,0.3\n0.5,1500,0.4,0.6",
            "\u{feff}\"t_s\",\"q1\",\"q2\",\"q3\"\r\n0,0.1,0.2,0.3\r\n1.5,0.4,0.5,0.6\r\n\r\n",
            "# recorded by hand\nt_s,q1,q2,q3\n# at rest\n0,0.1,0.2,0.3\n1.5,0.4,0.5,0.6\n",
            "0,0.1,0.2,0.3\n1.5,0.4,0.5,0.6",
        ] {
            assert!(points(text) == expected, "{text:?}");
        }
        let degrees = points("t_s,q1_deg,q2_deg,q3\n0,180,-90,0.5\n1,0,0,0\n");
        let expected = [std::f64::consts::PI, -std::f64::consts::FRAC_PI_2, 0.5];
        assert!(degrees[0].1.iter().zip(expected).all(|(found, right)| (found - right).abs() < 1e-15), "{degrees:?}");
        assert!(has_names("# a comment\nt_s,q1,q2,q3\n0,0,0,0") && !has_names("0,0,0,0\n1,0,0,0"));
    }

    #[test]
    fn a_name_that_is_no_column_is_refused_by_name() {
        let refused: &[(&str, &[&str])] = &[
            ("t_s,q1,q2,qq3", &["column 4", "\"qq3\"", "did you mean q3?"]),
            ("time,q1,q2,q3", &["column 1", "\"time\"", "t_s or t_ms"]),
            ("t_us,q1,q2,q3", &["column 1", "\"t_us\"", "t_s or t_ms"]),
            ("t_s,q1_grad,q2,q3", &["column 2", "\"q1_grad\"", "_deg"]),
            ("t_s,q1,q2,q4", &["column 4", "\"q4\"", "the chain has 3 links"]),
            ("t_s,q0,q1,q2", &["column 2", "\"q0\""]),
            ("t_s,q1,q2,q3,v1", &["column 5", "\"v1\""]),
            ("t_s,q1,q2,q1", &["column 4, q1", "column 2, q1", "each once"]),
            ("t_s,q1,q2,q2_deg", &["column 4, q2_deg", "column 3, q2"]),
            ("t_s,t_ms,q2,q3", &["column 2, t_ms", "column 1, t_s"]),
            ("t_s,q1,q2", &["no column is q3"]),
            ("q1,q2,q3", &["no column is the time"]),
            ("t_s,q1,,q3", &["column 3 has no name"]),
            ("t_s,q1,q2,q3,", &["column 5 has no name"]),
            ("t_s,1,2,3", &["column 2", "\"1\""]),
            ("t_s;q1;q2;q3", &["';'", "','"]),
            ("t_s\tq1\tq2\tq3", &["a tab", "','"]),
            ("0,5;1,5;2,5;3,5", &["';'", "','"]),
            ("0 1 2 3", &["blanks", "','"]),
            ("0|1|2|3", &["'|'", "','"]),
            ("t_s,q\u{1b}[2J,q2,q3", &["q\\u{1b}[2J"]),
        ];
        for (text, parts) in refused {
            let (line, problem) = read::<3>(&format!("{text}\n0,0,0,0\n1,0,0,0\n")).err().expect("it is refused");
            assert_eq!(line, 1, "{text}: {problem}");
            for part in *parts {
                assert!(problem.contains(part), "{text}: {problem:?} does not say {part:?}");
            }
        }
        let (line, problem) = read::<3>("t_s,q1,q2,q3\n0,0,0,0\n1,0,0,0,\n").err().expect("it is refused");
        assert!(line == 3 && problem.contains("ends with a ','"), "{problem}");
        let (line, problem) = read::<3>("t_s,q1,q2,q3_deg\n0,0,0,0\n1,0,0,x\n").err().expect("it is refused");
        assert!(line == 3 && problem.starts_with("q3_deg is \"x\""), "{problem}");
    }
}
