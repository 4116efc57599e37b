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
mod stream;
mod undecodable;
mod view;
mod watch;

use super::State;
use crate::server::tokens::rights;
use crate::wire::v1::export_server::ExportServer;
use crate::wire::v1::heights_server::HeightsServer;
use crate::wire::v1::query_server::QueryServer;
use crate::wire::v1::streams_server::StreamsServer;
use crate::wire::v1::view_server::ViewServer;
use crate::wire::v1::watch_server::WatchServer;
use crate::wire::{self, MESSAGE_BYTES_MAX};
use axum::Router;
use std::collections::BTreeSet;
use std::sync::Arc;
use tonic::service::Routes;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

/// Every service, health and reflection. What all calls pass is laid around them by [`start`](crate::server::start). Needs a
/// runtime: it tells health when the server stops.
pub fn routes(state: &Arc<State>) -> Router {
    let query = QueryServer::new(query::QueryService(state.clone()))
        .max_decoding_message_size(MESSAGE_BYTES_MAX)
        .max_encoding_message_size(MESSAGE_BYTES_MAX);
    let watch = WatchServer::new(watch::WatchService::new(state.clone()))
        .max_decoding_message_size(MESSAGE_BYTES_MAX);
    let view =
        ViewServer::new(view::ViewService::new(state.clone())).max_decoding_message_size(MESSAGE_BYTES_MAX);
    let heights = HeightsServer::new(heights::HeightsService(state.clone()))
        .max_decoding_message_size(MESSAGE_BYTES_MAX)
        .max_encoding_message_size(MESSAGE_BYTES_MAX);
    let (reporter, health) = tonic_health::server::health_reporter();
    tokio::spawn(report(reporter, state.stop.subscribe()));
    let routes = Routes::new(reflection().build_v1().expect("the descriptors were made by the build"))
        .add_service(reflection().build_v1alpha().expect("the descriptors were made by the build"))
        .add_service(health)
        .add_service(catalog::service(state))
        .add_service(ExportServer::new(export::ExportService::new(state.clone())))
        .add_service(heights)
        .add_service(ingest::service(state))
        .add_service(query)
        .add_service(
            StreamsServer::new(stream::StreamsService::new(state.clone()))
                .max_decoding_message_size(MESSAGE_BYTES_MAX),
        )
        .add_service(view)
        .add_service(watch);
    routes.prepare().into_axum_router().layer(axum::middleware::map_response(undecodable::correct))
}

fn reflection() -> tonic_reflection::server::Builder<'static> {
    tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
}

/// Tells that each service serves, until the server is told to stop.
async fn report(reporter: HealthReporter, mut stopped: tokio::sync::watch::Receiver<bool>) {
    let services: BTreeSet<&str> =
        rights::METHODS.iter().filter_map(|m| m.path[1..].split('/').next()).chain([""]).collect();
    for s in &services {
        reporter.set_service_status(*s, ServingStatus::Serving).await;
    }
    let _ = stopped.wait_for(|s| *s).await;
    for s in &services {
        reporter.set_service_status(*s, ServingStatus::NotServing).await;
    }
}
