//! What happens to every call, whatever it asks: it gets an id, a right, a place among those under way, a time to end, and a
//! line in the log.
//!
//! In order: the method is looked up in [`rights`]; the token is compared with the right it needs; calls beyond the bounds are
//! shed with a status; a deadline, a revoked token and the stopping server end the call with a status, in its headers or its
//! trailers; a panic becomes `INTERNAL`. The line in the log and the numbers in `/metrics` come from [`Record`].

mod body;
mod record;

use super::listen::Peer;
use super::metrics;
use super::settings::Settings;
use super::tokens::rights::{self, Lasts};
use super::tokens::{Caller, Tokens};
use axum::body::Body;
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use base64::Engine;
use body::{CallBody, Counted, Ending};
use futures_util::FutureExt;
use http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use record::Record;
use std::net::IpAddr;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;
use tokio::sync::{Semaphore, watch};
use tonic::{Code, Status};

/// The header that names a call, in requests and answers.
pub const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// What all calls pass.
pub struct Calls {
    tokens: Arc<Tokens>,
    room: Arc<Semaphore>,
    long_room: Arc<Semaphore>,
    stopped: watch::Receiver<bool>,
    calls_max: usize,
    streams_max: usize,
    deadline: Duration,
    grace: Duration,
    insecure_open: bool,
}

impl Calls {
    pub fn new(settings: &Settings, tokens: Arc<Tokens>, stopped: watch::Receiver<bool>) -> Calls {
        Calls {
            tokens,
            room: Arc::new(Semaphore::new(settings.calls_max)),
            long_room: Arc::new(Semaphore::new(settings.streams_max)),
            stopped,
            calls_max: settings.calls_max,
            streams_max: settings.streams_max,
            deadline: settings.deadline,
            grace: settings.grace,
            insecure_open: settings.insecure_open,
        }
    }

    /// Refuses what no page or program of this machine sends: a browser that was told that a stranger's name is this machine.
    #[allow(clippy::result_large_err)]
    fn refuse_strange_host(&self, request: &Request) -> Result<(), Status> {
        if self.tokens.guarded() || self.insecure_open {
            return Ok(());
        }
        let named = request.headers().get(header::HOST).and_then(|h| h.to_str().ok());
        let Some(host) = request.uri().authority().map(http::uri::Authority::as_str).or(named) else {
            return Ok(());
        };
        let name = host.parse::<http::uri::Authority>().map_or("", |_| host_of(host));
        let local = name == "localhost" || name.ends_with(".localhost") || name.parse::<IpAddr>().is_ok();
        if local {
            return Ok(());
        }
        Err(Status::permission_denied(format!(
            "this server needs no token and so answers only to localhost and to addresses, not to the name '{}'; make tokens \
             (`terraquilt token add`) or start it with --insecure-open",
            name.escape_default()
        )))
    }

    /// A status for a call whose one message does not come: it would keep its place for ever.
    fn unsaid(&self, lasts: Lasts, whole: Arc<AtomicBool>) -> impl Future<Output = Status> + use<> {
        let within = self.deadline;
        async move {
            if lasts == Lasts::Stream {
                tokio::time::sleep(within).await;
                if !whole.load(Relaxed) {
                    return Status::deadline_exceeded(format!(
                        "the message of the call did not come within {within:?}"
                    ));
                }
            }
            std::future::pending().await
        }
    }

    /// A status with which the call ends from outside, when its time has come.
    fn ending(self: &Arc<Self>, caller: &Caller, lasts: Lasts, within: Option<Duration>) -> Ending {
        let (calls, caller) = (self.clone(), caller.clone());
        let mut stopped = self.stopped.clone();
        Box::pin(async move {
            let late = async {
                match within {
                    None => std::future::pending().await,
                    Some(t) => tokio::time::sleep(t).await,
                }
            };
            let stopping = async {
                if stopped.wait_for(|s| *s).await.is_ok() && lasts != Lasts::Endless {
                    tokio::time::sleep(calls.grace).await;
                }
            };
            tokio::select! {
                () = late => Status::deadline_exceeded(format!(
                    "the call took longer than {:?}, the time it was given; ask for less, or give it more (grpc-timeout)",
                    within.unwrap_or_default()
                )),
                () = stopping => stopping_status(),
                status = calls.tokens.withdrawn(&caller) => status,
            }
        })
    }
}

