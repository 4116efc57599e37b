//! Corrections of seams as they travel: a client bends the surface as the server does.

use super::queries::{error_m, helens, served};
use super::worlds::{Random, Scratch, random_grid, seeds};
use std::collections::BTreeMap;
use terraquilt::client::query::Patches;
use terraquilt::codec::corrections;
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::db::{CorrectionPart, Policy, Snapshot};
use terraquilt::height::lod::SurveyNumber;
use terraquilt::height::patch::Kind;
use terraquilt::height::surface::seam::Field;
use terraquilt::height::surface::{Blend, How, Seams};
use terraquilt::wire::v1;

const ALL: How = How { blend: Blend::Exact, seams: Seams::All };

fn asked(e: f64, seams: v1::Seams, at: u64) -> v1::PatchesRequest {
    v1::PatchesRequest { tolerance: error_m(e), seams: seams as i32, at, ..Default::default() }
}

/// The ramp of fades along the tolerance.
fn ramp(smooth: bool, t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    if smooth { t * t * t * (10.0 + t * (6.0 * t - 15.0)) } else { t }
}

/// What a client knows of a survey: anchor, u and v of its frame, CRS units.
type Frames = BTreeMap<u32, [[f64; 2]; 3]>;

/// What bends the surveys of an answer.
struct Bends {
    frames: Frames,
    fields: BTreeMap<(u32, i32, i32), Field>,
    smooth: bool,
}

impl Bends {
    fn travelled(found: &Patches) -> Bends {
        let size = 2f64.powi(found.header.ground.as_ref().unwrap().lattice_unit_log2);
        let frame = |f: &v1::SurveyFrame| {
            let points = [[f.anchor_x, f.anchor_y], [f.u_x, f.u_y], [f.v_x, f.v_y]];
            (f.survey, points.map(|p| p.map(|v| v as f64 * size)))
        };
        let field = |c: &v1::CorrectionBlock| ((c.survey, c.i, c.j), corrections::unpack(&c.nodes).unwrap());
        let frames = found.header.surveys.iter().map(frame).collect();
        Bends { frames, fields: found.corrections.iter().map(field).collect(), smooth: false }
    }

    /// Without a server.
    fn of(s: &Snapshot, query: &Query, smooth: bool) -> Bends {
        let selection = s.select(query).unwrap();
        let size = s.unit().size();
        let frame = |n: SurveyNumber| {
            let f = s.survey_by_number(n).unwrap().geometry.frame;
            (n.0, [f.anchor, f.u, f.v].map(|p| [p.x as f64 * size, p.y as f64 * size]))
        };
        let frames = s.surveys_of(&selection).into_iter().map(frame).collect();
        let parts = s.corrections(&selection, query.how).unwrap();
        let field = |c: &CorrectionPart| ((c.survey.0, c.i, c.j), corrections::unpack(&c.nodes).unwrap());
        Bends { frames, fields: parts.iter().map(field).collect(), smooth }
    }

    /// The correction of a survey at a point and a tolerance.
    fn at(&self, survey: u32, p: [f64; 2], z: f64) -> f64 {
        let [anchor, u, v] = self.frames[&survey];
        let [dx, dy] = [p[0] - anchor[0], p[1] - anchor[1]];
        let det = u[0] * v[1] - u[1] * v[0];
        let index = [(dx * v[1] - dy * v[0]) / det, (u[0] * dy - u[1] * dx) / det];
        let place = index.map(|c| (c / 28.0).floor());
        let [x, y] = [0, 1].map(|k| index[k] - 28.0 * place[k]);
        let field = self.fields.get(&(survey, place[0] as i32, place[1] as i32));
        field.map_or(0.0, |f| f.at(x, y, z, |t: f64| ramp(self.smooth, t)).0)
    }

    /// How many points are bent, and by how much the sum over who makes a height differs from what the server says.
    fn compare(&self, s: &Snapshot, points: &[[f64; 2]], z: f64, how: How) -> (usize, f64) {
        let tolerance = Tolerance::Constant(z);
        let heights = s.heights(points, &tolerance, how).unwrap();
        let makers = s.explained(points, &tolerance, how).unwrap();
        let (mut bent, mut worst) = (0, 0.0f64);
        for ((p, height), makers) in points.iter().zip(&heights).zip(&makers) {
            let Some(height) = height else { continue };
            let own: f64 = makers.iter().flatten().map(|(r, share)| share * self.at(r.survey.0, *p, z)).sum();
            bent += usize::from(height.correction_m != 0.0);
            worst = worst.max((own - height.correction_m).abs());
        }
        (bent, worst)
    }
}

/// The box around the survey of 2004, whose border lies inside that of 2000, and 100 m more.
fn dome(s: &Snapshot) -> [f64; 4] {
    let b = s.survey_by_number(SurveyNumber(2)).unwrap().geometry.bounds();
    let size = s.unit().size();
    let at = |v: i64, by: f64| v as f64 * size + by;
    [at(b.min.x, -100.0), at(b.min.y, -100.0), at(b.max.x, 100.0), at(b.max.y, 100.0)]
}

fn scattered(b: [f64; 4], r: &mut Random, count: usize) -> Vec<[f64; 2]> {
    (0..count).map(|_| [b[0] + (b[2] - b[0]) * r.unit(), b[1] + (b[3] - b[1]) * r.unit()]).collect()
}

