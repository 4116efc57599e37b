//! A GeoTIFF as a source of heights: band 1 of the first image.
//!
//! Rows of uncompressed strips are read straight from the file, so that one strip may be the whole image;
//! everything else is decoded block by block by `tiff-reader`, whose cache holds one row of blocks, so
//! that windows going down the file decode each block once.

use super::blocks::{Blocks, tiff_error};
use super::georef::{self, GeoKeys};
use super::lzma::LzmaBlocks;
use super::metadata::{parse_band_metadata, parse_nodata, shorten};
use super::stored::Stored;
use crate::base::{Error, Result, limits};
use crate::format::input::Input;
use crate::format::sidecar;
use crate::format::voids::Voids;
use crate::format::window;
use crate::height::source::{HeightSource, SampleType, Samples, SourceInfo, Window};
use std::sync::Arc;
use tiff_reader::source::{SharedSource, TiffSource};
use tiff_reader::{ByteOrder, Ifd, OpenOptions, ParseBudgets, RasterLayout, TiffError, TiffFile};

const TAG_SUBFILE_TYPE: u16 = 254;
const TAG_EXTRA_SAMPLES: u16 = 338;
const TAG_GDAL_METADATA: u16 = 42112;
const TAG_GDAL_NODATA: u16 = 42113;
const SUBFILE_OVERVIEW: u32 = 1;
const SUBFILE_MASK: u32 = 4;
const EXTRA_ALPHA: [u16; 2] = [1, 2];

/// The shorter of the two headers.
const HEADER_BYTES: u64 = 8;
/// Images in one file (overviews, masks, pages).
const IMAGES_MAX: usize = 1000;
/// Tags of one image.
const IMAGE_TAGS_MAX: usize = 4096;
/// Bytes of all tags of a file: tables of 16 million blocks and some more.
const TAG_BYTES_MAX: usize = 256 << 20;
/// Rows worth reading together, where blocks are flatter.
const ROW_BATCH_MIN: u64 = 64;
/// Posts of one batch of rows, where blocks are taller.
const ROW_BATCH_POSTS: u64 = 16 << 20;
/// Bytes of decoded blocks kept for windows that do not follow the batches.
const CACHE_BYTES: u64 = 64 << 20;
/// Blocks kept.
const CACHE_SLOTS: usize = 256;
/// Bytes read at once from uncompressed strips.
const PLAIN_READ_BYTES: u64 = 8 << 20;

/// What marks posts as void besides nodata.
enum Mask {
    None,
    /// Image number in the file: zero is void.
    Image(usize),
    /// Band of the first image: zero is void.
    Alpha(usize),
}

/// Band 1 of the first image of a GeoTIFF.
pub struct GeoTiff {
    info: SourceInfo,
    tiff: TiffFile,
    blocks: Blocks,
    layout: RasterLayout,
    lzma: LzmaBlocks,
    stored: Stored,
    mask: Mask,
    voids: Voids,
    /// Sample in place of blocks that are not stored, and whether it is a void.
    missing: (Vec<u8>, bool),
}

impl GeoTiff {
    /// Opens a file and reads its tags; no sample is read.
    ///
    /// # Errors
    /// As [`crate::format::open`].
    pub fn open(input: Input) -> Result<GeoTiff> {
        let mut tiff = GeoTiff::begin(input)?;
        let notes = tiff.band_notes()?;
        tiff.info.notes.splice(0..0, notes);
        Ok(tiff)
    }

    /// What is to be known of a file with more in it than one band of heights.
    fn band_notes(&self) -> Result<Vec<String>> {
        let ifd = self.tiff.ifd(0).map_err(|e| tiff_error(&self.info.file, "header", e))?;
        let mut notes = Vec::new();
        if self.layout.samples_per_pixel > 1 {
            notes.push(format!("the file has {} bands; the first is read", self.layout.samples_per_pixel));
        }
        if ifd.photometric_interpretation() == Some(2) {
            notes.push("the file is a colour picture (RGB); its red band is read as heights".to_string());
        }
        if ifd.photometric_interpretation() == Some(3) {
            notes.push("the file has a colour palette; its numbers are read as heights".to_string());
        }
        Ok(notes)
    }

