//! DTED levels 0, 1 and 2 (`.dt0`, `.dt1`, `.dt2`): three headers, then one record a meridian, west to east.
//!
//! A record runs from south to north: sentinel, counts, big-endian samples as sign and magnitude, and a checksum
//! over all of it, which every read holds against the bytes. -32767 is a void. Posts lie on the degree lines.
//! Layout: MIL-PRF-89020B, Performance Specification Digital Terrain Elevation Data (2000), section 3.13; the accuracy
//! is the absolute vertical one of the ACC record (metres, 90 %).

use super::geotiff::shorten;
use super::input::Input;
use super::voids::Voids;
use super::window;
use crate::base::{Error, Result};
use crate::height::crs::Crs;
use crate::height::source::{Affine, HeightSource, SampleType, Samples, SourceInfo, Window};

/// User header label, data set identification, accuracy description.
const UHL_BYTES: u64 = 80;
const DSI_BYTES: u64 = 648;
const ACC_BYTES: u64 = 2700;
/// Labels of a tape that may stand before, 80 bytes each.
const TAPE_LABELS_MAX: u64 = 4;
const RECORD_HEAD_BYTES: usize = 8;
const RECORD_SENTINEL: u8 = 0xaa;
const CHECKSUM_BYTES: usize = 4;
const POST_BYTES: usize = 2;
const VOID: f64 = -32767.0;
/// Below any ground; more negative samples are two's complement, against the specification.
const LOWEST: i16 = -16000;

/// Whether a file begins with a user header label, or with a tape's labels before one.
pub fn begins(head: &[u8]) -> bool {
    let labels = head.chunks_exact(UHL_BYTES as usize);
    head.starts_with(b"UHL1")
        || (head.starts_with(b"VOL1") || head.starts_with(b"HDR1"))
            && labels.take(TAPE_LABELS_MAX as usize + 1).any(|l| l.starts_with(b"UHL1"))
}

/// One cell of DTED.
pub struct Dted {
    info: SourceInfo,
    input: Input,
    /// Byte of the first record.
    records_at: u64,
    voids: Voids,
}

impl Dted {
    /// Opens a cell by its headers; no sample is read.
    ///
    /// # Errors
    /// [`Error::Corrupt`] for headers that are not understood or do not fit the size of the file.
    pub fn open(input: Input) -> Result<Dted> {
        let mut labels = 0;
        let headers = loop {
            let mut bytes = vec![0; (UHL_BYTES + DSI_BYTES + ACC_BYTES) as usize];
            input.fill(labels * UHL_BYTES, &mut bytes, "header")?;
            if bytes.starts_with(b"UHL1") {
                break Headers { file: input.file.clone(), bytes };
            }
            labels += 1;
            if labels > TAPE_LABELS_MAX {
                return Err(Error::corrupt(&input.file, "header", "no user header label (UHL1)"));
            }
        };
        let (cols, rows) =
            (headers.number(47..51, "meridians")?, headers.number(51..55, "posts of a meridian")?);
        window::check_size(&input.file, cols, rows)?;
        // Tenths of arc-seconds.
        let step = |range, what| Ok::<f64, Error>(headers.number(range, what)? as f64 / 36000.0);
        let (dx, dy) = (step(20..24, "longitude interval")?, step(24..28, "latitude interval")?);
        if dx == 0.0 || dy == 0.0 {
            return Err(Error::corrupt(&input.file, "user header label", "an interval is zero"));
        }
        let (west, south) = (headers.angle(4, 180.0)?, headers.angle(12, 90.0)?);
        let north = south + (rows - 1) as f64 * dy;
        let mut notes = Vec::new();
        let mut info = SourceInfo {
            file: input.file.clone(),
            format: "DTED",
            cols,
            rows,
            sample_type: SampleType::I16,
            affine: Some(Affine { origin: [west, north], col_step: [dx, 0.0], row_step: [0.0, -dy] }),
            crs: headers.crs(&mut notes)?,
            nodata: Some(VOID),
            scale: 1.0,
            offset: 0.0,
            accuracy_m: headers.accuracy_m(),
            product: Some("DTED"),
            vertical_datum: None,
            vertical_unit_m: None,
            notes,
        };
        let records_at = labels * UHL_BYTES + UHL_BYTES + DSI_BYTES + ACC_BYTES;
        let wanted = records_at + cols * record_bytes(rows) as u64;
        if input.span_bytes() < wanted {
            let reason = format!(
                "{cols} meridians of {rows} posts need {wanted} bytes, the file has {}",
                input.span_bytes()
            );
            return Err(Error::corrupt(&input.file, "size", reason));
        }
        let voids = Voids::of(&mut info);
        Ok(Dted { info, input, records_at, voids })
    }

