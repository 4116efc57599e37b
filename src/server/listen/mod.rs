//! Connections: taken, bounded, given TLS, watched over and ended.
//!
//! One port speaks HTTP/1.1 and HTTP/2, which is told by the first bytes. Whatever a peer does, its connection costs a bounded
//! amount of memory for a bounded time: the handshake, the first bytes and each request's head have to come in time (`tls`,
//! [`Guard`]), and a connection beyond `connections_max` is closed as it comes.

mod files;
mod guard;
mod tls;

pub use guard::{CallMark, Guard};
pub use tls::acceptor;

use super::metrics;
use super::settings::Settings;
use axum::body::{Body, HttpBody};
use axum::response::Response;
use bytes::Bytes;
use guard::Watched;
use http::{Request, header};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use hyper_util::service::TowerToHyperService;
use std::convert::Infallible;
use std::future::Future;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio_rustls::TlsAcceptor;
use tower::Service;

/// Bytes of the names and values that one request's head may have.
const HEAD_BYTES_MAX: u32 = 32 << 10;
/// After a failed accept: the next waits this long, or a lack of file handles becomes a busy loop.
const ACCEPT_AGAIN: Duration = Duration::from_millis(50);
/// Connections that the system holds until they are taken. With fewer, a burst makes callers wait a second for their next try.
const WAITING_MAX: u32 = 8192;
/// After the time of grace: statuses of calls that were ended go out.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// Which server a connection's requests go to, and by which rules.
pub struct Listen {
    pub grpc: axum::Router,
    pub pages: axum::Router,
    pub tls: Option<TlsAcceptor>,
    pub settings: Settings,
}

/// Where a call comes from: an extension of each request.
#[derive(Clone)]
pub struct Peer {
    pub address: SocketAddr,
    pub guard: Arc<Guard>,
}

/// Listens on an address.
pub fn bind(address: SocketAddr) -> std::io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    // A server that is started again need not wait for the last connections of the one before.
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(WAITING_MAX)
}

impl Listen {
    /// Takes connections until told to stop, lets calls end within the time of grace, and returns.
    pub async fn run(self, listener: TcpListener, mut stopped: watch::Receiver<bool>) {
        let bound = files::connections(self.settings.connections_max);
        let room = Arc::new(Semaphore::new(bound));
        let grace = self.settings.grace;
        let shared = Arc::new(self);
        // Dropped at the end of grace: connections that are still open end with it.
        let (last_call, over) = watch::channel(false);
        loop {
            let taken = tokio::select! {
                taken = listener.accept() => taken,
                _ = stopped.wait_for(|s| *s) => break,
            };
            let (stream, address) = match taken {
                Ok(t) => t,
                Err(e) => {
                    metrics::refused_connection("accept");
                    tracing::warn!("a connection could not be taken: {e}");
                    tokio::time::sleep(ACCEPT_AGAIN).await;
                    continue;
                }
            };
            let Ok(permit) = room.clone().try_acquire_owned() else {
                metrics::refused_connection("connections_max");
                tracing::debug!("connection of {address} closed: {bound} are open, and no more are allowed");
                continue;
            };
            let (listen, stopped, mut over) = (shared.clone(), stopped.clone(), over.clone());
            tokio::spawn(async move {
                let _permit = permit;
                let _open = metrics::open_connection();
                tokio::select! {
                    () = listen.connection(stream, address, stopped) => {}
                    _ = over.wait_for(|o| *o) => {}
                }
            });
        }
        drop(listener);
        let all = u32::try_from(bound).unwrap_or(u32::MAX);
        if tokio::time::timeout(grace + LAST_WORDS, room.acquire_many(all)).await.is_err() {
            let left = bound - room.available_permits();
            tracing::warn!(
                "{left} connections had not ended {:?} after the signal: closed",
                grace + LAST_WORDS
            );
            let _ = last_call.send(true);
            let _ = tokio::time::timeout(LAST_WORDS, room.acquire_many(all)).await;
        }
    }

    async fn connection(&self, stream: TcpStream, address: SocketAddr, stopped: watch::Receiver<bool>) {
        // Small messages must not wait for large ones; a peer that vanished is found out below HTTP/1.1, which has no pings.
        let _ = stream.set_nodelay(true);
        let _ = rustix::net::sockopt::set_socket_keepalive(&stream, true);
        let _ = rustix::net::sockopt::set_tcp_keepidle(
            &stream,
            self.settings.keepalive.max(Duration::from_secs(1)),
        );
        let Some(tls) = &self.tls else { return self.serve(stream, address, stopped).await };
        match tokio::time::timeout(self.settings.greet_within, tls.accept(stream)).await {
            Ok(Ok(stream)) => self.serve(stream, address, stopped).await,
            Ok(Err(e)) => {
                metrics::refused_connection("tls");
                tracing::info!("connection of {address} refused: TLS: {e}");
            }
            Err(_) => {
                metrics::refused_connection("greeting");
                tracing::debug!(
                    "connection of {address} closed: no TLS handshake within {:?}",
                    self.settings.greet_within
                );
            }
        }
    }

    async fn serve<S>(&self, stream: S, address: SocketAddr, mut stopped: watch::Receiver<bool>)
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        let s = &self.settings;
        let guard = Arc::new(Guard::new(s.greet_within, s.idle, s.stall));
        let service = Split {
            grpc: self.grpc.clone(),
            pages: self.pages.clone(),
            peer: Peer { address, guard: guard.clone() },
        };
        let mut builder = auto::Builder::new(TokioExecutor::new());
        builder.http1().timer(TokioTimer::new()).header_read_timeout(s.greet_within).max_buf_size(64 << 10);
        builder
            .http2()
            .timer(TokioTimer::new())
            .max_concurrent_streams(s.connection_calls_max)
            .max_header_list_size(HEAD_BYTES_MAX)
            .keep_alive_interval(s.keepalive)
            .keep_alive_timeout(s.greet_within);
        let io = TokioIo::new(Watched::new(stream, guard.clone()));
        let mut connection = std::pin::pin!(builder.serve_connection(io, TowerToHyperService::new(service)));
        let mut told = false;
        let ended = loop {
            tokio::select! {
                ended = connection.as_mut() => break ended.map_err(|e| e.to_string()),
                why = guard.expired() => break Err(why),
                _ = stopped.wait_for(|s| *s), if !told => {
                    told = true;
                    connection.as_mut().graceful_shutdown();
                }
            }
        };
        if let Err(why) = ended {
            tracing::debug!("connection of {address} ended: {why}");
        }
    }
}

/// gRPC goes one way, everything else to the pages.
#[derive(Clone)]
struct Split {
    grpc: axum::Router,
    pages: axum::Router,
    peer: Peer,
}

impl<B> Service<Request<B>> for Split
where
    B: HttpBody<Data = Bytes> + Send + 'static,
    B::Error: Into<axum::BoxError>,
{
    type Response = Response;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<Response, Infallible>> + Send>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, mut request: Request<B>) -> Self::Future {
        let kind = request.headers().get(header::CONTENT_TYPE).map(http::HeaderValue::as_bytes);
        let grpc = kind.is_some_and(|k| k.starts_with(b"application/grpc"));
        request.extensions_mut().insert(self.peer.clone());
        let mut router = if grpc { self.grpc.clone() } else { self.pages.clone() };
        let answer = router.call(request.map(Body::new));
        Box::pin(answer)
    }
}
