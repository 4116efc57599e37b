//! Commands that read: surveys, tiles, versions, patches, heights, boxes.

use super::args::{CoordsArg, Region, Source, ToleranceArgs, numbers};
use super::output::{Output, count, message, table};
use super::points::{Points, quoted, read_points};
use super::reader::{Needed, Reader};
use crate::analysis::{Ground, Posts};
use crate::base::{Error, Result};
use crate::db::query::{difference, set_hash};
use crate::export::whereabouts;
use crate::height::lod::SurveyNumber;
use crate::height::surface::{Evaluation, Seams};
use crate::store::quadtree::Record;
use clap::Args;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// List what is in the database
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt surveys hills --json")]
pub struct Surveys {
    #[command(flatten)]
    source: Source,
}

impl Surveys {
    pub fn run(self) -> Result<bool> {
        let rows = self.source.open()?.surveys()?;
        let mut out = Output::new();
        if self.source.json {
            out.json(&rows)?;
            return out.end();
        }
        if rows.is_empty() {
            out.line("no survey yet; `terraquilt ingest` brings one")?;
            return out.end();
        }
        let lines: Vec<Vec<String>> = rows
            .iter()
            .map(|r| {
                vec![
                    r.name.clone(),
                    r.date.clone().unwrap_or_else(|| "-".into()),
                    format!("{}", r.accuracy_m),
                    r.precedence.to_string(),
                    format!("{} x {}", short(r.step[0]), short(r.step[1])),
                    format!("{:.1}", r.rotation_deg),
                    format!("{} x {}", r.cols, r.rows),
                    r.tiles.to_string(),
                    count(r.live),
                    count(r.dormant),
                    r.version.to_string(),
                ]
            })
            .collect();
        table(
            &[
                "name",
                "date",
                "accuracy m",
                "rank",
                "step",
                "turned",
                "posts",
                "tiles",
                "live",
                "dormant",
                "since version",
            ],
            &lines,
            &mut out,
        )?;
        out.end()
    }
}

/// Six significant digits, for people.
fn short(v: f64) -> f64 {
    crate::base::round::significant(v, 6)
}

/// List the tiles of a survey
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt tiles hills lidar-2025")]
pub struct Tiles {
    #[command(flatten)]
    source: Source,
    survey: String,
}

impl Tiles {
    pub fn run(self) -> Result<bool> {
        let tiles = self.source.open()?.tiles(&self.survey)?;
        let mut out = Output::new();
        if self.source.json {
            out.json(&tiles)?;
            return out.end();
        }
        let rows: Vec<Vec<String>> = tiles
            .iter()
            .map(|t| {
                vec![
                    t.file.clone(),
                    t.key[..12.min(t.key.len())].to_string(),
                    format!("{} x {}", t.cols, t.rows),
                    format!("{}, {}", t.first[0], t.first[1]),
                    count(t.valid),
                    format!("{} .. {}", t.z_min, t.z_max),
                ]
            })
            .collect();
        table(&["file", "key", "posts", "first post", "valid", "heights m"], &rows, &mut out)?;
        out.end()
    }
}

/// List every commit
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt versions hills\nReading commands take --at VERSION.")]
pub struct Versions {
    /// Directory of the database (or --server ADDR)
    db: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Versions {
    pub fn run(self) -> Result<bool> {
        let versions = Reader::versions(&self.db)?;
        let mut out = Output::new();
        if self.json {
            out.json(&versions)?;
            return out.end();
        }
        let rows: Vec<Vec<String>> =
            versions.iter().map(|v| vec![v.version.to_string(), utc(v.made_at), v.action.clone()]).collect();
        table(&["version", "made (UTC)", "action"], &rows, &mut out)?;
        out.end()
    }
}

/// Seconds since 1970 as a day and a time (days to civil date after Howard Hinnant).
fn utc(seconds: i64) -> String {
    let (days, rest) = (seconds.div_euclid(86_400), seconds.rem_euclid(86_400));
    let z = days + 719_468;
    let era = z.div_euclid(146_097);
    let doe = z.rem_euclid(146_097);
    let yoe = (doe - doe / 1460 + doe / 36_524 - doe / 146_096) / 365;
    let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
    let mp = (5 * doy + 2) / 153;
    let day = doy - (153 * mp + 2) / 5 + 1;
    let month = if mp < 10 { mp + 3 } else { mp - 9 };
    let year = yoe + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02}:{:02}", rest / 3600, rest / 60 % 60, rest % 60)
}

