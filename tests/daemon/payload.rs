//! Payload: a client rebuilds the server's heights, and its masks do not depend on the region.

use super::queries::{error_m, helens, served};
use std::collections::BTreeMap;
use terraquilt::client::query::unpacked;
use terraquilt::codec::cells;
use terraquilt::db::query::Tolerance;
use terraquilt::height::lod::SIDE;
use terraquilt::height::lod::cut::Region;
use terraquilt::height::surface::Blend;
use terraquilt::wire::v1;

#[tokio::test]
async fn vertices_are_the_heights_of_the_server() {
    let (server, client) = served().await;
    let db = helens();
    let now = db.snapshot(Some(1)).unwrap();
    let request = v1::PatchesRequest { tolerance: error_m(0.0), at: 1, ..Default::default() };
    let found = client.patches(request).await.unwrap();
    let f = &found.header.surveys[0];
    let size = 2f64.powi(found.header.ground.as_ref().unwrap().lattice_unit_log2);
    let (mut points, mut known) = (Vec::new(), Vec::new());
    for p in found.patches.iter().filter(|p| p.level == 0) {
        let z = unpacked(p).unwrap();
        for (k, z) in z.iter().enumerate() {
            let (a, b) = ((k % SIDE) as i64, (k / SIDE) as i64);
            let (i, j) = (28 * i64::from(p.i) - 2 + a, 28 * i64::from(p.j) - 2 + b);
            // Strictly inside the ground that is measured: one survey, so every contributor has this height.
            if i > f.core_i0 && i < f.core_i1 && j > f.core_j0 && j < f.core_j1 {
                let at = |anchor: i64, u: i64, v: i64| (anchor + i * u + j * v) as f64 * size;
                points.push([at(f.anchor_x, f.u_x, f.v_x), at(f.anchor_y, f.u_y, f.v_y)]);
                known.push(*z);
            }
        }
    }
    assert!(points.len() > 100_000, "{}", points.len());
    let heights = now.heights(&points, &Tolerance::Constant(0.0), Blend::Exact).unwrap();
    let off = |e: &terraquilt::height::surface::Evaluation, z: f64| (e.z - z).abs();
    let worst =
        heights.iter().zip(&known).filter_map(|(e, z)| Some(off(e.as_ref()?, *z))).fold(0.0, f64::max);
    assert!(worst <= 1e-6, "{worst}");
    server.stop().await.unwrap();
}

#[test]
fn patches_take_less_than_half_of_the_papers_bytes() {
    let now = helens().snapshot(None).unwrap();
    for e in [0.0, 3.0, 20.0] {
        let query = terraquilt::db::query::Query {
            area: None.into(),
            tolerance: Tolerance::Constant(e),
            how: Blend::Exact.into(),
        };
        let records = now.select(&query).unwrap().records;
        let bytes: usize = records.iter().map(|r| now.payload(r).unwrap().len()).sum();
        let mean = bytes / records.len();
        println!("{e} m: {} patches, {mean} bytes each", records.len());
        assert!(mean < 4106 / 2, "{e} m: {mean}");
    }
}

#[test]
fn blocks_of_masks_are_the_same_from_any_region() {
    let now = helens().snapshot(None).unwrap();
    let b = now.bounds().unwrap();
    let all = now.masks(&Region::from_box(b)).unwrap();
    assert!(all.is_sorted_by_key(|m| m.key()));
    let by_key: BTreeMap<_, _> = all.iter().map(|m| (m.key(), m.cells.clone())).collect();
    assert!(by_key.len() == all.len() && all.iter().any(|m| !m.cells.is_empty()));
    let mut met = BTreeMap::new();
    let n = 7;
    for k in 0..n * n {
        let side = [(b[2] - b[0]) / n as f64, (b[3] - b[1]) / n as f64];
        let corner = [b[0] + side[0] * (k % n) as f64, b[1] + side[1] * (k / n) as f64];
        let part = Region::from_box([corner[0], corner[1], corner[0] + side[0], corner[1] + side[1]]);
        for m in now.masks(&part).unwrap() {
            assert_eq!(by_key[&m.key()], m.cells);
            met.insert(m.key(), m.cells);
        }
    }
    assert_eq!(met, by_key);
    assert!(now.masks(&Region::from_box([0.0, 0.0, 1.0, 1.0])).unwrap().is_empty());
    // Every place of a block is in core' of its survey or beside it: cells of the newer survey are not the older one's.
    let cells_of = |survey: u32| -> u64 {
        let blocks = all.iter().filter(|m| m.survey.0 == survey);
        blocks
            .flat_map(|m| match m.cells.is_empty() {
                true => vec![784 << (2 * m.level)],
                false => cells::unpack(m.level, &m.cells).unwrap().iter().map(|b| b.count().into()).collect(),
            })
            .sum()
    };
    let (old, new) = (all[0].survey.0, all.last().unwrap().survey.0);
    let before = helens().snapshot(Some(1)).unwrap().masks(&Region::from_box(b)).unwrap();
    let alone: u64 = before
        .iter()
        .flat_map(|m| match m.cells.is_empty() {
            true => vec![784u64 << (2 * m.level)],
            false => cells::unpack(m.level, &m.cells).unwrap().iter().map(|b| b.count().into()).collect(),
        })
        .sum();
    assert!(old != new && cells_of(old) < alone && cells_of(new) > 10_000);
}