    /// Opens a file whose first three bands are red, green and blue, 8 bits each; of one band, all three are that.
    ///
    /// # Errors
    /// As [`GeoTiff::open`]; [`Error::Unsupported`] for samples of other widths, palettes and bands that lie in planes of their own.
    pub fn open_colours(input: Input) -> Result<GeoTiff> {
        let tiff = GeoTiff::begin(input)?;
        let file = &tiff.info.file;
        let ifd = tiff.tiff.ifd(0).map_err(|e| tiff_error(file, "header", e))?;
        let bands = tiff.layout.samples_per_pixel;
        let unsupported = |what: String, how: &str| {
            Err(Error::unsupported(
                file,
                what,
                format!("write it anew: gdal_translate {how} INPUT OUTPUT.tif"),
            ))
        };
        if tiff.stored != Stored::Same(SampleType::U8) || tiff.layout.bits_per_sample != 8 {
            let what = format!("samples of {} bits are no colours; 8 are read", tiff.layout.bits_per_sample);
            return unsupported(what, "-ot Byte -scale");
        }
        if ifd.photometric_interpretation() == Some(3) {
            return unsupported("a picture with a palette is not read".into(), "-expand rgb");
        }
        if bands == 2 {
            return unsupported("a picture of 2 bands; 1, 3 or more are read".into(), "-b 1 -b 1 -b 1");
        }
        if bands > 1 && tiff.layout.planar_configuration != 1 {
            return unsupported(
                "bands that lie in planes of their own are not read".into(),
                "-co INTERLEAVE=PIXEL",
            );
        }
        Ok(tiff)
    }

    /// Red, green and blue of a window, and which pixels are void: by mask or alpha, or if every band is the nodata value.
    ///
    /// # Errors
    /// As [`HeightSource::read`].
    pub fn read_colours(&mut self, w: Window) -> Result<(Vec<[u8; 3]>, Vec<bool>)> {
        window::check(&self.info, w)?;
        let mut rgb = vec![[0; 3]; w.cols * w.rows];
        if rgb.is_empty() {
            return Ok((rgb, Vec::new()));
        }
        let bands = if self.layout.samples_per_pixel >= 3 { 3 } else { 1 };
        for band in 0..bands {
            let data = self.read_band(band, w)?;
            rgb.iter_mut().zip(data).for_each(|(pixel, v)| pixel[band] = v);
        }
        if bands == 1 {
            rgb.iter_mut().for_each(|pixel| *pixel = [pixel[0]; 3]);
        }
        let nodata = self.voids.nodata_bytes().map(|b| b[0]);
        let mut valid: Vec<u8> = rgb.iter().map(|p| u8::from(nodata.is_none_or(|n| *p != [n; 3]))).collect();
        self.blocks.each_missing(w, |row, from, to| {
            valid[row * w.cols + from..row * w.cols + to].fill(u8::from(nodata.is_none()));
        });
        self.mask(w, &mut valid)?;
        Ok((rgb, valid.iter().map(|v| *v == 0).collect()))
    }

