//! Answers people expect: against analytic surfaces, against sums over the files, and where nothing can be answered.

use crate::support::{Grid, Random, Scratch, bundled, printed, program, random_grid, refused, seeds};
use serde_json::Value;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use terraquilt::analysis::{
    self, Contours, End, Levels, Shape, SightOptions, Spot, Sun, Terrain, Verdict, contours, sight,
};
use terraquilt::base::Result;
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::db::{self, Change, Db, Ingest, Options, Policy, Progress, Snapshot, metres_per_unit};
use terraquilt::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use terraquilt::height::crs::Crs;
use terraquilt::height::patch::Kind;
use terraquilt::height::source::{Affine, SampleType, Window};
use terraquilt::height::surface::Blend;

const STEP: f64 = 2.0;
const N: usize = 61;
/// The first post; the middle post is the origin of the functions below.
const WEST: f64 = 500_000.0;
const NORTH: f64 = 4_000_120.0;
const MIDDLE: [f64; 2] = [WEST + 60.0, NORTH - 60.0];

/// 61 x 61 posts at 2 m of a function of the distance east and north of the middle.
fn grid(name: &str, accuracy: f64, f: impl Fn(f64, f64) -> f64) -> Grid {
    let at = |k: usize| (k as f64 - 30.0) * STEP;
    Grid {
        name: name.into(),
        cols: N,
        rows: N,
        z: (0..N * N).map(|k| f(at(k % N), -at(k / N)) as f32).collect(),
        affine: Affine { origin: [WEST, NORTH], col_step: [STEP, 0.0], row_step: [0.0, -STEP] },
        accuracy,
        precedence: Some(0),
        date: None,
    }
}

fn query(area: Area) -> Query {
    Query { area, tolerance: Tolerance::Constant(0.0), how: Blend::Exact.into() }
}

fn everything() -> Query {
    query(Area::Everything)
}

fn world(grids: &[&Grid]) -> (Scratch, Snapshot) {
    let w = Scratch::new(Policy::Accuracy);
    for g in grids {
        w.ingest(g);
    }
    let s = w.db.snapshot(None).unwrap();
    (w, s)
}

fn on_grid<'a>(s: &'a Snapshot, q: &Query) -> (Terrain<'a>, analysis::Grid) {
    let t = Terrain::new(s, q).unwrap();
    let g = analysis::Grid::new(&[&t], &q.area, None, None).unwrap();
    (t, g)
}

fn lines(s: &Snapshot, q: &Query, interval: f64, base: f64) -> Contours {
    let (t, g) = on_grid(s, q);
    contours(&t, &g, Levels { interval, base }, &|_| true).unwrap()
}

fn plane(x: f64, y: f64) -> f64 {
    100.0 + 0.25 * x - 0.125 * y
}

#[test]
fn a_plane_has_its_slope_its_mean_and_its_profile() {
    let (_w, s) = world(&[&grid("plane", 0.5, plane)]);
    let (t, g) = on_grid(&s, &everything());
    // The core lies one cell inside the posts.
    assert_eq!(([g.west, g.north], [g.cols, g.rows]), ([WEST + 2.0, NORTH - 2.0], [58, 58]));
    g.ask(&t, Spot::Slopes, &|_| true, |_, row| {
        for e in row.iter().flatten() {
            for (k, rise) in [0.25, -0.125].into_iter().enumerate() {
                assert!((e.gradient[k] - rise).abs() < 1e-9, "{e:?}");
            }
            assert!((Shape::Aspect.of(e.gradient) - 296.565_051_177).abs() < 1e-6);
        }
        Ok(())
    })
    .unwrap();
    let f = analysis::statistics(&t, &g, &|_| true).unwrap();
    assert!((f.mean_m - 100.0).abs() < 1e-9 && (f.area_m2 - 116.0 * 116.0).abs() < 1e-6, "{f:?}");
    assert!((f.min_m - plane(-58.0, 58.0)).abs() < 1e-9 && (f.max_m - plane(58.0, -58.0)).abs() < 1e-9);
    assert_eq!((f.max_at, f.error_m), ([MIDDLE[0] + 58.0, MIDDLE[1] - 58.0], 0.5));
    assert!(f.share_without_data.abs() < 1e-12 && f.cells == 58 * 58);
    // Uniform in both axes: the variance is that of the two ranges, less that inside the cells.
    let var = (0.25f64.powi(2) + 0.125f64.powi(2)) * (116.0f64.powi(2) - STEP * STEP) / 12.0;
    assert!((f.std_m - var.sqrt()).abs() < 1e-9, "{} {}", f.std_m, var.sqrt());

    let line = [[WEST + 10.3, NORTH - 10.0], [WEST + 50.3, NORTH - 10.0], [WEST + 50.3, NORTH - 40.0]];
    let p = analysis::profile(&t, &line, None).unwrap();
    assert_eq!(p.len(), 1 + 20 + 15, "a step of 2 m, vertices once");
    assert_eq!(p.iter().filter(|s| s.vertex).count(), 3);
    assert!((p[p.len() - 1].distance_m - 70.0).abs() < 1e-9);
    for s in &p {
        assert!((s.z.unwrap() - plane(s.x - MIDDLE[0], s.y - MIDDLE[1])).abs() < 1e-9);
        assert_eq!(s.error_m, Some(0.5));
    }
}

