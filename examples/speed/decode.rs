//! Sample blocks from the mapped files, decoded on one thread: the bytes of samples that come out a second.

use crate::summary;
use serde_json::{Value, json};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;
use terraquilt::base::{Error, Result};
use terraquilt::db::{Db, read_tile};

/// Passes over the tile after the first one, which brings the files into memory.
const PASSES: usize = 3;

pub fn run(db: &str) -> Result<Value> {
    let db = Db::open(Path::new(db))?;
    let now = db.snapshot(None)?;
    let Some(entry) = now.entries().next() else {
        return Err(Error::missing("a survey", "ingest one first"));
    };
    let tile = read_tile(&now, entry.number, 0)?;
    let (mut rates, mut bytes, mut blocks) = (Vec::new(), 0u64, 0u64);
    for pass in 0..=PASSES {
        (bytes, blocks) = (0, 0);
        let started = Instant::now();
        tile.blocks(|_, block| {
            bytes += black_box(&block.samples).len() as u64;
            blocks += 1;
            Ok(())
        })?;
        if pass > 0 {
            rates.push(bytes as f64 / started.elapsed().as_secs_f64() / 1e9);
        }
    }
    Ok(json!({
        "part": "decode", "gigabytes_a_second": summary(rates), "sample_bytes": bytes, "blocks": blocks,
        "sample_type": tile.declaration.delivered().sample_type.name(),
    }))
}
