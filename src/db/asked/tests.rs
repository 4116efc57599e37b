//! Questions held against the plain definition: every record of every node that the pruning leaves, by exact clipping, told apart by id.

use super::*;
use crate::base::polygon::Polygon;
use crate::db::query::{Area, Query, Tolerance};
use crate::db::view::{Rules, Tables, View};
use crate::db::{Change, Db, Ingest, Options, Policy, Progress, Snapshot};
use crate::height::crs::Crs;
use crate::height::lod::cut::{Camera, ErrorRaster, Foci, Focus, Region};
use crate::height::patch::Kind;
use crate::height::source::{Affine, HeightSource, SampleType, Samples, SourceInfo, Window};
use crate::height::surface::Blend;
use crate::store::quadtree::{Explored, Node, child_cell, root_cell};
use crate::store::segment::PageRef;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Uniform in [0, 1) (xorshift64).
fn random(s: &mut u64) -> f64 {
    *s ^= *s << 13;
    *s ^= *s >> 7;
    *s ^= *s << 17;
    (*s >> 11) as f64 / (1u64 << 53) as f64
}

struct Plain<'a> {
    view: &'a View,
    size: f64,
    cut: &'a dyn Cut,
    exact: bool,
    clip: Clip,
    met: HashSet<PatchId>,
    records: Vec<Record>,
    nodes: u64,
    tested: u64,
}

impl Plain<'_> {
    fn range(&mut self, cell: &Bounds) -> Option<(f64, f64)> {
        let part = self.clip.part(&corners(&cell.quad(), self.size));
        let (lo, hi) = (!part.is_empty()).then(|| self.cut.bounds(part))?;
        Some((lo / if self.exact { KAPPA } else { 1.0 }, hi))
    }

    fn node(&mut self, at: &PageRef, cell: &Bounds, lo: f64) {
        self.nodes += 1;
        let node = Node::read(&self.view.files, at).unwrap();
        for r in &node.records {
            if f64::from(r.top) <= lo {
                return;
            }
            self.visit(r);
        }
        for (k, c) in node.children.iter().enumerate() {
            let (Some(c), cell) = (c, child_cell(cell, k)) else { continue };
            let Some((lo, hi)) = self.range(&cell) else { continue };
            if f64::from(c.top_max) > lo && (f64::from(c.bot_min) <= hi || c.floor) {
                self.node(&c.page, &cell, lo);
            }
        }
    }

    fn visit(&mut self, r: &Record) {
        self.tested += 1;
        if !self.met.insert(r.id) {
            return;
        }
        let g = self.view.geometry_of(r.survey);
        let part = self.clip.part(&corners(&g.frame.quad(&r.place.domain()), self.size));
        if part.is_empty() {
            return;
        }
        let (lo, hi) = self.cut.bounds(part);
        let kappa = if self.exact { KAPPA } else { 1.0 };
        if lo < kappa * f64::from(r.top) && (f64::from(r.bot) <= hi || self.exact && r.floor) {
            self.records.push(*r);
        }
    }
}

/// Records ascending by id, nodes read, records looked at.
fn plain(s: &Snapshot, region: &Region, cut: &dyn Cut, blend: Blend) -> (Vec<Record>, u64, u64) {
    let mut p = Plain {
        view: &s.view,
        size: s.unit.size(),
        cut,
        exact: blend == Blend::Exact,
        clip: Clip::new(region),
        met: HashSet::new(),
        records: Vec::new(),
        nodes: 0,
        tested: 0,
    };
    let cell = root_cell();
    if let Some(root) = &s.view.tree
        && !region.is_empty()
        && let Some((lo, _)) = p.range(&cell)
    {
        p.node(&root.page, &cell, lo);
    }
    p.records.sort_unstable_by_key(|r| r.id);
    (p.records, p.nodes, p.tested)
}

/// Hills in memory.
struct Hills {
    info: SourceInfo,
    seed: u64,
}

impl HeightSource for Hills {
    fn info(&self) -> &SourceInfo {
        &self.info
    }
    fn set_nodata(&mut self, value: f64) {
        self.info.nodata = Some(value);
    }
    fn read(&mut self, w: Window) -> crate::base::Result<Samples> {
        let mut s = Samples { cols: w.cols, rows: w.rows, ..Samples::default() };
        for k in 0..w.cols * w.rows {
            let (i, j) = (w.col as f64 + (k % w.cols) as f64, w.row as f64 + (k / w.cols) as f64);
            let mut noise = self.seed ^ (i as u64) << 20 ^ (j as u64 + 1) << 40;
            let z = 200.0
                + 80.0 * (i / 61.0).sin() * (j / 47.0).cos()
                + 6.0 * (i / 7.0).sin()
                + random(&mut noise);
            s.data.extend_from_slice(&(z as f32).to_le_bytes());
            s.valid.push(1);
        }
        Ok(s)
    }
    fn row_batch(&self) -> usize {
        64
    }
}

