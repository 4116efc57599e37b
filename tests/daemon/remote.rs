//! The command line with `--server` prints what it prints of a directory, byte for byte.

use super::survey::{helens, offline};
use crate::support::{empty, serve};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use terraquilt::server::Running;
use tokio::runtime::Runtime;

fn program(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_terraquilt"))
        .args(args)
        .env_remove("TERRAQUILT_TOKEN")
        .output()
        .expect("the program was built")
}

/// Three surveys, a version each, and a server of them.
struct Served {
    folder: tempfile::TempDir,
    db: PathBuf,
    runtime: Runtime,
    server: Running,
}

impl Served {
    fn new() -> Served {
        let folder = tempfile::tempdir().unwrap();
        let db = empty(folder.path());
        for k in [0, 1, 3] {
            offline(&db, k);
        }
        let runtime = Runtime::new().unwrap();
        let server = runtime.block_on(serve(&db));
        Served { db: db.path().to_path_buf(), folder, runtime, server }
    }

    fn address(&self) -> String {
        self.server.address.to_string()
    }

    fn file(&self, name: &str, text: &str) -> String {
        let path = self.folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    }

    /// Runs a command line in which `DB` is the database, of the directory and over the server.
    fn both(&self, line: &str) -> [Output; 2] {
        let words: Vec<&str> = line.split_whitespace().collect();
        let here = words.iter().map(|w| if *w == "DB" { self.db.to_str().unwrap() } else { w });
        let here = program(&here.collect::<Vec<_>>());
        let address = self.address();
        let there: Vec<&str> =
            words.iter().filter(|w| **w != "DB").copied().chain(["--server", &address]).collect();
        [here, program(&there)]
    }

