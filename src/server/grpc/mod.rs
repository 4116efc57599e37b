//! The services of `proto/terraquilt/v1`, one file each.

mod arrival;
mod catalog;
mod export;
mod files;
mod heights;
mod ingest;
mod outgoing;
mod query;
mod report;
mod watch;

use super::State;
use crate::wire::v1::export_server::ExportServer;
use crate::wire::v1::heights_server::HeightsServer;
use crate::wire::v1::query_server::QueryServer;
use crate::wire::v1::watch_server::WatchServer;
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
    let routes = Routes::new(v1)
        .add_service(catalog::service(state))
        .add_service(ExportServer::new(export::ExportService::new(state.clone())))
        .add_service(heights)
        .add_service(ingest::service(state))
        .add_service(QueryServer::new(query::QueryService::new(state.clone())))
        .add_service(WatchServer::new(watch::WatchService::new(state.clone())));
    routes.into_axum_router()
}
