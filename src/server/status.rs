//! Our errors as gRPC statuses.

use crate::base::Error;
use std::io::ErrorKind;
use tonic::{Code, Status};

/// Bytes of the text of a status.
const TEXT_BYTES_MAX: usize = 4096;

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
        Error::Io { source, .. } => match source.kind() {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded => Code::ResourceExhausted,
            ErrorKind::ReadOnlyFilesystem => Code::FailedPrecondition,
            _ => Code::Internal,
        },
        Error::Catalog(_) => Code::Internal,
        Error::Remote { .. } => Code::Unavailable,
        Error::Stopped => Code::Aborted,
    };
    Status::new(code, short(e.to_string()))
}

/// A text that fits into a header, even where each byte takes three (many clients take no more than 16 KiB of headers): its
/// beginning and its end.
pub fn short(text: String) -> String {
    if text.len() <= TEXT_BYTES_MAX {
        return text;
    }
    let (head, tail) = (TEXT_BYTES_MAX / 2, text.len() - TEXT_BYTES_MAX / 2);
    format!("{} ... {}", &text[..text.floor_char_boundary(head)], &text[text.ceil_char_boundary(tail)..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_fits_into_a_header_whatever_was_named() {
        let told = status(Error::missing(format!("survey '{}'", "\u{e9}".repeat(1 << 20)), "check the name"));
        let told = told.message();
        assert!(
            told.len() < 4110 && told.starts_with("survey '\u{e9}") && told.ends_with("check the name"),
            "{told}"
        );
        assert_eq!(short("as it was".into()), "as it was");
        let full = std::io::Error::from(ErrorKind::StorageFull);
        assert_eq!(status(Error::io("db", full)).code(), Code::ResourceExhausted);
    }
}
