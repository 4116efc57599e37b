//! A promised error and its three shares: of the surface, of rounding to units, of the codec.
//!
//! TOLERANCE as one error of M metres is a promise for the file: `surface + unit / 2 + E unit <= M`. The surface is asked for M / 2
//! and the codec takes what is left once the surface is known; a bound that the caller chose is the codec's, and the surface is
//! asked for the rest. The unit is a power of ten of metres, a twentieth of M or a tenth of the codec's bound at most, and one
//! millimetre at least.

use crate::base::{Error, Result};
use crate::db::query::Tolerance;
use terraquilt_codecs::gtb::header::{BOUND_MAX, LAYERS_MAX};

/// Units that are chosen, metres.
const UNITS: [f64; 7] = [0.001, 0.01, 0.1, 1.0, 10.0, 100.0, 1000.0];
/// What sums of doubles may be off at heights of a million metres.
pub const SUMS_M: f64 = 1e-9;

/// What the caller chose beside TOLERANCE.
#[derive(Clone, Debug, Default)]
pub struct Choice {
    /// The codec's bound, metres.
    pub bound: Option<f64>,
    /// Bounds of its layers, metres, coarse to fine; the last is the codec's bound. Empty: one layer.
    pub layers: Vec<f64>,
    /// Metres of a unit.
    pub unit: Option<f64>,
}

/// The shares, before the surface is known.
#[derive(Clone, Debug)]
pub struct Shares {
    /// What the surface is asked for.
    pub surface: Tolerance,
    /// What was promised, if it is one number above 0.
    promised: Option<f64>,
    choice: Choice,
}

impl Shares {
    /// # Errors
    /// If a bound, layer or unit is no length, layers do not descend, or nothing is left for the surface.
    pub fn new(tolerance: &Tolerance, choice: &Choice) -> Result<Shares> {
        check(choice)?;
        let choice = choice.clone();
        let Tolerance::Constant(m) = tolerance else {
            return Ok(Shares { surface: tolerance.clone(), promised: None, choice });
        };
        if *m == 0.0 {
            return Ok(Shares { surface: Tolerance::Constant(0.0), promised: None, choice });
        }
        let surface = match choice.chosen() {
            None => m / 2.0,
            Some(b) => m - b - choice.unit_for(b, b) / 2.0 - 2.0 * SUMS_M,
        };
        let half = choice.unit_for(choice.chosen().unwrap_or(m / 2.0), m / 2.0) / 2.0;
        if surface <= 0.0 || half > m / 2.0 {
            let reason = match choice.chosen() {
                Some(b) if surface <= 0.0 => {
                    format!("{b} m (and rounding to units) leave nothing of {m} m for the surface; give less")
                }
                _ => {
                    format!("{} m round by {half} m, of {m} m that were asked; give a finer one", 2.0 * half)
                }
            };
            return Err(Error::invalid(if surface <= 0.0 { "bound" } else { "unit" }, reason));
        }
        Ok(Shares { surface: Tolerance::Constant(surface), promised: Some(*m), choice })
    }

    /// For a codec that promises nothing: the surface and its rounding have all of the tolerance.
    ///
    /// # Errors
    /// If the unit is none, or leaves nothing for the surface.
    pub fn unbounded(tolerance: &Tolerance, unit: Option<f64>) -> Result<Shares> {
        let mut choice = Choice { unit, ..Choice::default() };
        check(&choice)?;
        let mut surface = tolerance.clone();
        if let Tolerance::Constant(m) = tolerance
            && *m > 0.0
        {
            let unit = choice.unit_for(*m, *m);
            let left = m - unit / 2.0 - 2.0 * SUMS_M;
            if left <= 0.0 {
                let half = unit / 2.0;
                let reason =
                    format!("{unit} m round by {half} m, of {m} m that were asked; give a finer one");
                return Err(Error::invalid("unit", reason));
            }
            choice.unit = Some(unit);
            surface = Tolerance::Constant(left);
        }
        Ok(Shares { surface, promised: None, choice })
    }

