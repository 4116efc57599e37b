//! Polygons out of GeoJSON (RFC 7946): Polygon, MultiPolygon, GeometryCollection, Feature, FeatureCollection.
//!
//! Coordinates come as they stand in the file. RFC 7946 knows longitude and latitude only; a file of the older kind may
//! name its CRS in a member `crs`, and its name is handed on. This file is the only door to the crate `geojson`.

use crate::base::polygon::Ring;
use crate::base::{Error, Result, limits};
use geojson::{GeoJson, Geometry, GeometryValue, Position};
use std::path::Path;

/// What a file holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Polygons {
    /// Outer ring and holes of each polygon; the last point of a ring, which repeats the first, is left out.
    pub parts: Vec<Vec<Ring>>,
    /// The CRS that the file names, as [`Crs::parse`](crate::height::crs::Crs::parse) reads it.
    pub crs: Option<String>,
    /// Points and lines that were passed over.
    pub others: u64,
}

/// Reads the polygons of a file.
///
/// # Errors
/// [`Error::Missing`] if there is none of that name, [`Error::Limit`] above [`limits::GEOJSON_BYTES_MAX`] bytes or
/// [`limits::POLYGON_POINTS_MAX`] points, [`Error::Corrupt`] if it is not GeoJSON, [`Error::Invalid`] if a ring is not
/// closed or no polygon is in it.
pub fn read_polygons(path: &Path) -> Result<Polygons> {
    let name = path.display().to_string();
    let meta = std::fs::metadata(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => Error::missing(format!("file {name}"), "check the name"),
        _ => Error::io(path, e),
    })?;
    if !meta.is_file() {
        return Err(Error::unsupported(name, "not a regular file", "name a GeoJSON file"));
    }
    if meta.len() > limits::GEOJSON_BYTES_MAX {
        let what = format!("bytes of {name} (simplify the polygon)");
        return Err(Error::limit(what, limits::GEOJSON_BYTES_MAX, meta.len()));
    }
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
    parse(&name, &text)
}

/// As [`read_polygons`], of a text; `name` is used in errors.
pub fn parse(name: &str, text: &str) -> Result<Polygons> {
    let text = text.trim_start_matches('\u{feff}');
    let bad = |e: String| Error::corrupt(name, "GeoJSON", e);
    let json: GeoJson = text.parse().map_err(|e: geojson::Error| bad(e.to_string()))?;
    let mut found = Polygons::default();
    let foreign = match &json {
        GeoJson::Geometry(g) => g.foreign_members.as_ref(),
        GeoJson::Feature(f) => f.foreign_members.as_ref(),
        GeoJson::FeatureCollection(c) => c.foreign_members.as_ref(),
    };
    if let Some(crs) = foreign.and_then(|m| m.get("crs")).filter(|c| !c.is_null()) {
        let text = crs.pointer("/properties/name").or(Some(crs)).and_then(|n| n.as_str());
        let text = text.ok_or_else(|| bad("its member \"crs\" names no system by properties.name".into()))?;
        found.crs = Some(crs_name(text));
    }
    match &json {
        GeoJson::Geometry(g) => found.geometry(name, g)?,
        GeoJson::Feature(f) => f.geometry.iter().try_for_each(|g| found.geometry(name, g))?,
        GeoJson::FeatureCollection(c) => {
            c.features.iter().flat_map(|f| &f.geometry).try_for_each(|g| found.geometry(name, g))?;
        }
    }
    if found.parts.is_empty() {
        let reason = match found.others {
            0 => "holds no geometry, so the region is empty".to_string(),
            n => {
                format!("holds {n} points or lines but no polygon; a region needs a Polygon or MultiPolygon")
            }
        };
        return Err(Error::invalid(name, reason));
    }
    Ok(found)
}

impl Polygons {
    fn geometry(&mut self, name: &str, g: &Geometry) -> Result<()> {
        match &g.value {
            GeometryValue::Polygon { coordinates } => self.part(name, coordinates),
            GeometryValue::MultiPolygon { coordinates } => {
                coordinates.iter().try_for_each(|p| self.part(name, p))
            }
            GeometryValue::GeometryCollection { geometries } => {
                geometries.iter().try_for_each(|g| self.geometry(name, g))
            }
            _ => {
                self.others += 1;
                Ok(())
            }
        }
    }