#[test]
fn contours_of_a_plane_are_straight_and_lie_on_it() {
    let (_w, s) = world(&[&grid("plane", 0.5, plane)]);
    let found = lines(&s, &everything(), 5.0, 2.5);
    // Heights 78.25 .. 121.75: lines at 82.5, 87.5 .. 117.5 and 122.5 is above.
    let heights: Vec<f64> = found.lines.iter().map(|l| l.elevation).collect();
    assert_eq!(heights, [82.5, 87.5, 92.5, 97.5, 102.5, 107.5, 112.5, 117.5]);
    for l in &found.lines {
        assert!(!l.closed && l.error_m == Some(0.5));
        for p in &l.points {
            assert!((plane(p[0] - MIDDLE[0], p[1] - MIDDLE[1]) - l.elevation).abs() < 1e-9);
        }
        // Higher ground, to the south-east, lies on the left.
        let (a, b) = (l.points[0], l.points[l.points.len() - 1]);
        assert!((b[0] - a[0]) * -0.125 - (b[1] - a[1]) * 0.25 > 0.0, "{a:?} {b:?}");
    }
}

#[test]
fn contours_of_a_cone_are_rings_around_its_summit() {
    let (_w, s) = world(&[&grid("cone", 0.0, |x, y| 200.0 - x.hypot(y))]);
    let found = lines(&s, &everything(), 10.0, 0.0);
    let rings: Vec<_> = found.lines.iter().filter(|l| l.closed).collect();
    let heights: Vec<f64> = rings.iter().map(|l| l.elevation).collect();
    // 200 is the summit itself: no ring. Radius 60 leaves the grid: four open lines in its corners.
    assert_eq!(heights, [150.0, 160.0, 170.0, 180.0, 190.0]);
    for l in rings {
        assert_eq!(l.points[0], l.points[l.points.len() - 1]);
        let r = 200.0 - l.elevation;
        let around = |p: &[f64; 2]| [p[0] - MIDDLE[0], p[1] - MIDDLE[1]];
        for p in l.points.iter().map(around) {
            // A chord of the cone between two posts 2 m apart lies below it by at most 1 / (2 r).
            assert!((p[0].hypot(p[1]) - r).abs() < 1.0 / (2.0 * r) + 1e-6, "{p:?} at {r}");
        }
        let twice: f64 = l
            .points
            .windows(2)
            .map(|w| {
                let (a, b) = (around(&w[0]), around(&w[1]));
                a[0] * b[1] - a[1] * b[0]
            })
            .sum();
        assert!(
            (twice / 2.0 / (std::f64::consts::PI * r * r) - 1.0).abs() < 0.02,
            "the summit is on the left"
        );
    }
    let open: Vec<f64> = found.lines.iter().filter(|l| !l.closed).map(|l| l.elevation).collect();
    assert_eq!(open, [[120.0; 4], [130.0; 4], [140.0; 4]].concat());
}

