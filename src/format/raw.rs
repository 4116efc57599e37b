//! Samples that stand uncompressed in a file, at equal distances: HGT, Esri and ENVI grids.

use super::input::Input;
use super::voids::Voids;
use super::window;
use crate::base::{Error, Result, limits};
use crate::height::source::{HeightSource, Samples, SourceInfo, Window};

/// Where the samples of the band that is read stand.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    /// Byte of the first sample.
    pub at: u64,
    /// Bytes from one sample of a row to the next.
    pub sample_stride: u64,
    /// Bytes from one row to the next.
    pub row_stride: u64,
    pub big_endian: bool,
}

/// A grid read from its place in the file.
pub struct RawGrid {
    info: SourceInfo,
    input: Input,
    layout: Layout,
    voids: Voids,
}

impl RawGrid {
    /// Holds the layout against the file and the limits; reads no sample.
    ///
    /// # Errors
    /// [`Error::Limit`] for too many posts, [`Error::Corrupt`] if the file is too short for the layout.
    pub fn new(mut info: SourceInfo, input: Input, layout: Layout) -> Result<RawGrid> {
        window::check_size(&info.file, info.cols, info.rows)?;
        let width = info.sample_type.bytes() as u64;
        let span = |steps: u64, stride: u64| steps.checked_mul(stride);
        let row = span(info.cols - 1, layout.sample_stride).and_then(|n| n.checked_add(width));
        let end = span(info.rows - 1, layout.row_stride)
            .and_then(|n| n.checked_add(layout.at))
            .and_then(|n| n.checked_add(row?));
        let span_bytes = input.span_bytes();
        let (Some(row), Some(_)) = (row, end.filter(|end| *end <= span_bytes)) else {
            let wanted = end.map_or("more than can be counted".to_string(), |end| end.to_string());
            let reason = format!(
                "the file has {span_bytes} bytes, {} x {} {} samples need {wanted}",
                info.cols,
                info.rows,
                info.sample_type.name()
            );
            return Err(Error::corrupt(&info.file, "size", reason));
        };
        if row > limits::INPUT_BLOCK_BYTES_MAX {
            let what = format!("bytes of one row of {}", info.file);
            return Err(Error::limit(what, limits::INPUT_BLOCK_BYTES_MAX, row));
        }
        let voids = Voids::of(&mut info);
        Ok(RawGrid { info, input, layout, voids })
    }
}

impl HeightSource for RawGrid {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn set_nodata(&mut self, value: f64) {
        self.info.nodata = Some(value);
        self.voids = Voids::of(&mut self.info);
    }

    fn read(&mut self, w: Window) -> Result<Samples> {
        window::check(&self.info, w)?;
        if w.cols == 0 || w.rows == 0 {
            return Ok(Samples { cols: w.cols, rows: w.rows, ..Samples::default() });
        }
        let width = self.info.sample_type.bytes();
        let Layout { at, sample_stride, row_stride, big_endian } = self.layout;
        let row_bytes = w.cols * width;
        let mut data = vec![0; row_bytes * w.rows];
        let first = at + w.row * row_stride + w.col * sample_stride;
        let place = format!("rows {} to {}", w.row, w.row + w.rows as u64 - 1);
        if sample_stride == width as u64 && row_stride == row_bytes as u64 {
            // Whole rows follow one another: all at once.
            self.input.fill(first, &mut data, &place)?;
        } else {
            let mut run = vec![0; (w.cols - 1) * sample_stride as usize + width];
            for (row, out) in data.chunks_exact_mut(row_bytes).enumerate() {
                self.input.fill(first + row as u64 * row_stride, &mut run, &place)?;
                let samples = run.chunks(sample_stride as usize);
                for (out, sample) in out.chunks_exact_mut(width).zip(samples) {
                    out.copy_from_slice(&sample[..width]);
                }
            }
        }
        if big_endian && width > 1 {
            data.chunks_exact_mut(width).for_each(<[u8]>::reverse);
        }
        let valid = self.voids.valid(&data);
        Ok(Samples { cols: w.cols, rows: w.rows, data, valid })
    }
}
