//! Streams of answers: computed as the client reads, and ended with the client.

use crate::server::Answer;
use std::future::Future;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Response, Status};

/// A client that reads nothing for so long is let go, and what was held for it.
const READ_WITHIN: Duration = Duration::from_secs(600);

/// The stream of a call, as tonic sends it.
pub type Stream<T> = ReceiverStream<Answer<T>>;

/// Where the messages of a call go. One waits for the client, no more.
pub struct Outgoing<T>(mpsc::Sender<Answer<T>>);

impl<T: Send + 'static> Outgoing<T> {
    /// Waits until the next message would be taken: before it is computed.
    pub async fn room(&self) -> Answer<()> {
        within(self.0.reserve()).await.map(drop)
    }

    pub async fn send(&self, message: T) -> Answer<()> {
        within(self.0.send(Ok(message))).await
    }
}

async fn within<R, E>(wait: impl Future<Output = Result<R, E>>) -> Answer<R> {
    match tokio::time::timeout(READ_WITHIN, wait).await {
        Ok(Ok(r)) => Ok(r),
        Ok(Err(_)) => Err(Status::cancelled("the client has gone")),
        Err(_) => {
            let s = READ_WITHIN.as_secs();
            Err(Status::deadline_exceeded(format!(
                "nothing was read for {s} s; ask again, and read what comes"
            )))
        }
    }
}

/// Answers a call with what `work` sends. When the client goes, `work` is dropped where it waits.
pub fn stream<T: Send + 'static, F>(work: impl FnOnce(Outgoing<T>) -> F) -> Response<Stream<T>>
where
    F: Future<Output = Answer<()>> + Send + 'static,
{
    let (sender, receiver) = mpsc::channel(1);
    let work = work(Outgoing(sender.clone()));
    tokio::spawn(async move {
        tokio::select! {
            done = work => {
                if let Err(status) = done {
                    let _ = tokio::time::timeout(READ_WITHIN, sender.send(Err(status))).await;
                }
            }
            () = sender.closed() => {}
        }
    });
    Response::new(ReceiverStream::new(receiver))
}
