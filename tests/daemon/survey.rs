//! Surveys as uploads: the bundled ones, and hills made up.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use terraquilt::base::Result;
use terraquilt::base::date::Date;
use terraquilt::client::ingest::InMemory;
use terraquilt::db::{Change, Db, Ingest, Progress, fingerprint};
use terraquilt::format;
use terraquilt::height::source::{Affine, HeightSource, SampleType, Samples, SourceInfo, Window};
use terraquilt::wire::v1;

/// The surveys of Mount St. Helens that are in the repository: file, name, date, accuracy.
pub const HELENS: [(&str, &str, &str, f64); 5] = [
    ("survey_2000-09-25_native.tif", "crater-2000", "2000-09-25", 2.0),
    ("survey_2004-10-04_native.tif", "dome-2004-10-04", "2004-10-04", 0.5),
    ("survey_2004-10-11_native.tif", "dome-2004-10-11", "2004-10-11", 0.5),
    ("survey_2004-10-13_native.tif", "dome-2004-10-13", "2004-10-13", 0.5),
    ("crater_2005-06-15_10m.tif", "crater-2005", "2005-06-15", 2.0),
];

pub fn helens(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/st_helens").join(file)
}

/// A survey as it is said and sent.
#[derive(Clone)]
pub struct Survey {
    pub header: v1::UploadHeader,
    /// Rows of each grid.
    pub grids: Vec<Vec<u8>>,
}

impl Survey {
    pub fn rows(&self) -> InMemory {
        let row_bytes = self.header.grids.iter().map(|g| g.row_bytes().unwrap() as usize).collect();
        InMemory { grids: self.grids.clone(), row_bytes }
    }

    /// Rows of all grids.
    pub fn count(&self) -> u64 {
        self.header.grids.iter().map(|g| g.rows).sum()
    }

    /// Rows `[row, row + rows)` of a grid as one block.
    pub fn block(&self, grid: usize, row: u64, rows: u64) -> v1::SampleBlock {
        let n = self.header.grids[grid].row_bytes().unwrap();
        let samples = self.grids[grid][(row * n) as usize..((row + rows) * n) as usize].to_vec();
        v1::SampleBlock {
            grid: grid as u32,
            row,
            rows: rows as u32,
            packing: 0,
            crc32: terraquilt::wire::crc32(&samples),
            samples: samples.into(),
        }
    }

    pub fn called(mut self, operation: &str) -> Survey {
        self.header.operation = operation.into();
        self
    }
}

/// One file as one grid.
pub fn grid_of(source: &mut dyn HeightSource) -> (v1::Grid, Vec<u8>) {
    let info = source.info().clone();
    let all = Window { col: 0, row: 0, cols: info.cols as usize, rows: info.rows as usize };
    let samples = source.read(all).unwrap();
    (terraquilt::client::ingest::grid_of(&info).unwrap(), samples.data)
}

/// A bundled survey, with its hash.
pub fn bundled(k: usize) -> Survey {
    let (file, name, date, accuracy) = HELENS[k];
    let mut source = format::open(&helens(file)).unwrap();
    let (mut grid, rows) = grid_of(&mut *source);
    grid.hash = blake3::hash(&rows).as_bytes().to_vec().into();
    let header = v1::UploadHeader {
        operation: format!("upload of {name}"),
        name: name.into(),
        accuracy_m: Some(accuracy),
        date: date.into(),
        crs: source.info().crs.as_ref().map_or(String::new(), |c| c.code.clone()),
        vertical_datum: source.info().vertical_datum.clone().unwrap_or_default(),
        grids: vec![grid],
        ..Default::default()
    };
    Survey { header, grids: vec![rows] }
}

/// Made-up hills, float32, 10 m posts: `side` x `side` posts whose first lies `east` m to the east.
pub fn hills(name: &str, side: u64, east: f64, seed: u64) -> Survey {
    let mut rows = Vec::with_capacity((side * side * 4) as usize);
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    for j in 0..side {
        for i in 0..side {
            state ^= state >> 12;
            state ^= state << 25;
            state ^= state >> 27;
            let (x, y) = ((east + i as f64 * 10.0) / 300.0, j as f64 / 30.0);
            let noise = (state >> 40) as f64 / 2f64.powi(24);
            rows.extend_from_slice(&((900.0 + 80.0 * x.sin() * y.cos() + noise) as f32).to_le_bytes());
        }
    }
    let grid = v1::Grid {
        name: format!("{name}.grid"),
        cols: side,
        rows: side,
        sample_type: v1::SampleType::Float32 as i32,
        x: 560_000.0 + east,
        y: 5_110_000.0,
        col_dx: 10.0,
        row_dy: -10.0,
        ..Default::default()
    };
    let header = v1::UploadHeader {
        operation: format!("upload of {name}"),
        name: name.into(),
        accuracy_m: Some(1.0),
        date: "2020-01-01".into(),
        grids: vec![grid],
        ..Default::default()
    };
    Survey { header, grids: vec![rows] }
}

/// Ingests a bundled survey without a server.
pub fn offline(db: &Db, k: usize) {
    let (file, name, date, accuracy) = HELENS[k];
    ingest(db, name, date, accuracy, format::open(&helens(file)).unwrap());
}

/// The same of made-up hills: float32 without a mask.
pub fn offline_hills(db: &Db, s: &Survey) {
    let (h, g) = (&s.header, &s.header.grids[0]);
    let info = SourceInfo {
        affine: Some(Affine {
            origin: [g.x, g.y],
            col_step: [g.col_dx, g.col_dy],
            row_step: [g.row_dx, g.row_dy],
        }),
        crs: Some(db.crs().clone()),
        ..SourceInfo::new(g.name.clone(), "memory", [g.cols, g.rows], SampleType::F32)
    };
    let source = Memory { info, rows: s.grids[0].clone() };
    ingest(db, &h.name, &h.date, h.accuracy_m.unwrap(), Box::new(source));
}

/// A float32 grid in memory, all of it valid.
struct Memory {
    info: SourceInfo,
    rows: Vec<u8>,
}

impl HeightSource for Memory {
    fn info(&self) -> &SourceInfo {
        &self.info
    }
    fn set_nodata(&mut self, _: f64) {
        unreachable!("nobody does")
    }
    fn read(&mut self, w: Window) -> Result<Samples> {
        let (first, n) = (self.info.cols as usize * w.row as usize, w.cols * w.rows);
        assert_eq!((w.col, w.cols as u64), (0, self.info.cols));
        let data = self.rows[first * 4..(first + n) * 4].to_vec();
        Ok(Samples { cols: w.cols, rows: w.rows, data, valid: vec![1; n] })
    }
}

fn ingest(db: &Db, name: &str, date: &str, accuracy: f64, source: Box<dyn HeightSource>) {
    let request = Ingest {
        name: Some(name.into()),
        accuracy_m: Some(accuracy),
        date: Some(Date::parse(date).unwrap()),
        ..Ingest::new(vec![source])
    };
    change(db, Change::Ingest(request));
}

fn change(db: &Db, change: Change) {
    let stop = AtomicBool::new(false);
    let progress = Progress { report: &|_, _| (), stop: &stop };
    db.change(change, None, false, &progress, &mut || {}).unwrap();
}

pub fn print(db: &Db) -> String {
    fingerprint(&db.snapshot(None).unwrap()).unwrap()
}
