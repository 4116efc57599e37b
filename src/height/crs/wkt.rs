//! WKT as a tree: what the text's own codes are, and the text in the words that proj-wkt knows.

use crate::base::{Error, Result};

/// `KEYWORD["text", 1.0, CHILD[...]]`.
#[derive(Debug, PartialEq)]
pub(super) struct Node {
    /// Upper case.
    pub keyword: String,
    pub values: Vec<Value>,
}

#[derive(Debug, PartialEq)]
pub(super) enum Value {
    /// Quoted text, or a number or word as it stands.
    Text(String),
    Word(String),
    Node(Node),
}

/// Deepest nesting accepted; real texts need fewer than ten.
const DEPTH_MAX: usize = 24;
/// Longest text accepted.
const BYTES_MAX: usize = 1 << 16;

impl Node {
    /// # Errors
    /// If the text is no WKT, or longer or deeper than any real one.
    pub fn parse(text: &str) -> Result<Node> {
        if text.len() > BYTES_MAX {
            return Err(Error::limit("bytes of a WKT text", BYTES_MAX as u64, text.len() as u64));
        }
        let mut rest = text.trim();
        let node = node(&mut rest, 0)?;
        match rest.trim_matches(|c: char| c.is_whitespace() || c == '\0') {
            "" => Ok(node),
            more => Err(bad(format!("text after the end: '{}'", start(more)))),
        }
    }

    pub fn children(&self) -> impl Iterator<Item = &Node> {
        self.values.iter().filter_map(|v| match v {
            Value::Node(n) => Some(n),
            _ => None,
        })
    }

    pub fn child(&self, keywords: &[&str]) -> Option<&Node> {
        self.children().find(|n| keywords.contains(&n.keyword.as_str()))
    }

    /// Text or word number `i`.
    pub fn text(&self, i: usize) -> Option<&str> {
        match self.values.get(i)? {
            Value::Text(t) | Value::Word(t) => Some(t),
            Value::Node(_) => None,
        }
    }

    /// Authority (upper case) and code that the node states for itself.
    pub fn code(&self) -> Option<(String, u32)> {
        let id = self.child(&["AUTHORITY", "ID"])?;
        Some((id.text(0)?.to_uppercase(), id.text(1)?.trim().parse().ok()?))
    }

    /// Named parameter (`PARAMETER["name",value]`) with this name, whatever its case.
    fn parameter(&mut self, name: &str) -> Option<&mut Node> {
        self.values.iter_mut().find_map(|v| match v {
            Value::Node(n)
                if n.keyword == "PARAMETER" && n.text(0).is_some_and(|t| t.eq_ignore_ascii_case(name)) =>
            {
                Some(n)
            }
            _ => None,
        })
    }

    fn write(&self, out: &mut String) {
        out.push_str(&self.keyword);
        out.push('[');
        for (i, value) in self.values.iter().enumerate() {
            if i > 0 {
                out.push(',');
            }
            match value {
                Value::Text(t) => out.extend(["\"", &t.replace('"', "\"\""), "\""]),
                Value::Word(w) => out.push_str(w),
                Value::Node(n) => n.write(out),
            }
        }
        out.push(']');
    }
}

impl std::fmt::Display for Node {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut out = String::new();
        self.write(&mut out);
        f.write_str(&out)
    }
}

fn bad(reason: String) -> Error {
    Error::invalid("WKT", reason)
}

fn start(text: &str) -> String {
    text.chars().take(20).collect()
}

fn node(rest: &mut &str, depth: usize) -> Result<Node> {
    if depth > DEPTH_MAX {
        return Err(Error::limit("nesting of a WKT text", DEPTH_MAX as u64, depth as u64));
    }
    let open = rest.find(['[', '(']).ok_or_else(|| bad(format!("no bracket after '{}'", start(rest))))?;
    let keyword = rest[..open].trim();
    if keyword.is_empty() || !keyword.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
        return Err(bad(format!("'{}' is no keyword", start(keyword))));
    }
    *rest = &rest[open + 1..];
    let mut values = Vec::new();
    loop {
        *rest = rest.trim_start();
        values.push(value(rest, depth)?);
        *rest = rest.trim_start();
        let mut chars = rest.chars();
        let next = chars.next();
        *rest = chars.as_str();
        match next {
            Some(',') => {}
            Some(']' | ')') => return Ok(Node { keyword: keyword.to_uppercase(), values }),
            _ => return Err(bad(format!("{keyword} is not closed"))),
        }
    }
}

