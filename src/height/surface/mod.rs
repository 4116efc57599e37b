//! The one surface that is measured and drawn: patches blended by weights in LOD space
//! (LOD-space specification, section 5.4), or by the paper's plain blend (equation 1, section 3.2).
//!
//! ```text
//! weight(P, p, z) = W(p) v(p) up'(p, z) dn(z)        F(p, z) = sum weight f / sum weight      surface(p) = F(p, tolerance(p))
//! ```
//!
//! - W: with unit volume over the patch's domain, `k w(x/dx) w(y/dy) / (dx dy)`: in bilinear databases the hat of the
//!   paper and k = 1, in bicubic ones `w(t) = (1-|t|)^3 (3|t| + 1)` and k = 25/16 (section 7);
//! - v: 1 on core' of the patch's survey, 0 from one cell away ([`hood`]);
//! - up, dn: fade in above bot, fade out above top, over a ratio of [`KAPPA`], linear or of class C2 ([`Real::ramp`]);
//! - up': a floor patch stays in wherever no better survey is.
//!
//! In a bicubic database every factor and every patch is of class C2, so the surface is, too, wherever the tolerance is;
//! gradient and second derivatives come from the same formula, evaluated in numbers that carry them ([`Real`]).
//!
//! Where a cell of core' holds p, every contributor has `bot <= max(tolerance, best)`: theorem T7.
//! Where surveys disagree, a correction per survey may be added to its patches (section 15): [`seam`].

mod bent;
mod buckets;
mod eval;
mod hood;
mod lanes;
mod planes;
mod real;
mod run;
mod scattered;
pub mod seam;
mod survey;
mod tile;

pub use eval::{Blend, Evaluation, Hessian, How, Patch, Seams, Sheet, Source, Surface};
pub use hood::{Hood, outside};
pub use planes::{Band, Planes};
pub use real::{Dual, Jet, Real};
pub use scattered::Ordered;
pub use survey::SurveyField;

/// Ratio over which weights fade in and out along the error axis.
pub const KAPPA: f64 = 1.1;