    fn begin(input: Input) -> Result<GeoTiff> {
        let file = input.file.clone();
        let input = Arc::new(input);
        let span_bytes = input.span_bytes();
        let (tiff, blocks, layout) = open_tiff(&file, input.clone())?;
        let ifd = tiff.ifd(0).map_err(|e| tiff_error(&file, "header", e))?;
        let stored = Stored::of(&file, ifd)?;
        let sample_type = stored.sample_type();

        let mut notes = Vec::new();
        let pages =
            tiff.ifds().iter().skip(1).filter(|i| subfile(i) & (SUBFILE_OVERVIEW | SUBFILE_MASK) == 0);
        let pages = pages.count();
        if pages > 0 {
            notes.push(format!("the file has {} images; the first is read", pages + 1));
        }
        let keys = GeoKeys::read(ifd);
        let affine = georef::affine(ifd, &keys, &mut notes);
        let crs = georef::crs(&keys, &mut notes);
        let text = |tag| ifd.tag(tag).and_then(|t| t.value.as_str());
        let band = parse_band_metadata(text(TAG_GDAL_METADATA).unwrap_or(""), &mut notes);
        let vertical = georef::vertical(&keys, band.unit.as_deref(), &file)?;
        notes.extend(georef::height_unit_note(&keys, band.unit.as_deref()));
        let nodata = match text(TAG_GDAL_NODATA) {
            None => None,
            Some(text) => parse_nodata(text).or_else(|| {
                notes.push(format!("the file's nodata value '{}' is not a number; ignored", shorten(text)));
                None
            }),
        };
        let mask = find_mask(&file, span_bytes, &tiff, &mut notes)?;
        let mut info = SourceInfo {
            file,
            format: "GeoTIFF",
            cols: blocks.cols,
            rows: blocks.rows,
            sample_type,
            affine,
            crs,
            nodata,
            scale: band.scale,
            offset: band.offset,
            vertical_datum: vertical.datum,
            vertical_unit_m: vertical.unit_m,
            accuracy_m: None,
            product: None,
            notes,
        };
        let voids = Voids::of(&mut info);
        let missing = match voids.nodata_bytes() {
            Some(bytes) => (bytes, true),
            None => (vec![0; sample_type.bytes()], false),
        };
        if matches!(mask, Mask::None)
            && let Some(mask) = input.beside.find(&[format!("{}.msk", base_name(&info.file))])?
        {
            info.notes.push(format!("the mask {} beside the file is not read", mask.file));
        }
        sidecar::complete(&mut info, &input, &["tfw", "tifw", "wld"])?;
        let lzma = LzmaBlocks::default();
        Ok(GeoTiff { info, tiff, blocks, layout, lzma, stored, mask, voids, missing })
    }

    /// Marks the posts of a window that the mask or the alpha band leaves out.
    fn mask(&mut self, w: Window, valid: &mut [u8]) -> Result<()> {
        let (mask, width) = match self.mask {
            Mask::None => return Ok(()),
            Mask::Image(image) => (self.decode(image, 0, w)?, 1),
            Mask::Alpha(band) => (self.read_band(band, w)?, self.stored.bytes()),
        };
        for (valid, mask) in valid.iter_mut().zip(mask.chunks_exact(width)) {
            if mask.iter().all(|b| *b == 0) {
                *valid = 0;
            }
        }
        Ok(())
    }

    /// Reads one band of one image as little-endian samples.
    fn decode(&self, image: usize, band: usize, w: Window) -> Result<Vec<u8>> {
        let place = |index: usize| match image {
            0 => self.blocks.place(index),
            _ => format!("block {index} of the mask"),
        };
        let ifd = self.tiff.ifd(image).map_err(|e| tiff_error(&self.info.file, "header", e))?;
        let (row, col) = (w.row as usize, w.col as usize);
        let mut data =
            self.tiff.read_band_window_bytes_from_ifd(ifd, band, row, col, w.rows, w.cols).map_err(|e| {
                let place = match &e {
                    TiffError::DecompressionFailed { index, .. } => place(*index),
                    _ => format!("rows {row} to {}", row + w.rows - 1),
                };
                tiff_error(&self.info.file, &place, e)
            })?;
        if cfg!(target_endian = "big") && image == 0 {
            reverse_samples(&mut data, self.stored.bytes());
        }
        Ok(data)
    }

    /// Reads one band of the first image as little-endian stored samples, the cheapest way.
    fn read_band(&mut self, band: usize, w: Window) -> Result<Vec<u8>> {
        if reads_plain(&self.blocks) {
            return self.read_plain(band, w);
        }
        if !self.blocks.lzma {
            return self.decode(0, band, w);
        }
        let mut data =
            self.lzma.read_band(&self.info.file, &self.tiff, &self.layout, &self.blocks, band, w)?;
        if cfg!(target_endian = "big") {
            reverse_samples(&mut data, self.stored.bytes());
        }
        Ok(data)
    }

