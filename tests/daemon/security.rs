//! Who may do what: tokens and rights, TLS and mutual TLS.

use super::calls::Call;
use super::raw::{channel, ends, methods, open};
use super::support::empty;
use super::survey::hills;
use bytes::Bytes;
use futures_util::StreamExt;
use rcgen::{CertificateParams, DnType, IsCa, Issuer, KeyPair};
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use terraquilt::client::{Address, Connection};
use terraquilt::server::tokens::{Right, TokenFile};
use terraquilt::server::{Running, Settings, TlsFiles, start};
use terraquilt::wire::v1::InfoRequest;
use tonic::Code;

const LOOPBACK: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 0);

/// Method -> right, as the comments of `proto/` say: `Right: x` holds for the methods below it.
fn manual() -> BTreeMap<String, String> {
    let mut out = BTreeMap::new();
    for e in std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("proto/terraquilt/v1")).unwrap() {
        let (mut service, mut right) = (None, String::new());
        for line in std::fs::read_to_string(e.unwrap().path()).unwrap().lines().map(str::trim) {
            let word = |s: &str| s.split([' ', '(', '{', '.', ',']).next().unwrap().to_string();
            if let Some(rest) = line.strip_prefix("service ") {
                (service, right) = (Some(word(rest)), String::new());
            } else if let Some((_, rest)) = line.split_once("Right: ") {
                right = word(rest);
            } else if let (Some(rest), Some(s)) = (line.strip_prefix("rpc "), &service) {
                out.insert(format!("/terraquilt.v1.{s}/{}", word(rest)), right.clone());
            }
        }
    }
    out
}

#[tokio::test]
async fn every_right_against_every_method() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let file = TokenFile::at(db.path().join("tokens.json"));
    let mut tokens = vec![("none", None), ("wrong", Some("tq_00".to_string()))];
    for (name, right) in [("read", Right::Read), ("write", Right::Write), ("admin", Right::Admin)] {
        tokens.push((name, Some(file.add(right, Some(name), None).unwrap().1)));
    }
    let rank = |r: &str| ["read", "write", "admin"].iter().position(|k| *k == r);
    let server = start(Settings { listen: LOOPBACK, ..Settings::new(db.path()) }).await.unwrap();
    let channel = channel(server.address).await;
    let manual = manual();
    let (mut tried, mut wrong) = (0, Vec::new());
    for method in methods() {
        let needed = manual[&method].as_str();
        assert!(rank(needed).is_some(), "{method}: the manual says '{needed}'");
        for (name, token) in &tokens {
            let ended = ends(&channel, &method, token.as_deref(), Bytes::new()).await;
            let code = ended.map(|e| e.map_or_else(|s| s.code(), |()| Code::Ok));
            let expected = match rank(name) {
                None => Some(Code::Unauthenticated),
                Some(r) if Some(r) < rank(needed) => Some(Code::PermissionDenied),
                Some(_) => None,
            };
            let fits = match expected {
                Some(e) => code == Some(e),
                None => !matches!(code, Some(Code::Unauthenticated | Code::PermissionDenied)),
            };
            tried += 1;
            if !fits {
                wrong.push(format!("{method} ({needed}) with token {name}: {code:?}"));
            }
        }
    }
    println!("{tried} calls tried");
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(tried >= 28 * 5);
    // The sentence names both rights.
    let read = tokens[2].1.as_deref();
    let e = ends(&channel, "/terraquilt.v1.Catalog/Prune", read, Bytes::new()).await.unwrap().unwrap_err();
    assert!(e.message().contains("needs the right admin, token 'read' has the right read"), "{e}");
    // Open to all: whether it lives. Not open: what there is.
    let health = "/grpc.health.v1.Health/Check";
    assert!(ends(&channel, health, None, Bytes::new()).await.unwrap().is_ok());
    let list = "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo";
    let e = ends(&channel, list, None, Bytes::new()).await.unwrap().unwrap_err();
    assert_eq!(e.code(), Code::Unauthenticated);
    drop(channel);
    server.stop().await.unwrap();
}

#[tokio::test]
async fn a_revoked_or_expired_token_ends_streams_that_live() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let file = TokenFile::at(db.path().join("tokens.json"));
    let (_, revoked) = file.add(Right::Read, Some("crew"), None).unwrap();
    let (_, short) = file.add(Right::Read, Some("guest"), Some(Duration::from_secs(2))).unwrap();
    let server = start(Settings { listen: LOOPBACK, ..Settings::new(db.path()) }).await.unwrap();
    let channel = channel(server.address).await;
    for (token, why) in [(short, "token 'guest' has expired"), (revoked, "token 'crew' was revoked")] {
        let watch = "/grpc.health.v1.Health/Watch";
        let mut stream =
            open(&channel, watch, Some(&token), futures_util::stream::iter([Bytes::new()])).await.unwrap();
        stream.next().await.unwrap().unwrap();
        let began = Instant::now();
        if why.contains("revoked") {
            file.revoke("crew").unwrap();
        }
        let end =
            tokio::time::timeout(Duration::from_secs(5), stream.next()).await.unwrap().unwrap().unwrap_err();
        println!("{why}: {:?} later", began.elapsed());
        assert_eq!((end.code(), end.message()), (Code::Unauthenticated, why));
        let e = ends(&channel, watch, Some(&token), Bytes::new()).await.unwrap().unwrap_err();
        assert_eq!(e.code(), Code::Unauthenticated);
    }
    drop(channel);
    server.stop().await.unwrap();
}

