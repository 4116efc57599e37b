//! What a survey file gives: a grid of samples in their own type, read window by window.

use super::crs::Crs;
use crate::base::Result;
use std::path::Path;

/// How one sample is stored. Samples are kept in this type, bit for bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum SampleType {
    U8 = 1,
    I8 = 2,
    U16 = 3,
    I16 = 4,
    U32 = 5,
    I32 = 6,
    F32 = 7,
    F64 = 8,
}

/// Does something once for a sample type: `T` is the type of number that the samples are.
macro_rules! each_type {
    ($type:expr, $t:ident => $body:block) => {
        each_type!(@ $type, $t, $body, U8 u8, I8 i8, U16 u16, I16 i16, U32 u32, I32 i32, F32 f32, F64 f64)
    };
    (@ $type:expr, $t:ident, $body:block, $($name:ident $number:ty),*) => {
        match $type {
            $(SampleType::$name => {
                type $t = $number;
                $body
            })*
        }
    };
}

impl SampleType {
    pub const ALL: [SampleType; 8] = [
        SampleType::U8,
        SampleType::I8,
        SampleType::U16,
        SampleType::I16,
        SampleType::U32,
        SampleType::I32,
        SampleType::F32,
        SampleType::F64,
    ];

    pub fn from_code(code: u8) -> Option<SampleType> {
        SampleType::ALL.into_iter().find(|t| *t as u8 == code)
    }

    /// Bytes of one sample.
    pub fn bytes(self) -> usize {
        match self {
            SampleType::U8 | SampleType::I8 => 1,
            SampleType::U16 | SampleType::I16 => 2,
            SampleType::U32 | SampleType::I32 | SampleType::F32 => 4,
            SampleType::F64 => 8,
        }
    }

    pub fn is_float(self) -> bool {
        matches!(self, SampleType::F32 | SampleType::F64)
    }

    pub fn name(self) -> &'static str {
        match self {
            SampleType::U8 => "uint8",
            SampleType::I8 => "int8",
            SampleType::U16 => "uint16",
            SampleType::I16 => "int16",
            SampleType::U32 => "uint32",
            SampleType::I32 => "int32",
            SampleType::F32 => "float32",
            SampleType::F64 => "float64",
        }
    }

    /// The value of the little-endian sample at `bytes[..self.bytes()]`, exactly.
    #[inline]
    pub fn value(self, bytes: &[u8]) -> f64 {
        match self {
            SampleType::U8 => f64::from(bytes[0]),
            SampleType::I8 => f64::from(bytes[0] as i8),
            SampleType::U16 => f64::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            SampleType::I16 => f64::from(i16::from_le_bytes([bytes[0], bytes[1]])),
            SampleType::U32 => f64::from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
            SampleType::I32 => f64::from(i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
            SampleType::F32 => f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
            SampleType::F64 => f64::from_le_bytes([
                bytes[0], bytes[1], bytes[2], bytes[3], bytes[4], bytes[5], bytes[6], bytes[7],
            ]),
        }
    }

    /// The values of the samples in `bytes`, exactly: as [`SampleType::value`] of each, but the type is looked at once.
    ///
    /// # Panics
    /// If `bytes` does not hold `out.len()` samples.
    // One of the types is f64 itself.
    #[allow(clippy::useless_conversion)]
    pub fn values(self, bytes: &[u8], out: &mut [f64]) {
        assert_eq!(bytes.len(), out.len() * self.bytes(), "one sample a value");
        each_type!(self, T => {
            for (v, b) in out.iter_mut().zip(bytes.chunks_exact(size_of::<T>())) {
                *v = f64::from(T::from_le_bytes(b.try_into().expect("chunks of one sample")));
            }
        });
    }

    /// Number of valid samples (`valid`: one byte a sample, 0 = void), and the least and the greatest of them:
    /// infinity and -infinity if there is none.
    ///
    /// # Panics
    /// If `bytes` does not hold `valid.len()` samples.
    // One of the types is f64 itself.
    #[allow(clippy::useless_conversion)]
    pub fn span(self, bytes: &[u8], valid: &[u8]) -> (u64, [f64; 2]) {
        assert_eq!(bytes.len(), valid.len() * self.bytes(), "one byte of validity a sample");
        let count = valid.iter().map(|v| u64::from(*v != 0)).sum();
        // In lanes: the least and the greatest of numbers have no order.
        const LANES: usize = 8;
        let (mut low, mut high) = ([f64::INFINITY; LANES], [f64::NEG_INFINITY; LANES]);
        each_type!(self, T => {
            for (b, v) in bytes.chunks(LANES * size_of::<T>()).zip(valid.chunks(LANES)) {
                let heights = b.chunks_exact(size_of::<T>());
                for (k, (b, v)) in heights.zip(v).enumerate() {
                    let h = f64::from(T::from_le_bytes(b.try_into().expect("chunks of one sample")));
                    let (l, h) = if *v != 0 { (h, h) } else { (f64::INFINITY, f64::NEG_INFINITY) };
                    low[k] = if l < low[k] { l } else { low[k] };
                    high[k] = if h > high[k] { h } else { high[k] };
                }
            }
        });
        let span = [
            low.into_iter().fold(f64::INFINITY, f64::min),
            high.into_iter().fold(f64::NEG_INFINITY, f64::max),
        ];
        (count, span)
    }
}

/// A rectangle of posts of a source: `col, row` is the first, counted from the file's first post.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    pub col: u64,
    pub row: u64,
    pub cols: usize,
    pub rows: usize,
}