    /// Reads a meridian's record and holds it against its checksum.
    fn record(&self, col: u64, record: &mut [u8]) -> Result<()> {
        let place = || format!("record of meridian {col}");
        self.input.fill(self.records_at + col * record.len() as u64, record, "records")?;
        if record[0] != RECORD_SENTINEL {
            let reason = format!("it begins with byte {:#04x}, not {RECORD_SENTINEL:#04x}", record[0]);
            return Err(Error::corrupt(&self.info.file, place(), reason));
        }
        let (summed, sum) = record.split_at(record.len() - CHECKSUM_BYTES);
        let found = summed.iter().fold(0u32, |n, b| n.wrapping_add(u32::from(*b)));
        let stored = sum.iter().fold(0u32, |n, b| n << 8 | u32::from(*b));
        if found != stored {
            let reason = format!(
                "checksum {stored}, but the bytes sum up to {found}; if its producer never wrote right ones, \
                 convert it: gdal_translate INPUT OUTPUT.tif"
            );
            return Err(Error::corrupt(&self.info.file, place(), reason));
        }
        Ok(())
    }
}

fn record_bytes(rows: u64) -> usize {
    RECORD_HEAD_BYTES + rows as usize * POST_BYTES + CHECKSUM_BYTES
}

impl HeightSource for Dted {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn set_nodata(&mut self, value: f64) {
        self.info.nodata = Some(value);
        self.voids = Voids::of(&mut self.info);
    }

    fn read(&mut self, w: Window) -> Result<Samples> {
        window::check(&self.info, w)?;
        let mut data = vec![0; w.cols * w.rows * POST_BYTES];
        let mut record = vec![0; record_bytes(self.info.rows)];
        for col in 0..w.cols {
            self.record(w.col + col as u64, &mut record)?;
            for row in 0..w.rows {
                let from_south = (self.info.rows - 1 - w.row) as usize - row;
                let at = RECORD_HEAD_BYTES + from_south * POST_BYTES;
                let bits = u16::from_be_bytes([record[at], record[at + 1]]);
                let size = (bits & 0x7fff) as i16;
                let sample = if bits & 0x8000 == 0 { size } else { -size };
                if sample < LOWEST && f64::from(sample) != VOID {
                    let place = format!("meridian {}, row {}", w.col + col as u64, w.row + row as u64);
                    let reason = format!("{sample} m: negative heights must be sign and magnitude");
                    return Err(Error::corrupt(&self.info.file, place, reason));
                }
                let to = (row * w.cols + col) * POST_BYTES;
                data[to..to + POST_BYTES].copy_from_slice(&sample.to_le_bytes());
            }
        }
        let valid = self.voids.valid(&data);
        Ok(Samples { cols: w.cols, rows: w.rows, data, valid })
    }

    /// Every read passes over the records of all meridians.
    fn row_batch(&self) -> usize {
        window::tall_batch(&self.info)
    }
}

/// The three headers, from the user header label on.
struct Headers {
    file: String,
    bytes: Vec<u8>,
}

impl Headers {
    fn text(&self, range: std::ops::Range<usize>) -> String {
        String::from_utf8_lossy(&self.bytes[range]).trim_matches(['\0', ' ']).to_string()
    }

    fn number(&self, range: std::ops::Range<usize>, what: &str) -> Result<u64> {
        let text = self.text(range);
        text.parse().map_err(|_| {
            let reason = format!("'{}' is not a number of {what}", shorten(&text));
            Error::corrupt(&self.file, "user header label", reason)
        })
    }

    /// Degrees, minutes, seconds and hemisphere (DDDMMSSH) at a byte of the user header label.
    fn angle(&self, at: usize, most: f64) -> Result<f64> {
        let part = |from: usize, n: usize| Ok::<f64, Error>(self.number(from..from + n, "an angle")? as f64);
        let degrees = part(at, 3)? + part(at + 3, 2)? / 60.0 + part(at + 5, 2)? / 3600.0;
        let signed = match self.bytes[at + 7] {
            b'E' | b'N' => degrees,
            b'W' | b'S' => -degrees,
            _ => f64::NAN,
        };
        if signed.is_nan() || degrees > most {
            let reason = format!("'{}' is no origin (DDDMMSSH)", shorten(&self.text(at..at + 8)));
            return Err(Error::corrupt(&self.file, "user header label", reason));
        }
        Ok(signed)
    }

    /// By the horizontal datum of the data set identification.
    fn crs(&self, notes: &mut Vec<String>) -> Result<Option<Crs>> {
        let at = UHL_BYTES as usize + 144;
        match self.text(at..at + 5).as_str() {
            "WGS84" => Crs::from_epsg(4326).map(Some),
            "WGS72" => Crs::from_epsg(4322).map(Some),
            other => {
                notes.push(format!(
                    "the horizontal datum '{}' is not known; name the CRS with --crs",
                    shorten(other)
                ));
                Ok(None)
            }
        }
    }