#[test]
fn vertices_of_contours_lie_on_the_surface_and_lines_end_at_voids_and_borders_only() {
    for seed in seeds(4) {
        let mut r = Random::new(seed);
        // A saddle in every other cell, and a hole.
        let mut g = grid("rough", 0.0, |x, y| 50.0 + x * y / 100.0);
        g.z.iter_mut().for_each(|z| *z += (r.unit() * 6.0) as f32);
        for k in [30 * N + 30, 30 * N + 31, 12 * N + 40] {
            g.z[k] = f32::NAN;
        }
        let (_w, s) = world(&[&g]);
        let found = lines(&s, &everything(), 2.0, 0.125);
        let points: Vec<[f64; 2]> = found.lines.iter().flat_map(|l| l.points.iter().copied()).collect();
        let heights = s.heights(&points, &Tolerance::Constant(0.0), Blend::Exact).unwrap();
        let mut at = heights.iter();
        let mut ends = 0;
        for l in &found.lines {
            for p in &l.points {
                let z =
                    at.next().unwrap().as_ref().unwrap_or_else(|| panic!("seed {seed}: no data at {p:?}")).z;
                assert!((z - l.elevation).abs() < 1e-5, "seed {seed}: {z} on the line {}", l.elevation);
            }
            assert_eq!(l.closed, l.points[0] == l.points[l.points.len() - 1]);
            if !l.closed {
                for p in [l.points[0], l.points[l.points.len() - 1]] {
                    let (c, row) = ((p[0] - WEST) / STEP, (NORTH - p[1]) / STEP);
                    let border = c < 1.001 || row < 1.001 || c > 58.999 || row > 58.999;
                    // Heights end two posts from a void: one cell outside the core.
                    let hole = [[30.0, 30.0], [31.0, 30.0], [40.0, 12.0]]
                        .iter()
                        .any(|h: &[f64; 2]| (h[0] - c).abs() < 2.001 && (h[1] - row).abs() < 2.001);
                    assert!(border || hole, "seed {seed}: a line ends at {c}, {row}");
                    ends += usize::from(hole);
                }
            }
        }
        assert!(found.lines.len() > 100 && ends > 0, "seed {seed}: {} lines", found.lines.len());
    }
}

#[test]
fn a_volume_between_two_planes_and_its_worst_case() {
    let before = grid("before", 0.5, plane);
    // Raised by 3 m in the west half, dug by 1 m in the east: the step is at a post line.
    let after = Grid {
        precedence: Some(1),
        ..grid("after", 0.25, |x, y| plane(x, y) + if x < 0.0 { 3.0 } else { -1.0 })
    };
    let (w, s) = world(&[&before, &after]);
    let first = w.db.snapshot(Some(1)).unwrap();
    let stop = AtomicBool::new(false);
    let quiet = Progress { report: &|_, _| (), stop: &stop };
    let only = s.only(&["before".into()], &quiet).unwrap();
    let q = query(Area::Box([WEST + 10.0, NORTH - 50.0, WEST + 110.0, NORTH - 10.0]));
    for from in [&first, &only] {
        let (a, b) = (Terrain::new(from, &q).unwrap(), Terrain::new(&s, &q).unwrap());
        let g = analysis::Grid::new(&[&a, &b], &q.area, None, None).unwrap();
        let mut seen = 0;
        let c = analysis::volumes(&a, &b, &g, Some(0.0), &|_| true, |_, row| {
            seen += row.iter().filter(|d| !d.is_nan()).count();
            Ok(())
        })
        .unwrap();
        assert_eq!((seen, c.cells), (1000, 1000));
        // 48 m of +3, one cell from +3 to -1 (mean +1), 50 m of -1; 40 m wide.
        let (fill, cut) = ((48.0 * 3.0 + 2.0) * 40.0, 50.0 * 40.0);
        for (found, meant) in [
            (c.fill_m3, fill),
            (c.cut_m3, cut),
            (c.net_m3, fill - cut),
            (c.area_m2, 4000.0),
            (c.net_bound_m3, 0.75 * 4000.0),
            (c.fill_range_m3[0], (48.0 * 2.25 + 2.0 * 0.25) * 40.0),
            (c.fill_range_m3[1], (48.0 * 3.75 + 2.0 * 1.75) * 40.0),
            (c.cut_range_m3[0], 50.0 * 0.25 * 40.0),
            (c.cut_range_m3[1], 50.0 * 1.75 * 40.0),
            // Uniform errors, each of the 1000 cells of 4 m2 on its own.
            (c.net_std_m3, ((0.25 + 0.0625) / 3.0 * 16.0 * 1000.0f64).sqrt()),
        ] {
            assert!((found - meant).abs() < 1e-3, "{found} {meant} in {c:?}");
        }
        assert_eq!((c.changed_m2, c.error_m), (4000.0, 0.75));
    }
}

