//! The services of `proto/terraquilt/v1`, one file each.

mod arrival;
mod catalog;
mod files;
mod heights;
mod ingest;
mod outgoing;
mod query;
mod report;
mod view;

use super::State;
use crate::wire::v1::heights_server::HeightsServer;
use crate::wire::v1::query_server::QueryServer;
use crate::wire::v1::view_server::ViewServer;
use crate::wire::{self, MESSAGE_BYTES_MAX};
use axum::Router;
use std::sync::Arc;
use tonic::service::Routes;

/// Every service, and reflection.
pub fn routes(state: &Arc<State>) -> Router {
    let v1 = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
        .build_v1()
        .expect("the descriptors were made by the build");
    let heights = HeightsServer::new(heights::HeightsService(state.clone()))
        .max_decoding_message_size(MESSAGE_BYTES_MAX)
        .max_encoding_message_size(MESSAGE_BYTES_MAX);
    let view = ViewServer::new(view::ViewService::new(state.clone()));
    let routes = Routes::new(v1)
        .add_service(catalog::service(state))
        .add_service(heights)
        .add_service(ingest::service(state))
        .add_service(QueryServer::new(query::QueryService::new(state.clone())))
        .add_service(view.max_decoding_message_size(MESSAGE_BYTES_MAX));
    routes.into_axum_router()
}
