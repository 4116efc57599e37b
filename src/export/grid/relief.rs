//! A grid as a shaded picture.

use super::{Grid, RasterTold};
use crate::base::Result;
use crate::db::metres_per_unit;
use crate::export::{Going, go_on};
use crate::format::relief::{Relief, write_painted_relief};
use crate::height::crs::AxisUnit;
use std::io::Write;

/// Draws a shaded relief, north up as far as rows and columns allow. `paint`: the colour of a post, where it has one of its own. `comment`:
/// what the file says of itself.
///
/// # Errors
/// What writing meets.
pub fn write_relief(
    out: &mut dyn Write,
    grid: &Grid,
    paint: Option<&dyn Fn(usize) -> Option<[u8; 3]>>,
    comment: Option<&str>,
    going: Going,
) -> Result<RasterTold> {
    go_on(going, "picture", 0.0)?;
    let (cols, rows) = (grid.cols, grid.rows);
    let (flip, mirror) = grid.affine.map_or((false, false), |a| (a.row_step[1] > 0.0, a.col_step[0] < 0.0));
    let source = |k: usize| {
        let (row, col) = (k / cols, k % cols);
        let row = if flip { rows - 1 - row } else { row };
        row * cols + if mirror { cols - 1 - col } else { col }
    };
    let unit_m = grid.vertical_unit_m.unwrap_or(1.0);
    let z: Vec<f32> = (0..cols * rows).map(|k| (grid.z[source(k)] * unit_m) as f32).collect();
    let paint = paint.map(|of| (0..cols * rows).map(|k| of(source(k))).collect::<Vec<Option<[u8; 3]>>>());
    let cell_m = match grid.affine {
        None => [1.0; 2],
        Some(a) => {
            let at = [0, 1]
                .map(|k| a.origin[k] + (cols / 2) as f64 * a.col_step[k] + (rows / 2) as f64 * a.row_step[k]);
            let unit = grid.crs.as_ref().map_or(AxisUnit::Metre(1.0), |c| c.unit);
            let m = metres_per_unit(unit, at);
            let length = |s: [f64; 2]| (s[0] * m[0]).hypot(s[1] * m[1]);
            [length(a.col_step), length(a.row_step)]
        }
    };
    let relief = Relief { cols, rows, z: &z, cell_m, class: None, class_range: None };
    write_painted_relief(out, &relief, paint.as_deref(), comment)?;
    Ok(RasterTold { cols: cols as u64, rows: rows as u64, samples: "picture", rounding: 0.0 })
}
