//! The strips or tiles of one image, held against the file and the limits before any is decoded.
//!
//! After [`Blocks::check`]:
//! - sides, posts and the bytes of one decoded block are within `base::limits`;
//! - there is one offset for each block, and every stored block lies inside the file;
//! - the compression, predictor and sample layout are ones that decode to whole samples.

use crate::base::{Error, Result, limits};
use crate::format::window;
use crate::height::source::Window;
use tiff_reader::{Ifd, RasterLayout, TiffError};

const TAG_STRIP_OFFSETS: u16 = 273;
const TAG_STRIP_BYTE_COUNTS: u16 = 279;
const TAG_TILE_OFFSETS: u16 = 324;
const TAG_TILE_BYTE_COUNTS: u16 = 325;
const FILL_ORDER_LOW_BIT_FIRST: u16 = 2;
const PLANAR_SEPARATE: u16 = 2;
const COMPRESSION_NONE: u16 = 1;
const COMPRESSION_PACKBITS: u16 = 32773;
const COMPRESSION_LZMA: u16 = 34925;
const PREDICTOR_NONE: u16 = 1;
const PREDICTOR_FLOAT: u16 = 3;

/// Blocks up to this size are taken as they are, whatever the size of the grid.
const BLOCK_BYTES_USUAL: u128 = 64 << 20;

/// What is done about an encoding that is not read.
const REWRITE: &str = "rewrite it with: gdal_translate -co COMPRESS=DEFLATE INPUT OUTPUT.tif";

/// Where the blocks of band 1 lie.
pub struct Blocks {
    pub cols: u64,
    pub rows: u64,
    /// Columns and rows of one block; strips are as wide as the image.
    pub block_cols: u64,
    pub block_rows: u64,
    pub across: u64,
    pub tiled: bool,
    /// Bytes from one sample of band 1 to the next inside a block.
    pub stride_bytes: usize,
    pub sample_bytes: usize,
    /// Bytes of one decoded block.
    pub block_bytes: u64,
    /// Uncompressed and in plain order: rows can be taken from the file as they are.
    pub plain: bool,
    /// Compressed in the way that only `lzma` decodes.
    pub lzma: bool,
    /// Offset of each block; 0: the block is not stored.
    offsets: Vec<u64>,
    /// Bytes of each block, if they are needed to decode it here.
    counts: Vec<u64>,
    sparse: bool,
}

impl Blocks {
    /// Looks through the directory of an image; reads no block.
    pub fn check(file: &str, span_bytes: u64, ifd: &Ifd) -> Result<(Blocks, RasterLayout)> {
        let (cols, rows) = (u64::from(ifd.width()), u64::from(ifd.height()));
        window::check_size(file, cols, rows)?;
        check_encoding(file, ifd)?;
        let layout = ifd.raster_layout().map_err(|e| tiff_error(file, "image directory", e))?;

        let tiled = ifd.is_tiled();
        let (block_cols, block_rows) = if tiled {
            (u64::from(ifd.tile_width().unwrap_or(0)), u64::from(ifd.tile_height().unwrap_or(0)))
        } else {
            (cols, u64::from(ifd.rows_per_strip()).min(rows))
        };
        if block_cols == 0 || block_rows == 0 {
            let place = if tiled { "tile size" } else { "rows per strip" };
            return Err(Error::corrupt(file, place, format!("{block_cols} x {block_rows}")));
        }
        let separate = layout.planar_configuration == PLANAR_SEPARATE;
        let samples = if separate { 1 } else { layout.samples_per_pixel };
        let stride_bytes = samples * layout.bytes_per_sample;
        // u32 * u32 * (u16 * 8) does not fit in u64.
        let block_bytes = u128::from(block_cols) * u128::from(block_rows) * stride_bytes as u128;
        if block_bytes > u128::from(limits::INPUT_BLOCK_BYTES_MAX) {
            let what = format!("bytes of one {} of {file}", if tiled { "tile" } else { "strip" });
            let wanted = u64::try_from(block_bytes).unwrap_or(u64::MAX);
            return Err(Error::limit(what, limits::INPUT_BLOCK_BYTES_MAX, wanted));
        }
        // A block far larger than the grid costs memory for nothing; no writer makes one.
        let block_posts = block_cols.saturating_mul(block_rows);
        if block_bytes > BLOCK_BYTES_USUAL && block_posts / 4 > cols * rows {
            let reason = format!("{block_cols} x {block_rows} posts, but the grid has {cols} x {rows}");
            return Err(Error::corrupt(file, "tile size", reason));
        }
        let mut blocks = Blocks {
            cols,
            rows,
            block_cols,
            block_rows,
            across: cols.div_ceil(block_cols),
            tiled,
            stride_bytes,
            sample_bytes: layout.bytes_per_sample,
            block_bytes: block_bytes as u64,
            plain: ifd.compression() == COMPRESSION_NONE
                && ifd.fill_order() != FILL_ORDER_LOW_BIT_FIRST
                && layout.bits_per_sample.is_multiple_of(8),
            lzma: ifd.compression() == COMPRESSION_LZMA,
            offsets: Vec::new(),
            counts: Vec::new(),
            sparse: false,
        };
        let planes = if separate { layout.samples_per_pixel as u64 } else { 1 };
        blocks.check_table(file, span_bytes, ifd, planes)?;
        Ok((blocks, layout))
    }

