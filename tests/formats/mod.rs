//! Reading other people's files and writing GeoTIFF: every difficult file, damage of all kinds, round trips.

/// Zip archives.
mod archives;
/// Cut and flipped files of every format.
mod damage;
/// Where posts lie, and what a user is told.
mod place;
/// What lies beside a grid: headers, world files, `.prj`.
mod sidecars;
/// Triangle meshes: PLY, GLB, glTF.
mod solids;
/// Every file of the difficult data: read as GDAL reads it, or refused.
mod table;
/// Text formats: Esri ASCII grids, USGS DEM.
mod text;
/// GeoTIFF as it is written here, and lies about it.
mod written;

use std::path::PathBuf;
use terraquilt::base::Error;
use terraquilt::format::open_bytes;
use terraquilt::height::source::{HeightSource, Samples, Window};

/// A file of the shared data, or None (with a message) where they are absent.
fn shared(path: &str) -> Option<PathBuf> {
    crate::support::shared(path)
}

fn fnv(parts: [&[u8]; 2]) -> u64 {
    let bytes = parts.into_iter().flatten();
    bytes.fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3))
}

/// Everything, in the source's own batches of rows.
fn read_all(source: &mut dyn HeightSource) -> Result<Samples, Error> {
    let (cols, rows) = (source.info().cols as usize, source.info().rows);
    let mut all = Samples { cols, rows: rows as usize, ..Samples::default() };
    let mut row = 0;
    while row < rows {
        let batch = (rows - row).min(source.row_batch() as u64) as usize;
        let part = source.read(Window { col: 0, row, cols, rows: batch })?;
        assert_eq!(part.data.len(), cols * batch * source.info().sample_type.bytes());
        assert_eq!(part.valid.len(), cols * batch);
        all.data.extend(part.data);
        all.valid.extend(part.valid);
        row += batch as u64;
    }
    Ok(all)
}

/// Windows of all sizes hold what the whole holds.
fn check_windows(source: &mut dyn HeightSource, all: &Samples, random: &mut Random) {
    let width = source.info().sample_type.bytes();
    for _ in 0..20 {
        let (col, row) = (random.below(all.cols), random.below(all.rows));
        let (cols, rows) = (1 + random.below(all.cols - col), 1 + random.below(all.rows - row));
        let part = source.read(Window { col: col as u64, row: row as u64, cols, rows }).unwrap();
        for r in 0..rows {
            let at = (row + r) * all.cols + col;
            assert_eq!(part.valid[r * cols..][..cols], all.valid[at..][..cols]);
            assert_eq!(part.data[r * cols * width..][..cols * width], all.data[at * width..][..cols * width]);
        }
    }
    let (cols, rows) = (all.cols as u64, all.rows as u64);
    for (col, row) in [(cols, 0), (0, rows), (u64::MAX, 0), (0, u64::MAX)] {
        assert!(source.read(Window { col, row, cols: 1, rows: 1 }).is_err());
    }
    assert!(source.read(Window { col: 0, row: 0, cols: usize::MAX, rows: 1 }).is_err());
    assert!(source.read(Window { col: cols, row: 0, cols: 0, rows: 1 }).unwrap().data.is_empty());
}

/// xorshift64*; the seed is printed by the test that fails.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }
    fn below(&mut self, n: usize) -> usize {
        (self.next() >> 16) as usize % n
    }
}

/// Opens and reads what may be anything; only a panic, a hang or a huge allocation is wrong.
fn endure(name: &str, bytes: Vec<u8>) -> bool {
    let Ok(mut source) = open_bytes(name, bytes) else { return false };
    // A header may honestly claim a large sparse grid: look at its start and its end only.
    let info = source.info().clone();
    let cols = info.cols.min(2048) as usize;
    let rows = info.rows.min(512) as usize;
    let start = source.read(Window { col: 0, row: 0, cols, rows });
    let (col, row) = (info.cols - cols as u64, info.rows - rows as u64);
    let end = source.read(Window { col, row, cols, rows });
    start.is_ok() && end.is_ok()
}

/// A few bytes changed, most of them where headers and directories lie.
fn damaged(good: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = good.to_vec();
    for _ in 0..1 + random.below(4) {
        let n = bytes.len();
        let at = match random.below(3) {
            0 => random.below(n),
            1 => random.below(n.min(400)),
            _ => n - 1 - random.below(n.min(600)),
        };
        bytes[at] = match random.below(3) {
            0 => bytes[at] ^ (1 << random.below(8)),
            1 => [0, 1, 0x7f, 0xff][random.below(4)],
            _ => random.next() as u8,
        };
    }
    bytes
}
