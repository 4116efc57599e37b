//! Our errors as gRPC statuses.

use crate::base::Error;
use tonic::{Code, Status};

/// The status that says what the caller can do next.
pub fn status(e: Error) -> Status {
    let code = match &e {
        Error::Corrupt { .. } => Code::DataLoss,
        Error::Unsupported { .. } => Code::FailedPrecondition,
        Error::Invalid { .. } => Code::InvalidArgument,
        Error::Limit { .. } => Code::ResourceExhausted,
        Error::Missing { .. } => Code::NotFound,
        Error::Busy { .. } => Code::Unavailable,
        Error::NoSpace { .. } => Code::ResourceExhausted,
        Error::Io { .. } | Error::Catalog(_) => Code::Internal,
        Error::Remote { .. } => Code::Unavailable,
        Error::Stopped => Code::Aborted,
    };
    Status::new(code, e.to_string())
}
