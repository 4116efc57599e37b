//! Numbers about the server, as Prometheus reads them at `/metrics`. One set for the process.

use super::State;
use ::metrics::{counter, describe_counter, describe_gauge, describe_histogram, gauge, histogram};
use axum::extract::State as Shared;
use axum::response::{IntoResponse, Response};
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::sync::watch;

/// Seconds at which durations are told apart: a frame is 0.016 or 0.033.
const BUCKETS: [f64; 17] = [
    0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.033, 0.066, 0.125, 0.25, 0.5, 1.0, 2.0, 5.0, 15.0, 60.0,
    300.0,
];
/// How often what was measured is summed up, scraped or not.
const SUM_EVERY: Duration = Duration::from_secs(5);

static HANDLE: OnceLock<Option<PrometheusHandle>> = OnceLock::new();

fn handle() -> Option<&'static PrometheusHandle> {
    HANDLE
        .get_or_init(|| {
            let seconds = Matcher::Suffix("_seconds".into());
            let recorder =
                PrometheusBuilder::new().set_buckets_for_metric(seconds, &BUCKETS).ok()?.build_recorder();
            let handle = recorder.handle();
            // Another recorder in this process keeps its place, and this page stays empty.
            ::metrics::set_global_recorder(recorder).ok()?;
            describe();
            Some(handle)
        })
        .as_ref()
}

fn describe() {
    describe_counter!(
        "terraquilt_calls_total",
        "Calls that ended, by method and gRPC code (pages: HTTP status)."
    );
    describe_histogram!("terraquilt_call_seconds", "How long calls took, by method.");
    describe_counter!("terraquilt_received_bytes_total", "Bytes of messages received, by method.");
    describe_counter!("terraquilt_sent_bytes_total", "Bytes of messages sent, by method.");
    describe_gauge!("terraquilt_calls_open", "Calls under way, by method.");
    describe_counter!(
        "terraquilt_calls_shed_total",
        "Calls refused because too many were under way, by method."
    );
    describe_gauge!("terraquilt_connections_open", "Connections that are open.");
    describe_counter!(
        "terraquilt_connections_refused_total",
        "Connections closed before their first call, by reason."
    );
    describe_counter!("terraquilt_commits_total", "Commits that were asked for here, by how they ended.");
    describe_gauge!("terraquilt_version", "The newest version of the database.");
    describe_gauge!("terraquilt_surveys", "Surveys in it.");
    describe_gauge!("terraquilt_uploads_open", "Uploads in progress, or kept to be resumed.");
    describe_gauge!("terraquilt_view_sessions", "Sessions of views, also those kept for clients that left.");
    describe_gauge!(
        "terraquilt_queue",
        "Answers, files and checks, and commits that wait for a thread, by pool."
    );
    describe_gauge!("terraquilt_view_sessions", "Sessions of views that are held.");
    describe_gauge!("terraquilt_uploads_open", "Uploads that are not committed yet.");
    describe_counter!("terraquilt_patches_sent_total", "Patches made for answers, by service.");
    describe_gauge!("process_resident_memory_bytes", "Memory that the process holds.");
    describe_gauge!("process_open_fds", "Files and connections that the process has open.");
}

/// Makes ready to count, and sums up until told to stop.
pub fn start(mut stopped: watch::Receiver<bool>) {
    let Some(handle) = handle() else { return };
    tokio::spawn(async move {
        while !*stopped.borrow() {
            tokio::select! {
                () = tokio::time::sleep(SUM_EVERY) => handle.run_upkeep(),
                _ = stopped.changed() => break,
            }
        }
    });
}

/// Everything counted so far, as Prometheus reads it.
pub fn page(state: &State) -> String {
    let Some(handle) = handle() else { return String::new() };
    let newest = state.live.newest();
    gauge!("terraquilt_version").set(newest.number() as f64);
    gauge!("terraquilt_surveys").set(newest.entries().count() as f64);
    gauge!("terraquilt_view_sessions").set(state.views.count() as f64);
    if let Ok(uploads) = state.uploads.count() {
        gauge!("terraquilt_uploads_open").set(uploads as f64);
    }
    for (pool, waiting) in state.pools.waiting() {
        gauge!("terraquilt_queue", "pool" => pool).set(waiting as f64);
    }
    if let Some(bytes) = resident_bytes() {
        gauge!("process_resident_memory_bytes").set(bytes as f64);
    }
    if let Ok(open) = std::fs::read_dir("/proc/self/fd") {
        gauge!("process_open_fds").set(open.count() as f64);
    }
    handle.render()
}

fn resident_bytes() -> Option<usize> {
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: usize = text.split(' ').nth(1)?.parse().ok()?;
    Some(pages * rustix::param::page_size())
}

/// Counts a call until it is dropped.
pub struct OpenCall(&'static str);

pub fn open_call(method: &'static str) -> OpenCall {
    gauge!("terraquilt_calls_open", "method" => method).increment(1.0);
    OpenCall(method)
}

impl Drop for OpenCall {
    fn drop(&mut self) {
        gauge!("terraquilt_calls_open", "method" => self.0).decrement(1.0);
    }
}

/// A call is over.
pub fn call(method: &'static str, code: &str, took: Duration, received: u64, sent: u64) {
    counter!("terraquilt_calls_total", "method" => method, "code" => code.to_string()).increment(1);
    histogram!("terraquilt_call_seconds", "method" => method).record(took.as_secs_f64());
    counter!("terraquilt_received_bytes_total", "method" => method).increment(received);
    counter!("terraquilt_sent_bytes_total", "method" => method).increment(sent);
}

/// A call was refused because too many were under way.
pub fn shed(method: &'static str) {
    counter!("terraquilt_calls_shed_total", "method" => method).increment(1);
}

/// Counts a connection until it is dropped.
pub struct OpenConnection(());

pub fn open_connection() -> OpenConnection {
    gauge!("terraquilt_connections_open").increment(1.0);
    OpenConnection(())
}

impl Drop for OpenConnection {
    fn drop(&mut self) {
        gauge!("terraquilt_connections_open").decrement(1.0);
    }
}

/// A connection was closed before its first call.
pub fn refused_connection(reason: &'static str) {
    counter!("terraquilt_connections_refused_total", "reason" => reason).increment(1);
}

/// Patches were made for an answer.
pub fn patches_sent(service: &'static str, patches: usize) {
    counter!("terraquilt_patches_sent_total", "service" => service).increment(patches as u64);
}

/// A commit that was asked for ended.
pub fn commit(done: bool) {
    counter!("terraquilt_commits_total", "end" => if done { "done" } else { "failed" }).increment(1);
}

/// The page, for callers of `/metrics`.
pub async fn scrape(Shared(state): Shared<Arc<State>>) -> Response {
    let shared = state.clone();
    match state.pools.work(move || Ok(page(&shared))).await {
        Ok(text) => {
            let kind = [(http::header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")];
            (kind, text).into_response()
        }
        Err(e) => (http::StatusCode::INTERNAL_SERVER_ERROR, format!("{}\n", e.message())).into_response(),
    }
}
