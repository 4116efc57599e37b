//! `ingest` and `replace` over a server: files are opened here, their samples are streamed.

use super::line::Line;
use super::output::{Meter, message, stop_flag};
use crate::base::{Error, Result};
use crate::client::{catalog, ingest};
use crate::db::{Ingest, Outcome};
use crate::height::source::{HeightSource, SourceInfo, Window};
use crate::wire::v1;
use crate::wire::v1::upload_header::Target;
use std::sync::atomic::Ordering;

/// What is said of an upload beside its request.
pub struct Call<'a> {
    /// Survey whose tiles are delivered again.
    pub replace: Option<&'a str>,
    /// As the user wrote it.
    pub datum_shift: Option<&'a str>,
    pub operation: String,
    pub dry_run: bool,
}

/// Files whose rows are sent as they are asked for.
struct Files(Vec<Box<dyn HeightSource>>);

impl ingest::Rows for Files {
    fn read(&mut self, grid: usize, row: u64, rows: u64, out: &mut Vec<u8>) -> Result<()> {
        // Read far ahead is read in vain.
        if stop_flag().load(Ordering::Relaxed) {
            return Err(Error::Stopped);
        }
        let source = &mut self.0[grid];
        let (cols, width) = (source.info().cols as usize, source.info().sample_type.bytes());
        let samples = source.read(Window { col: 0, row, cols, rows: rows as usize })?;
        for (data, valid) in samples.data.chunks_exact(cols * width).zip(samples.valid.chunks_exact(cols)) {
            out.extend_from_slice(data);
            let bits =
                |eight: &[u8]| eight.iter().enumerate().fold(0u8, |b, (k, v)| b | u8::from(*v != 0) << k);
            out.extend(valid.chunks(8).map(bits));
        }
        Ok(())
    }

    fn batch(&self, grid: usize) -> u64 {
        self.0[grid].row_batch() as u64
    }
}

/// The files of a request, as grids of one system.
fn grids(request: &Ingest) -> Result<Vec<v1::Grid>> {
    request.sources.iter().map(|s| grid(s.info(), request)).collect()
}

fn grid(info: &SourceInfo, request: &Ingest) -> Result<v1::Grid> {
    let metres = request.vertical_unit_m.or(info.vertical_unit_m).unwrap_or(1.0);
    let own = ingest::grid_of(info)?;
    // A file may have voids that no sample value marks.
    Ok(v1::Grid { scale: own.scale * metres, offset: own.offset * metres, masked: true, ..own })
}

/// What all files say alike, the first that says it and its file.
fn alike(request: &Ingest, what: &str, of: impl Fn(&SourceInfo) -> Option<String>) -> Result<Option<String>> {
    let mut found: Option<(&str, String)> = None;
    for info in request.sources.iter().map(|s| s.info()) {
        match (of(info), &found) {
            (Some(own), Some((file, other))) if own != *other => {
                let reason =
                    format!("its {what} is {own}, that of {file} is {other}; bring them in two calls");
                return Err(Error::invalid(&info.file, reason));
            }
            (Some(own), None) => found = Some((&info.file, own)),
            _ => {}
        }
    }
    Ok(found.map(|(_, own)| own))
}

/// Sends the files of a request and waits for the commit.
pub fn send(line: &Line, mut request: Ingest, call: Call) -> Result<Outcome> {
    let info = line.wait(catalog::info(&line.connection, 0, false))?;
    let mut warnings: Vec<String> = Vec::new();
    for s in request.sources.iter().map(|s| s.info()) {
        warnings.extend(s.notes.iter().map(|n| format!("{}: {n}", s.file)));
    }
    let crs = match &request.crs {
        Some(crs) => crs.code.clone(),
        None => {
            if let Some(s) = request.sources.iter().map(|s| s.info()).find(|s| s.crs.is_none()) {
                return Err(Error::invalid(&s.file, "does not say its coordinate system; say it with --crs"));
            }
            alike(&request, "coordinate system", |s| s.crs.as_ref().map(|c| c.code.clone()))?
                .unwrap_or_default()
        }
    };
    // Databases of format 1 have no place for what files say of it.
    let told = |s: &SourceInfo| s.vertical_datum.clone().filter(|_| info.format_version >= 2);
    let vertical_datum = match request.vertical_datum.clone() {
        Some(datum) => Some(datum),
        None => alike(&request, "vertical datum", told)?,
    };
    let product = request.sources.first().and_then(|s| {
        let own = s.info().accuracy_m.filter(|_| request.accuracy_m.is_none())?;
        let product = s.info().product.unwrap_or("product");
        let file = &s.info().file;
        let said = format!("{file}: accuracy {own} m, that of {product}; --accuracy says otherwise");
        Some((own, said)).filter(|_| request.into.is_none() && call.replace.is_none())
    });
    let accuracy_m = request.accuracy_m.or(product.as_ref().map(|(a, _)| *a));
    warnings.extend(product.map(|(_, said)| said));
    let target = match call.replace {
        Some(survey) => Some(Target::Replace(survey.to_string())),
        None => request.into.clone().map(Target::Into),
    };
    let header = v1::UploadHeader {
        operation: call.operation.clone(),
        name: request.name.clone().unwrap_or_default(),
        target,
        accuracy_m,
        date: request.date.map(|d| d.to_string()).unwrap_or_default(),
        precedence: request.precedence,
        crs,
        datum_shift: call.datum_shift.unwrap_or_default().to_string(),
        vertical_datum: vertical_datum.unwrap_or_default(),
        lattice: request.lattice.map(Vec::from).unwrap_or_default(),
        step: request.step.map(Vec::from).unwrap_or_default(),
        grids: grids(&request)?,
        dry_run: call.dry_run,
    };
    let all: u64 = header.grids.iter().map(|g| g.rows).sum();
    let files = Files(std::mem::take(&mut request.sources));
    let meter = Meter::new();
    let mut there = 0;
    let mut told = |r: &v1::UploadReply| {
        there += r.received.iter().map(|s| s.rows).sum::<u64>();
        if r.stage.is_empty() {
            meter.report("sending", (there as f64 / all.max(1) as f64).min(1.0));
        } else {
            meter.report(&r.stage, r.share);
        }
    };
    let sending = ingest::Sending::default();
    let done = line.wait(ingest::upload(&line.connection, header, files, &sending, &mut told));
    meter.clear();
    let done = match done {
        Err(Error::Stopped) => {
            message(&format!(
                "what arrived is kept for some hours: the same command with --operation {} goes on from there",
                call.operation
            ));
            return Err(Error::Remote {
                server: line.connection.server.clone(),
                message: "stopped sending; nothing was changed unless all samples had arrived".into(),
            });
        }
        done => done?,
    };
    let mut outcome: Outcome = line.read(done.json.as_bytes())?;
    warnings.append(&mut outcome.warnings);
    outcome.warnings = warnings;
    Ok(outcome)
}
