//! The catalog of uploads in progress: a small SQLite file of its own beside their folders (decision 15).
//!
//! The catalog of the database is written by the holder of the writer lock only, and a commit holds that for as long as it
//! takes; uploads come and go meanwhile. This one needs no lock: every change is one transaction.

use crate::base::{Error, Result};
use rusqlite::{Connection, OptionalExtension, TransactionBehavior, params};
use std::path::{Path, PathBuf};
use std::time::Duration;

mod embedded {
    refinery::embed_migrations!("migrations/uploads");
}

/// How long a change waits for another process.
const BUSY: Duration = Duration::from_secs(30);

/// Deliveries that are remembered: some 100 bytes each.
const DELIVERED_MAX: i64 = 200_000;

/// An upload in progress.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Upload {
    /// The caller's id.
    pub operation: String,
    /// Room that its folder may take in the end, bytes.
    pub bytes: u64,
    /// Seconds since 1970 UTC of the last sign of life.
    pub touched_at: i64,
}

/// The catalog of uploads in progress.
pub struct Uploads {
    db: Connection,
    path: PathBuf,
}

impl Uploads {
    /// Opens the catalog, or makes an empty one.
    pub fn open(path: &Path) -> Result<Uploads> {
        let wrong = |e: &dyn std::fmt::Display| Error::Io {
            path: path.to_path_buf(),
            source: std::io::Error::other(format!(
                "{e}; without this file the uploads in progress are lost, and nothing else"
            )),
        };
        let mut db = Connection::open(path).map_err(|e| wrong(&e))?;
        db.busy_timeout(BUSY).map_err(|e| wrong(&e))?;
        embedded::migrations::runner().run(&mut db).map_err(|e| wrong(&e))?;
        Ok(Uploads { db, path: path.to_path_buf() })
    }

    fn wrong(&self, e: rusqlite::Error) -> Error {
        Error::Io { path: self.path.clone(), source: std::io::Error::other(e.to_string()) }
    }

    /// Every upload in progress, by operation.
    pub fn all(&self) -> Result<Vec<Upload>> {
        let read = || {
            let sql = "SELECT operation, bytes, touched_at FROM upload ORDER BY operation";
            let mut q = self.db.prepare_cached(sql)?;
            q.query_map([], upload_of)?.collect::<rusqlite::Result<_>>()
        };
        read().map_err(|e| self.wrong(e))
    }

    /// The message that began an upload, if it is in progress.
    pub fn header(&self, operation: &str) -> Result<Option<Vec<u8>>> {
        let sql = "SELECT header FROM upload WHERE operation = ?1";
        self.db.query_row(sql, [operation], |r| r.get(0)).optional().map_err(|e| self.wrong(e))
    }

    /// Adds an upload that is not there, and the message that began it.
    ///
    /// # Errors
    /// If there would be more uploads than `most`, or more than `most_bytes` bytes of them.
    pub fn add(&mut self, upload: &Upload, header: &[u8], most: u64, most_bytes: u64) -> Result<()> {
        let path = self.path.clone();
        let wrong = |e: rusqlite::Error| Error::Io {
            path: path.clone(),
            source: std::io::Error::other(e.to_string()),
        };
        let tx = self.db.transaction_with_behavior(TransactionBehavior::Immediate).map_err(wrong)?;
        let (count, bytes): (i64, i64) = tx
            .query_row("SELECT count(*), coalesce(sum(bytes), 0) FROM upload", [], |r| {
                Ok((r.get(0)?, r.get(1)?))
            })
            .map_err(wrong)?;
        if count as u64 >= most {
            return Err(Error::limit(
                "uploads in progress or kept to be resumed (abandon one, or wait)",
                most,
                count as u64 + 1,
            ));
        }
        let wanted = (bytes as u64).saturating_add(upload.bytes);
        if wanted > most_bytes {
            return Err(Error::limit(
                "bytes of uploads in progress or kept to be resumed (abandon one, or wait)",
                most_bytes,
                wanted,
            ));
        }
        tx.execute(
            "INSERT INTO upload VALUES (?1, ?2, ?3, ?4)",
            params![upload.operation, header, upload.bytes as i64, upload.touched_at],
        )
        .map_err(wrong)?;
        tx.commit().map_err(wrong)
    }

