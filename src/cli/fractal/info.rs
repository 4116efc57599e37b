//! `fractal info`: what a fractal tile holds.

use super::super::output::{Output, bytes, count, table};
use super::{Codec, at_most, bytes_of, error_of, errors_in, notes, short};
use crate::base::Result;
use crate::export::fractal::{Opened, Worth, kind_name, psnr_db, search_name, told};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use terraquilt_codecs::fractal::{Header, Ifs, Kind, Shape};

/// Say what a fractal tile holds, what it is worth, and whether it is whole and sound
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt fractal info crater.ifs\n\nOf a file that is cut, what is there is described."
)]
pub struct Info {
    /// Fractal tile; `-`: standard input
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
    kind: &'static str,
    size: &'a [usize],
    samples: u64,
    bits_per_sample: f64,
    maps: u64,
    maps_there: u64,
    planes: Vec<PlaneTold>,
    #[serde(flatten)]
    worth: &'a Worth,
    error_rms: f64,
    psnr_db: Option<f64>,
    bound: Option<f64>,
    voids: u64,
    /// Of `bytes`, what the mask of voids took, and what a bound adds; maps stand with their planes.
    mask_bytes: u64,
    residual_bytes: u64,
    search: &'static str,
    source: &'a str,
    #[serde(flatten)]
    place: Option<PlaceTold<'a>>,
    #[serde(flatten)]
    space: Option<SpaceTold>,
}

#[derive(Serialize)]
struct PlaceTold<'a> {
    unit: f64,
    base: f64,
    given_error: f64,
    transform: [f64; 6],
    crs: &'a str,
    vertical: &'a str,
}

#[derive(Serialize)]
struct SpaceTold {
    /// Centre of the first voxel.
    origin: [f64; 3],
    voxel: f64,
}

/// How a plane, or the volume, is told.
#[derive(Serialize)]
struct PlaneTold {
    name: &'static str,
    size: Vec<usize>,
    range_max: usize,
    range_min: usize,
    jump: usize,
    isometries: usize,
    near: usize,
    scale_bits: u32,
    /// Step of the means.
    step: f64,
    /// Of the file.
    bytes: u64,
    maps: Vec<SideTold>,
}

#[derive(Serialize)]
struct SideTold {
    side: usize,
    maps: usize,
    /// Of these, without a domain.
    flat: usize,
}