#[test]
fn some_surveys_of_a_version_are_what_they_make_alone() {
    for seed in seeds(8) {
        let mut r = Random::new(seed);
        let grids: Vec<Grid> = (0..4).map(|k| random_grid(&mut r, &format!("s{k}"), 90)).collect();
        let (_all, s) = world(&grids.iter().collect::<Vec<_>>());
        let kept: Vec<&Grid> = grids.iter().filter(|_| r.chance(0.5)).collect();
        let kept = if kept.is_empty() { vec![&grids[0]] } else { kept };
        let names: Vec<String> = kept.iter().map(|g| g.name.clone()).collect();
        let stop = AtomicBool::new(false);
        let only = s.only(&names, &Progress { report: &|_, _| (), stop: &stop }).unwrap();
        let (_w, fresh) = world(&kept);
        assert_eq!(
            db::fingerprint(&only).unwrap(),
            db::fingerprint(&fresh).unwrap(),
            "seed {seed}: {names:?}"
        );
        let points: Vec<[f64; 2]> =
            (0..200).map(|_| [500_000.0 + r.unit() * 400.0, 4_000_000.0 + r.unit() * 400.0]).collect();
        let z = |s: &Snapshot| s.heights(&points, &Tolerance::Constant(1.0), Blend::Exact).unwrap();
        assert_eq!(z(&only), z(&fresh), "seed {seed}");
    }
}

#[test]
fn surveys_that_contradict_each_other_are_told_before_and_after() {
    let base = grid("base", 0.5, plane);
    // 4 m steps; 5 m higher in the east.
    let mut coarse = grid("coarse", 1.0, |_, _| 0.0);
    (coarse.cols, coarse.rows) = (31, 31);
    coarse.affine = Affine { col_step: [4.0, 0.0], row_step: [0.0, -4.0], ..coarse.affine };
    let at = |k: usize| (k as f64 - 15.0) * 4.0;
    coarse.z = (0..31 * 31)
        .map(|k| (plane(at(k % 31), -at(k / 31)) + if k % 31 >= 15 { 5.0 } else { 0.0 }) as f32)
        .collect();
    let mut told = Vec::new();
    for order in [[&base, &coarse], [&coarse, &base]] {
        let w = Scratch::new(Policy::Accuracy);
        assert!(w.ingest(order[0]).contradictions.is_empty());
        let stop = AtomicBool::new(false);
        let quiet = Progress { report: &|_, _| (), stop: &stop };
        let dry = w.db.change(Change::Ingest(order[1].ingest()), None, true, &quiet, &mut || ()).unwrap();
        assert_eq!(w.db.snapshot(None).unwrap().number(), 1, "a dry run writes nothing");
        let done = w.ingest(order[1]);
        assert_eq!(dry.contradictions, done.contradictions);
        let mut found = Vec::new();
        let s = w.db.snapshot(None).unwrap();
        s.contradictions(None, |o| {
            let (pieces, _) = analysis::dissolve(o.cols, o.rows, |c, r| o.contradicts(c, r));
            assert_eq!((pieces.len(), pieces[0].cells), (1, 16 * 30));
            // The eastern half, and the cells that lead to it: from 4 m west of the middle on.
            assert!(
                o.at([MIDDLE[0] + 30.0, MIDDLE[1]]) == -5.0 && o.at([MIDDLE[0] - 30.0, MIDDLE[1]]) == 0.0
            );
            assert!(o.at([MIDDLE[0] + 300.0, MIDDLE[1]]).is_nan());
            found.push(o.found);
            Ok(())
        })
        .unwrap();
        assert_eq!(found, done.contradictions);
        told.extend(found);
    }
    assert_eq!(told[0], told[1], "in either order");
    let c = &told[0];
    assert_eq!((c.coarser.as_str(), c.finer.as_str(), c.cells, c.every), ("coarse", "base", 900, 1));
    assert_eq!((c.allowed_m, c.contradicted_cells), (1.5, 480));
    // 15 columns of -5, one of -2.5, 14 of 0.
    assert!((c.share - 480.0 / 900.0).abs() < 1e-12 && (c.mean_m + 77.5 / 30.0).abs() < 1e-6, "{c:?}");
    assert!((c.overlap_m2 - 14_400.0).abs() < 1e-3 && c.largest_m == -5.0 && c.hint.is_none());
}

