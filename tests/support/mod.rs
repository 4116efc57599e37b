//! What several subjects need: sources in memory, databases in temporary folders, the program itself.

/// A disk whose power can be cut.
pub mod power;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::atomic::AtomicBool;
use terraquilt::base::Result;
use terraquilt::base::date::Date;
use terraquilt::db::{Change, Db, Ingest, Options, Outcome, Policy, Progress};
use terraquilt::height::crs::Crs;
use terraquilt::height::patch::Kind;
use terraquilt::height::source::{Affine, HeightSource, SampleType, Samples, SourceInfo, Window};

/// A small generator (xorshift64*): seeds are printed and can be passed back with TERRAQUILT_SEED.
#[derive(Clone)]
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        let mut r = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        (0..4).for_each(|_| {
            r.next();
        });
        r
    }
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }
    /// Uniform in [0, n).
    pub fn below(&mut self, n: u64) -> u64 {
        self.next() % n.max(1)
    }
    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
    pub fn chance(&mut self, p: f64) -> bool {
        self.unit() < p
    }
    pub fn shuffle<T>(&mut self, v: &mut [T]) {
        for k in (1..v.len()).rev() {
            v.swap(k, self.below(k as u64 + 1) as usize);
        }
    }
}

/// The first seed of a test, and how many: TERRAQUILT_SEED=n runs that one only.
pub fn seeds(count: u64) -> Vec<u64> {
    match std::env::var("TERRAQUILT_SEED") {
        Ok(s) => vec![s.parse().expect("TERRAQUILT_SEED is a number")],
        Err(_) => (1..=count).collect(),
    }
}

/// A grid in memory, float32, NaN = void.
#[derive(Clone, Debug)]
pub struct Grid {
    pub name: String,
    pub cols: usize,
    pub rows: usize,
    pub z: Vec<f32>,
    pub affine: Affine,
    pub accuracy: f64,
    pub precedence: Option<i64>,
    pub date: Option<Date>,
}

impl Grid {
    /// A rectangle of the grid, as a file of its own.
    pub fn cut(&self, col: usize, row: usize, cols: usize, rows: usize) -> Grid {
        let a = &self.affine;
        let at = |k: usize| a.origin[k] + col as f64 * a.col_step[k] + row as f64 * a.row_step[k];
        let mut z = Vec::with_capacity(cols * rows);
        for r in row..row + rows {
            z.extend_from_slice(&self.z[r * self.cols + col..r * self.cols + col + cols]);
        }
        Grid { cols, rows, z, affine: Affine { origin: [at(0), at(1)], ..*a }, ..self.clone() }
    }

    pub fn source(&self) -> Box<dyn HeightSource> {
        self.source_in("EPSG:32610")
    }

    /// The same file, said to be in another system.
    pub fn source_in(&self, crs: &str) -> Box<dyn HeightSource> {
        Box::new(GridSource {
            info: SourceInfo {
                affine: Some(self.affine),
                crs: Some(Crs::parse(crs).unwrap()),
                nodata: Some(f64::NAN),
                ..SourceInfo::new(
                    format!("{}-{}-{}.mem", self.name, self.affine.origin[0], self.affine.origin[1]),
                    "memory",
                    [self.cols as u64, self.rows as u64],
                    SampleType::F32,
                )
            },
            z: self.z.clone(),
        })
    }

    pub fn ingest(&self) -> Ingest {
        Ingest { name: Some(self.name.clone()), ..self.tiles_of(vec![self.source()]) }
    }

    /// An ingest of tiles of this survey.
    pub fn tiles_of(&self, sources: Vec<Box<dyn HeightSource>>) -> Ingest {
        Ingest {
            accuracy_m: Some(self.accuracy),
            date: self.date,
            precedence: self.precedence,
            ..Ingest::new(sources)
        }
    }
}

struct GridSource {
    info: SourceInfo,
    z: Vec<f32>,
}

impl HeightSource for GridSource {
    fn info(&self) -> &SourceInfo {
        &self.info
    }
    fn set_nodata(&mut self, value: f64) {
        self.info.nodata = Some(value);
    }
    fn read(&mut self, w: Window) -> Result<Samples> {
        let mut s = Samples { cols: w.cols, rows: w.rows, ..Samples::default() };
        for r in 0..w.rows {
            let at = (w.row as usize + r) * self.info.cols as usize + w.col as usize;
            for v in &self.z[at..at + w.cols] {
                s.data.extend_from_slice(&v.to_le_bytes());
                s.valid.push(u8::from(v.is_finite()));
            }
        }
        Ok(s)
    }
    fn row_batch(&self) -> usize {
        17
    }
}

/// Hills with ridges and flats, whole metres: the same ground for every survey of a world.
pub fn ground(x: f64, y: f64) -> f64 {
    let a = (x / 310.0).sin() * (y / 170.0).cos() * 60.0;
    let b = ((x + 2.0 * y) / 47.0).sin() * 9.0 + ((3.0 * x - y) / 23.0).cos() * 4.0;
    let c = ((x * 0.71 + y * 1.13) / 9.0).sin() * 2.0;
    let flat = (x / 900.0).sin() * (y / 700.0).sin();
    500.0 + a + if flat > 0.3 { 0.0 } else { b + c }
}

