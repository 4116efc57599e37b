//! Calls of the ingest service, message by message.

use super::survey::Survey;
use terraquilt::client::Connection;
use terraquilt::client::ingest::{Sending, upload};
use terraquilt::db::Db;
use terraquilt::server::{Running, Settings, start};
use terraquilt::wire::v1::upload_request::Kind;
use terraquilt::wire::v1::{self, operation_status::State};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Status, Streaming};

/// A server with other settings than the defaults.
pub async fn serve_with(db: &Db, set: impl FnOnce(&mut Settings)) -> Running {
    let mut settings = Settings { listen: ([127, 0, 0, 1], 0).into(), ..Settings::new(db.path()) };
    set(&mut settings);
    start(settings).await.expect("a free port")
}

/// A stream of an upload, message by message.
pub struct Call {
    pub send: mpsc::Sender<v1::UploadRequest>,
    pub replies: Streaming<v1::UploadReply>,
}

impl Call {
    pub async fn open(c: &Connection) -> Call {
        let (send, requests) = mpsc::channel(64);
        let replies = c.ingest().upload(ReceiverStream::new(requests)).await.unwrap().into_inner();
        Call { send, replies }
    }

    /// Sends a header and returns what is there.
    pub async fn begin(c: &Connection, header: &v1::UploadHeader) -> Result<(Call, v1::UploadReply), Status> {
        let mut call = Call::open(c).await;
        call.header(header).await;
        let first = call.replies.message().await?.expect("a reply");
        Ok((call, first))
    }

    pub async fn kind(&self, kind: Kind) {
        // A server that refused takes nothing more.
        let _ = self.send.send(v1::UploadRequest { kind: Some(kind) }).await;
    }
    pub async fn header(&self, h: &v1::UploadHeader) {
        self.kind(Kind::Header(h.clone())).await;
    }
    pub async fn block(&self, b: v1::SampleBlock) {
        self.kind(Kind::Block(b)).await;
    }
    pub async fn finish(&self) {
        self.kind(Kind::Finish(v1::UploadFinish::default())).await;
    }

    /// Reads replies until so many rows were said to be durable.
    pub async fn durable(&mut self, rows: u64) {
        let mut seen = 0;
        while seen < rows {
            let reply = self.replies.message().await.unwrap().expect("a reply");
            seen += reply.received.iter().map(|s| s.rows).sum::<u64>();
        }
    }

    /// Reads replies until the commit.
    pub async fn commit(&mut self) -> Result<v1::CommitReply, Status> {
        loop {
            let reply = self.replies.message().await?.expect("a reply");
            if let Some(commit) = reply.commit {
                assert_eq!(reply.state, State::Done as i32);
                return Ok(commit);
            }
        }
    }

    /// What the server refuses.
    pub async fn refused(&mut self) -> Status {
        self.commit().await.expect_err("a refusal")
    }
}

pub async fn send(c: &Connection, s: &Survey) -> terraquilt::base::Result<v1::CommitReply> {
    upload(c, s.header.clone(), s.rows(), &Sending::default(), &mut |_| {}).await
}

/// Folders of uploads that are left.
pub fn folders(db: &Db) -> usize {
    let Ok(entries) = std::fs::read_dir(db.path().join("uploads")) else { return 0 };
    entries.filter(|e| e.as_ref().unwrap().path().is_dir()).count()
}

pub async fn listed(c: &Connection) -> Vec<v1::UploadInfo> {
    c.ingest().list_uploads(v1::ListUploadsRequest {}).await.unwrap().into_inner().uploads
}

pub fn spans(reply: &v1::UploadReply) -> Vec<[u64; 3]> {
    reply.received.iter().map(|s| [u64::from(s.grid), s.row, s.rows]).collect()
}