#[tokio::test]
async fn streams_without_a_token_end_when_the_first_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = start(Settings { listen: LOOPBACK, ..Settings::new(db.path()) }).await.unwrap();
    let channel = channel(server.address).await;
    let watch = "/grpc.health.v1.Health/Watch";
    let mut stream = open(&channel, watch, None, futures_util::stream::iter([Bytes::new()])).await.unwrap();
    stream.next().await.unwrap().unwrap();
    TokenFile::at(db.path().join("tokens.json")).add(Right::Read, None, None).unwrap();
    let end =
        tokio::time::timeout(Duration::from_secs(5), stream.next()).await.unwrap().unwrap().unwrap_err();
    assert_eq!(end.code(), Code::Unauthenticated);
    assert!(end.message().contains("tokens were made"), "{end}");
    drop(channel);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_whose_token_was_revoked_cannot_be_finished() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let file = TokenFile::at(db.path().join("tokens.json"));
    let (_, secret) = file.add(Right::Write, Some("crew"), None).unwrap();
    let server = start(Settings { listen: LOOPBACK, ..Settings::new(db.path()) }).await.unwrap();
    let address = Address { server: server.address.to_string(), token: Some(secret), ..Address::default() };
    let c = Connection::open(&address).await.unwrap();
    let survey = hills("hills", 20, 0.0, 1);
    let (mut call, _) = Call::begin(&c, &survey.header).await.unwrap();
    call.block(survey.block(0, 0, 20)).await;
    call.durable(20).await;
    file.revoke("crew").unwrap();
    let e = call.refused().await;
    assert!(e.code() == Code::Unauthenticated && e.message().contains("revoked"), "{e}");
    // A client that goes on as if nothing had been said.
    call.finish().await;
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert_eq!(db.newest().unwrap(), 0);
    drop((call, c));
    server.stop().await.unwrap();
}

#[tokio::test]
async fn beyond_loopback_needs_tokens_or_a_clear_word() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let settings = Settings { listen: "0.0.0.0:0".parse().unwrap(), ..Settings::new(db.path()) };
    let e = start(settings.clone()).await.err().expect("refused").to_string();
    assert!(
        e.contains("0.0.0.0:0") && e.contains("terraquilt token add") && e.contains("--insecure-open"),
        "{e}"
    );
    let open = start(Settings { insecure_open: true, ..settings.clone() }).await.unwrap();
    open.stop().await.unwrap();
    TokenFile::at(db.path().join("tokens.json")).add(Right::Read, None, None).unwrap();
    start(settings).await.unwrap().stop().await.unwrap();
}

/// Who signs.
struct Authority {
    issuer: Issuer<'static, KeyPair>,
    pem: String,
}

fn authority(name: &str) -> Authority {
    let mut params = CertificateParams::new(vec![]).unwrap();
    params.is_ca = IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
    params.distinguished_name.push(DnType::CommonName, name);
    let key = KeyPair::generate().unwrap();
    let pem = params.self_signed(&key).unwrap().pem();
    Authority { issuer: Issuer::new(params, key), pem }
}

/// A certificate and its key.
fn signed(by: &Authority, name: &str, years: [i32; 2]) -> (String, String) {
    let mut params = CertificateParams::new(vec![name.to_string()]).unwrap();
    params.not_before = rcgen::date_time_ymd(years[0], 1, 1);
    params.not_after = rcgen::date_time_ymd(years[1], 1, 1);
    let key = KeyPair::generate().unwrap();
    (params.signed_by(&key, &by.issuer).unwrap().pem(), key.serialize_pem())
}

const GOOD: [i32; 2] = [2020, 2090];
const EXPIRED: [i32; 2] = [2010, 2020];