#[test]
fn a_tile_that_arrives_is_compared_where_it_lies() {
    let flat = grid("flat", 0.0, |_, _| 10.0);
    let raised = grid("raised", 0.0, |x, _| if x > 0.0 { 12.0 } else { 10.0 });
    // West and east halves share the column of posts in the middle.
    let (west, east) = (raised.cut(0, 0, 31, N), raised.cut(30, 0, 31, N));
    let w = Scratch::new(Policy::Accuracy);
    w.ingest(&flat);
    assert!(w.ingest(&west).contradictions.is_empty());
    let tile = Ingest { into: Some("raised".into()), ..raised.tiles_of(vec![east.source()]) };
    let found = w.change(Change::Ingest(tile)).unwrap().contradictions;
    // One or two columns of cells around the tile are looked at, too.
    assert!(found[0].contradicted_cells == 30 * 60 && found[0].cells <= 32 * 60, "{found:?}");
    // The other way round: the survey below is the one that was there first.
    let w = Scratch::new(Policy::Accuracy);
    w.ingest(&raised);
    assert!(w.ingest(&flat.cut(0, 0, 31, N)).contradictions.is_empty());
    let tile = Ingest { into: Some("flat".into()), ..flat.tiles_of(vec![flat.cut(30, 0, 31, N).source()]) };
    let found = w.change(Change::Ingest(tile)).unwrap().contradictions;
    assert_eq!(found[0].contradicted_cells, 30 * 60, "{found:?}");
}

#[test]
fn a_datum_slip_is_suggested_and_agreement_is_silent() {
    let w = Scratch::new(Policy::Accuracy);
    w.ingest(&grid("a", 0.5, plane));
    let slip = w.ingest(&grid("slip", 0.5, |x, y| plane(x, y) + 1.2)).contradictions;
    assert_eq!(slip.len(), 1);
    assert!(
        slip[0].hint.as_ref().unwrap().contains("datum slip?") && (slip[0].mean_m.abs() - 1.2).abs() < 1e-5
    );
    assert!(w.ingest(&grid("within", 0.5, |x, y| plane(x, y) + 0.6)).contradictions.is_empty());
}

