//! The surveys that come with the program (USGS Open-File Report 2008-1169, public domain), as they are sent to a server.

use crate::base::{Error, Result};
use crate::client::ingest::{InMemory, grid_of};
use crate::format;
use crate::height::source::Window;
use crate::wire::v1;
use std::path::Path;

/// A survey that comes with the program.
pub struct Bundled {
    pub file: &'static str,
    pub name: &'static str,
    pub date: &'static str,
    pub accuracy_m: f64,
    bytes: &'static [u8],
}

macro_rules! bundled {
    ($file:literal, $name:literal, $date:literal, $accuracy:literal) => {
        Bundled {
            file: $file,
            name: $name,
            date: $date,
            accuracy_m: $accuracy,
            bytes: include_bytes!(concat!("../../tests/data/st_helens/", $file)),
        }
    };
}

pub const SURVEYS: [Bundled; 5] = [
    bundled!("survey_2000-09-25_native.tif", "crater-2000", "2000-09-25", 2.0),
    bundled!("survey_2004-10-04_native.tif", "dome-2004-10-04", "2004-10-04", 0.5),
    bundled!("survey_2004-10-11_native.tif", "dome-2004-10-11", "2004-10-11", 0.5),
    bundled!("survey_2004-10-13_native.tif", "dome-2004-10-13", "2004-10-13", 0.5),
    bundled!("crater_2005-06-15_10m.tif", "crater-2005", "2005-06-15", 2.0),
];

impl Bundled {
    /// Writes the file into a folder.
    pub fn unpack(&self, folder: &Path) -> Result<()> {
        let path = folder.join(self.file);
        std::fs::write(&path, self.bytes).map_err(|e| Error::io(&path, e))
    }

    /// The survey as an upload: what is said of it, and its rows.
    pub fn upload(&self) -> Result<(v1::UploadHeader, InMemory)> {
        let mut source = format::open_bytes(self.file, self.bytes.to_vec())?;
        let info = source.info().clone();
        let (cols, rows) = (info.cols as usize, info.rows as usize);
        let samples = source.read(Window { col: 0, row: 0, cols, rows })?;
        let grid = grid_of(&info)?;
        let header = v1::UploadHeader {
            operation: format!("demo-{}", self.name),
            name: self.name.into(),
            accuracy_m: Some(self.accuracy_m),
            date: self.date.into(),
            crs: info.crs.map(|c| c.code).unwrap_or_default(),
            vertical_datum: info.vertical_datum.unwrap_or_default(),
            grids: vec![grid],
            ..Default::default()
        };
        let row_bytes = vec![cols * info.sample_type.bytes()];
        Ok((header, InMemory { grids: vec![samples.data], row_bytes }))
    }
}
