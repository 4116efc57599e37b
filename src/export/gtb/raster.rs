//! The surface of a prefix as GeoTIFF, bit for bit where it is whole, and as a shaded picture.

use super::prefix::Prefix;
use crate::base::Result;
use crate::export::Going;
use crate::export::grid::{self, RasterTold, Samples, write_relief};
use std::io::{Seek, Write};

/// Writes heights, at the posts of the source: int16 or int32 if they are whole, else float32, or float64 where float32 would round
/// by more than an eighth of the unit.
///
/// # Errors
/// What writing meets.
pub fn write_tif(out: &mut (impl Write + Seek), p: &Prefix, going: Going) -> Result<RasterTold> {
    let samples = Samples {
        whole: p.reached.complete && p.is_whole(),
        single: p.reached.complete && p.reached.error_bound == 0.0,
        unit: p.header.place.unit,
        description: None,
    };
    grid::write_tif(out, &p.grid, &samples, going)
}

/// Draws a shaded relief, north up as far as rows and columns allow, in the colours of the picture if there is one.
///
/// # Errors
/// What writing meets.
pub fn write_picture(out: &mut dyn Write, p: &Prefix, going: Going) -> Result<RasterTold> {
    let Some(cells) = &p.picture else { return write_relief(out, &p.grid, None, None, going) };
    let side = 1usize << cells.n;
    let last = p.header.lattice.last();
    let of = |k: usize| {
        let cell = |post: usize| (post * side / last).min(side - 1);
        let at = cell(k / p.grid.cols) * side + cell(k % p.grid.cols);
        (!cells.void.get(at).copied().unwrap_or(false)).then(|| cells.rgb[at])
    };
    write_relief(out, &p.grid, Some(&of), None, going)
}
