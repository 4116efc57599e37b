//! Uploads in progress: where their folders are, and the catalog that knows them. What is in the folders is the server's.
//!
//! ```text
//! DB/uploads/catalog.sqlite   uploads in progress          DB/uploads/HEX/...   what arrived of one
//! ```
//! Commits, prune, backups and copies neither read nor remove them.

use super::arrive::{foresee, name_taken};
use super::change::{Change, Ingest, Outcome};
use super::database::{Db, Snapshot};
use crate::base::{Error, Result};
use crate::height::frame::CellRect;
use crate::height::source::SourceInfo;
pub use crate::store::catalog::{Upload, Uploads};
use std::path::PathBuf;

impl Db {
    /// The folder of uploads in progress. It may be missing.
    pub fn uploads_folder(&self) -> PathBuf {
        self.path().join("uploads")
    }

    /// The catalog of uploads in progress; made if there is none.
    pub fn uploads(&self) -> Result<Uploads> {
        let folder = self.uploads_folder();
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
        Uploads::open(&folder.join("catalog.sqlite"))
    }

    /// Bytes that the disk of the database can still take, if it knows.
    pub fn free_bytes(&self) -> Result<Option<u64>> {
        self.disk().free_bytes()
    }

    /// Holds an ingest or a replacement against a version, without reading a sample: what can be refused already, is.
    /// `delivered` says which tile a file became before, of its index and the rectangle of posts that it covers. If the version
    /// holds all of them, the commit would change nothing: the outcome says so.
    pub fn foresee(
        &self,
        snapshot: &Snapshot,
        change: &Change,
        delivered: &dyn Fn(usize, &CellRect) -> Result<Option<TileKey>>,
    ) -> Result<Option<Outcome>> {
        let (ingest, into): (&Ingest, Option<&str>) = match change {
            Change::Ingest(i) => (i, i.into.as_deref()),
            Change::Replace { survey, ingest } => (ingest, Some(survey)),
            _ => return Ok(None),
        };
        let found = foresee(self, &snapshot.view, ingest, into)?;
        let named = || snapshot.entries().find(|e| e.name == found.declaration.name);
        let Some(entry) = found.entry.as_ref().or_else(named) else { return Ok(None) };
        let head = snapshot.head(entry.number)?;
        if matches!(change, Change::Replace { .. }) {
            return Ok(None);
        }
        if head.declaration != found.declaration {
            // Whatever its samples are, a survey of another declaration cannot take the name.
            return if found.entry.is_some() { Ok(None) } else { Err(name_taken(&entry.name)) };
        }
        let (mut posts, mut voids) = (0, 0);
        for (k, (source, at)) in ingest.sources.iter().zip(&found.places).enumerate() {
            let Some(key) = delivered(k, &rectangle(source.info(), at))? else { return Ok(None) };
            let Some(tile) = head.tiles.iter().find(|t| t.key == key) else { return Ok(None) };
            let all = source.info().cols * source.info().rows;
            (posts, voids) = (posts + all, voids + all.saturating_sub(tile.valid));
        }
        let warnings =
            vec![format!("survey '{}' holds these samples already; nothing was changed", entry.name)];
        Ok(Some(Outcome {
            survey: entry.name.clone(),
            version: snapshot.number(),
            patches: entry.live + entry.dormant,
            live: entry.live,
            dormant: entry.dormant,
            posts,
            voids,
            warnings,
            ..Outcome::default()
        }))
    }

    /// The tiles that files became in a version that holds them: of each the rectangle of posts that it covers, and the key.
    /// `None` where two tiles of the survey cover the same posts.
    pub fn tiles_of(
        &self,
        snapshot: &Snapshot,
        survey: &str,
        infos: &[SourceInfo],
    ) -> Result<Vec<Option<(CellRect, TileKey)>>> {
        let head = snapshot.head(snapshot.survey(survey)?.number)?;
        let tile = |info: &SourceInfo| {
            let Some(affine) = &info.affine else { return Ok(None) };
            let lattice = head.declaration.delivered_lattice();
            let at = rectangle(info, &lattice.index_of(affine, info.cols, info.rows, &info.file)?);
            let mut there = head.tiles.iter().filter(|t| t.posts == at);
            Ok(there.next().filter(|_| there.next().is_none()).map(|t| (at, t.key)))
        };
        infos.iter().map(tile).collect()
    }
}

/// Key of a tile: a hash of the posts that it covers and of its samples.
pub type TileKey = [u8; 16];

fn rectangle(info: &SourceInfo, at: &[i64; 2]) -> CellRect {
    CellRect::new(at[0], at[1], at[0] + info.cols as i64, at[1] + info.rows as i64)
}
