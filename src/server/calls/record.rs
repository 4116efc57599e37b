//! What a call was and how it ended: one line of the log, and the numbers of `/metrics`.

use crate::server::metrics;
use http::{HeaderMap, HeaderValue, StatusCode};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Instant;
use tonic::{Code, Status};

/// A call under way. When it is dropped, the call is over, and is logged; without an end until then, its client went away.
pub struct Record {
    method: &'static str,
    id: HeaderValue,
    peer: Option<SocketAddr>,
    token: String,
    began: Instant,
    received: Arc<AtomicU64>,
    sent: u64,
    code: Option<String>,
    /// Why it was refused or ended, in the words that the caller got.
    reason: Option<String>,
    fault: bool,
    _open: metrics::OpenCall,
}

impl Record {
    pub fn begin(method: &'static str, id: &HeaderValue, peer: Option<SocketAddr>) -> Record {
        Record {
            method,
            id: id.clone(),
            peer,
            token: "-".into(),
            began: Instant::now(),
            received: Arc::default(),
            sent: 0,
            code: None,
            reason: None,
            fault: false,
            _open: metrics::open_call(method),
        }
    }

    pub fn caller(&mut self, name: &str) {
        self.token = name.to_string();
    }

    /// Where received bytes are counted.
    pub fn received(&self) -> Arc<AtomicU64> {
        self.received.clone()
    }

    pub fn sent(&mut self, bytes: u64) {
        self.sent += bytes;
    }

    /// The call ends with this status.
    pub fn refused(&mut self, status: &Status) {
        self.end(status.code());
        self.reason = Some(status.message().to_string());
    }

    /// The head of an answer is there; it says how the call ended if there is nothing more.
    pub fn answered(&mut self, http: StatusCode, headers: &HeaderMap) {
        if http != StatusCode::OK {
            self.code = Some(http.as_u16().to_string());
        }
        self.ended(headers);
    }

    /// The headers or trailers that may hold the status.
    pub fn ended(&mut self, headers: &HeaderMap) {
        if let Some(status) = Status::from_header_map(headers) {
            if status.code() != Code::Ok {
                self.refused(&status);
            } else {
                self.end(Code::Ok);
            }
        }
    }

    /// A page was answered.
    pub fn page(&mut self, http: StatusCode, bytes: u64) {
        self.code = Some(http.as_u16().to_string());
        self.fault = http.is_server_error();
        self.sent = bytes;
    }

    fn end(&mut self, code: Code) {
        self.code = Some(name(code).into());
        self.fault = matches!(code, Code::Internal | Code::Unknown | Code::DataLoss);
    }
}

impl Drop for Record {
    fn drop(&mut self) {
        let took = self.began.elapsed();
        let code = self.code.as_deref().unwrap_or("CANCELLED");
        let received = self.received.load(Relaxed);
        metrics::call(self.method, code, took, received, self.sent);
        macro_rules! line {
            ($level:ident) => {
                tracing::$level!(
                    target: "terraquilt::call",
                    id = self.id.to_str().unwrap_or("-"),
                    method = self.method,
                    peer = self.peer.map(tracing::field::display),
                    token = self.token,
                    code,
                    ms = took.as_micros() as f64 / 1000.0,
                    received,
                    sent = self.sent,
                    reason = self.reason,
                    "call"
                )
            };
        }
        if self.fault {
            line!(error);
        } else {
            line!(info);
        }
    }
}

/// A code as gRPC's documents write it.
fn name(code: Code) -> &'static str {
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}
