//! What people and machines see of a server: pages, numbers, the log; gRPC-web; the command line of `serve` and `token`.

use super::raw::{exchange, get};
use super::support::empty;
use std::io::{BufReader, Read};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use terraquilt::server::tokens::{Right, TokenFile};
use terraquilt::server::{Settings, start};

fn program(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terraquilt"));
    command.args(arguments);
    command
}

fn run(arguments: &[&str]) -> Output {
    program(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A survey of 9 x 9 posts with this name in the database.
fn ingest(folder: &Path, db: &Path, name: &str) {
    let row = "1 2 3 4 5 6 7 8 9\n".repeat(9);
    let grid = format!("ncols 9\nnrows 9\nxllcorner 500000\nyllcorner 4100000\ncellsize 10\n{row}");
    let file = folder.join("grid.asc");
    std::fs::write(&file, grid).unwrap();
    let [db, file] = [db, &file].map(|p| p.to_str().unwrap().to_string());
    let done = run(&[
        "ingest",
        &db,
        &file,
        "--name",
        name,
        "--accuracy",
        "1",
        "--crs",
        "EPSG:26910",
        "--date",
        "2026-01-01",
    ]);
    assert!(done.status.success(), "{}", text(&done.stderr));
}

#[tokio::test]
async fn the_page_says_what_is_there_and_a_name_is_no_markup() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    ingest(folder.path(), db.path(), "<script>alert('x')</script> & \"more\"");
    let server =
        start(Settings { listen: ([127, 0, 0, 1], 0).into(), ..Settings::new(db.path()) }).await.unwrap();
    let page = get(server.address, "/", "").await;
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("text/html"), "{page}");
    assert!(!page.contains("<script") && !page.contains("\"more\""), "{page}");
    assert!(
        page.contains("&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt; &amp; &quot;more&quot;"),
        "{page}"
    );
    for said in
        ["Version <b>1</b>", "1 surveys", "EPSG:26910", "terraquilt.v1.Catalog/ListSurveys", "x-request-id: "]
    {
        assert!(page.contains(said), "'{said}' is missing in {page}");
    }
    assert!(get(server.address, "/healthz", "").await.ends_with("ok\n"));
    assert!(get(server.address, "/nothing", "").await.starts_with("HTTP/1.1 404"));
    let numbers = get(server.address, "/metrics", "").await;
    for name in [
        "terraquilt_version 1",
        "terraquilt_surveys 1",
        "terraquilt_calls_total{method=\"/\",code=\"200\"}",
        "terraquilt_call_seconds_bucket{method=\"/healthz\",le=\"0.016\"}",
        "terraquilt_connections_open",
        "terraquilt_queue{pool=\"answer\"}",
        "process_open_fds",
        "# TYPE terraquilt_calls_open gauge",
    ] {
        assert!(numbers.contains(name), "'{name}' is missing in {numbers}");
    }
    server.stop().await.unwrap();
}

#[tokio::test]
async fn pages_need_a_token_where_calls_do_and_a_browser_can_give_it() {
    use base64::Engine;
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let (_, token) =
        TokenFile::at(db.path().join("tokens.json")).add(Right::Read, Some("map"), None).unwrap();
    let server =
        start(Settings { listen: ([127, 0, 0, 1], 0).into(), ..Settings::new(db.path()) }).await.unwrap();
    let basic = base64::engine::general_purpose::STANDARD.encode(format!("me:{token}"));
    for page in ["/", "/metrics"] {
        let refused = get(server.address, page, "").await;
        assert!(
            refused.starts_with("HTTP/1.1 401") && refused.contains("www-authenticate: Basic"),
            "{refused}"
        );
        let wrong = get(server.address, page, "Authorization: Bearer tq_no\r\n").await;
        assert!(wrong.starts_with("HTTP/1.1 401"), "{wrong}");
        for given in [format!("Bearer {token}"), format!("Basic {basic}")] {
            let answer = get(server.address, page, &format!("Authorization: {given}\r\n")).await;
            assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        }
    }
    assert!(get(server.address, "/healthz", "").await.starts_with("HTTP/1.1 200"));
    server.stop().await.unwrap();
}

#[tokio::test]
async fn a_server_without_tokens_answers_to_no_strange_name() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server =
        start(Settings { listen: ([127, 0, 0, 1], 0).into(), ..Settings::new(db.path()) }).await.unwrap();
    let as_host = |host: &str| format!("GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    let refused = exchange(server.address, as_host("evil.example:50051").as_bytes()).await;
    assert!(refused.starts_with("HTTP/1.1 403") && refused.contains("'evil.example'"), "{refused}");
    for host in ["localhost", "127.0.0.1:50051", "[::1]:50051"] {
        let answer = exchange(server.address, as_host(host).as_bytes()).await;
        assert!(answer.starts_with("HTTP/1.1 200"), "{host}: {answer}");
    }
    server.stop().await.unwrap();
}

