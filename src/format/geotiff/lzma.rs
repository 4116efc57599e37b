//! Blocks compressed with LZMA (34925), which tiff-reader does not know: each one an `.xz` stream of one block.
//!
//! This file is the only door to `lzma-rust2`.

use super::blocks::{Blocks, tiff_error};
use crate::base::{Error, Result};
use crate::height::source::Window;
use lzma_rust2::XzReader;
use std::collections::VecDeque;
use std::io::Read;
use std::sync::Arc;
use tiff_reader::filters::fix_endianness_and_predict;
use tiff_reader::{RasterLayout, TiffFile};

/// What the decoder may hold besides the block: the largest dictionary of xz's presets and some more.
const DECODER_KIB_MAX: u32 = 80 << 10;
/// Bytes of decoded blocks kept for windows that do not follow the blocks.
const KEPT_BYTES: u64 = 64 << 20;

/// Decodes windows of the first image; keeps the blocks of the last.
#[derive(Default)]
pub struct LzmaBlocks {
    kept: VecDeque<(u64, Arc<Vec<u8>>)>,
}

impl LzmaBlocks {
    /// One band of a window as samples in the byte order of this machine; zeros where a block is not stored.
    ///
    /// # Errors
    /// [`Error::Corrupt`], naming the block, if it does not decode to its size.
    pub fn read_band(
        &mut self,
        file: &str,
        tiff: &TiffFile,
        layout: &RasterLayout,
        b: &Blocks,
        band: usize,
        w: Window,
    ) -> Result<Vec<u8>> {
        let width = b.sample_bytes;
        let mut data = vec![0; w.cols * w.rows * width];
        let (col_end, row_end) = (w.col + w.cols as u64, w.row + w.rows as u64);
        for down in w.row / b.block_rows..row_end.div_ceil(b.block_rows) {
            for right in w.col / b.block_cols..col_end.div_ceil(b.block_cols) {
                let index = down * b.across + right;
                let Some(block) = self.block(file, tiff, layout, b, index)? else { continue };
                let cols = (right * b.block_cols).max(w.col)..((right + 1) * b.block_cols).min(col_end);
                for row in (down * b.block_rows).max(w.row)..((down + 1) * b.block_rows).min(row_end) {
                    let first =
                        (row - down * b.block_rows) * b.block_cols + cols.start - right * b.block_cols;
                    let from = &block[first as usize * b.stride_bytes..];
                    let to = ((row - w.row) * w.cols as u64 + cols.start - w.col) as usize * width;
                    let n = (cols.end - cols.start) as usize;
                    let pixels = from.chunks_exact(b.stride_bytes).take(n);
                    for (out, pixel) in data[to..].chunks_exact_mut(width).zip(pixels) {
                        out.copy_from_slice(&pixel[band * width..][..width]);
                    }
                }
            }
        }
        Ok(data)
    }

    /// A decoded block, of full size; None if it is not stored.
    fn block(
        &mut self,
        file: &str,
        tiff: &TiffFile,
        layout: &RasterLayout,
        b: &Blocks,
        index: u64,
    ) -> Result<Option<Arc<Vec<u8>>>> {
        if let Some((_, kept)) = self.kept.iter().find(|k| k.0 == index) {
            return Ok(Some(kept.clone()));
        }
        let Some((offset, count)) = b.stored(index) else { return Ok(None) };
        let place = b.place(index as usize);
        // The file holds them: that was checked. They may still be many for nothing.
        if count > b.block_bytes.saturating_mul(2).saturating_add(1 << 16) {
            let reason = format!("{count} bytes stored for {} bytes of samples", b.block_bytes);
            return Err(Error::corrupt(file, place, reason));
        }
        let packed =
            tiff.source().read_exact_at(offset, count as usize).map_err(|e| tiff_error(file, &place, e))?;
        // The last strip may be stored shorter.
        let rows = if b.tiled { b.block_rows } else { b.block_rows.min(b.rows - index * b.block_rows) };
        let row_bytes = b.block_cols as usize * b.stride_bytes;
        let wanted = rows as usize * row_bytes;
        let mut block = Vec::new();
        let mut reader = XzReader::new_mem_limit(&packed[..], false, DECODER_KIB_MAX).take(b.block_bytes);
        reader.read_to_end(&mut block).map_err(|e| Error::corrupt(file, &place, format!("LZMA: {e}")))?;
        if block.len() < wanted {
            let reason = format!("it unpacks to {} bytes, {wanted} needed", block.len());
            return Err(Error::corrupt(file, place, reason));
        }
        block.truncate(wanted);
        let samples = (b.stride_bytes / b.sample_bytes) as u16;
        for row in block.chunks_exact_mut(row_bytes) {
            let bits = layout.bits_per_sample;
            fix_endianness_and_predict(row, bits, samples, tiff.byte_order(), layout.predictor)
                .map_err(|e| tiff_error(file, &place, e))?;
        }
        let block = Arc::new(block);
        let most = (KEPT_BYTES / b.block_bytes.max(1)).max(1) as usize;
        self.kept.truncate(most.min(1024) - 1);
        self.kept.push_front((index, block.clone()));
        Ok(Some(block))
    }
}
