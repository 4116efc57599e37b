//! The catalog in SQLite (WAL, synchronous = FULL); schema in `migrations/catalog/`.

use super::{Catalog, Commit, Contents, Counters, NamedFile, Version};
use crate::base::bytes::Reader;
use crate::base::{Error, Result};
use crate::store::segment::PageRef;
use rusqlite::{Connection, OpenFlags, OptionalExtension, params};
use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

mod embedded {
    refinery::embed_migrations!("migrations/catalog");
}

/// How long a reader waits for a writer's checkpoint, and a writer for a reader's.
const BUSY: Duration = Duration::from_secs(30);

impl From<rusqlite::Error> for Error {
    fn from(e: rusqlite::Error) -> Error {
        Error::Catalog(e.to_string())
    }
}

pub struct Sqlite {
    db: Connection,
    path: PathBuf,
    /// Device and number of the file that was opened.
    file: (u64, u64),
}

/// Device and number of a file: another file under the same name has others.
fn identity(path: &Path) -> Result<(u64, u64)> {
    let found = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
    Ok((found.dev(), found.ino()))
}

impl Sqlite {
    /// Creates an empty catalog.
    pub fn create(path: &Path) -> Result<Sqlite> {
        let mut db = Connection::open(path)?;
        configure(&db)?;
        migrate(&mut db)?;
        Ok(Sqlite { db, path: path.to_path_buf(), file: identity(path)? })
    }

    /// Opens a catalog for writing.
    pub fn open(path: &Path) -> Result<Sqlite> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let mut db = Connection::open_with_flags(path, flags)?;
        configure(&db)?;
        refuse_newer(&db)?;
        migrate(&mut db)?;
        Ok(Sqlite { db, path: path.to_path_buf(), file: identity(path)? })
    }

    /// Makes the catalog hold this and nothing else. One transaction.
    pub fn fill(&mut self, contents: &Contents) -> Result<()> {
        let tx = self.db.transaction()?;
        for table in ["version_file", "version", "file", "operation", "constant"] {
            tx.execute(&format!("DELETE FROM {table}"), [])?;
        }
        for (name, value) in &contents.constants {
            tx.execute("INSERT INTO constant VALUES (?1, ?2)", params![name, value])?;
        }
        for (version, files) in &contents.versions {
            insert_version(&tx, version, files)?;
        }
        for (id, version) in &contents.operations {
            tx.execute("INSERT INTO operation VALUES (?1, ?2)", params![id, *version as i64])?;
        }
        set_counters(&tx, &contents.counters)?;
        tx.execute("DELETE FROM counter WHERE name = 'backup'", [])?;
        if let Some(version) = contents.backup {
            tx.execute("INSERT INTO counter VALUES ('backup', ?1)", [version as i64])?;
        }
        tx.commit()?;
        Ok(())
    }

    /// The newest version when a backup was made here; `None` if this is no backup.
    pub fn backup(&self) -> Result<Option<u64>> {
        let sql = "SELECT value FROM counter WHERE name = 'backup'";
        Ok(self.db.query_row(sql, [], |r| r.get::<_, i64>(0)).optional()?.map(|v| v as u64))
    }

    /// Opens a catalog for reading. On a medium that cannot be written it is taken as unchanging.
    pub fn open_read_only(path: &Path) -> Result<Sqlite> {
        let flags =
            OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_URI;
        let plain = Connection::open_with_flags(path, flags).and_then(|db| {
            db.busy_timeout(BUSY)?;
            db.query_row("SELECT count(*) FROM constant", [], |_| Ok(()))?;
            Ok(db)
        });
        let db = match plain {
            Ok(db) => db,
            Err(first) => {
                let text = path.to_str().unwrap_or_default();
                let uri = format!(
                    "file:{}?immutable=1",
                    text.replace('%', "%25").replace('?', "%3f").replace('#', "%23")
                );
                let wal = path.with_file_name(format!(
                    "{}-wal",
                    path.file_name().and_then(|n| n.to_str()).unwrap_or_default()
                ));
                // With immutable=1 a write-ahead log is not read: only right if there is none.
                if std::fs::metadata(&wal).is_ok_and(|m| m.len() > 0) {
                    return Err(first.into());
                }
                let db = Connection::open_with_flags(uri, flags)?;
                db.query_row("SELECT count(*) FROM constant", [], |_| Ok(())).map_err(|_| first)?;
                db
            }
        };
        refuse_newer(&db)?;
        Ok(Sqlite { db, path: path.to_path_buf(), file: identity(path)? })
    }
}