#[test]
fn a_ridge_hides_and_the_error_leaves_it_undecided() {
    // A ridge of 10 m along the middle.
    let ridge = |x: f64, _: f64| 10.0 - x.abs().min(10.0);
    let (_w, s) = world(&[&grid("ridge", 0.25, ridge)]);
    let t = Terrain::new(&s, &everything()).unwrap();
    let look = |h: f64, refraction| {
        let end = |x: f64| End { at: [MIDDLE[0] + x, MIDDLE[1] + 1.0], height: h, absolute: false };
        sight(&t, end(-50.0), end(50.0), SightOptions { step_m: None, refraction }).unwrap()
    };
    let hidden = look(5.0, None);
    assert_eq!((hidden.verdict, hidden.on_surface), (Verdict::Hidden, Verdict::Hidden));
    let first = hidden.obstruction.unwrap();
    // The ground passes 5 m half way up the ridge: the next metre is in the way.
    assert!(
        (first.x - (MIDDLE[0] - 4.0)).abs() < 1e-9 && (first.distance_m - 46.0).abs() < 1e-9,
        "{first:?}"
    );
    let closest = hidden.closest.unwrap();
    assert!((closest.clearance_m.unwrap() + 5.0).abs() < 1e-9 && closest.error_m == Some(0.5));
    assert_eq!((look(10.6, None).verdict, look(10.4, None).verdict), (Verdict::Visible, Verdict::Undecided));
    assert_eq!(
        (look(10.4, None).on_surface, look(9.6, None).verdict),
        (Verdict::Visible, Verdict::Undecided)
    );
    assert_eq!(look(9.4, None).verdict, Verdict::Hidden);
    // The bulge of 50 m to either side: 50 * 50 * 0.87 / (2 R).
    let (flat, round) = (look(20.0, None).rays, look(20.0, Some(0.13)).rays);
    let mid = flat.len() / 2;
    let bulge = flat[mid].clearance_m.unwrap() - round[mid].clearance_m.unwrap();
    assert!((bulge - 2500.0 * 0.87 / 2.0 / 6_371_008.8).abs() < 1e-9, "{bulge}");
    // Beyond the data nothing is promised.
    let far = End { at: [MIDDLE[0] + 500.0, MIDDLE[1]], height: 90.0, absolute: true };
    let near = End { at: [MIDDLE[0] + 20.0, MIDDLE[1]], ..far };
    let found = sight(&t, near, far, SightOptions { step_m: Some(5.0), refraction: None }).unwrap();
    assert!(found.verdict == Verdict::Undecided && found.without_data > 80, "{}", found.without_data);
}

/// Writes a float32 GeoTIFF.
fn write_tif(path: &Path, epsg: u32, affine: Affine, cols: usize, z: &[f32]) {
    let spec = GeoTiffSpec {
        cols: cols as u64,
        rows: (z.len() / cols) as u64,
        sample_type: SampleType::F32,
        affine: Some(affine),
        crs: Some(Crs::from_epsg(epsg).unwrap()),
        nodata: None,
        scale: 1.0,
        offset: 0.0,
        vertical_datum: None,
    };
    let mut out = GeoTiffWriter::create(path, spec).unwrap();
    let data: Vec<u8> = z.iter().flat_map(|v| v.to_le_bytes()).collect();
    out.write_rows(0, &data).unwrap();
    out.finish().unwrap();
}

/// The samples of a float32 file.
fn read_tif(path: &Path) -> ([usize; 2], Vec<f32>) {
    let mut f = terraquilt::format::open(path).unwrap();
    let (cols, rows) = (f.info().cols as usize, f.info().rows as usize);
    let s = f.read(Window { col: 0, row: 0, cols, rows }).unwrap();
    let z = s.data.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    ([cols, rows], z)
}

