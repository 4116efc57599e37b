//! Version records: one small file beside the segments for each version, repeating what the catalog says of it.
//!
//! A record is durable before the catalog's transaction, and goes when its version is pruned. So a lost catalog can be
//! made again from the files. Bytes: `docs/format.md`.

use super::catalog::{Counters, NamedFile, Version};
use super::disk::{Disk, Unnamed};
use super::segment::{PageRef, checksum};
use crate::base::bytes::{Put, Reader};
use crate::base::{Error, Result, limits};
use std::collections::BTreeMap;

/// First bytes of every version record.
pub const MAGIC: [u8; 8] = *b"TQUILTVR";
/// Version of the bytes of a record.
pub const RECORD_VERSION: u32 = 1;
/// Magic, version, length of the body.
const HEAD: usize = 16;

/// What the catalog says of one version, and what it needs to be made again.
#[derive(Clone, Debug, PartialEq)]
pub struct VersionRecord {
    pub version: Version,
    /// Files that the version reads, ascending.
    pub files: Vec<NamedFile>,
    /// Numbers given out when the version was made.
    pub counters: Counters,
    pub constants: BTreeMap<String, String>,
}

/// The final name of the record of a version.
pub fn record_name(version: u64) -> String {
    format!("{version:08}.tqv")
}

/// The version whose record a file is, by its name.
pub fn version_of_name(name: &str) -> Option<u64> {
    let number = name.strip_suffix(".tqv")?.parse().ok()?;
    (record_name(number) == name).then_some(number)
}

impl VersionRecord {
    pub fn encode(&self) -> Vec<u8> {
        let mut body = Vec::new();
        let (v, c) = (&self.version, &self.counters);
        body.put_u64(v.number);
        body.put_i64(v.made_at);
        v.root.put(&mut body);
        body.put_u32(c.file);
        body.put_u32(c.survey);
        body.put_u64(c.version);
        body.put_text(&v.operation);
        body.put_text(&v.action);
        body.put_u32(self.files.len() as u32);
        for f in &self.files {
            body.put_u32(f.number);
            body.put_u64(f.length);
            body.put_u64(f.live);
        }
        body.put_u32(self.constants.len() as u32);
        for (name, value) in &self.constants {
            body.put_text(name);
            body.put_text(value);
        }
        let mut out = Vec::with_capacity(HEAD + body.len() + 4);
        out.put(&MAGIC);
        out.put_u32(RECORD_VERSION);
        out.put_u32(body.len() as u32);
        out.put(&body);
        let crc = checksum(&out);
        out.put_u32(crc);
        out
    }

    /// Reads a record.
    ///
    /// # Errors
    /// `Corrupt` if it is not whole; `Unsupported` if a newer program wrote it.
    pub fn decode(bytes: &[u8], file: &str) -> Result<VersionRecord> {
        let mut r = Reader::new(bytes, file, "version record");
        if r.take(8)? != MAGIC {
            return Err(r.bad("does not begin with TQUILTVR"));
        }
        let (format, length) = (r.u32()?, r.u32()? as usize);
        if length + 4 != r.remaining() {
            return Err(r.bad(format!(
                "{} bytes follow the head, {} belong there",
                r.remaining(),
                length + 4
            )));
        }
        let (crc, stored) = (checksum(&bytes[..HEAD + length]), &bytes[HEAD + length..]);
        if crc.to_le_bytes() != *stored {
            return Err(r.bad(format!("checksum {crc:#010x} is not the stored one")));
        }
        if format > RECORD_VERSION {
            return Err(Error::unsupported(
                file,
                format!("version record of format {format}, this program reads up to {RECORD_VERSION}"),
                "use a newer terraquilt",
            ));
        }
        let mut r = Reader::new(&bytes[HEAD..HEAD + length], file, "version record");
        let (number, made_at, root) = (r.u64()?, r.i64()?, PageRef::read(&mut r)?);
        let counters = Counters { file: r.u32()?, survey: r.u32()?, version: r.u64()? };
        let (operation, action) = (text(&mut r)?, text(&mut r)?);
        let n = r.u32()? as usize;
        if n > r.remaining() / 20 {
            return Err(r.bad(format!("{n} files in {} bytes", r.remaining())));
        }
        let files = (0..n)
            .map(|_| Ok(NamedFile { number: r.u32()?, length: r.u64()?, live: r.u64()? }))
            .collect::<Result<Vec<_>>>()?;
        let n = r.u32()? as usize;
        if n > r.remaining() / 8 {
            return Err(r.bad(format!("{n} constants in {} bytes", r.remaining())));
        }
        let constants = (0..n).map(|_| Ok((r.text()?, r.text()?))).collect::<Result<_>>()?;
        r.end()?;
        if number == 0 || counters.version < number || !files.is_sorted_by(|a, b| a.number < b.number) {
            return Err(r.bad(format!("version {number} with these counters and files is impossible")));
        }
        let version = Version { number, operation, made_at, action, root };
        Ok(VersionRecord { version, files, counters, constants })
    }

    /// Writes the record, under a temporary name.
    pub fn write(&self, disk: &dyn Disk) -> Result<Unnamed> {
        let name = record_name(self.version.number);
        let temporary = format!("{name}.tmp");
        let mut file = disk.create(&temporary)?;
        file.append(&self.encode())?;
        Ok(Unnamed { file, temporary, name })
    }

    /// Reads the record in a file of `length` bytes.
    pub fn read(disk: &dyn Disk, name: &str, length: u64) -> Result<VersionRecord> {
        if length > limits::PAGE_BYTES_MAX {
            return Err(Error::limit("bytes of a version record", limits::PAGE_BYTES_MAX, length));
        }
        let place = format!("{}/{name}", disk.place());
        if length == 0 {
            return Err(Error::corrupt(place, "version record", "is empty"));
        }
        let bytes = disk.open(name, length)?;
        VersionRecord::decode((*bytes).as_ref(), &place)
    }
}

/// A text of any length that the record holds: callers name operations as they like.
fn text(r: &mut Reader) -> Result<String> {
    let n = r.u32()? as usize;
    String::from_utf8(r.take(n)?.to_vec()).map_err(|_| r.bad("text is not UTF-8"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_comes_back_and_any_damage_is_an_error() {
        let record = VersionRecord {
            version: Version {
                number: 12,
                operation: "delivery 7".into(),
                made_at: 1_700_000_000,
                action: "ingest 'hills'".repeat(400),
                root: PageRef { file: 9, len: 300, offset: 5000, crc: 77 },
            },
            files: vec![
                NamedFile { number: 3, length: 9000, live: 20 },
                NamedFile { number: 9, length: 5300, live: 5268 },
            ],
            counters: Counters { file: 9, survey: 4, version: 12 },
            constants: [("crs".to_string(), "EPSG:32610".to_string())].into(),
        };
        let bytes = record.encode();
        assert_eq!(VersionRecord::decode(&bytes, "t").unwrap(), record);
        for cut in 0..bytes.len() {
            assert!(VersionRecord::decode(&bytes[..cut], "t").is_err());
        }
        for bit in 0..bytes.len() * 8 {
            let mut x = bytes.clone();
            x[bit / 8] ^= 1 << (bit % 8);
            assert!(VersionRecord::decode(&x, "t").is_err(), "bit {bit}");
        }
        assert_eq!(version_of_name(&record_name(12)), Some(12));
        assert_eq!(version_of_name("12.tqv"), None);
        assert_eq!(version_of_name("00000012.tqs"), None);
    }
}
