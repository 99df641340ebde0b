//! Pictures of a run or a study: line charts and heat maps as SVG, and the same as PNG.
//!
//! Responsible for how a picture looks. Which numbers it shows is decided by whoever fills a [`Figure`]. A figure is a
//! column of panels with one legend beside them, never on top of the data.

mod axis;
mod png;
mod svg;
mod theme;

pub use axis::{Axis, Scale};
pub use png::{PngError, to_png};
pub use svg::to_svg;
pub use theme::Theme;

/// A picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figure {
    /// Above all panels; empty: none.
    pub title: String,
    /// From top to bottom.
    pub panels: Vec<Panel>,
    /// Width of the picture, px; 0: the default of 860.
    pub width_px: u32,
    /// Height of the data area of each panel, px; 0: the default of 200.
    pub panel_height_px: u32,
}

/// One pair of axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Above the data, such as "(a) first link"; empty: none.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// What is drawn.
    pub content: Content,
}

/// What a panel draws.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// Lines and marks.
    Lines(Vec<Series>),
    /// Coloured cells.
    Heat(HeatMap),
}

/// A line, or a set of marks. Series of the same name share one entry of the legend and one style.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// In the legend; empty: not listed.
    pub name: String,
    /// (x, y); a value that is not finite, or not positive on a logarithmic axis, breaks the line.
    pub points: Vec<(f64, f64)>,
    /// Which colour, counted on through the palette of eight.
    pub colour: usize,
    /// How it is drawn.
    pub style: Style,
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// A solid line.
    #[default]
    Line,
    /// A dashed line: predictions, bounds, references.
    Dashed,
    /// Marks alone: measurements.
    Marks,
    /// A line with its marks.
    MarkedLine,
}

/// Cells of equal size with a colour for each value.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatMap {
    /// Names of the columns, left to right; of one line or two.
    pub columns: Vec<String>,
    /// Names of the rows, top to bottom.
    pub rows: Vec<String>,
    /// Rows × columns; what is not finite is drawn grey.
    pub values: Vec<Vec<f64>>,
    /// What is written into each cell, rows × columns.
    pub labels: Vec<Vec<String>>,
    /// Whether colours follow the logarithm of the value.
    pub scale: Scale,
}

impl Series {
    /// A solid line.
    #[must_use]
    pub fn line(name: impl Into<String>, colour: usize, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), points, colour, style: Style::Line }
    }

    /// The same series drawn otherwise.
    #[must_use]
    pub fn styled(self, style: Style) -> Self {
        Self { style, ..self }
    }
}

impl Panel {
    /// A panel of lines.
    #[must_use]
    pub fn lines(title: impl Into<String>, x: Axis, y: Axis, series: Vec<Series>) -> Self {
        Self { title: title.into(), x, y, content: Content::Lines(series) }
    }

    /// A heat map.
    #[must_use]
    pub fn heat(title: impl Into<String>, map: HeatMap) -> Self {
        Self { title: title.into(), x: Axis::linear(""), y: Axis::linear(""), content: Content::Heat(map) }
    }
}

#[cfg(test)]
mod tests;