    fn check_table(&mut self, file: &str, span_bytes: u64, ifd: &Ifd, planes: u64) -> Result<()> {
        let (what, offsets_tag, counts_tag) = if self.tiled {
            ("tile", TAG_TILE_OFFSETS, TAG_TILE_BYTE_COUNTS)
        } else {
            ("strip", TAG_STRIP_OFFSETS, TAG_STRIP_BYTE_COUNTS)
        };
        let table = |tag| ifd.tag(tag).and_then(|t| t.value.as_u64_vec()).unwrap_or_default();
        let (mut offsets, mut counts) = (table(offsets_tag), table(counts_tag));
        let per_plane = self.across * self.rows.div_ceil(self.block_rows);
        let expected = per_plane.saturating_mul(planes);
        for (found, name) in [(offsets.len() as u64, "offsets"), (counts.len() as u64, "byte counts")] {
            if found != expected {
                let reason = format!(
                    "{found} {what} {name}, {expected} needed for {} x {} posts",
                    self.cols, self.rows
                );
                return Err(Error::corrupt(file, format!("table of {what}s"), reason));
            }
        }
        // Band 1 comes first, in both planar layouts.
        offsets.truncate(per_plane as usize);
        for (i, (offset, count)) in offsets.iter_mut().zip(counts.iter().copied()).enumerate() {
            if *offset == 0 || count == 0 {
                *offset = 0;
                self.sparse = true;
                continue;
            }
            let mut needed = count;
            if self.plain && !self.tiled {
                let row = i as u64 * self.block_rows;
                let rows = self.block_rows.min(self.rows - row);
                needed = rows * self.cols * self.stride_bytes as u64;
                if count < needed {
                    let reason = format!("{count} bytes stored, {needed} needed for {rows} rows");
                    return Err(Error::corrupt(file, format!("{what} {i}"), reason));
                }
            }
            let end = offset.checked_add(needed);
            if end.is_none_or(|end| end > span_bytes) {
                let reason = format!("{needed} bytes from byte {offset}, but the file has {span_bytes}");
                return Err(Error::corrupt(file, format!("{what} {i}"), reason));
            }
        }
        self.offsets = offsets;
        if self.lzma {
            counts.truncate(per_plane as usize);
            self.counts = counts;
        }
        Ok(())
    }

    /// Offset of the strip or tile with this index; None if it is not stored.
    pub fn offset(&self, index: u64) -> Option<u64> {
        self.offsets.get(index as usize).copied().filter(|at| *at != 0)
    }

    /// Offset and bytes of the block with this index, for blocks that are decoded here; None if it is not stored.
    pub fn stored(&self, index: u64) -> Option<(u64, u64)> {
        Some((self.offset(index)?, *self.counts.get(index as usize)?))
    }

