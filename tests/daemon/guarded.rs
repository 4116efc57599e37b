//! What strangers, broken clients and too many of them do to a server: nothing.

use super::raw::{channel, ends, exchange, methods, open};
use super::support::empty;
use bytes::Bytes;
use futures_util::{StreamExt, stream};
use prost::Message;
use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use terraquilt::server::{Running, Settings, start};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Code;
use tonic_reflection::pb::v1::ServerReflectionRequest;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;

const CHECK: &str = "/grpc.health.v1.Health/Check";
const WATCH: &str = "/grpc.health.v1.Health/Watch";
const REFLECT: &str = "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo";

async fn serve(folder: &Path, with: impl FnOnce(&mut Settings)) -> Running {
    let db = empty(folder);
    let mut settings = Settings { listen: ([127, 0, 0, 1], 0).into(), ..Settings::new(db.path()) };
    with(&mut settings);
    start(settings).await.unwrap()
}

/// Asks whether it lives, over a connection of its own, and how long that took.
async fn check(address: SocketAddr) -> Duration {
    let began = Instant::now();
    let channel = channel(address).await;
    ends(&channel, CHECK, None, Bytes::new()).await.expect("an answer in time").unwrap();
    began.elapsed()
}

/// How long until the server closes a connection on which these bytes were sent, one a step.
async fn closed_after(address: SocketAddr, bytes: &[u8], step: Duration) -> Duration {
    let began = Instant::now();
    let mut stream = TcpStream::connect(address).await.unwrap();
    let (mut next, mut buffer) = (bytes.iter().cycle(), [0u8; 4096]);
    loop {
        if let Some(b) = next.next()
            && stream.write_all(&[*b]).await.is_err()
        {
            return began.elapsed();
        }
        let read = tokio::time::timeout(step, stream.read(&mut buffer)).await;
        if matches!(read, Ok(Ok(0) | Err(_))) {
            return began.elapsed();
        }
        assert!(began.elapsed() < Duration::from_secs(30), "the connection stays open");
    }
}