    /// Notes a sign of life.
    pub fn touch(&self, operation: &str, at: i64) -> Result<()> {
        let sql = "UPDATE upload SET touched_at = ?2 WHERE operation = ?1";
        self.db.execute(sql, params![operation, at]).map(|_| ()).map_err(|e| self.wrong(e))
    }

    /// Forgets an upload. Returns whether it was there.
    pub fn remove(&self, operation: &str) -> Result<bool> {
        let gone = self.db.execute("DELETE FROM upload WHERE operation = ?1", [operation]);
        gone.map(|n| n > 0).map_err(|e| self.wrong(e))
    }

    /// The key of the tile that a grid became when it was delivered before.
    pub fn delivered(&self, grid: &[u8; 32]) -> Result<Option<[u8; 16]>> {
        let sql = "SELECT tile FROM delivered WHERE grid = ?1";
        let found = self
            .db
            .prepare_cached(sql)
            .and_then(|mut q| q.query_row([grid], |r| r.get::<_, [u8; 16]>(0)).optional());
        found.map_err(|e| self.wrong(e))
    }

    /// Notes which tiles grids became. The oldest of many are forgotten. One transaction.
    pub fn deliver(&mut self, grids: &[([u8; 32], [u8; 16])]) -> Result<()> {
        let note = |db: &mut Connection| {
            let tx = db.transaction_with_behavior(TransactionBehavior::Immediate)?;
            for (grid, tile) in grids {
                let sql = "INSERT OR REPLACE INTO delivered (grid, tile) VALUES (?1, ?2)";
                tx.prepare_cached(sql)?.execute(params![grid, tile])?;
            }
            let sql = "DELETE FROM delivered WHERE number <= (SELECT max(number) FROM delivered) - ?1";
            tx.execute(sql, [DELIVERED_MAX])?;
            tx.commit()
        };
        note(&mut self.db).map_err(|e| self.wrong(e))
    }
}

fn upload_of(row: &rusqlite::Row) -> rusqlite::Result<Upload> {
    Ok(Upload { operation: row.get(0)?, bytes: row.get::<_, i64>(1)? as u64, touched_at: row.get(2)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uploads_are_kept_and_limited() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("catalog.sqlite");
        let upload = |operation: &str, bytes| Upload { operation: operation.into(), bytes, touched_at: 5 };
        let mut first = Uploads::open(&path).unwrap();
        first.add(&upload("b", 10), &[1, 2], 3, 100).unwrap();
        let mut second = Uploads::open(&path).unwrap();
        second.add(&upload("a", 20), &[1, 2], 3, 100).unwrap();
        assert_eq!(first.all().unwrap(), [upload("a", 20), upload("b", 10)]);
        assert!(first.add(&upload("a", 1), &[1, 2], 3, 100).is_err(), "it is there");
        let e = first.add(&upload("c", 71), &[1, 2], 3, 100).unwrap_err().to_string();
        assert!(e.contains("101") && e.contains("100"), "{e}");
        first.add(&upload("c", 70), &[1, 2], 3, 100).unwrap();
        let e = first.add(&upload("d", 0), &[1, 2], 3, 100).unwrap_err().to_string();
        assert!(e.contains("4") && e.contains("3"), "{e}");
        second.touch("b", 9).unwrap();
        assert_eq!(first.all().unwrap()[1].touched_at, 9);
        assert_eq!(first.header("b").unwrap(), Some(vec![1, 2]));
        assert!(first.remove("b").unwrap() && !second.remove("b").unwrap());
        assert_eq!(second.header("b").unwrap(), None);
    }

    #[test]
    fn deliveries_are_remembered() {
        let folder = tempfile::tempdir().unwrap();
        let mut u = Uploads::open(&folder.path().join("catalog.sqlite")).unwrap();
        u.deliver(&[([1; 32], [2; 16]), ([3; 32], [4; 16])]).unwrap();
        u.deliver(&[([1; 32], [5; 16])]).unwrap();
        assert_eq!(u.delivered(&[1; 32]).unwrap(), Some([5; 16]));
        assert_eq!(u.delivered(&[3; 32]).unwrap(), Some([4; 16]));
        assert_eq!(u.delivered(&[9; 32]).unwrap(), None);
    }
}
