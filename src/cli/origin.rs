//! Where a map comes from: what each survey contributes, everywhere or to a region.

use super::args::{Region, Source, ToleranceArgs};
use super::output::{Output, bytes, count, table};
use crate::base::Result;
use crate::height::surface::Seams;
use clap::Args;

fn percent(share: f64) -> String {
    format!("{:.2} %", share * 100.0)
}

/// List what each survey contributes, and which are redundant: seen at no tolerance
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt redundant hills\nA survey is redundant if no patch of it is live. Without it every height stays the same; `remove`, then `prune`, frees\nits bytes. It would be missed if a survey that covers it were removed."
)]
pub struct Redundant {
    #[command(flatten)]
    source: Source,
}

impl Redundant {
    pub fn run(self) -> Result<bool> {
        let all = self.source.open()?.contributions()?;
        let mut out = Output::new();
        if self.source.json {
            out.json(&all)?;
            return out.end();
        }
        let rows: Vec<Vec<String>> = all
            .iter()
            .map(|c| {
                vec![
                    c.name.clone(),
                    format!("{} of {}", count(c.live), count(c.patches)),
                    percent(c.live_share),
                    percent(c.cells_share),
                    bytes(c.bytes),
                    if c.redundant { "redundant".into() } else { String::new() },
                ]
            })
            .collect();
        table(&["survey", "live patches", "share", "cells kept", "removal frees", ""], &rows, &mut out)?;
        let gone: Vec<_> = all.iter().filter(|c| c.redundant).collect();
        out.line(format!(
            "{} of {} redundant; removing them frees {} (after `terraquilt prune`)",
            gone.len(),
            all.len(),
            bytes(gone.iter().map(|c| c.bytes).sum())
        ))?;
        out.end()
    }
}

/// Say which surveys the heights of a region come from, and how much of it each shows
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt provenance hills --error 2 --bbox 562000,5115000,563000,5116000\nThe weights of the surface are evaluated at the centres of a grid over the region, some 200 x 200 unless --step says\notherwise. `share` is a survey's weight on average, `mostly` the share of the points where it weighs most."
)]
pub struct ProvenanceCommand {
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    region: Region,
    #[command(flatten)]
    tolerance: ToleranceArgs,
    /// Spacing of the points, in units of the CRS
    #[arg(long, value_name = "LENGTH")]
    step: Option<f64>,
}

impl ProvenanceCommand {
    pub fn run(self) -> Result<bool> {
        let r = self.source.open()?;
        let s = r.ground()?;
        let query = self.tolerance.query(&self.region.place(s)?, s, Seams::Off)?;
        let p = r.provenance(&query, self.step)?;
        let mut out = Output::new();
        if self.source.json {
            out.json(&p)?;
            return out.end();
        }
        let rows: Vec<Vec<String>> = p
            .surveys
            .iter()
            .map(|s| {
                vec![
                    s.name.clone(),
                    s.date.clone().unwrap_or_else(|| "-".into()),
                    format!("{} m", s.accuracy_m),
                    percent(s.share),
                    percent(s.dominant_share),
                    format!("{:.3} m", s.error_max_m),
                    format!("{}-{}", s.levels[0], s.levels[1]),
                ]
            })
            .collect();
        table(&["survey", "date", "accuracy", "share", "mostly", "error up to", "levels"], &rows, &mut out)?;
        out.line(format!(
            "{} points {:.4} x {:.4} apart, {} with data",
            count(p.points),
            p.step[0],
            p.step[1],
            count(p.points_with_data)
        ))?;
        out.end()
    }
}
