//! `load.html`: the study as one page that needs no network and no script.

use loopbound_monitor::chart::{Theme, to_svg};
use loopbound_scenario::format_rate;

use super::Report;
use super::advice::ForLoad;
use super::pictures::maps;
use super::text::{SETTING_HEADINGS, cells, headings, setting_cells};

/// The page.
#[must_use]
pub fn page(report: &Report) -> String {
    let paragraphs = |lines: &[String]| lines.iter().map(|line| format!("<p>{}</p>", prose(line))).collect::<String>();
    let mut choice = vec![report.advice.words.clone()];
    choice.extend(report.check.iter().map(|check| check.words.clone()));
    let rates = report.advice.rates.iter();
    let rates = rates.map(|rate| line("td", &[format_rate(rate.rate_hz), rate.words.clone()])).collect::<String>();
    let only = |only: &ForLoad| line("td", &[format!("load {} alone", only.load.name()), only.words.clone()]);
    let loads = report.for_each_load.iter().map(only).collect::<String>();
    let settings = report.advice.settings.iter().map(|setting| line("td", &setting_cells(report, setting)));
    let settings = line("th", &SETTING_HEADINGS.map(str::to_owned)) + &settings.collect::<String>();
    let cases = report.rows.iter().map(|row| line("td", &cells(row))).collect::<String>();
    include_str!("page.html")
        .replace("{{head}}", &paragraphs(&report.head()))
        .replace("{{choice}}", &paragraphs(&choice))
        .replace("{{rates}}", &rates)
        .replace("{{loads}}", &loads)
        .replace("{{rules}}", &prose(&report.rules()))
        .replace("{{settings}}", &settings)
        .replace("{{maps}}", &to_svg(&maps(report), Theme::Auto))
        .replace("{{cases}}", &(line("th", &headings(report)) + &cases))
}

fn line(cell: &str, texts: &[String]) -> String {
    let cells = texts.iter().map(|text| format!("<{cell}>{}</{cell}>", prose(text))).collect::<String>();
    format!("<tr>{cells}</tr>\n")
}

/// Text as HTML may hold it, with what stands between back quotes as code.
fn prose(text: &str) -> String {
    let safe = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;");
    let mut parts = safe.split('`');
    let mut html = parts.next().unwrap_or_default().to_owned();
    for (at, part) in parts.enumerate() {
        html.push_str(if at % 2 == 0 { "<code>" } else { "</code>" });
        html.push_str(part);
    }
    html
}
