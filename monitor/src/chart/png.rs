//! PNG, from the same SVG, with a font of our own: a machine without fonts writes the same picture.

use std::sync::Arc;

use resvg::{tiny_skia, usvg};
use thiserror::Error;

use super::{Figure, Theme, to_svg};

/// Why there is no PNG.
#[derive(Debug, Error)]
pub enum PngError {
    /// Our own SVG was refused: a text that is no XML, or a size that is none.
    #[error("the picture can't be read back: {0}")]
    Svg(#[from] usvg::Error),
    /// A picture of that size doesn't fit.
    #[error("a picture of {width} × {height} px can't be made")]
    Size {
        /// px.
        width: u32,
        /// px.
        height: u32,
    },
    /// The encoder failed.
    #[error("encoding failed: {0}")]
    Encode(String),
}

/// The figure as PNG at `scale` pixels a px, in the light theme.
///
/// # Errors
/// If the figure has no size.
pub fn to_png(figure: &Figure, scale: f32) -> Result<Vec<u8>, PngError> {
    let mut fonts = usvg::fontdb::Database::new();
    fonts.load_font_data(dejavu::sans::regular().to_vec());
    fonts.load_font_data(dejavu::sans::bold().to_vec());
    fonts.set_sans_serif_family("DejaVu Sans");
    let options =
        usvg::Options { fontdb: Arc::new(fonts), font_family: "DejaVu Sans".to_owned(), ..usvg::Options::default() };
    let tree = usvg::Tree::from_str(&to_svg(figure, Theme::Light), &options)?;
    let size = tree.size().to_int_size().scale_by(scale);
    let (width, height) = size.map_or((0, 0), |size| (size.width(), size.height()));
    let mut pixels = tiny_skia::Pixmap::new(width, height).ok_or(PngError::Size { width, height })?;
    resvg::render(&tree, tiny_skia::Transform::from_scale(scale, scale), &mut pixels.as_mut());
    pixels.encode_png().map_err(|e| PngError::Encode(e.to_string()))
}
