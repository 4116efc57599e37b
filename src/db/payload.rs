//! Vertices of patches as they travel: packed once, kept by content key.

use super::Snapshot;
use super::kept::Kept;
use crate::base::Result;
use crate::codec::vertices;
use crate::height::lod::PatchId;
use crate::store::quadtree::Record;
use bytes::Bytes;
use quick_cache::Weighter;

/// Bytes of packed vertices kept.
const PAYLOAD_BYTES_CACHED: u64 = 64 << 20;

#[derive(Clone)]
struct ByBytes;

impl Weighter<PatchId, Bytes> for ByBytes {
    fn weight(&self, _: &PatchId, b: &Bytes) -> u64 {
        64 + b.len() as u64
    }
}

/// Packed vertices by content key: right for every version of a database, so its snapshots share them.
pub struct Payloads(Kept<PatchId, Bytes, ByBytes>);

impl Payloads {
    pub fn new() -> Payloads {
        Payloads(Kept::weighing((PAYLOAD_BYTES_CACHED / 1500) as usize, PAYLOAD_BYTES_CACHED, ByBytes))
    }

    /// Drops what nobody asked for lately.
    pub fn sweep(&self) {
        self.0.sweep();
    }
}

impl Snapshot {
    /// The vertices of a patch, packed as `docs/payload.md` draws. Some 50 microseconds a patch where its samples are at hand,
    /// next to nothing where it was asked for lately, whichever version it was asked of.
    pub fn payload(&self, r: &Record) -> Result<Bytes> {
        if let Some(b) = self.view.caches.payloads.0.get(&r.id) {
            return Ok(b);
        }
        let packed = self.view.with_samples(r.survey, |reader| {
            let z = reader.vertices(self.kind(), r.place)?;
            Ok(vertices::pack(&z, reader.declaration.scale, reader.declaration.offset))
        })?;
        let packed = Bytes::from(packed);
        self.view.caches.payloads.0.insert(r.id, packed.clone());
        Ok(packed)
    }
}
