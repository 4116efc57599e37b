//! One camera's question over and over, for counting instructions: nodes are decoded by the first.

use serde_json::{Value, json};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;
use terraquilt::base::{Error, Result};
use terraquilt::db::Db;
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::height::lod::cut::Camera;
use terraquilt::height::surface::Blend;

const VIEW_M: f64 = 15_000.0;

pub fn run(db: &str, times: usize) -> Result<Value> {
    let db = Db::open(Path::new(db))?;
    let now = db.snapshot(None)?;
    let (Some(b), Some(z)) = (now.bounds(), now.z_range()) else {
        return Err(Error::missing("a survey", "ingest one first"));
    };
    let eye = [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0 - VIEW_M / 2.0, z[1] + 300.0];
    let look = [eye[0], eye[1] + VIEW_M, z[1]];
    let camera = Camera::new(eye, look, 45.0, [1920, 1080], 1.0, Some(VIEW_M))?;
    let query =
        Query { area: Area::Everything, tolerance: Tolerance::Camera(camera), how: Blend::Exact.into() };
    let (mut best, mut patches) = (f64::INFINITY, 0);
    for _ in 0..times {
        let started = Instant::now();
        patches = black_box(now.find(&query)?).len();
        best = best.min(started.elapsed().as_secs_f64());
    }
    Ok(json!({ "part": "camera", "microseconds": best * 1e6, "patches": patches }))
}
