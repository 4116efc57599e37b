//! Bytes that are no message are the caller's mistake. The library below calls them a fault of the server (`INTERNAL`); here they
//! become `INVALID_ARGUMENT`, in headers and trailers alike.

use axum::body::{Body, HttpBody};
use axum::response::Response;
use bytes::Bytes;
use http::HeaderMap;
use http_body::{Frame, SizeHint};
use std::pin::Pin;
use std::task::{Context, Poll};
use tonic::{Code, Status};

/// How the texts of the library begin.
const UNDECODABLE: &str = "failed to decode Protobuf message";

/// Corrects the status of an answer.
pub async fn correct(mut response: Response) -> Response {
    correct_status(response.headers_mut());
    response.map(|inner| Body::new(Corrected { inner }))
}

fn correct_status(headers: &mut HeaderMap) {
    // Almost all answers are not looked into any further.
    if headers.get(Status::GRPC_STATUS).is_none_or(|c| c != "13") {
        return;
    }
    let Some(found) = Status::from_header_map(headers) else { return };
    if found.code() == Code::Internal && found.message().starts_with(UNDECODABLE) {
        let said =
            Status::invalid_argument(format!("{}; send a message of this method's type", found.message()));
        // The text came out of a header: it fits into one.
        let _ = said.add_header(headers);
    }
}

struct Corrected {
    inner: Body,
}

impl HttpBody for Corrected {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.inner).poll_frame(cx).map_ok(|mut frame| {
            if let Some(trailers) = frame.trailers_mut() {
                correct_status(trailers);
            }
            frame
        })
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}
