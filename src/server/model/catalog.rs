//! What is in a version, as messages.

use crate::base::{Error, Result};
use crate::db::{Outcome, Snapshot, SurveyEntry, SurveyRow, TileRow};
use crate::height::crs::AxisUnit;
use crate::height::patch::Kind;
use crate::wire::v1;
use serde::Serialize;

/// A row as the command line prints it.
pub fn json(row: &impl Serialize) -> Result<String> {
    serde_json::to_string(row).map_err(|e| Error::invalid("JSON", e))
}

/// What is fixed for all surveys of a version.
pub fn ground(s: &Snapshot) -> v1::Ground {
    let z = s.z_range();
    v1::Ground {
        version: s.number(),
        crs: s.crs().code.clone(),
        unit: match s.crs().unit {
            AxisUnit::Metre => "m",
            AxisUnit::Degree => "deg",
        }
        .to_string(),
        lattice_unit_log2: s.unit().exponent,
        patch: match s.kind() {
            Kind::Bilinear => v1::PatchKind::Bilinear,
            Kind::Bicubic => v1::PatchKind::Bicubic,
        } as i32,
        z_min: z.map(|z| z[0]),
        z_max: z.map(|z| z[1]),
        bounds: s.bounds().map(boxed),
    }
}

fn boxed([xmin, ymin, xmax, ymax]: [f64; 4]) -> v1::Box {
    v1::Box { xmin, ymin, xmax, ymax }
}

/// A survey as its patches need it.
pub fn frame(e: &SurveyEntry) -> v1::SurveyFrame {
    let (g, f) = (&e.geometry, &e.geometry.frame);
    v1::SurveyFrame {
        survey: e.number.0,
        name: e.name.clone(),
        anchor_x: f.anchor.x,
        anchor_y: f.anchor.y,
        u_x: f.u.x,
        u_y: f.u.y,
        v_x: f.v.x,
        v_y: f.v.y,
        step_x: g.steps[0],
        step_y: g.steps[1],
        accuracy_m: g.accuracy,
        core_i0: g.core.i0,
        core_j0: g.core.j0,
        core_i1: g.core.i1,
        core_j1: g.core.j1,
        level_max: u32::from(g.level_max),
    }
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

/// What a commit did.
pub fn commit_reply(o: Outcome, operation: String) -> Result<v1::CommitReply> {
    Ok(v1::CommitReply {
        json: json(&o)?,
        version: o.version,
        changed: o.changed,
        survey: o.survey,
        patches: o.patches,
        live: o.live,
        dormant: o.dormant,
        posts: o.posts,
        voids: o.voids,
        seconds: o.seconds,
        warnings: o.warnings,
        operation,
    })
}