fn write(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

/// A server with a certificate; `client_ca`: who signs those of its clients.
async fn serve_tls(
    folder: &Path,
    (certificate, key): &(String, String),
    client_ca: Option<&Authority>,
) -> Running {
    let db = empty(folder);
    let tls = TlsFiles {
        certificates: write(folder, "server.pem", certificate),
        key: write(folder, "server.key", key),
        client_ca: client_ca.map(|a| write(folder, "clients.pem", &a.pem)),
    };
    start(Settings { listen: LOOPBACK, tls: Some(tls), ..Settings::new(db.path()) }).await.unwrap()
}

/// What a call through the client of this crate says: nothing if it reached the server.
async fn call(
    server: &Running,
    ca: Option<&Authority>,
    identity: Option<&(String, String)>,
) -> Result<(), String> {
    let address = Address {
        server: format!("https://localhost:{}", server.address.port()),
        ca: ca.map(|a| a.pem.clone().into_bytes()),
        identity: identity.map(|(c, k)| (c.clone().into_bytes(), k.clone().into_bytes())),
        ..Address::default()
    };
    let connection = Connection::open(&address).await.map_err(|e| e.to_string())?;
    match connection.catalog().info(InfoRequest::default()).await {
        Ok(_) => Ok(()),
        Err(s) if s.code() == Code::Unimplemented => Ok(()),
        Err(s) => Err(s.to_string()),
    }
}

#[tokio::test]
async fn wrong_and_expired_certificates_are_refused_and_the_server_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (ours, theirs) = (authority("ours"), authority("theirs"));
    let server = serve_tls(folder.path(), &signed(&ours, "localhost", GOOD), None).await;
    call(&server, Some(&ours), None).await.unwrap();
    let e = call(&server, Some(&theirs), None).await.unwrap_err();
    println!("{e}");
    assert!(e.contains("UnknownIssuer") || e.contains("BadSignature"), "{e}");
    // Nor do those whom the system trusts sign for us.
    let e = call(&server, None, None).await.unwrap_err();
    println!("{e}");
    // Plain words to a port that speaks TLS, and noise.
    let plain = Address { server: server.address.to_string(), ..Address::default() };
    let refused = match Connection::open(&plain).await {
        Err(_) => true,
        Ok(c) => {
            c.catalog().info(InfoRequest::default()).await.is_err_and(|s| s.code() != Code::Unimplemented)
        }
    };
    assert!(refused, "a plain call was answered on a TLS port");
    let said = super::raw::exchange(server.address, b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").await;
    assert!(!said.contains("HTTP/1.1 200"), "{said}");
    super::raw::exchange(server.address, &[0x16, 3, 1, 0xff, 0xff, 1, 2, 3, 4, 5, 0, 0, 0, 0, 0]).await;
    call(&server, Some(&ours), None).await.unwrap();
    server.stop().await.unwrap();

    for (name, years, why) in
        [("localhost", EXPIRED, "xpired"), ("elsewhere.example", GOOD, "not valid for name")]
    {
        let folder = tempfile::tempdir().unwrap();
        let server = serve_tls(folder.path(), &signed(&ours, name, years), None).await;
        let e = call(&server, Some(&ours), None).await.unwrap_err();
        println!("{e}");
        assert!(e.contains(why), "{e}");
        server.stop().await.unwrap();
    }
}

#[tokio::test]
async fn mutual_tls_lets_in_only_whom_its_authority_signed() {
    let folder = tempfile::tempdir().unwrap();
    let (ours, clients, theirs) = (authority("ours"), authority("clients"), authority("theirs"));
    let server = serve_tls(folder.path(), &signed(&ours, "localhost", GOOD), Some(&clients)).await;
    let good = signed(&clients, "crew", GOOD);
    call(&server, Some(&ours), Some(&good)).await.unwrap();
    for (what, identity) in [
        ("none", None),
        ("expired", Some(signed(&clients, "crew", EXPIRED))),
        ("another authority's", Some(signed(&theirs, "crew", GOOD))),
        ("the server's authority's", Some(signed(&ours, "crew", GOOD))),
    ] {
        let e = call(&server, Some(&ours), identity.as_ref()).await.expect_err(what);
        println!("{what}: {e}");
    }
    call(&server, Some(&ours), Some(&good)).await.unwrap();
    server.stop().await.unwrap();
}

#[tokio::test]
async fn files_that_are_no_certificates_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let ours = authority("ours");
    let (certificate, key) = signed(&ours, "localhost", GOOD);
    let (_, other_key) = signed(&ours, "localhost", GOOD);
    let good = write(folder.path(), "good.pem", &certificate);
    let nothing = write(folder.path(), "nothing.pem", "nothing\n");
    let absent = folder.path().join("absent.pem");
    let (key, other_key) = (write(folder.path(), "k", &key), write(folder.path(), "o", &other_key));
    for (certificates, key, names) in [
        (&nothing, &key, "nothing.pem"),
        (&absent, &key, "absent.pem"),
        (&good, &nothing, "nothing.pem"),
        (&good, &other_key, "its own key"),
    ] {
        let tls = TlsFiles { certificates: certificates.clone(), key: key.clone(), client_ca: None };
        let e = start(Settings { listen: LOOPBACK, tls: Some(tls), ..Settings::new(db.path()) }).await;
        let e = e.err().expect("refused").to_string();
        assert!(e.contains(names), "{e}");
    }
}