    /// The absolute vertical accuracy; `NA` means that it is not known.
    fn accuracy_m(&self) -> Option<f64> {
        let at = (UHL_BYTES + DSI_BYTES) as usize;
        let label = self.text(at..at + 3);
        let metres: u32 = self.text(at + 7..at + 11).parse().ok()?;
        (label == "ACC" && metres > 0).then_some(f64::from(metres))
    }
}

#[cfg(test)]
mod tests {
    use super::super::sidecar::Beside;
    use super::*;

    /// A cell of 3 meridians and 4 posts, 30 arc-seconds apart, south-west corner 1 S 71 W.
    fn cell(samples: [[u16; 4]; 3], accuracy: &str) -> Vec<u8> {
        let mut bytes =
            format!("{:<80}", "UHL10710000W0010000S03000300NA  U              000300040").into_bytes();
        let mut dsi = vec![b' '; DSI_BYTES as usize];
        dsi[..4].copy_from_slice(b"DSIU");
        dsi[144..149].copy_from_slice(b"WGS84");
        bytes.extend(dsi);
        let mut acc = vec![b' '; ACC_BYTES as usize];
        acc[..11].copy_from_slice(format!("ACCNA  {accuracy:<4}").as_bytes());
        bytes.extend(acc);
        for (i, column) in samples.iter().enumerate() {
            let mut record = vec![RECORD_SENTINEL, 0, 0, i as u8, 0, i as u8, 0, 0];
            record.extend(column.iter().flat_map(|s| s.to_be_bytes()));
            let sum: u32 = record.iter().map(|b| u32::from(*b)).sum();
            record.extend(sum.to_be_bytes());
            bytes.extend(record);
        }
        bytes
    }

    fn open(bytes: Vec<u8>) -> Result<Dted> {
        Dted::open(Input::memory("w071s01.dt0", bytes, Beside::Nothing))
    }

    const COLUMNS: [[u16; 4]; 3] = [[1, 2, 3, 4], [0x8005, 6, 7, 8], [9, 0xffff, 11, 12]];

    #[test]
    fn meridians_become_columns_and_magnitudes_heights() {
        let mut d = open(cell(COLUMNS, "0018")).unwrap();
        let a = d.info().affine.unwrap();
        assert_eq!((a.origin[0], d.info().accuracy_m), (-71.0, Some(18.0)));
        assert!((a.origin[1] - (-1.0 + 3.0 / 120.0)).abs() < 1e-12, "{a:?}");
        let s = d.read(Window { col: 0, row: 0, cols: 3, rows: 4 }).unwrap();
        let heights: Vec<i16> = s.data.chunks(2).map(|b| i16::from_le_bytes([b[0], b[1]])).collect();
        assert_eq!(heights, [4, 8, 12, 3, 7, 11, 2, 6, -32767, 1, -5, 9]);
        assert_eq!(s.valid.iter().position(|v| *v == 0), Some(8));
        let s = d.read(Window { col: 1, row: 2, cols: 1, rows: 2 }).unwrap();
        assert_eq!(s.data, [6, 0, 251, 255]);
        assert_eq!(open(cell(COLUMNS, "NA")).unwrap().info().accuracy_m, None);
    }

    #[test]
    fn tape_labels_before_the_header_are_skipped() {
        let bytes = [format!("{:<80}{:<80}", "VOL1", "HDR1").into_bytes(), cell(COLUMNS, "NA")].concat();
        assert!(begins(&bytes) && !begins(b"VOL1") && begins(b"UHL1"));
        let mut d = open(bytes).unwrap();
        assert!(d.read(Window { col: 2, row: 0, cols: 1, rows: 4 }).is_ok());
    }

    #[test]
    fn a_wrong_checksum_and_twos_complement_are_damage() {
        let good = cell(COLUMNS, "NA");
        let mut flipped = good.clone();
        let last = flipped.len() - 5;
        flipped[last] ^= 1;
        let whole = Window { col: 0, row: 0, cols: 3, rows: 4 };
        let text = open(flipped).unwrap().read(whole).unwrap_err().to_string();
        assert!(text.contains("meridian 2") && text.contains("checksum"), "{text}");
        let mut columns = COLUMNS;
        columns[1][2] = (-5i16) as u16;
        let text = open(cell(columns, "NA")).unwrap().read(whole).unwrap_err().to_string();
        assert!(text.contains("meridian 1, row 1") && text.contains("magnitude"), "{text}");
        let text = open(good[..good.len() - 1].to_vec()).err().unwrap().to_string();
        assert!(text.contains(&good.len().to_string()), "{text}");
    }
}
