//! The right that each method needs, and how long a call of it lasts. A method that is not in the table is refused.

use super::Right;

/// What a caller must show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Needs {
    /// Nothing: open to all who reach the port.
    Nothing,
    Right(Right),
}

/// How long a call lasts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lasts {
    /// One message in, one out: the default deadline holds.
    Short,
    /// One message in, many out, to an end that the server knows.
    Stream,
    /// As long as the client sends. Counted among the long ones.
    Fed,
    /// Until one side has enough. Counted among the long ones, and ended as soon as the server is told to stop.
    Endless,
}

/// A method of a service.
#[derive(Debug)]
pub struct Method {
    /// `/package.Service/Method`.
    pub path: &'static str,
    pub needs: Needs,
    pub lasts: Lasts,
}

const OPEN: Needs = Needs::Nothing;
const READ: Needs = Needs::Right(Right::Read);
const WRITE: Needs = Needs::Right(Right::Write);
const ADMIN: Needs = Needs::Right(Right::Admin);

const fn method(path: &'static str, needs: Needs, lasts: Lasts) -> Method {
    Method { path, needs, lasts }
}

/// Every method that is served.
pub const METHODS: &[Method] = &[
    method("/terraquilt.v1.Catalog/Info", READ, Lasts::Short),
    method("/terraquilt.v1.Catalog/ListSurveys", READ, Lasts::Short),
    method("/terraquilt.v1.Catalog/GetSurvey", READ, Lasts::Short),
    method("/terraquilt.v1.Catalog/ListTiles", READ, Lasts::Short),
    method("/terraquilt.v1.Catalog/ListVersions", READ, Lasts::Short),
    method("/terraquilt.v1.Catalog/GetOperation", READ, Lasts::Short),
    method("/terraquilt.v1.Catalog/Fingerprint", READ, Lasts::Short),
    method("/terraquilt.v1.Catalog/Boxes", READ, Lasts::Stream),
    method("/terraquilt.v1.Catalog/Report", READ, Lasts::Stream),
    method("/terraquilt.v1.Catalog/Remove", WRITE, Lasts::Short),
    method("/terraquilt.v1.Catalog/Set", WRITE, Lasts::Short),
    method("/terraquilt.v1.Catalog/Prune", ADMIN, Lasts::Short),
    method("/terraquilt.v1.Catalog/Verify", ADMIN, Lasts::Stream),
    method("/terraquilt.v1.Export/File", READ, Lasts::Stream),
    method("/terraquilt.v1.Heights/Points", READ, Lasts::Fed),
    method("/terraquilt.v1.Heights/Ask", READ, Lasts::Stream),
    method("/terraquilt.v1.Heights/Profile", READ, Lasts::Stream),
    method("/terraquilt.v1.Heights/Raster", READ, Lasts::Stream),
    method("/terraquilt.v1.Ingest/Upload", WRITE, Lasts::Fed),
    method("/terraquilt.v1.Ingest/ListUploads", WRITE, Lasts::Short),
    method("/terraquilt.v1.Ingest/Abandon", WRITE, Lasts::Short),
    method("/terraquilt.v1.Ingest/Files", WRITE, Lasts::Stream),
    method("/terraquilt.v1.Query/Patches", READ, Lasts::Stream),
    method("/terraquilt.v1.Query/Difference", READ, Lasts::Stream),
    method("/terraquilt.v1.Streams/Surface", READ, Lasts::Stream),
    method("/terraquilt.v1.View/Hold", READ, Lasts::Endless),
    method("/terraquilt.v1.View/Follow", READ, Lasts::Endless),
    method("/terraquilt.v1.View/Steer", READ, Lasts::Short),
    method("/terraquilt.v1.Watch/Commits", READ, Lasts::Endless),
    method("/grpc.health.v1.Health/Check", OPEN, Lasts::Short),
    method("/grpc.health.v1.Health/List", OPEN, Lasts::Short),
    method("/grpc.health.v1.Health/Watch", READ, Lasts::Endless),
    method("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo", READ, Lasts::Fed),
    method("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo", READ, Lasts::Fed),
];

/// The method of a path.
pub fn find(path: &str) -> Option<&'static Method> {
    METHODS.iter().find(|m| m.path == path)
}

/// What a page of the HTTP side needs: all but `/healthz` tell of what is in the database.
pub fn of_page(path: &str) -> Needs {
    if path == "/healthz" { OPEN } else { READ }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire;
    use prost::Message;
    use std::collections::BTreeMap;

    /// Path -> (streams in, streams out), as `proto/` says.
    fn of_the_manual() -> BTreeMap<String, (bool, bool)> {
        let set = prost_types::FileDescriptorSet::decode(wire::DESCRIPTORS).unwrap();
        let mut out = BTreeMap::new();
        for file in set.file {
            for service in &file.service {
                for m in &service.method {
                    let path = format!("/{}.{}/{}", file.package(), service.name(), m.name());
                    out.insert(path, (m.client_streaming(), m.server_streaming()));
                }
            }
        }
        out
    }

    #[test]
    fn every_method_of_the_manual_has_a_right() {
        let manual = of_the_manual();
        assert!(manual.len() >= 28, "{manual:?}");
        for (path, streams) in &manual {
            let m = find(path).unwrap_or_else(|| panic!("{path} has no right in METHODS"));
            let fits = match m.lasts {
                Lasts::Short => *streams == (false, false),
                Lasts::Stream => *streams == (false, true),
                Lasts::Fed => *streams == (true, true),
                Lasts::Endless => streams.1,
            };
            assert!(fits, "{path}: {:?}, the manual says {streams:?} (in, out)", m.lasts);
        }
        let ours = METHODS.iter().filter(|m| m.path.starts_with("/terraquilt."));
        let unknown: Vec<_> = ours.filter(|m| !manual.contains_key(m.path)).collect();
        assert!(unknown.is_empty(), "no such methods: {unknown:?}");
    }
}
