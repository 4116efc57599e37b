//! The catalog stays open between the commits of a process: opening it anew costs a commit more than its row.

use crate::base::Result;
use crate::store::catalog::{Catalog, Commit};
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, PoisonError};

/// Where the catalog waits for the next commit. When the last connection to it is closed, its log is emptied.
#[derive(Clone, Default)]
pub(super) struct WriterHome(Arc<Mutex<Option<Box<dyn Catalog>>>>);

impl WriterHome {
    /// The catalog that waits here, if it is still the one of the database, or one that `open` opens. Only under the writer lock.
    ///
    /// # Errors
    /// If it has become the catalog of a newer program.
    pub fn take(&self, open: &dyn Fn() -> Result<Box<dyn Catalog>>) -> Result<Writer> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        let catalog = match kept {
            // Since it was put here the file may have been made again (`rebuild`), or restored by hand.
            Some(catalog) if catalog.is_current()? => catalog,
            _ => open()?,
        };
        Ok(Writer { catalog: Some(catalog), failed: false, home: self.clone() })
    }
}

/// The catalog in the hands of a writer; it goes back afterwards, unless writing to it failed.
pub(super) struct Writer {
    catalog: Option<Box<dyn Catalog>>,
    failed: bool,
    home: WriterHome,
}

impl Writer {
    /// See [`Catalog::commit`].
    pub fn commit(&mut self, commit: &Commit) -> Result<()> {
        self.failed = true;
        (**self).commit(commit)?;
        self.failed = false;
        Ok(())
    }

    /// See [`Catalog::prune`].
    pub fn prune(&mut self, versions: &[u64]) -> Result<()> {
        self.failed = true;
        (**self).prune(versions)?;
        self.failed = false;
        Ok(())
    }
}

impl Deref for Writer {
    type Target = dyn Catalog;

    fn deref(&self) -> &Self::Target {
        &**self.catalog.as_ref().expect("it goes back when it is dropped")
    }
}

impl DerefMut for Writer {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut **self.catalog.as_mut().expect("it goes back when it is dropped")
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        if !self.failed {
            *self.home.0.lock().unwrap_or_else(PoisonError::into_inner) = self.catalog.take();
        }
    }
}
