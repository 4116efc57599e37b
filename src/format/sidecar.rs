//! Small files beside a grid: `.prj` (CRS), `.aux.xml` (GDAL's notes), world files (place), `.hdr` (layout).
//!
//! They are looked for by the grid's own name with another extension, whatever the case of the letters, in the
//! same folder or in the same archive.

use super::geotiff::shorten;
use super::input::Input;
use crate::base::{Error, Result, limits};
use crate::height::crs::Crs;
use crate::height::source::{Affine, SourceInfo};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where sidecars are looked for.
#[derive(Clone)]
pub enum Beside {
    /// Nowhere.
    Nothing,
    /// In the folder of this file.
    Folder(PathBuf),
    /// Among these members of an archive: name without folders, bytes.
    Archive(Arc<Vec<(String, Vec<u8>)>>),
}

/// A small text file that lies beside a grid.
#[derive(Debug)]
pub struct Sidecar {
    pub file: String,
    pub text: String,
}

impl Beside {
    /// The first of these file names that is there, read as text.
    ///
    /// # Errors
    /// [`Error::Limit`] if it is too large for a sidecar; [`Error::Io`] if it cannot be read.
    pub fn find(&self, names: &[String]) -> Result<Option<Sidecar>> {
        match self {
            Beside::Nothing => Ok(None),
            Beside::Archive(members) => {
                let same = |name: &String| members.iter().find(|m| m.0.eq_ignore_ascii_case(name));
                let found = names.iter().find_map(same);
                Ok(found.map(|(name, bytes)| Sidecar {
                    file: name.clone(),
                    text: String::from_utf8_lossy(bytes).into_owned(),
                }))
            }
            Beside::Folder(grid) => {
                let Some(path) = on_disk(grid, names) else { return Ok(None) };
                let file = std::fs::File::open(&path).map_err(|e| Error::io(&path, e))?;
                let span_bytes = file.metadata().map_err(|e| Error::io(&path, e))?.len();
                if span_bytes > limits::SIDECAR_BYTES_MAX {
                    let what = format!("bytes of {}", path.display());
                    return Err(Error::limit(what, limits::SIDECAR_BYTES_MAX, span_bytes));
                }
                let mut bytes = Vec::new();
                let mut file = file.take(limits::SIDECAR_BYTES_MAX);
                file.read_to_end(&mut bytes).map_err(|e| Error::io(&path, e))?;
                let text = String::from_utf8_lossy(&bytes).into_owned();
                Ok(Some(Sidecar { file: path.display().to_string(), text }))
            }
        }
    }

    /// Files in the folder of a grid on disk whose name satisfies `wanted`, in the order of their names.
    pub fn list(&self, wanted: impl Fn(&str) -> bool) -> Vec<PathBuf> {
        let Beside::Folder(grid) = self else { return Vec::new() };
        let Ok(entries) = std::fs::read_dir(folder_of(grid)) else { return Vec::new() };
        let named = entries.flatten().filter(|e| e.file_name().to_str().is_some_and(&wanted));
        let mut found: Vec<PathBuf> = named.map(|e| e.path()).filter(|p| p.is_file()).collect();
        found.sort();
        found
    }
}

/// The first of these names in the folder of `grid`: as written, else in other letters.
fn on_disk(grid: &Path, names: &[String]) -> Option<PathBuf> {
    for name in names {
        let exact = grid.with_file_name(name);
        if exact.is_file() {
            return Some(exact);
        }
    }
    let entries: Vec<_> = std::fs::read_dir(folder_of(grid)).ok()?.flatten().collect();
    names.iter().find_map(|name| {
        let same =
            entries.iter().filter(|e| e.file_name().to_str().is_some_and(|n| n.eq_ignore_ascii_case(name)));
        same.map(|e| e.path()).filter(|p| p.is_file()).min()
    })
}