fn stopping_status() -> Status {
    Status::unavailable("the server is stopping; try again when it is back")
}

/// A call of a method.
pub async fn grpc(State(calls): State<Arc<Calls>>, request: Request, next: Next) -> Response {
    let id = request_id(request.headers());
    let mut response = call(calls, request, next, &id).await;
    response.headers_mut().insert(REQUEST_ID, id);
    response
}

async fn call(calls: Arc<Calls>, mut request: Request, next: Next, id: &HeaderValue) -> Response {
    let path = request.uri().path();
    let method = rights::find(path);
    let peer = request.extensions().get::<Peer>().cloned();
    let mut record =
        Record::begin(method.map_or("unknown", |m| m.path), id, peer.as_ref().map(|p| p.address));
    macro_rules! refuse {
        ($status:expr) => {{
            let status: Status = $status;
            record.refused(&status);
            return status.into_http();
        }};
    }
    let Some(method) = method else {
        refuse!(Status::unimplemented(format!(
            "'{}' is no method of this server; reflection names all there are",
            path.escape_default()
        )))
    };
    if let Err(status) = calls.refuse_strange_host(&request) {
        refuse!(status)
    }
    let caller = match calls.tokens.admit(given(request.headers()).as_deref(), method.needs, &path[1..]) {
        Ok(c) => c,
        Err(status) => refuse!(status),
    };
    record.caller(caller.name());
    if *calls.stopped.borrow() {
        refuse!(stopping_status())
    }
    let within = match timeout(request.headers()) {
        Ok(Some(t)) => Some(t),
        Ok(None) => (method.lasts == Lasts::Short).then_some(calls.deadline),
        Err(status) => refuse!(status),
    };
    let (room, max, what) = match method.lasts {
        Lasts::Short | Lasts::Stream => (&calls.room, calls.calls_max, "calls"),
        Lasts::Fed | Lasts::Endless => {
            (&calls.long_room, calls.streams_max, "long calls (views, watches, uploads)")
        }
    };
    let Ok(place) = room.clone().try_acquire_owned() else {
        metrics::shed(method.path);
        refuse!(Status::resource_exhausted(format!(
            "the server has {max} {what} under way, as many as it takes; try again in a moment"
        )))
    };
    let mark = peer.map(|p| p.guard.call());
    request.headers_mut().insert(REQUEST_ID, id.clone());
    // Nothing behind this needs the secret.
    request.headers_mut().remove(header::AUTHORIZATION);
    let (parts, body) = request.into_parts();
    let body = Counted::new(body, record.received());
    let unsaid = calls.unsaid(method.lasts, body.whole());
    let request = Request::from_parts(parts, Body::new(body));
    let mut ending = calls.ending(&caller, method.lasts, within);
    let answer = AssertUnwindSafe(next.run(request)).catch_unwind();
    let answered = tokio::select! {
        answered = answer => answered,
        status = &mut ending => refuse!(status),
        status = unsaid => refuse!(status),
    };
    match answered {
        Ok(response) => {
            record.answered(response.status(), response.headers());
            response.map(|b| Body::new(CallBody::new(b, ending, record, mark, place)))
        }
        Err(_) => refuse!(body::fault()),
    }
}

/// A page.
pub async fn page(State(calls): State<Arc<Calls>>, mut request: Request, next: Next) -> Response {
    let id = request_id(request.headers());
    let path = request.uri().path();
    let peer = request.extensions().get::<Peer>().cloned();
    let known = ["/", "/healthz", "/metrics"].into_iter().find(|p| *p == path);
    let mut record = Record::begin(known.unwrap_or("unknown page"), &id, peer.as_ref().map(|p| p.address));
    let _mark = peer.map(|p| p.guard.call());
    let admitted = calls.refuse_strange_host(&request).and_then(|()| {
        calls.tokens.admit(given(request.headers()).as_deref(), rights::of_page(path), "this page")
    });
    let mut response = match admitted {
        Err(status) => {
            record.refused(&status);
            refused_page(&status)
        }
        Ok(caller) => {
            record.caller(caller.name());
            request.headers_mut().remove(header::AUTHORIZATION);
            let answer = AssertUnwindSafe(next.run(request)).catch_unwind();
            let response = match tokio::time::timeout(calls.deadline, answer).await {
                Ok(Ok(response)) => response,
                Ok(Err(_)) => refused_page(&body::fault()),
                Err(_) => refused_page(&Status::deadline_exceeded("the page took too long")),
            };
            record.page(response.status(), axum::body::HttpBody::size_hint(response.body()).lower());
            response
        }
    };
    response.headers_mut().insert(REQUEST_ID, id);
    response
}

