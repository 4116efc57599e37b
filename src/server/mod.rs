//! The daemon: one process that takes surveys as they arrive, answers questions and keeps views live, over gRPC, gRPC-web
//! and HTTP on one port.
//!
//! - [`State`]: the database as it is now ([`Live`]), the threads that work for it ([`Pools`]);
//! - `model`: messages become our types, once, at the edge; `status`: our errors become statuses;
//! - `uploads`: samples as they arrive, until they are committed;
//! - [`view`]: what clients hold, and what is sent to keep it in step;
//! - `grpc`: one file a service of `proto/terraquilt/v1`;
//! - [`start`]: listens, and stops gracefully.

mod answer;
pub mod command;
mod grpc;
mod live;
mod model;
pub mod operations;
mod pools;
mod settings;
mod state;
mod status;
mod uploads;
pub mod view;

pub use live::{Arrival, Live};
pub use pools::{Answer, Pools};
pub use settings::Settings;
pub use state::State;

use crate::base::{Error, Result};
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// A server that listens.
pub struct Running {
    pub address: SocketAddr,
    state: Arc<State>,
    stop: watch::Sender<bool>,
    done: JoinHandle<std::io::Result<()>>,
}

/// Opens the database and listens. Returns when connections are taken.
///
/// # Errors
/// If the database cannot be opened, or the address is taken.
pub async fn start(settings: Settings) -> Result<Running> {
    let listen = settings.listen;
    let state = tokio::task::spawn_blocking(move || State::open(settings).map(Arc::new))
        .await
        .map_err(|e| Error::invalid("server", e))??;
    let io = |e| Error::invalid(format!("address {listen}"), e);
    let listener = TcpListener::bind(listen).await.map_err(io)?;
    let address = listener.local_addr().map_err(io)?;
    let stop = state.stop.clone();
    let stopped = stop.subscribe();
    state.live.follow(stopped.clone());
    state.uploads.sweep_on(stopped.clone());
    let app = grpc::routes(&state);
    let until = |mut stopped: watch::Receiver<bool>| async move {
        let _ = stopped.wait_for(|s| *s).await;
    };
    let serve = axum::serve(listener, app).with_graceful_shutdown(until(stopped));
    let done = tokio::spawn(async move { serve.await });
    Ok(Running { address, state, stop, done })
}

impl Running {
    pub fn state(&self) -> &Arc<State> {
        &self.state
    }

    /// Takes no more connections, lets calls that are under way end, and returns.
    pub async fn stop(self) -> Result<()> {
        self.stop.send_replace(true);
        self.done
            .await
            .map_err(|e| Error::invalid("server", e))?
            .map_err(|e| Error::invalid(format!("address {}", self.address), e))
    }
}
