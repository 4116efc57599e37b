//! Any bytes and any valid message as a request to any method: a status or an answer, never a panic, and little memory.
//!
//! Requests go through the whole service in this process, without sockets. `fuzz/fuzz_targets/requests.rs` drives the same
//! code with the fuzzer.

#[path = "requests/caller.rs"]
mod caller;
#[path = "requests/messages.rs"]
mod messages;

use caller::Caller;
use messages::{Facts, message, methods};

/// Seconds of random requests in the default run. TERRAQUILT_FUZZ_SECONDS=600 runs ten minutes of each.
fn seconds() -> u64 {
    std::env::var("TERRAQUILT_FUZZ_SECONDS").ok().and_then(|s| s.parse().ok()).unwrap_or(6)
}

fn bytes(seed: &mut u64, len: usize) -> Vec<u8> {
    (0..len)
        .map(|_| {
            *seed ^= *seed << 13;
            *seed ^= *seed >> 7;
            *seed ^= *seed << 17;
            (*seed >> 32) as u8
        })
        .collect()
}

fn peak_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:")).unwrap_or("0");
    line.trim().trim_end_matches(" kB").trim().parse().unwrap_or(0)
}

/// Requests until time is up; prints how they ended.
fn endure(what: &str, mut request: impl FnMut(&Caller, &str, &mut u64) -> Vec<Vec<u8>>) {
    let caller = Caller::new();
    let all = methods();
    let mut seed = std::env::var("TERRAQUILT_SEED").ok().and_then(|s| s.parse().ok()).unwrap_or(0x5eed);
    println!("seed {seed}; TERRAQUILT_SEED=n runs another");
    let until = std::time::Instant::now() + std::time::Duration::from_secs(seconds());
    let mut ends = std::collections::BTreeMap::<String, u64>::new();
    let before = peak_kib();
    let mut k = 0;
    while std::time::Instant::now() < until {
        let method = &all[k % all.len()];
        k += 1;
        let was = seed;
        let sent = request(&caller, method, &mut seed);
        let end = caller.call(method, &sent);
        assert_ne!(end.code, Some(tonic::Code::Internal), "{method}, state {was}: {}", end.message);
        assert_ne!(end.code, Some(tonic::Code::Unimplemented), "{method}: {}", end.message);
        *ends.entry(format!("{:?}", end.code)).or_default() += 1;
    }
    println!("{what}: {k} requests, {ends:?}, peak {} MiB more", peak_kib().saturating_sub(before) / 1024);
    assert!(peak_kib().saturating_sub(before) < 1 << 20, "more than a GiB for small requests");
}

#[test]
fn any_bytes_are_a_status() {
    endure("bytes", |_, _, seed| {
        let n = bytes(seed, 1)[0] as usize % 3;
        (0..=n)
            .map(|_| {
                let len = bytes(seed, 1)[0] as usize;
                bytes(seed, len)
            })
            .collect()
    });
}

#[test]
fn any_valid_message_is_answered_or_refused() {
    endure("messages", |caller, method, seed| {
        let facts = Facts { names: &caller.names, bounds: caller.bounds };
        let n = bytes(seed, 1)[0] as usize % 4;
        (0..=n)
            .map(|_| {
                let raw = bytes(seed, 2048);
                message(method, &facts, &mut arbitrary::Unstructured::new(&raw)).unwrap_or_default()
            })
            .collect()
    });
}