#[test]
fn degrees_become_metres_of_their_latitude() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("slope.tif");
    // Rises 1000 m a degree towards east and north, around 10 east, 60 north; posts every 0.001 degrees.
    let affine = Affine { origin: [10.0, 60.0], col_step: [0.001, 0.0], row_step: [0.0, -0.001] };
    let z: Vec<f32> = (0..50 * 50).map(|k| (k % 50) as f32 - (k / 50) as f32 + 100.0).collect();
    write_tif(&file, 4326, affine, 50, &z);
    let db = Db::create(
        &folder.path().join("db"),
        &Options { crs: Crs::from_epsg(4326).unwrap(), policy: Policy::Accuracy, patch: Kind::Bilinear },
    )
    .unwrap();
    let sources = vec![terraquilt::format::open(&file).unwrap()];
    let request = Ingest { name: Some("slope".into()), ..grid("slope", 0.0, |_, _| 0.0).tiles_of(sources) };
    crate::support::change(&db, Change::Ingest(request)).unwrap();
    let path = folder.path().join("db");
    let path = path.to_str().unwrap();
    let out = folder.path().join("percent.tif");
    printed(&["slope", path, out.to_str().unwrap(), "--error", "0", "--percent"]);
    let ([cols, rows], percent) = read_tif(&out);
    assert_eq!([cols, rows], [47, 47]);
    for row in [0, 20, 46] {
        let k = metres_per_unit(db.crs().unit, [10.0, 60.0 - 0.001 * (row as f64 + 1.5)]);
        let meant = 100.0 * (1000.0 / k[0]).hypot(1000.0 / k[1]);
        assert!((f64::from(percent[row * cols + 7]) - meant).abs() < 1e-3, "row {row}");
    }
    let found: Value =
        serde_json::from_str(&printed(&["statistics", path, "--error", "0", "--json"])).unwrap();
    let area: f64 = (0..47)
        .map(|r| {
            let k = metres_per_unit(db.crs().unit, [10.0, 60.0 - 0.001 * (f64::from(r) + 1.5)]);
            47.0 * k[0] * k[1] * 1e-6
        })
        .sum();
    assert!((found["area_m2"].as_f64().unwrap() / area - 1.0).abs() < 1e-9);
    let p: Value = serde_json::from_str(&printed(&[
        "profile",
        path,
        "--error",
        "0",
        "--json",
        "--line",
        "10.01,59.98",
        "10.03,59.98",
        "--step",
        "10",
    ]))
    .unwrap();
    let k = metres_per_unit(db.crs().unit, [10.02, 59.98]);
    assert!((p["length_m"].as_f64().unwrap() - 0.02 * k[0]).abs() < 1e-6, "{p}");
    assert_eq!(p["points"].as_array().unwrap().len(), 1 + (0.02 * k[0] / 10.0).ceil() as usize);
    assert!(refused(&["profile", path, "--error", "0", "--line", "1,1", "2,2"], 1).contains("holds no data"));
}

#[test]
fn the_volume_of_the_dome_is_that_of_the_files() -> Result<()> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("db");
    let path = path.to_str().unwrap();
    let file = |n: &str| bundled("st_helens").join(n);
    let (before, after) = (file("survey_2000-09-25_native.tif"), file("crater_2005-06-15_10m.tif"));
    printed(&["init", path, "--crs", "EPSG:26910", "--policy", "newest"]);
    printed(&[
        "ingest",
        path,
        before.to_str().unwrap(),
        "--name",
        "a",
        "--accuracy",
        "2",
        "--date",
        "2000-09-25",
    ]);
    let out = printed(&[
        "ingest",
        path,
        after.to_str().unwrap(),
        "--name",
        "b",
        "--accuracy",
        "2",
        "--date",
        "2005-06-15",
    ]);
    assert!(
        out.contains("'a' and 'b' contradict each other") || out.contains("'b' and 'a' contradict"),
        "{out}"
    );
    let between = ["--from-surveys", "a", "--to-surveys", "b", "--error", "0"];
    let c: Value =
        serde_json::from_str(&printed(&[&["volume", path, "--json"], &between[..]].concat())).unwrap();
    // Both files lie on one grid: the mean of four posts is the centre of a cell. Cores lie one cell inside.
    let ([cols, rows], a) = read_tif(&before);
    let (_, b) = read_tif(&after);
    let d = |c: usize, r: usize| f64::from(b[r * cols + c]) - f64::from(a[r * cols + c]);
    let (mut net, mut fill) = (0.0, 0.0);
    for r in 1..rows - 2 {
        for c in 1..cols - 2 {
            let mean = (d(c, r) + d(c + 1, r) + d(c, r + 1) + d(c + 1, r + 1)) / 4.0;
            net += mean * 100.0;
            fill += mean.max(0.0) * 100.0;
        }
    }
    println!("net {net} m3, volume {}", c["net_m3"]);
    assert!(
        (c["net_m3"].as_f64().unwrap() - net).abs() < 1.0
            && (c["fill_m3"].as_f64().unwrap() - fill).abs() < 1.0
    );
    assert!((62e6..64e6).contains(&net), "{net}");
    // Two versions give the same, as the second survey covers the first.
    let v: Value =
        serde_json::from_str(&printed(&["volume", path, "--json", "--from", "1", "--error", "0"])).unwrap();
    assert!((v["net_m3"].as_f64().unwrap() - net).abs() < 1.0, "{v}");
    // The rasters: the dome stands in the difference; every picture is a PNG.
    let tif = folder.path().join("d.tif");
    printed(&[&["difference", path, tif.to_str().unwrap()], &between[..]].concat());
    let (_, raster) = read_tif(&tif);
    let sum: f64 = raster.iter().map(|v| f64::from(*v) * 100.0).sum();
    assert!((sum - net).abs() < 10.0, "{sum} {net}");
    for (name, args) in
        [("difference", &between[..]), ("slope", &["--error", "5"]), ("aspect", &["--error", "5"])]
    {
        let png = folder.path().join(format!("{name}.png"));
        printed(&[&[name, path, png.to_str().unwrap()], args].concat());
        assert!(std::fs::read(&png).unwrap().starts_with(b"\x89PNG"), "{name}");
    }
    let map = folder.path().join("map.geojson");
    let told: Value =
        serde_json::from_str(&printed(&["contradictions", path, map.to_str().unwrap(), "--json"])).unwrap();
    let polygons: Value = serde_json::from_slice(&std::fs::read(&map).unwrap()).unwrap();
    let area: f64 = polygons["features"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["properties"]["area_m2"].as_f64().unwrap())
        .sum();
    assert!((area - told[0]["contradicted_m2"].as_f64().unwrap()).abs() < 1.0);
    Ok(())
}

