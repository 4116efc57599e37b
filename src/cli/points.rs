//! Points in CSV files, with the columns that come along.

use crate::base::{Error, Result};
use std::path::Path;

/// The points of a file.
#[derive(Debug, Default, PartialEq)]
pub struct Points {
    pub xy: Vec<[f64; 2]>,
    /// Names and cells of all columns, if there are more than x and y.
    pub table: Option<Table>,
}

#[derive(Debug, Default, PartialEq)]
pub struct Table {
    pub names: Vec<String>,
    /// Which columns hold x and y.
    pub place: [usize; 2],
    /// One row a point.
    pub rows: Vec<Vec<String>>,
}

/// The cells of a line; quotes keep separators, and two of them are one.
fn cells(line: &str, separator: char) -> Vec<String> {
    let (mut out, mut cell, mut quoted) = (Vec::new(), String::new(), false);
    let mut chars = line.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '"' if quoted && chars.peek() == Some(&'"') => {
                cell.push('"');
                chars.next();
            }
            '"' => quoted = !quoted,
            _ if c == separator && !quoted => out.push(std::mem::take(&mut cell).trim().to_string()),
            _ => cell.push(c),
        }
    }
    out.push(cell.trim().to_string());
    out
}

/// A cell as it is written with commas between.
pub fn quoted(cell: &str) -> String {
    if cell.contains([',', '"']) { format!("\"{}\"", cell.replace('"', "\"\"")) } else { cell.to_string() }
}

/// Reads points from a CSV file: x and y in the first two columns, or in columns named x and y (easting, northing; lon,
/// lat). Separated by commas, semicolons or tabs, whichever the first line has most of.
pub fn read_points(path: &Path) -> Result<Points> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
    parse(&path.display().to_string(), &text)
}

fn parse(name: &str, text: &str) -> Result<Points> {
    let mut place = [0usize, 1];
    let mut names: Option<Vec<String>> = None;
    let mut xy = Vec::new();
    let mut rows: Vec<Vec<String>> = Vec::new();
    let mut separator = None;
    for (n, line) in text.lines().enumerate() {
        let line = line.trim_start_matches('\u{feff}').trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let first = separator.is_none();
        let by = *separator.get_or_insert_with(|| {
            let count = |c: char| line.matches(c).count();
            // The last of equals: a comma.
            [';', '\t', ','].into_iter().max_by_key(|c| count(*c)).unwrap_or(',')
        });
        let row = cells(line, by);
        let number =
            |k: usize| row.get(place[k]).and_then(|c| c.parse::<f64>().ok()).filter(|v| v.is_finite());
        if let (Some(x), Some(y)) = (number(0), number(1)) {
            xy.push([x, y]);
            rows.push(row);
            continue;
        }
        if !first {
            return Err(Error::invalid(name, format!("line {}: '{line}' has no numbers for x and y", n + 1)));
        }
        let find =
            |names: [&str; 4]| names.iter().find_map(|n| row.iter().position(|c| c.eq_ignore_ascii_case(n)));
        match (find(["x", "easting", "lon", "longitude"]), find(["y", "northing", "lat", "latitude"])) {
            (Some(x), Some(y)) => (place, names) = ([x, y], Some(row)),
            _ => {
                return Err(Error::invalid(
                    name,
                    format!(
                        "line {}: '{line}' is neither two numbers nor a header with columns x and y",
                        n + 1
                    ),
                ));
            }
        }
    }
    let width = rows.iter().chain(&names).map(Vec::len).max().unwrap_or(0);
    if width <= 2 {
        return Ok(Points { xy, table: None });
    }
    rows.iter_mut().for_each(|r| r.resize(width, String::new()));
    let mut names = names.unwrap_or_else(|| {
        (0..width).map(|k| ["x", "y"].get(k).map_or(String::new(), |n| n.to_string())).collect()
    });
    names.resize(width, String::new());
    for (k, name) in names.iter_mut().enumerate().filter(|(_, n)| n.is_empty()) {
        *name = format!("column{}", k + 1);
    }
    Ok(Points { xy, table: Some(Table { names, place, rows }) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_alone() {
        for text in [
            "1,2\n3.5,-4\n",
            "x;y\n1;2\n3.5;-4",
            "# note\n\"y\"\t\"x\"\n2\t1\n\n-4\t3.5",
            "\u{feff}1 , 2\n3.5,-4,",
        ] {
            let p = parse("f", text).unwrap();
            assert_eq!(p.xy, [[1.0, 2.0], [3.5, -4.0]], "{text}");
        }
    }

    #[test]
    fn further_columns_come_along() {
        let t = parse("f", "id,X,note,Y\na,1,\"one, \"\"two\"\"\",2\nb,3,,4\n").unwrap();
        assert_eq!(t.xy, [[1.0, 2.0], [3.0, 4.0]]);
        let table = t.table.unwrap();
        assert_eq!((table.names.join("|"), table.place), ("id|X|note|Y".to_string(), [1, 3]));
        assert_eq!(table.rows[0][2], "one, \"two\"");
        assert_eq!(quoted(&table.rows[0][2]), "\"one, \"\"two\"\"\"");
        let t = parse("f", "1;2;a,b\n3;4\n").unwrap().table.unwrap();
        assert_eq!(
            (t.names.join("|"), t.rows[0][2].as_str(), t.rows[1][2].as_str()),
            ("x|y|column3".into(), "a,b", "")
        );
        assert!(parse("f", "a,b\n1,2").is_err());
        assert!(parse("f", "1,2\n1,zwei").unwrap_err().to_string().contains("line 2"));
    }
}
