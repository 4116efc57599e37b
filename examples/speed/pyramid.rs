//! Errors of the patches of all levels, measured at every post, on one thread: section 8 of the LOD-space specification. The paper
//! spends 86 % of its time there.

use crate::summary;
use serde_json::{Value, json};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;
use terraquilt::base::{Error, Result};
use terraquilt::db::{Db, read_tile};
use terraquilt::height::block::BLOCK;
use terraquilt::height::lod::places_touching_posts;
use terraquilt::height::patch::Residuals;

/// Posts a side: those of the north-west of the first tile.
const SIDE: usize = 4097;
const LEVELS: u8 = 10;
const PASSES: usize = 3;

pub fn run(db: &str) -> Result<Value> {
    let db = Db::open(Path::new(db))?;
    let now = db.snapshot(None)?;
    let Some(entry) = now.entries().next() else {
        return Err(Error::missing("a survey", "ingest one first"));
    };
    let tile = read_tile(&now, entry.number, 0)?;
    let sample_type = tile.declaration.delivered().sample_type;
    let (width, cols) = (tile.cols(), tile.cols().min(SIDE));
    let mut posts: Vec<f64> = Vec::with_capacity(cols * SIDE);
    tile.bands(|_, rows, samples, valid| {
        for r in 0..rows {
            if posts.len() < cols * SIDE {
                let at = |c: usize| r * width + c;
                posts.extend((0..cols).map(|c| match valid[at(c)] {
                    0 => f64::NAN,
                    _ => sample_type.value(&samples[at(c) * sample_type.bytes()..]),
                }));
            }
        }
        Ok(())
    })?;
    let rows = posts.len() / cols;
    let mut passes = Vec::new();
    let mut levels = vec![Vec::new(); usize::from(LEVELS) - 1];
    for _ in 0..PASSES {
        let mut whole = 0.0;
        for level in 1..LEVELS {
            let seconds = errors(&posts, cols, rows, level);
            levels[usize::from(level) - 1].push((cols * rows) as f64 / seconds / 1e6);
            whole += seconds;
        }
        passes.push((cols * rows) as f64 / whole / 1e6);
    }
    Ok(json!({
        "part": "pyramid", "posts": cols * rows, "levels": LEVELS,
        "million_posts_a_second_all_levels": summary(passes),
        "million_posts_a_second_by_level": levels.into_iter().map(summary).collect::<Vec<_>>(),
    }))
}

/// Seconds for the errors of one level over all posts, block by block as an ingest takes them. Vertices are at hand.
fn errors(posts: &[f64], cols: usize, rows: usize, level: u8) -> f64 {
    let vertices = Vertices::new(posts, cols, rows, level);
    let started = Instant::now();
    for j0 in (0..rows).step_by(BLOCK as usize) {
        for i0 in (0..cols).step_by(BLOCK as usize) {
            let [i1, j1] = [(i0 + BLOCK as usize).min(cols), (j0 + BLOCK as usize).min(rows)];
            let places = places_touching_posts(level, i0 as i64, j0 as i64, i1 as i64 - 1, j1 as i64 - 1);
            let mut gather = Residuals::new(level, places, i0 as i64, i1 - i0);
            let (first, count) = gather.vertices();
            for j in j0..j1 {
                let line = |v: usize| &vertices.z[v * vertices.cols + first as usize..][..count];
                gather.row(
                    j as i64,
                    &posts[j * cols + i0..j * cols + i1],
                    line(j >> level),
                    line((j >> level) + 1),
                );
            }
            black_box(gather.finish());
        }
    }
    started.elapsed().as_secs_f64()
}

/// Every so many-th post of every so many-th row, the last ones repeated at the end.
struct Vertices {
    cols: usize,
    z: Vec<f64>,
}

impl Vertices {
    fn new(posts: &[f64], cols: usize, rows: usize, level: u8) -> Vertices {
        let (wide, high) = ((cols >> level) + 2, (rows >> level) + 2);
        let at = |v: usize, n: usize| (v << level).min(n - 1);
        let z = (0..high).flat_map(|j| (0..wide).map(move |i| posts[at(j, rows) * cols + at(i, cols)]));
        Vertices { cols: wide, z: z.collect() }
    }
}
