//! The decision rule for a marker in contact, shared by all rungs that measure its pressure.
//!
//! Free markers carry no pressure, p = 0. A marker in contact may carry any pressure up to that of the
//! part's own surface there. Its height, known ten times better than its pressure, bounds that: to
//! several heights where the part leaves the gel with a curvature. So p = 0 is compared with p uniform
//! from 0 to `MAX_SHARE` h by their Bayes factor, on a Markov random field that couples neighbours. The
//! factor's penalty for a wide range (Occam's factor, MacKay 1992) is high beside a deep contact, where a
//! small pressure is more likely noise. It is negligible beside a shallow one, where contact gives only
//! small pressures.

use crate::math::{abs, log1p, sqrt};

/// Cost of a pair of neighbours with different labels, in squared standard deviations. On simulated
/// presses of many parts 3 to 5 do about as well.
const EDGE_COST: f64 = 4.0;
/// Largest pressure of a contact, in heights. At the rims of simulated contacts four of five markers
/// carry less.
const MAX_SHARE: f64 = 4.0;
/// √(2π)
const ROOT_TWO_PI: f64 = 2.506_628_274_631_000_5;
/// Initial contact threshold on the plain stencil, in standard deviations.
pub(super) const START: f64 = 4.0;
/// Threshold on a marker's pressure, predicted as if all neighbours were free, from which a marker far
/// from contacts is classified, in standard deviations. It is below that of a label change (4), as
/// variances are taken as equal here.
const SCREEN: f64 = 3.3;
/// Lower bound of the standard deviation of a height, mm: a nanometre.
pub(super) const MIN_SIGMA_MM: f64 = 1e-6;

/// Whether the residual of a pressure, predicted as if all neighbours were free, is large enough to
/// classify the marker.
pub(super) fn stands_out(left_mm: f64, variance_mm2: f64) -> bool {
    left_mm > 0.0 && left_mm * left_mm > SCREEN * SCREEN * variance_mm2
}

/// Signed squared pressure in standard deviations.
pub(super) fn evidence(pressure_mm: f64, variance_mm2: f64) -> f64 {
    pressure_mm * abs(pressure_mm) / variance_mm2
}

/// Gain of contact over no contact, in squared standard deviations (twice the log odds), from a marker's
/// pressure and height and its neighbours' labels.
pub(super) fn gain(
    pressure_mm: f64,
    height_mm: f64,
    variance_mm2: f64,
    neighbours: impl Iterator<Item = bool>,
) -> f64 {
    // Range of possible pressures, relative to the range compatible with the measurement.
    let choice = MAX_SHARE * height_mm.max(0.0) / (ROOT_TWO_PI * sqrt(variance_mm2));
    let edges: f64 = neighbours.map(|touches| if touches { -EDGE_COST } else { EDGE_COST }).sum();
    evidence(pressure_mm, variance_mm2) - 2.0 * log1p(choice) - edges
}
