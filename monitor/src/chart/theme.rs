//! Colours and fonts. Everything is drawn by class, so that a theme is one block of style.

use std::fmt::Write as _;

use super::Scale;

/// Which colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Theme {
    /// Dark on white, for paper.
    #[default]
    Light,
    /// Light on black.
    Dark,
    /// As the reader's browser prefers; a page around may set the variables `--lb-ink`, `--lb-paper`, … itself.
    Auto,
}

/// Of Okabe and Ito: told apart by colour-blind readers, and dark enough for thin lines on white.
const SERIES_LIGHT: [&str; 8] =
    ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#7a52b3", "#4d4d4d"];
const SERIES_DARK: [&str; 8] = ["#4aa8e0", "#ff8c42", "#2ecf9f", "#e8a0c8", "#e6c04a", "#8fd0ff", "#b59ae6", "#b0b0b0"];
const LIGHT: [(&str, &str); 4] = [("ink", "#1f2328"), ("soft", "#57606a"), ("grid", "#dfe3e8"), ("paper", "#ffffff")];
const DARK: [(&str, &str); 4] = [("ink", "#e6edf3"), ("soft", "#9da7b3"), ("grid", "#30363d"), ("paper", "#0d1117")];

/// What a browser falls back on when the first is missing; PNG has the first.
pub(super) const FONTS: &str = "'DejaVu Sans','Helvetica Neue',Arial,sans-serif";

/// How many colours there are before they repeat.
pub(super) const COLOURS: usize = SERIES_LIGHT.len();

/// The style block of a picture.
pub(super) fn style(theme: Theme) -> String {
    let mut css = String::new();
    let named = |set: [(&'static str, &'static str); 4], series: [&'static str; 8]| {
        let series = series.into_iter().enumerate().map(|(at, colour)| (format!("s{at}"), colour));
        set.into_iter().map(|(name, colour)| (name.to_owned(), colour)).chain(series).collect::<Vec<_>>()
    };
    let (light, dark) = (named(LIGHT, SERIES_LIGHT), named(DARK, SERIES_DARK));
    if theme == Theme::Auto {
        let variables = |colours: &[(String, &str)]| {
            colours.iter().fold(String::new(), |all, (name, colour)| format!("{all}--lb-{name}:{colour};"))
        };
        let _ = writeln!(css, ":root{{{}}}", variables(&light));
        let _ = writeln!(css, "@media (prefers-color-scheme:dark){{:root{{{}}}}}", variables(&dark));
    }
    let colours = if theme == Theme::Dark { dark } else { light };
    for (name, colour) in colours {
        let value = if theme == Theme::Auto { format!("var(--lb-{name})") } else { colour.to_owned() };
        match name.as_str() {
            "ink" => _ = writeln!(css, ".lb-t{{fill:{value}}} .lb-axis{{stroke:{value};fill:none}}"),
            "soft" => _ = writeln!(css, ".lb-l{{fill:{value}}}"),
            "grid" => _ = writeln!(css, ".lb-g{{stroke:{value};fill:none}} .lb-none{{fill:{value}}}"),
            "paper" => _ = writeln!(css, ".lb-p{{fill:{value}}} .lb-halo{{stroke:{value}}}"),
            series => _ = writeln!(css, ".lb-{series}{{stroke:{value};fill:none}} .lb-m{series}{{fill:{value}}}"),
        }
    }
    css
}

/// The colour of a share between 0 and 1, and whether writing on it must be light: from pale to dark blue.
pub(super) fn heat(share: f64) -> (String, bool) {
    const STOPS: [[f64; 3]; 5] =
        [[247.0, 251.0, 255.0], [198.0, 219.0, 239.0], [107.0, 174.0, 214.0], [33.0, 113.0, 181.0], [8.0, 48.0, 107.0]];
    let place = share.clamp(0.0, 1.0) * 4.0;
    let at = if place >= 3.0 { 3 } else { usize::from(place >= 1.0) + usize::from(place >= 2.0) };
    let part = place - at as f64;
    let mix = |i: usize| STOPS[at][i] + (STOPS[at + 1][i] - STOPS[at][i]) * part;
    (format!("rgb({:.0},{:.0},{:.0})", mix(0), mix(1), mix(2)), share > 0.55)
}

/// The measure in which a heat map compares values.
pub(super) fn measure(scale: Scale, value: f64) -> Option<f64> {
    let measured = match scale {
        Scale::Linear => value,
        Scale::Log => libm::log10(value),
    };
    measured.is_finite().then_some(measured)
}
