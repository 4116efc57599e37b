//! Corrections of seams at one point: by survey, and their weighted sum.

use super::eval::{FEW, Scratch};
use super::seam::Field;
use super::{Real, Sheet, Surface};
use crate::base::Result;
use crate::height::lod::KERNEL;
use std::sync::Arc;

/// Indices of a level-0 block, and the correction there.
pub(super) type MetField = ((i32, i32), Arc<Field>);

/// A correction, and whether contradicting surveys made it.
pub(super) type Bent<T> = (T, bool);

/// The corrections at one point: by survey, and their weighted sum.
pub(super) struct Corrections<T> {
    few: [Option<Bent<T>>; FEW],
    many: Vec<Option<Bent<T>>>,
    pub(super) sum: T,
}

impl<T: Real> Corrections<T> {
    pub(super) fn new(surface: &Surface) -> Corrections<T> {
        let n = surface.surveys.len();
        let many = if surface.corrected && n > FEW { vec![None; n] } else { Vec::new() };
        Corrections { few: [None; FEW], many, sum: T::constant(0.0) }
    }

    /// The correction of a survey that contributes.
    pub(super) fn of(
        &mut self,
        sheet: &Sheet,
        survey: usize,
        index: [T; 2],
        z: T,
        s: &mut Scratch,
    ) -> Result<Bent<T>> {
        let slot = if self.many.is_empty() { &mut self.few[survey] } else { &mut self.many[survey] };
        match slot {
            Some(c) => Ok(*c),
            None => Ok(*slot.insert(sheet.correction(survey, index, z, s)?)),
        }
    }
}

impl Sheet<'_> {
    /// The correction of a survey of the surface at a point, metres: what is added to each of its patches there.
    pub fn correction_of(&self, survey: usize, p: [f64; 2]) -> Result<f64> {
        if !self.surface.corrected {
            return Ok(0.0);
        }
        let index: [f64; 2] = self.surface.surveys[survey].index(p);
        Ok(self.correction(survey, index, self.cut.at(p), &mut Scratch::default())?.0)
    }

    /// The correction of a survey at a point of its index space.
    pub(super) fn correction<T: Real>(
        &self,
        survey: usize,
        index: [T; 2],
        z: T,
        s: &mut Scratch,
    ) -> Result<Bent<T>> {
        let block = index.map(|c| (c.value() / KERNEL as f64).floor());
        let key = (block[0] as i32, block[1] as i32);
        s.seams.resize(self.surface.surveys.len(), None);
        let slot = &mut s.seams[survey];
        let field = match slot {
            Some((k, f)) if *k == key => &*f,
            _ => &slot.insert((key, self.source.seam(survey, key.0, key.1)?)).1,
        };
        let [x, y] = [0, 1].map(|k| index[k] - T::constant(block[k] * KERNEL as f64));
        Ok(field.at(x, y, z, |t: T| t.ramp(self.surface.kind)))
    }
}