fn configure(db: &Connection) -> Result<()> {
    db.busy_timeout(BUSY)?;
    db.pragma_update(None, "journal_mode", "WAL")?;
    db.pragma_update(None, "synchronous", "FULL")?;
    db.pragma_update(None, "foreign_keys", true)?;
    Ok(())
}

fn migrate(db: &mut Connection) -> Result<()> {
    embedded::migrations::runner().run(db).map_err(|e| Error::Catalog(e.to_string()))?;
    Ok(())
}

/// A catalog with migrations that this program does not know is of a newer program.
fn refuse_newer(db: &Connection) -> Result<()> {
    let found: i64 = db
        .query_row("SELECT max(version) FROM refinery_schema_history", [], |r| r.get::<_, Option<i64>>(0))?
        .unwrap_or(0);
    let known = embedded::migrations::runner()
        .get_migrations()
        .iter()
        .map(|m| i64::from(m.version()))
        .max()
        .unwrap_or(0);
    if found > known {
        return Err(Error::unsupported(
            "catalog",
            format!("schema {found} of a newer program, this one knows {known}"),
            "use a newer terraquilt",
        ));
    }
    Ok(())
}

fn version_of(row: &rusqlite::Row) -> rusqlite::Result<(Version, Vec<u8>)> {
    let root: Vec<u8> = row.get(4)?;
    let v = Version {
        number: row.get::<_, i64>(0)? as u64,
        operation: row.get(1)?,
        made_at: row.get(2)?,
        action: row.get(3)?,
        root: PageRef { file: 0, len: 0, offset: 0, crc: 0 },
    };
    Ok((v, root))
}

fn with_root((mut v, root): (Version, Vec<u8>)) -> Result<Version> {
    let mut r = Reader::new(&root, "catalog.sqlite", "root reference");
    v.root = PageRef::read(&mut r)?;
    r.end()?;
    Ok(v)
}

fn insert_version(tx: &Connection, v: &Version, files: &[NamedFile]) -> Result<()> {
    let mut root = Vec::new();
    v.root.put(&mut root);
    tx.execute(
        "INSERT INTO version (number, operation, made_at, action, root) VALUES (?1, ?2, ?3, ?4, ?5)",
        params![v.number as i64, v.operation, v.made_at, v.action, root],
    )?;
    for f in files {
        tx.execute(
            "INSERT OR IGNORE INTO file VALUES (?1, ?2)",
            params![i64::from(f.number), f.length as i64],
        )?;
        tx.execute(
            "INSERT INTO version_file VALUES (?1, ?2, ?3)",
            params![v.number as i64, i64::from(f.number), f.live as i64],
        )?;
    }
    Ok(())
}

fn set_counters(tx: &Connection, c: &Counters) -> Result<()> {
    for (name, value) in
        [("file", i64::from(c.file)), ("survey", i64::from(c.survey)), ("version", c.version as i64)]
    {
        tx.execute("UPDATE counter SET value = ?2 WHERE name = ?1", params![name, value])?;
    }
    Ok(())
}

const COLUMNS: &str = "number, operation, made_at, action, root";

impl Catalog for Sqlite {
    fn constants(&self) -> Result<BTreeMap<String, String>> {
        let mut q = self.db.prepare_cached("SELECT name, value FROM constant")?;
        let rows = q.query_map([], |r| Ok((r.get(0)?, r.get(1)?)))?;
        Ok(rows.collect::<rusqlite::Result<_>>()?)
    }

    fn counters(&self) -> Result<Counters> {
        let get = |name: &str| -> Result<i64> {
            Ok(self.db.query_row("SELECT value FROM counter WHERE name = ?1", [name], |r| r.get(0))?)
        };
        Ok(Counters {
            file: get("file")? as u32,
            survey: get("survey")? as u32,
            version: get("version")? as u64,
        })
    }