/// Samples of one window, row-major, little-endian in the source's type, and which of them are valid.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Samples {
    pub cols: usize,
    pub rows: usize,
    /// `cols * rows * sample_type.bytes()` bytes, as they stood in the file (but little-endian).
    pub data: Vec<u8>,
    /// 1 = a height, 0 = a void (nodata value, NaN, infinite, masked). One byte a post.
    pub valid: Vec<u8>,
}

/// Where posts lie: post (col, row) is at `origin + col * col_step + row * row_step`, in units of the CRS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    pub origin: [f64; 2],
    pub col_step: [f64; 2],
    pub row_step: [f64; 2],
}

/// What a source says of itself before any sample is read.
#[derive(Clone, Debug)]
pub struct SourceInfo {
    /// The file, as the user named it; used in errors.
    pub file: String,
    /// Name of the format, for messages: `GeoTIFF`, `HGT`, `DTED`, ...
    pub format: &'static str,
    pub cols: u64,
    pub rows: u64,
    pub sample_type: SampleType,
    /// Position of post centres (pixel-is-area files: centre of the pixel). None: no georeference.
    pub affine: Option<Affine>,
    /// None: the file does not say.
    pub crs: Option<Crs>,
    /// The value that marks voids, as in the file.
    pub nodata: Option<f64>,
    /// height = sample * scale + offset, in metres unless the user says otherwise.
    pub scale: f64,
    pub offset: f64,
    /// What heights count from, as [`crate::height::crs::vertical::VerticalDatum`] records it. None: not said.
    pub vertical_datum: Option<String>,
    /// Metres of one unit of height. None: the file does not say.
    pub vertical_unit_m: Option<f64>,
    /// Vertical accuracy in metres, if the file is of a product whose accuracy is published.
    pub accuracy_m: Option<f64>,
    /// Name of that product, for messages.
    pub product: Option<&'static str>,
    /// Things a user should know (several bands: the first is read; CRS taken from ...).
    pub notes: Vec<String>,
}

/// Values that programs write where there is no data.
const NODATA_LIKE: [f64; 6] = [-32768.0, -32767.0, -9999.0, -99999.0, 32767.0, -3.4028234663852886e38];

impl SourceInfo {
    /// A note if the lowest or highest sample, as it stands in the file, looks like a nodata value that the file does not name.
    pub fn suspect(&self, ends: [f64; 2]) -> Option<String> {
        let found =
            NODATA_LIKE.into_iter().find(|v| ends.iter().any(|raw| (raw - v).abs() < 1e-6 * v.abs()))?;
        let file = &self.file;
        Some(format!(
            "{file}: {found} looks like a nodata value, and counts as a height; --nodata {found} says otherwise"
        ))
    }

    /// A grid of metres of which nothing else is known; `size`: columns and rows.
    pub fn new(
        file: impl Into<String>,
        format: &'static str,
        size: [u64; 2],
        sample_type: SampleType,
    ) -> SourceInfo {
        SourceInfo {
            file: file.into(),
            format,
            cols: size[0],
            rows: size[1],
            sample_type,
            affine: None,
            crs: None,
            nodata: None,
            scale: 1.0,
            offset: 0.0,
            vertical_datum: None,
            vertical_unit_m: None,
            accuracy_m: None,
            product: None,
            notes: Vec::new(),
        }
    }
}

/// A grid of samples that can be read in windows, in any order, any number of times.
pub trait HeightSource: Send {
    fn info(&self) -> &SourceInfo;

    /// Overrides the nodata value (`--nodata`).
    fn set_nodata(&mut self, value: f64);

    /// Reads one window.
    ///
    /// # Errors
    /// If the window leaves the grid, or the file cannot be decoded there (`Error::Corrupt` with file and place).
    fn read(&mut self, window: Window) -> Result<Samples>;

    /// Rows that are cheap to read together (height of a strip or tile of the file).
    fn row_batch(&self) -> usize {
        64
    }
}

/// Opens a file as a source. The implementation sits in `format/`; ingest knows only this type.
pub type Opener<'a> = &'a dyn Fn(&Path) -> Result<Box<dyn HeightSource>>;

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of samples of any bits, against one sample at a time.
    #[test]
    fn rows_are_what_their_samples_are() {
        let mut state = 88172645463325252u64;
        let mut byte = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state as u8
        };
        for t in SampleType::ALL {
            for n in [0usize, 1, 7, 31, 300] {
                let bytes: Vec<u8> = (0..n * t.bytes()).map(|_| byte()).collect();
                let mut valid: Vec<u8> = (0..n).map(|_| byte() & 1).collect();
                let mut found = vec![1.0; n];
                t.values(&bytes, &mut found);
                let plain: Vec<f64> = bytes.chunks_exact(t.bytes()).map(|b| t.value(b)).collect();
                assert!(found.iter().zip(&plain).all(|(a, b)| a.to_bits() == b.to_bits()), "{t:?}");
                // A valid sample is a number.
                valid.iter_mut().zip(&plain).filter(|(_, h)| !h.is_finite()).for_each(|(v, _)| *v = 0);
                let held = || plain.iter().zip(&valid).filter(|(_, v)| **v != 0).map(|(h, _)| *h);
                let span = [held().fold(f64::INFINITY, f64::min), held().fold(f64::NEG_INFINITY, f64::max)];
                assert_eq!(t.span(&bytes, &valid), (held().count() as u64, span), "{t:?}");
            }
        }
    }
}
