//! `fractal point`: the value of a tile at points.

use super::super::args::listed;
use super::super::output::{Output, message};
use super::super::points::{Table, quoted, read_points};
use super::{Codec, bytes_of, metered, notes};
use crate::base::{Error, Result};
use crate::export::fractal::{Answer, Opened, Points, Zoom};
use clap::Args;
use serde_json::{Value, json};
use std::path::PathBuf;
use terraquilt_codecs::fractal::Kind;

/// The value of a fractal tile at points
///
/// Prints CSV: x,y,z,error (pictures: x,y,grey,error or x,y,red,green,blue,error; solids: x,y,z,distance,error, positive inside), heights and their
/// errors in the unit that `fractal info` names. At zoom 1 a point gets the measured sample whose cell it lies in, and error is how far that sample is
/// from the source's at most. Above zoom 1 it gets what the maps say there: synthetic, of unknown error. Nothing off the tile and where there is no
/// data. Further columns of --points come first.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt fractal point crater.ifs 562310.5,5116320\n  terraquilt fractal point crater.ifs 562310.5,5116320 562315,5116320 --zoom 8 --json\n  terraquilt fractal point crater.ifs --points stakes.csv > heights.csv\n  terraquilt fractal point photo.ifs 120.5,80.5           # pixels from the upper left corner, downwards\n  terraquilt fractal point bunny.ifs 0,0.1,0"
)]
pub struct Point {
    /// Fractal tile; `-`: standard input
    file: PathBuf,
    /// Points, in the coordinates of the file that was encoded
    #[arg(value_name = "X,Y[,Z]", required_unless_present = "points")]
    at_points: Vec<String>,
    /// Points from a CSV file: columns x and y (of solids z, too), or the first ones
    #[arg(long, value_name = "FILE.csv", conflicts_with = "at_points")]
    points: Option<PathBuf>,
    /// How many times finer than the samples; 1: the samples
    #[arg(long, value_name = "Z", default_value_t = 1.0, allow_negative_numbers = true)]
    zoom: f64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Columns that are printed.
const NAMES: [&str; 9] = ["x", "y", "z", "error", "grey", "red", "green", "blue", "distance"];

impl Point {
    pub fn run(self) -> Result<bool> {
        let zoom = Zoom::new(self.zoom)?;
        let (name, found) = bytes_of(&self.file, Codec::Fractal, None)?;
        let o = metered(|_| Opened::read(&name, &found))?;
        notes(&o.notes);
        let points = metered(|_| Points::new(&o, zoom))?;
        let (asked, columns) = self.asked(points.axes())?;
        let answers: Vec<Option<Answer>> = asked.iter().map(|p| points.value(p)).collect();
        if answers.iter().all(Option::is_none) {
            message(
                "note: no point lies on the tile, or none has data; `terraquilt fractal info` says where it lies",
            );
        } else if zoom.is_synthetic() {
            message(
                "note: values are synthetic: the maps say them (as `decode --detail plain`), nobody measured them",
            );
        }
        let mut out = Output::new();
        if self.json {
            let mut rows: Vec<Value> =
                asked.iter().zip(&answers).map(|(p, a)| row(&o, zoom, p, a.as_ref())).collect();
            for (row, cells) in rows.iter_mut().zip(columns.iter().flat_map(|t| &t.rows)) {
                let named = columns.iter().flat_map(|t| t.names.iter().zip(cells));
                row["columns"] =
                    Value::Object(named.map(|(n, c)| (n.clone(), Value::String(c.clone()))).collect());
            }
            out.json(&rows)?;
            return out.end();
        }
        let (head, values) = match o.kind() {
            Kind::Heights => ("x,y,z,error", 1),
            Kind::Grey => ("x,y,grey,error", 1),
            Kind::Colour => ("x,y,red,green,blue,error", 3),
            Kind::Volume => ("x,y,z,distance,error", 1),
        };
        let joined = |cells: &[String]| cells.iter().map(|c| quoted(c)).collect::<Vec<_>>();
        let names = columns.iter().flat_map(|t| joined(&t.names)).chain([head.to_string()]);
        out.line(names.collect::<Vec<_>>().join(","))?;
        for (k, (p, a)) in asked.iter().zip(&answers).enumerate() {
            let mut cells = columns.as_ref().map_or(Vec::new(), |t| joined(&t.rows[k]));
            cells.extend(p.iter().map(f64::to_string));
            match a {
                Some(a) => {
                    cells.extend(a.values.iter().map(f64::to_string));
                    cells.push(a.error.map_or(String::new(), |e| e.to_string()));
                }
                None => cells.extend(std::iter::repeat_n(String::new(), values + 1)),
            }
            out.line(cells.join(","))?;
        }
        out.end()
    }

