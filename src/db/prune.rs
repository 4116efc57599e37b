//! Forgetting versions, and giving back the bytes that only they read.

use super::database::Db;
use crate::base::Result;
use crate::store::lock::leased;

/// What prune did.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct PruneOutcome {
    pub pruned: Vec<u64>,
    pub kept_for_readers: Vec<u64>,
    pub bytes_freed: u64,
}

impl Db {
    /// Forgets versions and gives their bytes back. Keeps the latest, and every version that a reader holds.
    pub fn prune(
        &self,
        choose: impl Fn(&[u64]) -> Vec<u64>,
        waiting: &mut dyn FnMut(),
    ) -> Result<PruneOutcome> {
        let mut writing = self.begin(waiting)?;
        let all: Vec<u64> = writing.catalog.versions()?.iter().map(|v| v.number).collect();
        let held = leased(self.path())?;
        let latest = all.last().copied();
        let mut gone = choose(&all);
        gone.retain(|v| all.contains(v) && Some(*v) != latest);
        let kept_for_readers: Vec<u64> = gone.iter().copied().filter(|v| held.contains(v)).collect();
        gone.retain(|v| !held.contains(v));
        if !gone.is_empty() {
            writing.catalog.prune(&gone)?;
        }
        let freed = writing.swept + writing.sweep(self)?;
        Ok(PruneOutcome { pruned: gone, kept_for_readers, bytes_freed: freed })
    }
}