fn refused_page(status: &Status) -> Response {
    let code = match status.code() {
        Code::Unauthenticated => StatusCode::UNAUTHORIZED,
        Code::PermissionDenied => StatusCode::FORBIDDEN,
        Code::Internal => StatusCode::INTERNAL_SERVER_ERROR,
        _ => StatusCode::SERVICE_UNAVAILABLE,
    };
    let mut response = (code, format!("{}\n", status.message())).into_response();
    if code == StatusCode::UNAUTHORIZED {
        // A browser asks for a name (any) and a password (the token).
        let ask = HeaderValue::from_static("Basic realm=\"terraquilt: any name, the token as password\"");
        response.headers_mut().insert(header::WWW_AUTHENTICATE, ask);
    }
    response
}

/// The name of a host without its port.
fn host_of(authority: &str) -> &str {
    match authority.strip_prefix('[') {
        Some(v6) => v6.split(']').next().unwrap_or(""),
        None => authority.split(':').next().unwrap_or(""),
    }
}

/// The token that was given: as a bearer's, or as the password of a browser.
fn given(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::AUTHORIZATION)?.to_str().ok()?;
    let (scheme, rest) = value.split_once(' ')?;
    let rest = rest.trim();
    match scheme.to_ascii_lowercase().as_str() {
        "bearer" => Some(rest.to_string()),
        "basic" => {
            let bytes = base64::engine::general_purpose::STANDARD.decode(rest).ok()?;
            let text = String::from_utf8(bytes).ok()?;
            text.split_once(':').map(|(_, password)| password.to_string())
        }
        _ => None,
    }
}

/// The caller's name for this call if it is fit for a log, else one of ours.
fn request_id(headers: &HeaderMap) -> HeaderValue {
    let sane = |v: &&HeaderValue| {
        let fits = |b: &u8| b.is_ascii_alphanumeric() || b"._-".contains(b);
        !v.is_empty() && v.len() <= 64 && v.as_bytes().iter().all(fits)
    };
    if let Some(v) = headers.get(REQUEST_ID).filter(sane) {
        return v.clone();
    }
    let mut random = [0u8; 8];
    // Without randomness all calls have one name: no reason to refuse them.
    let _ = getrandom::fill(&mut random);
    let hex: String = random.iter().map(|b| format!("{b:02x}")).collect();
    HeaderValue::try_from(hex).unwrap_or(HeaderValue::from_static("-"))
}

/// The time that the caller gives (`grpc-timeout`: up to eight digits and a unit).
#[allow(clippy::result_large_err)]
fn timeout(headers: &HeaderMap) -> Result<Option<Duration>, Status> {
    let Some(value) = headers.get("grpc-timeout") else { return Ok(None) };
    let text = value.to_str().unwrap_or("");
    let parsed = || {
        let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
        if digits.is_empty() || digits.len() > 8 || !digits.bytes().all(|b| b.is_ascii_digit()) {
            return None;
        }
        let n: u64 = digits.parse().ok()?;
        Some(match unit {
            "H" => Duration::from_secs(n * 3600),
            "M" => Duration::from_secs(n * 60),
            "S" => Duration::from_secs(n),
            "m" => Duration::from_millis(n),
            "u" => Duration::from_micros(n),
            "n" => Duration::from_nanos(n),
            _ => return None,
        })
    };
    parsed().map(Some).ok_or_else(|| {
        Status::invalid_argument(format!(
            "grpc-timeout '{}' is no time; give up to eight digits and one of H, M, S, m, u, n",
            text.escape_default()
        ))
    })
}

#[cfg(test)]
mod tests;