fn survey(s: &mut u64, name: &str, side: u64) -> Ingest {
    let (turn, step) =
        (if random(s) < 0.4 { 0.0 } else { 6.3 * random(s) }, [1.0, 2.0, 5.0][(3.0 * random(s)) as usize]);
    let (c, n) = (turn.cos() * step, turn.sin() * step);
    let at = |v: f64, s: &mut u64| v + 600.0 * (random(s) - 0.5);
    let origin = [at(500_000.0, s), at(4_000_000.0, s)];
    let info = SourceInfo {
        affine: Some(Affine { origin, col_step: [c, n], row_step: [n, -c] }),
        crs: Some(Crs::parse("EPSG:32610").unwrap()),
        ..SourceInfo::new(format!("{name}.mem"), "memory", [side, side / 2 + 40], SampleType::F32)
    };
    Ingest {
        name: Some(name.to_string()),
        accuracy_m: Some([0.0, 0.3, 1.0][(3.0 * random(s)) as usize]),
        precedence: Some((3.0 * random(s)) as i64),
        ..Ingest::new(vec![Box::new(Hills { info, seed: s.wrapping_mul(31) })])
    }
}

fn tolerance(s: &mut u64, s0: &Snapshot) -> Tolerance {
    let b = s0.bounds().unwrap();
    let somewhere = |s: &mut u64| [0, 1].map(|k| b[k] + (b[k + 2] - b[k]) * (1.4 * random(s) - 0.2));
    match (8.0 * random(s)) as u32 {
        0 => Tolerance::Constant(0.0),
        1 => Tolerance::Constant(f64::INFINITY),
        2 => Tolerance::Constant(30.0 * random(s).powi(3)),
        3 => Tolerance::Foci(
            Foci::new(
                (0..1 + (3.0 * random(s)) as usize)
                    .map(|_| Focus {
                        center: somewhere(s),
                        radius: 200.0 * random(s),
                        error: 2.0 * random(s),
                        growth: 0.05 * random(s),
                    })
                    .collect(),
            )
            .unwrap(),
        ),
        4 => {
            let values = (0..30 * 20).map(|_| (20.0 * random(s).powi(4)) as f32).collect();
            let affine = Affine { origin: somewhere(s), col_step: [40.0, 13.0], row_step: [13.0, -40.0] };
            Tolerance::Raster(Arc::new(ErrorRaster::new(30, 20, values, &affine).unwrap()))
        }
        _ => {
            let (eye, look) = (somewhere(s), somewhere(s));
            let eye = [eye[0], eye[1], 150.0 + 500.0 * random(s).powi(2)];
            let look = [look[0], look[1], 400.0 * random(s)];
            let far = 300.0 + 4000.0 * random(s);
            let pixels = 0.3 + 5.0 * random(s);
            Tolerance::Camera(
                Camera::new(eye, look, 20.0 + 60.0 * random(s), [800, 600], pixels, Some(far)).unwrap(),
            )
        }
    }
}

fn area(s: &mut u64, s0: &Snapshot) -> Area {
    let b = s0.bounds().unwrap();
    let somewhere = |s: &mut u64| [0, 1].map(|k| b[k] + (b[k + 2] - b[k]) * (1.4 * random(s) - 0.2));
    let (p, q) = (somewhere(s), somewhere(s));
    match (4.0 * random(s)) as u32 {
        0 => Area::Everything,
        1 => Area::Box([p[0].min(q[0]), p[1].min(q[1]), p[0].max(q[0]), p[1].max(q[1])]),
        2 => Area::Box([p[0], p[1], p[0] + 1e-3, p[1] + 1e-3]),
        _ => {
            let r = 50.0 + 600.0 * random(s);
            let ring = (0..7).map(|k| {
                let (a, r) = (f64::from(k) * 0.89, r * if k % 2 == 0 { 1.0 } else { 0.3 });
                [p[0] + r * a.cos(), p[1] + r * a.sin()]
            });
            Area::Polygon(Arc::new(Polygon::new("star", vec![vec![ring.collect()]]).unwrap()))
        }
    }
}