/// The hash of a set of patches as JSON has it.
fn set_of(records: &[Record]) -> String {
    set_hash(records.iter()).iter().map(|b| format!("{b:02x}")).collect()
}

/// List the patches that a region needs within a tolerance
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt patches hills --error 5\n  terraquilt patches hills --bbox 500000,4100000,501000,4101000 --error 1 --json\n  terraquilt patches hills --eye 500000,4100000,2500 --look-at 503000,4102000,1800\n  terraquilt patches hills --error 5 --since 3      # what changed since version 3"
)]
pub struct Patches {
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    region: Region,
    #[command(flatten)]
    tolerance: ToleranceArgs,
    /// Only what differs from the same question to this version
    #[arg(long, value_name = "VERSION")]
    since: Option<u64>,
}

impl Patches {
    pub fn run(self) -> Result<bool> {
        let r = self.source.open()?;
        let s = r.ground()?;
        let place = self.region.place(s)?;
        let query = self.tolerance.query(&place, s, Seams::Off)?;
        let found = r.select(&query)?;
        if found.records.is_empty() {
            let there = whereabouts(s.crs(), s.bounds(), place.coords.as_ref());
            message(&format!("note: nothing lies there; {there}"));
        }
        match self.since {
            Some(v) => {
                let before = r.at(Some(v))?;
                self.difference(s, &before.select(&query)?, &found)
            }
            None => self.list(s, &found),
        }
    }

    fn list(&self, s: &dyn Ground, found: &Needed) -> Result<bool> {
        let posts = by_number(s);
        let mut out = Output::new();
        if self.source.json {
            let patches =
                found.records.iter().map(|r| patch(s, &posts, r)).collect::<Result<Vec<Value>>>()?;
            out.json(&json!({
                "version": found.version, "count": patches.len(), "set": set_of(&found.records), "patches": patches,
                "nodes_visited": found.nodes, "records_tested": found.tested,
            }))?;
            return out.end();
        }
        let mut by: BTreeMap<(String, u8), (u64, f32, f32)> = Default::default();
        for r in &found.records {
            let name = survey_of(&posts, r)?.name.to_string();
            let e = by.entry((name, r.place.level)).or_insert((0, f32::INFINITY, 0.0));
            *e = (e.0 + 1, e.1.min(r.bot), e.2.max(r.bot));
        }
        let rows: Vec<Vec<String>> = by
            .iter()
            .map(|((n, l), (k, lo, hi))| {
                vec![n.clone(), l.to_string(), count(*k), format!("{lo:.3} .. {hi:.3}")]
            })
            .collect();
        table(&["survey", "level", "patches", "errors m"], &rows, &mut out)?;
        out.line(format!(
            "{} patches at version {}, {} tree nodes read (--json lists them)",
            count(found.records.len() as u64),
            found.version,
            found.nodes
        ))?;
        out.end()
    }

