//! Mixed load at a bounded rate: does the server's memory grow, do its file handles, does any call fail?
//!
//! `cargo run --release --example soak -- [--minutes 60] [--settle 10]`
//!
//! The server is a process of its own on loopback. Four views fly, two clients ask for patches and one for heights, one exports
//! files, and every few seconds a small survey arrives while the oldest of those before goes; what only old versions read is
//! pruned. Every 10 s the resident memory and the open handles of the server are read from `/proc`.
//!
//! Growth is judged after the settling time, by quarters of what is left: the mean of the last quarter may lie above that of the
//! first by 5 % and 8 MiB at most, the most handles of the last quarter above the most of the first by 4. Exits with 1 if
//! something grew or a call failed.

// Each of the two examples uses a part of it.
#[allow(dead_code)]
mod load;

use clap::Parser;
use load::{Flight, Server, Survey, constant, create, ground, serve};
use std::collections::VecDeque;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use terraquilt::base::{Error, Result};
use terraquilt::client::view::{Opening, View};
use terraquilt::client::{Connection, catalog, heights};
use terraquilt::wire::v1;

/// How long, and how much of it counts.
#[derive(Parser)]
struct Args {
    /// How long the load lasts
    #[arg(long, default_value_t = 60.0)]
    minutes: f64,
    /// Until memory and handles should have settled
    #[arg(long, default_value_t = 10.0)]
    settle: f64,
    /// Leave exports out
    #[arg(long)]
    no_exports: bool,
}

const SAMPLE_EVERY: Duration = Duration::from_secs(10);
/// What is allowed between the first and the last quarter.
const GROWTH: f64 = 1.05;
const GROWTH_BYTES: f64 = (8 << 20) as f64;
const HANDLES: u64 = 4;
/// Small surveys that are there at once, and versions that are kept.
const SMALL: usize = 6;
const VERSIONS_KEPT: u64 = 8;

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().collect();
    let done = match args.get(1).map(String::as_str) {
        Some(load::SERVE) => serve(&args[2]).map(|()| true),
        _ => soak(&Args::parse()),
    };
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(e) => {
            eprintln!("error: {e}");
            ExitCode::from(1)
        }
    }
}

/// What the clients did.
#[derive(Default)]
struct Done {
    steps: AtomicU64,
    queries: AtomicU64,
    heights: AtomicU64,
    exports: AtomicU64,
    commits: AtomicU64,
}

fn count(n: &AtomicU64) {
    n.fetch_add(1, Ordering::Relaxed);
}

/// A state of the server's process.
struct Sample {
    minute: f64,
    bytes: u64,
    handles: u64,
}

fn sample(server: u32, minute: f64) -> Result<Sample> {
    let io = |e: std::io::Error| Error::invalid("the server's process", format!("{e}; has it ended?"));
    let status = std::fs::read_to_string(format!("/proc/{server}/status")).map_err(io)?;
    let kib =
        status.lines().find_map(|l| l.strip_prefix("VmRSS:")?.trim().split(' ').next()?.parse::<u64>().ok());
    let bytes = kib.ok_or_else(|| Error::invalid("the server's process", "has ended"))? << 10;
    let handles = std::fs::read_dir(format!("/proc/{server}/fd")).map_err(io)?.count() as u64;
    Ok(Sample { minute, bytes, handles })
}

async fn fly(c: Connection, k: usize, done: Arc<Done>) -> Result<()> {
    let flight = Flight::new(&ground(&c).await?, k, 10.0);
    let opening = Opening { tolerance: Some(flight.at(0)), ..Opening::default() };
    let mut view = View::open(&c, opening.clone()).await?;
    let mut pace = tokio::time::interval(Duration::from_millis(100));
    for frame in 1.. {
        pace.tick().await;
        let number = view.steer(None, flight.at(frame)).await?;
        while view.next().await?.answers < number {}
        count(&done.steps);
        // Now and then a client begins anew, or comes back.
        if frame % 900 == 0 {
            view = View::open(&c, opening.clone()).await?;
            view.next().await?;
        } else if frame % 300 == 0 {
            view = view.resume(&c, Some((None, flight.at(frame)))).await?;
            view.next().await?;
        }
    }
    Ok(())
}

