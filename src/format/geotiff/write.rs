//! Writes a GeoTIFF: tiles, deflate with predictor, BigTIFF where the file might pass 4 GB.
//!
//! Bytes: header, tiles in reading order, values of long tags, the one image directory. The header's pointer
//! to the directory is filled in last, so a file that was not finished is no TIFF with an image. The same
//! samples give the same bytes.

use super::georef::{
    KEY_GEODETIC_CITATION, KEY_GEODETIC_CRS, KEY_MODEL_TYPE, KEY_PROJECTED_CITATION, KEY_PROJECTED_CRS,
    KEY_RASTER_TYPE, KEY_VERTICAL_CITATION, KEY_VERTICAL_CRS, KEY_VERTICAL_DATUM, KEY_VERTICAL_UNIT,
    MODEL_GEOGRAPHIC, MODEL_PROJECTED, RASTER_AREA, TAG_GEO_ASCII, TAG_GEO_KEYS, TAG_PIXEL_SCALE,
    TAG_TIEPOINTS, TAG_TRANSFORMATION, UNIT_METRE, USER_DEFINED,
};
use crate::base::bytes::Put;
use crate::base::{Error, Result, limits};
use crate::height::crs::{AxisUnit, Crs};
use crate::height::source::{Affine, SampleType};
use rayon::prelude::*;
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

/// Posts along a tile's side, where the grid is that large.
const TILE_SIDE: usize = 256;
/// TIFF wants tile sides in multiples of this.
const TILE_SIDE_STEP: usize = 16;
/// Above this many bytes before compression, BigTIFF: deflate may enlarge by 0.1 %, tables come on top.
const CLASSIC_BYTES_MAX: u64 = 3_900_000_000;
const DEFLATE_LEVEL: u32 = 6;
const PREDICTOR_DIFFERENCE: u16 = 2;
const PREDICTOR_FLOAT: u16 = 3;

/// What a GeoTIFF says of its samples.
#[derive(Clone, Debug)]
pub struct GeoTiffSpec {
    pub cols: u64,
    pub rows: u64,
    pub sample_type: SampleType,
    /// Position of the posts; the file says PixelIsArea, so its corner lies half a step outside.
    pub affine: Option<Affine>,
    pub crs: Option<Crs>,
    /// Printed into the file as it is.
    pub nodata: Option<String>,
    /// height = sample * scale + offset.
    pub scale: f64,
    pub offset: f64,
    /// What heights, in metres, count from, as [`VerticalDatum`] records it.
    ///
    /// [`VerticalDatum`]: crate::height::crs::vertical::VerticalDatum
    pub vertical_datum: Option<String>,
}

/// Writes rows from the first to the last; holds one row of tiles.
pub struct GeoTiffWriter<W: Write + Seek = File> {
    out: W,
    file: String,
    spec: GeoTiffSpec,
    /// What the file says of itself.
    description: Option<String>,
    big: bool,
    shape: TileShape,
    /// Rows of the current row of tiles.
    band: Vec<u8>,
    rows_written: u64,
    /// Where the next byte goes.
    at: u64,
    offsets: Vec<u64>,
    counts: Vec<u64>,
}

impl GeoTiffWriter<File> {
    /// Creates the file, or empties it.
    ///
    /// # Errors
    /// As [`GeoTiffWriter::new`]; [`Error::Io`] if it cannot be created.
    pub fn create(path: &Path, spec: GeoTiffSpec) -> Result<Self> {
        check_spec(&spec)?;
        let out = File::create(path).map_err(|e| Error::io(path, e))?;
        GeoTiffWriter::new(out, path.display().to_string(), spec)
    }
}