    fn part(&mut self, name: &str, rings: &[Vec<Position>]) -> Result<()> {
        if rings.is_empty() {
            return Ok(());
        }
        let number = self.parts.len() + 1;
        let mut part = Vec::with_capacity(rings.len());
        for (n, ring) in rings.iter().enumerate() {
            let place = format!("ring {} of part {number}", n + 1);
            let mut points = Ring::with_capacity(ring.len());
            for position in ring {
                let [x, y, ..] = *position.as_slice() else {
                    return Err(Error::corrupt(name, place, "a position has less than two numbers"));
                };
                points.push([x, y]);
            }
            if points.len() < 4 {
                let reason = format!(
                    "{place} has {} points; a ring needs 3 and the first of them again at its end",
                    points.len()
                );
                return Err(Error::invalid(name, reason));
            }
            let (first, last) = (points[0], points[points.len() - 1]);
            if first != last {
                let reason = format!(
                    "{place} is not closed: it begins at {}, {} and ends at {}, {}; repeat the first point at the end",
                    first[0], first[1], last[0], last[1]
                );
                return Err(Error::invalid(name, reason));
            }
            points.pop();
            part.push(points);
        }
        self.parts.push(part);
        Ok(())
    }
}

/// `urn:ogc:def:crs:EPSG::26910` and the like as `EPSG:26910`; CRS84 is longitude and latitude on WGS 84.
fn crs_name(text: &str) -> String {
    let Some(rest) = text.strip_prefix("urn:ogc:def:crs:") else { return text.to_string() };
    let words: Vec<&str> = rest.split(':').collect();
    match (words.first(), words.last()) {
        (Some(&"OGC"), Some(&"CRS84")) => "EPSG:4326".to_string(),
        (Some(authority), Some(code)) => format!("{authority}:{code}"),
        _ => text.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: &str = "[[0,0],[4,0],[4,4,99],[0,4],[0,0]]";

    #[test]
    fn every_kind_of_object_gives_its_polygons() {
        let polygon = format!(r#"{{"type":"Polygon","coordinates":[{SQUARE}]}}"#);
        let feature = format!(r#"{{"type":"Feature","properties":null,"geometry":{polygon}}}"#);
        let point = r#"{"type":"Feature","properties":{},"geometry":{"type":"Point","coordinates":[1,2]}}"#;
        for (text, parts, others) in [
            (polygon.clone(), 1, 0),
            (format!("\u{feff}{feature}"), 1, 0),
            (format!(r#"{{"type":"MultiPolygon","coordinates":[[{SQUARE}],[{SQUARE},{SQUARE}]]}}"#), 2, 0),
            (format!(r#"{{"type":"FeatureCollection","features":[{feature},{point},{feature}]}}"#), 2, 1),
            (format!(r#"{{"type":"GeometryCollection","geometries":[{polygon},{polygon}]}}"#), 2, 0),
        ] {
            let found = parse("f", &text).unwrap();
            assert_eq!((found.parts.len(), found.others, found.crs), (parts, others, None), "{text}");
            assert_eq!(found.parts[0][0], [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]);
        }
    }

    #[test]
    fn the_older_crs_member_is_handed_on() {
        for (name, code) in [
            ("urn:ogc:def:crs:EPSG::26910", "EPSG:26910"),
            ("urn:ogc:def:crs:EPSG:6.6:4269", "EPSG:4269"),
            ("urn:ogc:def:crs:OGC:1.3:CRS84", "EPSG:4326"),
            ("EPSG:25832", "EPSG:25832"),
        ] {
            let crs = format!(r#"{{"type":"name","properties":{{"name":"{name}"}}}}"#);
            let text = format!(r#"{{"type":"Polygon","crs":{crs},"coordinates":[{SQUARE}]}}"#);
            assert_eq!(parse("f", &text).unwrap().crs.as_deref(), Some(code));
        }
        let text = format!(r#"{{"type":"Polygon","crs":{{"type":"link"}},"coordinates":[{SQUARE}]}}"#);
        assert!(parse("f", &text).unwrap_err().to_string().contains("crs"));
    }

    #[test]
    fn what_is_no_region_is_refused() {
        for (text, word) in [
            ("", "damaged GeoJSON"),
            ("{\"type\":\"Polygon\"", "damaged GeoJSON"),
            ("[1,2]", "damaged GeoJSON"),
            (r#"{"type":"Polygon","coordinates":[[[0,0],[1]]]}"#, "less than two"),
            (r#"{"type":"Polygon","coordinates":[[[0,0],["1",2]]]}"#, "damaged GeoJSON"),
            (r#"{"type":"Polygon","coordinates":[[[0,0],[1,1],[0,0]]]}"#, "has 3 points"),
            (
                r#"{"type":"Polygon","coordinates":[[[0,0],[1,1],[1,0],[0,2]]]}"#,
                "not closed: it begins at 0, 0",
            ),
            (r#"{"type":"Polygon","coordinates":[]}"#, "empty"),
            (r#"{"type":"FeatureCollection","features":[]}"#, "empty"),
            (r#"{"type":"LineString","coordinates":[[0,0],[1,1]]}"#, "no polygon"),
        ] {
            let line = parse("f.geojson", text).unwrap_err().to_string();
            assert!(line.contains(word) && line.contains("f.geojson"), "{text}: {line}");
        }
        assert!(matches!(read_polygons(Path::new("no/such.geojson")), Err(Error::Missing { .. })));
    }
}
