//! `fractal point`: the value of a tile at points.

use super::super::args::listed;
use super::super::output::{Output, message};
use super::{Codec, bytes_of, metered, notes};
use crate::base::{Error, Result};
use crate::export::fractal::{Answer, Opened, Points, Zoom};
use clap::Args;
use serde_json::{Value, json};
use std::path::PathBuf;
use terraquilt_codecs::fractal::Kind;

/// The value of a fractal tile at points
///
/// Prints CSV: x,y,z,error_m (pictures: x,y,grey,error or x,y,red,green,blue,error; solids: x,y,z,distance,error, positive inside). At zoom 1 a
/// point gets the measured sample whose cell it lies in, and error_m is how far that sample is from the source's. Above zoom 1 it gets what the
/// maps say there: synthetic, of unknown error. Nothing off the tile and where there is no data.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt fractal point crater.ifs 562310.5,5116320\n  terraquilt fractal point crater.ifs 562310.5,5116320 562315,5116320 --zoom 8 --json\n  terraquilt fractal point photo.ifs 120.5,80.5           # pixels from the upper left corner, downwards\n  terraquilt fractal point bunny.ifs 0,0.1,0"
)]
pub struct Point {
    /// Fractal tile; `-`: standard input
    file: PathBuf,
    /// Points, in the coordinates of the file that was encoded
    #[arg(value_name = "X,Y[,Z]", required = true)]
    points: Vec<String>,
    /// How many times finer than the samples; 1: the samples
    #[arg(long, value_name = "Z", default_value_t = 1.0, allow_negative_numbers = true)]
    zoom: f64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Point {
    pub fn run(self) -> Result<bool> {
        let zoom = Zoom::new(self.zoom)?;
        let (name, found) = bytes_of(&self.file, Codec::Fractal, None)?;
        let o = metered(|_| Opened::read(&name, &found))?;
        notes(&o.notes);
        let points = metered(|_| Points::new(&o, zoom))?;
        let asked: Vec<Vec<f64>> =
            self.points.iter().map(|t| self.point(t, points.axes())).collect::<Result<_>>()?;
        let answers: Vec<Option<Answer>> = asked.iter().map(|p| points.value(p)).collect();
        if answers.iter().all(Option::is_none) {
            message(
                "note: no point lies on the tile, or none has data; `terraquilt fractal info` says where it lies",
            );
        } else if zoom.is_synthetic() {
            message("note: values are synthetic: the maps say them, nobody measured them");
        }
        let mut out = Output::new();
        if self.json {
            let rows: Vec<Value> =
                asked.iter().zip(&answers).map(|(p, a)| row(&o, zoom, p, a.as_ref())).collect();
            out.json(&rows)?;
            return out.end();
        }
        let (head, values) = match o.kind() {
            Kind::Heights => ("x,y,z,error_m", 1),
            Kind::Grey => ("x,y,grey,error", 1),
            Kind::Colour => ("x,y,red,green,blue,error", 3),
            Kind::Volume => ("x,y,z,distance,error", 1),
        };
        out.line(head)?;
        for (p, a) in asked.iter().zip(&answers) {
            let mut cells: Vec<String> = p.iter().map(f64::to_string).collect();
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
            put("error_m", error);
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