#[tokio::test]
async fn a_message_beyond_the_bound_is_refused_by_every_method() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(folder.path(), |_| {}).await;
    let channel = channel(server.address).await;
    let large = Bytes::from(vec![0u8; (4 << 20) + 1]);
    let mut wrong = Vec::new();
    for method in methods() {
        let ended = ends(&channel, &method, None, large.clone()).await;
        let code = ended.map(|e| e.map_or_else(|s| s.code(), |()| Code::Ok));
        if !matches!(code, Some(Code::OutOfRange | Code::ResourceExhausted | Code::Unimplemented)) {
            wrong.push(format!("{method}: {code:?}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    check(server.address).await;
    drop(channel);
    server.stop().await.unwrap();
}

#[tokio::test]
async fn streams_and_calls_are_shed_apart_with_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(folder.path(), |s| s.streams_max = 2).await;
    let channel = channel(server.address).await;
    let (senders, held): (Vec<_>, Vec<_>) = [(); 2]
        .map(|()| {
            let (sender, messages) = tokio::sync::mpsc::channel(1);
            (sender, open(&channel, REFLECT, None, ReceiverStream::new(messages)))
        })
        .into_iter()
        .unzip();
    let held = futures_util::future::join_all(held).await;
    assert!(held.iter().all(Result::is_ok), "{held:?}");
    let e = open(&channel, WATCH, None, stream::iter([Bytes::new()])).await.unwrap_err();
    assert_eq!(e.code(), Code::ResourceExhausted);
    assert!(e.message().contains("2 long calls") && e.message().contains("try again"), "{e}");
    // Short calls have places of their own, and a place comes back.
    assert!(ends(&channel, CHECK, None, Bytes::new()).await.unwrap().is_ok());
    drop((senders, held));
    let began = Instant::now();
    while open(&channel, WATCH, None, stream::iter([Bytes::new()])).await.is_err() {
        assert!(began.elapsed() < Duration::from_secs(5), "the places did not come back");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    drop(channel);
    server.stop().await.unwrap();

    let folder = tempfile::tempdir().unwrap();
    let server = serve(folder.path(), |s| s.calls_max = 0).await;
    let channel = super::raw::channel(server.address).await;
    let e = ends(&channel, CHECK, None, Bytes::new()).await.unwrap().unwrap_err();
    assert_eq!(e.code(), Code::ResourceExhausted, "{e}");
    drop(channel);
    server.stop().await.unwrap();
}

#[tokio::test]
async fn a_call_whose_message_never_comes_gives_its_place_back() {
    let folder = tempfile::tempdir().unwrap();
    let set = |s: &mut Settings| (s.calls_max, s.deadline) = (1, Duration::from_millis(500));
    let server = serve(folder.path(), set).await;
    let channel = channel(server.address).await;
    let e =
        open(&channel, "/terraquilt.v1.Query/Patches", None, stream::pending::<Bytes>()).await.unwrap_err();
    assert_eq!(e.code(), Code::DeadlineExceeded, "{e}");
    assert!(e.message().contains("did not come within 500ms"), "{e}");
    assert!(ends(&channel, CHECK, None, Bytes::new()).await.unwrap().is_ok());
    drop(channel);
    server.stop().await.unwrap();
}

#[tokio::test]
async fn stopping_ends_streams_with_a_sentence_and_waits_no_longer_than_grace() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(folder.path(), |s| s.grace = Duration::from_secs(1)).await;
    let channel = channel(server.address).await;
    let mut endless = open(&channel, WATCH, None, stream::iter([Bytes::new()])).await.unwrap();
    endless.next().await.unwrap().unwrap();
    let mut fed = open(&channel, REFLECT, None, stream::pending()).await.unwrap();
    let address = server.address;
    let began = Instant::now();
    let stopped = tokio::spawn(server.stop());
    let mut last = None;
    while let Some(m) = endless.next().await {
        last = m.err();
    }
    let e = last.unwrap();
    assert_eq!(e.code(), Code::Unavailable);
    assert!(e.message().contains("the server is stopping"), "{e}");
    assert!(began.elapsed() < Duration::from_millis(800), "{:?}", began.elapsed());
    let e = fed.next().await.unwrap().unwrap_err();
    assert_eq!(e.code(), Code::Unavailable, "{e}");
    assert!(began.elapsed() >= Duration::from_secs(1), "{:?}", began.elapsed());
    stopped.await.unwrap().unwrap();
    println!("stopped after {:?}", began.elapsed());
    assert!(began.elapsed() < Duration::from_secs(4), "{:?}", began.elapsed());
    assert!(TcpStream::connect(address).await.is_err(), "it still listens");
}

#[tokio::test]
async fn noise_is_closed_and_nothing_else_is_hurt() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(folder.path(), |s| s.greet_within = Duration::from_secs(1)).await;
    let address = server.address;
    let channel = channel(address).await;
    let mut x = 88_172_645_463_325_252_u64;
    for n in 0..200usize {
        let mut noise: Vec<u8> = (0..n * 7)
            .map(|_| {
                x ^= x << 13;
                x ^= x >> 7;
                x ^= x << 17;
                x as u8
            })
            .collect();
        if n % 2 == 0 {
            noise.splice(0..0, *b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n");
        }
        let mut stream = TcpStream::connect(address).await.unwrap();
        let _ = stream.write_all(&noise).await;
    }
    // A head without end, and one that is too large.
    let head = format!("GET / HTTP/1.1\r\nHost: {address}\r\nA: {}\r\n\r\n", "a".repeat(200_000));
    let said = exchange_broken(address, head.as_bytes()).await;
    assert!(said.is_empty() || said.starts_with("HTTP/1.1 431"), "{said}");
    assert!(ends(&channel, CHECK, None, Bytes::new()).await.unwrap().is_ok());
    check(address).await;
    drop(channel);
    server.stop().await.unwrap();
}

/// As `exchange`, where the server may close before everything was sent.
async fn exchange_broken(address: SocketAddr, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let _ = stream.write_all(bytes).await;
    let mut out = Vec::new();
    let _ = tokio::time::timeout(Duration::from_secs(5), stream.read_to_end(&mut out)).await;
    String::from_utf8_lossy(&out).into_owned()
}

#[tokio::test]
async fn who_says_nothing_or_too_slowly_is_closed() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(folder.path(), |s| {
        s.greet_within = Duration::from_millis(600);
        s.idle = Duration::from_millis(1500);
    })
    .await;
    let address = server.address;
    let step = Duration::from_millis(100);
    let cases: [(&str, &[u8]); 3] = [
        ("nothing", b""),
        (
            "a head without end",
            b"GET / HTTP/1.1\r\nHost: localhost\r\nA: aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa",
        ),
        ("the beginning of HTTP/2 without end", b"PRI * HT"),
    ];
    for (what, bytes) in cases {
        let took = closed_after(address, bytes, step).await;
        println!("{what}: closed after {took:?}");
        assert!(took > Duration::from_millis(400) && took < Duration::from_secs(4), "{what}: {took:?}");
    }
    // An HTTP/1.1 connection that asked once and then nothing.
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(format!("GET /healthz HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes()).await.unwrap();
    let mut out = Vec::new();
    tokio::time::timeout(Duration::from_secs(4), stream.read_to_end(&mut out))
        .await
        .expect("closed")
        .unwrap();
    assert!(String::from_utf8_lossy(&out).ends_with("ok\n"));
    server.stop().await.unwrap();
}

#[tokio::test]
async fn a_quiet_client_of_http2_that_answers_pings_stays() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(folder.path(), |s| {
        s.idle = Duration::from_millis(700);
        s.keepalive = Duration::from_millis(200);
    })
    .await;
    let channel = channel(server.address).await;
    let mut quiet = open(&channel, WATCH, None, stream::iter([Bytes::new()])).await.unwrap();
    quiet.next().await.unwrap().unwrap();
    let said = tokio::time::timeout(Duration::from_secs(2), quiet.next()).await;
    assert!(said.is_err(), "the quiet stream ended: {said:?}");
    drop((quiet, channel));
    server.stop().await.unwrap();
}

#[tokio::test]
async fn a_client_that_never_reads_is_closed_and_holds_nobody_up() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(folder.path(), |s| s.stall = Duration::from_secs(1)).await;
    let address = server.address;
    // HTTP/1.1: thousands of pages asked for in one go, none read.
    let mut pages = TcpStream::connect(address).await.unwrap();
    let asked = format!("GET / HTTP/1.1\r\nHost: {address}\r\n\r\n").repeat(20_000);
    let writes = tokio::spawn(async move {
        let began = Instant::now();
        // What the kernel takes in says nothing; that it takes no more does.
        while pages.write_all(asked.as_bytes()).await.is_ok() {
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        began.elapsed()
    });
    // HTTP/2: answers that nobody takes fill the window of their stream; its connection answers pings all the while.
    let unread = channel(address).await;
    let symbol = MessageRequest::FileContainingSymbol("terraquilt.v1.View".into());
    let request = ServerReflectionRequest { message_request: Some(symbol), ..Default::default() };
    let message = Bytes::from(request.encode_to_vec());
    let never_read =
        open(&unread, REFLECT, None, stream::iter(vec![message; 20_000]).chain(stream::pending())).await;
    let began = Instant::now();
    let mut slowest = Duration::ZERO;
    while began.elapsed() < Duration::from_secs(4) {
        slowest = slowest.max(check(address).await);
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    println!("slowest answer to others: {slowest:?}");
    let closed =
        tokio::time::timeout(Duration::from_secs(10), writes).await.expect("HTTP/1.1: closed").unwrap();
    println!("HTTP/1.1: closed after {closed:?}");
    assert!(closed > Duration::from_millis(900), "{closed:?}");
    let mut answers = never_read.unwrap();
    let end = tokio::time::timeout(Duration::from_secs(5), async {
        while let Some(m) = answers.next().await {
            m?;
        }
        Ok(())
    });
    let end: Result<(), tonic::Status> = end.await.expect("the stream ended");
    println!("HTTP/2: {}", end.unwrap_err());
    drop(unread);
    server.stop().await.unwrap();
}

#[tokio::test]
async fn connections_beyond_the_bound_are_closed_as_they_come() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(folder.path(), |s| s.connections_max = 10).await;
    let mut held = Vec::new();
    for _ in 0..10 {
        held.push(TcpStream::connect(server.address).await.unwrap());
    }
    tokio::time::sleep(Duration::from_millis(100)).await;
    for _ in 0..5 {
        assert_eq!(exchange_broken(server.address, b"").await, "");
    }
    drop(held);
    tokio::time::sleep(Duration::from_millis(100)).await;
    check(server.address).await;
    server.stop().await.unwrap();
}

/// Tells this binary that it is the other process of the next test.
const IDLE_TO: &str = "TERRAQUILT_TEST_IDLE_TO";
const IDLE: usize = 10_000;

/// Not a test of its own: opens connections for the next one, and holds them until its input ends.
#[test]
#[ignore = "run by ten_thousand_idle_connections_are_harmless, in a process of its own"]
fn idle_connections() {
    let Ok(address) = std::env::var(IDLE_TO) else { return };
    raise_files();
    let held: Vec<_> = (0..IDLE).map(|_| std::net::TcpStream::connect(&address)).collect();
    println!("\nopened {}", held.iter().filter(|c| c.is_ok()).count());
    std::io::stdout().flush().unwrap();
    let _ = std::io::stdin().read_line(&mut String::new());
}

fn raise_files() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let hard = getrlimit(Resource::Nofile).maximum;
    assert!(hard.is_none_or(|h| h > IDLE as u64 + 1000), "this system allows {hard:?} open files a process");
    setrlimit(Resource::Nofile, Rlimit { current: hard, maximum: hard }).unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ten_thousand_idle_connections_are_harmless() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(folder.path(), |s| s.greet_within = Duration::from_secs(3)).await;
    let address = server.address;
    let resident = || {
        let text = std::fs::read_to_string("/proc/self/statm").unwrap();
        text.split(' ').nth(1).unwrap().parse::<usize>().unwrap() * 4096
    };
    let before = resident();
    let mut other = Command::new(std::env::current_exe().unwrap())
        .args(["guarded::idle_connections", "--exact", "--ignored", "--nocapture"])
        .env(IDLE_TO, address.to_string())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(other.stdout.take().unwrap()).lines();
    let opened = tokio::task::spawn_blocking(move || {
        let opened =
            lines.find_map(|l| l.unwrap().strip_prefix("opened ").map(|n| n.parse::<usize>().unwrap()));
        (opened, lines)
    });
    let mut slowest = Duration::ZERO;
    while !opened.is_finished() {
        slowest = slowest.max(check(address).await);
    }
    let (opened, rest) = opened.await.unwrap();
    assert_eq!(opened, Some(IDLE));
    let grown = resident().saturating_sub(before);
    for _ in 0..20 {
        slowest = slowest.max(check(address).await);
    }
    println!("{IDLE} open: {} KiB each; slowest call meanwhile {slowest:?}", grown / 1024 / IDLE);
    assert!(grown < 400 << 20, "{grown} bytes for {IDLE} idle connections");
    // Beside other tests on a busy machine; alone it is some 30 ms.
    assert!(slowest < Duration::from_secs(10), "{slowest:?}");
    // They said nothing: they are closed, and their files with them.
    let began = Instant::now();
    let files = || std::fs::read_dir("/proc/self/fd").unwrap().count();
    while files() > 1000 {
        assert!(began.elapsed() < Duration::from_secs(20), "{} files are still open", files());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    drop(other.stdin.take());
    rest.for_each(drop);
    assert!(other.wait().unwrap().success());
    check(address).await;
    server.stop().await.unwrap();
}

#[tokio::test]
async fn the_end_of_a_page_comes_though_the_client_closed_its_side() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(folder.path(), |_| {}).await;
    let request = format!("GET /healthz HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", server.address);
    assert!(exchange(server.address, request.as_bytes()).await.ends_with("ok\n"));
    server.stop().await.unwrap();
}
