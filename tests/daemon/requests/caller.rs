//! A server in this process, called without sockets.

use axum::Router;
use axum::body::{Body, Bytes};
use futures_util::StreamExt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use terraquilt::db::{Change, Db, Ingest, Options, Policy, Progress};
use terraquilt::height::crs::Crs;
use terraquilt::height::patch::Kind;
use terraquilt::server::{Settings, State, routes};
use tonic::Code;
use tower::ServiceExt;

/// Bytes of an answer that are read before its caller goes away.
const READ_MAX: usize = 8 << 20;
/// How long a caller stays.
const STAY: Duration = Duration::from_millis(300);

/// How a call ended; `code` is `None` if the caller went away first.
pub struct End {
    pub code: Option<Code>,
    pub message: String,
}

/// A server over two surveys of Mount St. Helens.
pub struct Caller {
    runtime: tokio::runtime::Runtime,
    router: Router,
    pub names: Vec<String>,
    pub bounds: [f64; 4],
    _folder: tempfile::TempDir,
}

impl Caller {
    pub fn new() -> Caller {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let crs = Crs::from_epsg(26910).expect("EPSG:26910 is known");
        let options = Options { crs, policy: Policy::Newest, patch: Kind::Bilinear };
        let db = Db::create(&folder.path().join("db"), &options).expect("the folder is writable");
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/st_helens");
        let data = if data.is_dir() { data } else { Path::new("../tests/data/st_helens").to_path_buf() };
        let surveys =
            [("survey_2004-10-04_native.tif", "2004-10-04"), ("survey_2004-10-11_native.tif", "2004-10-11")];
        let mut names = Vec::new();
        for (file, date) in surveys {
            let request = Ingest {
                name: Some(date.into()),
                accuracy_m: Some(0.5),
                date: terraquilt::base::date::Date::parse(date).ok(),
                ..Ingest::new(vec![
                    terraquilt::format::open(&data.join(file)).expect("a survey of the repository"),
                ])
            };
            let progress = Progress { report: &|_, _| {}, stop: &AtomicBool::new(false) };
            db.change(Change::Ingest(request), None, false, &progress, &mut || {}).expect("it is sound");
            names.push(date.to_string());
        }
        let bounds = db.snapshot(None).expect("it was made").bounds().expect("it has surveys");
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .expect("threads can be started");
        let state = Arc::new(State::open(Settings::new(db.path())).expect("the database is sound"));
        let router = runtime.block_on(async { routes(&state) });
        Caller { runtime, router, names, bounds, _folder: folder }
    }

    /// Calls a method (`/package.Service/Method`) with some messages, each framed as gRPC has them.
    pub fn call(&self, method: &str, messages: &[Vec<u8>]) -> End {
        let mut framed = Vec::new();
        for m in messages {
            framed.push(0);
            framed.extend_from_slice(&(m.len() as u32).to_be_bytes());
            framed.extend_from_slice(m);
        }
        let request = http::Request::post(format!("http://localhost{method}"))
            .version(http::Version::HTTP_2)
            .header("content-type", "application/grpc")
            .header("te", "trailers")
            .body(Body::from(framed))
            .expect("the parts are sound");
        let router = self.router.clone();
        self.runtime.block_on(async move {
            tokio::time::timeout(STAY, answer(router, request))
                .await
                .unwrap_or(End { code: None, message: String::new() })
        })
    }
}

async fn answer(router: Router, request: http::Request<Body>) -> End {
    let response = router.oneshot(request).await.expect("a router has no errors of its own");
    let (parts, body) = response.into_parts();
    let status = |h: &http::HeaderMap| {
        let code = h.get("grpc-status")?.to_str().ok()?.parse::<i32>().ok()?;
        let message =
            h.get("grpc-message").map_or(String::new(), |m| String::from_utf8_lossy(m.as_bytes()).into());
        Some(End { code: Some(Code::from(code)), message })
    };
    if let Some(end) = status(&parts.headers) {
        return end;
    }
    let mut read = 0;
    let mut frames = http_body_util::BodyStream::new(body);
    while let Some(frame) = frames.next().await {
        let Ok(frame) = frame else { return End { code: Some(Code::Unknown), message: "broken".into() } };
        match frame.into_data() {
            Ok::<Bytes, _>(data) => read += data.len(),
            Err(frame) => {
                if let Some(end) = frame.trailers_ref().and_then(status) {
                    return end;
                }
            }
        }
        if read > READ_MAX {
            break;
        }
    }
    End { code: None, message: String::new() }
}
