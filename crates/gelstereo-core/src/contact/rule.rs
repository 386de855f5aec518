//! The rule by which a marker is in contact, whichever rung measures its pressure.
//!
//! Free markers carry no pressure, p = 0; a marker in contact may carry any up to that of the part's own surface there. Its
//! height is known ten times better than its pressure and says how large that can be: on a part that leaves the gel with a
//! curvature, some heights. So p = 0 is held against p drawn evenly from 0 to `MAX_SHARE` h, by their Bayes factor, on a Markov
//! random field that holds neighbours together. The factor's price for a wide choice (Occam's factor, MacKay 1992) is high
//! beside a deep contact, where a little pressure is likelier noise, and nothing beside a shallow one, where little is all that
//! contact can bring.

use crate::math::{abs, log1p, sqrt};

/// What a pair of neighbours costs of which one is in contact, in squared standard deviations. On simulated presses of many parts
/// 3 to 5 do about as well.
const EDGE_COST: f64 = 4.0;
/// Largest pressure of a contact, in heights. Of the markers at the rims of simulated contacts four in five carry less.
const MAX_SHARE: f64 = 4.0;
/// √(2π)
const ROOT_TWO_PI: f64 = 2.506_628_274_631_000_5;
/// Standard deviations of the plain stencil from which a marker is taken to be in contact at first.
pub(super) const START: f64 = 4.0;
/// Standard deviations of a marker's pressure, as if all around were free, from which one far from any contact is judged:
/// fewer than a change of its label takes (4), since for this the variances are taken as equal.
const SCREEN: f64 = 3.3;
/// Standard deviation below which no height is believed to be, mm: a nanometre.
pub(super) const MIN_SIGMA_MM: f64 = 1e-6;

/// Whether a pressure, less what those around say of it if all are free, is worth a judgement.
pub(super) fn stands_out(left_mm: f64, variance_mm2: f64) -> bool {
    left_mm > 0.0 && left_mm * left_mm > SCREEN * SCREEN * variance_mm2
}

/// Signed squared standard deviations of a pressure.
pub(super) fn evidence(pressure_mm: f64, variance_mm2: f64) -> f64 {
    pressure_mm * abs(pressure_mm) / variance_mm2
}

/// What contact gains over no contact, in squared standard deviations (twice the logarithm of the odds): of a marker's pressure
/// and height, among neighbours that are in contact or not.
pub(super) fn gain(
    pressure_mm: f64,
    height_mm: f64,
    variance_mm2: f64,
    neighbours: impl Iterator<Item = bool>,
) -> f64 {
    // Pressures to choose from, over those that explain the evidence about as well as the likeliest.
    let choice = MAX_SHARE * height_mm.max(0.0) / (ROOT_TWO_PI * sqrt(variance_mm2));
    let edges: f64 = neighbours.map(|touches| if touches { -EDGE_COST } else { EDGE_COST }).sum();
    evidence(pressure_mm, variance_mm2) - 2.0 * log1p(choice) - edges
}
