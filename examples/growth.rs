//! What a query, an arrival and a removal cost as a database grows: in posts, and in surveys over one place.
//!
//! `cargo run --release --example growth -- [--sizes 1025,4097] [--counts 1,10,100] [--db DB]`
//!
//! Three tables. *Size*: bases of so many posts a side (and DB, which is copied first), on each the same small question and
//! the same survey of 257 x 257 posts that comes and goes. *One place*: small surveys lie one over the other under the survey
//! that comes and goes. *Beside*: as many lie side by side, and the survey and the question touch none of them. Work is counted
//! where it can be: what is counted must not grow with the base, and with surveys only where they are touched. Takes about two
//! minutes; with 1000 surveys, far longer.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;
use terraquilt::base::{Error, Result};
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::db::{Change, Db, Ingest, Options, Outcome, Policy, Progress};
use terraquilt::height::source::{Affine, HeightSource, SampleType, Samples, SourceInfo, Window};
use terraquilt::height::{crs::Crs, patch::Kind, surface::Blend};

/// Posts of one side of the survey that comes and goes, and of those that pile up.
const COMES: usize = 257;
const PILED: usize = 65;
/// Metres from post to post: of the bases, of the survey that comes and goes, of those that pile up.
const BASE_STEP: f64 = 10.0;
const STEP: f64 = 5.0;
const PILED_STEP: f64 = 2.5;
/// How often the survey comes and goes; the first time is not counted.
const ROUNDS: usize = 6;
/// Repeats of the question.
const QUESTIONS: usize = 200;
/// Where the bases have their middle, metres east and north, where no other database is named.
const MIDDLE: [f64; 2] = [500_000.0, 4_000_000.0];

/// Hills of all sizes, metres: the same ground for every survey.
fn ground(x: f64, y: f64) -> f32 {
    let mut z = 900.0;
    let (mut long, mut high) = (9000.0, 300.0);
    for k in 0..9 {
        let (s, c) = (f64::from(k) * 1.9 + 0.4).sin_cos();
        z += ((x * c + y * s) / long).sin() * ((y * c - x * s) / long * 1.3).cos() * high;
        (long, high) = (long * 0.47, high * 0.52);
    }
    (z * 10.0).round() as f32 / 10.0
}

/// A square survey of that ground, made up as it is read.
struct Square {
    info: SourceInfo,
    affine: Affine,
}

impl Square {
    /// With its middle at a place, turned by some degrees.
    fn new(posts: usize, step: f64, middle: [f64; 2], degrees: f64, crs: &Crs) -> Square {
        let (s, c) = degrees.to_radians().sin_cos();
        let (col_step, row_step) = ([step * c, step * s], [step * s, -step * c]);
        let half = (posts - 1) as f64 / 2.0;
        let origin =
            [0, 1].map(|k| ((middle[k] - half * (col_step[k] + row_step[k])) * 100.0).round() / 100.0);
        let affine = Affine { origin, col_step, row_step };
        let info = SourceInfo {
            affine: Some(affine),
            crs: Some(crs.clone()),
            ..SourceInfo::new(
                format!("made-up-{posts}"),
                "memory",
                [posts as u64, posts as u64],
                SampleType::F32,
            )
        };
        Square { info, affine }
    }

    fn ingest(self, name: &str, accuracy_m: f64) -> Change {
        Change::Ingest(Ingest {
            name: Some(name.into()),
            accuracy_m: Some(accuracy_m),
            ..Ingest::new(vec![Box::new(self)])
        })
    }
}

impl HeightSource for Square {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn set_nodata(&mut self, value: f64) {
        self.info.nodata = Some(value);
    }

    fn read(&mut self, w: Window) -> Result<Samples> {
        let mut data = Vec::with_capacity(w.cols * w.rows * 4);
        for row in 0..w.rows {
            for col in 0..w.cols {
                let (i, j) = ((w.col as usize + col) as f64, (w.row as usize + row) as f64);
                let a = &self.affine;
                let [x, y] = [0, 1].map(|k| a.origin[k] + i * a.col_step[k] + j * a.row_step[k]);
                data.extend_from_slice(&ground(x, y).to_le_bytes());
            }
        }
        Ok(Samples { cols: w.cols, rows: w.rows, data, valid: vec![1; w.cols * w.rows] })
    }
}

