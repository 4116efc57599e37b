//! The surface as a stream from a server: the bytes of the command line, whole or from where the client is; refinements of what the
//! client holds; what breaks off, changes and is refused.

use super::by_hand;
use super::hills::{DOME, arrival, commit, hills};
use super::support::{connect, empty, serve};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use terraquilt::client::stream::Terrain;
use terraquilt::client::{Address, Connection};
use terraquilt::db::query::Tolerance;
use terraquilt::db::{Db, Snapshot};
use terraquilt::height::surface::Blend;
use terraquilt::server::{Running, Settings, start};
use terraquilt::wire::v1;
use terraquilt::wire::v1::surface_piece::Kind;
use terraquilt_codecs::gtb::{Decoded, Stop};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

/// The east of the dome, and the rest of it.
const EAST: [f64; 4] = [562_905.0, 5_115_300.0, 563_300.0, 5_116_600.0];
const WEST: [f64; 4] = [562_000.0, 5_115_300.0, 562_900.0, 5_116_600.0];

fn region(b: [f64; 4]) -> Option<v1::Region> {
    let b = v1::Box { xmin: b[0], ymin: b[1], xmax: b[2], ymax: b[3] };
    Some(v1::Region { kind: Some(v1::region::Kind::Box(b)) })
}

fn request(error_m: f64, step: f64) -> v1::SurfaceRequest {
    let kind = Some(v1::tolerance::Kind::ErrorM(error_m));
    let tolerance = Some(v1::Tolerance { kind });
    v1::SurfaceRequest { tolerance, region: region(DOME), step_x: step, ..Default::default() }
}

async fn fetched(c: &Connection, r: v1::SurfaceRequest) -> Terrain {
    let mut t = Terrain::new(r);
    t.fetch(c, None, |_| Ok(())).await.unwrap();
    t
}

async fn refused(c: &Connection, r: v1::SurfaceRequest) -> String {
    Terrain::new(r).fetch(c, None, |_| Ok(())).await.unwrap_err().to_string()
}

/// The beginning of what came.
fn beginning(t: &Terrain, bytes: usize) -> Terrain {
    let mut out = t.clone();
    out.bytes.truncate(bytes);
    out
}

/// One call as it is: head and data.
async fn asked(c: &Connection, r: v1::SurfaceRequest) -> (v1::SurfaceHead, Vec<u8>) {
    let mut stream = c.streams().surface(r).await.unwrap().into_inner();
    let (mut head, mut bytes) = (None, Vec::new());
    while let Some(piece) = stream.message().await.unwrap() {
        match piece.kind.unwrap() {
            Kind::Head(h) => assert!(head.replace(h).is_none(), "two heads"),
            Kind::Data(d) => {
                assert!(head.is_some() && d.len() <= 32 << 10);
                bytes.extend_from_slice(&d);
            }
        }
    }
    (head.unwrap(), bytes)
}

/// Every post is as far from the surface as codec and rounding may be, no farther. The surface is asked for half of `error_m`.
fn holds(d: &Decoded, s: &Snapshot, error_m: f64) {
    let (h, place, z) = (&d.header, &d.header.place, d.surface());
    let t = &place.transform;
    let posts = (0..h.rows).flat_map(|r| (0..h.cols).map(move |c| (r, c)));
    let points: Vec<[f64; 2]> =
        posts.clone().map(|(r, c)| [t[0] + c as f64 * t[1], t[3] + r as f64 * t[5]]).collect();
    let surface = s.planes(&points, &Tolerance::Constant(error_m / 2.0), Blend::Exact).unwrap().z;
    let one = |((r, c), true_z): ((usize, usize), &f64)| {
        (place.base + place.unit * z[r * h.lattice.side() + c] - true_z).abs()
    };
    let worst = posts.zip(&surface).filter(|(_, z)| !z.is_nan()).map(one).fold(0.0, f64::max);
    let allowed = place.unit * (0.5 + f64::from(d.bound)) + 1e-6;
    assert!(worst <= allowed && allowed <= error_m, "{worst} m at posts, {allowed} m allowed");
}

