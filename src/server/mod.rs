//! The daemon: one process that takes surveys as they arrive, answers questions and keeps views live, over gRPC, gRPC-web
//! and HTTP on one port.
//!
//! - [`State`]: the database as it is now ([`Live`]), the threads that work for it ([`Pools`]);
//! - `model`: messages become our types, once, at the edge; `status`: our errors become statuses;
//! - `uploads`: samples as they arrive, until they are committed;
//! - [`view`]: what clients hold, and what is sent to keep it in step;
//! - `grpc`: one file a service of `proto/terraquilt/v1`;
//! - [`tokens`]: who may ask for what; `calls`: what every call passes, whatever it asks;
//! - `listen`: connections; `page`, `metrics`, `log`: what people and machines see of it;
//! - [`configuration`]: flags, variables and a file become [`Settings`];
//! - [`start`]: listens, and stops gracefully.

mod answer;
mod calls;
pub mod command;
pub mod configuration;
mod grpc;
mod listen;
mod live;
mod log;
mod metrics;
mod model;
pub mod operations;
mod page;
mod pools;
mod settings;
mod state;
mod status;
pub mod tokens;
mod uploads;
pub mod view;

pub use grpc::routes;
pub use live::{Arrival, Live};
pub use pools::{Answer, Pools};
pub use settings::{LogForm, Settings, TlsFiles};
pub use state::State;

use crate::base::{Error, Result};
use axum::middleware::from_fn_with_state;
use calls::Calls;
use listen::Listen;
use std::net::SocketAddr;
use std::sync::Arc;
use tokens::Tokens;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tonic_web::GrpcWebLayer;
use tower_http::cors::{AllowHeaders, AllowOrigin, CorsLayer};

/// A server that listens.
pub struct Running {
    pub address: SocketAddr,
    state: Arc<State>,
    stop: watch::Sender<bool>,
    done: JoinHandle<()>,
}

/// Opens the database and listens. Returns when connections are taken.
///
/// # Errors
/// If the database, the certificates or the tokens cannot be opened; if the address is taken, or beyond loopback while no token
/// was made.
pub async fn start(settings: Settings) -> Result<Running> {
    let listen = settings.listen;
    let tokens = Arc::new(Tokens::open(&settings.tokens_file())?);
    refuse_open_door(&settings, &tokens)?;
    let tls = settings.tls.as_ref().map(listen::acceptor).transpose()?;
    let state = tokio::task::spawn_blocking(move || State::open(settings).map(Arc::new))
        .await
        .map_err(|e| Error::invalid("server", e))??;
    let io = |e: std::io::Error| {
        let advice = match e.kind() {
            std::io::ErrorKind::AddrInUse => {
                "; another program listens there: stop it, or give another --listen"
            }
            _ => "",
        };
        Error::invalid(format!("address {listen}"), format!("{e}{advice}"))
    };
    let listener = listen::bind(listen).map_err(io)?;
    let address = listener.local_addr().map_err(io)?;
    let stop = state.stop.clone();
    let stopped = stop.subscribe();
    state.live.follow(stopped.clone());
    state.uploads.sweep_on(stopped.clone());
    tokens.follow(stopped.clone());
    metrics::start(stopped.clone());
    let settings = &state.settings;
    let calls = Arc::new(Calls::new(settings, tokens, stopped.clone()));
    let cors = cors(&settings.allow_origin)?;
    let listen = Listen {
        grpc: grpc::routes(&state)
            .layer(from_fn_with_state(calls.clone(), calls::grpc))
            .layer(GrpcWebLayer::new())
            .layer(cors.clone()),
        pages: page::routes(&state).layer(from_fn_with_state(calls, calls::page)).layer(cors),
        tls,
        settings: settings.clone(),
    };
    let done = tokio::spawn(listen.run(listener, stopped));
    Ok(Running { address, state, stop, done })
}

/// Whoever reaches a port without tokens may do everything: beyond this machine that has to be wanted.
fn refuse_open_door(settings: &Settings, tokens: &Tokens) -> Result<()> {
    let (listen, file) = (settings.listen, settings.tokens_file());
    let beyond = !listen.ip().is_loopback();
    if tokens.guarded() {
        tracing::info!("{} tokens of {} are good", tokens.good(), file.display());
        if beyond && settings.tls.is_none() {
            tracing::warn!(
                "tokens travel in the clear to {listen}: give --tls-cert and --tls-key, unless a proxy speaks TLS"
            );
        }
    } else if beyond && !settings.insecure_open {
        return Err(Error::invalid(
            format!("address {listen}"),
            format!(
                "is beyond loopback, and no token was made ({} is not there): whoever reaches it could change everything; make \
                 one by `terraquilt token add {} --right admin`, or say --insecure-open",
                file.display(),
                settings.db.display()
            ),
        ));
    } else if beyond {
        tracing::warn!("no token was made: whoever reaches {listen} may do everything (--insecure-open)");
    } else {
        tracing::info!("no token was made: everyone on this machine may do everything");
    }
    Ok(())
}

/// Which pages of other origins may ask.
fn cors(origins: &[String]) -> Result<CorsLayer> {
    let header = |name: &'static str| http::HeaderName::from_static(name);
    let asked =
        ["authorization", "content-type", "grpc-timeout", "x-grpc-web", "x-request-id", "x-user-agent"];
    let told = ["grpc-status", "grpc-message", "grpc-status-details-bin", "x-request-id"];
    let allowed = if origins.iter().any(|o| o == "*") {
        AllowOrigin::any()
    } else {
        let parsed =
            origins.iter().map(|o| o.parse().map_err(|e| Error::invalid(format!("allow-origin {o}"), e)));
        AllowOrigin::list(parsed.collect::<Result<Vec<_>>>()?)
    };
    Ok(CorsLayer::new()
        .allow_origin(allowed)
        .allow_methods([http::Method::GET, http::Method::POST])
        .allow_headers(AllowHeaders::list(asked.map(header)))
        .expose_headers(told.map(header))
        .max_age(std::time::Duration::from_secs(600)))
}

impl Running {
    pub fn state(&self) -> &Arc<State> {
        &self.state
    }

    /// Takes no more connections and calls, ends streams that have no end, lets other calls go on for the time of grace, and
    /// returns.
    pub async fn stop(self) -> Result<()> {
        self.stop.send_replace(true);
        self.done.await.map_err(|e| Error::invalid("server", e))
    }
}