impl<W: Write + Seek> GeoTiffWriter<W> {
    /// Writes to `out`, which is empty; `file` names it in errors.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a grid without posts or a CRS that GeoTIFF cannot name; [`Error::Limit`] for a
    /// grid that [`crate::format::open`] would refuse.
    pub fn new(out: W, file: String, spec: GeoTiffSpec) -> Result<Self> {
        check_spec(&spec)?;
        let side = |posts: u64| {
            let posts = usize::try_from(posts).unwrap_or(TILE_SIDE).min(TILE_SIDE);
            posts.next_multiple_of(TILE_SIDE_STEP)
        };
        let (tile_cols, tile_rows) = (side(spec.cols), side(spec.rows));
        let tiles = spec.cols.div_ceil(tile_cols as u64) * spec.rows.div_ceil(tile_rows as u64);
        let raw_bytes = tiles * ((tile_cols * tile_rows * spec.sample_type.bytes()) as u64 + 16);
        let band_bytes = spec.cols as usize * tile_rows * spec.sample_type.bytes();
        let big = raw_bytes > CLASSIC_BYTES_MAX;
        let shape =
            TileShape { cols: spec.cols as usize, tile_cols, tile_rows, sample_type: spec.sample_type };
        let mut writer = GeoTiffWriter {
            out,
            file,
            spec,
            description: None,
            big,
            shape,
            band: Vec::with_capacity(band_bytes),
            rows_written: 0,
            at: 0,
            offsets: Vec::new(),
            counts: Vec::new(),
        };
        writer.put(&header(big, 0))?;
        Ok(writer)
    }

    /// Writes whole rows of little-endian samples; they have to follow the last ones written.
    ///
    /// # Errors
    /// [`Error::Invalid`] if rows are left out or repeated, or `data` is not whole rows of the grid.
    pub fn write_rows(&mut self, first_row: u64, data: &[u8]) -> Result<()> {
        let row_bytes = self.spec.cols as usize * self.spec.sample_type.bytes();
        if first_row != self.rows_written {
            let reason = format!("row {first_row} given, row {} comes next", self.rows_written);
            return Err(Error::invalid(format!("rows of {}", self.file), reason));
        }
        let rows = (data.len() / row_bytes) as u64;
        if !data.len().is_multiple_of(row_bytes) || rows > self.spec.rows - self.rows_written {
            let left = self.spec.rows - self.rows_written;
            let reason =
                format!("{} bytes given, rows of {row_bytes} bytes wanted, {left} are left", data.len());
            return Err(Error::invalid(format!("rows of {}", self.file), reason));
        }
        for row in data.chunks_exact(row_bytes) {
            self.band.extend_from_slice(row);
            self.rows_written += 1;
            if self.band.len() == row_bytes * self.shape.tile_rows || self.rows_written == self.spec.rows {
                self.flush_band()?;
            }
        }
        Ok(())
    }

    /// Writes the directory and completes the file. It is not synced to the disk.
    ///
    /// # Errors
    /// [`Error::Invalid`] if rows are missing.
    pub fn finish(mut self) -> Result<W> {
        if self.rows_written != self.spec.rows {
            let reason = format!("{} rows written, {} wanted", self.rows_written, self.spec.rows);
            return Err(Error::invalid(format!("rows of {}", self.file), reason));
        }
        let directory = self.write_directory()?;
        let header = header(self.big, directory);
        self.out
            .seek(SeekFrom::Start(0))
            .and_then(|_| self.out.write_all(&header))
            .and_then(|()| self.out.flush())
            .map_err(|e| Error::io(&self.file, e))?;
        Ok(self.out)
    }

    /// What the file says of itself (ImageDescription): letters of ASCII, others become `?`.
    pub fn describe(&mut self, text: &str) {
        let plain = |c: char| if c.is_ascii() && c != '\0' { c } else { '?' };
        self.description = Some(text.chars().map(plain).collect());
    }

    fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.out.write_all(bytes).map_err(|e| Error::io(&self.file, e))?;
        self.at += bytes.len() as u64;
        Ok(())
    }

    fn flush_band(&mut self) -> Result<()> {
        let across = self.shape.cols.div_ceil(self.shape.tile_cols);
        let (band, shape) = (&self.band[..], self.shape);
        let tiles: Vec<Vec<u8>> = (0..across).into_par_iter().map(|i| shape.encode(band, i)).collect();
        for tile in tiles {
            self.offsets.push(self.at);
            self.counts.push(tile.len() as u64);
            self.put(&tile)?;
        }
        self.band.clear();
        Ok(())
    }

    fn write_directory(&mut self) -> Result<u64> {
        let entries = self.entries();
        let inline_bytes = if self.big { 8 } else { 4 };
        let mut body: Vec<u8> = Vec::new();
        match self.big {
            true => body.put_u64(entries.len() as u64),
            false => body.put_u16(entries.len() as u16),
        }
        for entry in entries {
            body.put_u16(entry.tag);
            body.put_u16(entry.kind);
            self.put_offset(&mut body, entry.count);
            if entry.value.len() <= inline_bytes {
                let mut value = entry.value;
                value.resize(inline_bytes, 0);
                body.put(&value);
            } else {
                self.align()?;
                self.put_offset(&mut body, self.at);
                self.put(&entry.value)?;
            }
        }
        self.put_offset(&mut body, 0);
        self.align()?;
        let directory = self.at;
        self.put(&body)?;
        Ok(directory)
    }

    fn put_offset(&self, to: &mut Vec<u8>, value: u64) {
        match self.big {
            true => to.put_u64(value),
            // CLASSIC_BYTES_MAX keeps every offset of a classic file below 4 GiB.
            false => to.put_u32(value as u32),
        }
    }

    /// Values and directories begin at even bytes (at multiples of eight, for BigTIFF's sake).
    fn align(&mut self) -> Result<()> {
        let pad = self.at.next_multiple_of(8) - self.at;
        self.put(&[0; 8][..pad as usize])
    }

    fn entries(&self) -> Vec<Entry> {
        let spec = &self.spec;
        let (predictor, format) = match spec.sample_type {
            SampleType::F32 | SampleType::F64 => (PREDICTOR_FLOAT, 3),
            SampleType::I8 | SampleType::I16 | SampleType::I32 => (PREDICTOR_DIFFERENCE, 2),
            SampleType::U8 | SampleType::U16 | SampleType::U32 => (PREDICTOR_DIFFERENCE, 1),
        };
        let table = |tag, values: &[u64]| match self.big {
            true => Entry::long8(tag, values),
            false => Entry::long(tag, values),
        };
        let mut entries = vec![
            Entry::long(256, &[spec.cols]),
            Entry::long(257, &[spec.rows]),
            Entry::short(258, &[spec.sample_type.bytes() as u16 * 8]),
            Entry::short(259, &[8]), // deflate
            Entry::short(262, &[1]), // black is zero
        ];
        entries.extend(self.description.iter().map(|t| Entry::text(270, t)));
        entries.extend([
            Entry::short(277, &[1]), // one band
            Entry::short(284, &[1]), // one plane
            Entry::short(317, &[predictor]),
            Entry::long(322, &[self.shape.tile_cols as u64]),
            Entry::long(323, &[self.shape.tile_rows as u64]),
            table(324, &self.offsets),
            table(325, &self.counts),
            Entry::short(339, &[format]),
        ]);
        if let Some(affine) = spec.affine {
            entries.extend(placement(affine));
        }
        let (keys, text) = geo_keys(spec.crs.as_ref(), spec.vertical_datum.as_deref());
        entries.push(Entry::short(TAG_GEO_KEYS, &keys));
        entries.extend(text.map(|t| Entry::text(TAG_GEO_ASCII, &t)));
        if spec.scale != 1.0 || spec.offset != 0.0 {
            let item = |name: &str, role: &str, value: f64| {
                format!("  <Item name=\"{name}\" sample=\"0\" role=\"{role}\">{value}</Item>\n")
            };
            let (offset, scale) = (item("OFFSET", "offset", spec.offset), item("SCALE", "scale", spec.scale));
            entries.push(Entry::text(42112, &format!("<GDALMetadata>\n{offset}{scale}</GDALMetadata>\n")));
        }
        if let Some(nodata) = &spec.nodata {
            entries.push(Entry::text(42113, nodata));
        }
        entries
    }
}

/// How a row of tiles is cut from whole rows.
#[derive(Clone, Copy)]
struct TileShape {
    cols: usize,
    tile_cols: usize,
    tile_rows: usize,
    sample_type: SampleType,
}

impl TileShape {
    /// One tile of `band`: past the grid's edge its last samples are repeated.
    fn encode(self, band: &[u8], index: usize) -> Vec<u8> {
        let width = self.sample_type.bytes();
        let row_bytes = self.cols * width;
        let rows = band.len() / row_bytes;
        let tile_row_bytes = self.tile_cols * width;
        let from = index * tile_row_bytes;
        let to = (from + tile_row_bytes).min(row_bytes);
        let mut tile = Vec::with_capacity(tile_row_bytes * self.tile_rows);
        let mut scratch = vec![0; tile_row_bytes];
        for row in 0..self.tile_rows {
            let start = tile.len();
            tile.extend_from_slice(&band[row.min(rows - 1) * row_bytes..][from..to]);
            while tile.len() < start + tile_row_bytes {
                tile.extend_from_within(tile.len() - width..);
            }
            predict(&mut tile[start..], self.sample_type, &mut scratch);
        }
        deflate(&tile)
    }
}