    fn stop(self) {
        self.runtime.block_on(self.server.stop()).unwrap();
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Exit 1, nothing on stdout, and one line on stderr that says these.
fn fails(o: &Output, says: &[&str]) {
    let message = text(&o.stderr);
    assert_eq!(o.status.code(), Some(1), "{message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    assert!(says.iter().all(|s| message.contains(s)), "{message} does not say {says:?}");
}

const POINTS: &str = "562660,5116000 562000.25,5116100.75 562349.1,5115990 500000,5116000";
const BOX: &str = "--bbox 562300,5115900,562700,5116300";

#[test]
fn every_reading_command_says_the_same_over_a_server() {
    let s = Served::new();
    let polygon = s.file(
        "place.geojson",
        r#"{"type":"Polygon","coordinates":[[[562300,5115900],[562800,5116000],[562500,5116400],[562300,5115900]]]}"#,
    );
    let raster = s.file(
        "errors.asc",
        "ncols 4\nnrows 4\nxllcorner 562000\nyllcorner 5115500\ncellsize 300\n1 2 3 4\n5 6 7 8\n1 1 1 1\n9 9 9 9\n",
    );
    let csv = s.file("stakes.csv", "id,x,y\na,562660,5116000\nb,562400,5116111.5\nc,1,2\n");
    let camera = "--eye 562000,5115000,3500 --look-at 562700,5116100,2100 --viewport 800x600 --pixels 2";
    let lines = [
        "surveys DB".to_string(),
        "surveys DB --json".into(),
        "surveys DB --at 1 --json".into(),
        "tiles DB dome-2004-10-04".into(),
        "tiles DB dome-2004-10-04 --json".into(),
        "versions DB".into(),
        "versions DB --json".into(),
        "patches DB --error 2".into(),
        "patches DB --error 2 --json".into(),
        format!("patches DB --error 0 {BOX} --json"),
        format!("patches DB --error 5 --polygon {polygon} --json"),
        format!("patches DB {camera} --json"),
        "patches DB --focus 562660,5116000,50,0.5,0.01 --json".into(),
        format!("patches DB --error-raster {raster} {BOX} --json"),
        "patches DB --error 2 --since 1".into(),
        "patches DB --error 2 --since 1 --json".into(),
        "patches DB --error 2 --since 0 --json".into(),
        "patches DB --error 2 --bbox 1,1,2,2".into(),
        format!("heights DB --error 0 {POINTS}"),
        format!("heights DB --error 0.7 {POINTS} --json --explain"),
        format!("heights DB --error 3 --surface plain --seams all {POINTS} --explain"),
        format!("heights DB {camera} {POINTS} --json"),
        format!("heights DB --focus 562660,5116000,50,0.5,0.01 {POINTS} --json"),
        format!("heights DB --error-raster {raster} {POINTS} --json"),
        format!("heights DB --error 0 --points {csv}"),
        format!("heights DB --error 0 --points {csv} --json --at 2"),
        "heights DB --error 0 --coords EPSG:4326 -122.19,46.2 --json".into(),
        "boxes DB --at 1".into(),
        "boxes DB --json".into(),
        "profile DB --error 0 --line 562300,5115900 562700,5116300 562800,5116000".into(),
        "profile DB --error 1 --step 20 --line 562300,5115900 562700,5116300 --json".into(),
        "sight DB --error 0 --from 562300,5115900 --to 562700,5116300,10 --curvature".into(),
        "sight DB --error 0 --from 562300,5115900 --to 562700,5116300,10 --json".into(),
        format!("statistics DB --error 0 {BOX} --step 8"),
        format!("statistics DB --error 1 --polygon {polygon} --step 8 --json"),
        format!("volume DB --from 1 --to 3 --error 0 {BOX} --step 8"),
        format!("volume DB --from 1 --error 0 {BOX} --step 8 --json"),
        format!("volume DB --from-surveys crater-2000 --to-surveys dome-2004-10-13 --error 0 {BOX} --step 8"),
        format!("volume DB --from-surveys dome-2004-10-04,crater-2000 --error 1 {BOX} --json"),
        "contradictions DB".into(),
        "contradictions DB --json".into(),
        "contradictions DB --surveys dome-2004-10-04,dome-2004-10-13".into(),
        "info DB".into(),
        "info DB --json --at 2".into(),
        "fingerprint DB".into(),
        "fingerprint DB --json --at 1".into(),
        "verify DB --at 2".into(),
        "verify DB --at 1 --json".into(),
        "redundant DB".into(),
        "redundant DB --json".into(),
        format!("provenance DB --error 0 {BOX} --step 20"),
        format!("provenance DB --error 1 --polygon {polygon} --step 20 --json"),
    ];
    for line in &lines {
        let [here, there] = s.both(line);
        assert!(here.status.success(), "{line}: {}", text(&here.stderr));
        assert!(there.status.success(), "{line}: {}", text(&there.stderr));
        assert_eq!(text(&there.stdout), text(&here.stdout), "{line}");
        assert_eq!(text(&there.stderr), text(&here.stderr), "{line}");
        assert!(!here.stdout.is_empty(), "{line}");
    }
    let out = |name: &str| s.folder.path().join(name);
    for (line, name) in [
        (format!("contours DB OUT --error 0 --interval 10 {BOX} --step 8"), "lines.geojson"),
        (format!("slope DB OUT --error 0 {BOX} --step 8"), "slope.tif"),
        (format!("aspect DB OUT --error 0 {BOX} --step 8 --json"), "aspect.png"),
        (format!("hillshade DB OUT --error 0 --polygon {polygon} --step 8"), "shade.png"),
        (format!("export DB OUT --error 0 --polygon {polygon}"), "heights.tif"),
        (format!("export DB OUT --error 1 {BOX} --step 8"), "relief.png"),
        (format!("export DB OUT --error 6 {BOX}"), "dome.glb"),
        (format!("export DB OUT --error 6 {BOX} --quantize"), "small.glb"),
        ("export DB OUT --survey dome-2004-10-04 --json".into(), "delivered.tif"),
        (format!("difference DB OUT --from 1 --error 0 {BOX} --step 8"), "change.tif"),
        (format!("difference DB OUT --from 1 --to 3 --error 0 {BOX} --step 8 --json"), "change.png"),
    ] {
        let path = out(name);
        let words = line.replace("OUT", path.to_str().unwrap());
        let here = program(&words.replace("DB", s.db.to_str().unwrap()).split(' ').collect::<Vec<_>>());
        let written = std::fs::read(&path).expect("it was written");
        std::fs::remove_file(&path).unwrap();
        let there = words.replace("DB ", "") + " --server " + &s.address();
        let there = program(&there.split(' ').collect::<Vec<_>>());
        assert!(there.status.success(), "{line}: {}", text(&there.stderr));
        assert_eq!(text(&there.stdout), text(&here.stdout), "{line}");
        assert!(std::fs::read(&path).unwrap() == written, "{line}: other bytes");
    }
    s.stop();
}

#[test]
fn what_cannot_be_asked_of_a_server_is_said_in_a_line() {
    let s = Served::new();
    let address = s.address();
    let with = |line: &str| program(&line.replace("ADDR", &address).split(' ').collect::<Vec<_>>());
    fails(&with("surveys --server ADDR --at 99"), &[&address, "version 99", "not found"]);
    fails(&with("tiles nowhere --server ADDR"), &[&address, "survey 'nowhere' not found"]);
    let volume = with("volume --from-surveys crater-2000,none --error 0 --server=ADDR");
    fails(&volume, &[&address, "survey 'none' not found"]);
    fails(&with("contradictions where.png --server ADDR"), &[&address, "leave the file out"]);
    // Another way to write it.
    let listed = with("surveys http://ADDR");
    assert!(listed.status.success() && text(&listed.stdout).contains("crater-2000"));
    for word in ["init", "backup", "compact", "copy", "rebuild", "demo", "serve"] {
        let o = with(&format!("{word} --server ADDR"));
        assert_eq!(o.status.code(), Some(2), "{word}");
        assert!(text(&o.stderr).contains("without --server"), "{word}: {}", text(&o.stderr));
    }
    // Nobody listens; no address; somebody else listens.
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    fails(&program(&["surveys", "--server", &free]), &[&free, "terraquilt serve"]);
    fails(&program(&["surveys", "--server", "no address"]), &["no address", "host:port"]);
    let other = TcpListener::bind("127.0.0.1:0").unwrap();
    let at = other.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for c in other.incoming() {
            let Ok(mut c) = c else { return };
            let _ = c.read(&mut [0; 64]);
            let _ = c.write_all(b"HTTP/1.1 400 Bad Request\r\ncontent-length: 0\r\n\r\n");
        }
    });
    fails(&program(&["surveys", "--server", &at]), &[&at]);
    // The connection breaks in the middle of a long answer.
    let cut = cut_after(s.server.address, 60_000);
    let broken = program(&["boxes", "--server", &cut.to_string()]);
    let message = text(&broken.stderr);
    assert_eq!(broken.status.code(), Some(1), "{message}");
    assert!(
        message.lines().count() == 1 && message.contains(&format!("{cut}: the connection broke")),
        "{message}"
    );
    s.stop();
}

/// Passes bytes on to a server until it has sent so many, then hangs up.
fn cut_after(server: SocketAddr, bytes: u64) -> SocketAddr {
    let door = TcpListener::bind("127.0.0.1:0").unwrap();
    let at = door.local_addr().unwrap();
    std::thread::spawn(move || {
        let (client, _) = door.accept().unwrap();
        let there = TcpStream::connect(server).unwrap();
        let (mut from, mut to) = (client.try_clone().unwrap(), there.try_clone().unwrap());
        std::thread::spawn(move || std::io::copy(&mut from, &mut to));
        let _ = std::io::copy(&mut (&there).take(bytes), &mut &client);
        let _ = there.shutdown(std::net::Shutdown::Both);
        let _ = client.shutdown(std::net::Shutdown::Both);
    });
    at
}

/// JSON without what differs from run to run.
fn timeless(o: &Output) -> serde_json::Value {
    assert!(o.status.success(), "{}", text(&o.stderr));
    let mut v: serde_json::Value = serde_json::from_slice(&o.stdout).unwrap();
    if let Some(v) = v.as_object_mut() {
        v.remove("seconds");
        // Records of versions hold the ids of their operations, which are random here.
        v.remove("bytes_freed");
    }
    v
}

fn copied(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for e in std::fs::read_dir(from).unwrap().map(|e| e.unwrap()) {
        match e.file_type().unwrap().is_dir() {
            true => copied(&e.path(), &to.join(e.file_name())),
            false => std::fs::copy(e.path(), to.join(e.file_name())).map(|_| ()).unwrap(),
        }
    }
}

#[test]
fn changes_over_a_server_are_those_of_the_directory() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    offline(&db, 0);
    let twin = folder.path().join("twin");
    copied(db.path(), &twin);
    let runtime = Runtime::new().unwrap();
    let server = runtime.block_on(serve(&db));
    let address = server.address.to_string();
    let file = |k: &str| helens(k).display().to_string();
    let (first, second) = (file("survey_2004-10-04_native.tif"), file("survey_2004-10-13_native.tif"));
    for (line, tail) in [
        ("ingest DB FIRST --name dome --accuracy 0.5 --date 2004-10-04 --dry-run", ""),
        ("ingest DB FIRST --name dome --accuracy 0.5 --date 2004-10-04", ""),
        ("ingest DB FIRST --name dome --accuracy 0.5 --date 2004-10-04", ""),
        ("ingest DB SECOND --accuracy 0.5 --precedence -5", ""),
        ("set DB crater-2000 --date 2000-09-26", ""),
        ("set DB crater-2000 --date 2000-09-26", ""),
        ("replace DB dome FIRST", ""),
        ("remove DB dome", "--operation away"),
        ("remove DB dome", "--operation away"),
        ("prune DB --keep 2", ""),
    ] {
        let line = format!("{line} {tail} --json").replace("FIRST", &first).replace("SECOND", &second);
        let run = |line: String| timeless(&program(&line.split_whitespace().collect::<Vec<_>>()));
        let here = run(line.replace("DB", twin.to_str().unwrap()));
        let there = run(line.replace("DB ", "") + " --server " + &address);
        assert_eq!(there, here, "{line}");
    }
    let print = |args: &[&str]| text(&program(args).stdout);
    assert_eq!(
        print(&["fingerprint", "--server", &address]),
        print(&["fingerprint", twin.to_str().unwrap()])
    );
    fails(&program(&["ingest", &first, "--server", &address]), &[&address, "accura"]);
    runtime.block_on(server.stop()).unwrap();
}
