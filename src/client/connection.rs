//! A channel to a server.

use crate::base::{Error, Result};
use crate::wire::{MESSAGE_BYTES_MAX, v1};
use std::error::Error as _;
use std::time::Duration;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Request, Status};

/// How long it may take until a server answers at all.
const CONNECT_WITHIN: Duration = Duration::from_secs(10);

/// Where a server is, and who asks.
#[derive(Clone, Debug, Default)]
pub struct Address {
    /// `host:port`, `http://host:port` or `https://host:port`.
    pub server: String,
    /// Token of the caller.
    pub token: Option<String>,
    /// Certificates (PEM) that may sign the server's, instead of those that the system trusts.
    pub ca: Option<Vec<u8>>,
    /// Certificate and key (PEM) of the caller, for mutual TLS.
    pub identity: Option<(Vec<u8>, Vec<u8>)>,
}

/// Adds the token to every call.
#[derive(Clone)]
pub struct Bearer(Option<MetadataValue<Ascii>>);

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> std::result::Result<Request<()>, Status> {
        if let Some(token) = &self.0 {
            request.metadata_mut().insert("authorization", token.clone());
        }
        Ok(request)
    }
}

/// What the generated clients speak through.
pub type Wire = InterceptedService<Channel, Bearer>;

/// A channel to a server. Cheap to clone; calls share it.
#[derive(Clone)]
pub struct Connection {
    pub server: String,
    wire: Wire,
}

macro_rules! clients {
    ($($service:ident: $module:ident :: $client:ident),* $(,)?) => {
        $(pub fn $service(&self) -> v1::$module::$client<Wire> {
            v1::$module::$client::new(self.wire.clone())
                .max_decoding_message_size(MESSAGE_BYTES_MAX)
                .max_encoding_message_size(MESSAGE_BYTES_MAX)
        })*
    };
}

impl Connection {
    /// Connects.
    ///
    /// # Errors
    /// If nobody listens there, or its certificate is not trusted.
    pub async fn open(address: &Address) -> Result<Connection> {
        let url = match address.server.as_str() {
            s if s.starts_with("http://") || s.starts_with("https://") => s.to_string(),
            s if address.ca.is_some() || address.identity.is_some() => format!("https://{s}"),
            s => format!("http://{s}"),
        };
        let bad = |e: &dyn std::fmt::Display| {
            Error::invalid(
                format!("server {}", address.server),
                format!("{e}; give host:port, or https://host:port where the server speaks TLS"),
            )
        };
        if url.starts_with("http://") && (address.ca.is_some() || address.identity.is_some()) {
            // What was meant to be secret must not travel in the clear.
            return Err(bad(&"certificates are given, and http:// speaks no TLS"));
        }
        let web = url == address.server;
        let port = address.server.rsplit_once(':').is_some_and(|(_, p)| p.parse::<u16>().is_ok());
        if !web && (!port || address.server.contains("://")) {
            return Err(bad(&"names no host and port"));
        }
        let mut endpoint = Endpoint::from_shared(url.clone())
            .map_err(|e| bad(&e))?
            .connect_timeout(CONNECT_WITHIN)
            .http2_keep_alive_interval(Duration::from_secs(30))
            .keep_alive_while_idle(true)
            .tcp_nodelay(true);
        if url.starts_with("https://") {
            let mut tls = ClientTlsConfig::new();
            tls = match &address.ca {
                Some(ca) => tls.ca_certificate(Certificate::from_pem(ca)),
                None => tls.with_native_roots(),
            };
            if let Some((certificate, key)) = &address.identity {
                tls = tls.identity(Identity::from_pem(certificate, key));
            }
            endpoint = endpoint.tls_config(tls).map_err(|e| bad(&deepest(&e)))?;
        }
        let token = match &address.token {
            None => None,
            Some(t) => Some(
                MetadataValue::try_from(format!("Bearer {}", t.trim()))
                    .map_err(|_| Error::invalid("token", "holds characters that no token has"))?,
            ),
        };
        let advice = if url.starts_with("https://") {
            "does `terraquilt serve` speak TLS there, with a certificate for that name that is trusted here?"
        } else {
            "is `terraquilt serve` running there, without TLS?"
        };
        let channel = endpoint.connect().await.map_err(|e| Error::Remote {
            server: address.server.clone(),
            message: format!("cannot be reached: {}; {advice}", deepest(&e)),
        })?;
        Ok(Connection {
            server: address.server.clone(),
            wire: InterceptedService::new(channel, Bearer(token)),
        })
    }

    clients! {
        catalog: catalog_client::CatalogClient,
        ingest: ingest_client::IngestClient,
        query: query_client::QueryClient,
        view: view_client::ViewClient,
        watch: watch_client::WatchClient,
        heights: heights_client::HeightsClient,
        export: export_client::ExportClient,
        streams: streams_client::StreamsClient,
    }

    /// A status as an error of this server.
    pub fn failed(&self, status: Status) -> Error {
        failed(&self.server, status)
    }
}

/// A status as an error of the server that sent it.
pub fn failed(server: &str, status: Status) -> Error {
    // What a server says has no cause of its own; what the connection met has.
    let message = match (status.message(), status.source()) {
        ("", _) => format!("{:?}", status.code()),
        (_, Some(cause)) => format!(
            "the connection broke ({}); is the server still running, and does it speak TLS (https://) or ask for a certificate? \
             Ask again",
            deepest(cause)
        ),
        (m, None) => m.to_string(),
    };
    Error::Remote { server: server.to_string(), message }
}

/// What an error of the connection came from in the end: the errors around it say less.
fn deepest<'e>(e: &'e (dyn std::error::Error + 'static)) -> &'e (dyn std::error::Error + 'static) {
    let mut cause = e;
    while let Some(deeper) = cause.source() {
        cause = deeper;
    }
    cause
}
