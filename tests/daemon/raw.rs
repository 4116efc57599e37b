//! Calls by path with raw bytes, and requests of HTTP/1.1 written by hand: for what generated clients cannot say.

use bytes::{Buf, BufMut, Bytes};
use futures_util::StreamExt;
use std::net::SocketAddr;
use std::time::Duration;
use terraquilt::wire::DESCRIPTORS;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tonic::codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::transport::{Channel, Endpoint};
use tonic::{Request, Status, Streaming};

/// Messages as they are.
#[derive(Clone, Copy, Default)]
pub struct Raw;

impl Codec for Raw {
    type Encode = Bytes;
    type Decode = Bytes;
    type Encoder = Raw;
    type Decoder = Raw;
    fn encoder(&mut self) -> Raw {
        Raw
    }
    fn decoder(&mut self) -> Raw {
        Raw
    }
}

impl Encoder for Raw {
    type Item = Bytes;
    type Error = Status;
    fn encode(&mut self, item: Bytes, dst: &mut EncodeBuf<'_>) -> Result<(), Status> {
        dst.put(item);
        Ok(())
    }
}

impl Decoder for Raw {
    type Item = Bytes;
    type Error = Status;
    fn decode(&mut self, src: &mut DecodeBuf<'_>) -> Result<Option<Bytes>, Status> {
        Ok(Some(src.copy_to_bytes(src.remaining())))
    }
}

/// Every method that `proto/` describes, as `/package.Service/Method`.
pub fn methods() -> Vec<String> {
    use prost::Message;
    let set = prost_types::FileDescriptorSet::decode(DESCRIPTORS).unwrap();
    let mut out = Vec::new();
    for file in &set.file {
        for service in &file.service {
            let of = |m: &prost_types::MethodDescriptorProto| {
                format!("/{}.{}/{}", file.package(), service.name(), m.name())
            };
            out.extend(service.method.iter().map(of));
        }
    }
    out
}

pub async fn channel(address: SocketAddr) -> Channel {
    Endpoint::from_shared(format!("http://{address}")).unwrap().connect().await.unwrap()
}

/// Opens a call with these messages, and leaves its answers to be read.
pub async fn open<S>(
    channel: &Channel,
    path: &str,
    token: Option<&str>,
    messages: S,
) -> Result<Streaming<Bytes>, Status>
where
    S: futures_util::Stream<Item = Bytes> + Send + 'static,
{
    let mut client = tonic::client::Grpc::new(channel.clone());
    client.ready().await.map_err(|e| Status::unknown(e.to_string()))?;
    let mut request = Request::new(messages);
    if let Some(t) = token {
        request.metadata_mut().insert("authorization", format!("Bearer {t}").parse().unwrap());
    }
    let path = http::uri::PathAndQuery::try_from(path).unwrap();
    Ok(client.streaming(request, path, Raw).await?.into_inner())
}

/// How a call with one message ends; `None`: it goes on after a while.
pub async fn ends(
    channel: &Channel,
    path: &str,
    token: Option<&str>,
    message: Bytes,
) -> Option<Result<(), Status>> {
    let one = futures_util::stream::iter([message]);
    let whole = async {
        let mut answers = open(channel, path, token, one).await?;
        while let Some(answer) = answers.next().await {
            answer?;
        }
        Ok(())
    };
    tokio::time::timeout(Duration::from_millis(500), whole).await.ok()
}

/// Sends bytes, and reads until the server closes.
pub async fn exchange(address: SocketAddr, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(bytes).await.unwrap();
    let mut out = Vec::new();
    let read = tokio::time::timeout(Duration::from_secs(20), stream.read_to_end(&mut out)).await;
    let _ = read.expect("the server closes");
    String::from_utf8_lossy(&out).into_owned()
}

/// A page, with its head.
pub async fn get(address: SocketAddr, path: &str, headers: &str) -> String {
    let request = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n{headers}\r\n");
    exchange(address, request.as_bytes()).await
}
