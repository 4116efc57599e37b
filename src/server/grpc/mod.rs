//! The services of `proto/terraquilt/v1`, one file each.

use super::State;
use crate::base::{Error, Result};
use crate::server::tokens::rights;
use crate::wire;
use axum::Router;
use std::collections::BTreeSet;
use std::sync::Arc;
use tokio::sync::watch;
use tonic::service::Routes;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

/// Every service, health and reflection. What all calls pass is laid around them by [`start`](crate::server::start).
pub fn routes(_state: &Arc<State>, stopped: watch::Receiver<bool>) -> Result<Router> {
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let bad = |e: tonic_reflection::server::Error| Error::invalid("reflection", e);
    let (reporter, health) = tonic_health::server::health_reporter();
    tokio::spawn(report(reporter, stopped));
    let routes = Routes::new(reflection().build_v1().map_err(bad)?)
        .add_service(reflection().build_v1alpha().map_err(bad)?)
        .add_service(health);
    Ok(routes.prepare().into_axum_router())
}

/// Tells that each service serves, until the server is told to stop.
async fn report(reporter: HealthReporter, mut stopped: watch::Receiver<bool>) {
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
