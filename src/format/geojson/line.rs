//! Reading a line.

use crate::base::{Error, Result, limits};
use serde_json::Value;
use std::path::Path;

/// Reads the one line of a GeoJSON file: a LineString, bare, in a Feature, or in a FeatureCollection of one.
///
/// Third coordinates are left out. The coordinates are taken to be in the CRS of the database.
///
/// # Errors
/// [`Error::Corrupt`] if it is no JSON; [`Error::Unsupported`] if it holds no LineString or several;
/// [`Error::Limit`] above [`limits::LINE_FILE_BYTES_MAX`].
pub fn read_line(path: &Path) -> Result<Vec<[f64; 2]>> {
    let name = path.display().to_string();
    let size = std::fs::metadata(path).map_err(|e| Error::io(path, e))?.len();
    if size > limits::LINE_FILE_BYTES_MAX {
        return Err(Error::limit(format!("bytes of {name}"), limits::LINE_FILE_BYTES_MAX, size));
    }
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    let value: Value = serde_json::from_slice(&bytes)
        .map_err(|e| Error::corrupt(&name, format!("line {}", e.line()), format!("is no JSON: {e}")))?;
    let mut lines = Vec::new();
    collect(&value, &mut lines);
    let found = match lines[..] {
        [one] => one,
        [] => {
            return Err(Error::unsupported(&name, "holds no LineString", "draw the line as one LineString"));
        }
        _ => {
            return Err(Error::unsupported(
                &name,
                format!("holds {} LineStrings", lines.len()),
                "leave one in the file",
            ));
        }
    };
    let point = |v: &Value| Some([v.get(0)?.as_f64()?, v.get(1)?.as_f64()?]);
    let points: Option<Vec<[f64; 2]>> =
        found.get("coordinates").and_then(Value::as_array).and_then(|l| l.iter().map(point).collect());
    points
        .filter(|p| p.iter().flatten().all(|v| v.is_finite()))
        .ok_or_else(|| Error::corrupt(&name, "coordinates", "of a LineString are a list of [x, y] numbers"))
}

/// The LineStrings of a geometry, a feature or a collection of features.
fn collect<'a>(value: &'a Value, out: &mut Vec<&'a Value>) {
    match value.get("type").and_then(Value::as_str) {
        Some("LineString") => out.push(value),
        Some("Feature") => {
            if let Some(g) = value.get("geometry").filter(|g| g["type"] == "LineString") {
                out.push(g);
            }
        }
        Some("FeatureCollection") => {
            let features = value.get("features").and_then(Value::as_array);
            features.into_iter().flatten().for_each(|f| {
                if f["type"] == "Feature" {
                    collect(f, out);
                }
            });
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<[f64; 2]>> {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        std::fs::write(file.path(), text).expect("it is written");
        read_line(file.path())
    }

    #[test]
    fn a_line_is_found_bare_in_a_feature_and_in_a_collection() {
        let line = r#"{"type":"LineString","coordinates":[[1,2],[3,4.5,9]]}"#;
        let feature = format!(r#"{{"type":"Feature","properties":null,"geometry":{line}}}"#);
        let all = format!(r#"{{"type":"FeatureCollection","features":[{feature}]}}"#);
        for text in [line, &feature, &all] {
            assert_eq!(read(text).expect("a line"), [[1.0, 2.0], [3.0, 4.5]]);
        }
        for (text, word) in [
            ("{", "JSON"),
            (r#"{"type":"Point","coordinates":[1,2]}"#, "no LineString"),
            (r#"{"type":"LineString","coordinates":[[1],[2,3]]}"#, "coordinates"),
            (r#"{"type":"LineString"}"#, "coordinates"),
            (&format!(r#"{{"type":"FeatureCollection","features":[{feature},{feature}]}}"#), "2 LineStrings"),
        ] {
            let e = read(text).expect_err(text).to_string();
            assert!(e.contains(word), "{e}");
        }
    }
}
