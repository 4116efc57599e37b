//! What GDAL leaves in two text tags: the nodata value, and scale, offset and unit of the heights.

/// Scale, offset and unit of band 1.
#[derive(Debug, PartialEq)]
pub struct BandMetadata {
    pub scale: f64,
    pub offset: f64,
    pub unit: Option<String>,
}

/// Reads the text of tag 42113. None if it is not a number.
pub fn parse_nodata(text: &str) -> Option<f64> {
    let word = text.trim_matches(['\0', ' ', '\n', '\r', '\t']).split_whitespace().next()?;
    let lower = word.to_ascii_lowercase();
    // `1.#QNAN` and `-1.#IND` are how older Windows programs print NaN.
    if lower.trim_start_matches(['-', '+']) == "nan" || lower.contains("#qnan") || lower.contains("#ind") {
        return Some(f64::NAN);
    }
    word.parse().ok()
}

/// Reads the XML of tag 42112: items of band 1 (`sample="0"`) whose role is scale, offset or unittype.
///
/// Items that are not numbers, or a scale of zero, are reported in `notes` and left out.
pub fn parse_band_metadata(xml: &str, notes: &mut Vec<String>) -> BandMetadata {
    let mut band = BandMetadata { scale: 1.0, offset: 0.0, unit: None };
    for item in xml.split("<Item").skip(1) {
        let Some((head, rest)) = item.split_once('>') else {
            continue;
        };
        let Some((text, _)) = rest.split_once("</Item>") else {
            continue;
        };
        if attribute(head, "sample") != Some("0") {
            continue;
        }
        let mut number = |name: &str| match text.trim().parse::<f64>() {
            Ok(v) if v.is_finite() && (v != 0.0 || name != "scale") => Some(v),
            _ => {
                notes.push(format!("the file gives '{}' as {name}; ignored", shorten(text.trim())));
                None
            }
        };
        match attribute(head, "role") {
            Some("scale") => band.scale = number("scale").unwrap_or(band.scale),
            Some("offset") => band.offset = number("offset").unwrap_or(band.offset),
            Some("unittype") => band.unit = Some(shorten(text.trim())).filter(|t| !t.is_empty()),
            _ => {}
        }
    }
    band
}

/// A text from a file, short enough for a message: control characters removed, at most 80 letters.
pub fn shorten(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(80).collect()
}

fn attribute<'a>(head: &'a str, name: &str) -> Option<&'a str> {
    let mut rest = head;
    while let Some((before, after)) = rest.split_once('=') {
        let value = after.trim_start().strip_prefix('"')?;
        let (value, tail) = value.split_once('"')?;
        if before.trim() == name {
            return Some(value);
        }
        rest = tail;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodata_texts_of_many_programs() {
        assert_eq!(parse_nodata("-32768\0"), Some(-32768.0));
        assert_eq!(parse_nodata(" -3.4028229999999999e+038 "), Some(-3.402823e38));
        assert_eq!(parse_nodata("-9999 "), Some(-9999.0));
        for nan in ["nan", "NaN", "-nan", "1.#QNAN", "-1.#IND"] {
            assert!(parse_nodata(nan).is_some_and(f64::is_nan), "{nan}");
        }
        assert_eq!(parse_nodata(""), None);
        assert_eq!(parse_nodata("none"), None);
    }

    #[test]
    fn only_items_of_band_one_count() {
        let xml = r#"<GDALMetadata><Item name="OFFSET" sample="0" role="offset">2500</Item>
            <Item name="SCALE" sample="0" role="scale">0.25</Item>
            <Item name="SCALE" sample="1" role="scale">7</Item>
            <Item name="UNITTYPE" sample="0" role="unittype">ft</Item>
            <Item name="scale">3</Item></GDALMetadata>"#;
        let mut notes = Vec::new();
        let band = parse_band_metadata(xml, &mut notes);
        assert_eq!(band, BandMetadata { scale: 0.25, offset: 2500.0, unit: Some("ft".into()) });
        assert!(notes.is_empty());
        let band = parse_band_metadata(r#"<Item sample="0" role="scale">0</Item>"#, &mut notes);
        assert_eq!((band.scale, notes.len()), (1.0, 1));
    }
}
