//! What all calls share.

use super::operations::Operations;
use super::uploads::Uploads;
use super::view::Sessions;
use super::{Live, Pools, Settings};
use crate::base::Result;
use crate::db::Db;
use std::sync::Arc;
use tokio::sync::watch;

/// What all calls share.
pub struct State {
    pub settings: Settings,
    pub live: Arc<Live>,
    pub pools: Pools,
    pub operations: Operations,
    pub views: Sessions,
    /// True when the server stops: streams that would go on for ever end then.
    pub stop: watch::Sender<bool>,
    pub uploads: Arc<Uploads>,
}

impl State {
    pub fn open(settings: Settings) -> Result<State> {
        let live = Arc::new(Live::open(Db::open(&settings.db)?)?);
        let uploads = Arc::new(Uploads::new(live.db().clone(), &settings));
        Ok(State {
            live,
            pools: Pools::new()?,
            operations: Operations::default(),
            views: Sessions::new(settings.sessions_kept, settings.sessions_max),
            stop: watch::Sender::new(false),
            uploads,
            settings,
        })
    }
}
