//! The kernels that everything waits for. `cargo bench --bench kernels [NAME]`
//!
//! Reads the bundled surveys of Mount St. Helens; needs nothing else.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use terraquilt::base::Result;
use terraquilt::base::date::Date;
use terraquilt::base::lattice::{Bounds, Point, Quad, covered};
use terraquilt::db::query::{Query, Tolerance};
use terraquilt::db::{Change, Db, Ingest, Options, Policy, Progress};
use terraquilt::height::block::{BLOCK, Heights, RawBlock, decode, encode};
use terraquilt::height::cells::{Block, Fill};
use terraquilt::height::crs::Crs;
use terraquilt::height::frame::{CellRect, Frame};
use terraquilt::height::lod::cutter::standing;
use terraquilt::height::lod::{
    Cells, Fact, Geometry, PatchId, Place, SurveyNumber, World, places_touching_posts,
};
use terraquilt::height::patch::{Kind, Residuals, Shape, Vertices};
use terraquilt::height::source::SampleType;
use terraquilt::height::surface::{Blend, Planes};

/// Hills in whole centimetres.
fn hill(i: i64, j: i64) -> f64 {
    let (x, y) = (i as f64, j as f64);
    ((500.0 + (x / 31.0).sin() * 60.0 + ((x + 2.0 * y) / 17.0).cos() * 9.0) * 100.0).round() / 100.0
}

fn blocks(c: &mut Criterion) {
    let mut group = c.benchmark_group("block");
    let n = BLOCK as usize;
    for (name, sample_type) in [("f32", SampleType::F32), ("i16", SampleType::I16)] {
        let mut samples = Vec::new();
        for k in 0..BLOCK * BLOCK {
            let h = hill(k % BLOCK, k / BLOCK);
            match sample_type {
                SampleType::F32 => samples.extend((h as f32).to_le_bytes()),
                _ => samples.extend((h as i16).to_le_bytes()),
            }
        }
        let block = RawBlock {
            col: 0,
            row: 0,
            cols: n,
            rows: n,
            sample_type,
            samples,
            valid: None,
            fills: Vec::new(),
        };
        let bytes = encode(&block);
        // Bytes of samples, not of what is read or written.
        group.throughput(Throughput::Bytes(block.samples.len() as u64));
        group.bench_function(BenchmarkId::new("encode", name), |b| b.iter(|| encode(black_box(&block))));
        group.bench_function(BenchmarkId::new("decode", name), |b| {
            b.iter(|| decode(black_box(&bytes), "bench").expect("it was just written"))
        });
        // As a page of a mapped file is read: its checksum first, heights in metres at the end.
        let crc = crc32c::crc32c(&bytes);
        group.bench_function(BenchmarkId::new("check, decode, lay", name), |b| {
            b.iter(|| {
                assert_eq!(crc32c::crc32c(black_box(&bytes)), crc);
                let mut heights = Heights::void();
                heights.lay(&decode(&bytes, "bench").expect("it was just written"), 1.0, 0.0);
                heights
            })
        });
    }
    group.finish();
}

/// A block of posts against ten levels: posts of the whole pyramid a second, ten times that in posts looked at.
fn errors(c: &mut Criterion) {
    let (i0, j0) = (3 * BLOCK, 7 * BLOCK);
    let posts: Vec<f64> = (0..BLOCK * BLOCK).map(|k| hill(i0 + k % BLOCK, j0 + k / BLOCK)).collect();
    // Places, first row of vertices, vertices in a row, and the vertices.
    let levels: Vec<(CellRect, i64, usize, Vec<f64>)> = (1..=10u8)
        .map(|level| {
            let places = places_touching_posts(level, i0, j0, i0 + BLOCK - 1, j0 + BLOCK - 1);
            let (a, b) = (i0 >> level, j0 >> level);
            let (across, up) = (((i0 + BLOCK - 1) >> level) + 2 - a, ((j0 + BLOCK - 1) >> level) + 2 - b);
            let vertex = |k: i64| hill((a + k % across) << level, (b + k / across) << level);
            (places, b, across as usize, (0..across * up).map(vertex).collect())
        })
        .collect();
    let mut group = c.benchmark_group("errors");
    group.throughput(Throughput::Elements((BLOCK * BLOCK) as u64));
    group.bench_function("of ten levels", |bench| {
        bench.iter(|| {
            for (level, (places, first, across, vertices)) in (1..=10u8).zip(&levels) {
                let mut gather = Residuals::new(level, *places, i0, BLOCK as usize);
                for (j, row) in (j0..).zip(posts.chunks_exact(BLOCK as usize)) {
                    let at = ((j >> level) - first) as usize * across;
                    let (below, above) =
                        (&vertices[at..at + across], &vertices[at + across..at + 2 * across]);
                    gather.row(j, black_box(row), below, above);
                }
                black_box(gather.finish());
            }
        })
    });
    group.finish();
}