    /// The unit, and the bounds of the layers in units, for a surface whose certified errors lie from `least` to `most` metres.
    pub fn settle(&self, [least, most]: [f64; 2]) -> Settled {
        let least = if least.is_finite() { least } else { 0.0 };
        let chosen = self.choice.chosen();
        let wish = chosen.unwrap_or(match self.promised {
            Some(m) => m / 2.0,
            // At error 0 the codec adds nothing; where the tolerance varies, no more than the surface has anywhere.
            None if self.surface == Tolerance::Constant(0.0) => 0.0,
            None => least,
        });
        let unit = self.choice.unit_for(wish, wish);
        let left = self.promised.map(|m| m - most - unit / 2.0 - 2.0 * SUMS_M);
        // A surface that needs more than was promised: the codec keeps its half, and the file says what it is.
        let last = match (chosen, left) {
            (None, Some(left)) if left >= 0.0 => units(left / unit),
            (None, Some(_)) => units(wish / unit - 0.5),
            // What is meant to be so many units may miss it by the dust of the division.
            _ => units(wish / unit + 1e-9),
        };
        let mut layers = vec![last];
        for wanted in self.choice.layers.iter().rev().skip(1) {
            let fine = 2.0 * f64::from(layers[0]) + 1.0;
            let parts = ((2.0 * wanted / unit + 1.0) / fine - 1.0) / 2.0;
            let parts = 2.0 * parts.round().clamp(1.0, 127.0) + 1.0;
            layers.insert(0, ((parts * fine - 1.0) / 2.0).min(f64::from(u32::MAX / 4)) as u32);
        }
        let given_error = most + unit / 2.0 + SUMS_M;
        Settled { unit, layers, given_error, asked: self.choice.layers.clone(), promised: self.promised }
    }
}

/// What a stream is made with.
pub struct Settled {
    /// Metres of a unit.
    pub unit: f64,
    /// Bounds of the layers in units, coarse to fine.
    pub layers: Vec<u32>,
    /// Of surface and rounding, metres.
    pub given_error: f64,
    asked: Vec<f64>,
    promised: Option<f64>,
}

impl Settled {
    /// Bounds of the layers in metres.
    pub fn layers_m(&self) -> Vec<f64> {
        self.layers.iter().map(|e| f64::from(*e) * self.unit).collect()
    }

    /// What a person should know. `codec`: the bound of the codec, metres.
    pub fn notes(&self, codec: f64) -> Vec<String> {
        let mut out = Vec::new();
        let taken = self.layers_m();
        if self.asked.iter().zip(&taken).any(|(a, t)| (a - t).abs() >= self.unit) {
            let list = |v: &[f64]| v.iter().map(|m| shown(*m)).collect::<Vec<String>>().join(", ");
            out.push(format!(
                "layers of {} m do not refine each other in units of {} m (2E + 1 of each must divide that of the one before, in \
                 units): the nearest, {} m, were taken",
                list(&self.asked),
                self.unit,
                list(&taken)
            ));
        }
        if let Some(m) = self.promised.filter(|m| self.given_error + codec > *m) {
            out.push(format!(
                "the surface alone has {:.3} m there (the accuracy of its surveys); with the codec's {codec:.3} m that is more \
                 than the {m} m asked",
                self.given_error
            ));
        }
        out
    }
}

/// Metres without the dust of doubles.
fn shown(m: f64) -> String {
    ((m * 1e6).round() / 1e6).to_string()
}

/// Whole units, rounded down.
fn units(bound: f64) -> u32 {
    (bound.floor().max(0.0) as u32).min(BOUND_MAX)
}

impl Choice {
    /// The codec's bound, if the caller chose one.
    fn chosen(&self) -> Option<f64> {
        self.layers.last().copied().or(self.bound)
    }

    fn unit_for(&self, bound: f64, share: f64) -> f64 {
        let fits = |u: &&f64| **u <= bound.min(share) / 10.0;
        self.unit.unwrap_or_else(|| *UNITS.iter().rev().find(fits).unwrap_or(&UNITS[0]))
    }
}

