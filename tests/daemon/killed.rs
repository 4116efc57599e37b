//! The server is killed with signal 9 at random moments while surveys are streamed in: what was acknowledged is there, what
//! had arrived is not sent again, every upload is finished by its client, and nothing is left lying about.

use super::support::empty;
use super::survey::{Survey, bundled, hills, offline, offline_hills, print};
use std::collections::{BTreeMap, BTreeSet};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use terraquilt::base::Result;
use terraquilt::client::ingest::{InMemory, Rows, Sending, upload};
use terraquilt::client::{Address, Connection};
use terraquilt::db::{Db, Progress, verify};
use terraquilt::store::catalog::{Catalog, Sqlite, Uploads};
use terraquilt::store::record::record_name;
use terraquilt::store::segment::file_name;
use terraquilt::wire::v1::{self, operation_status::State};

/// A small generator (xorshift64*).
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Starts the program and waits until it listens.
fn serve(db: &Path, at: SocketAddr) -> Child {
    let started = Instant::now();
    loop {
        let mut child = Command::new(env!("CARGO_BIN_EXE_terraquilt"))
            .arg("serve")
            .arg(db)
            .args(["--listen", &at.to_string()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        // It ends by itself if it cannot have the port.
        while child.try_wait().unwrap().is_none() {
            if TcpStream::connect(at).is_ok() {
                return child;
            }
            assert!(started.elapsed() < Duration::from_secs(60), "no server listens on {at}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// Rows that come slowly, as over a thin line, and are counted.
struct Slow {
    rows: InMemory,
    random: Random,
    sent: Arc<AtomicU64>,
}

impl Rows for Slow {
    fn read(&mut self, grid: usize, row: u64, rows: u64, out: &mut Vec<u8>) -> Result<()> {
        std::thread::sleep(Duration::from_micros((self.random.unit() * 8e3) as u64));
        self.sent.fetch_add(rows, Relaxed);
        self.rows.read(grid, row, rows, out)
    }
    fn batch(&self, _: usize) -> u64 {
        1
    }
}

/// Files that no version names, and what is left of uploads.
fn leftovers(db: &Path) -> Vec<String> {
    let catalog = Sqlite::open_read_only(&db.join("catalog.sqlite")).unwrap();
    let segments = catalog.all_files().unwrap().into_iter().map(|(n, _)| file_name(n));
    let records = catalog.versions().unwrap().into_iter().map(|v| record_name(v.number));
    let named: BTreeSet<String> = segments.chain(records).collect();
    let names = |folder: &str| -> Vec<String> {
        let entries = std::fs::read_dir(db.join(folder)).unwrap();
        entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    };
    let mut out: Vec<String> = names("segments").into_iter().filter(|n| !named.contains(n)).collect();
    out.extend(names("uploads").into_iter().filter(|n| n != "catalog.sqlite"));
    let rows = Uploads::open(&db.join("uploads/catalog.sqlite")).unwrap().all().unwrap();
    out.extend(rows.into_iter().map(|u| u.operation));
    out
}

/// What the client was doing when the server was killed.
const DOING: [&str; 4] = ["connecting", "sending samples", "waiting for the commit", "between two uploads"];

fn trial(kills: u64, seed: u64) {
    let started = Instant::now();
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let path = db.path().to_path_buf();
    let at = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let doing = Arc::new(AtomicU64::new(0));
    let over = Arc::new(AtomicBool::new(false));
    let mut server = serve(&path, at);
    // Surveys come one after the other: the bundled ones, four of hills, then those again and again as corrected deliveries.
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let mut hills_now: BTreeMap<String, Survey> = BTreeMap::new();
    let mut acknowledged: Vec<(String, u64)> = Vec::new();
    let (sent, mut all, mut resumed, mut streams) = (Arc::new(AtomicU64::new(0)), 0, 0, 0);
    let mut next = 1;
    let mut arrive = |n: u64| {
        let survey = match n {
            0..5 => bundled(n as usize),
            _ => {
                let name = format!("hills-{}", n % 4);
                let mut s = hills(&name, 120, (n % 4) as f64 * 800.0, n);
                let first = hills_now.insert(name.clone(), s.clone()).is_none();
                if !first {
                    s.header.target = Some(v1::upload_header::Target::Replace(name));
                    s.header.name.clear();
                    s.header.date.clear();
                }
                s
            }
        };
        let survey = survey.called(&format!("delivery {n}"));
        all += survey.count();
        let rows = Slow { rows: survey.rows(), random: Random(seed + 2 * n + 1), sent: sent.clone() };
        let sending = Sending {
            packed: n.is_multiple_of(2),
            tries: 5000,
            wait: Duration::from_millis(10),
            wait_max: Duration::from_millis(20),
        };
        let known = Mutex::new(0);
        doing.store(0, Relaxed);
        let commit = runtime.block_on(async {
            let address = Address { server: at.to_string(), ..Address::default() };
            let connection = loop {
                match Connection::open(&address).await {
                    Ok(c) => break c,
                    Err(_) => tokio::time::sleep(Duration::from_millis(10)).await,
                }
            };
            let mut told = |r: &v1::UploadReply| {
                // Only the first reply of a stream says how long samples are kept.
                if r.kept_s > 0 {
                    streams += 1;
                    let rows: u64 = r.received.iter().map(|s| s.rows).sum();
                    let mut known = known.lock().unwrap();
                    assert!(rows >= *known, "delivery {n}: {rows} rows are there, {known} were");
                    resumed += u64::from(rows > 0);
                    *known = rows;
                } else if r.state() == State::Uploading {
                    *known.lock().unwrap() += r.received.iter().map(|s| s.rows).sum::<u64>();
                }
                doing.store(if r.state() == State::Uploading { 1 } else { 2 }, Relaxed);
            };
            upload(&connection, survey.header.clone(), rows, &sending, &mut told).await
        });
        doing.store(3, Relaxed);
        let commit = commit.unwrap_or_else(|e| panic!("seed {seed}, delivery {n}: {e}"));
        acknowledged.push((commit.operation, commit.version));
    };
    // One undisturbed: how long it takes. Then kills come within that time, so that about half of the deliveries get through.
    let first = Instant::now();
    arrive(0);
    let undisturbed = first.elapsed().as_secs_f64();
    let killer = std::thread::spawn({
        let (doing, over, path) = (doing.clone(), over.clone(), path.clone());
        let mut random = Random(seed | 1);
        move || {
            let mut met: BTreeMap<&str, u64> = BTreeMap::new();
            for _ in 0..kills {
                std::thread::sleep(Duration::from_secs_f64(random.unit() * 1.6 * undisturbed));
                *met.entry(DOING[doing.load(Relaxed) as usize]).or_default() += 1;
                server.kill().unwrap();
                server.wait().unwrap();
                server = serve(&path, at);
            }
            over.store(true, Relaxed);
            (server, met)
        }
    });

    while !over.load(Relaxed) || next < 9 {
        arrive(next);
        next += 1;
    }
    let (last, met) = killer.join().unwrap();
    server = last;
    // One more, undisturbed: what the killed ones left goes with it.
    arrive(next);
    server.kill().unwrap();
    server.wait().unwrap();

    let left = leftovers(&path);
    assert!(left.is_empty(), "seed {seed}: {left:?}");
    let db = Db::open(&path).unwrap();
    let versions = db.versions().unwrap();
    assert_eq!(versions.len(), acknowledged.len(), "seed {seed}: one version for each delivery");
    for (n, (operation, version)) in acknowledged.iter().enumerate() {
        assert_eq!((operation.as_str(), *version), (format!("delivery {n}").as_str(), n as u64 + 1));
        assert_eq!(db.operation(operation).unwrap(), Some(*version), "seed {seed}: {operation}");
    }
    let stop = AtomicBool::new(false);
    let progress = Progress { report: &|_, _| (), stop: &stop };
    let report = verify(&db, &db.snapshot(None).unwrap(), &progress).unwrap();
    assert!(report.ok, "seed {seed}: {:#?}", report.problems);
    let alone = empty(&folder.path().join("alone"));
    (0..5).for_each(|k| offline(&alone, k));
    hills_now.values().for_each(|s| offline_hills(&alone, s));
    assert_eq!(print(&db), print(&alone), "seed {seed}");
    println!(
        "{kills} kills, {} deliveries in {streams} streams, {resumed} of them with rows that were there; {} rows sent for {all}; \
         killed while {met:?}; {undisturbed:.2} s for one undisturbed, {:.1} s in all",
        acknowledged.len(),
        sent.load(Relaxed),
        started.elapsed().as_secs_f64()
    );
}

#[test]
fn ten_kills_while_surveys_arrive_lose_nothing() {
    trial(10, 1);
}

/// `cargo test --release --test daemon a_hundred_kills -- --ignored --nocapture`
#[test]
#[ignore = "takes minutes"]
fn a_hundred_kills_while_surveys_arrive_lose_nothing() {
    trial(100, 2);
}