/// A box inside the ground, other ones in turn.
fn part(here: &v1::Ground, k: u64, side: f64) -> v1::Region {
    let b = here.bounds.unwrap_or_default();
    let at = |k: u64| (k as f64 * 0.618_033_988) % 1.0;
    let (x, y) =
        (b.xmin + at(k) * (b.xmax - b.xmin - side), b.ymin + at(3 * k + 1) * (b.ymax - b.ymin - side));
    v1::Region {
        kind: Some(v1::region::Kind::Box(v1::Box { xmin: x, ymin: y, xmax: x + side, ymax: y + side })),
    }
}

async fn query(c: Connection, first: u64, done: Arc<Done>) -> Result<()> {
    let here = ground(&c).await?;
    let mut pace = tokio::time::interval(Duration::from_millis(1000));
    for k in first.. {
        pace.tick().await;
        let ask = v1::PatchesRequest {
            region: Some(part(&here, k, 2000.0)),
            tolerance: Some(constant(0.5 + (k % 20) as f64)),
            ..v1::PatchesRequest::default()
        };
        let mut stream = c.query().patches(ask).await.map_err(|s| c.failed(s))?.into_inner();
        while stream.message().await.map_err(|s| c.failed(s))?.is_some() {}
        count(&done.queries);
    }
    Ok(())
}

async fn sound(c: Connection, done: Arc<Done>) -> Result<()> {
    let here = ground(&c).await?;
    let b = here.bounds.unwrap_or_default();
    let mut pace = tokio::time::interval(Duration::from_millis(250));
    for k in 0u64.. {
        pace.tick().await;
        let at = |n: u64| ((k * 95 + n) as f64 * 0.618_033_988) % 1.0;
        let points: Vec<[f64; 2]> = (0..95)
            .map(|n| [b.xmin + at(n) * (b.xmax - b.xmin), b.ymin + at(2 * n + 1) * (b.ymax - b.ymin)])
            .collect();
        let header = v1::HeightsHeader { tolerance: Some(constant(0.0)), ..v1::HeightsHeader::default() };
        heights::points(&c, header, &points).await?;
        count(&done.heights);
    }
    Ok(())
}

async fn export(c: Connection, done: Arc<Done>) -> Result<()> {
    use v1::file_request::Format;
    let here = ground(&c).await?;
    let mut pace = tokio::time::interval(Duration::from_secs(15));
    for k in 0u64.. {
        pace.tick().await;
        let ask = v1::FileRequest {
            format: [Format::Geotiff, Format::Glb, Format::Png][k as usize % 3] as i32,
            region: Some(part(&here, k, 1000.0)),
            tolerance: Some(constant(2.0)),
            ..v1::FileRequest::default()
        };
        let mut stream = c.export().file(ask).await.map_err(|s| c.failed(s))?.into_inner();
        while stream.message().await.map_err(|s| c.failed(s))?.is_some() {}
        count(&done.exports);
    }
    Ok(())
}

/// Small surveys come and go; old versions are pruned.
async fn change(c: Connection, done: Arc<Done>) -> Result<()> {
    let mut there = VecDeque::new();
    let mut pace = tokio::time::interval(Duration::from_secs(5));
    for k in 0u64.. {
        pace.tick().await;
        let name = format!("small {k}");
        let offset = [500.0 + (k % 7) as f64 * 1000.0, 700.0 + (k % 5) as f64 * 1300.0];
        Survey::mountains(&name, 129, 5.0, offset, k).send(&c).await?;
        count(&done.commits);
        there.push_back(name);
        if there.len() > SMALL
            && let Some(old) = there.pop_front()
        {
            catalog::remove(&c, v1::RemoveRequest { surveys: vec![old], ..v1::RemoveRequest::default() })
                .await?;
            count(&done.commits);
        }
        if k % 12 == 11 {
            catalog::prune(&c, v1::prune_request::What::Keep(VERSIONS_KEPT)).await?;
        }
    }
    Ok(())
}