#[tokio::test(flavor = "multi_thread")]
async fn streams_are_those_of_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    let (db, address) = (folder.path().join("db"), server.address.to_string());
    let (db, dome) = (db.to_str().unwrap(), DOME.map(|v| v.to_string()).join(","));
    let degrees = ["--coords", "EPSG:4326", "--bbox", "-122.195,46.195,-122.185,46.205"];
    let in_degrees = v1::SurfaceRequest {
        coords: "EPSG:4326".into(),
        region: region([-122.195, 46.195, -122.185, 46.205]),
        ..request(8.0, 0.0001)
    };
    let foci = v1::Foci {
        foci: vec![v1::Focus { x: 562_600.0, y: 5_116_100.0, radius_m: 150.0, error_m: 1.0, growth: 0.03 }],
    };
    let foci = Some(v1::Tolerance { kind: Some(v1::tolerance::Kind::Foci(foci)) });
    let cases: Vec<(Vec<&str>, v1::SurfaceRequest)> = vec![
        (vec!["--error", "4", "--bbox", &dome, "--step", "10"], request(4.0, 10.0)),
        (vec!["--error", "0", "--bbox", &dome], request(0.0, 0.0)),
        (
            vec![
                "--error", "9", "--bbox", &dome, "--step", "7,9", "--at", "1", "--bound", "2", "--unit",
                "0.5",
            ],
            v1::SurfaceRequest { step_y: 9.0, at: 1, bound_m: Some(2.0), unit_m: 0.5, ..request(9.0, 7.0) },
        ),
        ([&["--error", "8", "--step", "0.0001"], &degrees[..]].concat(), in_degrees),
        (
            vec!["--focus", "562600,5116100,150,1,0.03", "--bbox", &dome, "--step", "5", "--seams", "all"],
            v1::SurfaceRequest { tolerance: foci, seams: v1::Seams::All as i32, ..request(0.0, 5.0) },
        ),
    ];
    for (args, r) in cases {
        let (head, bytes) = asked(&c, r).await;
        let (here, said, notes) = by_hand::export(folder.path(), "gtb", &[db], &args);
        assert!(bytes == here, "{args:?}: {} and {} bytes differ", bytes.len(), here.len());
        let json: serde_json::Value = serde_json::from_str(&head.json).unwrap();
        assert_eq!(json, said, "{args:?}");
        assert_eq!((head.bytes, head.from), (bytes.len() as u64, 0));
        assert_eq!(head.hash[..], blake3::hash(&bytes).as_bytes()[..]);
        assert!(head.passes.windows(2).all(|w| w[0].bytes <= w[1].bytes && w[1].error_m >= head.error_m));
        let last = head.passes.last().unwrap();
        assert!((last.error_m - head.error_m).abs() < 1e-9 && last.spacing == 1 && last.edges);
        assert_eq!(head.version, json["version"].as_u64().unwrap());
        // The command line of a server.
        let (there, told, told_notes) = by_hand::export(folder.path(), "gtb", &["--server", &address], &args);
        assert!(there == here && told == said && told_notes == notes, "{args:?}: {told_notes}");
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn who_has_a_beginning_is_sent_the_rest() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    let r = request(0.0, 4.0);
    let (whole, bytes) = asked(&c, r.clone()).await;
    let n = bytes.len();
    assert!(n > 20_000, "{n} bytes");
    let prefix = |n: usize, hash: &[u8]| Some(v1::Prefix { bytes: n as u64, hash: hash.to_vec().into() });
    for cut in [1, 10, 100, 16_384, n / 2, n - 1, n] {
        for hash in [whole.hash.to_vec(), blake3::hash(&bytes[..cut]).as_bytes().to_vec()] {
            let (head, rest) =
                asked(&c, v1::SurfaceRequest { prefix: prefix(cut, &hash), ..r.clone() }).await;
            assert_eq!((head.from, head.bytes, &head.hash), (cut as u64, n as u64, &whole.hash));
            assert!(rest == bytes[cut..] && head.notes == whole.notes);
        }
    }
    // Another stream, bytes that are none of it, more bytes than there are, a request that differs.
    let other = v1::SurfaceRequest { prefix: prefix(n / 2, &whole.hash), ..request(0.1, 4.0) };
    let anew = [
        v1::SurfaceRequest { prefix: prefix(n / 2, &[7; 32]), ..r.clone() },
        v1::SurfaceRequest { prefix: prefix(n / 2, &[]), ..r.clone() },
        v1::SurfaceRequest { prefix: prefix(n + 1, &whole.hash), ..r.clone() },
        v1::SurfaceRequest { prefix: prefix(usize::MAX, &whole.hash), ..r.clone() },
        other,
    ];
    for r in anew {
        let (head, rest) = asked(&c, r).await;
        assert_eq!((head.from, head.bytes), (0, rest.len() as u64));
        assert!(head.notes.iter().any(|n| n.contains("it begins anew")), "{:?}", head.notes);
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_goes_on_with_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    let server = serve(&db).await;
    let address = server.address.to_string();
    let dome = DOME.map(|v| v.to_string()).join(",");
    let args = ["--error", "2", "--bbox", &dome, "--step", "5"];
    let at = ["--server", &address];
    let (bytes, json, _) = by_hand::export(folder.path(), "gtb", &at, &args);
    let out = folder.path().join("by-hand.gtb");
    let resumed = [&args[..], &["--resume"]].concat();
    for cut in [0, 5, 200, bytes.len() / 3, bytes.len()] {
        std::fs::write(&out, &bytes[..cut]).unwrap();
        let (again, told, said) = by_hand::export(folder.path(), "gtb", &at, &resumed);
        assert!(again == bytes && told == json);
        let fetched = format!("{cut} bytes were there, {} were fetched", bytes.len() - cut);
        assert_eq!(said.contains(&fetched), cut > 0, "{said}");
    }
    // Damaged, it begins anew.
    let mut half = bytes[..bytes.len() / 2].to_vec();
    half[3000] ^= 1;
    std::fs::write(&out, &half).unwrap();
    let (again, _, said) = by_hand::export(folder.path(), "gtb", &at, &resumed);
    assert!(again == bytes && said.contains("begins anew"), "{said}");
    // A commit in between: the file names its version, and goes on with it.
    std::fs::write(&out, &bytes[..bytes.len() / 2]).unwrap();
    let set = by_hand::program(&["set", "--server", &address, "2005", "--precedence", "1"]);
    assert!(set.status.success(), "{}", String::from_utf8_lossy(&set.stderr));
    let (again, _, said) = by_hand::export(folder.path(), "gtb", &at, &resumed);
    assert!(again == bytes && !said.contains("anew"), "{said}");
    // Unless the newest is asked for.
    std::fs::write(&out, &bytes[..bytes.len() / 2]).unwrap();
    let newest = db.newest().unwrap().to_string();
    let (again, json, said) =
        by_hand::export(folder.path(), "gtb", &at, &[&resumed[..], &["--at", &newest]].concat());
    assert!(again != bytes && said.contains("begins anew") && json["version"].as_u64() == Some(4), "{said}");
    server.stop().await.unwrap();
}

/// Passes connections on, and cuts each after so many bytes of answers.
async fn broken_link(to: std::net::SocketAddr, after: usize) -> (String, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let cuts = Arc::new(AtomicUsize::new(0));
    let counted = cuts.clone();
    tokio::spawn(async move {
        while let Ok((near, _)) = listener.accept().await {
            let counted = counted.clone();
            tokio::spawn(async move {
                let far = TcpStream::connect(to).await.unwrap();
                let ((mut near_in, mut near_out), (mut far_in, mut far_out)) =
                    (near.into_split(), far.into_split());
                let up = tokio::spawn(async move { tokio::io::copy(&mut near_in, &mut far_out).await });
                let (mut left, mut some) = (after, [0; 4096]);
                while left > 0 {
                    let Ok(n @ 1..) = far_in.read(&mut some[..left.min(4096)]).await else { break };
                    if near_out.write_all(&some[..n]).await.is_err() {
                        break;
                    }
                    left -= n;
                }
                counted.fetch_add(usize::from(left == 0), Ordering::Relaxed);
                up.abort();
            });
        }
    });
    (address, cuts)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_goes_on_where_the_connection_broke() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    let (_, bytes) = asked(&c, request(0.0, 4.0)).await;
    assert!(bytes.len() > 100_000, "{} bytes", bytes.len());
    let (address, cuts) = broken_link(server.address, 40_000).await;
    let link = Connection::open(&Address { server: address, ..Address::default() }).await.unwrap();
    let mut t = Terrain::new(request(0.0, 4.0));
    let (mut surfaces, mut bound) = (0, u32::MAX);
    let fetched = t.fetch(&link, None, |t| {
        // Whatever came is a surface.
        if let Ok(d) = t.decode(Stop::End) {
            (surfaces, bound) = (surfaces + 1, d.bound);
        }
        Ok(())
    });
    fetched.await.unwrap();
    assert!(t.bytes == bytes && t.is_complete());
    println!("{} bytes over {} broken connections", bytes.len(), cuts.load(Ordering::Relaxed));
    assert!(cuts.load(Ordering::Relaxed) >= 3 && surfaces >= 4 && bound == 0);
    // A link that lets nothing through ends in a sentence; what came stays.
    let (address, _) = broken_link(server.address, 400).await;
    let link = Connection::open(&Address { server: address.clone(), ..Address::default() }).await.unwrap();
    let mut t = Terrain::begun(request(0.0, 4.0), bytes[..5000].to_vec());
    let e = t.fetch(&link, None, |_| Ok(())).await.unwrap_err().to_string();
    assert!(e.contains(&address) && t.bytes == bytes[..5000], "{e}");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_held_is_refined() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    let s = db.snapshot(None).unwrap();
    let server = serve(&db).await;
    let c = connect(&server).await;
    let coarse = fetched(&c, request(4.0, 32.0)).await;
    // Level by level: each spacing refines the one before.
    let mut chain = vec![coarse];
    for step in [16.0, 8.0, 4.0] {
        let alone = fetched(&c, request(4.0, step)).await;
        let earlier = chain.last().unwrap();
        let mut t = Terrain::new(earlier.refined(request(4.0, step)).unwrap());
        t.fetch(&c, Some(earlier), |_| Ok(())).await.unwrap();
        let head = t.head.clone().unwrap();
        let d = t.decode(Stop::End).unwrap();
        let given = d.header.given.is_some() && head.refines.is_some();
        println!("step {step}: {} bytes, {} for all", t.bytes.len(), alone.bytes.len());
        assert!(given && d.complete && t.bytes.len() < alone.bytes.len() * 9 / 10, "{:?}", head.notes);
        holds(&d, &s, 4.0);
        // What stayed is what was held.
        let e = earlier.decode(Stop::End).unwrap();
        let (new, old) = (&d.header, &e.header);
        let (side_new, side_old) = (new.lattice.side(), old.lattice.side());
        let offset = |k: usize, j: usize| {
            let (a, b) = (&new.place.transform, &old.place.transform);
            ((b[k] - a[k]) / a[j]).round() as isize
        };
        let (x0, y0) = (offset(0, 1), offset(3, 5));
        let (mut shared, mut same) = (0, 0);
        for (r, c) in (0..old.rows).flat_map(|r| (0..old.cols).map(move |c| (r, c))) {
            let (y, x) = (y0 + 2 * r as isize, x0 + 2 * c as isize);
            if y >= 0 && x >= 0 && y < new.rows as isize && x < new.cols as isize {
                let z = new.place.unit * f64::from(d.z[y as usize * side_new + x as usize]);
                shared += 1;
                same += i32::from((z - old.place.unit * f64::from(e.z[r * side_old + c])).abs() < 1e-9);
            }
        }
        assert!(
            shared * 10 > (old.rows * old.cols * 9) as i32 && same * 10 > shared * 9,
            "{same} of {shared}"
        );
        // Without what was held it cannot be read, nor with something else.
        let bare = Terrain::begun(t.request.clone(), t.bytes.clone());
        assert!(bare.decode(Stop::End).is_err());
        // It goes on where it broke off as any other stream.
        let mut half = Terrain::begun(t.request.clone(), t.bytes[..t.bytes.len() / 2].to_vec());
        half.fetch(&c, Some(earlier), |_| Ok(())).await.unwrap();
        assert!(half.bytes == t.bytes && half.head.as_ref().unwrap().from > 0);
        assert_eq!(half.decode(Stop::End).unwrap().z, d.z);
        chain.push(t);
    }
    server.stop().await.unwrap();
    // A server that begins anew knows nothing of it, and makes the same.
    let server = serve(&db).await;
    let c = connect(&server).await;
    let last = chain.pop().unwrap();
    let (head, bytes) = asked(&c, last.request.clone()).await;
    assert!(bytes == last.bytes && head.hash == last.head.unwrap().hash);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_neighbouring_region_and_a_part_of_a_stream_count_as_held() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    let s = db.snapshot(None).unwrap();
    let server = serve(&db).await;
    let c = connect(&server).await;
    let west = v1::SurfaceRequest { region: region(WEST), ..request(4.0, 8.0) };
    let held = fetched(&c, west).await;
    let wide = request(4.0, 8.0);
    let alone = fetched(&c, wide.clone()).await.bytes.len();
    let mut t = Terrain::new(held.refined(wide.clone()).unwrap());
    t.fetch(&c, Some(&held), |_| Ok(())).await.unwrap();
    println!("{} bytes, {alone} for all, {} held", t.bytes.len(), held.bytes.len());
    assert!(t.bytes.len() * 2 < alone);
    holds(&t.decode(Stop::End).unwrap(), &s, 4.0);
    // The beginning of a stream: its posts so far.
    let part = beginning(&held, held.bytes.len() * 2 / 3);
    let mut p = Terrain::new(part.refined(wide.clone()).unwrap());
    p.fetch(&c, Some(&part), |_| Ok(())).await.unwrap();
    assert!(t.bytes.len() < p.bytes.len() && p.bytes.len() < alone, "{} bytes", p.bytes.len());
    holds(&p.decode(Stop::End).unwrap(), &s, 4.0);
    // Other posts, and too little of it: everything is sent, and it is said.
    for (held, r, says, error) in [
        (&held, v1::SurfaceRequest { region: region(EAST), ..wide.clone() }, "shares no post", 4.0),
        (&held, request(0.1, 8.0), "are good enough for it", 0.1),
        (&beginning(&held, 40), wide.clone(), "is no surface yet", 4.0),
    ] {
        let mut t = Terrain::new(held.refined(r).unwrap());
        t.fetch(&c, Some(held), |_| Ok(())).await.unwrap();
        let notes = t.head.clone().unwrap().notes.join("\n");
        assert!(notes.contains(says) && notes.contains("everything is sent"), "{notes}");
        holds(&t.decode(Stop::End).unwrap(), &s, error);
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn changed_terrain_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    commit(&db, arrival(0));
    let server = serve(&db).await;
    let c = connect(&server).await;
    let everywhere = |step| v1::SurfaceRequest { region: None, ..request(5.0, step) };
    let before = fetched(&c, everywhere(20.0)).await;
    assert_eq!(before.request.at, 1);
    // A survey of the dome arrives: most of the crater is as it was.
    commit(&db, arrival(1));
    server.state().live.look().unwrap();
    let s = db.snapshot(None).unwrap();
    let alone = fetched(&c, everywhere(10.0)).await;
    let mut t = Terrain::new(before.refined(everywhere(10.0)).unwrap());
    t.fetch(&c, Some(&before), |_| Ok(())).await.unwrap();
    let head = t.head.clone().unwrap();
    let runs = head.refines.clone().unwrap().runs;
    let fell: u64 = runs.iter().skip(1).step_by(2).sum();
    println!(
        "{} bytes, {} for all; {fell} of {} heights fell",
        t.bytes.len(),
        alone.bytes.len(),
        runs.iter().sum::<u64>()
    );
    assert!(fell > 100 && t.bytes.len() < alone.bytes.len() && head.version == 2);
    holds(&t.decode(Stop::End).unwrap(), &s, 5.0);
    // Who goes on with a beginning and names no version begins anew.
    let half = before.bytes[..before.bytes.len() / 2].to_vec();
    let mut on = Terrain::begun(everywhere(20.0), half.clone());
    on.fetch(&c, None, |_| Ok(())).await.unwrap();
    let head = on.head.clone().unwrap();
    assert!(head.from == 0 && head.notes.iter().any(|n| n.contains("begins anew")), "{:?}", head.notes);
    // Who names it goes on.
    let mut on = Terrain::begun(v1::SurfaceRequest { at: 1, ..everywhere(20.0) }, half);
    on.fetch(&c, None, |_| Ok(())).await.unwrap();
    assert!(on.bytes == before.bytes && on.head.unwrap().from > 0);
    server.stop().await.unwrap();
    // The version is gone.
    db.prune(|_| vec![1], &mut || {}).unwrap();
    let server = serve(&db).await;
    let c = connect(&server).await;
    let mut t = Terrain::new(before.refined(everywhere(10.0)).unwrap());
    t.fetch(&c, Some(&before), |_| Ok(())).await.unwrap();
    let head = t.head.clone().unwrap();
    assert!(
        head.refines.is_none() && head.notes.iter().any(|n| n.contains("version 1") && n.contains("gone"))
    );
    holds(&t.decode(Stop::End).unwrap(), &s, 5.0);
    let e = refused(&c, v1::SurfaceRequest { at: 1, ..everywhere(20.0) }).await;
    assert!(e.contains("version 1 not found"), "{e}");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_requests_are_refused_with_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    let r = request(4.0, 10.0);
    let held = |at: u64, inner: Option<v1::Held>| {
        let request = v1::SurfaceRequest { at, held: inner.map(Box::new), ..request(4.0, 20.0) };
        v1::Held { request: Some(Box::new(request)), hash: vec![0; 32].into(), bytes: 0 }
    };
    let of = |h: v1::Held| v1::SurfaceRequest { held: Some(Box::new(h)), ..r.clone() };
    let deep = (0..12).fold(None, |inner, _| Some(held(1, inner))).unwrap();
    for (r, sentence) in [
        (v1::SurfaceRequest { tolerance: None, ..r.clone() }, "tolerance: is missing"),
        (v1::SurfaceRequest { profile: 9, ..r.clone() }, "profile: 9 is none"),
        (v1::SurfaceRequest { step_x: -1.0, ..r.clone() }, "must be positive"),
        (v1::SurfaceRequest { step_x: 0.5, ..r.clone() }, "at most 2049 allowed"),
        (v1::SurfaceRequest { step_x: 1e-9, ..r.clone() }, "a larger step"),
        (v1::SurfaceRequest { bound_m: Some(f64::NAN), ..r.clone() }, "NaN is no bound"),
        (v1::SurfaceRequest { bound_m: Some(4.0), ..r.clone() }, "leave nothing of 4 m"),
        (v1::SurfaceRequest { unit_m: -1.0, ..r.clone() }, "unit: -1 m"),
        (v1::SurfaceRequest { unit_m: 1e-6, ..request(0.0, 10.0) }, "take a larger unit"),
        (v1::SurfaceRequest { layers_m: vec![1.0; 9], ..r.clone() }, "at most 8 allowed"),
        (v1::SurfaceRequest { layers_m: vec![1.0, 2.0], ..r.clone() }, "must be finer"),
        (
            v1::SurfaceRequest { layers_m: vec![2.0, 1.0], bound_m: Some(1.0), ..r.clone() },
            "leave one of both out",
        ),
        (v1::SurfaceRequest { region: region([0.0, 0.0, 9.0, 9.0]), ..r.clone() }, "the surveys lie in"),
        (v1::SurfaceRequest { coords: "EPSG:1".into(), ..r.clone() }, "EPSG:1"),
        (v1::SurfaceRequest { at: 99, ..r.clone() }, "99"),
        (of(v1::Held::default()), "held.request: is missing"),
        (of(held(0, None)), "say the version of what is held"),
        (of(deep), "at most 8 allowed"),
    ] {
        let said = refused(&c, r).await;
        assert!(said.contains(sentence), "{said}");
    }
    // What is held and is not what its request gives.
    let (head, bytes) = asked(&c, of(held(1, None))).await;
    assert!(head.notes.iter().any(|n| n.contains("not what its request gives")), "{:?}", head.notes);
    assert_eq!(head.bytes, bytes.len() as u64);
    server.stop().await.unwrap();
}

/// A server with little room.
async fn small(db: &Db) -> Running {
    let settings = Settings {
        listen: ([127, 0, 0, 1], 0).into(),
        gtb_side_max: 100,
        gtb_cache_bytes: 1,
        ..Settings::new(db.path())
    };
    start(settings).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn limits_are_settings_and_who_goes_is_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    let server = small(&db).await;
    let c = connect(&server).await;
    let said = refused(&c, request(4.0, 12.5)).await;
    assert!(said.contains("105 wanted, at most 100 allowed"), "{said}");
    // Nothing is kept: what is held is made again.
    let held = fetched(&c, request(4.0, 40.0)).await;
    let mut t = Terrain::new(held.refined(request(4.0, 20.0)).unwrap());
    t.fetch(&c, Some(&held), |_| Ok(())).await.unwrap();
    assert!(t.head.unwrap().refines.is_some());
    server.stop().await.unwrap();
    let server = serve(&db).await;
    let c = connect(&server).await;
    let wide =
        |k: usize| v1::SurfaceRequest { region: None, unit_m: 0.001 + k as f64 * 1e-6, ..request(0.0, 2.2) };
    // Sixteen may be made, wait or be read at once; who does not read keeps a place.
    let mut kept = Vec::new();
    for k in 0..16 {
        kept.push(connect(&server).await.streams().surface(wide(k)).await.unwrap().into_inner());
    }
    let said = refused(&c, request(4.0, 40.0)).await;
    assert!(said.contains("16 streams are being made"), "{said}");
    drop(kept);
    let done = async {
        loop {
            let mut t = Terrain::new(request(4.0, 40.0));
            match t.fetch(&c, None, |_| Ok(())).await {
                Ok(()) => break t.bytes.len(),
                Err(e) => assert!(e.to_string().contains("16 streams"), "{e}"),
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    // The work of sixteen stops soon.
    assert!(tokio::time::timeout(Duration::from_secs(60), done).await.unwrap() > 500);
    server.stop().await.unwrap();
}