/// A call of gRPC-web over HTTP/1.1 with an empty message.
async fn web(address: SocketAddr, path: &str, headers: &str) -> String {
    let head = format!(
        "POST {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nContent-Type: application/grpc-web+proto\r\n\
         Content-Length: 5\r\n{headers}\r\n"
    );
    exchange(address, &[head.as_bytes(), &[0; 5]].concat()).await
}

#[tokio::test]
async fn grpc_web_works_and_only_allowed_origins_may_read_it() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let allow_origin = vec!["https://maps.example".into()];
    let settings = Settings { listen: ([127, 0, 0, 1], 0).into(), allow_origin, ..Settings::new(db.path()) };
    let server = start(settings).await.unwrap();
    let check = "/grpc.health.v1.Health/Check";
    let answer = web(server.address, check, "Origin: https://maps.example\r\nx-request-id: page-7\r\n").await;
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("application/grpc-web+proto"), "{answer}");
    assert!(answer.contains("grpc-status:0"), "{answer}");
    assert!(answer.contains("access-control-allow-origin: https://maps.example"), "{answer}");
    assert!(answer.contains("x-request-id: page-7"), "{answer}");
    let other = web(server.address, check, "Origin: https://evil.example\r\n").await;
    assert!(!other.contains("access-control-allow-origin: https://evil"), "{other}");
    let unknown = web(server.address, "/terraquilt.v1.Catalog/Drop", "").await;
    assert!(unknown.contains("grpc-status: 12"), "{unknown}");
    let asked = format!(
        "OPTIONS {check} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\nOrigin: https://maps.example\r\n\
         Access-Control-Request-Method: POST\r\nAccess-Control-Request-Headers: x-grpc-web,authorization\r\n\r\n",
        server.address
    );
    let allowed = exchange(server.address, asked.as_bytes()).await;
    assert!(allowed.starts_with("HTTP/1.1 200"), "{allowed}");
    assert!(allowed.contains("access-control-allow-origin: https://maps.example"), "{allowed}");
    assert!(allowed.contains("authorization") && allowed.contains("x-grpc-web"), "{allowed}");
    server.stop().await.unwrap();
}