    fn difference(&self, s: &dyn Ground, old: &Needed, new: &Needed) -> Result<bool> {
        let posts = by_number(s);
        let d = difference(&old.records, &new.records);
        let mut out = Output::new();
        if self.source.json {
            let added = d.added.iter().map(|r| patch(s, &posts, r)).collect::<Result<Vec<Value>>>()?;
            let changed: Vec<Value> = d
                .changed
                .iter()
                .map(|r| json!({"id": r.id.to_string(), "top_m": finite(r.top), "floor": r.floor}))
                .collect();
            let removed: Vec<String> = d.removed.iter().map(|r| r.id.to_string()).collect();
            out.json(&json!({
                "from": old.version, "to": new.version, "added": added, "removed": removed, "changed": changed,
                "set": set_of(&new.records),
            }))?;
            return out.end();
        }
        out.line(format!(
            "from version {} to {}: {} added, {} removed, {} with another top or floor, {} unchanged",
            old.version,
            new.version,
            count(d.added.len() as u64),
            count(d.removed.len() as u64),
            count(d.changed.len() as u64),
            count((new.records.len() - d.added.len() - d.changed.len()) as u64),
        ))?;
        out.end()
    }
}

fn finite(v: f32) -> Option<f32> {
    v.is_finite().then_some(v)
}

fn by_number(s: &dyn Ground) -> BTreeMap<SurveyNumber, Posts<'_>> {
    s.posts().map(|p| (p.number, p)).collect()
}

fn survey_of<'a>(posts: &'a BTreeMap<SurveyNumber, Posts>, r: &Record) -> Result<&'a Posts<'a>> {
    posts.get(&r.survey).ok_or_else(|| {
        Error::corrupt("tree", format!("patch {}", r.id), "is of no survey; run `terraquilt verify`")
    })
}

fn patch(s: &dyn Ground, posts: &BTreeMap<SurveyNumber, Posts>, r: &Record) -> Result<Value> {
    let g = survey_of(posts, r)?;
    let size = s.unit().size();
    let domain = r.place.domain();
    let quad = g.frame.quad(&domain).0.map(|p| [p.x as f64 * size, p.y as f64 * size]);
    let center = [0, 1].map(|k| quad.iter().map(|p| p[k]).sum::<f64>() / 4.0);
    let half = [g.steps[0] * domain.width() as f64 / 2.0, g.steps[1] * domain.height() as f64 / 2.0];
    Ok(json!({
        "id": r.id.to_string(), "survey": g.name, "level": r.place.level, "index": [r.place.i, r.place.j],
        "center": center, "half": half, "angle_deg": (g.frame.u.y as f64).atan2(g.frame.u.x as f64).to_degrees(),
        "domain": quad, "error_m": r.bot, "top_m": finite(r.top), "floor": r.floor,
    }))
}

/// Heights of the surface at points
///
/// Prints CSV: x,y,z,error_m. No z: no data there. A z without error_m: the outermost cell of a survey or hole, where no error
/// is promised. Further columns of --points come first, then z and error_m. With --coords, x and y are in that CRS.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt heights hills --error 0 562310.5,5116320\n  terraquilt heights hills --error 1 --points stakes.csv > heights.csv\n  terraquilt heights hills --error 0 562310.5,5116320 --explain\n  terraquilt heights hills --error 0 --coords EPSG:4326 -122.19,46.2"
)]
pub struct Heights {
    #[command(flatten)]
    source: Source,
    /// Points in the database's CRS, or that of --coords
    #[arg(value_name = "X,Y")]
    at_points: Vec<String>,
    #[command(flatten)]
    coords: CoordsArg,
    #[command(flatten)]
    tolerance: ToleranceArgs,
    /// A CSV file: x and y in the first two columns, or in columns named x and y
    #[arg(long, value_name = "FILE.csv", conflicts_with = "at_points")]
    points: Option<PathBuf>,
    /// Say which patches contributed, and with what weight
    #[arg(long)]
    explain: bool,
}

