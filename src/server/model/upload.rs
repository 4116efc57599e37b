//! What is said of samples before they come.

use crate::base::date::Date;
use crate::base::{Error, Result, limits};
use crate::db::{Change, Ingest};
use crate::height::crs::vertical::VerticalDatum;
use crate::height::crs::{Crs, DatumChoice};
use crate::height::source::{Affine, HeightSource, SampleType, SourceInfo};
use crate::wire::v1;
use std::collections::HashSet;

/// A grid of an upload, and where its rows lie in the staging file.
#[derive(Clone, Debug)]
pub struct StagedGrid {
    pub info: SourceInfo,
    /// Bytes of one row: samples, and the mask behind them.
    pub row_bytes: u64,
    pub masked: bool,
    /// Byte of its first row in the file of all grids.
    pub at: u64,
    /// What its rows must hash to.
    pub hash: Option<[u8; 32]>,
}

/// A header whose every number was checked.
#[derive(Clone, Debug)]
pub struct Said {
    pub operation: String,
    pub grids: Vec<StagedGrid>,
    /// Rows of all grids.
    pub rows: u64,
    /// Bytes of all rows.
    pub bytes: u64,
    pub dry_run: bool,
    name: Option<String>,
    target: Option<v1::upload_header::Target>,
    accuracy_m: Option<f64>,
    date: Option<Date>,
    precedence: Option<i64>,
    crs: Option<Crs>,
    datum: DatumChoice,
    vertical_datum: Option<String>,
    lattice: Option<[f64; 4]>,
    step: Option<[f64; 2]>,
}

/// Checks a header of an upload, with its grids. `here`: the system of the database.
pub fn said(h: &v1::UploadHeader, here: &Crs) -> Result<Said> {
    let mut said = described(h)?;
    let count = h.grids.len() as u64;
    if count == 0 {
        return Err(Error::invalid("grids", "there is none; an upload has one at least"));
    }
    if count > limits::UPLOAD_GRIDS_MAX {
        return Err(Error::limit("grids of an upload", limits::UPLOAD_GRIDS_MAX, count));
    }
    let mut names = HashSet::new();
    let mut posts = 0u64;
    for (k, g) in h.grids.iter().enumerate() {
        let mut staged = grid(g, k)?;
        if !names.insert(g.name.as_str()) {
            return Err(Error::invalid(
                format!("grids[{k}].name"),
                format!("'{}' is the name of an earlier grid; a name stands for one tile", g.name),
            ));
        }
        // No overflow: rows, row_bytes and the sum before were held against their limits.
        said.rows += g.rows;
        posts += g.cols * g.rows;
        if said.rows > limits::UPLOAD_ROWS_MAX {
            return Err(Error::limit("rows of an upload", limits::UPLOAD_ROWS_MAX, said.rows));
        }
        if posts > limits::POSTS_MAX {
            return Err(Error::limit("posts of an upload", limits::POSTS_MAX, posts));
        }
        staged.at = said.bytes;
        said.bytes += g.rows * staged.row_bytes;
        staged.info.crs = Some(said.crs.clone().unwrap_or_else(|| here.clone()));
        said.grids.push(staged);
    }
    Ok(said)
}

/// Checks a header of files that the server can see: all but grids.
pub fn said_of_files(h: &v1::UploadHeader) -> Result<Said> {
    if !h.grids.is_empty() {
        return Err(Error::invalid(
            "header.grids",
            format!("{} are described; of files leave them out, the files say it", h.grids.len()),
        ));
    }
    described(h)
}

impl Said {
    /// What to commit, of these sources.
    pub fn change(&self, sources: Vec<Box<dyn HeightSource>>) -> Change {
        use v1::upload_header::Target;
        let into = match &self.target {
            Some(Target::Into(survey)) => Some(survey.clone()),
            _ => None,
        };
        let ingest = Ingest {
            sources,
            name: self.name.clone(),
            into,
            accuracy_m: self.accuracy_m,
            date: self.date,
            precedence: self.precedence,
            vertical_unit_m: None,
            vertical_datum: self.vertical_datum.clone(),
            crs: self.crs.clone(),
            datum: self.datum.clone(),
            lattice: self.lattice,
            step: self.step,
        };
        match &self.target {
            Some(Target::Replace(survey)) => Change::Replace { survey: survey.clone(), ingest },
            _ => Change::Ingest(ingest),
        }
    }
}