/// A random survey near the point (500000, 4000000): turned or not, with holes or not.
pub fn random_grid(r: &mut Random, name: &str, posts_max: usize) -> Grid {
    let cols = 20 + r.below(posts_max as u64 - 20) as usize;
    let rows = 20 + r.below(posts_max as u64 - 20) as usize;
    let step = [1.0, 2.0, 2.5, 5.0, 10.0][r.below(5) as usize];
    let angle = if r.chance(0.5) { 0.0 } else { (r.unit() * 360.0f64).to_radians() };
    let shear = if r.chance(0.1) { 0.2 } else { 0.0 };
    let (c, s) = (angle.cos(), angle.sin());
    let on = if r.chance(0.4) { 10.0 } else { 0.01 };
    let at = |v: f64| (v / on).round() * on;
    let affine = Affine {
        origin: [at(500_000.0 + r.unit() * 400.0 - 200.0), at(4_000_000.0 + r.unit() * 400.0 - 200.0)],
        col_step: [step * c, step * s],
        row_step: [step * (s + shear * c), -step * (c - shear * s)],
    };
    let mut z = Vec::with_capacity(cols * rows);
    let noise = r.below(3) as f64;
    let lift = if r.chance(0.3) { 20.0 } else { 0.0 };
    for j in 0..rows {
        for i in 0..cols {
            let p = [0, 1]
                .map(|k| affine.origin[k] + i as f64 * affine.col_step[k] + j as f64 * affine.row_step[k]);
            let h = ground(p[0] - 500_000.0, p[1] - 4_000_000.0) + lift + (r.unit() - 0.5) * noise;
            z.push(h.round() as f32);
        }
    }
    if r.chance(0.6) {
        for _ in 0..1 + r.below(4) {
            let (ci, cj) = (r.below(cols as u64) as i64, r.below(rows as u64) as i64);
            let radius = r.below(12) as i64;
            for j in 0..rows as i64 {
                for i in 0..cols as i64 {
                    if (i - ci).pow(2) + (j - cj).pow(2) <= radius * radius {
                        z[j as usize * cols + i as usize] = f32::NAN;
                    }
                }
            }
        }
    }
    Grid {
        name: name.to_string(),
        cols,
        rows,
        z,
        affine,
        accuracy: [0.0, 0.1, 0.5, 1.0, 1.0, 3.0][r.below(6) as usize],
        precedence: Some(r.below(4) as i64),
        date: None,
    }
}

/// A new database in a temporary folder.
pub struct Scratch {
    pub db: Db,
    pub folder: tempfile::TempDir,
}

impl Scratch {
    pub fn new(policy: Policy) -> Scratch {
        Scratch::of(policy, Kind::Bilinear)
    }
    /// With patches of a kind.
    pub fn of(policy: Policy, patch: Kind) -> Scratch {
        let folder = tempfile::tempdir().unwrap();
        let options = Options { crs: Crs::from_epsg(32610).unwrap(), policy, patch };
        let db = Db::create(&folder.path().join("db"), &options).unwrap();
        Scratch { db, folder }
    }
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("db")
    }
    pub fn change(&self, c: Change) -> Result<Outcome> {
        change(&self.db, c)
    }
    pub fn ingest(&self, g: &Grid) -> Outcome {
        self.change(Change::Ingest(g.ingest())).unwrap()
    }
    pub fn remove(&self, name: &str) -> Outcome {
        self.change(Change::Remove { surveys: vec![name.to_string()], tile: None }).unwrap()
    }
    pub fn fingerprint(&self) -> String {
        terraquilt::db::fingerprint(&self.db.snapshot(None).unwrap()).unwrap()
    }
    /// Everything that `verify` checks.
    pub fn verify(&self) {
        let stop = AtomicBool::new(false);
        let s = self.db.snapshot(None).unwrap();
        let r = terraquilt::db::verify(&self.db, &s, &Progress { report: &|_, _| (), stop: &stop }).unwrap();
        assert!(r.ok, "{:#?}", r.problems);
    }
}

/// Commits a change without a bar.
pub fn change(db: &Db, c: Change) -> Result<Outcome> {
    let stop = AtomicBool::new(false);
    db.change(c, None, false, &Progress { report: &|_, _| (), stop: &stop }, &mut || ())
}

/// Runs the program in a new process.
pub fn program(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_terraquilt")).args(args).output().expect("the program starts")
}

/// Runs the program and gives what it printed; fails unless it exits with 0.
pub fn printed(args: &[&str]) -> String {
    let out = program(args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).expect("the program prints UTF-8")
}

/// The program's error: it must exit with `code` and one line that starts with `error:`.
pub fn refused(args: &[&str], code: i32) -> String {
    let out = program(args);
    let text = String::from_utf8_lossy(&out.stderr).to_string();
    assert_eq!(out.status.code(), Some(code), "{args:?}: {text}");
    assert!(text.contains("error:"), "{args:?}: {text}");
    text
}

/// A file of the shared data, or `None` (with a message) where they are absent.
pub fn shared(path: &str) -> Option<PathBuf> {
    let full = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(path);
    if full.exists() {
        return Some(full);
    }
    assert!(std::env::var_os("TERRAQUILT_REQUIRE_SHARED").is_none(), "{} is absent", full.display());
    println!("shared data absent: skipped ({path})");
    None
}

/// A file that comes with the repository.
pub fn bundled(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}