/// A kernel of 28 cells of 1 m under a cover turned by 17 degrees that just holds it.
fn coverage(c: &mut Criterion) {
    let mut group = c.benchmark_group("covered");
    let unit = 1i64 << 35;
    let kernel =
        Bounds { min: Point::new(-14 * unit, -14 * unit), max: Point::new(14 * unit, 14 * unit) }.quad();
    for side in [1i64, 4, 10] {
        // `side` x `side` quads (one line fewer for 12), each 48 m / side wide, in an integer frame.
        let rows = if side == 4 { 3 } else { side };
        let (ux, uy) = (46 * unit / side, 14 * unit / side);
        let (vx, vy) = (-14 * unit / rows, 46 * unit / rows);
        let (ax, ay) = (-(side * ux + rows * vx) / 2, -(side * uy + rows * vy) / 2);
        let post = |i: i64, j: i64| Point::new(ax + i * ux + j * vx, ay + i * uy + j * vy);
        let cover: Vec<Quad> = (0..rows)
            .flat_map(|j| (0..side).map(move |i| (i, j)))
            .map(|(i, j)| Quad([post(i, j), post(i + 1, j), post(i + 1, j + 1), post(i, j + 1)]))
            .collect();
        assert!(covered(&kernel, &cover));
        group.bench_function(BenchmarkId::from_parameter(cover.len()), |b| {
            b.iter(|| covered(black_box(&kernel), black_box(&cover)))
        });
    }
    group.finish();
}

/// Two surveys without holes, 1 m and 3 m, the second turned: pyramids with errors that grow with the level.
struct TwoSurveys([Geometry; 2]);

impl TwoSurveys {
    fn new() -> TwoSurveys {
        let unit = 1i64 << 35;
        let geometry = |u: [i64; 2], step: f64, accuracy, core| Geometry {
            frame: Frame { anchor: Point::new(0, 0), u: Point::new(u[0], u[1]), v: Point::new(-u[1], u[0]) },
            steps: [step; 2],
            accuracy,
            precedence: 0,
            level_max: 4,
            core,
        };
        // 9 : 12 : 15, so that the steps of the second are exactly 3 m.
        let turned = [unit * 12 / 5, unit * 9 / 5];
        TwoSurveys([
            geometry([unit, 0], 1.0, 0.5, CellRect::new(-450, -450, 430, 440)),
            geometry(turned, 3.0, 1.0, CellRect::new(-440, -450, 445, 450)),
        ])
    }
    fn of(&self, s: SurveyNumber) -> &Geometry {
        &self.0[s.0 as usize]
    }
}

impl World for TwoSurveys {
    fn meeting(&self, bounds: &Bounds) -> Vec<SurveyNumber> {
        (0..2).map(SurveyNumber).filter(|s| self.of(*s).bounds().overlaps(bounds)).collect()
    }
    fn geometry(&self, survey: SurveyNumber) -> &Geometry {
        self.of(survey)
    }
    fn fill(&self, survey: SurveyNumber, _: Cells, place: Place) -> Result<Fill> {
        let core = &self.of(survey).core;
        Ok(match (core.contains(&place.rect()), core.overlaps(&place.rect())) {
            (true, _) => Fill::Full,
            (_, true) => Fill::Mixed,
            _ => Fill::Empty,
        })
    }
    fn block(&self, survey: SurveyNumber, _: Cells, i: i32, j: i32) -> Result<Block> {
        let mut block = Block::FULL;
        let (rect, core) = (Place { level: 0, i, j }.rect(), &self.of(survey).core);
        for b in 0..28 {
            for a in 0..28 {
                let (x, y) = (rect.i0 + a, rect.j0 + b);
                if !core.contains(&CellRect::new(x, y, x + 1, y + 1)) {
                    block.clear(a as usize, b as usize);
                }
            }
        }
        Ok(block)
    }
    fn fact(&self, survey: SurveyNumber, place: Place) -> Result<Option<Fact>> {
        if self.fill(survey, Cells::Core, place)? == Fill::Empty {
            return Ok(None);
        }
        let mix = (i64::from(place.i) * 7919 + i64::from(place.j) * 104_729).rem_euclid(256) as u8;
        let bot = self.of(survey).accuracy + f32::from(place.level).powi(2) * (1.0 + f32::from(mix) / 256.0);
        Ok(Some(Fact { id: PatchId([mix ^ survey.0 as u8; 16]), bot }))
    }
}

