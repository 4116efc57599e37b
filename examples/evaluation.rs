//! How many heights a second one core finds: on grids and at scattered points, bilinear and bicubic.
//! `cargo run --release --example evaluation -- DB [--grid FILE] [--json]`
//!
//! DB is a bilinear database; a window in its middle is asked, of 1025 x 1025 steps of its finest survey for grids, of 2049 x
//! 2049 for points. The bicubic database is made in a temporary folder, of FILE or of synthetic hills. One call warms blocks,
//! patches and caches ("first" is its rate); then the best of several calls counts. Rates are millions of heights a
//! second: of the clock ("wall") and of the time that the thread had a core ("core", where the system tells), which is what
//! counts where others compute as well. Takes about half a minute.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use terraquilt::base::{Error, Result};
use terraquilt::db::query::{Query, Tolerance};
use terraquilt::db::{Change, Db, Ingest, Options, Policy, Progress, Snapshot};
use terraquilt::height::crs::Crs;
use terraquilt::height::patch::Kind;
use terraquilt::height::source::{Affine, HeightSource, SampleType, Samples, SourceInfo, Window};
use terraquilt::height::surface::{Blend, Planes};

/// Points along a side of the grids.
const SIDE: usize = 1025;
/// Posts along a side of the synthetic hills.
const HILLS: u64 = 2049;
/// Scattered points of one call.
const POINTS: usize = 1_000_000;
/// How long one figure may take, and how often it is taken.
const EACH: Duration = Duration::from_millis(900);
const TIMES: usize = 12;

fn main() -> Result<()> {
    let usage = "usage: evaluation DB [--grid FILE] [--json]";
    let (mut db, mut grid, mut json) = (None, None, false);
    let mut args = std::env::args().skip(1);
    while let Some(a) = args.next() {
        match a.as_str() {
            "--json" => json = true,
            "--grid" => grid = Some(PathBuf::from(args.next().expect(usage))),
            _ => db = Some(PathBuf::from(a)),
        }
    }
    let db = db.expect(usage);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    pool.expect("a pool of one thread").install(|| measure(&db, grid.as_deref(), json))
}

fn measure(db: &Path, grid: Option<&Path>, json: bool) -> Result<()> {
    let mut out = Table { json, rows: Vec::new() };
    let now = Db::open(db)?.snapshot(None)?;
    grids(&now, 11, "bilinear", &[0.0, 5.0, 20.0], &mut out)?;
    points(&now, "bilinear", &[0.0, 5.0], &mut out)?;
    drop(now);
    let folder = tempfile::tempdir().map_err(|e| Error::io("a temporary folder", e))?;
    let smooth = bicubic(&folder.path().join("db"), grid)?;
    let now = smooth.snapshot(None)?;
    grids(&now, 12, "bicubic", &[0.0, 5.0], &mut out)?;
    points(&now, "bicubic", &[0.0], &mut out)?;
    if json {
        println!("[{}]", out.rows.join(","));
    }
    Ok(())
}

/// Figures, printed as they come or as JSON at the end.
struct Table {
    json: bool,
    rows: Vec<String>,
}

impl Table {
    /// Times a call that finds `count` heights.
    fn add(
        &mut self,
        row: u8,
        what: &str,
        tolerance: f64,
        count: usize,
        mut call: impl FnMut() -> Result<usize>,
    ) -> Result<()> {
        let rate = |seconds: f64| count as f64 / seconds / 1e6;
        let begun = Instant::now();
        let found = call()?;
        let first = rate(begun.elapsed().as_secs_f64());
        let (mut wall, mut core) = (f64::INFINITY, f64::INFINITY);
        let begun = Instant::now();
        for _ in 0..TIMES {
            let (clock, time) = (Instant::now(), core_seconds());
            call()?;
            wall = wall.min(clock.elapsed().as_secs_f64());
            core = core.min(core_seconds().zip(time).map_or(f64::INFINITY, |(a, b)| a - b));
            if begun.elapsed() > EACH {
                break;
            }
        }
        let (wall, core) = (rate(wall), if core.is_finite() { rate(core) } else { rate(wall) });
        if self.json {
            self.rows.push(format!(
                "{{\"row\":{row},\"what\":\"{what}\",\"tolerance_m\":{tolerance},\"points\":{count},\"found\":{found},\
                 \"first_mps\":{first:.2},\"wall_mps\":{wall:.2},\"core_mps\":{core:.2}}}"
            ));
        } else {
            println!(
                "row {row}  {what:<44} {tolerance:>4} m {count:>8} points {found:>8} heights  first {first:>6.1}  \
                 wall {wall:>6.1}  core {core:>6.1} M/s"
            );
        }
        Ok(())
    }
}

/// Seconds that this thread has had a core, where the system tells.
fn core_seconds() -> Option<f64> {
    let said = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(said.split(' ').next()?.parse::<f64>().ok()? / 1e9)
}