fn folder_of(grid: &Path) -> &Path {
    grid.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The names a sidecar of `file` may have: its name with the extension replaced, and with it added.
pub fn names(file: &str, extensions: &[&str]) -> Vec<String> {
    let path = Path::new(file);
    let text = |p: PathBuf| p.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let replaced = extensions.iter().map(|e| text(path.with_extension(e)));
    let added = extensions.iter().map(|e| text(path.with_added_extension(e)));
    replaced.chain(added).collect()
}

/// Completes what a file says of itself by what lies beside it: the CRS by `.prj` or `.aux.xml`, the place by
/// `.aux.xml` or, if `world` names extensions of world files, by one of these.
///
/// A CRS that is not understood becomes a note.
///
/// # Errors
/// [`Error::Corrupt`] if a world file is none.
pub fn complete(info: &mut SourceInfo, input: &Input, world: &[&str]) -> Result<()> {
    let aux = if info.crs.is_none() || info.affine.is_none() {
        input.beside.find(&names(&info.file, &["aux.xml"]))?
    } else {
        None
    };
    if info.crs.is_none() {
        let prj = input.beside.find(&names(&info.file, &["prj"]))?;
        let prj = prj.map(|s| (s.text, s.file));
        let by_aux = || aux.as_ref().and_then(|s| Some((unescape(element(&s.text, "SRS")?), s.file.clone())));
        if let Some((text, file)) = prj.or_else(by_aux) {
            info.crs = understood(text.trim(), &file, &mut info.notes);
        }
    }
    if info.affine.is_none() {
        info.affine = match input.beside.find(&names(&info.file, world))? {
            Some(sidecar) if !world.is_empty() => Some(world_file(&sidecar)?),
            _ => aux.as_ref().and_then(|s| geo_transform(element(&s.text, "GeoTransform")?)),
        };
    }
    Ok(())
}

/// The CRS that `text` of `file` means; None, with a note, if it is not understood.
pub fn understood(text: &str, file: &str, notes: &mut Vec<String>) -> Option<Crs> {
    match Crs::parse(text) {
        Ok(crs) => Some(crs),
        Err(e) => {
            let reason = match e {
                Error::Unsupported { what, .. } => what,
                Error::Invalid { reason, .. } => reason,
                other => other.to_string(),
            };
            notes.push(format!(
                "the CRS in {file} ({}) is not understood: {}",
                shorten(text),
                shorten(&reason)
            ));
            None
        }
    }
}

/// Six numbers, one a line: x by column, y by column, x by row, y by row, x and y of the centre of the first pixel.
fn world_file(sidecar: &Sidecar) -> Result<Affine> {
    let words = sidecar.text.split_whitespace();
    let numbers: Vec<f64> = words.map_while(|w| w.replace(',', ".").parse().ok()).collect();
    let bad = |reason: String| Err(Error::corrupt(&sidecar.file, "world file", reason));
    let [a, d, b, e, x, y] = numbers[..] else {
        return bad(format!("six numbers wanted, {} found", numbers.len()));
    };
    let affine = Affine { origin: [x, y], col_step: [a, d], row_step: [b, e] };
    if !usable(&affine) {
        return bad(format!("steps ({a}, {d}) and ({b}, {e}) from ({x}, {y}) span no area"));
    }
    Ok(affine)
}

/// GDAL's six numbers: x of the corner, x by column, x by row, y of the corner, y by column, y by row.
fn geo_transform(text: &str) -> Option<Affine> {
    let numbers: Vec<f64> = text.split(',').map_while(|w| w.trim().parse().ok()).collect();
    let [x, a, b, y, d, e] = numbers[..] else { return None };
    let origin = [x + 0.5 * (a + b), y + 0.5 * (d + e)];
    Some(Affine { origin, col_step: [a, d], row_step: [b, e] }).filter(usable)
}

/// Whether positions are numbers and steps span an area.
pub fn usable(a: &Affine) -> bool {
    let determinant = a.col_step[0] * a.row_step[1] - a.col_step[1] * a.row_step[0];
    a.origin.iter().all(|v| v.is_finite()) && determinant.is_finite() && determinant != 0.0
}

/// The text of the first element of this name.
fn element<'a>(xml: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = xml.split_once(&format!("<{name}"))?;
    let (_, rest) = rest.split_once('>')?;
    Some(rest.split_once(&format!("</{name}>"))?.0.trim())
}

fn unescape(text: &str) -> String {
    let plain = text.replace("&quot;", "\"").replace("&apos;", "'").replace("&lt;", "<").replace("&gt;", ">");
    plain.replace("&amp;", "&")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sidecar(text: &str) -> Sidecar {
        Sidecar { file: "a.pgw".into(), text: text.into() }
    }

    #[test]
    fn names_of_sidecars_replace_or_follow_the_extension() {
        assert_eq!(names("dir/a.bil", &["hdr"]), ["a.hdr", "a.bil.hdr"]);
        assert_eq!(names("dir/a", &["hdr"]), ["a.hdr", "a.hdr"]);
    }

    #[test]
    fn a_world_file_gives_the_centre_of_the_first_pixel() {
        let a = world_file(&sidecar("2.0\r\n0\r\n0\r\n-3,5\r\n100.5\r\n200\r\n")).unwrap();
        let expected = Affine { origin: [100.5, 200.0], col_step: [2.0, 0.0], row_step: [0.0, -3.5] };
        assert_eq!(a, expected);
        for bad in ["", "1 2 3", "2 0 0 0 1 1", "2 0 0 nan 1 1", "1 0 0 -1 5 5 5"] {
            assert!(world_file(&sidecar(bad)).unwrap_err().to_string().contains("a.pgw"), "{bad}");
        }
    }

    #[test]
    fn gdals_notes_give_crs_and_corner() {
        let xml = "<PAMDataset>\n<SRS dataAxisToSRSAxisMapping=\"2,1\">A[&quot;x&quot;]</SRS>\n\
                   <GeoTransform> 1.0e+01, 2, 0, 20, 0, -2</GeoTransform></PAMDataset>";
        assert_eq!(unescape(element(xml, "SRS").unwrap()), "A[\"x\"]");
        assert_eq!(geo_transform(element(xml, "GeoTransform").unwrap()).unwrap().origin, [11.0, 19.0]);
        assert_eq!(element("<SRS>", "SRS"), None);
    }

    #[test]
    fn letters_do_not_matter_in_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("GRID.PRJ"), "EPSG:32610").unwrap();
        let beside = Beside::Folder(folder.path().join("grid.asc"));
        let found = beside.find(&names("grid.asc", &["prj"])).unwrap().unwrap();
        assert_eq!(found.text, "EPSG:32610");
        assert!(beside.find(&names("grid.asc", &["hdr"])).unwrap().is_none());
        assert_eq!(beside.list(|n| n.starts_with("GRID")).len(), 1);
    }
}