#[tokio::test]
async fn a_client_bends_the_surface_as_the_server_does() {
    let (server, client) = served().await;
    let now = helens().snapshot(Some(2)).unwrap();
    let points = scattered(dome(&now), &mut Random::new(7), 1500);
    for (name, seams) in [(v1::Seams::All, Seams::All), (v1::Seams::Consistent, Seams::Consistent)] {
        let how = How { blend: Blend::Exact, seams };
        for e in [0.0, 4.0, 20.0] {
            let found = client.patches(asked(e, name, 2)).await.unwrap();
            let bends = Bends::travelled(&found);
            let bytes: usize = found.corrections.iter().map(|c| c.nodes.len()).sum();
            let blocks = bends.fields.len();
            let (bent, worst) = bends.compare(&now, &points, e, how);
            println!(
                "{name:?}, {e} m: {} blocks of {} bytes, {bent} of {} points bent, {worst:.1e} m off",
                blocks,
                bytes / blocks.max(1),
                points.len()
            );
            assert!(worst < 1e-6 && blocks > 5 && bent > 50, "{worst} m, {bent} points");
        }
    }
    let bare = v1::PatchesRequest { descriptors_only: true, ..asked(0.0, v1::Seams::All, 2) };
    assert!(client.patches(bare).await.unwrap().corrections.is_empty());
    assert!(client.patches(asked(0.0, v1::Seams::Off, 2)).await.unwrap().corrections.is_empty());
    let alone = client.patches(asked(0.0, v1::Seams::All, 1)).await.unwrap();
    assert!(alone.corrections.is_empty(), "one survey has no seam");
    server.stop().await.unwrap();
}

#[test]
fn random_worlds_are_bent_by_their_parts_alone() {
    let (mut bent, mut blocks) = (0, 0);
    for seed in seeds(4) {
        let mut r = Random::new(seed);
        let (policy, patch) =
            if r.chance(0.5) { (Policy::Accuracy, Kind::Bilinear) } else { (Policy::Newest, Kind::Bicubic) };
        let world = Scratch::of(policy, patch);
        for k in 0..3 {
            world.ingest(&random_grid(&mut r, &format!("s{k}"), 60));
        }
        let s = world.db.snapshot(None).unwrap();
        let z = r.unit() * 8.0;
        let query = Query { area: Area::Everything, tolerance: Tolerance::Constant(z), how: ALL };
        let bends = Bends::of(&s, &query, patch == Kind::Bicubic);
        let (some, worst) = bends.compare(&s, &scattered(s.bounds().unwrap(), &mut r, 400), z, ALL);
        assert!(worst < 1e-6, "seed {seed}, {z} m: {worst} m");
        (bent, blocks) = (bent + some, blocks + bends.fields.len());
    }
    assert!(bent > 20 && blocks > 8, "{bent} points, {blocks} blocks");
}

#[test]
fn the_corrections_of_a_part_are_those_of_the_whole() {
    let now = helens().snapshot(Some(2)).unwrap();
    let ask = |area| {
        let tolerance = Tolerance::Constant(1.0);
        let query = Query { area, tolerance, how: ALL };
        now.corrections(&now.select(&query).unwrap(), ALL).unwrap()
    };
    let whole = ask(Area::Everything);
    assert!(whole.is_sorted_by(|a, b| a.key() < b.key()));
    let mut some = 0;
    for [x, y] in scattered(dome(&now), &mut Random::new(3), 20) {
        let part = ask(Area::Box([x, y, x + 300.0, y + 300.0]));
        assert!(part.iter().all(|c| whole.contains(c)));
        some += part.len();
    }
    assert!(some > 20 && some < 20 * whole.len(), "{some} of {}", whole.len());
}

#[tokio::test]
async fn differences_lead_to_the_corrections_of_the_other_version() {
    let (server, client) = served().await;
    let key = |c: &v1::CorrectionBlock| (c.survey, c.i, c.j);
    for (from, to) in [(0, 1), (0, 2), (1, 2), (2, 1), (2, 2)] {
        let seams = v1::Seams::All as i32;
        let request =
            v1::DifferenceRequest { tolerance: error_m(1.0), seams, from, to, ..Default::default() };
        let d = client.difference(request).await.unwrap();
        let held = match from {
            0 => Vec::new(),
            at => client.patches(asked(1.0, v1::Seams::All, at)).await.unwrap().corrections,
        };
        let mut held: BTreeMap<_, _> = held.into_iter().map(|c| (key(&c), c)).collect();
        for gone in &d.corrections_removed {
            assert!(gone.nodes.is_empty() && held.remove(&key(gone)).is_some(), "{gone:?}");
        }
        for c in d.corrections {
            let old = held.insert(key(&c), c.clone());
            assert_ne!(old, Some(c), "told again as it was");
        }
        let known = client.patches(asked(1.0, v1::Seams::All, to)).await.unwrap().corrections;
        assert_eq!(held.into_values().collect::<Vec<_>>(), known, "{from} to {to}");
        assert_eq!(known.is_empty(), to == 1);
    }
    server.stop().await.unwrap();
}

#[tokio::test]
async fn budgets_count_corrections() {
    use prost::Message;
    let (server, client) = served().await;
    let whole = client.patches(asked(0.0, v1::Seams::All, 2)).await.unwrap();
    let part = v1::PatchesPart {
        patches: whole.patches.clone(),
        masks: whole.masks.clone(),
        corrections: whole.corrections.clone(),
        ..Default::default()
    };
    let most = part.encoded_len() as u64 * 2 / 3;
    let request = v1::PatchesRequest { max_bytes: Some(most), ..asked(0.0, v1::Seams::All, 2) };
    let found = client.patches(request).await.unwrap();
    let part = v1::PatchesPart {
        patches: found.patches,
        masks: found.masks,
        corrections: found.corrections,
        ..Default::default()
    };
    let used = part.encoded_len() as u64;
    assert!(found.header.factor > 1.0 && used <= most && used > most / 3, "{used} of {most} bytes");
    server.stop().await.unwrap();
}