fn standings(c: &mut Criterion) {
    let world = TwoSurveys::new();
    let mut group = c.benchmark_group("standing");
    for level in [0u8, 2, 4] {
        let place = Place::of_cell(level, 10, 10);
        let fact = world.fact(SurveyNumber(0), place).expect("never fails").expect("the cell is in the core");
        group.bench_function(BenchmarkId::new("level", level), |b| {
            b.iter(|| standing(black_box(&world), SurveyNumber(0), place, &fact))
        });
    }
    group.finish();
}

fn helens(folder: &Path) -> Result<Db> {
    let db = Db::create(
        folder,
        &Options { crs: Crs::parse("EPSG:26910")?, policy: Policy::Newest, patch: Kind::Bilinear },
    )?;
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/st_helens");
    let stop = AtomicBool::new(false);
    for (date, accuracy_m) in
        [("2000-09-25", 2.0), ("2004-10-04", 0.5), ("2004-10-11", 0.5), ("2004-10-13", 0.5)]
    {
        let ingest = Ingest {
            name: Some(date.to_string()),
            accuracy_m: Some(accuracy_m),
            date: Some(Date::parse(date)?),
            ..Ingest::new(vec![terraquilt::format::open(&data.join(format!("survey_{date}_native.tif")))?])
        };
        let progress = Progress { report: &|_, _| (), stop: &stop };
        db.change(Change::Ingest(ingest), None, false, &progress, &mut || ())?;
    }
    Ok(db)
}

fn questions(c: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let db = helens(&folder.path().join("db")).expect("the bundled surveys are ingested");
    let s = db.snapshot(None).expect("a version");
    let region = Some([562_000.0, 5_115_300.0, 563_300.0, 5_116_600.0]);
    let query = |error_m| Query {
        area: region.into(),
        tolerance: Tolerance::Constant(error_m),
        how: Blend::Exact.into(),
    };
    let mut group = c.benchmark_group("select");
    for error_m in [0.0, 5.0, 50.0] {
        group.bench_function(BenchmarkId::new("within", error_m), |b| {
            b.iter(|| s.select(black_box(&query(error_m))).expect("an answer").records.len())
        });
    }
    group.finish();
    let side = 128;
    let points: Vec<[f64; 2]> = (0..side * side)
        .map(|k| [562_000.0 + f64::from(k % side) * 10.0, 5_115_300.0 + f64::from(k / side) * 10.0])
        .collect();
    let mut group = c.benchmark_group("heights");
    group.throughput(Throughput::Elements(points.len() as u64));
    group.sample_size(20);
    for error_m in [0.0, 5.0, 50.0] {
        let ground = s.surface(&query(error_m)).expect("a surface");
        // The first time decodes blocks; measured is what follows.
        ground.heights(&points).expect("heights");
        group.bench_function(BenchmarkId::new("grid within", error_m), |b| {
            b.iter(|| ground.heights(black_box(&points)).expect("heights").len())
        });
    }
    group.finish();
    let ground = s.surface(&query(0.0)).expect("a surface");
    let mut group = c.benchmark_group("surface");
    // Several surveys, some of them ending there: from tiles that one fills to points in the rim.
    let row = |first: f64, step: f64| (0..512).map(|k| first + f64::from(k) * step).collect::<Vec<f64>>();
    let (xs, ys) = (row(562_000.0, 2.5), row(5_116_590.0, -2.5));
    let mut planes = Planes::default();
    group.throughput(Throughput::Elements((xs.len() * ys.len()) as u64));
    group.sample_size(20);
    group.bench_function("grid", |b| {
        b.iter(|| ground.grid_into(black_box(&xs), black_box(&ys), &mut planes).expect("heights"))
    });
    let near = |k: usize| {
        let (x, y) = (xs[k % xs.len()], ys[k / xs.len()]);
        [x + (y * 0.7) % 40.0, y + (x * 0.3) % 20.0]
    };
    let points: Vec<[f64; 2]> = (0..xs.len() * ys.len()).map(near).collect();
    group.bench_function("points", |b| b.iter(|| ground.planes(black_box(&points)).expect("heights").len()));
    group.bench_function("points one by one", |b| {
        b.iter(|| ground.sheet().heights(black_box(&points[..4096])).expect("heights").len())
    });
    group.finish();
}

fn splines(c: &mut Criterion) {
    let z: Box<Vertices> = Box::new(std::array::from_fn(|k| hill((k % 33) as i64, (k / 33) as i64)));
    c.bench_function("spline through 33 x 33 vertices", |b| {
        b.iter(|| Shape::new(Kind::Bicubic, black_box(z.clone())).at(3.5, 4.5).z)
    });
}

criterion_group!(kernels, blocks, errors, coverage, standings, questions, splines);
criterion_main!(kernels);
