//! Starting poses: points of a low-discrepancy sequence, mapped to the uncertainty of the guess.

use super::normal_system::{Placement, Prior};
use crate::math::{DVec3, cbrt, cos, floor, sin, sqrt};

/// Starts lie within this many standard deviations of the guess.
pub(super) const REACH: f64 = 2.4;

/// Powers of 1 / φ, φ⁷ = φ + 1: the additive recurrence of least known discrepancy in six dimensions
/// (Roberts 2018).
const STEPS: [f64; 6] = [
    0.898_653_712_628_699_3,
    0.807_578_495_221_347_6,
    0.725_733_412_940_224_4,
    0.652_183_025_915_054_4,
    0.586_086_697_482_084_2,
    0.526_688_987_040_246_5,
];

/// The `k`-th start; the first is the guess itself.
pub(super) fn start(prior: &Prior, k: u32) -> Placement {
    if k == 0 {
        return prior.guess;
    }
    let u = STEPS.map(|step| {
        let x = 0.5 + f64::from(k) * step;
        x - floor(x)
    });
    let omega = in_ball([u[0], u[1], u[2]]) * (REACH * prior.sigma_rad);
    let v = in_ball([u[3], u[4], u[5]]) * (REACH * prior.sigma_mm);
    prior.guess.moved(omega, v)
}

/// A point of the unit ball, uniform by volume.
fn in_ball([a, b, c]: [f64; 3]) -> DVec3 {
    let z = 2.0 * a - 1.0;
    let across = sqrt((1.0 - z * z).max(0.0));
    let angle = core::f64::consts::TAU * b;
    DVec3::new(across * cos(angle), across * sin(angle), z) * cbrt(c)
}