#[test]
fn what_cannot_be_answered_is_said_in_a_sentence() {
    let w = Scratch::new(Policy::Accuracy);
    let path = w.path();
    let db = path.to_str().unwrap();
    let out = w.folder.path().join("out.geojson");
    let out = out.to_str().unwrap();
    for command in [
        &["statistics", db, "--error", "0"][..],
        &["contours", db, out, "--error", "0", "--interval", "5"],
        &["profile", db, "--error", "0", "--line", "0,0", "9,9"],
    ] {
        let text = refused(command, 1);
        assert!(text.contains("terraquilt"), "{text}");
    }
    assert!(printed(&["contradictions", db]).contains("no two surveys"));
    w.ingest(&grid("a", 0.5, plane));
    let away = "600000,4000000,600100,4000100";
    for (command, word) in [
        (&["statistics", db, "--error", "0", "--bbox", away][..], "holds no data"),
        (&["contours", db, out, "--error", "0", "--interval", "0"], "positive"),
        (&["contours", db, out, "--error", "0", "--interval", "1e-9"], "at most"),
        (&["contours", db, "out.shp", "--error", "0", "--interval", "5"], ".geojson"),
        (&["slope", db, "out.glb", "--error", "0"], ".tif or .png"),
        (&["slope", db, "out.tif", "--error", "0", "--step", "0"], "positive"),
        (&["profile", db, "--error", "0", "--line", "5,5", "5,5"], "the same"),
        (&["profile", db, "--error", "0", "--line-file", "no.geojson"], "check the name"),
        (&["volume", db, "--from", "1", "--to", "1", "--error", "0"], "same version"),
        (&["volume", db, "--from", "9", "--error", "0"], "version 9"),
        (&["volume", db, "--from-surveys", "b", "--to-surveys", "a", "--error", "0"], "survey 'b' not found"),
        (&["sight", db, "--error", "0", "--from", "500060,4000060", "--to", "900000,4000060"], "--absolute"),
        (&["hillshade", db, "out.tif", "--error", "0", "--altitude", "100"], "between 0 and 90"),
        (&["contradictions", db, "--surveys", "a"], "two surveys"),
    ] {
        let text = refused(command, 1);
        assert!(text.contains(word), "{command:?}: {text}");
    }
    assert_eq!(program(&["volume", db, "--error", "0"]).status.code(), Some(2));
    assert!(!Path::new(out).exists(), "nothing half done");
    // The light is that of the library.
    let shade = Shape::Hillshade(Sun::default()).of([0.25, -0.125]) as f32;
    let tif = w.folder.path().join("shade.tif");
    printed(&["hillshade", db, tif.to_str().unwrap(), "--error", "0"]);
    assert!(read_tif(&tif).1.iter().all(|v| (v - shade).abs() < 1e-3), "{shade}");
}
