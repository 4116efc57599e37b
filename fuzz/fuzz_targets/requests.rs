//! Requests to any method of the daemon, through the whole service in this process. The first byte chooses the method, the second whether
//! the rest is taken as it is, or as the choices of which a valid message is made; further messages follow after a length.
#![no_main]

#[path = "../../tests/daemon/requests/caller.rs"]
mod caller;
#[path = "../../tests/daemon/requests/messages.rs"]
mod messages;

use caller::Caller;
use libfuzzer_sys::fuzz_target;
use messages::{Facts, message, methods};
use std::sync::OnceLock;

fuzz_target!(|data: &[u8]| {
    static WORLD: OnceLock<(Caller, Vec<String>)> = OnceLock::new();
    let (caller, methods) = WORLD.get_or_init(|| (Caller::new(), methods()));
    let [chosen, kind, rest @ ..] = data else { return };
    let method = &methods[usize::from(*chosen) % methods.len()];
    let facts = Facts { names: &caller.names, bounds: caller.bounds };
    let mut sent = Vec::new();
    for part in rest.chunks(1024).take(4) {
        sent.push(if kind % 4 == 0 {
            part.to_vec()
        } else {
            message(method, &facts, &mut arbitrary::Unstructured::new(part)).unwrap_or_default()
        });
    }
    let end = caller.call(method, &sent);
    assert_ne!(end.code, Some(tonic::Code::Internal), "{method}: {}", end.message);
});