    /// Calls `each(row, first, end)` for the runs of posts of `w` that lie in blocks which are not stored;
    /// rows and columns are counted from the window's first post.
    pub fn each_missing(&self, w: Window, mut each: impl FnMut(usize, usize, usize)) {
        if !self.sparse {
            return;
        }
        let col_end = w.col + w.cols as u64;
        for row in w.row..w.row + w.rows as u64 {
            let first = row / self.block_rows * self.across;
            for block in w.col / self.block_cols..col_end.div_ceil(self.block_cols) {
                if self.offset(first + block).is_none() {
                    let from = (block * self.block_cols).max(w.col) - w.col;
                    let to = ((block + 1) * self.block_cols).min(col_end) - w.col;
                    each((row - w.row) as usize, from as usize, to as usize);
                }
            }
        }
    }

    /// Names a block for messages: its number and the posts it covers.
    pub fn place(&self, index: usize) -> String {
        let index = index as u64;
        let first_row = index / self.across * self.block_rows;
        let last_row = (first_row + self.block_rows).min(self.rows).saturating_sub(1);
        if self.tiled {
            let first_col = index % self.across * self.block_cols;
            let last_col = (first_col + self.block_cols).min(self.cols) - 1;
            format!("tile {index} (columns {first_col} to {last_col}, rows {first_row} to {last_row})")
        } else {
            format!("strip {index} (rows {first_row} to {last_row})")
        }
    }
}

fn check_encoding(file: &str, ifd: &Ifd) -> Result<()> {
    let unsupported = |what: String| Err(Error::unsupported(file, what, REWRITE));
    let compression = ifd.compression();
    match compression {
        COMPRESSION_NONE | 5 | 8 | 32946 | COMPRESSION_PACKBITS | 34887 | COMPRESSION_LZMA | 50000 => {}
        _ => {
            let name = match compression {
                2..=4 => "fax",
                6 | 7 => "JPEG",
                34712 | 33003 | 33005 => "JPEG 2000",
                50001 => "WebP",
                50002 | 52546 => "JPEG XL",
                _ => "unknown",
            };
            return unsupported(format!("compression {compression} ({name}) is not read"));
        }
    }
    match ifd.photometric_interpretation().unwrap_or(1) {
        // White is zero, black is zero, RGB, palette, mask.
        0..=4 => {}
        other => return unsupported(format!("colour model {other} is not one of heights")),
    }
    let predictor = ifd.predictor();
    let predicts = !matches!(compression, COMPRESSION_NONE | COMPRESSION_PACKBITS | 34887);
    if predictor != PREDICTOR_NONE && !predicts {
        // libtiff ignores the tag there, tiff-reader does not: refuse rather than guess.
        return unsupported(format!("predictor {predictor} with compression {compression} is not read"));
    }
    if compression == COMPRESSION_LZMA {
        let bits = ifd.bits_per_sample().ok().and_then(|b| b.first().copied()).unwrap_or(1);
        if !bits.is_multiple_of(8) || ifd.fill_order() == FILL_ORDER_LOW_BIT_FIRST {
            return unsupported(format!("{bits}-bit samples or turned bits with LZMA are not read"));
        }
    }
    let is_float = ifd.sample_format().is_ok_and(|f| f.first() == Some(&3));
    if predictor == PREDICTOR_FLOAT && !is_float {
        return unsupported("the floating-point predictor on integer samples is not read".to_string());
    }
    Ok(())
}

/// Turns an error of tiff-reader into ours; `place` is where it happened.
pub fn tiff_error(file: &str, place: &str, e: TiffError) -> Error {
    match e {
        TiffError::Io(source, _) => Error::io(file, source),
        TiffError::DecodeOutputTooLarge { requested, limit } => {
            Error::limit(format!("decoded bytes of {file}, {place}"), limit as u64, requested as u64)
        }
        TiffError::UnsupportedCompression(_)
        | TiffError::UnsupportedPredictor(_)
        | TiffError::UnsupportedPlanarConfiguration(_)
        | TiffError::UnsupportedBitsPerSample(_)
        | TiffError::UnsupportedSampleFormat(_) => Error::unsupported(file, e, REWRITE),
        TiffError::DecompressionFailed { reason, .. } => Error::corrupt(file, place, reason),
        other => Error::corrupt(file, place, other),
    }
}
