//! Which samples are wanted.

use terraquilt_codecs::fractal::walk::{DEPTH_MAX, Walk};
use terraquilt_codecs::{Error, Result};

/// The most samples of one window: 2 GiB of values.
pub const SAMPLES_MAX: u64 = 1 << 28;

const PARTS: f64 = 4_294_967_296.0;

/// A grid of samples at equal distances, anywhere in a tile.
///
/// Lengths are in cells of the zoom-1 grid: zoom z has samples every 1/z. Each value is that at the centre of its sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Left edge of the first column.
    pub x0: f64,
    /// Upper edge of the first row.
    pub y0: f64,
    /// From sample to sample, in both directions.
    pub step: f64,
    /// Columns.
    pub cols: u32,
    /// Rows.
    pub rows: u32,
    /// Steps of the walk: at step 2^-k, k of them give the samples of the discrete decoder (zoom theorem).
    pub depth: u32,
}

impl Window {
    /// A whole tile of `size` (columns, rows) at a zoom; a last sample that would begin in the tile but not end there is left out.
    ///
    /// # Errors
    /// Invalid for a zoom below 1 or above 2 to the power of [`DEPTH_MAX`]; Limit for more than [`SAMPLES_MAX`] samples.
    pub fn whole(size: [usize; 2], zoom: f64) -> Result<Window> {
        if !(zoom >= 1.0 && zoom <= f64::from(1 << DEPTH_MAX)) {
            let reason = format!(
                "zoom {zoom}; from 1 to 2^{DEPTH_MAX} (below 1 samples are means: decode on the CPU)"
            );
            return Err(Error::invalid("window", reason));
        }
        let step = 1.0 / zoom;
        // A hundredth of a sample is rounding.
        let sides = size.map(|n| (n as f64 * zoom + 0.01).floor());
        let [cols, rows] = sides.map(|n| n as u32);
        let out = Window { x0: 0.0, y0: 0.0, step, cols, rows, depth: Walk::<2>::depth(1.0, step) };
        out.check(size)?;
        Ok(out)
    }

    /// Where the samples of a column lie, rounded to 2^-32 of a cell: value (c, r) is [`Walk::value`] at `[x(c), y(r)]`.
    pub fn x(&self, col: u32) -> f64 {
        centre(self.x0, self.step, col)
    }

    /// As [`x`](Window::x), for a row.
    pub fn y(&self, row: u32) -> f64 {
        centre(self.y0, self.step, row)
    }

    /// Samples.
    pub fn len(&self) -> usize {
        self.cols as usize * self.rows as usize
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The part at `col`, `row`, in the words of the shader: for each of `count` samples whole cells and 2^-32 parts.
    pub(crate) fn columns(&self, col: u32, count: u32) -> Vec<[u32; 2]> {
        (col..col + count).map(|c| words(self.x(c))).collect()
    }

    /// As [`columns`](Window::columns).
    pub(crate) fn lines(&self, row: u32, count: u32) -> Vec<[u32; 2]> {
        (row..row + count).map(|r| words(self.y(r))).collect()
    }

    /// Whether every sample lies in a tile of `size`, and the limits hold.
    pub(crate) fn check(&self, size: [usize; 2]) -> Result<()> {
        let samples = u64::from(self.cols) * u64::from(self.rows);
        if samples > SAMPLES_MAX {
            return Err(Error::Limit { what: "samples of a window", limit: SAMPLES_MAX, wanted: samples });
        }
        if self.depth > DEPTH_MAX {
            let (limit, wanted) = (u64::from(DEPTH_MAX), u64::from(self.depth));
            return Err(Error::Limit { what: "steps of the walk", limit, wanted });
        }
        let ends = [(self.x0, self.cols, size[0], "columns"), (self.y0, self.rows, size[1], "rows")];
        for (from, count, size, axis) in ends {
            let last = centre(from, self.step, count.saturating_sub(1));
            let inside = self.step > 0.0 && centre(from, self.step, 0) >= 0.0 && last < size as f64;
            if !inside {
                let reason = format!(
                    "{count} {axis} from {from} with step {}; they lie between 0 and {size}, the step is above 0",
                    self.step
                );
                return Err(Error::invalid("window", reason));
            }
        }
        Ok(())
    }
}

fn centre(from: f64, step: f64, k: u32) -> f64 {
    ((from + (f64::from(k) + 0.5) * step) * PARTS).round() / PARTS
}

/// Exact for what [`centre`] gives.
fn words(p: f64) -> [u32; 2] {
    [p.floor() as u32, ((p - p.floor()) * PARTS) as u32]
}