/// The caller's id of an operation.
pub fn operation(id: &str) -> Result<String> {
    let most = limits::OPERATION_BYTES_MAX;
    if id.is_empty() || id.len() > most || id.chars().any(char::is_control) {
        return Err(Error::invalid(
            "operation",
            format!(
                "has {} bytes; give an id of your own of 1 to {most} bytes without control characters: with it the call can \
                 be repeated",
                id.len()
            ),
        ));
    }
    if id.starts_with("commit-") {
        return Err(Error::invalid(
            "operation",
            format!("'{id}': ids that begin with 'commit-' are the program's; give one of your own"),
        ));
    }
    Ok(id.to_string())
}

fn described(h: &v1::UploadHeader) -> Result<Said> {
    use v1::upload_header::Target;
    text("name", &h.name)?;
    if let Some(Target::Into(s) | Target::Replace(s)) = &h.target {
        text("into or replace", s)?;
        if s.is_empty() {
            return Err(Error::invalid("into or replace", "is empty; name a survey, or leave it out"));
        }
        if !h.name.is_empty() {
            return Err(Error::invalid(
                "name",
                format!("'{}': tiles of survey '{s}' have its name; leave it out", h.name),
            ));
        }
    }
    text("date", &h.date)?;
    text("crs", &h.crs)?;
    text("datum_shift", &h.datum_shift)?;
    text("vertical_datum", &h.vertical_datum)?;
    finite("accuracy_m", h.accuracy_m)?;
    finite("lattice", h.lattice.iter().copied())?;
    finite("step", h.step.iter().copied())?;
    let given = |s: &str| (!s.is_empty()).then(|| s.to_string());
    let vertical = given(&h.vertical_datum).map(|d| VerticalDatum::parse(&d)).transpose()?;
    Ok(Said {
        operation: operation(&h.operation)?,
        grids: Vec::new(),
        rows: 0,
        bytes: 0,
        dry_run: h.dry_run,
        name: given(&h.name),
        target: h.target.clone(),
        accuracy_m: h.accuracy_m,
        date: given(&h.date).map(|d| Date::parse(&d)).transpose()?,
        precedence: h.precedence,
        crs: given(&h.crs).map(|c| Crs::parse(&c)).transpose()?,
        datum: given(&h.datum_shift).map_or(Ok(DatumChoice::None), |d| DatumChoice::parse(&d))?,
        vertical_datum: vertical.map(|d| d.as_str().to_string()),
        lattice: exactly("lattice", &h.lattice)?,
        step: exactly("step", &h.step)?,
    })
}

fn grid(g: &v1::Grid, k: usize) -> Result<StagedGrid> {
    let at = |field: &str| format!("grids[{k}].{field}");
    text(&at("name"), &g.name)?;
    if g.name.is_empty() || g.name.chars().any(char::is_control) {
        return Err(Error::invalid(at("name"), "is empty or holds control characters; name the tile"));
    }
    let sample_type = sample_type(g.sample_type).ok_or_else(|| {
        Error::invalid(
            at("sample_type"),
            format!("{} is none that this server knows; see SampleType in ingest.proto", g.sample_type),
        )
    })?;
    for (side, field) in [(g.cols, "cols"), (g.rows, "rows")] {
        if side < 4 {
            return Err(Error::invalid(at(field), format!("{side}; a grid has 4 x 4 posts at least")));
        }
        if side > limits::SIDE_MAX {
            return Err(Error::limit(at(field), limits::SIDE_MAX, side));
        }
    }
    let row_bytes = g.row_bytes().unwrap_or(u64::MAX);
    if row_bytes > limits::UPLOAD_ROW_BYTES_MAX {
        let what = format!("bytes of a row of grid '{}' (send it as several grids)", g.name);
        return Err(Error::limit(what, limits::UPLOAD_ROW_BYTES_MAX, row_bytes));
    }
    for (value, field) in [
        (g.x, "x"),
        (g.y, "y"),
        (g.col_dx, "col_dx"),
        (g.col_dy, "col_dy"),
        (g.row_dx, "row_dx"),
        (g.row_dy, "row_dy"),
        (g.scale, "scale"),
        (g.offset, "offset"),
    ] {
        finite(&at(field), [value])?;
    }
    let hash = hash(&at("hash"), &g.hash)?;
    let affine =
        Affine { origin: [g.x, g.y], col_step: [g.col_dx, g.col_dy], row_step: [g.row_dx, g.row_dy] };
    // The rows and columns must span an area.
    crate::height::frame::Lattice::of_affine(&affine)
        .map_err(|e| Error::invalid(format!("grids[{k}] '{}'", g.name), e))?;
    let info = SourceInfo {
        file: g.name.clone(),
        format: "upload",
        cols: g.cols,
        rows: g.rows,
        sample_type,
        affine: Some(affine),
        crs: None,
        nodata: g.nodata,
        scale: if g.scale == 0.0 { 1.0 } else { g.scale },
        offset: g.offset,
        vertical_datum: None,
        vertical_unit_m: None,
        accuracy_m: None,
        product: None,
        notes: Vec::new(),
    };
    Ok(StagedGrid { info, row_bytes, masked: g.masked, at: 0, hash })
}

