//! Stream G1.
use super::companion::Companion;
use super::dense::Reached;
use super::field::Field;
use super::header::Header;
use crate::range::Coder;
use crate::{Error, Result};

pub(super) fn code<C: Coder, T: Companion<C>>(
    _header: &Header,
    _source: Option<&[i32]>,
    _field: &mut Field,
    _c: &mut C,
    _companion: &mut T,
    _mark: &mut dyn FnMut(usize, u32, &C) -> Result<bool>,
) -> Result<Reached> {
    Err(Error::invalid("profile", "sparse comes"))
}
