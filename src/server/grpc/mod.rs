//! The services of `proto/terraquilt/v1`, one file each.

mod view;

use super::State;
use crate::wire;
use crate::wire::{MESSAGE_BYTES_MAX, v1};
use axum::Router;
use std::sync::Arc;
use tonic::service::Routes;

/// Every service, and reflection.
pub fn routes(state: &Arc<State>) -> Router {
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
        .build_v1()
        .expect("the descriptors were made by the build");
    let mut routes = Routes::new(reflection);
    routes = routes.add_service(
        v1::view_server::ViewServer::new(view::ViewService::new(state.clone()))
            .max_decoding_message_size(MESSAGE_BYTES_MAX),
    );
    routes.into_axum_router()
}
