//! A picture of 8 bits as PNG.

use crate::base::{Error, Result};
use std::io::Write;

/// Writes grey (`channels` 1) or red, green, blue (3), row by row. `comment`: what the file says of itself.
///
/// # Errors
/// [`Error::Invalid`] where sizes do not fit, [`Error::Io`] from `out`.
pub fn write_png(
    out: &mut dyn Write,
    [cols, rows]: [usize; 2],
    channels: usize,
    samples: &[u8],
    comment: Option<&str>,
) -> Result<()> {
    let invalid = |reason: String| Error::invalid("picture", reason);
    let color = match channels {
        1 => png::ColorType::Grayscale,
        3 => png::ColorType::Rgb,
        n => return Err(invalid(format!("{n} channels; 1 or 3 are written"))),
    };
    let side = |n: usize| u32::try_from(n).map_err(|_| invalid(format!("{n} pixels along a side")));
    let mut encoder = png::Encoder::new(out, side(cols)?, side(rows)?);
    encoder.set_color(color);
    encoder.set_depth(png::BitDepth::Eight);
    let failed = |e| match e {
        png::EncodingError::IoError(e) => Error::io("PNG", e),
        e => invalid(e.to_string()),
    };
    if let Some(text) = comment {
        encoder.add_text_chunk("Comment".into(), text.into()).map_err(failed)?;
    }
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(samples).map_err(failed)?;
    writer.finish().map_err(failed)
}