    fn latest(&self) -> Result<Option<Version>> {
        let sql = format!("SELECT {COLUMNS} FROM version ORDER BY number DESC LIMIT 1");
        self.db.prepare_cached(&sql)?.query_row([], version_of).optional()?.map(with_root).transpose()
    }

    fn version(&self, number: u64) -> Result<Option<Version>> {
        let sql = format!("SELECT {COLUMNS} FROM version WHERE number = ?1");
        self.db
            .prepare_cached(&sql)?
            .query_row([number as i64], version_of)
            .optional()?
            .map(with_root)
            .transpose()
    }

    fn versions(&self) -> Result<Vec<Version>> {
        let sql = format!("SELECT {COLUMNS} FROM version ORDER BY number");
        let mut q = self.db.prepare_cached(&sql)?;
        let rows = q.query_map([], version_of)?.collect::<rusqlite::Result<Vec<_>>>()?;
        rows.into_iter().map(with_root).collect()
    }

    fn operation(&self, id: &str) -> Result<Option<u64>> {
        let found: Option<i64> = self
            .db
            .prepare_cached("SELECT version FROM operation WHERE id = ?1")?
            .query_row([id], |r| r.get(0))
            .optional()?;
        Ok(found.map(|v| v as u64))
    }

    fn operations(&self) -> Result<Vec<(String, u64)>> {
        let mut q = self.db.prepare_cached("SELECT id, version FROM operation ORDER BY version, id")?;
        let rows = q.query_map([], |r| Ok((r.get(0)?, r.get::<_, i64>(1)? as u64)))?;
        Ok(rows.collect::<rusqlite::Result<_>>()?)
    }

    fn files(&self, version: u64) -> Result<Vec<NamedFile>> {
        let mut q = self.db.prepare_cached(
            "SELECT f.number, f.length, v.live FROM version_file v JOIN file f ON f.number = v.file
             WHERE v.version = ?1 ORDER BY f.number",
        )?;
        let rows = q.query_map([version as i64], |r| {
            Ok(NamedFile {
                number: r.get::<_, i64>(0)? as u32,
                length: r.get::<_, i64>(1)? as u64,
                live: r.get::<_, i64>(2)? as u64,
            })
        })?;
        Ok(rows.collect::<rusqlite::Result<_>>()?)
    }

    fn all_files(&self) -> Result<Vec<(u32, u64)>> {
        let mut q = self.db.prepare_cached("SELECT number, length FROM file ORDER BY number")?;
        let rows = q.query_map([], |r| Ok((r.get::<_, i64>(0)? as u32, r.get::<_, i64>(1)? as u64)))?;
        Ok(rows.collect::<rusqlite::Result<_>>()?)
    }

    fn commit(&mut self, c: &Commit) -> Result<()> {
        let tx = self.db.transaction()?;
        insert_version(&tx, &c.version, &c.files)?;
        let v = &c.version;
        tx.execute("INSERT INTO operation VALUES (?1, ?2)", params![v.operation, v.number as i64])?;
        set_counters(&tx, &c.counters)?;
        tx.commit()?;
        Ok(())
    }

    fn prune(&mut self, versions: &[u64]) -> Result<()> {
        let tx = self.db.transaction()?;
        for v in versions {
            tx.execute("DELETE FROM version_file WHERE version = ?1", [*v as i64])?;
            tx.execute("DELETE FROM version WHERE number = ?1", [*v as i64])?;
        }
        tx.execute("DELETE FROM file WHERE number NOT IN (SELECT file FROM version_file)", [])?;
        tx.commit()?;
        Ok(())
    }

    fn is_current(&self) -> Result<bool> {
        if identity(&self.path).ok() != Some(self.file) {
            return Ok(false);
        }
        refuse_newer(&self.db)?;
        Ok(true)
    }

    fn check(&self) -> Result<Vec<String>> {
        let mut q = self.db.prepare("PRAGMA integrity_check")?;
        let rows = q.query_map([], |r| r.get::<_, String>(0))?;
        let found: Vec<String> = rows.collect::<rusqlite::Result<_>>()?;
        Ok(found.into_iter().filter(|s| s != "ok").collect())
    }
}
