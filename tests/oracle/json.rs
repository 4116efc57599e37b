//! Reads the lines of `boxes` without losing a bit: numbers stay text until their type is known.

use super::PatchBox;

enum Json<'a> {
    /// A number, true, false or null, as written.
    Word(&'a str),
    Text(String),
    List(Vec<Json<'a>>),
    Map(Vec<(String, Json<'a>)>),
}

/// The patches of `terraquilt boxes --json`, one object a line. Unknown fields are passed over.
///
/// # Errors
/// Says which line could not be read, and why.
pub fn parse_boxes(text: &str) -> Result<Vec<PatchBox>, String> {
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines.map(|(k, line)| parse_box(line).map_err(|why| format!("line {}: {why}", k + 1))).collect()
}

fn parse_box(line: &str) -> Result<PatchBox, String> {
    let mut rest = line;
    let json = value(&mut rest)?;
    if !rest.trim().is_empty() {
        return Err(format!("more after the object: {rest}"));
    }
    let top = match json.get("top")? {
        Json::Word("null") => f32::INFINITY,
        other => other.number()?,
    };
    let kernel = json.get("kernel")?.list()?.iter().map(points).collect::<Result<_, _>>()?;
    let domain = points(json.get("domain")?)?;
    Ok(PatchBox {
        id: json.get("id")?.text()?,
        key: json.get("key")?.text()?,
        survey: json.get("survey")?.text()?,
        level: json.get("level")?.number()?,
        index: pair(json.get("index")?)?,
        kernel,
        domain: domain.try_into().map_err(|_| "the domain is no quad")?,
        area: json.get("area")?.number()?,
        err: json.get("err")?.number()?,
        top,
        live: match json.get("state")?.text()?.as_str() {
            "live" => true,
            "dormant" => false,
            other => return Err(format!("state {other}")),
        },
        floor: match json.get("floor")? {
            Json::Word("true") => true,
            Json::Word("false") => false,
            _ => return Err("floor is neither true nor false".into()),
        },
    })
}

fn pair(json: &Json) -> Result<[i64; 2], String> {
    match json.list()? {
        [x, y] => Ok([x.number()?, y.number()?]),
        _ => Err("not a pair".into()),
    }
}

fn points(json: &Json) -> Result<Vec<[i64; 2]>, String> {
    json.list()?.iter().map(pair).collect()
}

impl Json<'_> {
    fn get(&self, name: &str) -> Result<&Json<'_>, String> {
        let Json::Map(fields) = self else {
            return Err("not an object".into());
        };
        let mut named = fields.iter().filter(|(key, _)| key == name);
        match (named.next(), named.next()) {
            (Some((_, value)), None) => Ok(value),
            (None, _) => Err(format!("no field {name}")),
            _ => Err(format!("field {name} twice")),
        }
    }

    fn list(&self) -> Result<&[Json<'_>], String> {
        if let Json::List(items) = self { Ok(items) } else { Err("not a list".into()) }
    }

    fn text(&self) -> Result<String, String> {
        if let Json::Text(text) = self { Ok(text.clone()) } else { Err("not a text".into()) }
    }

    fn number<T: std::str::FromStr>(&self) -> Result<T, String> {
        let Json::Word(word) = self else {
            return Err("not a number".into());
        };
        let first = word.bytes().next().is_some_and(|b| b == b'-' || b.is_ascii_digit());
        word.parse().ok().filter(|_| first).ok_or_else(|| format!("not such a number: {word}"))
    }
}

fn value<'a>(rest: &mut &'a str) -> Result<Json<'a>, String> {
    *rest = rest.trim_start();
    let open = rest.chars().next().ok_or("the line ends early")?;
    match open {
        '"' => text(rest).map(Json::Text),
        '[' | '{' => {
            let close = if open == '[' { ']' } else { '}' };
            let (mut items, mut fields) = (Vec::new(), Vec::new());
            *rest = &rest[1..];
            if !take(rest, close) {
                loop {
                    if open == '[' {
                        items.push(value(rest)?);
                    } else {
                        *rest = rest.trim_start();
                        let name = text(rest)?;
                        if !take(rest, ':') {
                            return Err(format!("no colon after {name}"));
                        }
                        fields.push((name, value(rest)?));
                    }
                    if take(rest, close) {
                        break;
                    }
                    if !take(rest, ',') {
                        return Err("no comma".into());
                    }
                }
            }
            Ok(if open == '[' { Json::List(items) } else { Json::Map(fields) })
        }
        _ => {
            let end = rest.find([',', ']', '}', ' ']).unwrap_or(rest.len());
            let (word, after) = rest.split_at(end);
            *rest = after;
            Ok(Json::Word(word))
        }
    }
}

fn take(rest: &mut &str, wanted: char) -> bool {
    *rest = rest.trim_start();
    let there = rest.strip_prefix(wanted);
    *rest = there.unwrap_or(rest);
    there.is_some()
}

/// A quoted text; escapes other than `\"`, `\\` and `\/` are kept as they are written.
fn text(rest: &mut &str) -> Result<String, String> {
    let mut out = String::new();
    let mut chars = rest.strip_prefix('"').ok_or("no text where one belongs")?.chars();
    while let Some(c) = chars.next() {
        match c {
            '"' => {
                *rest = chars.as_str();
                return Ok(out);
            }
            '\\' => match chars.next() {
                Some(c @ ('"' | '\\' | '/')) => out.push(c),
                Some(c) => out.extend(['\\', c]),
                None => break,
            },
            c => out.push(c),
        }
    }
    Err("a text without end".into())
}
