//! How long a view, a height, a first patch takes: client and server on loopback, each in a process of its own.
//!
//! `cargo run --release --example latency -- [--grid FILE] [--seconds N]`
//!
//! Without a file it makes up 20 km of mountains, 10 m from post to post; a file is a GeoTIFF in UTM 11. Prints a table;
//! exits with 1 if a limit was missed: of 10 clients' steps 99 % within 16 ms, and within 33 ms while surveys of 1025 x 1025 posts
//! arrive, one after the other without a pause.

// Each of the two examples uses a part of it.
#[allow(dead_code)]
mod load;

use clap::Parser;
use load::{Flight, Server, Survey, constant, create, ground, serve};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use terraquilt::base::{Error, Result};
use terraquilt::client::view::{Opening, View};
use terraquilt::client::{Connection, catalog, heights};
use terraquilt::wire::v1;
use tokio::sync::Barrier;
use tokio::time::{MissedTickBehavior, interval_at};

/// What is measured.
#[derive(Parser)]
struct Args {
    /// Ground to look at: a GeoTIFF in UTM 11
    #[arg(long)]
    grid: Option<PathBuf>,
    /// How long each number of clients is measured
    #[arg(long, default_value_t = 15)]
    seconds: u64,
    /// Numbers of clients
    #[arg(long, value_delimiter = ',', default_value = "1,10,100")]
    clients: Vec<usize>,
}

/// Steps a second of every view.
const RATE: f64 = 60.0;
/// Limits for the 99th percentile with ten clients, ms.
const IDLE_MS: f64 = 16.0;
const ARRIVING_MS: f64 = 33.0;
/// Posts of one side of a survey that arrives, and the metres from one to the next.
const POSTS: u64 = 1025;
const STEP: f64 = 5.0;

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().collect();
    let done = match args.get(1).map(String::as_str) {
        Some(load::SERVE) => serve(&args[2]).map(|()| true),
        _ => measure(&Args::parse()),
    };
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(e) => {
            eprintln!("error: {e}");
            ExitCode::from(2)
        }
    }
}

/// Times in milliseconds, ascending.
struct Times(Vec<f64>);

impl Times {
    fn new(mut ms: Vec<f64>) -> Times {
        ms.sort_by(f64::total_cmp);
        Times(ms)
    }

    fn mean(&self) -> f64 {
        self.0.iter().sum::<f64>() / self.0.len() as f64
    }

    fn share(&self, p: f64) -> f64 {
        let n = self.0.len();
        self.0.get(((n as f64 * p) as usize).min(n.saturating_sub(1))).copied().unwrap_or(f64::NAN)
    }
}

fn ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

/// One view that moves at [`RATE`] until told to stop, from when all are open. A step lasts from when it was due until its difference is applied; where
/// one lasts longer than a frame, the frames that were due meanwhile are left out and counted.
async fn fly(
    c: Connection,
    flight: Flight,
    k: usize,
    opened: Arc<Barrier>,
    stop: Arc<AtomicBool>,
    late: Arc<AtomicU64>,
) -> Result<(Vec<f64>, usize)> {
    let opening = Opening { tolerance: Some(flight.at(0)), ..Opening::default() };
    let view = async {
        let mut view = View::open(&c, opening).await?;
        view.next().await.map(|_| view)
    };
    let view = view.await;
    // The others wait for it also where it failed.
    opened.wait().await;
    let mut view = view?;
    let frame = Duration::from_secs_f64(1.0 / RATE);
    let begin = tokio::time::Instant::now() + frame.mul_f64(k as f64 * 0.618 % 1.0) + frame;
    let mut ticks = interval_at(begin, frame);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut times = Vec::new();
    let mut last = 0;
    while !stop.load(Ordering::Relaxed) {
        let due = ticks.tick().await;
        let n = ((due - begin).as_secs_f64() * RATE).round() as u64 + 1;
        late.fetch_add(n - last - 1, Ordering::Relaxed);
        last = n;
        let number = view.steer(None, flight.at(n)).await?;
        // A step that changes nothing is answered, too.
        while view.next().await?.answers < number {}
        times.push(due.elapsed().as_secs_f64() * 1e3);
    }
    Ok((times, view.set.patches.len()))
}

/// Steps of `n` views, until `until` is over. Times, patches of a view, frames left out.
async fn steps<T>(
    server: &Server,
    n: usize,
    until: impl Future<Output = Result<T>>,
) -> Result<(Times, usize, u64, T)> {
    let here = ground(&server.connect().await?).await?;
    let (stop, late) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let opened = Arc::new(Barrier::new(n + 1));
    let mut views = Vec::new();
    for k in 0..n {
        let flight = Flight::new(&here, k, 10.0);
        let c = server.connect().await?;
        views.push(tokio::spawn(fly(c, flight, k, opened.clone(), stop.clone(), late.clone())));
    }
    opened.wait().await;
    let waited = until.await;
    stop.store(true, Ordering::Relaxed);
    let (mut times, mut patches) = (Vec::new(), 0);
    for v in views {
        let (t, held) = v.await.map_err(|e| Error::invalid("a view", e))??;
        times.extend(t);
        patches += held;
    }
    Ok((Times::new(times), patches / n, late.load(Ordering::Relaxed), waited?))
}

fn row(what: &str, t: &Times, rest: &str) {
    println!("{what:44} {:>8.2} {:>8.2} {:>8.2}   {rest}", t.share(0.5), t.share(0.99), t.share(1.0));
}

