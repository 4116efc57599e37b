//! Who may use whom: every `crate::` path of `src/` against the table "room | may use" of docs/architecture.md.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Room -> what it may use: a room, or one module of a room (`height::lod`).
fn table() -> BTreeMap<String, BTreeSet<String>> {
    let text =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/architecture.md")).unwrap();
    let rows = text.lines().skip_while(|l| !l.starts_with("| room | may use |")).skip(2);
    rows.take_while(|l| l.starts_with('|'))
        .map(|l| {
            let cells: Vec<&str> = l.split('|').map(str::trim).collect();
            let may = cells[2].split(',').map(str::trim).filter(|w| *w != "--" && !w.is_empty());
            (cells[1].to_string(), may.map(str::to_string).collect())
        })
        .collect()
}

fn files(folder: &Path, out: &mut Vec<PathBuf>) {
    for e in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        if e.is_dir() {
            files(&e, out);
        } else if e.extension().is_some_and(|x| x == "rs") {
            out.push(e);
        }
    }
}

/// The first two words of each path that begins with `crate::`, braces opened: `height::lod`, or `base` alone.
fn paths(text: &str) -> Vec<String> {
    let code: String =
        text.lines().filter(|l| !l.trim_start().starts_with("//")).flat_map(|l| [l, "\n"]).collect();
    let word = |s: &str| s.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let mut out = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        if code[..at].ends_with('$') {
            continue;
        }
        let rest = &code[at + "crate::".len()..];
        let rooms = if rest.starts_with('{') { branches(rest) } else { vec![rest] };
        for path in rooms {
            let room = word(path);
            let below = path[room.len()..].strip_prefix("::");
            match below {
                None => out.push(room),
                Some(b) if b.starts_with('{') => {
                    out.extend(branches(b).into_iter().map(|x| format!("{room}::{}", word(x))));
                }
                Some(b) => out.push(format!("{room}::{}", word(b))),
            }
        }
    }
    out
}

/// The parts of `{a, b::{c, d}, e}`, as they begin.
fn branches(text: &str) -> Vec<&str> {
    let (mut depth, mut from, mut out) = (0, 1, Vec::new());
    for (k, c) in text.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        if depth == 0 || (depth == 1 && c == ',') {
            out.push(text[from..k].trim_start());
            from = k + 1;
        }
        if depth == 0 {
            break;
        }
    }
    out.retain(|p| !p.is_empty());
    out
}

#[test]
fn every_edge_is_in_the_table() {
    let table = table();
    assert!(table.len() >= 7, "the table of docs/architecture.md was not found: {table:?}");
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut all = Vec::new();
    files(&src, &mut all);
    let (mut wrong, mut edges) = (BTreeSet::new(), 0);
    for file in all {
        let place = file.strip_prefix(&src).unwrap();
        // lib.rs and main.rs are the plan of the house, not a room.
        if place.components().count() < 2 {
            continue;
        }
        let room = place.iter().next().unwrap().to_str().unwrap();
        let Some(may) = table.get(room) else {
            wrong.insert(format!("room '{room}' is not in the table"));
            continue;
        };
        for path in paths(&std::fs::read_to_string(&file).unwrap()) {
            let to = path.split("::").next().unwrap();
            edges += 1;
            if to != room && !may.contains(to) && !may.contains(&path) {
                wrong.insert(format!("{}: uses {path}, the table allows {may:?}", place.display()));
            }
        }
    }
    assert!(edges > 100, "only {edges} paths were found: the test reads wrongly");
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn the_table_has_no_circle() {
    let table = table();
    let room = |w: &String| w.split("::").next().unwrap().to_string();
    let mut left: BTreeMap<String, BTreeSet<String>> =
        table.iter().map(|(r, may)| (r.clone(), may.iter().map(room).collect())).collect();
    while !left.is_empty() {
        let ground: Vec<String> = left
            .iter()
            .filter(|(_, m)| m.iter().all(|x| !left.contains_key(x)))
            .map(|(r, _)| r.clone())
            .collect();
        assert!(!ground.is_empty(), "these use each other in a circle: {left:?}");
        ground.iter().for_each(|r| {
            left.remove(r);
        });
    }
}

#[test]
fn paths_are_read_from_code_and_not_from_comments() {
    let text = "use crate::base::{Error, Result};\n/// [`crate::cli`]\nuse crate::{db::Db, store::{disk, lock}};\n\
                fn f() { crate::mesh::check() }\n        $crate::no::no\n";
    assert_eq!(
        paths(text),
        ["base::Error", "base::Result", "db::Db", "store::disk", "store::lock", "mesh::check"]
    );
}