impl Heights {
    pub fn run(self) -> Result<bool> {
        let r = self.source.open()?;
        let s = r.ground()?;
        let points = match &self.points {
            Some(f) => read_points(f)?,
            None if self.at_points.is_empty() => {
                return Err(Error::invalid("points", "none given; name X,Y ... or --points FILE.csv"));
            }
            None => Points {
                xy: self.at_points.iter().map(|t| numbers("point", t)).collect::<Result<_>>()?,
                table: None,
            },
        };
        let coords = self.coords.get(s)?;
        let inside: Vec<[f64; 2]> = match &coords {
            Some(c) => points.xy.iter().map(|p| c.inside("point", *p)).collect::<Result<_>>()?,
            None => points.xy.clone(),
        };
        let tolerance = self.tolerance.get(s, coords.as_ref())?;
        if let (crate::db::query::Tolerance::Camera(_), crate::height::crs::AxisUnit::Degree) =
            (&tolerance, s.crs().unit)
        {
            return Err(Error::unsupported(
                &s.crs().code,
                "a camera needs metres, and this database is in degrees",
                "ask with --error M",
            ));
        }
        let how = self.tolerance.how(Seams::Off);
        let found = s.heights(&inside, &tolerance, how)?;
        let makers = if self.explain { r.explain(&inside, &tolerance, how)? } else { Vec::new() };
        if !found.is_empty() && found.iter().all(Option::is_none) {
            let there = whereabouts(s.crs(), s.bounds(), coords.as_ref());
            message(&format!("note: no point lies on a survey; {there}"));
        }
        let mut out = Output::new();
        if !self.source.json {
            let names = points
                .table
                .as_ref()
                .map(|t| t.names.iter().map(|n| quoted(n)).collect::<Vec<_>>().join(","));
            out.line(format!("{},z,error_m", names.as_deref().unwrap_or("x,y")))?;
        }
        let mut rows = Vec::new();
        for (k, (p, e)) in points.xy.iter().zip(&found).enumerate() {
            let cells = points.table.as_ref().map(|t| (t, &t.rows[k]));
            if self.source.json {
                let mut row = row(p, e.as_ref());
                if let Some((t, cells)) = cells {
                    let more = (0..cells.len()).filter(|k| !t.place.contains(k));
                    let more = more.map(|k| (t.names[k].clone(), Value::String(cells[k].clone())));
                    row["columns"] = Value::Object(more.collect());
                }
                if let Some(makers) = makers.get(k) {
                    row["sources"] = json!(makers);
                }
                rows.push(row);
                continue;
            }
            let start = match cells {
                Some((_, cells)) => cells.iter().map(|c| quoted(c)).collect::<Vec<_>>().join(","),
                None => format!("{},{}", p[0], p[1]),
            };
            match e {
                // No error is promised in the rim: the column stays empty there.
                Some(e) if !e.certified => out.line(format!("{start},{},", e.z))?,
                Some(e) => out.line(format!("{start},{},{}", e.z, e.error_m))?,
                None => out.line(format!("{start},,"))?,
            }
            for m in makers.get(k).into_iter().flatten() {
                // Names as JSON writes them.
                out.line(format!(
                    "# {} patch {} weight {}",
                    json!(m.survey),
                    json!(m.patch),
                    json!(m.weight)
                ))?;
            }
        }
        if self.source.json {
            out.json(&rows)?;
        }
        out.end()
    }
}

fn row(p: &[f64; 2], e: Option<&Evaluation>) -> Value {
    match e {
        Some(e) => json!({"x": p[0], "y": p[1], "z": e.z, "error_m": e.error_m, "accuracy_m": e.accuracy_m,
                          "certified": e.certified, "synthetic": false, "correction_m": e.correction_m,
                          "contradiction": e.contradiction}),
        None => {
            json!({"x": p[0], "y": p[1], "z": null, "error_m": null, "accuracy_m": null, "certified": false,
                       "synthetic": false, "correction_m": null, "contradiction": false})
        }
    }
}

/// Print every patch as exact integers, one JSON object a line, for independent checking
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt boxes hills > boxes.jsonl")]
pub struct Boxes {
    #[command(flatten)]
    source: Source,
}

impl Boxes {
    pub fn run(self) -> Result<bool> {
        let mut out = Output::new();
        self.source.open()?.boxes(|line| out.write(line))?;
        out.end()
    }
}