impl Info {
    pub fn run(self) -> Result<bool> {
        let (name, found) = bytes_of(&self.file, Codec::Fractal, None)?;
        let (_, head) = Header::read(&found).map_err(|e| told(&name, e))?;
        let o = Opened::read(&name, &found)?;
        notes(&o.notes);
        let h = &o.tile.header;
        let whole = h.file_bytes(head);
        let planes = planes(&o);
        let heights = h.kind == Kind::Heights;
        let p = &h.place;
        let unit = if heights { p.unit } else { 1.0 };
        let axes = if h.kind == Kind::Volume { 3 } else { 2 };
        let voids = o.tile.void.iter().filter(|v| **v).count() as u64;
        let mut out = Output::new();
        if self.json {
            out.json(&Told {
                file: &self.file,
                bytes: found.len() as u64,
                bytes_whole: whole,
                sound: o.worth.damaged_at.is_none(),
                kind: kind_name(h.kind),
                size: &h.size[..axes],
                samples: h.samples(),
                bits_per_sample: whole as f64 * 8.0 / h.samples() as f64,
                maps: h.maps,
                maps_there: o.tile.maps() as u64,
                planes,
                worth: &o.worth,
                error_rms: h.error_rms * unit,
                psnr_db: psnr_db(h),
                bound: h.bound.map(|e| f64::from(e) * unit),
                voids,
                mask_bytes: o.tile.parts.mask,
                residual_bytes: o.tile.parts.residual,
                search: search_name(h.search),
                source: &p.source,
                place: heights.then_some(PlaceTold {
                    unit,
                    base: p.base,
                    given_error: p.given_error,
                    transform: p.transform,
                    crs: &p.crs,
                    vertical: &p.vertical,
                }),
                space: h.space.map(|s| SpaceTold { origin: s.origin, voxel: s.voxel }),
            })?;
            return out.end();
        }
        let or = |text: &str| if text.is_empty() { "unknown".to_string() } else { text.to_string() };
        let size: Vec<String> = h.size[..axes].iter().map(usize::to_string).collect();
        let share = found.len() as f64 / whole.max(1) as f64 * 100.0;
        let psnr = psnr_db(h).map_or("every unit the same".into(), |p| format!("{p:.2} dB"));
        let mut lines = vec![
            format!(
                "file      {} of {} ({:.1} %)",
                bytes(found.len() as u64),
                bytes(whole),
                share.min(100.0)
            ),
            format!("from      {}", or(&p.source)),
            format!(
                "holds     {}, {} samples ({}){}, {:.3} bits each",
                kind_name(h.kind),
                count(h.samples()),
                size.join(" x "),
                if voids > 0 { format!(", {} without data", count(voids)) } else { String::new() },
                whole as f64 * 8.0 / h.samples() as f64,
            ),
        ];
        if heights {
            let t = p.transform;
            lines.push(format!(
                "place     first post at {}, {}; a column {}, {}, a row {}, {}",
                t[0], t[3], t[1], t[4], t[2], t[5]
            ));
            lines.push(format!("crs       {}", or(&p.crs)));
            let vertical = if p.vertical.is_empty() { "unit and datum unknown" } else { &p.vertical };
            lines.push(format!("heights   {} + {} x integer, {vertical}", p.base, p.unit));
        }
        if let Some(s) = h.space {
            let [x, y, z] = s.origin;
            lines.push(format!("place     first voxel's middle at {x}, {y}, {z}; voxels of {}", s.voxel));
        }
        let errors = error_of(&o.worth, &errors_in(&o));
        let rest = if o.worth.complete { "" } else { "of the whole file " };
        lines.push(format!(
            "error     {errors}; {rest}root mean square {}, {psnr}",
            short(h.error_rms * unit)
        ));
        if heights && p.given_error > 0.0 {
            lines.push(format!(
                "          of which {} before coding (rounding to the unit, and the source's own)",
                at_most(p.given_error)
            ));
        }
        let state = match (o.worth.complete, o.worth.damaged_at) {
            (true, _) => "complete, every block is sound".to_string(),
            (_, None) => "not complete; every block that is there is sound".to_string(),
            (_, Some(at)) => {
                format!("the block at byte {at} of the body is damaged: nothing from there on is used")
            }
        };
        lines.push(format!("state     {state}"));
        lines.push(format!("search    {}", search_name(h.search)));
        lines.push(format!("maps      {}, {} of them there", count(h.maps), count(o.tile.maps() as u64)));
        let parts = &o.tile.parts;
        let mut spent = vec![format!("maps {}", bytes(parts.maps.iter().sum()))];
        if h.bound.is_some() {
            spent.push(format!("what the bound adds {}", bytes(parts.residual)));
        }
        if h.mask {
            spent.push(format!("voids {}", bytes(parts.mask)));
        }
        lines.push(format!("spent on  {}", spent.join(", ")));
        lines.iter().try_for_each(|l| out.line(l))?;
        for plane in &planes {
            out.line(format!(
                "{}: {}, ranges of {} to {}, domains every {}, {} isometries, {} bits of s, means in steps of {}",
                plane.name,
                bytes(plane.bytes),
                plane.range_max,
                plane.range_min,
                plane.jump,
                plane.isometries,
                plane.scale_bits,
                plane.step * unit
            ))?;
            let rows: Vec<Vec<String>> = plane
                .maps
                .iter()
                .map(|s| vec![s.side.to_string(), count(s.maps as u64), count(s.flat as u64)])
                .collect();
            table(&["side", "maps", "of them flat"], &rows, &mut out)?;
        }
        out.end()
    }
}

fn planes(o: &Opened) -> Vec<PlaneTold> {
    let names: &[&'static str] = match o.kind() {
        Kind::Heights => &["heights"],
        Kind::Grey => &["brightness"],
        Kind::Colour => &["brightness (Y)", "colour (I)", "colour (Q)"],
        Kind::Volume => &["distances"],
    };
    let spent = &o.tile.parts.maps;
    let flat = o.tile.planes.iter().zip(names).zip(spent).map(|((p, name), bytes)| plane(name, p, *bytes));
    let solid = o.tile.volume.iter().zip(spent).map(|(v, bytes)| plane(names[0], v, *bytes));
    flat.chain(solid).collect()
}

fn plane<const D: usize>(name: &'static str, ifs: &Ifs<D>, bytes: u64) -> PlaneTold {
    let s: &Shape<D> = &ifs.shape;
    let mut maps: Vec<SideTold> = (0..s.levels())
        .map(|level| {
            let own = || ifs.leaves.iter().filter(move |l| usize::from(l.level) == level);
            SideTold {
                side: s.side(level),
                maps: own().count(),
                flat: own().filter(|l| l.scale == 0).count(),
            }
        })
        .collect();
    if !ifs.unit_means.is_empty() {
        // Samples stored one by one.
        let units = ifs.unit_means.len();
        maps.retain(|m| m.side > 1);
        maps.push(SideTold { side: 1, maps: units, flat: units });
    }
    PlaneTold {
        name,
        size: s.size.to_vec(),
        range_max: s.side(0),
        range_min: s.side(s.levels() - 1),
        jump: s.jump,
        isometries: s.isometries,
        near: s.near,
        scale_bits: s.scale_bits,
        step: s.step,
        bytes,
        maps,
    }
}
