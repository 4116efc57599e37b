//! A mesh of a whole database, from the selection of patches to triangles in memory.

use crate::summary;
use serde_json::{Value, json};
use std::path::Path;
use std::time::Instant;
use terraquilt::base::Result;
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::db::{Db, triangulate_region};
use terraquilt::height::surface::Blend;

pub fn run(db: &str, error_m: f64, rounds: usize) -> Result<Value> {
    let db = Db::open(Path::new(db))?;
    let now = db.snapshot(None)?;
    let query =
        Query { area: Area::Everything, tolerance: Tolerance::Constant(error_m), how: Blend::Exact.into() };
    let (mut seconds, mut made) = (Vec::new(), None);
    for _ in 0..rounds {
        let started = Instant::now();
        made = Some(triangulate_region(&now, &query, &|_| true)?);
        seconds.push(started.elapsed().as_secs_f64());
    }
    let made = made.expect("there is a round at least");
    Ok(json!({
        "part": "mesh", "seconds": summary(seconds), "triangles": made.mesh.triangles.len(),
        "vertices": made.mesh.positions.len(), "mesh_error_m": made.mesh.error_m,
    }))
}