/// One entry of the image directory.
struct Entry {
    tag: u16,
    kind: u16,
    count: u64,
    value: Vec<u8>,
}

impl Entry {
    fn short(tag: u16, values: &[u16]) -> Entry {
        let value = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Entry { tag, kind: 3, count: values.len() as u64, value }
    }
    fn long(tag: u16, values: &[u64]) -> Entry {
        let value = values.iter().flat_map(|v| (*v as u32).to_le_bytes()).collect();
        Entry { tag, kind: 4, count: values.len() as u64, value }
    }
    fn long8(tag: u16, values: &[u64]) -> Entry {
        let value = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Entry { tag, kind: 16, count: values.len() as u64, value }
    }
    fn double(tag: u16, values: &[f64]) -> Entry {
        let value = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Entry { tag, kind: 12, count: values.len() as u64, value }
    }
    fn text(tag: u16, text: &str) -> Entry {
        let mut value = text.as_bytes().to_vec();
        value.push(0);
        Entry { tag, kind: 2, count: value.len() as u64, value }
    }
}

fn check_spec(spec: &GeoTiffSpec) -> Result<()> {
    if spec.cols == 0 || spec.rows == 0 {
        return Err(Error::invalid("grid", format!("{} x {} posts", spec.cols, spec.rows)));
    }
    let side = spec.cols.max(spec.rows);
    if side > limits::SIDE_MAX {
        return Err(Error::limit("columns or rows of a GeoTIFF", limits::SIDE_MAX, side));
    }
    if spec.cols * spec.rows > limits::POSTS_MAX {
        return Err(Error::limit("posts of a GeoTIFF", limits::POSTS_MAX, spec.cols * spec.rows));
    }
    if let Some(crs) = spec.crs.as_ref().filter(|c| c.code.starts_with("EPSG:") && epsg_of(&c.code).is_none())
    {
        let reason = format!("'{}' is not EPSG:1 to EPSG:32766, which is what GeoTIFF can name", crs.code);
        return Err(Error::invalid("crs", reason));
    }
    if let Some(crs) =
        spec.crs.as_ref().filter(|c| c.code.len() > limits::TEXT_BYTES_MAX || !c.code.is_ascii())
    {
        let reason = format!("a name of {} bytes does not fit a GeoTIFF", crs.code.len());
        return Err(Error::invalid("crs", reason));
    }
    if let Some(datum) =
        spec.vertical_datum.as_ref().filter(|d| d.len() > limits::TEXT_BYTES_MAX || d.contains(['|', '\0']))
    {
        let reason = format!("'{datum}' does not fit a GeoTIFF; use another name");
        return Err(Error::invalid("vertical datum", reason));
    }
    if spec.nodata.as_ref().is_some_and(|text| text.contains('\0')) {
        return Err(Error::invalid("nodata", "the text holds a zero byte"));
    }
    Ok(())
}

fn header(big: bool, directory: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    bytes.put(b"II");
    if big {
        bytes.put_u16(43);
        bytes.put_u16(8);
        bytes.put_u16(0);
        bytes.put_u64(directory);
    } else {
        bytes.put_u16(42);
        bytes.put_u32(directory as u32);
    }
    bytes
}

/// The number of `EPSG:n`, if a key can hold it.
fn epsg_of(name: &str) -> Option<u16> {
    name.strip_prefix("EPSG:")?.parse().ok().filter(|code| (1..32767).contains(code))
}