    /// Takes one band of the rows of uncompressed strips from the file as they are.
    fn read_plain(&self, band: usize, w: Window) -> Result<Vec<u8>> {
        let b = &self.blocks;
        let (stride, width) = (b.stride_bytes as u64, b.sample_bytes);
        let row_bytes = b.cols * stride;
        let whole_rows = w.col == 0 && w.cols as u64 == b.cols;
        let mut data = vec![0; w.cols * w.rows * width];
        let mut row = w.row;
        let end = w.row + w.rows as u64;
        while row < end {
            let strip = row / b.block_rows;
            // Whole rows follow one another in the file: several at once.
            let most = if whole_rows { (PLAIN_READ_BYTES / row_bytes).max(1) } else { 1 };
            let rows = most.min(end - row).min((strip + 1) * b.block_rows - row);
            if let Some(offset) = b.offset(strip) {
                let at = offset + (row - strip * b.block_rows) * row_bytes + w.col * stride;
                let span = if whole_rows { rows * row_bytes } else { w.cols as u64 * stride };
                let bytes = self.tiff.source().read_exact_at(at, span as usize);
                let bytes = bytes.map_err(|e| tiff_error(&self.info.file, &b.place(strip as usize), e))?;
                let to = (row - w.row) as usize * w.cols * width;
                let out = data[to..].chunks_exact_mut(width);
                for (sample, pixel) in out.zip(bytes.chunks_exact(b.stride_bytes)) {
                    sample.copy_from_slice(&pixel[band * width..][..width]);
                }
            }
            row += rows;
        }
        if self.tiff.byte_order() == ByteOrder::BigEndian {
            reverse_samples(&mut data, self.stored.bytes());
        }
        Ok(data)
    }
}

impl HeightSource for GeoTiff {
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
        let stored = self.read_band(0, w)?;
        let mut data = self.stored.widen(&self.info.file, stored)?;
        let width = self.info.sample_type.bytes();
        let (fill, fill_is_void) = &self.missing;
        if fill.iter().any(|b| *b != 0) {
            self.blocks.each_missing(w, |row, from, to| {
                let run = &mut data[(row * w.cols + from) * width..(row * w.cols + to) * width];
                run.chunks_exact_mut(width).for_each(|sample| sample.copy_from_slice(fill));
            });
        }
        let mut valid = self.voids.valid(&data);
        if *fill_is_void {
            self.blocks
                .each_missing(w, |row, from, to| valid[row * w.cols + from..row * w.cols + to].fill(0));
        }
        self.mask(w, &mut valid)?;
        Ok(Samples { cols: w.cols, rows: w.rows, data, valid })
    }

    fn row_batch(&self) -> usize {
        row_batch(&self.blocks) as usize
    }
}

/// Parses the directories and holds the first image's blocks against file and limits.
fn open_tiff(file: &str, source: SharedSource) -> Result<(TiffFile, Blocks, RasterLayout)> {
    let span_bytes = source.len();
    if span_bytes < HEADER_BYTES {
        let reason = format!("the file has {span_bytes} bytes, a header alone has {HEADER_BYTES}");
        return Err(Error::corrupt(file, "header", reason));
    }
    let mut options = OpenOptions {
        block_cache_bytes: CACHE_BYTES as usize,
        block_cache_slots: CACHE_SLOTS,
        parse_budgets: ParseBudgets {
            max_ifds: IMAGES_MAX,
            max_ifd_entries: IMAGE_TAGS_MAX,
            max_tag_value_bytes: TAG_BYTES_MAX,
            max_metadata_value_bytes: TAG_BYTES_MAX,
        },
        decode_output_bytes: limits::INPUT_BLOCK_BYTES_MAX as usize,
    };
    let parse = |options| {
        TiffFile::from_source_with_options(source.clone(), options)
            .map_err(|e| tiff_error(file, "header or image directory", e))
    };
    let tiff = parse(options)?;
    let ifd = tiff.ifd(0).map_err(|_| Error::corrupt(file, "header", "the file holds no image"))?;
    Stored::of(file, ifd)?;
    let (blocks, layout) = Blocks::check(file, span_bytes, ifd)?;

    // The cache is fixed at opening: open again if one row of blocks does not fit into the usual one.
    // Batches of whole blocks need each block once; only batches that split blocks need more bytes.
    let row_bytes = blocks.across.saturating_mul(blocks.block_bytes);
    let splits_blocks = !reads_plain(&blocks) && !row_batch(&blocks).is_multiple_of(blocks.block_rows);
    if blocks.across as usize >= CACHE_SLOTS || (splits_blocks && row_bytes > CACHE_BYTES) {
        options.block_cache_slots = CACHE_SLOTS.max(blocks.across as usize + 1);
        if splits_blocks {
            let bytes = row_bytes.clamp(CACHE_BYTES, limits::INPUT_BLOCK_BYTES_MAX);
            options.block_cache_bytes = bytes as usize;
        }
        return Ok((parse(options)?, blocks, layout));
    }
    Ok((tiff, blocks, layout))
}

