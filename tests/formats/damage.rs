//! Cut and flipped files of every format: an error or samples; no panic, no hang, no huge allocation, and no survey
//! that is half there.

use super::table::{GOOD, REFUSED};
use super::{Random, shared};
use crate::support::{Scratch, change};
use std::path::Path;
use std::time::{Duration, Instant};
use terraquilt::base::Error;
use terraquilt::db::{Change, Ingest, Policy};
use terraquilt::format::{open, open_bytes_beside};
use terraquilt::height::source::Window;

/// What may lie beside the grids: it is damaged, too.
const SIDECARS: &[&str] = &["ehdr.hdr", "ehdr.prj", "envi.hdr"];

fn bytes_of(name: &str) -> Vec<u8> {
    std::fs::read(shared(&format!("difficult/{name}")).unwrap()).unwrap()
}

/// Opens a file and reads its start and its end; whether both went well.
fn endured(name: &str, bytes: Vec<u8>, beside: &[(String, Vec<u8>)]) -> bool {
    let began = Instant::now();
    let read = || -> Result<(), Error> {
        let mut source = open_bytes_beside(name, bytes, beside.to_vec())?;
        let info = source.info().clone();
        let (cols, rows) = (info.cols.min(2048) as usize, info.rows.min(512) as usize);
        for (col, row) in [(0, 0), (info.cols - cols as u64, info.rows - rows as u64)] {
            let s = source.read(Window { col, row, cols, rows })?;
            assert_eq!((s.valid.len(), s.data.len()), (cols * rows, cols * rows * info.sample_type.bytes()));
        }
        Ok(())
    };
    let result = read();
    assert!(began.elapsed() < Duration::from_secs(20), "{name}: {:?}", began.elapsed());
    if let Err(e) = &result {
        assert!(!e.to_string().contains('\n') && e.to_string().len() < 1000, "{e}");
    }
    result.is_ok()
}

/// Cuts and flips every difficult file, and the header of those that have one.
fn damage_all(cuts: usize, flips: usize, seed: u64) {
    println!("seed {seed}");
    let mut random = Random(seed);
    let Some(_) = shared("difficult") else { return };
    let beside: Vec<(String, Vec<u8>)> = SIDECARS.iter().map(|n| (n.to_string(), bytes_of(n))).collect();
    let (mut read, mut refused) = (0, 0);
    let mut count = |ok: bool| if ok { read += 1 } else { refused += 1 };
    for name in GOOD.iter().map(|g| g.0).chain(REFUSED.iter().map(|r| r.0)) {
        let good = bytes_of(name);
        if good.is_empty() {
            continue;
        }
        for round in 0..cuts + flips {
            let bytes = if round < cuts {
                good[..random.below(good.len())].to_vec()
            } else {
                flipped(&good, &mut random)
            };
            count(endured(name, bytes, &beside));
        }
        let stem = name.split('.').next().unwrap();
        for k in (0..beside.len()).filter(|k| beside[*k].0.split('.').next() == Some(stem)) {
            for round in 0..cuts + flips {
                let mut around = beside.clone();
                let text = &beside[k].1;
                around[k].1 = if round < cuts {
                    text[..random.below(text.len())].to_vec()
                } else {
                    flipped(text, &mut random)
                };
                count(endured(name, good.clone(), &around));
            }
        }
    }
    println!("{read} read, {refused} refused");
    assert!(read > 0 && refused > 0);
}

/// One byte changed; every second time where headers, directories and tables lie.
fn flipped(good: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = good.to_vec();
    let n = bytes.len();
    let at = match random.below(4) {
        0 => random.below(n.min(4096)),
        1 => n - 1 - random.below(n.min(600)),
        _ => random.below(n),
    };
    bytes[at] = match random.below(3) {
        0 => bytes[at] ^ (1 << random.below(8)),
        1 => b"09-., \0\xff"[random.below(8)],
        _ => random.next() as u8,
    };
    bytes
}

#[test]
fn cut_and_flipped_files_never_panic() {
    damage_all(2, 5, 20260101);
}

/// 50 cuts and 200 flips of each file, and the most memory that took. By itself, since memory is of the process:
/// `cargo test --test main formats::damage::every_file -- --ignored --nocapture`
#[test]
#[ignore = "minutes; the command is in its comment"]
fn every_file_cut_50_times_and_flipped_200_times() {
    for seed in crate::support::seeds(1) {
        damage_all(50, 200, 20260101 + seed);
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let Some(peak) = peak.and_then(|l| l.trim().trim_end_matches(" kB").parse::<u64>().ok()) else { return };
    println!("peak memory {} MB", peak / 1024);
    assert!(peak < 1 << 20, "peak memory {peak} kB");
}

#[test]
fn a_damaged_file_leaves_no_survey_behind() {
    let Some(_) = shared("difficult") else { return };
    let scratch = Scratch::new(Policy::Accuracy);
    let folder = scratch.folder.path();
    for name in SIDECARS {
        std::fs::write(folder.join(name), bytes_of(name)).unwrap();
    }
    let ingest = |path: &Path, name: &str| {
        let sources = vec![open(path)?];
        let request = Ingest {
            name: Some(name.to_string()),
            accuracy_m: Some(1.0),
            crs: Some(scratch.db.crs().clone()),
            ..Ingest::new(sources)
        };
        change(&scratch.db, Change::Ingest(request))
    };
    let mut random = Random(77);
    let (mut made, mut refused) = (0, 0);
    for name in [
        "dx_dy.asc",
        "wrapped_sci.asc",
        "ehdr.flt",
        "envi.bil",
        "everest.dt0",
        "everest_usgs.dem",
        "int16_lzma.tif",
    ] {
        let good = bytes_of(name);
        let path = folder.join(name);
        for round in 0..4 {
            let half = good.len() / 2;
            let bytes = if round == 0 {
                good[..half + random.below(half)].to_vec()
            } else {
                flipped(&good, &mut random)
            };
            std::fs::write(&path, bytes).unwrap();
            let before = scratch.fingerprint();
            match ingest(&path, &format!("{name} {round}")) {
                Ok(_) => made += 1,
                Err(e) => {
                    refused += 1;
                    assert_eq!(scratch.fingerprint(), before, "{e}");
                }
            }
        }
    }
    println!("{made} surveys made, {refused} files refused");
    assert!(made > 0 && refused > 6);
    scratch.verify();
}
