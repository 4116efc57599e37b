//! The HTTP side: a page for people at `/`, a sign of life at `/healthz`, numbers at `/metrics`. No scripts, nothing from
//! elsewhere.

use super::{State, metrics};
use crate::db::{self, SurveyRow};
use axum::Router;
use axum::extract::State as Shared;
use axum::response::{Html, IntoResponse, Response};
use axum::routing::get;
use http::{HeaderValue, StatusCode, header};
use std::fmt::Write;
use std::sync::Arc;

/// Surveys that the page lists.
const LISTED_MAX: usize = 1000;

/// The pages.
pub fn routes(state: &Arc<State>) -> Router {
    Router::new()
        .route("/", get(index))
        .route("/healthz", get(async || "ok\n"))
        .route("/metrics", get(metrics::scrape))
        .fallback(async || (StatusCode::NOT_FOUND, "no such page; there are /, /healthz and /metrics\n"))
        .with_state(state.clone())
}

async fn index(Shared(state): Shared<Arc<State>>) -> Response {
    let shared = state.clone();
    let made = state.pools.work(move || {
        let s = shared.live.newest();
        let rows = db::surveys(&s)?;
        Ok(html(&rows, s.number(), &s.crs().code))
    });
    match made.await {
        Ok(text) => {
            let mut response = Html(text).into_response();
            let rule = HeaderValue::from_static("default-src 'none'; style-src 'unsafe-inline'");
            response.headers_mut().insert(header::CONTENT_SECURITY_POLICY, rule);
            response
                .headers_mut()
                .insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
            response
        }
        Err(e) => (StatusCode::INTERNAL_SERVER_ERROR, format!("{}\n", e.message())).into_response(),
    }
}

fn html(rows: &[SurveyRow], version: u64, crs: &str) -> String {
    let mut body = String::new();
    for r in rows.iter().take(LISTED_MAX) {
        let [x0, y0, x1, y1] = r.bounds;
        let _ = writeln!(
            body,
            "<tr><td>{}<td>{}<td class=n>{:.2}<td class=n>{} x {}<td class=n>{:.0}, {:.0} .. {:.0}, {:.0}<td class=n>{}<td \
             class=n>{}</tr>",
            escaped(&r.name),
            escaped(r.date.as_deref().unwrap_or("")),
            r.accuracy_m,
            r.cols,
            r.rows,
            x0,
            y0,
            x1,
            y1,
            r.live,
            r.version,
        );
    }
    let more = match rows.len().saturating_sub(LISTED_MAX) {
        0 => String::new(),
        n => format!("<p>and {n} more: <code>Catalog/ListSurveys</code></p>"),
    };
    let whole = rows
        .iter()
        .map(|r| r.bounds)
        .reduce(|a, b| [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]);
    let whole = match whole {
        None => "nothing yet".to_string(),
        Some([x0, y0, x1, y1]) => format!("{x0:.0}, {y0:.0} .. {x1:.0}, {y1:.0}"),
    };
    format!(
        "<!doctype html>
<html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\"><title>Terraquilt</title>
<style>body{{font:16px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em}}table{{border-collapse:collapse}}
td,th{{border-bottom:1px solid #ccc;padding:.2em .7em;text-align:left}}.n{{text-align:right}}pre{{background:#f4f4f4;padding:.7em;overflow:auto}}</style>
<h1>Terraquilt {program}</h1>
<p>A living terrain database: overlapping elevation surveys go in, one seamless surface with a certified error comes out. This
server takes surveys as they arrive, answers questions and keeps views live.</p>
<p>Version <b>{version}</b> &middot; {count} surveys &middot; {crs} &middot; box {whole}</p>
<table><tr><th>survey<th>date<th>accuracy m<th>posts<th>box<th>live patches<th>since version</tr>
{body}</table>{more}
<h2>How to ask</h2>
<p>gRPC, gRPC-web and this page share one port. The server describes itself by reflection:</p>
<pre>grpcurl -plaintext HOST:PORT list
grpcurl -plaintext HOST:PORT terraquilt.v1.Catalog/ListSurveys
terraquilt surveys --server HOST:PORT</pre>
<p>With TLS leave <code>-plaintext</code> out; where tokens are needed add <code>-H 'authorization: Bearer tq_...'</code>. Also here:
<a href=/healthz>/healthz</a>, <a href=/metrics>/metrics</a>.</p>
</html>
",
        program = env!("CARGO_PKG_VERSION"),
        count = rows.len(),
        crs = escaped(crs),
    )
}

/// Text that is no markup, whatever it says.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}