/// Rows of a batch: whole blocks, at least 64 rows, unless that is more posts than fit.
fn row_batch(blocks: &Blocks) -> u64 {
    let most = (ROW_BATCH_POSTS / blocks.cols).max(1);
    let whole = ROW_BATCH_MIN.div_ceil(blocks.block_rows) * blocks.block_rows;
    if whole <= most { whole } else { most.min(ROW_BATCH_MIN) }
}

/// Whether rows are taken from the file without decoding.
fn reads_plain(blocks: &Blocks) -> bool {
    blocks.plain && !blocks.tiled
}

fn subfile(ifd: &Ifd) -> u32 {
    ifd.tag(TAG_SUBFILE_TYPE).and_then(|t| t.value.as_u32()).unwrap_or(0)
}

/// The mask image of the file, else an alpha band.
fn find_mask(file: &str, span_bytes: u64, tiff: &TiffFile, notes: &mut Vec<String>) -> Result<Mask> {
    let Ok(first) = tiff.ifd(0) else {
        return Ok(Mask::None);
    };
    let masks = tiff.ifds().iter().enumerate().skip(1);
    for (index, ifd) in masks.filter(|(_, i)| subfile(i) & (SUBFILE_MASK | SUBFILE_OVERVIEW) == SUBFILE_MASK)
    {
        let bits = ifd.bits_per_sample().ok().and_then(|b| b.first().copied());
        let same_size = (ifd.width(), ifd.height()) == (first.width(), first.height());
        if !same_size || !matches!(bits, Some(1 | 8)) || ifd.samples_per_pixel() != 1 {
            notes.push(format!("mask image {index} does not fit the grid; ignored"));
            continue;
        }
        Blocks::check(&format!("{file} (mask)"), span_bytes, ifd)?;
        return Ok(Mask::Image(index));
    }
    let extra = first.tag(TAG_EXTRA_SAMPLES).and_then(|t| t.value.as_u16_slice()).unwrap_or(&[]);
    let bands = usize::from(first.samples_per_pixel());
    if let Some(i) = extra.iter().position(|e| EXTRA_ALPHA.contains(e))
        && extra.len() < bands
    {
        // Bands of separate planes lie in other blocks, which were not held against the file.
        if first.planar_configuration() == 1 {
            notes.push("posts where the alpha band is zero are void".to_string());
            return Ok(Mask::Alpha(bands - extra.len() + i));
        }
        notes.push("the file has an alpha band in a plane of its own; ignored".to_string());
    }
    Ok(Mask::None)
}

fn reverse_samples(data: &mut [u8], width: usize) {
    if width > 1 {
        data.chunks_exact_mut(width).for_each(<[u8]>::reverse);
    }
}

fn base_name(file: &str) -> &str {
    file.rsplit('/').next().unwrap_or(file)
}

impl TiffSource for Input {
    fn len(&self) -> u64 {
        self.span_bytes()
    }

    fn read_exact_at(&self, offset: u64, len: usize) -> std::result::Result<Vec<u8>, TiffError> {
        let end = offset.checked_add(len as u64);
        if end.is_none_or(|end| end > self.span_bytes()) {
            let data_len = self.span_bytes();
            return Err(TiffError::OffsetOutOfBounds { offset, length: len as u64, data_len });
        }
        let mut bytes = vec![0; len];
        Input::read_exact_at(self, offset, &mut bytes).map_err(|e| TiffError::Io(e, self.file.clone()))?;
        Ok(bytes)
    }
}
