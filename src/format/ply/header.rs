//! The header: a text of lines up to `end_header`.

use crate::base::{Error, Result};

/// Bytes of a header, at most.
const HEADER_BYTES_MAX: usize = 1 << 20;
/// Elements of a file, and properties of an element, at most.
const NAMES_MAX: usize = 256;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Encoding {
    Text,
    LittleEndian,
    BigEndian,
}

/// A type of numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn named(name: &str) -> Option<Kind> {
        Some(match name {
            "char" | "int8" => Kind::I8,
            "uchar" | "uint8" => Kind::U8,
            "short" | "int16" => Kind::I16,
            "ushort" | "uint16" => Kind::U16,
            "int" | "int32" => Kind::I32,
            "uint" | "uint32" => Kind::U32,
            "float" | "float32" => Kind::F32,
            "double" | "float64" => Kind::F64,
            _ => return None,
        })
    }

    pub fn bytes(self) -> usize {
        match self {
            Kind::I8 | Kind::U8 => 1,
            Kind::I16 | Kind::U16 => 2,
            Kind::I32 | Kind::U32 | Kind::F32 => 4,
            Kind::F64 => 8,
        }
    }
}

/// One number of a row, or a list of them.
pub struct Property {
    pub name: String,
    pub kind: Kind,
    /// Of a list: the type of its length.
    pub count: Option<Kind>,
}

/// Rows of one kind.
pub struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

impl Element {
    /// The fewest bytes that a row takes in binary.
    pub fn least_bytes(&self) -> u64 {
        self.properties.iter().map(|p| p.count.unwrap_or(p.kind).bytes() as u64).sum()
    }
}

pub struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Where the rows begin.
    pub bytes: usize,
}

impl Header {
    pub fn read(file: &str, bytes: &[u8]) -> Result<Header> {
        let bad = |line: usize, reason: String| Error::corrupt(file, format!("header, line {line}"), reason);
        let mut lines = Lines { bytes: &bytes[..bytes.len().min(HEADER_BYTES_MAX)], at: 0 };
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        for number in 1.. {
            let Some(line) = lines.next() else {
                return Err(bad(number, "the file ends before end_header".into()));
            };
            // Names and comments may be in any encoding; words that are read here are ASCII.
            let line = String::from_utf8_lossy(line);
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words[..] {
                ["ply"] if number == 1 => {}
                _ if number == 1 => return Err(bad(1, "it is not the word ply".into())),
                [] | ["comment", ..] | ["obj_info", ..] => {}
                ["format", name, version] => {
                    encoding = match (name, version) {
                        ("ascii", "1.0") => Some(Encoding::Text),
                        ("binary_little_endian", "1.0") => Some(Encoding::LittleEndian),
                        ("binary_big_endian", "1.0") => Some(Encoding::BigEndian),
                        _ => {
                            let what = format!("PLY of format {name} {version}");
                            return Err(Error::unsupported(file, what, "write it as ascii or binary 1.0"));
                        }
                    };
                }
                ["element", name, count] => {
                    let count =
                        count.parse().map_err(|_| bad(number, format!("'{count}' is no number of rows")))?;
                    if elements.iter().any(|e| e.name == name) {
                        return Err(bad(number, format!("element {name} is there twice")));
                    }
                    elements.push(Element { name: name.to_string(), count, properties: Vec::new() });
                }
                ["property", ref rest @ ..] => {
                    let property = property(rest).map_err(|reason| bad(number, reason))?;
                    let element =
                        elements.last_mut().ok_or_else(|| bad(number, "a property of no element".into()))?;
                    if element.properties.iter().any(|p| p.name == property.name) {
                        return Err(bad(number, format!("property {} is there twice", property.name)));
                    }
                    element.properties.push(property);
                }
                ["end_header"] => {
                    let encoding = encoding.ok_or_else(|| bad(number, "there was no line format".into()))?;
                    return Ok(Header { encoding, elements, bytes: lines.at });
                }
                _ => {
                    return Err(bad(
                        number,
                        format!("'{}' is not known", super::super::geotiff::shorten(&line)),
                    ));
                }
            }
            let most = elements.iter().map(|e| e.properties.len()).chain([elements.len()]).max().unwrap_or(0);
            if most > NAMES_MAX {
                return Err(Error::limit("elements or properties of a PLY", NAMES_MAX as u64, most as u64));
            }
        }
        Err(bad(0, "it never ends".into()))
    }

    pub fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|e| e.name == name)
    }
}

/// What follows the word `property`.
fn property(words: &[&str]) -> std::result::Result<Property, String> {
    let kind = |word: &str| Kind::named(word).ok_or_else(|| format!("'{word}' is no type of numbers"));
    match words {
        ["list", count, of, name] => {
            let count = kind(count)?;
            if matches!(count, Kind::F32 | Kind::F64) {
                return Err(format!("the length of list {name} is no whole number"));
            }
            Ok(Property { name: name.to_string(), kind: kind(of)?, count: Some(count) })
        }
        [of, name] => Ok(Property { name: name.to_string(), kind: kind(of)?, count: None }),
        _ => Err("a property is a type and a name, or list, two types and a name".into()),
    }
}

/// Lines of a text that end with LF, CR LF or CR.
pub struct Lines<'a> {
    pub bytes: &'a [u8],
    pub at: usize,
}

impl<'a> Iterator for Lines<'a> {
    type Item = &'a [u8];

    /// The next line; nothing if no end of one follows, except at the end of a text.
    fn next(&mut self) -> Option<&'a [u8]> {
        let rest = self.bytes.get(self.at..).filter(|r| !r.is_empty())?;
        let length = rest.iter().position(|b| matches!(b, b'\n' | b'\r')).unwrap_or(rest.len());
        let end = &rest[length..];
        self.at += length + if end.starts_with(b"\r\n") { 2 } else { end.len().min(1) };
        Some(&rest[..length])
    }
}
