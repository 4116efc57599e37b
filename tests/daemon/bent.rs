//! Corrections of seams as they travel: a client bends the surface as the server does.

use super::queries::{error_m, helens, served};
use super::worlds::Random;
use std::collections::BTreeMap;
use terraquilt::client::query::Patches;
use terraquilt::codec::corrections;
use terraquilt::db::query::Tolerance;
use terraquilt::height::surface::seam::Field;
use terraquilt::height::surface::{Blend, How, Seams};
use terraquilt::wire::v1;

const ALL: How = How { blend: Blend::Exact, seams: Seams::All };

fn asked(e: f64, seams: v1::Seams, at: u64) -> v1::PatchesRequest {
    v1::PatchesRequest { tolerance: error_m(e), seams: seams as i32, at, ..Default::default() }
}

fn fields(found: &Patches) -> BTreeMap<(u32, i32, i32), Field> {
    let one = |c: &v1::CorrectionBlock| ((c.survey, c.i, c.j), corrections::unpack(&c.nodes).unwrap());
    found.corrections.iter().map(one).collect()
}

/// The correction of a survey at a point, from what travelled.
fn correction(
    found: &Patches,
    fields: &BTreeMap<(u32, i32, i32), Field>,
    survey: u32,
    p: [f64; 2],
    z: f64,
) -> f64 {
    let size = 2f64.powi(found.header.ground.as_ref().unwrap().lattice_unit_log2);
    let f = found.header.surveys.iter().find(|f| f.survey == survey).unwrap();
    let [dx, dy] = [p[0] / size - f.anchor_x as f64, p[1] / size - f.anchor_y as f64];
    let [ux, uy, vx, vy] = [f.u_x, f.u_y, f.v_x, f.v_y].map(|v| v as f64);
    let det = ux * vy - uy * vx;
    let index = [(dx * vy - dy * vx) / det, (ux * dy - uy * dx) / det];
    let place = index.map(|c| (c / 28.0).floor());
    let [x, y] = [0, 1].map(|k| index[k] - 28.0 * place[k]);
    let field = fields.get(&(survey, place[0] as i32, place[1] as i32));
    field.map_or(0.0, |f| f.at(x, y, z, |t: f64| t.clamp(0.0, 1.0)).0)
}

#[tokio::test]
async fn a_client_bends_the_surface_as_the_server_does() {
    let (server, client) = served().await;
    let now = helens().snapshot(Some(2)).unwrap();
    let b = now.bounds().unwrap();
    let mut r = Random::new(7);
    let mut points = Vec::new();
    while points.len() < 1500 {
        points.push([b[0] + (b[2] - b[0]) * r.unit(), b[1] + (b[3] - b[1]) * r.unit()]);
    }
    for (name, seams) in [(v1::Seams::All, Seams::All), (v1::Seams::Consistent, Seams::Consistent)] {
        let how = How { blend: Blend::Exact, seams };
        for e in [0.0, 4.0, 20.0] {
            let found = client.patches(asked(e, name, 2)).await.unwrap();
            let fields = fields(&found);
            let bytes: usize = found.corrections.iter().map(|c| c.nodes.len()).sum();
            let tolerance = Tolerance::Constant(e);
            let heights = now.heights(&points, &tolerance, how).unwrap();
            let makers = now.explained(&points, &tolerance, how).unwrap();
            let (mut bent, mut worst) = (0, 0.0f64);
            for ((p, height), makers) in points.iter().zip(&heights).zip(&makers) {
                let Some(height) = height else { continue };
                let own: f64 = makers
                    .iter()
                    .flatten()
                    .map(|(r, share)| share * correction(&found, &fields, r.survey.0, *p, e))
                    .sum();
                bent += usize::from(height.correction_m != 0.0);
                worst = worst.max((own - height.correction_m).abs());
            }
            println!(
                "{name:?}, {e} m: {} blocks of {} bytes, {bent} of {} points bent, {worst:.1e} m off",
                fields.len(),
                bytes / fields.len().max(1),
                points.len()
            );
            assert!(worst < 1e-6 && fields.len() > 10 && bent > 50, "{worst} m, {bent} points");
        }
    }
    let bare = v1::PatchesRequest { descriptors_only: true, ..asked(0.0, v1::Seams::All, 2) };
    assert!(client.patches(bare).await.unwrap().corrections.is_empty());
    assert!(client.patches(asked(0.0, v1::Seams::Off, 2)).await.unwrap().corrections.is_empty());
    let alone = client.patches(asked(0.0, v1::Seams::All, 1)).await.unwrap();
    assert!(alone.corrections.is_empty(), "one survey has no seam");
    server.stop().await.unwrap();
}

#[tokio::test]
async fn the_corrections_of_a_part_are_those_of_the_whole() {
    let now = helens().snapshot(Some(2)).unwrap();
    let ask = |area| {
        let tolerance = Tolerance::Constant(1.0);
        let query = terraquilt::db::query::Query { area, tolerance, how: ALL };
        now.corrections(&now.select(&query).unwrap(), ALL).unwrap()
    };
    let whole = ask(terraquilt::db::query::Area::Everything);
    assert!(whole.is_sorted_by(|a, b| a.key() < b.key()));
    let b = now.bounds().unwrap();
    let mut r = Random::new(3);
    let mut some = 0;
    for _ in 0..20 {
        let (x, y) = (b[0] + (b[2] - b[0]) * r.unit(), b[1] + (b[3] - b[1]) * r.unit());
        let part = ask(terraquilt::db::query::Area::Box([x, y, x + 300.0, y + 300.0]));
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
