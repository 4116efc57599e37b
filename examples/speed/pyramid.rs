//! Errors of the patches of all levels, measured at every post, on one thread: section 8 of the LOD-space specification. The paper
//! spends 86 % of its time there.

use crate::summary;
use serde_json::{Value, json};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;
use terraquilt::base::{Error, Result};
use terraquilt::db::{Db, read_tile};
use terraquilt::height::frame::CellRect;
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

/// Seconds for the errors of one level over all posts.
fn errors(posts: &[f64], cols: usize, rows: usize, level: u8) -> f64 {
    let places = places_touching_posts(level, 0, 0, cols as i64 - 1, rows as i64 - 1);
    let places = CellRect::new(places.i0, places.j0, places.i1, places.j1);
    let line = |first: i64, count: usize, row: i64| -> Vec<f64> {
        let j = ((row << level).max(0) as usize).min(rows - 1);
        (0..count as i64)
            .map(|k| posts[j * cols + (((first + k) << level).max(0) as usize).min(cols - 1)])
            .collect()
    };
    let started = Instant::now();
    let mut gather = Residuals::new(level, places, 0, cols);
    let (first, count) = gather.vertices();
    let (mut below, mut above) = (line(first, count, 0), line(first, count, 1));
    for j in 0..rows {
        let v = j as i64 >> level;
        if j > 0 && j % (1 << level) == 0 {
            below = std::mem::replace(&mut above, line(first, count, v + 1));
        }
        gather.row(j as i64, &posts[j * cols..(j + 1) * cols], &below, &above);
    }
    black_box(gather.finish());
    started.elapsed().as_secs_f64()
}