/// Carries a change out; returns what it did and the milliseconds until it was durable.
fn change(db: &Db, change: Change) -> Result<(Outcome, f64)> {
    let (stop, quiet) = (AtomicBool::new(false), |_: &str, _: f64| ());
    let started = Instant::now();
    let done = db.change(change, None, false, &Progress { report: &quiet, stop: &stop }, &mut || ())?;
    Ok((done, started.elapsed().as_secs_f64() * 1e3))
}

/// The median of some times.
fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// One line of a table: a small question, a survey that comes and goes, at a place of a database.
fn line(db: &Db, what: &str, at: [f64; 2]) -> Result<()> {
    let arriving = || Square::new(COMES, STEP, at, 17.0, db.crs()).ingest("comes and goes", 0.5);
    let leaving = || Change::Remove { surveys: vec!["comes and goes".into()], tile: None };
    let (mut come, mut go) = (Vec::new(), Vec::new());
    let (mut came, mut went) = (Outcome::default(), Outcome::default());
    for _ in 0..ROUNDS {
        let (done, ms) = change(db, arriving())?;
        came = done;
        come.push(ms);
        let (done, ms) = change(db, leaving())?;
        went = done;
        go.push(ms);
    }
    // The question is asked where nothing came and went.
    let area = Area::Box([at[0] - 640.0, at[1] - 640.0, at[0] + 640.0, at[1] + 640.0]);
    let query = Query { area, tolerance: Tolerance::Constant(2.0), how: Blend::Exact.into() };
    let snapshot = db.snapshot(None)?;
    let found = snapshot.select(&query)?;
    let mut asked = Vec::new();
    for _ in 0..QUESTIONS {
        let started = Instant::now();
        std::hint::black_box(snapshot.select(&query)?);
        asked.push(started.elapsed().as_secs_f64() * 1e6);
    }
    let started = Instant::now();
    db.snapshot(None)?;
    let opened = started.elapsed().as_secs_f64() * 1e3;
    let commit = |o: &Outcome, times: &[f64]| {
        let records = o.records_gone + o.records_come;
        format!(
            "{:8.1}{:8}{:9}{:8}",
            median(times[1..].to_vec()),
            o.tops_computed,
            records,
            o.bytes_written.div_ceil(1024)
        )
    };
    println!(
        "{what:>14}{opened:8.2} |{:8.1}{:7}{:8}{:8} |{} |{}",
        median(asked),
        found.nodes,
        found.tested,
        found.records.len(),
        commit(&came, &come),
        commit(&went, &go)
    );
    Ok(())
}

fn head(title: &str, first: &str) {
    println!("\n{title}");
    let commit = format!("{:>8}{:>8}{:>9}{:>8}", "ms", "tops", "records", "KiB");
    println!("{:>14}{:8} |{:^31} |{:^33} |{:^33}", "", "", "query", "arrival", "removal");
    println!(
        "{first:>14}{:>8} |{:>8}{:>7}{:>8}{:>8} |{commit} |{commit}",
        "open ms", "us", "nodes", "tested", "patches"
    );
}

/// A new database with one survey: so many posts a side.
fn base(at: &Path, posts: usize) -> Result<Db> {
    let crs = Crs::parse("EPSG:32611")?;
    let options = Options { crs: crs.clone(), policy: Policy::Accuracy, patch: Kind::Bilinear };
    let db = Db::create(at, &options)?;
    change(&db, Square::new(posts, BASE_STEP, MIDDLE, 0.0, &crs).ingest("base", 1.0))?;
    Ok(db)
}

