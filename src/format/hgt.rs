//! SRTM tiles (`.hgt`): a square of big-endian `int16` samples without any header.
//!
//! The name gives the south-west corner (`N44W072.hgt`: 44 north, 72 west), the size the number of posts
//! a side. Posts lie exactly on the degree lines: first and last row and column are shared with the
//! neighbours. The first row is the northernmost. -32768 is a void.
//!
//! Format and accuracy (16 m absolute, LE90): Farr et al., The Shuttle Radar Topography Mission, Reviews of
//! Geophysics 45, 2007.

use super::input::Input;
use super::raw::{Layout, RawGrid};
use crate::base::{Error, Result};
use crate::height::crs::Crs;
use crate::height::source::{Affine, SampleType, SourceInfo};
use std::path::Path;

const POST_BYTES: u64 = 2;
const VOID: f64 = -32768.0;
/// Posts a side of the tiles that exist: 3, 1 and half an arc-second.
const SIDES: [u64; 3] = [1201, 3601, 7201];
/// Published absolute vertical accuracy (LE90) of SRTM.
const ACCURACY_M: f64 = 16.0;

/// Opens a tile; its size is looked at, no sample is read.
///
/// # Errors
/// [`Error::Invalid`] if the name does not give a corner, [`Error::Corrupt`] if the size is not that of a tile.
pub fn open(input: Input) -> Result<RawGrid> {
    let file = input.file.clone();
    let span_bytes = input.span_bytes();
    let Some(side) = SIDES.into_iter().find(|n| n * n * POST_BYTES == span_bytes) else {
        let sizes: Vec<String> = SIDES.iter().map(|n| (n * n * POST_BYTES).to_string()).collect();
        let reason = format!("{span_bytes} bytes, but an HGT tile has {}", sizes.join(" or "));
        return Err(Error::corrupt(file, "size", reason));
    };
    let (south, west) = corner_of(&file).ok_or_else(|| {
        let reason = "the name gives no corner; rename it to one like N44W072.hgt (south-west corner)";
        Error::invalid(&file, reason)
    })?;
    let step_deg = 1.0 / (side - 1) as f64;
    let info = SourceInfo {
        file,
        format: "HGT",
        cols: side,
        rows: side,
        sample_type: SampleType::I16,
        affine: Some(Affine {
            origin: [f64::from(west), f64::from(south + 1)],
            col_step: [step_deg, 0.0],
            row_step: [0.0, -step_deg],
        }),
        crs: Some(Crs::from_epsg(4326)?),
        nodata: Some(VOID),
        scale: 1.0,
        offset: 0.0,
        accuracy_m: Some(ACCURACY_M),
        product: Some("SRTM"),
        // SRTM counts from the EGM96 geoid, in metres.
        vertical_datum: Some("EPSG:5773".to_string()),
        vertical_unit_m: Some(1.0),
        notes: Vec::new(),
    };
    let row_stride = side * POST_BYTES;
    RawGrid::new(info, input, Layout { at: 0, sample_stride: POST_BYTES, row_stride, big_endian: true })
}

/// South and west edge in whole degrees, from the first seven letters of the file's name.
fn corner_of(name: &str) -> Option<(i32, i32)> {
    let stem = Path::new(name).file_name()?.to_str()?.to_ascii_uppercase();
    let b = stem.as_bytes();
    if b.len() < 7 || !matches!(b.get(7), None | Some(b'.' | b'_' | b'-')) {
        return None;
    }
    let number = |digits: &[u8]| -> Option<i32> {
        digits.iter().try_fold(0, |n, d| d.is_ascii_digit().then(|| n * 10 + i32::from(d - b'0')))
    };
    let (lat, lon) = (number(&b[1..3])?, number(&b[4..7])?);
    let south = match b[0] {
        b'N' => lat,
        b'S' => -lat,
        _ => return None,
    };
    let west = match b[3] {
        b'E' => lon,
        b'W' => -lon,
        _ => return None,
    };
    ((-90..90).contains(&south) && (-180..180).contains(&west)).then_some((south, west))
}

#[cfg(test)]
mod tests {
    use super::super::sidecar::Beside;
    use super::*;
    use crate::height::source::{HeightSource, Window};

    fn tile(name: &str, bytes: Vec<u8>) -> Result<RawGrid> {
        open(Input::memory(name, bytes, Beside::Nothing))
    }

    #[test]
    fn the_name_gives_the_south_west_corner() {
        assert_eq!(corner_of("N44W072.hgt"), Some((44, -72)));
        assert_eq!(corner_of("dir/s01e179.SRTMGL1.hgt"), Some((-1, 179)));
        for bad in [
            "N90E000.hgt",
            "N44W181.hgt",
            "X44W072.hgt",
            "N4W072.hgt",
            "N44W0720.hgt",
            "N44W07\u{e9}.hgt",
            "",
        ] {
            assert_eq!(corner_of(bad), None, "{bad}");
        }
    }

    #[test]
    fn rows_run_from_north_and_samples_are_turned_to_little_endian() {
        let n = 1201usize;
        let mut bytes = vec![0u8; n * n * 2];
        bytes[..2].copy_from_slice(&300i16.to_be_bytes());
        bytes[2..4].copy_from_slice(&(-32768i16).to_be_bytes());
        let last = bytes.len() - 2;
        bytes[last..].copy_from_slice(&(-7i16).to_be_bytes());
        let mut tile = tile("N00E010.hgt", bytes).unwrap();
        let a = tile.info().affine.unwrap();
        assert_eq!(a.origin, [10.0, 1.0]);
        let end = |i: usize| a.origin[i] + 1200.0 * (a.col_step[i] + a.row_step[i]);
        assert!((end(0) - 11.0).abs() < 1e-12 && end(1).abs() < 1e-12);
        let s = tile.read(Window { col: 0, row: 0, cols: 2, rows: 1 }).unwrap();
        assert_eq!((s.data, s.valid), (vec![44, 1, 0, 128], vec![1, 0]));
        let s = tile.read(Window { col: 1200, row: 1200, cols: 1, rows: 1 }).unwrap();
        assert_eq!(s.data, (-7i16).to_le_bytes());
        assert!(tile.read(Window { col: 1200, row: 0, cols: 2, rows: 1 }).is_err());
        assert!(tile.read(Window { col: u64::MAX, row: 0, cols: 2, rows: 1 }).is_err());
    }

    #[test]
    fn other_sizes_are_refused_with_both_numbers() {
        let e = tile("N00E010.hgt", vec![0; 1000]).err().unwrap().to_string();
        assert!(e.contains("1000") && e.contains("2884802"), "{e}");
        assert!(tile("tile.hgt", vec![0; 2884802]).is_err());
    }
}
