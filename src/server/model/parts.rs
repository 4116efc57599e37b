//! What the ground is made of, as messages: the other direction.

use crate::base::Result;
use crate::db::query::Selection;
use crate::db::{CorrectionPart, MaskPart, Snapshot};
use crate::height::crs::AxisUnit;
use crate::height::lod::SurveyNumber;
use crate::height::patch::Kind;
use crate::store::quadtree::Record;
use crate::wire::v1;
use bytes::Bytes;

/// What is fixed for all surveys of a version.
pub fn ground(s: &Snapshot) -> v1::Ground {
    let z = s.z_range();
    v1::Ground {
        version: s.number(),
        crs: s.crs().code.clone(),
        unit: if s.crs().unit == AxisUnit::Degree { "deg" } else { "m" }.into(),
        lattice_unit_log2: i32::from(s.unit().exponent),
        patch: match s.kind() {
            Kind::Bilinear => v1::PatchKind::Bilinear,
            Kind::Bicubic => v1::PatchKind::Bicubic,
        } as i32,
        z_min: z.map(|z| z[0]),
        z_max: z.map(|z| z[1]),
        bounds: s.bounds().map(|[xmin, ymin, xmax, ymax]| v1::Box { xmin, ymin, xmax, ymax }),
    }
}

/// A survey as its patches need it.
pub fn survey_frame(s: &Snapshot, number: SurveyNumber) -> Result<v1::SurveyFrame> {
    let e = s.survey_by_number(number)?;
    let g = &e.geometry;
    Ok(v1::SurveyFrame {
        survey: number.0,
        name: e.name.clone(),
        anchor_x: g.frame.anchor.x,
        anchor_y: g.frame.anchor.y,
        u_x: g.frame.u.x,
        u_y: g.frame.u.y,
        v_x: g.frame.v.x,
        v_y: g.frame.v.y,
        step_x: g.steps[0],
        step_y: g.steps[1],
        accuracy_m: g.accuracy,
        core_i0: g.core.i0,
        core_j0: g.core.j0,
        core_i1: g.core.i1,
        core_j1: g.core.j1,
        level_max: u32::from(g.level_max),
    })
}

/// The surveys that a selection needs.
pub fn frames(s: &Snapshot, selection: &Selection) -> Result<Vec<v1::SurveyFrame>> {
    s.surveys_of(selection).into_iter().map(|n| survey_frame(s, n)).collect()
}

/// A patch; `handle` 0 and an empty payload where the answer has none.
pub fn patch(r: &Record, handle: u32, payload: Bytes) -> v1::Patch {
    v1::Patch {
        handle,
        id: Bytes::copy_from_slice(&r.id.0),
        survey: r.survey.0,
        level: u32::from(r.place.level),
        i: r.place.i,
        j: r.place.j,
        bot_m: r.bot,
        top_m: r.top,
        floor: r.floor,
        payload,
    }
}

/// A block of a mask.
pub fn mask(m: &MaskPart) -> v1::MaskBlock {
    v1::MaskBlock { survey: m.survey.0, level: u32::from(m.level), i: m.i, j: m.j, cells: m.cells.clone() }
}

/// The correction of a place.
pub fn correction(c: &CorrectionPart) -> v1::CorrectionBlock {
    v1::CorrectionBlock { survey: c.survey.0, i: c.i, j: c.j, nodes: c.nodes.clone() }
}
