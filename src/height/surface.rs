//! stub
/// Ratio over which weights fade in and out along the error axis.
pub const KAPPA: f64 = 1.1;
