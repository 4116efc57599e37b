//! One survey file in a zip archive, with its sidecars.
//!
//! The member is unpacked into memory when it is read, and let go with its last row: an ingest of many archives
//! holds one at a time. What it unpacks to is limited (`base::limits`) whatever the archive says. This file is the only door
//! to `zip`.

use super::input::{Input, InputReader};
use super::kind::{self, SIDECARS};
use super::sidecar::Beside;
use crate::base::{Error, Result, limits};
use crate::height::source::{HeightSource, Samples, SourceInfo, Window};
use std::io::{BufReader, Read};
use std::path::Path;
use std::sync::Arc;
use zip::ZipArchive;
use zip::result::ZipError;

const UNZIP: &str = "unzip it and name the files inside it";

/// A survey file that comes in an archive.
pub struct Zipped {
    archive: Arc<Input>,
    /// What the unpacked file says of itself.
    info: SourceInfo,
    row_batch: usize,
    nodata: Option<f64>,
    /// The unpacked file, while it is read.
    unpacked: Option<Box<dyn HeightSource>>,
}

impl Zipped {
    /// Opens the one grid in an archive; it is unpacked once to see what it is.
    ///
    /// # Errors
    /// [`Error::Unsupported`] if the archive holds no grid or several; [`Error::Limit`] if it unpacks to more than is
    /// held in memory; [`Error::Corrupt`] if it is damaged; else those of the format inside.
    pub fn open(input: Input) -> Result<Zipped> {
        let archive = Arc::new(input);
        let unpacked = unpack(&archive)?;
        let (info, row_batch) = (unpacked.info().clone(), unpacked.row_batch());
        Ok(Zipped { archive, info, row_batch, nodata: None, unpacked: None })
    }
}

impl HeightSource for Zipped {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn set_nodata(&mut self, value: f64) {
        self.nodata = Some(value);
        self.info.nodata = Some(value);
        if let Some(source) = &mut self.unpacked {
            source.set_nodata(value);
        }
    }

    fn read(&mut self, w: Window) -> Result<Samples> {
        let mut source = match self.unpacked.take() {
            Some(source) => source,
            None => {
                let mut source = unpack(&self.archive)?;
                if let Some(value) = self.nodata {
                    source.set_nodata(value);
                }
                source
            }
        };
        let samples = source.read(w)?;
        let last = w.row + w.rows as u64 == self.info.rows && w.col + w.cols as u64 == self.info.cols;
        self.unpacked = Some(source).filter(|_| !last);
        Ok(samples)
    }

    fn row_batch(&self) -> usize {
        self.row_batch
    }
}

/// Unpacks the one grid of an archive and opens it.
fn unpack(archive: &Arc<Input>) -> Result<Box<dyn HeightSource>> {
    let file = &archive.file;
    let mut zip =
        ZipArchive::new(BufReader::new(archive.reader(0))).map_err(|e| zip_error(file, "directory", e))?;
    if zip.len() as u64 > limits::ARCHIVE_MEMBERS_MAX {
        return Err(Error::limit(
            format!("members of {file}"),
            limits::ARCHIVE_MEMBERS_MAX,
            zip.len() as u64,
        ));
    }
    let (grid, name) = grid_of(file, &zip)?;
    let stem = Path::new(&name).file_stem().unwrap_or_default().to_ascii_lowercase();
    let mut beside = Vec::new();
    for k in 0..zip.len() {
        let member = base_name(&zip, k);
        let belongs = Path::new(&member).file_stem().is_some_and(|s| {
            let s = s.to_ascii_lowercase();
            // `a.hdr` and `a.bil.hdr` belong to `a.bil`.
            s == stem || Path::new(&s).file_stem() == Some(&stem)
        });
        if belongs && is_sidecar(&member) {
            let bytes = member_bytes(file, &mut zip, k, limits::SIDECAR_BYTES_MAX)?;
            beside.push((member, bytes));
        }
    }
    let bytes = member_bytes(file, &mut zip, grid, limits::ARCHIVE_MEMBER_BYTES_MAX)?;
    let input = Input::memory(&format!("{file}/{name}"), bytes, Beside::Archive(Arc::new(beside)));
    kind::open_plain(input)
}

/// Index and name of the one grid: by its extension, else the one member that is no sidecar.
fn grid_of<R>(file: &str, zip: &ZipArchive<R>) -> Result<(usize, String)>
where
    R: Read + std::io::Seek,
{
    let hidden = |k: &usize| {
        let path = zip.name_for_index(*k).and_then(|n| n.ok()).unwrap_or_default();
        path.ends_with('/') || path.starts_with("__MACOSX") || base_name(zip, *k).starts_with('.')
    };
    let members: Vec<usize> = (0..zip.len()).filter(|k| !hidden(k)).collect();
    let by_extension = |k: &&usize| kind::is_grid_name(&base_name(zip, **k));
    let mut grids: Vec<usize> = members.iter().filter(by_extension).copied().collect();
    if grids.is_empty() {
        grids = members.into_iter().filter(|k| !is_sidecar(&base_name(zip, *k))).collect();
    }
    match grids[..] {
        [one] => Ok((one, base_name(zip, one))),
        [] => Err(Error::unsupported(file, "a zip archive without a survey file", UNZIP)),
        [first, second, ..] => {
            let names = [base_name(zip, first), base_name(zip, second)].map(|n| super::geotiff::shorten(&n));
            let what = format!("a zip archive of {} files ({}, {}, ...)", grids.len(), names[0], names[1]);
            Err(Error::unsupported(file, what, UNZIP))
        }
    }
}

/// The name of a member without its folders.
fn base_name<R>(zip: &ZipArchive<R>, index: usize) -> String
where
    R: Read + std::io::Seek,
{
    let path = zip.name_for_index(index).and_then(|n| n.ok()).unwrap_or_default();
    let name = path.rsplit(['/', '\\']).next().unwrap_or_default();
    name.chars().filter(|c| !c.is_control()).collect()
}

fn is_sidecar(name: &str) -> bool {
    let extension = Path::new(name).extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    SIDECARS.contains(&extension.as_str())
}

/// Unpacks a member, `most` bytes at most whatever its header says.
fn member_bytes(
    file: &str,
    zip: &mut ZipArchive<BufReader<InputReader>>,
    index: usize,
    most: u64,
) -> Result<Vec<u8>> {
    let name = base_name(zip, index);
    let what = || format!("bytes of {name} in {file}, unpacked");
    let member = zip.by_index(index).map_err(|e| zip_error(file, &name, e))?;
    let wanted = member.size();
    if wanted > most {
        return Err(Error::limit(what(), most, wanted));
    }
    let mut bytes = Vec::new();
    member.take(most + 1).read_to_end(&mut bytes).map_err(|e| Error::corrupt(file, &name, e))?;
    if bytes.len() as u64 > most {
        return Err(Error::limit(what(), most, bytes.len() as u64));
    }
    Ok(bytes)
}

fn zip_error(file: &str, place: &str, e: ZipError) -> Error {
    match e {
        ZipError::UnsupportedArchive(what) => {
            Error::unsupported(file, format!("a zip archive: {what}"), UNZIP)
        }
        other => Error::corrupt(file, format!("zip {place}"), other),
    }
}