#[test]
fn answers_are_those_of_the_plain_definition() {
    let (mut taken, mut asked, mut apart) = (0, 0, 0);
    for seed in 1..=6u64 {
        let s = &mut (seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        let folder = tempfile::tempdir().unwrap();
        let options = Options {
            crs: Crs::from_epsg(32610).unwrap(),
            policy: Policy::Accuracy,
            patch: if seed % 3 == 0 { Kind::Bicubic } else { Kind::Bilinear },
        };
        let db = Db::create(&folder.path().join("db"), &options).unwrap();
        let stop = AtomicBool::new(false);
        let change = |c| db.change(c, None, false, &Progress { report: &|_, _| (), stop: &stop }, &mut || ());
        for step in 0..5 {
            let c = match step {
                3 => Change::Remove { surveys: vec!["s1".into()], tile: None },
                _ => Change::Ingest(survey(s, &format!("s{step}"), if step == 0 { 900 } else { 300 })),
            };
            change(c).unwrap();
            let now = db.snapshot(None).unwrap();
            // Edges: tolerances that are exactly a bot, or the least float that a top times kappa exceeds.
            let mut edges = Vec::new();
            let (all, ..) = plain(
                &now,
                &now.region(&whole(0.0)).unwrap(),
                &*now.cut(&Tolerance::Constant(0.0)),
                Blend::Exact,
            );
            for r in all.iter().step_by(all.len() / 8 + 1) {
                let t = f64::from(r.top) * KAPPA;
                edges.extend([f64::from(r.bot), f64::from(r.top), t, t.next_up(), t.next_down(), t / KAPPA]);
            }
            for n in 0..60 {
                let tolerance = match edges.get(n) {
                    Some(t) => Tolerance::Constant(*t),
                    None => tolerance(s, &now),
                };
                let how = if n % 2 == 0 { Blend::Exact } else { Blend::Plain };
                let query = Query { area: area(s, &now), tolerance, how: how.into() };
                let (region, cut) = (now.region(&query).unwrap(), now.cut(&query.tolerance));
                let (mut records, nodes, tested) = plain(&now, &region, &*cut, how);
                let found = now.find_in(region.clone(), &*cut, how).unwrap();
                assert_eq!(found.len(), records.len(), "seed {seed}, step {step}, {query:?}");
                assert_eq!((found.nodes, found.tested), (nodes, tested));
                assert_eq!(found.selection().records, records, "seed {seed}, step {step}, {query:?}");
                // The same where nodes find no room, and where some do.
                for most in [0, 7] {
                    let few =
                        now.find_through(Arc::new(Explored::of(most)), region.clone(), &*cut, how).unwrap();
                    assert!(few.records().count() == few.len());
                    apart += few.len();
                    assert_eq!(few.selection().records, records);
                }
                if let Area::Polygon(p) = &query.area {
                    let rules = Rules(&now.view);
                    records.retain(|r| p.meets(&corners(&rules.domain(r), now.unit.size())));
                }
                assert_eq!(now.select(&query).unwrap().records, records);
                asked += 1;
                taken += records.len();
            }
        }
    }
    println!("{asked} questions, {taken} patches");
    assert!(taken > 50_000 && apart > taken, "{asked} questions, {taken} patches");
}

fn whole(c: f64) -> Query {
    Query { area: Area::Everything, tolerance: Tolerance::Constant(c), how: Blend::Exact.into() }
}

#[test]
fn least_finds_the_first_float_of_a_rule() {
    let s = &mut 99;
    let mut thresholds =
        vec![0.0, -0.0, 1.0, f64::MIN_POSITIVE, 1e-46, -1e-46, 1e39, -1e39, f64::MAX, f64::NEG_INFINITY];
    thresholds.extend((0..2000).map(|_| (random(s) - 0.5) * 10f64.powf(80.0 * random(s) - 40.0)));
    for t in thresholds {
        for rule in [(|v, t| v > t) as fn(f64, f64) -> bool, |v, t| v >= t, |v, t| t < KAPPA * v] {
            let found = least(|v| rule(f64::from(v), t));
            assert!(rule(f64::from(found), t), "{t}");
            let before = found.next_down();
            assert!(
                found == f32::NEG_INFINITY || before == found || !rule(f64::from(before), t),
                "{t} {found}"
            );
        }
    }
    assert!(least(|_| false).is_nan() && least(|_| true) == f32::NEG_INFINITY);
}
