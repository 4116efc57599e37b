//! Samples as a TIFF stores them, and the type in which they are handed over: the same, or a wider one for half
//! floats, 64-bit integers and packed bits, which no [`SampleType`] is.

use super::blocks::tiff_error;
use crate::base::{Error, Result};
use crate::height::source::SampleType;
use tiff_reader::{Ifd, TiffError};

/// How one sample is stored, once its block is decoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stored {
    Same(SampleType),
    /// IEEE half floats; float32 holds every one.
    Half,
    /// 64-bit integers, handed over as float64 where that is exact.
    Int64,
    Uint64,
}

impl Stored {
    /// The samples of band 1.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for complex numbers and widths that are not read.
    pub fn of(file: &str, ifd: &Ifd) -> Result<Stored> {
        let first = |values: std::result::Result<Vec<u16>, TiffError>| match values {
            Ok(values) => Ok(values.first().copied().unwrap_or(1)),
            Err(e) => Err(tiff_error(file, "image directory", e)),
        };
        let (bits, format) = (first(ifd.bits_per_sample())?, first(ifd.sample_format())?);
        let kind = match format {
            1 | 4 => "unsigned",
            2 => "signed",
            3 => "float",
            5 | 6 => "complex",
            _ => "unknown",
        };
        Ok(Stored::Same(match (kind, bits) {
            // Less than a byte or two come out of their bits in the next whole number of bytes.
            ("unsigned", 1..=8) => SampleType::U8,
            ("unsigned", 9..=16) => SampleType::U16,
            ("unsigned", 32) => SampleType::U32,
            ("signed", 8) => SampleType::I8,
            ("signed", 16) => SampleType::I16,
            ("signed", 32) => SampleType::I32,
            ("float", 32) => SampleType::F32,
            ("float", 64) => SampleType::F64,
            ("float", 16) => return Ok(Stored::Half),
            ("signed", 64) => return Ok(Stored::Int64),
            ("unsigned", 64) => return Ok(Stored::Uint64),
            _ => {
                return Err(Error::unsupported(
                    file,
                    format!("samples of {bits} bits ({kind}) are not read"),
                    "convert them with: gdal_translate -ot Float32 INPUT OUTPUT.tif",
                ));
            }
        }))
    }

    /// The type handed over.
    pub fn sample_type(self) -> SampleType {
        match self {
            Stored::Same(t) => t,
            Stored::Half => SampleType::F32,
            Stored::Int64 | Stored::Uint64 => SampleType::F64,
        }
    }

    /// Bytes of one stored sample.
    pub fn bytes(self) -> usize {
        match self {
            Stored::Same(t) => t.bytes(),
            Stored::Half => 2,
            Stored::Int64 | Stored::Uint64 => 8,
        }
    }

    /// Little-endian stored samples in the type handed over.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for an integer that float64 cannot hold.
    pub fn widen(self, file: &str, data: Vec<u8>) -> Result<Vec<u8>> {
        let exact = |found: i128, wide: f64| {
            if wide as i128 == found {
                return Ok(wide.to_le_bytes());
            }
            let what = format!("the 64-bit sample {found} cannot be held exactly");
            Err(Error::unsupported(
                file,
                what,
                "convert it with: gdal_translate -ot Float64 INPUT OUTPUT.tif",
            ))
        };
        let eight = |b: &[u8]| [b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]];
        match self {
            Stored::Same(_) => Ok(data),
            Stored::Half => {
                let halves = data.chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]));
                Ok(halves.flat_map(|h| h.to_f32().to_le_bytes()).collect())
            }
            Stored::Int64 => {
                let values = data.chunks_exact(8).map(|b| i64::from_le_bytes(eight(b)));
                values.map(|v| exact(v.into(), v as f64)).collect::<Result<Vec<_>>>().map(|v| v.concat())
            }
            Stored::Uint64 => {
                let values = data.chunks_exact(8).map(|b| u64::from_le_bytes(eight(b)));
                values.map(|v| exact(v.into(), v as f64)).collect::<Result<Vec<_>>>().map(|v| v.concat())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_and_long_integers_widen_exactly_or_not_at_all() {
        let halves = [0x3c00u16, 0xc900, 0x7e00, 0x0001].iter().flat_map(|h| h.to_le_bytes()).collect();
        let wide = Stored::Half.widen("a.tif", halves).unwrap();
        let values: Vec<f64> = wide.chunks(4).map(|b| SampleType::F32.value(b)).collect();
        assert_eq!(values[..2], [1.0, -10.0]);
        assert!(values[2].is_nan() && values[3] == 2f64.powi(-24));
        let long = |v: i64| Stored::Int64.widen("a.tif", v.to_le_bytes().to_vec());
        for v in [-32768, 0, 1 << 53, i64::MIN] {
            assert_eq!(SampleType::F64.value(&long(v).unwrap()), v as f64);
        }
        for v in [(1 << 53) + 1, i64::MAX] {
            assert!(long(v).unwrap_err().to_string().contains(&v.to_string()));
        }
        assert!(Stored::Uint64.widen("a.tif", u64::MAX.to_le_bytes().to_vec()).is_err());
    }
}
