//! What a moving view costs on the wire: the paper's three flights over a database, encoded as the server sends them.
//! `cargo run --release --example flight_bytes -- DB [FRAMES]`
//!
//! A camera 300 m above the highest ground looks 15 km ahead. Of each frame the difference to the frame before is encoded as a
//! `ViewReply`: handles of patches that leave, patches that come with their vertices, blocks of masks. Printed are means over
//! the frames after the first.

use prost::Message;
use std::collections::{HashMap, HashSet};
use terraquilt::base::Result;
use terraquilt::db::query::{Query, Selection, Tolerance, difference};
use terraquilt::db::{Db, MaskPart, Snapshot};
use terraquilt::height::lod::PatchId;
use terraquilt::height::lod::cut::Camera;
use terraquilt::height::surface::Blend;
use terraquilt::store::quadtree::Record;
use terraquilt::wire::v1;

/// Of the paper: bytes a patch.
const PAPER_BYTES: f64 = 4106.0;
const VIEW_M: f64 = 15_000.0;

/// Metres forward and degrees of turn from one frame to the next.
const FLIGHTS: [(&str, f64, f64); 3] =
    [("10 m a frame", 10.0, 0.0), ("50 m a frame", 50.0, 0.0), ("1 degree a frame", 0.0, 1.0)];

fn main() -> Result<()> {
    let usage = "usage: flight_bytes DB [FRAMES]";
    let mut args = std::env::args().skip(1);
    let db = Db::open(args.next().expect(usage).as_ref())?;
    let frames: usize = args.next().map_or(200, |a| a.parse().expect(usage));
    let now = db.snapshot(None)?;
    println!("                      first view          a frame                        bytes a patch added");
    println!(
        "pixels flight         patches     bytes   added  removed  bytes (most)   all    vertices  of 4106"
    );
    for pixels in [1.0, 3.0] {
        for flight in FLIGHTS {
            fly(&now, pixels, flight, frames)?;
        }
    }
    Ok(())
}

fn fly(now: &Snapshot, pixels: f64, (name, forward, turn): (&str, f64, f64), frames: usize) -> Result<()> {
    let (b, z) = (now.bounds().expect("the database holds a survey"), now.z_range().expect("it has heights"));
    let middle = [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0];
    let start = middle[1] - VIEW_M / 2.0 - forward * frames as f64 / 2.0;
    let mut held = Held::default();
    let (mut first, mut sum, mut most) = ((0, 0), Frame::default(), 0);
    for k in 0..frames {
        let angle = (90.0 - turn * k as f64).to_radians();
        let eye = [middle[0], start + forward * k as f64, z[1] + 300.0];
        let look = [eye[0] + VIEW_M * angle.cos(), eye[1] + VIEW_M * angle.sin(), z[1]];
        let camera = Camera::new(eye, look, 45.0, [1920, 1080], pixels, Some(VIEW_M))?;
        let query =
            Query { area: None.into(), tolerance: Tolerance::Camera(camera), how: Blend::Exact.into() };
        let frame = held.step(now, now.select(&query)?, k as u64)?;
        if k == 0 {
            first = (frame.added, frame.bytes);
        } else {
            sum.added += frame.added;
            sum.removed += frame.removed;
            sum.bytes += frame.bytes;
            sum.vertices += frame.vertices;
            most = most.max(frame.bytes);
        }
    }
    let mean = |n: usize| n as f64 / (frames - 1) as f64;
    let patch = |n: usize| n as f64 / sum.added.max(1) as f64;
    println!(
        "{pixels:6} {name:16} {:5} {:9}   {:5.2}  {:7.2}  {:6.0} {:7} {:6.0} {:8.0}     {:4.1} %",
        first.0,
        first.1,
        mean(sum.added),
        mean(sum.removed),
        mean(sum.bytes),
        format!("({most})"),
        patch(sum.bytes),
        patch(sum.vertices),
        100.0 * patch(sum.bytes) / PAPER_BYTES
    );
    Ok(())
}

#[derive(Default)]
struct Frame {
    added: usize,
    removed: usize,
    bytes: usize,
    vertices: usize,
}

/// What a client holds, as the server knows it.
#[derive(Default)]
struct Held {
    records: Vec<Record>,
    handles: HashMap<PatchId, u32>,
    last: u32,
    masks: Vec<MaskPart>,
    surveys: HashSet<u32>,
}

impl Held {
    /// The difference to a new set, encoded.
    fn step(&mut self, now: &Snapshot, to: Selection, number: u64) -> Result<Frame> {
        let d = difference(&self.records, &to.records);
        let mut reply = v1::ViewReply {
            from: number,
            to: number + 1,
            answers: number + 1,
            hash: vec![0xff; 16].into(),
            patches: to.records.len() as u64,
            version: now.number(),
            ..Default::default()
        };
        for r in &d.removed {
            reply.removed.extend(self.handles.remove(&r.id));
        }
        let mut vertices = 0;
        for r in &d.added {
            self.last += 1;
            self.handles.insert(r.id, self.last);
            let payload = now.payload(r)?;
            vertices += payload.len();
            reply.added.push(v1::Patch {
                handle: self.last,
                id: r.id.0.to_vec().into(),
                survey: r.survey.0,
                level: r.place.level.into(),
                i: r.place.i,
                j: r.place.j,
                bot_m: r.bot,
                top_m: r.top,
                floor: r.floor,
                payload,
            });
        }
        let block = |m: &MaskPart, cells| v1::MaskBlock {
            survey: m.survey.0,
            level: m.level.into(),
            i: m.i,
            j: m.j,
            cells,
        };
        let masks = now.masks(&to.region)?;
        let old: HashSet<_> = self.masks.iter().map(MaskPart::key).collect();
        let new: HashSet<_> = masks.iter().map(MaskPart::key).collect();
        reply.masks =
            masks.iter().filter(|m| !old.contains(&m.key())).map(|m| block(m, m.cells.clone())).collect();
        reply.masks_removed = self
            .masks
            .iter()
            .filter(|m| !new.contains(&m.key()))
            .map(|m| block(m, Default::default()))
            .collect();
        for n in now.surveys_of(&to) {
            if self.surveys.insert(n.0) {
                let e = now.survey_by_number(n)?;
                let (f, core) = (&e.geometry.frame, &e.geometry.core);
                reply.surveys.push(v1::SurveyFrame {
                    survey: n.0,
                    name: e.name.clone(),
                    anchor_x: f.anchor.x,
                    anchor_y: f.anchor.y,
                    u_x: f.u.x,
                    u_y: f.u.y,
                    v_x: f.v.x,
                    v_y: f.v.y,
                    step_x: e.geometry.steps[0],
                    step_y: e.geometry.steps[1],
                    accuracy_m: e.geometry.accuracy,
                    core_i0: core.i0,
                    core_j0: core.j0,
                    core_i1: core.i1,
                    core_j1: core.j1,
                    level_max: e.geometry.level_max.into(),
                });
            }
        }
        (self.records, self.masks) = (to.records, masks);
        // A gRPC message has five bytes before it.
        let bytes = reply.encoded_len() + 5;
        Ok(Frame { added: d.added.len(), removed: d.removed.len(), bytes, vertices })
    }
}
