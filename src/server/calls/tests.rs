use super::*;
use crate::server::Settings;
use axum::Router;
use axum::body::HttpBody;
use axum::middleware::from_fn_with_state;
use axum::routing::any;
use bytes::Bytes;
use futures_util::stream;
use std::pin::Pin;
use tower::ServiceExt;

const SHORT: &str = "/terraquilt.v1.Catalog/Info";
const STREAM: &str = "/terraquilt.v1.Query/Patches";

/// A server of two methods that do as they are made to, behind everything that calls pass.
fn app(
    settings: &Settings,
    short: axum::routing::MethodRouter,
    streaming: axum::routing::MethodRouter,
) -> Router {
    let tokens = Arc::new(Tokens::open(&settings.tokens_file()).unwrap());
    // The server of these calls never stops.
    let stop: &'static watch::Sender<bool> = Box::leak(Box::new(watch::Sender::new(false)));
    let calls = Arc::new(Calls::new(settings, tokens, stop.subscribe()));
    Router::new().route(SHORT, short).route(STREAM, streaming).layer(from_fn_with_state(calls, grpc))
}

fn settings() -> Settings {
    Settings { deadline: Duration::from_millis(50), ..Settings::new("no/such/folder") }
}

/// The status in the headers, or in the trailers, of what a call answers; and whether data came.
async fn ask(app: Router, path: &str, headers: &[(&str, &str)]) -> (Status, bool) {
    let mut request = Request::builder().method("POST").uri(path);
    for (k, v) in headers {
        request = request.header(*k, *v);
    }
    let response = app.oneshot(request.body(Body::empty()).unwrap()).await.unwrap();
    assert!(response.headers().contains_key(REQUEST_ID));
    if let Some(s) = Status::from_header_map(response.headers()) {
        return (s, false);
    }
    let (mut body, mut data) = (response.into_body(), false);
    loop {
        let frame = std::future::poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)).await;
        let frame = frame.expect("the call ends with a status").unwrap();
        match frame.trailers_ref() {
            Some(t) => return (Status::from_header_map(t).unwrap(), data),
            None => data = true,
        }
    }
}

async fn never() -> Response {
    std::future::pending().await
}

/// Parts without end, one a millisecond.
async fn endless() -> Response {
    let parts = stream::unfold((), async |()| {
        tokio::time::sleep(Duration::from_millis(1)).await;
        Some((Ok::<_, std::io::Error>(Bytes::from_static(b"part")), ()))
    });
    Body::from_stream(parts).into_response()
}

#[tokio::test]
async fn a_panic_is_an_internal_status_wherever_it_happens() {
    async fn at_once() -> Response {
        panic!("a fault for this test")
    }
    async fn later() -> Response {
        let parts = stream::iter(0..2).map_ok_or_panic();
        Body::from_stream(parts).into_response()
    }
    let app = app(&settings(), any(at_once), any(later));
    let (s, _) = ask(app.clone(), SHORT, &[]).await;
    assert_eq!(s.code(), Code::Internal);
    assert!(s.message().contains("goes on"), "{s}");
    let (s, data) = ask(app, STREAM, &[]).await;
    assert_eq!((s.code(), data), (Code::Internal, true));
}

trait OrPanic: Sized {
    fn map_ok_or_panic(self) -> Pin<Box<dyn stream::Stream<Item = std::io::Result<Bytes>> + Send>>;
}

impl<S: stream::Stream<Item = i32> + Send + 'static> OrPanic for S {
    fn map_ok_or_panic(self) -> Pin<Box<dyn stream::Stream<Item = std::io::Result<Bytes>> + Send>> {
        use futures_util::StreamExt;
        Box::pin(
            self.map(
                |n| if n == 0 { Ok(Bytes::from_static(b"part")) } else { panic!("a fault for this test") },
            ),
        )
    }
}

#[tokio::test]
async fn a_short_call_has_a_deadline_and_a_stream_only_the_callers() {
    let app = app(&settings(), any(never), any(endless));
    let (s, _) = ask(app.clone(), SHORT, &[]).await;
    assert_eq!(s.code(), Code::DeadlineExceeded, "{s}");
    assert!(s.message().contains("50ms"), "{s}");
    let (s, data) = ask(app.clone(), STREAM, &[("grpc-timeout", "120m")]).await;
    assert_eq!((s.code(), data), (Code::DeadlineExceeded, true), "{s}");
    assert!(s.message().contains("120ms"), "{s}");
    let long = tokio::time::timeout(Duration::from_millis(200), ask(app.clone(), STREAM, &[])).await;
    assert!(long.is_err(), "a stream was ended by the deadline of short calls: {long:?}");
    for wrong in ["5", "S", "-1S", "123456789S", "1x", "\u{e9}"] {
        let (s, _) = ask(app.clone(), SHORT, &[("grpc-timeout", wrong)]).await;
        assert_eq!(s.code(), Code::InvalidArgument, "{wrong}: {s}");
    }
}

#[tokio::test]
async fn calls_beyond_the_bound_are_shed_and_a_place_comes_back() {
    let settings = Settings { calls_max: 1, deadline: Duration::from_secs(60), ..settings() };
    let app = app(&settings, any(never), any(async || Body::from("part").into_response()));
    let held = tokio::spawn(ask(app.clone(), SHORT, &[]));
    tokio::time::sleep(Duration::from_millis(50)).await;
    let (s, _) = ask(app.clone(), STREAM, &[]).await;
    assert_eq!(s.code(), Code::ResourceExhausted);
    assert!(s.message().contains("1 calls under way"), "{s}");
    held.abort();
    let _ = held.await;
    let answer = app.oneshot(Request::builder().uri(STREAM).body(Body::empty()).unwrap()).await.unwrap();
    assert!(Status::from_header_map(answer.headers()).is_none());
}

#[tokio::test]
async fn a_method_that_is_not_in_the_table_is_refused() {
    let app = app(&settings(), any(never), any(never)).route("/terraquilt.v1.Catalog/Drop", any(never));
    let settings = settings();
    let tokens = Arc::new(Tokens::open(&settings.tokens_file()).unwrap());
    let calls = Arc::new(Calls::new(&settings, tokens, watch::channel(false).1));
    let (s, _) = ask(app.layer(from_fn_with_state(calls, grpc)), "/terraquilt.v1.Catalog/Drop", &[]).await;
    assert_eq!(s.code(), Code::Unimplemented, "{s}");
}

#[test]
fn ids_of_callers_are_taken_only_if_a_log_can_hold_them() {
    let of = |v: &[u8]| {
        let mut headers = HeaderMap::new();
        headers.insert(REQUEST_ID, HeaderValue::from_bytes(v).unwrap());
        request_id(&headers)
    };
    assert_eq!(of(b"flight-7.upload_3"), "flight-7.upload_3");
    for strange in [&b"two words"[..], b"\xff", b"", b"a\tb", &[b'a'; 65]] {
        let made = of(strange);
        assert_eq!(made.len(), 16, "{made:?}");
        assert_ne!(made.as_bytes(), strange);
    }
}

#[test]
fn hosts_are_read_without_their_port() {
    let cases = [
        ("localhost:1", "localhost"),
        ("[::1]:50051", "::1"),
        ("127.0.0.1", "127.0.0.1"),
        ("a.example:9", "a.example"),
    ];
    for (authority, host) in cases {
        assert_eq!(host_of(authority), host);
    }
}
