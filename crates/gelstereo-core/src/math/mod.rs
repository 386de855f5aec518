//! The only use of libm, and the basic geometry built on it.
//!
//! libm replaces std's functions because those differ between machines with and without FMA; the same
//! input must give the same bits everywhere.

mod dense;
mod exp;
pub mod linalg;
pub mod random;
pub mod se3;
pub mod so3;
mod solve;

pub(crate) use dense::InverseFactor;
pub(crate) use exp::exp_nonpositive;
pub use glam::{DMat3, DQuat, DVec2, DVec3};
pub use libm::{
    acos, asin, asinh, atan, atan2, cbrt, ceil, cos, cosh, erf, erfc, exp, expm1, fabs as abs, floor, hypot,
    j0 as bessel_j0, j1 as bessel_j1, log as ln, log1p, pow, rint as round_even, round, sin, sqrt, tan, tanh,
};
pub use se3::Pose;
pub(crate) use solve::{Factor, solve_definite};

/// Arithmetic mean of the points; the zero vector for an empty slice.
#[must_use]
pub fn centroid(points: &[DVec3]) -> DVec3 {
    if points.is_empty() {
        return DVec3::ZERO;
    }
    // Relative to the first point, so that an offset of 1e9 mm does not cost precision.
    let origin = points[0];
    let sum = points.iter().fold(DVec3::ZERO, |sum, &point| sum + (point - origin));
    origin + sum / points.len() as f64
}

/// The middle value of `values` (the upper one of the two for an even count), which it reorders.
///
/// Returns `None` for an empty slice. Non-finite values are ordered by `f64::total_cmp`.
pub fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
