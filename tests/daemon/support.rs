//! Databases, servers and clients for these tests.

use std::path::Path;
use terraquilt::client::{Address, Connection};
use terraquilt::db::{Db, Options, Policy};
use terraquilt::height::crs::Crs;
use terraquilt::height::patch::Kind;
use terraquilt::server::{Running, Settings, start};

/// An empty database in EPSG:26910, policy newest.
pub fn empty(folder: &Path) -> Db {
    let crs = Crs::from_epsg(26910).expect("EPSG:26910 is known");
    let options = Options { crs, policy: Policy::Newest, patch: Kind::Bilinear };
    Db::create(&folder.join("db"), &options).expect("the folder is writable")
}

/// A server on a free port of loopback.
pub async fn serve(db: &Db) -> Running {
    let settings = Settings { listen: ([127, 0, 0, 1], 0).into(), ..Settings::new(db.path()) };
    start(settings).await.expect("a free port")
}

/// A client of it.
pub async fn connect(server: &Running) -> Connection {
    let address = Address { server: server.address.to_string(), ..Address::default() };
    Connection::open(&address).await.expect("the server listens")
}
