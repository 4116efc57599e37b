//! A server starts, answers and stops.

use super::support::{connect, empty, serve};

#[tokio::test]
async fn a_server_takes_connections_and_stops() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&empty(folder.path())).await;
    let client = connect(&server).await;
    drop(client);
    server.stop().await.unwrap();
}
