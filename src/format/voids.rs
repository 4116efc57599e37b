//! Which samples are no height: equal to the nodata value, NaN, or infinite.
//!
//! The nodata value is compared in the sample's own type. One rule bends: values beyond 1e30, which no
//! height can have, match within 2e-6 of the nodata value, because files write `-3.40282e+38` in text and
//! the lowest `f32` in their samples. A value that the type cannot hold matches nothing.

use crate::height::source::{SampleType, SourceInfo};

/// Above this, nodata matches loosely.
const HUGE: f64 = 1e30;
/// How loosely: six printed digits.
const HUGE_TOLERANCE: f64 = 2e-6;

/// Decides about samples of one type.
#[derive(Clone, Debug)]
pub struct Voids {
    sample_type: SampleType,
    nodata: Option<f64>,
}

impl Voids {
    pub fn new(sample_type: SampleType, nodata: Option<f64>) -> Voids {
        Voids { sample_type, nodata }
    }

    /// By the nodata value of a source, with a note to it if no sample can hold that.
    pub fn of(info: &mut SourceInfo) -> Voids {
        let voids = Voids::new(info.sample_type, info.nodata);
        info.notes.extend(voids.note());
        voids
    }

    /// A note for the user if no sample can hold the nodata value.
    pub fn note(&self) -> Option<String> {
        let value = self.nodata.filter(|_| self.nodata_bytes().is_none())?;
        let name = self.sample_type.name();
        Some(format!("no {name} sample can hold the nodata value {value}; no post is void by it"))
    }

    /// The nodata value as a little-endian sample.
    pub fn nodata_bytes(&self) -> Option<Vec<u8>> {
        let v = self.nodata?;
        let whole = |min: f64, max: f64| (v.fract() == 0.0 && v >= min && v <= max).then_some(v as i64);
        Some(match self.sample_type {
            SampleType::U8 => (whole(0.0, 255.0)? as u8).to_le_bytes().to_vec(),
            SampleType::I8 => (whole(-128.0, 127.0)? as i8).to_le_bytes().to_vec(),
            SampleType::U16 => (whole(0.0, 65535.0)? as u16).to_le_bytes().to_vec(),
            SampleType::I16 => (whole(-32768.0, 32767.0)? as i16).to_le_bytes().to_vec(),
            SampleType::U32 => (whole(0.0, f64::from(u32::MAX))? as u32).to_le_bytes().to_vec(),
            SampleType::I32 => {
                (whole(f64::from(i32::MIN), f64::from(i32::MAX))? as i32).to_le_bytes().to_vec()
            }
            SampleType::F32 => (v as f32).to_le_bytes().to_vec(),
            SampleType::F64 => v.to_le_bytes().to_vec(),
        })
    }

    /// One byte a sample: 1 = a height, 0 = a void. `data` holds whole little-endian samples.
    pub fn valid(&self, data: &[u8]) -> Vec<u8> {
        if self.sample_type.is_float() {
            return self.valid_floats(data);
        }
        let width = self.sample_type.bytes();
        match self.nodata_bytes() {
            None => vec![1; data.len() / width],
            Some(void) => data.chunks_exact(width).map(|sample| u8::from(sample != void)).collect(),
        }
    }

    fn valid_floats(&self, data: &[u8]) -> Vec<u8> {
        let width = self.sample_type.bytes();
        let value = |sample: &[u8]| self.sample_type.value(sample);
        // A NaN nodata needs no comparison: every NaN is a void.
        let void = self.nodata_bytes().map(|b| value(&b)).filter(|v| !v.is_nan());
        match void {
            None => data.chunks_exact(width).map(|s| u8::from(value(s).is_finite())).collect(),
            Some(void) if void.abs() > HUGE => {
                let slack = if void.is_finite() { void.abs() * HUGE_TOLERANCE } else { 0.0 };
                let is_void = |v: f64| !v.is_finite() || (v - void).abs() <= slack;
                data.chunks_exact(width).map(|s| u8::from(!is_void(value(s)))).collect()
            }
            Some(void) => {
                let is_void = |v: f64| !v.is_finite() || v == void;
                data.chunks_exact(width).map(|s| u8::from(!is_void(value(s)))).collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodata_is_compared_in_the_type_of_the_samples() {
        let f32s = |v: &[f32]| v.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
        let data = f32s(&[f32::MIN, 1.0, f32::NAN, f32::INFINITY, -9999.9, -9999.0]);
        let valid = |nodata| Voids::new(SampleType::F32, nodata).valid(&data);
        assert_eq!(valid(None), [1, 1, 0, 0, 1, 1]);
        assert_eq!(valid(Some(-3.4028234663852886e38)), [0, 1, 0, 0, 1, 1]);
        assert_eq!(valid(Some(-3.40282e38)), [0, 1, 0, 0, 1, 1]);
        assert_eq!(valid(Some(-9999.9)), [1, 1, 0, 0, 0, 1]);
        assert_eq!(valid(Some(f64::NAN)), [1, 1, 0, 0, 1, 1]);
        assert_eq!(valid(Some(f64::MIN)), [1, 1, 0, 0, 1, 1]);
    }

    #[test]
    fn nodata_that_the_type_cannot_hold_matches_nothing() {
        for (t, nodata) in [(SampleType::U8, -9999.0), (SampleType::I16, 0.5), (SampleType::I32, f64::NAN)] {
            let voids = Voids::new(t, Some(nodata));
            assert!(voids.note().is_some());
            assert_eq!(voids.valid(&[0; 8]), vec![1; 8 / t.bytes()]);
        }
        let voids = Voids::new(SampleType::U32, Some(4294967295.0));
        assert_eq!(voids.valid(&[255, 255, 255, 255, 254, 255, 255, 255]), [0, 1]);
    }
}
