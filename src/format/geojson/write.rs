//! Writing lines and polygons.

use crate::base::{Error, Result};
use crate::height::crs::{AxisUnit, Crs};
use serde_json::{Map, Value};
use std::io::Write;

/// What a feature looks like.
#[derive(Clone, Copy, Debug)]
pub enum Shape<'a> {
    Line(&'a [[f64; 2]]),
    /// Closed rings, the outer one first, in either direction: they are written as RFC 7946 wants them, outer
    /// counter-clockwise, holes clockwise.
    Polygon(&'a [Vec<[f64; 2]>]),
}

/// Writes a FeatureCollection feature by feature; holds one.
///
/// Coordinates have three digits after the point, or nine in degrees: a millimetre, or a tenth of one.
pub struct FeatureWriter<W: Write> {
    out: W,
    digits: usize,
    count: u64,
}

impl<W: Write> FeatureWriter<W> {
    /// Begins the collection; `extras` become members of it, beside `type` and `features`.
    pub fn new(mut out: W, crs: &Crs, extras: Map<String, Value>) -> Result<FeatureWriter<W>> {
        let mut head = Map::new();
        head.insert("type".into(), "FeatureCollection".into());
        if crs.code != "EPSG:4326" {
            let urn = format!("urn:ogc:def:crs:{}", crs.code.replace(':', "::"));
            head.insert("crs".into(), serde_json::json!({"type": "name", "properties": {"name": urn}}));
        }
        head.extend(extras);
        let head = Value::Object(head).to_string();
        // The object stays open: the features follow.
        write!(out, "{},\"features\":[", &head[..head.len() - 1]).map_err(io)?;
        let digits = if crs.unit == AxisUnit::Degree { 9 } else { 3 };
        Ok(FeatureWriter { out, digits, count: 0 })
    }

    pub fn feature(&mut self, shape: Shape, properties: &Value) -> Result<()> {
        let comma = if self.count > 0 { "," } else { "" };
        write!(self.out, "{comma}\n{{\"type\":\"Feature\",\"properties\":{properties},\"geometry\":")
            .map_err(io)?;
        match shape {
            Shape::Line(points) => {
                self.out.write_all(b"{\"type\":\"LineString\",\"coordinates\":").map_err(io)?;
                self.points(points.iter())?;
            }
            Shape::Polygon(rings) => {
                self.out.write_all(b"{\"type\":\"Polygon\",\"coordinates\":[").map_err(io)?;
                for (k, ring) in rings.iter().enumerate() {
                    if k > 0 {
                        self.out.write_all(b",").map_err(io)?;
                    }
                    if counter_clockwise(ring) == (k == 0) {
                        self.points(ring.iter())?;
                    } else {
                        self.points(ring.iter().rev())?;
                    }
                }
                self.out.write_all(b"]").map_err(io)?;
            }
        }
        self.count += 1;
        self.out.write_all(b"}}").map_err(io)
    }

    /// Ends the collection; returns how many features it has.
    pub fn finish(mut self) -> Result<u64> {
        self.out.write_all(b"\n]}\n").and_then(|()| self.out.flush()).map_err(io)?;
        Ok(self.count)
    }

    fn points<'a>(&mut self, points: impl Iterator<Item = &'a [f64; 2]>) -> Result<()> {
        for (k, p) in points.enumerate() {
            let open = if k == 0 { "[" } else { "," };
            write!(self.out, "{open}[{},{}]", self.number(p[0]), self.number(p[1])).map_err(io)?;
        }
        self.out.write_all(b"]").map_err(io)
    }

    /// Without zeros at the end.
    fn number(&self, v: f64) -> String {
        let text = format!("{v:.*}", self.digits);
        let text = text.trim_end_matches('0').trim_end_matches('.');
        if text == "-0" { "0".into() } else { text.into() }
    }
}

fn io(e: std::io::Error) -> Error {
    Error::io("GeoJSON", e)
}

fn counter_clockwise(ring: &[[f64; 2]]) -> bool {
    let Some(o) = ring.first() else { return true };
    // About the first point, so that digits are kept.
    let twice: f64 = ring
        .windows(2)
        .map(|w| (w[0][0] - o[0]) * (w[1][1] - o[1]) - (w[1][0] - o[0]) * (w[0][1] - o[1]))
        .sum();
    twice > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_collection_is_json_and_rings_turn_the_right_way() {
        let mut bytes = Vec::new();
        let crs = Crs::from_epsg(32610).expect("a known system");
        let mut w = FeatureWriter::new(&mut bytes, &crs, Map::new()).expect("it begins");
        let square = |a: f64, b: f64| vec![[a, a], [a, b], [b, b], [b, a], [a, a]];
        w.feature(Shape::Line(&[[0.0, -0.0001], [1.5, 2.25]]), &serde_json::json!({"elevation": 5}))
            .expect("written");
        w.feature(Shape::Polygon(&[square(0.0, 9.0), square(2.0, 3.0)]), &Value::Null).expect("written");
        assert_eq!(w.finish().expect("it ends"), 2);
        let v: Value = serde_json::from_slice(&bytes).expect("JSON");
        assert_eq!(v["crs"]["properties"]["name"], "urn:ogc:def:crs:EPSG::32610");
        assert_eq!(v["features"][0]["geometry"]["coordinates"], serde_json::json!([[0, 0], [1.5, 2.25]]));
        let rings = &v["features"][1]["geometry"]["coordinates"];
        assert_eq!(rings[0][1], serde_json::json!([9, 0]), "outer ring counter-clockwise");
        assert_eq!(rings[1][1], serde_json::json!([2, 3]), "hole clockwise");
    }

    #[test]
    fn an_empty_collection_is_json() {
        let mut bytes = Vec::new();
        let crs = Crs::from_epsg(4326).expect("a known system");
        FeatureWriter::new(&mut bytes, &crs, Map::new()).expect("it begins").finish().expect("it ends");
        let v: Value = serde_json::from_slice(&bytes).expect("JSON");
        assert_eq!(v, serde_json::json!({"type": "FeatureCollection", "features": []}));
    }
}