/// The program, serving; ended with the test.
struct Served {
    child: Child,
    address: SocketAddr,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Starts the program and waits until it listens. Its log goes to a file.
fn serve_program(db: &Path, log: &Path, more: &[&str]) -> Served {
    let arguments = [&["serve", db.to_str().unwrap(), "--listen", "127.0.0.1:0"], more].concat();
    let file = std::fs::File::create(log).unwrap();
    let mut child = program(&arguments).stderr(file).stdout(Stdio::null()).spawn().unwrap();
    let began = Instant::now();
    loop {
        let said = std::fs::read_to_string(log).unwrap();
        let at = said.lines().find_map(|l| l.strip_prefix("terraquilt listens on http://"));
        if let Some(address) = at.and_then(|a| a.parse().ok()) {
            return Served { child, address };
        }
        assert!(child.try_wait().unwrap().is_none(), "{said}");
        assert!(began.elapsed() < Duration::from_secs(20), "{said}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[tokio::test]
async fn the_log_has_a_line_for_each_call_and_no_token() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let made =
        run(&["token", "add", db.path().to_str().unwrap(), "--right", "read", "--name", "map-service"]);
    let token = text(&made.stdout).trim().to_string();
    assert!(token.len() == 67 && token.starts_with("tq_"), "{token}");
    assert!(!text(&made.stderr).contains(&token));
    let log = folder.path().join("log");
    let mut served = serve_program(db.path(), &log, &["--log", "json", "--log-level", "debug,h2=info"]);
    let wrong = "tq_0123456789";
    for (given, id) in [(token.as_str(), "first"), (wrong, "second")] {
        let more = format!("Authorization: Bearer {given}\r\nx-request-id: {id}\r\n");
        get(served.address, "/", &more).await;
        web(served.address, "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo", &more).await;
    }
    let process = rustix::process::Pid::from_child(&served.child);
    rustix::process::kill_process(process, rustix::process::Signal::TERM).unwrap();
    let began = Instant::now();
    let status = loop {
        match served.child.try_wait().unwrap() {
            Some(s) => break s,
            None => assert!(began.elapsed() < Duration::from_secs(10), "it does not stop"),
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    assert!(status.success(), "{status}");
    let said = std::fs::read_to_string(&log).unwrap();
    assert!(!said.contains(&token) && !said.contains(&token[3..20]) && !said.contains(wrong), "{said}");
    let lines: Vec<serde_json::Value> =
        said.lines().filter(|l| l.starts_with('{')).map(|l| serde_json::from_str(l).unwrap()).collect();
    let of = |id: &str, code: &str, token: &str| {
        let fits = |l: &&serde_json::Value| l["id"] == id && l["code"] == code && l["token"] == token;
        let line =
            lines.iter().find(fits).unwrap_or_else(|| panic!("no line of {id}, {code}, {token} in {said}"));
        assert_eq!(line["target"], "terraquilt::call");
        assert!(line["ms"].is_number() && line["sent"].is_number() && line["received"].is_number(), "{line}");
        assert!(line["peer"].as_str().unwrap().starts_with("127.0.0.1:"), "{line}");
        line["method"].as_str().unwrap().to_string()
    };
    assert_eq!(of("first", "200", "map-service"), "/");
    assert!(of("first", "INVALID_ARGUMENT", "map-service").ends_with("ServerReflectionInfo"));
    assert!(of("second", "UNAUTHENTICATED", "-").ends_with('/'), "{said}");
}

#[test]
fn tokens_are_listed_and_revoked_without_their_secrets() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let db = db.path().to_str().unwrap();
    let json = |arguments: &[&str]| -> serde_json::Value {
        let out = run(arguments);
        assert!(out.status.success(), "{}", text(&out.stderr));
        serde_json::from_slice(&out.stdout).unwrap()
    };
    let made = json(&["token", "add", db, "--right", "admin", "--name", "me", "--expires", "30", "--json"]);
    let secret = made["token"].as_str().unwrap().to_string();
    let list = json(&["token", "list", db, "--json"]);
    assert_eq!((&list[0]["name"], &list[0]["right"]), (&"me".into(), &"admin".into()));
    let days = list[0]["expires_at_s"].as_u64().unwrap() - list[0]["made_at_s"].as_u64().unwrap();
    assert_eq!(days, 30 * 86_400);
    let shown = text(&run(&["token", "list", db]).stdout);
    assert!(
        shown.contains("me") && !shown.contains(&secret[3..]) && !list.to_string().contains(&secret[3..])
    );
    assert!(!run(&["token", "revoke", db, "you"]).status.success());
    assert!(run(&["token", "revoke", db, "me"]).status.success());
    assert_eq!(json(&["token", "list", db, "--json"]), serde_json::json!([]));
    let absent = run(&["token", "add", "no/such/folder", "--right", "read"]);
    assert_eq!(absent.status.code(), Some(1));
    assert_eq!(run(&["token", "add", db, "--right", "all"]).status.code(), Some(2));
}

#[test]
fn a_backup_holds_no_tokens() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    ingest(folder.path(), db.path(), "grid");
    TokenFile::at(db.path().join("tokens.json")).add(Right::Admin, None, None).unwrap();
    let to = folder.path().join("backup");
    for command in ["backup", "backup"] {
        let done = run(&[command, db.path().to_str().unwrap(), to.to_str().unwrap()]);
        assert!(done.status.success(), "{}", text(&done.stderr));
    }
    assert!(!to.join("tokens.json").exists() && to.join("catalog.sqlite").exists());
    // Its own tokens are no reason against the next backup.
    TokenFile::at(to.join("tokens.json")).add(Right::Read, None, None).unwrap();
    let done = run(&["backup", db.path().to_str().unwrap(), to.to_str().unwrap()]);
    assert!(done.status.success(), "{}", text(&done.stderr));
    assert_eq!(TokenFile::at(to.join("tokens.json")).read().unwrap().unwrap().len(), 1);
}

#[test]
fn the_settings_that_hold_are_printed_and_mistakes_stop_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("serve.toml");
    std::fs::write(&file, "calls-max = 10\ngrace = \"7s\"\n").unwrap();
    let file = file.to_str().unwrap();
    let out = program(&["serve", "db", "--config", file, "--listen", "[::1]:9", "--print-config"])
        .env("TERRAQUILT_CALLS_MAX", "11")
        .output()
        .unwrap();
    let printed = text(&out.stdout);
    for line in [
        "listen = \"[::1]:9\"",
        "calls-max = 11",
        "grace = \"7s\"",
        "streams-max = 2048",
        "# tls-cert = \"\"",
    ] {
        assert!(printed.lines().any(|l| l == line), "'{line}' is missing in {printed}");
    }
    std::fs::write(file, "streems-max = 10\n").unwrap();
    let out = run(&["serve", "db", "--config", file]);
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stderr).contains("the nearest is 'streams-max'"), "{}", text(&out.stderr));
}

#[test]
fn a_port_that_is_taken_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let mut child = program(&["serve", db.path().to_str().unwrap(), "--listen", &address])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = String::new();
    BufReader::new(child.stderr.take().unwrap()).read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(1));
    assert!(said.lines().any(|l| l.starts_with("error: ") && l.contains(&address)), "{said}");
    assert!(taken.local_addr().is_ok());
}
