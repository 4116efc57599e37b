//! What is in a version, as messages.

use crate::base::{Error, Result};
use crate::db::{SurveyEntry, SurveyRow, TileRow};
use crate::wire::v1;
use serde::Serialize;

/// A row as the command line prints it.
pub fn json(row: &impl Serialize) -> Result<String> {
    serde_json::to_string(row).map_err(|e| Error::invalid("JSON", e))
}

fn boxed([xmin, ymin, xmax, ymax]: [f64; 4]) -> v1::Box {
    v1::Box { xmin, ymin, xmax, ymax }
}

/// A survey as it is listed.
pub fn survey(e: &SurveyEntry, row: &SurveyRow) -> Result<v1::Survey> {
    Ok(v1::Survey {
        survey: e.number.0,
        name: row.name.clone(),
        id: e.id.to_vec().into(),
        tiles: row.tiles as u64,
        crs: row.crs.clone(),
        cols: row.cols.unsigned_abs(),
        rows: row.rows.unsigned_abs(),
        step_x: row.step[0],
        step_y: row.step[1],
        rotation_deg: row.rotation_deg,
        accuracy_m: row.accuracy_m,
        date: row.date.clone().unwrap_or_default(),
        precedence: row.precedence,
        bounds: Some(boxed(row.bounds)),
        version: row.version,
        patches: row.patches,
        live: row.live,
        dormant: row.dormant,
        json: json(row)?,
    })
}

/// A tile as it is listed.
pub fn tile(row: &TileRow) -> Result<v1::Tile> {
    Ok(v1::Tile {
        id: row.key.clone(),
        file: row.file.clone(),
        i0: row.first[0],
        j0: row.first[1],
        i1: row.first[0] + row.cols,
        j1: row.first[1] + row.rows,
        valid: row.valid,
        voids: (row.cols.unsigned_abs() * row.rows.unsigned_abs()).saturating_sub(row.valid),
        json: json(row)?,
    })
}
