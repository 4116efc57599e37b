//! A PNG for its colours: grey, colours, palette, with alpha or without, of 8 or 16 bits; placed by a world file or `.aux.xml`.

use super::super::input::Input;
use super::super::{sidecar, window};
use crate::base::{Error, Result, limits};
use crate::height::source::{SampleType, SourceInfo, Window};
use png::{ColorType, Decoder, DecodingError, Limits, Transformations};
use std::io::BufReader;
use std::sync::Arc;

/// What the decoder may hold besides the pixels.
const DECODER_BYTES_MAX: usize = 64 << 20;

/// All pixels of a picture.
pub struct Png {
    info: SourceInfo,
    rgb: Vec<[u8; 3]>,
    void: Vec<bool>,
}

impl Png {
    /// Reads a picture, and where it lies.
    pub fn open(input: Input) -> Result<(SourceInfo, Png)> {
        let input = Arc::new(input);
        let file = input.file.clone();
        let error = |place: &str, e| decoding_error(&file, place, e);
        let mut decoder =
            Decoder::new_with_limits(BufReader::new(input.reader(0)), Limits { bytes: DECODER_BYTES_MAX });
        decoder.set_ignore_text_chunk(true);
        decoder.set_ignore_iccp_chunk(true);
        decoder.set_transformations(Transformations::EXPAND | Transformations::STRIP_16);
        let mut reader = decoder.read_info().map_err(|e| error("header", e))?;
        let (cols, rows) = (u64::from(reader.info().width), u64::from(reader.info().height));
        window::check_size(&file, cols, rows)?;
        if cols * rows > limits::WINDOW_POSTS_MAX {
            return Err(Error::limit(format!("pixels of {file}"), limits::WINDOW_POSTS_MAX, cols * rows));
        }
        let bytes = reader.output_buffer_size().unwrap_or(0);
        let mut data = vec![0; bytes];
        let frame = reader.next_frame(&mut data).map_err(|e| error("pixels", e))?;
        data.truncate(frame.buffer_size());
        let (width, alpha) = match frame.color_type {
            ColorType::Grayscale => (1, false),
            ColorType::GrayscaleAlpha => (2, true),
            ColorType::Rgb => (3, false),
            ColorType::Rgba => (4, true),
            ColorType::Indexed => return Err(Error::corrupt(&file, "palette", "it was not applied")),
        };
        let pixels = data.chunks_exact(width);
        let rgb = pixels.clone().map(|p| if width < 3 { [p[0]; 3] } else { [p[0], p[1], p[2]] }).collect();
        let void = pixels.map(|p| alpha && p[width - 1] == 0).collect();
        let mut info = SourceInfo::new(file.clone(), "PNG", [cols, rows], SampleType::U8);
        sidecar::complete(&mut info, &input, &["pgw", "pngw", "wld"])?;
        Ok((info.clone(), Png { info, rgb, void }))
    }

    /// Pixels of a window and which are void.
    pub fn read(&self, w: Window) -> Result<(Vec<[u8; 3]>, Vec<bool>)> {
        window::check(&self.info, w)?;
        let rows = (w.row as usize..w.row as usize + w.rows)
            .map(|row| row * self.info.cols as usize + w.col as usize)
            .map(|from| from..from + w.cols);
        let rgb = rows.clone().flat_map(|run| &self.rgb[run]).copied().collect();
        Ok((rgb, rows.flat_map(|run| &self.void[run]).copied().collect()))
    }
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