/// Copies a database at rest: its directory, file by file.
fn copy(from: &Path, to: &Path) -> Result<()> {
    let io = |path: &Path, e| Error::io(path, e);
    std::fs::create_dir_all(to).map_err(|e| io(to, e))?;
    for entry in std::fs::read_dir(from).map_err(|e| io(from, e))? {
        let path = entry.map_err(|e| io(from, e))?.path();
        let into = to.join(path.file_name().expect("an entry of a directory has a name"));
        if path.is_dir() {
            copy(&path, &into)?;
        } else {
            std::fs::copy(&path, &into).map_err(|e| io(&path, e))?;
        }
    }
    Ok(())
}

/// Lines of a base with ever more small surveys: `place` tells where each lies and how it is turned.
fn piles(at: &Path, counts: &[usize], place: impl Fn(usize) -> ([f64; 2], f64)) -> Result<()> {
    let db = base(at, 1025)?;
    let mut there = 0;
    for &count in counts {
        while there < count {
            let (middle, degrees) = place(there);
            let accuracy = [0.3, 0.6, 0.9, 1.5][there % 4];
            let survey = Square::new(PILED, PILED_STEP, middle, degrees, db.crs());
            change(&db, survey.ingest(&format!("small {there}"), accuracy))?;
            there += 1;
        }
        line(&db, &count.to_string(), MIDDLE)?;
    }
    Ok(())
}

fn measure(sizes: &[usize], counts: &[usize], db: Option<PathBuf>) -> Result<()> {
    let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), e))?;
    let at = |name: &str| folder.path().join(name);
    head("Size: one base of so many posts a side", "posts");
    for &posts in sizes {
        line(&base(&at(&format!("size {posts}")), posts)?, &posts.to_string(), MIDDLE)?;
    }
    if let Some(from) = db {
        copy(&from, &at("copy"))?;
        let db = Db::open(&at("copy"))?;
        let bounds = db.snapshot(None)?.bounds();
        let b = bounds.ok_or_else(|| Error::invalid(from.display(), "holds no survey"))?;
        line(&db, "--db", [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0])?;
    }
    head("One place: so many small surveys one over the other, under what comes", "surveys");
    piles(&at("one place"), counts, |k| {
        let (s, c) = (k as f64 * 2.4).sin_cos();
        let far = 60.0 * (k as f64 % 7.0) / 7.0;
        ([MIDDLE[0] + far * c, MIDDLE[1] + far * s], k as f64 * 37.0 % 90.0)
    })?;
    head("Beside: as many side by side, away from what comes", "surveys");
    piles(&at("beside"), counts, |k| {
        // In a lattice wide enough that none meets another, with a hole where the survey comes.
        let n = (0..).map(|n| [n % 40, n / 40].map(|v| (f64::from(v) - 19.5) * 240.0));
        let free = n.filter(|p| p[0].abs().max(p[1].abs()) > 1200.0);
        let [x, y] = free.into_iter().nth(k).expect("the lattice has no end");
        ([MIDDLE[0] + x, MIDDLE[1] + y], k as f64 * 37.0 % 90.0)
    })
}

fn main() -> std::process::ExitCode {
    let mut sizes = vec![1025, 4097];
    let mut counts = vec![1, 10, 100];
    let mut db = None;
    let mut args = std::env::args().skip(1);
    let list = |text: Option<String>| -> Option<Vec<usize>> {
        text?.split(',').map(|n| n.parse().ok().filter(|n| *n > 0)).collect()
    };
    while let Some(option) = args.next() {
        let understood = match option.as_str() {
            "--sizes" => list(args.next()).map(|l| sizes = l),
            "--counts" => list(args.next()).map(|l| counts = l),
            "--db" => args.next().map(|p| db = Some(PathBuf::from(p))),
            _ => None,
        };
        if understood.is_none() {
            eprintln!("usage: growth [--sizes 1025,4097] [--counts 1,10,100] [--db DB]");
            return std::process::ExitCode::from(2);
        }
    }
    match measure(&sizes, &counts, db) {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("error: {e}");
            std::process::ExitCode::FAILURE
        }
    }
}