fn measure(args: &Args) -> Result<bool> {
    let folder = tempfile::tempdir().map_err(|e| Error::invalid("temporary folder", e))?;
    let path = folder.path().join("db");
    create(&path)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|e| Error::invalid("threads", e))?;
    runtime.block_on(async {
        let mut server = Server::start(&path)?;
        let base = match &args.grid {
            Some(file) => Survey::of_file(file)?,
            None => Survey::mountains("base", 2049, 10.0, [0.0, 0.0], 0),
        };
        let begun = Instant::now();
        base.send(&server.connect().await?).await?;
        println!(
            "{} posts uploaded and committed in {:.1} s",
            base.header.grids[0].cols * base.header.grids[0].rows,
            begun.elapsed().as_secs_f64()
        );
        let here = ground(&server.connect().await?).await?;
        println!("{:44} {:>8} {:>8} {:>8}", "", "p50 ms", "p99 ms", "max ms");
        let mut good = true;
        for &n in &args.clients {
            let (t, patches, late, ()) = steps(&server, n, async {
                tokio::time::sleep(Duration::from_secs(args.seconds)).await;
                Ok(())
            })
            .await?;
            row(&format!("step of a view, {n} clients"), &t, &told(&t, patches, late, args.seconds as f64));
            good &= n != 10 || t.share(0.99) <= IDLE_MS;
        }
        let arriving = arriving(&here);
        for &n in &args.clients {
            let c = server.connect().await?;
            let until = arrive(&c, &arriving, n, Duration::from_secs(args.seconds));
            let begun = Instant::now();
            let (t, patches, late, took) = steps(&server, n, until).await?;
            let rest = told(&t, patches, late, begun.elapsed().as_secs_f64());
            let what =
                format!("step, {n} clients, {} x {POSTS}^2 arrive, {:.1} s each", took.0.len(), took.mean());
            row(&what, &t, &rest);
            good &= n != 10 || t.share(0.99) <= ARRIVING_MS;
            catalog::remove(&c, v1::RemoveRequest { surveys: names(n, took.0.len()), ..Default::default() })
                .await?;
        }
        row(
            "heights at 95 points, one call",
            &Times::new(points(&server.connect().await?, &here).await?),
            "",
        );
        let mut first = Vec::new();
        for k in 0..10 {
            server = Server::start(&path)?;
            first.push(first_patch(&server, &here, k).await?);
        }
        row("first patch, server just started", &Times::new(first), "");
        drop(server);
        println!("{}", if good { "limits met" } else { "LIMITS MISSED" });
        Ok(good)
    })
}

fn told(t: &Times, patches: usize, late: u64, seconds: f64) -> String {
    format!(
        "{} steps ({:.0} a second), {late} frames left out, {patches} patches a view",
        t.0.len(),
        t.0.len() as f64 / seconds
    )
}

/// Surveys around the middle of the ground, each in a place of its own.
fn arriving(here: &v1::Ground) -> Vec<Survey> {
    let b = here.bounds.unwrap_or_default();
    let side = (POSTS - 1) as f64 * STEP;
    let place = |k: u64| {
        let (i, j) = ((k % 3) as f64 - 1.5, (k / 3) as f64 - 1.5);
        let middle = [(b.xmin + b.xmax) / 2.0 - load::CORNER[0], load::CORNER[1] - (b.ymin + b.ymax) / 2.0];
        [middle[0] + i * side, middle[1] + j * side]
    };
    (0..9).map(|k| Survey::mountains("arrival", POSTS, STEP, place(k), k + 1)).collect()
}

fn names(clients: usize, arrivals: usize) -> Vec<String> {
    (0..arrivals).map(|k| format!("arrival {k} beside {clients}")).collect()
}

/// Surveys arrive one after the other. The seconds that each took.
async fn arrive(c: &Connection, surveys: &[Survey], clients: usize, until: Duration) -> Result<Times> {
    let begun = Instant::now();
    let mut times = Vec::new();
    while begun.elapsed() < until {
        let k = times.len();
        let sent = Instant::now();
        let name = format!("arrival {k} beside {clients}");
        surveys[k % surveys.len()].named(&name).send(c).await?;
        times.push(sent.elapsed().as_secs_f64());
    }
    Ok(Times(times))
}

async fn points(c: &Connection, here: &v1::Ground) -> Result<Vec<f64>> {
    let b = here.bounds.unwrap_or_default();
    let mut times = Vec::new();
    for k in 0..200 {
        let start =
            [b.xmin + (b.xmax - b.xmin) * (0.1 + 0.003 * f64::from(k)), b.ymin + (b.ymax - b.ymin) * 0.4];
        let line: Vec<[f64; 2]> =
            (0..95).map(|n| [start[0] + 20.0 * f64::from(n), start[1] + 15.0 * f64::from(n)]).collect();
        let header = v1::HeightsHeader { tolerance: Some(constant(0.0)), ..v1::HeightsHeader::default() };
        let begun = Instant::now();
        heights::points(c, header, &line).await?;
        times.push(ms(begun));
    }
    Ok(times)
}

/// Asks for what a camera sees; the time until the first message with a patch.
async fn first_patch(server: &Server, here: &v1::Ground, k: usize) -> Result<f64> {
    let c = server.connect().await?;
    let ask = v1::PatchesRequest {
        tolerance: Some(Flight::new(here, k, 10.0).at(0)),
        ..v1::PatchesRequest::default()
    };
    let begun = Instant::now();
    let mut stream = c.query().patches(ask).await.map_err(|s| c.failed(s))?.into_inner();
    while let Some(m) = stream.message().await.map_err(|s| c.failed(s))? {
        if let Some(v1::patches_reply::Kind::Part(p)) = m.kind
            && !p.patches.is_empty()
        {
            return Ok(ms(begun));
        }
    }
    Err(Error::invalid(Path::new("server").display(), "sent no patch"))
}