fn value(rest: &mut &str, depth: usize) -> Result<Value> {
    if let Some(mut quoted) = rest.strip_prefix('"') {
        let mut text = String::new();
        loop {
            let end = quoted.find('"').ok_or_else(|| bad("a quoted text is not closed".to_string()))?;
            text.push_str(&quoted[..end]);
            quoted = &quoted[end + 1..];
            match quoted.strip_prefix('"') {
                // Two quotes are one within the text.
                Some(more) => {
                    text.push('"');
                    quoted = more;
                }
                None => break,
            }
        }
        *rest = quoted;
        return Ok(Value::Text(text));
    }
    let end = rest.find([',', '[', '(', ']', ')']).unwrap_or(rest.len());
    if rest[end..].starts_with(['[', '(']) {
        return node(rest, depth + 1).map(Value::Node);
    }
    let word = rest[..end].trim().to_string();
    *rest = &rest[end..];
    Ok(Value::Word(word))
}

/// Keywords of horizontal systems.
const HORIZONTAL: [&str; 12] = [
    "PROJCS",
    "PROJCRS",
    "PROJECTEDCRS",
    "GEOGCS",
    "GEOGCRS",
    "GEOGRAPHICCRS",
    "GEODCRS",
    "GEODETICCRS",
    "GEOCCS",
    "BOUNDCRS",
    "BASEGEOGCRS",
    "BASEGEODCRS",
];

/// The horizontal system of a tree: its root, or the part of a compound system.
pub(super) fn horizontal(root: &Node) -> Option<&Node> {
    match root.keyword.as_str() {
        "COMPD_CS" | "COMPOUNDCRS" => root.children().find_map(horizontal),
        k => HORIZONTAL.contains(&k).then_some(root),
    }
}

/// Keywords of vertical systems.
const VERTICAL: [&str; 4] = ["VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS"];

/// The vertical system of a tree: a part of a compound system, or, as ESRI writes it, of a horizontal one.
pub(super) fn vertical(root: &Node) -> Option<&Node> {
    match VERTICAL.contains(&root.keyword.as_str()) {
        true => Some(root),
        false => root.children().find_map(|n| match n.keyword.as_str() {
            "COMPD_CS" | "COMPOUNDCRS" | "PROJCS" | "GEOGCS" | "SOURCECRS" => vertical(n),
            k => VERTICAL.contains(&k).then_some(n),
        }),
    }
}

/// Puts a projection's name and parameters in the words that proj-wkt knows, and drops a vertical part.
///
/// # Errors
/// For names that proj-wkt would read as something else: general (neither polar nor double) stereographic,
/// and Krovak with axes to south and west.
pub(super) fn in_known_words(node: &mut Node) -> Result<()> {
    node.values.retain(|v| !matches!(v, Value::Node(n) if VERTICAL.contains(&n.keyword.as_str())));
    let Some(name) = projection_name(node) else { return Ok(()) };
    let lower = name.to_ascii_lowercase();
    let known = match lower.as_str() {
        "albers" | "albers_conic_equal_area" => "Albers_Equal_Area",
        "lambert_conic_conformal_(1sp)" | "lambert conic conformal (1sp)" => "Lambert_Conformal_Conic_1SP",
        "lambert_conic_conformal_(2sp)" | "lambert conic conformal (2sp)" => "Lambert_Conformal_Conic_2SP",
        "gauss_kruger" => "Transverse_Mercator",
        "hotine_oblique_mercator_azimuth_center"
        | "rectified_skew_orthomorphic_center"
        | "oblique_mercator" => "Hotine_Oblique_Mercator_Variant_B",
        "hotine_oblique_mercator"
        | "hotine_oblique_mercator_azimuth_natural_origin"
        | "rectified_skew_orthomorphic_natural_origin" => "Hotine_Oblique_Mercator_Variant_A",
        "stereographic_north_pole" | "stereographic_south_pole" => {
            // ESRI states the latitude of true scale here.
            if let Some(parallel) = node.parameter("standard_parallel_1") {
                parallel.values[0] = Value::Text("latitude_of_origin".to_string());
            }
            "Polar_Stereographic"
        }
        "stereographic" => {
            return Err(Error::unsupported(
                "the text of the CRS",
                format!("projection '{name}'"),
                "only polar and double (oblique) stereographic systems are computed",
            ));
        }
        "krovak" => {
            return Err(Error::unsupported(
                "the text of the CRS",
                "Krovak in an unclear axis order",
                "name the system by its code (EPSG:5514 counts east and north)",
            ));
        }
        _ => return Ok(()),
    };
    if let Some(Value::Node(method)) = node.values.iter_mut().find(is_projection) {
        method.values[0] = Value::Text(known.to_string());
    }
    Ok(())
}

fn is_projection(value: &&mut Value) -> bool {
    matches!(value, Value::Node(n) if n.keyword == "PROJECTION" && !n.values.is_empty())
}

/// Name in `PROJECTION[...]` of WKT1; WKT2 names its methods as EPSG does, which proj-wkt knows.
fn projection_name(node: &Node) -> Option<String> {
    node.child(&["PROJECTION"])?.text(0).map(str::to_string)
}