    /// The points, and the columns that are no coordinates.
    fn asked(&self, axes: usize) -> Result<(Vec<Vec<f64>>, Option<Table>)> {
        let Some(file) = &self.points else {
            return Ok((self.at_points.iter().map(|t| self.point(t, axes)).collect::<Result<_>>()?, None));
        };
        let read = read_points(file)?;
        if read.xy.is_empty() {
            return Err(Error::invalid(file.display(), "holds no points; a line each is needed: x,y"));
        }
        let mut asked: Vec<Vec<f64>> = read.xy.iter().map(|p| p.to_vec()).collect();
        let mut columns = read.table;
        let mut places: Vec<usize> = columns.iter().flat_map(|t| t.place).collect();
        if axes == 3 {
            let name = file.display();
            let missing = || {
                Error::invalid(
                    &name,
                    "has no column z, and no third column; a solid is asked with x, y and z",
                )
            };
            let table = columns.as_ref().ok_or_else(missing)?;
            let named = table.names.iter().position(|n| n.eq_ignore_ascii_case("z"));
            let at = named.or((0..table.names.len()).find(|k| !places.contains(k))).ok_or_else(missing)?;
            for (p, cells) in asked.iter_mut().zip(&table.rows) {
                let z = cells[at].parse::<f64>().ok().filter(|z| z.is_finite());
                p.push(z.ok_or_else(|| {
                    Error::invalid(
                        &name,
                        format!("'{}' is no number for z, of the point {}, {}", cells[at], p[0], p[1]),
                    )
                })?);
            }
            places.push(at);
        }
        if let Some(t) = &mut columns {
            let rest = |cells: &[String]| {
                let own = cells.iter().enumerate().filter(|(k, _)| !places.contains(k));
                own.map(|(_, c)| c.clone()).collect::<Vec<_>>()
            };
            t.rows = t.rows.iter().map(|r| rest(r)).collect();
            t.names = rest(&t.names);
            // Two columns of one name would be one to who reads them.
            for name in t.names.iter_mut().filter(|n| NAMES.iter().any(|own| own.eq_ignore_ascii_case(n))) {
                name.push_str("_given");
            }
        }
        Ok((asked, columns.filter(|t| !t.names.is_empty())))
    }

    fn point(&self, text: &str, axes: usize) -> Result<Vec<f64>> {
        let p = listed("point", text)?;
        if p.len() != axes {
            let need = if axes == 3 { "a solid is asked with X,Y,Z" } else { "this tile is asked with X,Y" };
            return Err(Error::invalid("point", format!("'{text}' has {} numbers; {need}", p.len())));
        }
        Ok(p)
    }
}

fn row(o: &Opened, zoom: Zoom, p: &[f64], a: Option<&Answer>) -> Value {
    let mut row = json!({ "x": p[0], "y": p[1], "synthetic": zoom.is_synthetic() });
    let value = |k: usize| json!(a.map(|a| a.values[k]));
    let mut put = |name: &str, v: Value| row[name] = v;
    let error = json!(a.and_then(|a| a.error));
    match o.kind() {
        Kind::Heights => {
            put("z", value(0));
            put("error", error);
        }
        Kind::Grey => {
            put("grey", value(0));
            put("error", error);
        }
        Kind::Colour => {
            ["red", "green", "blue"].iter().enumerate().for_each(|(k, n)| put(n, value(k)));
            put("error", error);
        }
        Kind::Volume => {
            put("z", json!(p[2]));
            put("distance", value(0));
            put("error", error);
        }
    }
    put("sample", json!(a.map(|a| &a.sample)));
    row
}
