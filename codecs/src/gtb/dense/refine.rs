//! Layers: each refines every height inside the interval that the one before left.

use super::super::field::Field;
use super::super::header::Header;
use super::{Mark, Reached};
use crate::range::Coder;
use crate::{Error, Result};

/// Codes one further layer.
pub(super) fn code<C: Coder>(
    _header: &Header,
    _layer: usize,
    _source: Option<&[i32]>,
    _field: &mut Field,
    _c: &mut C,
    _mark: Mark<C>,
) -> Result<Reached> {
    Err(Error::invalid("layers", "they come"))
}