fn soak(args: &Args) -> Result<bool> {
    let folder = tempfile::tempdir().map_err(|e| Error::invalid("temporary folder", e))?;
    let path = folder.path().join("db");
    create(&path)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(|e| Error::invalid("threads", e))?;
    runtime.block_on(async {
        let server = Server::start(&path)?;
        Survey::mountains("base", 1025, 10.0, [0.0, 0.0], 0).send(&server.connect().await?).await?;
        let done = Arc::new(Done::default());
        let mut load = tokio::task::JoinSet::new();
        for k in 0..4 {
            load.spawn(fly(server.connect().await?, k, done.clone()));
        }
        for k in 0..2 {
            load.spawn(query(server.connect().await?, 1000 * k, done.clone()));
        }
        load.spawn(sound(server.connect().await?, done.clone()));
        if !args.no_exports {
            load.spawn(export(server.connect().await?, done.clone()));
        }
        load.spawn(change(server.connect().await?, done.clone()));
        let begun = Instant::now();
        let mut pace = tokio::time::interval(SAMPLE_EVERY);
        let mut samples: Vec<Sample> = Vec::new();
        println!("minute   MiB  handles    steps  queries  heights  exports  commits");
        while begun.elapsed().as_secs_f64() < args.minutes * 60.0 {
            tokio::select! {
                ended = load.join_next() => {
                    let why = match ended {
                        Some(Ok(Err(e))) => e.to_string(),
                        Some(Err(e)) => e.to_string(),
                        _ => "a client ended".to_string(),
                    };
                    println!("minute {:.1}: a call failed: {why}", begun.elapsed().as_secs_f64() / 60.0);
                    return Ok(false);
                }
                _ = pace.tick() => {
                    let s = sample(server.id(), begun.elapsed().as_secs_f64() / 60.0)?;
                    let n = |n: &AtomicU64| n.load(Ordering::Relaxed);
                    println!(
                        "{:6.1} {:5.0} {:8} {:8} {:8} {:8} {:8} {:8}",
                        s.minute, s.bytes as f64 / f64::from(1 << 20), s.handles,
                        n(&done.steps), n(&done.queries), n(&done.heights), n(&done.exports), n(&done.commits)
                    );
                    samples.push(s);
                }
            }
        }
        Ok(judge(&samples, args.settle))
    })
}

fn judge(samples: &[Sample], settle: f64) -> bool {
    let after: Vec<&Sample> = samples.iter().filter(|s| s.minute >= settle).collect();
    if after.len() < 8 {
        println!("no call failed; too short to judge growth: {} samples after minute {settle}", after.len());
        return true;
    }
    let quarter = after.len() / 4;
    let (first, last) = (&after[..quarter], &after[after.len() - quarter..]);
    let mean = |s: &[&Sample]| s.iter().map(|s| s.bytes as f64).sum::<f64>() / s.len() as f64;
    let most = |s: &[&Sample]| s.iter().map(|s| s.handles).max().unwrap_or(0);
    let mib = |b: f64| b / f64::from(1 << 20);
    let (a, b) = (mean(first), mean(last));
    let grew = b > a * GROWTH + GROWTH_BYTES || most(last) > most(first) + HANDLES;
    println!(
        "after minute {settle}: mean of the first quarter {:.1} MiB, of the last {:.1} MiB; most handles {} and {}: {}",
        mib(a),
        mib(b),
        most(first),
        most(last),
        if grew { "GREW" } else { "no growth, no call failed" }
    );
    !grew
}