/// The key directory, and the text that it points into. A system without an EPSG code is user-defined, with its
/// name or PROJ string as citation: this program reads it back, others show it. So is a vertical datum without one.
fn geo_keys(crs: Option<&Crs>, vertical_datum: Option<&str>) -> (Vec<u16>, Option<String>) {
    let mut entries = vec![[KEY_RASTER_TYPE, 0, 1, RASTER_AREA]];
    let mut text = String::new();
    let mut named = |entries: &mut Vec<[u16; 4]>, key: u16, citation: u16, name: &str| {
        entries.push([key, 0, 1, epsg_of(name).unwrap_or(USER_DEFINED)]);
        if epsg_of(name).is_none() {
            entries.push([citation, TAG_GEO_ASCII, name.len() as u16 + 1, text.len() as u16]);
            text.extend([name, "|"]);
        }
    };
    if let Some(crs) = crs {
        let (model, key, citation) = match crs.unit {
            AxisUnit::Degree => (MODEL_GEOGRAPHIC, KEY_GEODETIC_CRS, KEY_GEODETIC_CITATION),
            AxisUnit::Metre(_) => (MODEL_PROJECTED, KEY_PROJECTED_CRS, KEY_PROJECTED_CITATION),
        };
        entries.push([KEY_MODEL_TYPE, 0, 1, model]);
        named(&mut entries, key, citation, &crs.code);
    }
    if let Some(datum) = vertical_datum {
        named(&mut entries, KEY_VERTICAL_CRS, KEY_VERTICAL_CITATION, datum);
        if epsg_of(datum).is_none() {
            entries.push([KEY_VERTICAL_DATUM, 0, 1, USER_DEFINED]);
        }
        entries.push([KEY_VERTICAL_UNIT, 0, 1, UNIT_METRE]);
    }
    // Ascending by key, as GeoTIFF wants them. Compound systems came with its version 1.1.
    entries.sort_unstable();
    let mut directory = vec![1, 1, u16::from(vertical_datum.is_some()), entries.len() as u16];
    directory.extend(entries.as_flattened());
    (directory, Some(text).filter(|t| !t.is_empty()))
}

/// Scale and tie point for a north-up grid, else a matrix.
fn placement(a: Affine) -> Vec<Entry> {
    let corner = [0, 1].map(|k| a.origin[k] - 0.5 * a.col_step[k] - 0.5 * a.row_step[k]);
    let north_up = a.col_step[0] > 0.0 && a.col_step[1] == 0.0 && a.row_step[0] == 0.0 && a.row_step[1] < 0.0;
    if north_up {
        return vec![
            Entry::double(TAG_PIXEL_SCALE, &[a.col_step[0], -a.row_step[1], 0.0]),
            Entry::double(TAG_TIEPOINTS, &[0.0, 0.0, 0.0, corner[0], corner[1], 0.0]),
        ];
    }
    let (c, r) = (a.col_step, a.row_step);
    let matrix = [
        [c[0], r[0], 0.0, corner[0]],
        [c[1], r[1], 0.0, corner[1]],
        [0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ];
    vec![Entry::double(TAG_TRANSFORMATION, matrix.as_flattened())]
}

/// Turns a row into differences: of samples (predictor 2), or of bytes after sorting them by significance
/// (predictor 3, Adobe Photoshop TIFF Technical Note 3).
fn predict(row: &mut [u8], sample_type: SampleType, scratch: &mut [u8]) {
    let width = sample_type.bytes();
    if sample_type.is_float() {
        let count = row.len() / width;
        for (i, sample) in row.chunks_exact(width).enumerate() {
            for (k, byte) in sample.iter().rev().enumerate() {
                scratch[k * count + i] = *byte;
            }
        }
        row.copy_from_slice(scratch);
        for i in (1..row.len()).rev() {
            row[i] = row[i].wrapping_sub(row[i - 1]);
        }
        return;
    }
    for i in (width..row.len()).step_by(width).rev() {
        match width {
            1 => row[i] = row[i].wrapping_sub(row[i - 1]),
            2 => {
                let of = |at: usize| u16::from_le_bytes([row[at], row[at + 1]]);
                let d = of(i).wrapping_sub(of(i - 2));
                row[i..i + 2].copy_from_slice(&d.to_le_bytes());
            }
            _ => {
                let of = |at: usize| u32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]]);
                let d = of(i).wrapping_sub(of(i - 4));
                row[i..i + 4].copy_from_slice(&d.to_le_bytes());
            }
        }
    }
}

fn deflate(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(
        Vec::with_capacity(bytes.len() / 2),
        flate2::Compression::new(DEFLATE_LEVEL),
    );
    encoder.write_all(bytes).and_then(|()| encoder.finish()).expect("writing to memory does not fail")
}
