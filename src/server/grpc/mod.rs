//! The services of `proto/terraquilt/v1`, one file each.

mod query;

use super::State;
use crate::wire;
use crate::wire::v1::query_server::QueryServer;
use axum::Router;
use std::sync::Arc;
use tonic::service::Routes;

/// Every service, and reflection.
pub fn routes(state: &Arc<State>) -> Router {
    let v1 = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
        .build_v1()
        .expect("the descriptors were made by the build");
    let routes = Routes::new(v1).add_service(QueryServer::new(query::QueryService::new(state.clone())));
    routes.into_axum_router()
}
