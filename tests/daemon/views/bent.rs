//! Views with corrected seams hold what a fresh view would get, whatever moves, arrives or leaves.

use super::{World, boxed, constant, hills, moved, next};
use crate::worlds::{Grid, Random};
use std::collections::BTreeMap;
use terraquilt::client::view::{BlockKey, Opening, Set, View};
use terraquilt::db::Change;
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::height::surface::{Blend, How, Seams};
use terraquilt::wire::v1;

const ALL: How = How { blend: Blend::Exact, seams: Seams::All };

/// A survey that lies some metres above what the others say.
fn raised(g: Grid, by: f32) -> Grid {
    Grid { z: g.z.iter().map(|z| z + by).collect(), ..g }
}

impl World {
    fn corrections(&self, b: [f64; 4], e: f64) -> BTreeMap<BlockKey, bytes::Bytes> {
        let s = self.server.state().live.newest();
        let query = Query { area: Area::Box(b), tolerance: Tolerance::Constant(e), how: ALL };
        let found = s.corrections(&s.select(&query).unwrap(), ALL).unwrap();
        found.into_iter().map(|c| ((c.survey.0, 0, c.i, c.j), c.nodes)).collect()
    }

    async fn fresh(&self, opening: Opening) -> Set {
        let mut view = View::open(&self.connect().await, opening).await.unwrap();
        next(&mut view).await.unwrap();
        view.set.clone()
    }
}

#[tokio::test]
async fn a_view_keeps_the_corrections_of_a_fresh_one() {
    let base = hills("base", [-40.0, 40.0], 40, 12.0, 0);
    let dome = raised(hills("dome", [60.0, -60.0], 60, 2.0, 1), 6.0);
    let ridge = raised(hills("ridge", [120.0, -90.0], 40, 3.0, 2), -4.0);
    let w = World::of(&[base], |_| ()).await;
    let mut r = Random::new(11);
    let mut at = moved(&mut r);
    let opening = |b: [f64; 4]| Opening {
        region: Some(boxed(b)),
        tolerance: Some(constant(1.0)),
        seams: v1::Seams::All,
        ..Opening::default()
    };
    let mut view = View::open(&w.connect().await, opening(at)).await.unwrap();
    next(&mut view).await.unwrap();
    assert!(view.set.corrections.is_empty());
    let rank = |precedence| Change::Set { survey: "ridge".into(), date: None, precedence: Some(precedence) };
    let commits: [(&str, &dyn Fn()); 6] = [
        ("dome comes", &|| w.ingest(&dome)),
        ("ridge comes", &|| w.ingest(&ridge)),
        ("ridge is believed less", &|| w.commit(rank(-1))),
        ("dome leaves", &|| w.remove("dome")),
        ("ridge is believed more", &|| w.commit(rank(9))),
        ("dome comes again", &|| w.ingest(&dome)),
    ];
    let (mut most, mut told) = (0, 0);
    for (name, commit) in commits {
        commit();
        let newest = w.server.state().live.newest().number();
        while view.set.version != newest {
            let done = next(&mut view).await.unwrap();
            told += done.blocks;
        }
        assert_eq!(view.set.corrections, w.corrections(at, 1.0), "{name}");
        for _ in 0..2 {
            at = moved(&mut r);
            let number = view.steer(Some(boxed(at)), constant(1.0)).await.unwrap();
            while next(&mut view).await.unwrap().answers != number {}
            assert_eq!(view.set.corrections, w.corrections(at, 1.0), "{name}, then moved");
        }
        let fresh = w.fresh(opening(at)).await;
        assert_eq!(view.set.corrections, fresh.corrections, "{name}");
        assert_eq!((&view.set.masks, &view.set.hash), (&fresh.masks, &fresh.hash), "{name}");
        most = most.max(view.set.corrections.len());
    }
    assert!(most > 3 && told > 10, "{most} blocks, {told} told");
}
