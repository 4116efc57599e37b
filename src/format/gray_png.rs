//! Heights as a greyscale PNG of 8 or 16 bits, placed by a world file (`.pgw`, `.wld`) or by `.aux.xml`.
//!
//! Rows are decoded in their order; going back begins the picture anew. Nothing in the file says what a grey means:
//! samples are taken as metres, and a transparent grey (tRNS) as void.

use super::input::{Input, InputReader};
use super::sidecar;
use super::voids::Voids;
use super::window;
use crate::base::{Error, Result};
use crate::height::source::{HeightSource, SampleType, Samples, SourceInfo, Window};
use png::{BitDepth, ColorType, Decoder, DecodingError, Limits, Reader};
use std::io::BufReader;
use std::sync::Arc;

const CONVERT: &str = "convert it to heights first, for example with gdal_calc.py, as GeoTIFF";
/// What the decoder may hold besides a row.
const DECODER_BYTES_MAX: usize = 64 << 20;

/// One picture.
pub struct GrayPng {
    info: SourceInfo,
    input: Arc<Input>,
    voids: Voids,
    /// The decoder, and the row that it gives next.
    running: Option<(Box<Reader<BufReader<InputReader>>>, u64)>,
}

impl GrayPng {
    /// Opens a picture by its header; no row is decoded.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for colours, alpha, less than 8 bits and interlaced pictures; [`Error::Corrupt`] for
    /// damaged ones.
    pub fn open(input: Input) -> Result<GrayPng> {
        let input = Arc::new(input);
        let reader = decoder(&input)?;
        let header = reader.info();
        let (cols, rows) = (u64::from(header.width), u64::from(header.height));
        window::check_size(&input.file, cols, rows)?;
        let unsupported = |what: String| Err(Error::unsupported(&input.file, what, CONVERT));
        if header.color_type != ColorType::Grayscale {
            let name = match header.color_type {
                ColorType::Rgb | ColorType::Rgba => "colours",
                ColorType::Indexed => "a palette",
                _ => "transparency",
            };
            return unsupported(format!(
                "a PNG picture with {name}; read are greyscale ones of 8 or 16 bits"
            ));
        }
        let sample_type = match header.bit_depth {
            BitDepth::Eight => SampleType::U8,
            BitDepth::Sixteen => SampleType::U16,
            other => return unsupported(format!("a PNG picture of {} bits", other as u8)),
        };
        if header.interlaced {
            return unsupported("an interlaced PNG picture".to_string());
        }
        let clear = header.trns.as_deref().map(|t| t.iter().fold(0u32, |n, b| n << 8 | u32::from(*b)));
        let mut info = SourceInfo {
            file: input.file.clone(),
            format: "PNG",
            cols,
            rows,
            sample_type,
            affine: None,
            crs: None,
            nodata: clear.map(f64::from),
            scale: 1.0,
            offset: 0.0,
            accuracy_m: None,
            product: None,
            vertical_datum: None,
            vertical_unit_m: None,
            notes: vec!["a PNG does not say what a grey means; greys are taken as metres".to_string()],
        };
        sidecar::complete(&mut info, &input, &["pgw", "pngw", "wld"])?;
        let voids = Voids::of(&mut info);
        Ok(GrayPng { info, input, voids, running: None })
    }
}

fn decoder(input: &Arc<Input>) -> Result<Box<Reader<BufReader<InputReader>>>> {
    let limits = Limits { bytes: DECODER_BYTES_MAX };
    let mut decoder = Decoder::new_with_limits(BufReader::new(input.reader(0)), limits);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let reader = decoder.read_info().map_err(|e| decoding_error(&input.file, "header", e))?;
    Ok(Box::new(reader))
}

fn decoding_error(file: &str, place: &str, e: DecodingError) -> Error {
    match e {
        DecodingError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => Error::io(file, e),
        DecodingError::LimitsExceeded => Error::limit(
            format!("bytes to decode {file}"),
            DECODER_BYTES_MAX as u64,
            DECODER_BYTES_MAX as u64 + 1,
        ),
        other => Error::corrupt(file, place, other),
    }
}

impl HeightSource for GrayPng {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn set_nodata(&mut self, value: f64) {
        self.info.nodata = Some(value);
        self.voids = Voids::of(&mut self.info);
    }

    fn read(&mut self, w: Window) -> Result<Samples> {
        window::check(&self.info, w)?;
        let width = self.info.sample_type.bytes();
        let mut data = Vec::with_capacity(w.cols * w.rows * width);
        if w.cols == 0 || w.rows == 0 {
            return Ok(Samples { cols: w.cols, rows: w.rows, ..Samples::default() });
        }
        let (mut reader, mut next) = match self.running.take() {
            Some((reader, next)) if next <= w.row => (reader, next),
            _ => (decoder(&self.input)?, 0),
        };
        while next < w.row + w.rows as u64 {
            let row =
                reader.next_row().map_err(|e| decoding_error(&self.info.file, &format!("row {next}"), e))?;
            let from = w.col as usize * width;
            let run = row.as_ref().and_then(|row| row.data().get(from..from + w.cols * width));
            let Some(run) = run else {
                return Err(Error::corrupt(
                    &self.info.file,
                    format!("row {next}"),
                    "the picture ends before it",
                ));
            };
            if next >= w.row {
                data.extend_from_slice(run);
            }
            next += 1;
        }
        self.running = Some((reader, next));
        if width > 1 {
            data.chunks_exact_mut(width).for_each(<[u8]>::reverse);
        }
        let valid = self.voids.valid(&data);
        Ok(Samples { cols: w.cols, rows: w.rows, data, valid })
    }
}
