//! Profile `adaptive`.

use super::super::companion::Companion;
use super::super::field::Field;
use super::super::header::Header;
use super::{Mark, Reached};
use crate::range::Coder;
use crate::{Error, Result};

pub(super) fn code<C: Coder, T: Companion<C>>(
    _header: &Header,
    _source: Option<&[i32]>,
    _field: &mut Field,
    _c: &mut C,
    _companion: &mut T,
    _mark: Mark<C>,
) -> Result<Reached> {
    Err(Error::invalid("profile", "adaptive comes"))
}