/// The middle of everything, and the finest step.
fn middle(now: &Snapshot) -> ([f64; 2], f64) {
    let b = now.bounds().expect("the database holds a survey");
    let step = now.entries().map(|e| e.geometry.steps[0]).fold(f64::INFINITY, f64::min);
    ([(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0], step)
}

fn grids(now: &Snapshot, row: u8, kind: &str, tolerances: &[f64], out: &mut Table) -> Result<()> {
    let (m, step) = middle(now);
    // The window holds the turned grid, too.
    let half = step * SIDE as f64 / 2.0;
    for &tolerance in tolerances {
        let area = Some([m[0] - 1.5 * half, m[1] - 1.5 * half, m[0] + 1.5 * half, m[1] + 1.5 * half]).into();
        let query = Query { area, tolerance: Tolerance::Constant(tolerance), how: Blend::Exact.into() };
        let ground = now.surface(&query)?;
        let mut planes = Planes::default();
        // From the same corner: at every post, or between them in steps that are not theirs.
        for (name, first, by) in [("at the posts", 0.5, 1.0), ("finer than the posts", 0.37, 0.41)] {
            let [x0, y0] = [m[0] - half, m[1] + half].map(|v| (v / step).floor() * step + first * step);
            let xs: Vec<f64> = (0..SIDE).map(|k| x0 + k as f64 * by * step).collect();
            let ys: Vec<f64> = (0..SIDE).map(|k| y0 - k as f64 * by * step).collect();
            out.add(row, &format!("{kind}, grid {name}"), tolerance, SIDE * SIDE, || {
                ground.grid_into(&xs, &ys, &mut planes)?;
                Ok(planes.marks.iter().filter(|m| **m != 0).count())
            })?;
        }
        let (sin, cos) = 17f64.to_radians().sin_cos();
        let turned: Vec<[f64; 2]> = (0..SIDE * SIDE)
            .map(|k| [(k % SIDE) as f64 * step - half, (k / SIDE) as f64 * step - half])
            .map(|[x, y]| [m[0] + cos * x - sin * y, m[1] + sin * x + cos * y])
            .collect();
        out.add(
            row,
            &format!("{kind}, grid turned by 17 degrees, as points"),
            tolerance,
            SIDE * SIDE,
            || Ok(ground.planes(&turned)?.marks.iter().filter(|m| **m != 0).count()),
        )?;
    }
    Ok(())
}

fn points(now: &Snapshot, kind: &str, tolerances: &[f64], out: &mut Table) -> Result<()> {
    let (m, step) = middle(now);
    let b = now.bounds().expect("it holds a survey");
    let side = (step * 2048.0).min(b[2] - b[0]).min(b[3] - b[1]);
    let mut state = 1u64;
    let mut unit = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let points: Vec<[f64; 2]> =
        (0..POINTS).map(|_| [m[0] + (unit() - 0.5) * side, m[1] + (unit() - 0.5) * side]).collect();
    for &tolerance in tolerances {
        let tolerance_m = Tolerance::Constant(tolerance);
        out.add(13, &format!("{kind}, random points, as planes"), tolerance, POINTS, || {
            let found = now.planes(&points, &tolerance_m, Blend::Exact)?;
            Ok(found.marks.iter().filter(|m| **m != 0).count())
        })?;
        out.add(13, &format!("{kind}, random points, as structures"), tolerance, POINTS, || {
            Ok(now.heights(&points, &tolerance_m, Blend::Exact)?.iter().flatten().count())
        })?;
    }
    Ok(())
}

/// Hills of 2049 x 2049 posts, 10 m apart, in whole decimetres.
struct Hills(SourceInfo);

impl Hills {
    fn new() -> Result<Hills> {
        Ok(Hills(SourceInfo {
            affine: Some(Affine {
                origin: [500_005.0, 4_020_485.0],
                col_step: [10.0, 0.0],
                row_step: [0.0, -10.0],
            }),
            crs: Some(Crs::parse("EPSG:32611")?),
            scale: 0.1,
            ..SourceInfo::new("hills", "made up", [HILLS, HILLS], SampleType::I16)
        }))
    }
}

impl HeightSource for Hills {
    fn info(&self) -> &SourceInfo {
        &self.0
    }

    fn set_nodata(&mut self, _: f64) {}

    fn read(&mut self, w: Window) -> Result<Samples> {
        let mut s = Samples { cols: w.cols, rows: w.rows, data: Vec::new(), valid: vec![1; w.cols * w.rows] };
        for row in 0..w.rows {
            for col in 0..w.cols {
                let (x, y) = ((w.col as usize + col) as f64, (w.row as usize + row) as f64);
                let wide = (x / 131.0).sin() * (y / 87.0).cos() * 3000.0;
                let near = ((x + 2.0 * y) / 17.0).cos() * 300.0 + ((x * 0.7 - y) / 3.0).sin() * 12.0;
                s.data.extend(((9000.0 + wide + near).round() as i16).to_le_bytes());
            }
        }
        Ok(s)
    }
}

fn bicubic(path: &Path, grid: Option<&Path>) -> Result<Db> {
    let source: Box<dyn HeightSource> = match grid {
        Some(file) => terraquilt::format::open(file)?,
        None => Box::new(Hills::new()?),
    };
    let crs = source.info().crs.clone().expect("the grid says its coordinate system");
    let db = Db::create(path, &Options { crs, policy: Policy::Accuracy, patch: Kind::Bicubic })?;
    let ingest = Ingest { name: Some("grid".into()), accuracy_m: Some(1.0), ..Ingest::new(vec![source]) };
    let stop = AtomicBool::new(false);
    let progress = Progress { report: &|_, _| (), stop: &stop };
    db.change(Change::Ingest(ingest), None, false, &progress, &mut || ())?;
    Ok(db)
}