/// A BLAKE3 hash, if there is one.
pub fn hash(what: &str, bytes: &[u8]) -> Result<Option<[u8; 32]>> {
    if bytes.is_empty() {
        return Ok(None);
    }
    let found = bytes.try_into().map(Some);
    found.map_err(|_| Error::invalid(what, format!("has {} bytes; BLAKE3 has 32", bytes.len())))
}

fn sample_type(n: i32) -> Option<SampleType> {
    // The numbers of the enum are those of the store.
    let code = v1::SampleType::try_from(n).ok()? as i32;
    SampleType::from_code(u8::try_from(code).ok()?)
}

fn finite(what: &str, values: impl IntoIterator<Item = f64>) -> Result<()> {
    match values.into_iter().find(|v| !v.is_finite()) {
        Some(v) => Err(Error::invalid(what, format!("{v} is no finite number"))),
        None => Ok(()),
    }
}

fn exactly<const N: usize>(what: &str, values: &[f64]) -> Result<Option<[f64; N]>> {
    if values.is_empty() {
        return Ok(None);
    }
    let found = values.try_into().map(Some);
    found.map_err(|_| Error::invalid(what, format!("has {} numbers; give {N} or none", values.len())))
}

fn text(what: &str, value: &str) -> Result<()> {
    if value.len() > limits::TEXT_BYTES_MAX {
        return Err(Error::limit(
            format!("bytes of {what}"),
            limits::TEXT_BYTES_MAX as u64,
            value.len() as u64,
        ));
    }
    Ok(())
}

/// What differs between two headers, in words; `dry_run` may. `None`: nothing.
pub fn difference(was: &v1::UploadHeader, is: &v1::UploadHeader) -> Option<String> {
    let (a, b) = (fields(was), fields(is));
    let fields = a.iter().zip(&b).find(|((_, x), (_, y))| x != y);
    if let Some(((name, x), (_, y))) = fields {
        return Some(format!("{name} was {x}, is {y}"));
    }
    if was.grids.len() != is.grids.len() {
        return Some(format!("grids: there were {}, are {}", was.grids.len(), is.grids.len()));
    }
    let differ = |a: &v1::Grid, b: &v1::Grid| format!("{a:?}") != format!("{b:?}");
    let (k, (a, b)) = was.grids.iter().zip(&is.grids).enumerate().find(|(_, (a, b))| differ(a, b))?;
    Some(format!("grids[{k}] was {a:?}, is {b:?}"))
}

fn fields(h: &v1::UploadHeader) -> [(&'static str, String); 11] {
    [
        ("operation", format!("'{}'", h.operation)),
        ("name", format!("'{}'", h.name)),
        ("into or replace", format!("{:?}", h.target)),
        ("accuracy_m", format!("{:?}", h.accuracy_m)),
        ("date", format!("'{}'", h.date)),
        ("precedence", format!("{:?}", h.precedence)),
        ("crs", format!("'{}'", h.crs)),
        ("datum_shift", format!("'{}'", h.datum_shift)),
        ("vertical_datum", format!("'{}'", h.vertical_datum)),
        ("lattice", format!("{:?}", h.lattice)),
        ("step", format!("{:?}", h.step)),
    ]
}
