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
    let levels: Vec<Vertices> = (1..LEVELS).map(|level| Vertices::new(&posts, cols, rows, level)).collect();
    let blocks = blocks(&posts, cols, rows);
    let mut passes = Vec::new();
    for _ in 0..PASSES {
        let started = Instant::now();
        for block in &blocks {
            for vertices in &levels {
                black_box(errors(block, vertices));
            }
        }
        passes.push((cols * rows) as f64 / started.elapsed().as_secs_f64() / 1e6);
    }
    Ok(json!({
        "part": "pyramid", "posts": cols * rows, "levels": LEVELS,
        "million_posts_a_second_all_levels": summary(passes),
    }))
}

/// Posts as an ingest has them at hand: a block after the other.
struct Block {
    first: [usize; 2],
    cols: usize,
    z: Vec<f64>,
}

fn blocks(posts: &[f64], cols: usize, rows: usize) -> Vec<Block> {
    let side = BLOCK as usize;
    let firsts = (0..rows).step_by(side).flat_map(|j| (0..cols).step_by(side).map(move |i| [i, j]));
    firsts
        .map(|[i, j]| {
            let (i1, j1) = ((i + side).min(cols), (j + side).min(rows));
            let z = (j..j1).flat_map(|j| posts[j * cols + i..j * cols + i1].iter().copied()).collect();
            Block { first: [i, j], cols: i1 - i, z }
        })
        .collect()
}

/// Errors of the places of one level, as far as a block tells.
fn errors(block: &Block, vertices: &Vertices) -> Vec<f64> {
    let ([i0, j0], level, rows) = (block.first, vertices.level, block.z.len() / block.cols);
    let last = [i0 + block.cols - 1, j0 + rows - 1].map(|v| v as i64);
    let places = places_touching_posts(level, i0 as i64, j0 as i64, last[0], last[1]);
    let mut gather = Residuals::new(level, places, i0 as i64, block.cols);
    let (first, count) = gather.vertices();
    let line = |v: usize| &vertices.z[v * vertices.cols + first as usize..][..count];
    for (row, posts) in block.z.chunks_exact(block.cols).enumerate() {
        let v = (j0 + row) >> level;
        gather.row((j0 + row) as i64, posts, line(v), line(v + 1));
    }
    gather.finish()
}

/// Every so many-th post of every so many-th row, the last ones repeated at the end.
struct Vertices {
    level: u8,
    cols: usize,
    z: Vec<f64>,
}

impl Vertices {
    fn new(posts: &[f64], cols: usize, rows: usize, level: u8) -> Vertices {
        let (wide, high) = ((cols >> level) + 2, (rows >> level) + 2);
        let at = |v: usize, n: usize| (v << level).min(n - 1);
        let z = (0..high).flat_map(|j| (0..wide).map(move |i| posts[at(j, rows) * cols + at(i, cols)]));
        Vertices { level, cols: wide, z: z.collect() }
    }
}
