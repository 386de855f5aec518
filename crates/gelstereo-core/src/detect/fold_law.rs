//! How far a fold of the gel within a dot moves the dot's centre in an image.
//!
//! A fold shifts the dot's mean position from its centre in two ways: the far side moves, and its weight in
//! the image changes with its projected area and its brightness. The weight changes by about as much as the
//! slope or the stretch, so a fold by s is taken to change it by the factor 1 + s. Where in the dot the gel
//! folds is unknown.

use crate::math::linalg::{Symmetric, add_outer};

/// Mean square of a second difference over all positions of a fold by 1, times the pitch: the integral over
/// t of h(t)², where h(t) = max(0, 1 - |t|). That of h(t) - h(t - 1)/2 - h(t + 1)/2 is the same.
const MEAN_SQUARE: f64 = 2.0 / 3.0;
/// Square of a dot's mean position off its centre, integrated over all positions of a fold by 1, over the
/// cube of the radius in pitches: the integral of (E max(x - t, 0) - max(-t, 0))² over t, for x across a disc
/// of radius 1. Over `MEAN_SQUARE`.
const MOVED: f64 = 0.015_6 / MEAN_SQUARE;
/// The same for the offset along the surface when a fold by s changes the weight of the dot's far side in the
/// image by the factor 1 + s: the integral over t of g², where g(t) = 2 (1 - t²)^(3/2) / 3π is the integral
/// of x over the far side, x > t.
const WEIGHED: f64 = 0.041_2 / MEAN_SQUARE;

/// Adds what the moved far side does. `fold` is a second difference that a fold causes, `share` its weight
/// among those nearby, and `cube` that of the dot's radius in pitches.
pub(crate) fn add_moved<const N: usize>(
    covariance: &mut Symmetric<N>,
    cube: f64,
    share: f64,
    fold: [f64; N],
) {
    add_outer(covariance, cube * MOVED * share, fold);
}

/// Adds what the changed weight does along the unit vector `along`, for folds of this mean square.
pub(crate) fn add_weighed<const N: usize>(
    covariance: &mut Symmetric<N>,
    cube: f64,
    square: f64,
    along: [f64; N],
) {
    add_outer(covariance, cube * WEIGHED * square, along);
}