fn check(choice: &Choice) -> Result<()> {
    let length = |what: &str, v: f64| match v.is_finite() && v >= 0.0 {
        true => Ok(()),
        false => Err(Error::invalid(what, format!("{v} is no bound; give metres, 0 or more"))),
    };
    choice.bound.map_or(Ok(()), |b| length("bound", b))?;
    choice.layers.iter().try_for_each(|b| length("layers", *b))?;
    if let Some(u) = choice.unit.filter(|u| !(u.is_finite() && *u >= 1e-6)) {
        return Err(Error::invalid("unit", format!("{u} m; give 0.000001 m or more")));
    }
    if choice.bound.is_some() && !choice.layers.is_empty() {
        return Err(Error::invalid(
            "bound",
            "the last of the layers is the codec's bound; leave one of both out",
        ));
    }
    if choice.layers.len() > LAYERS_MAX {
        return Err(Error::limit("layers", LAYERS_MAX as u64, choice.layers.len() as u64));
    }
    match choice.layers.windows(2).find(|w| w[0] <= w[1]) {
        Some(w) => Err(Error::invalid(
            "layers",
            format!("{} after {}; each must be finer than the last", w[1], w[0]),
        )),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choice(bound: Option<f64>, layers: &[f64], unit: Option<f64>) -> Choice {
        Choice { bound, layers: layers.to_vec(), unit }
    }

    fn total(s: &Settled) -> f64 {
        s.given_error + f64::from(s.layers[s.layers.len() - 1]) * s.unit
    }

    #[test]
    fn the_shares_of_a_promise_sum_to_no_more() {
        for m in [0.003, 0.05, 0.7, 1.0, 3.0, 20.0, 1000.0, 1e6] {
            let shares = Shares::new(&Tolerance::Constant(m), &Choice::default()).unwrap();
            assert_eq!(shares.surface, Tolerance::Constant(m / 2.0));
            for part in [0.0, 0.1, 0.5, 0.7] {
                let s = shares.settle([0.0, m * part]);
                assert!(total(&s) <= m, "{m} {part}: {}", total(&s));
                // The codec uses what is left, but for a unit.
                assert!(
                    total(&s) > m - 2.0 * s.unit || s.layers[0] == BOUND_MAX,
                    "{m} {part}: {}",
                    total(&s)
                );
                assert!(s.notes(0.0).is_empty());
            }
            let s = shares.settle([m, 2.0 * m]);
            assert!(total(&s) > m && s.notes(f64::from(s.layers[0]) * s.unit).len() == 1);
        }
    }

    #[test]
    fn what_the_caller_chooses_is_the_codecs() {
        let m = Tolerance::Constant(5.0);
        let shares = Shares::new(&m, &choice(Some(2.0), &[], None)).unwrap();
        let Tolerance::Constant(surface) = shares.surface else { panic!("one number") };
        assert!(surface <= 2.95 && surface > 2.949999);
        let s = shares.settle([0.0, surface]);
        assert_eq!((s.unit, s.layers.clone()), (0.1, vec![20]));
        assert!(total(&s) <= 5.0);
        let exact = Shares::new(&Tolerance::Constant(0.0), &Choice::default()).unwrap().settle([0.1, 0.5]);
        assert_eq!((exact.unit, exact.layers.clone()), (0.001, vec![0]));
        assert!((total(&exact) - 0.5005).abs() < 1e-8);
        for (bound, unit, says) in
            [(Some(5.0), None, "bound"), (None, Some(9.0), "unit"), (Some(-1.0), None, "no bound")]
        {
            let e = Shares::new(&m, &choice(bound, &[], unit)).err().unwrap().to_string();
            assert!(e.contains(says), "{e}");
        }
    }

    #[test]
    fn without_a_bound_surface_and_rounding_have_all() {
        for m in [0.002, 1.0, 30.0, 5000.0] {
            let shares = Shares::unbounded(&Tolerance::Constant(m), None).unwrap();
            let Tolerance::Constant(surface) = shares.surface else { panic!("one number") };
            let s = shares.settle([0.0, surface]);
            assert!(s.given_error <= m && s.given_error > m - 2e-9 && s.unit <= f64::max(m / 10.0, 0.001));
        }
        let exact = Shares::unbounded(&Tolerance::Constant(0.0), None).unwrap();
        assert_eq!(exact.surface, Tolerance::Constant(0.0));
        let coarse = Shares::unbounded(&Tolerance::Constant(4.0), Some(8.0)).err().unwrap().to_string();
        assert!(coarse.contains("8 m round by 4 m"), "{coarse}");
        assert!(Shares::unbounded(&Tolerance::Constant(4.0), Some(-1.0)).is_err());
    }

    #[test]
    fn layers_are_the_nearest_that_refine_each_other() {
        let none = Tolerance::Constant(0.0);
        let s =
            Shares::new(&none, &choice(None, &[13.0, 4.0, 1.0, 0.0], Some(1.0))).unwrap().settle([0.0; 2]);
        assert_eq!(s.layers, [13, 4, 1, 0]);
        assert!(s.notes(0.0).is_empty());
        let s = Shares::new(&none, &choice(None, &[20.0, 6.0, 2.0], None)).unwrap().settle([0.0; 2]);
        assert_eq!(s.unit, 0.1);
        for pair in s.layers.windows(2) {
            let (a, b) = (2 * pair[0] + 1, 2 * pair[1] + 1);
            assert!(a > b && a % b == 0 && (a / b) % 2 == 1, "{:?}", s.layers);
        }
        assert_eq!(s.layers[2], 20);
        assert!(s.notes(2.0)[0].contains("20, 6, 2 m"), "{:?}", s.notes(2.0));
        assert!(Shares::new(&none, &choice(None, &[1.0, 2.0], None)).is_err());
    }

    #[test]
    fn where_the_tolerance_varies_the_codec_adds_no_more_than_the_least() {
        use crate::height::lod::cut::{Foci, Focus};
        let foci = Foci::new(vec![Focus { center: [0.0; 2], radius: 1.0, error: 1.0, growth: 0.1 }]).unwrap();
        let s = Shares::new(&Tolerance::Foci(foci), &Choice::default()).unwrap().settle([0.8, 40.0]);
        assert_eq!((s.unit, s.layers.clone()), (0.01, vec![80]));
        assert!((total(&s) - 40.805).abs() < 1e-6);
    }
}
