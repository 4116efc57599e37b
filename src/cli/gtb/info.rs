//! `gtb info`: what a GTB file holds, and what each part of it shows.

use super::super::output::{Output, bytes, count, table};
use super::{Codec, at_most, bytes_of, metered, notes, short, unit_of};
use crate::base::Result;
use crate::export::gtb::{Reached, Until, read_prefix, told};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use terraquilt_codecs::gtb::{Header, Profile};

/// Say what a GTB file holds, what each pass of it shows, and whether it is whole and sound
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt gtb info crater.gtb\nOf a file that is cut, what is there is described."
)]
pub struct Info {
    /// GTB file; `-`: standard input
    file: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Told<'a> {
    file: &'a Path,
    bytes: u64,
    /// Of the whole file.
    bytes_whole: u64,
    sound: bool,
    cols: usize,
    rows: usize,
    n: u32,
    profile: &'static str,
    /// In the unit of heights.
    layers: Vec<f64>,
    unit: f64,
    base: f64,
    given_error: f64,
    transform: [f64; 6],
    crs: &'a str,
    vertical: &'a str,
    source: &'a str,
    voids: bool,
    texture_side: Option<u64>,
    texture_bytes: u64,
    refines: Option<String>,
    #[serde(flatten)]
    reached: &'a Reached,
    passes: Vec<PassTold>,
}

#[derive(Serialize)]
struct PassTold {
    layer: usize,
    spacing: usize,
    kind: &'static str,
    bytes: u64,
    /// From there on, in the unit of heights.
    error_bound: f64,
}

impl Info {
    pub fn run(self) -> Result<bool> {
        let (name, found) = bytes_of(&self.file, Codec::Gtb, None)?;
        let (header, head) = Header::read(&found).map_err(|e| told(&name, e))?;
        let whole = header.file_position(head, usize::try_from(header.body).unwrap_or(usize::MAX / 2));
        if header.given.is_some() {
            return self.refinement(&name, &found, &header, whole);
        }
        let p = metered(|going| {
            read_prefix(&name, &found, Until::End, None, 0, &mut |share| going("decoding", share))
        })?;
        notes(&p.notes);
        let place = &header.place;
        let error = |units: u32| f64::from(units) * place.unit + place.given_error;
        let passes: Vec<PassTold> = p
            .passes
            .iter()
            .map(|e| PassTold {
                layer: e.layer,
                spacing: e.pass.step,
                kind: if e.pass.kind == terraquilt_codecs::lattice::Kind::Edges {
                    "edges"
                } else {
                    "centres"
                },
                bytes: e.bytes,
                error_bound: error(e.bound),
            })
            .collect();
        let mut out = Output::new();
        if self.json {
            out.json(&Told {
                file: &self.file,
                bytes: found.len() as u64,
                bytes_whole: whole,
                sound: p.reached.damaged_at.is_none(),
                cols: header.cols,
                rows: header.rows,
                n: header.lattice.n(),
                profile: name_of(header.profile),
                layers: header.layers.iter().map(|e| f64::from(*e) * place.unit).collect(),
                unit: place.unit,
                base: place.base,
                given_error: place.given_error,
                transform: place.transform,
                crs: &place.crs,
                vertical: &place.vertical,
                source: &place.source,
                voids: header.mask,
                texture_side: header.texture.map(|n| 1 << n),
                texture_bytes: p.texture_bytes,
                refines: None,
                reached: &p.reached,
                passes,
            })?;
            return out.end();
        }
        self.head(&mut out, &header, found.len() as u64, whole)?;
        let unit = unit_of(&place.vertical);
        let sound = match p.reached.damaged_at {
            None => "every block that is there is sound".to_string(),
            Some(at) => {
                format!("the block at byte {at} of the body is damaged: nothing from there on is used")
            }
        };
        out.line(format!("blocks    {sound}"))?;
        if header.texture.is_some() {
            let share = p.texture_bytes as f64 / p.reached.bytes_used.max(1) as f64 * 100.0;
            out.line(format!(
                "texture   {} of {}, {share:.1} %",
                bytes(p.texture_bytes),
                bytes(p.reached.bytes_used)
            ))?;
        }
        let complete = if p.reached.complete { "complete" } else { "not complete" };
        out.line(format!("now       error at most {}{unit}, {complete}", at_most(p.reached.error_bound)))?;
        let rows: Vec<Vec<String>> = passes
            .iter()
            .map(|p| {
                vec![
                    p.layer.to_string(),
                    p.spacing.to_string(),
                    p.kind.to_string(),
                    p.bytes.to_string(),
                    at_most(p.error_bound),
                ]
            })
            .collect();
        table(&["layer", "spacing", "pass", "ends at byte", "error then"], &rows, &mut out)?;
        out.end()
    }

    /// A stream that refines what a receiver holds cannot be read without it; its head can.
    fn refinement(&self, name: &str, found: &[u8], header: &Header, whole: u64) -> Result<bool> {
        let mut out = Output::new();
        let state = format!("{:016x}", header.given.unwrap_or_default());
        if self.json {
            out.json(&serde_json::json!({
                "file": name, "bytes": found.len(), "bytes_whole": whole, "cols": header.cols, "rows": header.rows,
                "n": header.lattice.n(), "profile": name_of(header.profile), "refines": state
            }))?;
            return out.end();
        }
        self.head(&mut out, header, found.len() as u64, whole)?;
        out.line(format!("refines   what its receiver holds, state {state}; it shows nothing alone"))?;
        out.end()
    }

    fn head(&self, out: &mut Output, h: &Header, there: u64, whole: u64) -> Result<()> {
        let place = &h.place;
        let or = |text: &str| if text.is_empty() { "unknown".to_string() } else { text.to_string() };
        let layers: Vec<String> = h.layers.iter().map(|e| short(f64::from(*e) * place.unit)).collect();
        let bound = match h.profile {
            Profile::Sparse => "a part of the posts".to_string(),
            _ => format!("layers {}", layers.join(", ")),
        };
        let share = there as f64 / whole.max(1) as f64 * 100.0;
        let t = place.transform;
        let lines = [
            format!("file      {} of {} ({:.1} %)", bytes(there), bytes(whole), share.min(100.0)),
            format!("from      {}", or(&place.source)),
            format!(
                "posts     {} ({} x {} in a lattice of {} a side){}",
                count((h.cols * h.rows) as u64),
                h.cols,
                h.rows,
                h.lattice.side(),
                if h.mask { ", with voids" } else { "" }
            ),
            format!(
                "place     first post at {}, {}; a column {}, {}, a row {}, {}",
                t[0], t[3], t[1], t[4], t[2], t[5]
            ),
            format!("crs       {}", or(&place.crs)),
            format!(
                "heights   {} + {} x integer, {}",
                place.base,
                place.unit,
                if place.vertical.is_empty() { "unit and datum unknown" } else { &place.vertical }
            ),
            format!("profile   {}, {bound}", name_of(h.profile)),
            format!(
                "error     {} before coding (rounding to the unit, and the source's own)",
                at_most(place.given_error)
            ),
        ];
        lines.iter().try_for_each(|l| out.line(l))?;
        match h.texture {
            Some(n) => out.line(format!("picture   {0} x {0} cells", 1u64 << n)),
            None => Ok(()),
        }
    }
}

fn name_of(profile: Profile) -> &'static str {
    match profile {
        Profile::Sparse => "sparse",
        Profile::Cubic => "cubic",
        Profile::Adaptive => "adaptive",
    }
}
