//! Moving ink during the exposure.

use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, ceil, cos};

/// The mean over a path is a sum over segments of it and over Gauss points within each segment. The blurred
/// image of a dot changes along the path like the integral of a Gaussian. Gauss quadrature converges on
/// that faster than any power.
#[derive(Clone, Debug)]
pub(crate) struct Shutter {
    sigma_px: Option<f64>,
    /// (position from -1 to 1, half of its weight) for the rules of 1, 2, ... points.
    rules: Vec<Vec<(f64, f64)>>,
}

/// Longest segment, in sigmas of the lens.
const SEGMENT_SIGMAS: f64 = 6.0;

/// Points of the longest segment: see [`segments`].
const MAX_PLACES: usize = 9;

/// Pieces per pixel of path without a lens, each with one point: higher rules do not help at sharp
/// edges. A pixel's coverage has a kink where an edge enters or leaves it, once in a segment. The error is
/// an eighth of a segment's length times the segment's share of the path, 2e-3 at most.
const SHARP_PER_PX: f64 = 16.0;
const MIN_SHARP: f64 = 4.0;

/// Longer paths are not sampled more often.
const FARTHEST_PX: f64 = 1e4;

impl Shutter {
    pub(crate) fn new(sigma_px: Option<f64>) -> Self {
        Self { sigma_px, rules: (1..=MAX_PLACES).map(gauss).collect() }
    }

    /// Number of copies of a dot that are drawn along its path.
    pub(crate) fn times(way_px: f64, sigma_px: Option<f64>) -> usize {
        let (segments, places) = segments(way_px, sigma_px);
        segments * places
    }

    /// Calls `draw` for every sample of a path of that length: its position as a share of the path from
    /// the middle, and its weight.
    pub(crate) fn each(&self, way_px: f64, mut draw: impl FnMut(f64, f64)) {
        let (segments, places) = segments(way_px, self.sigma_px);
        let Some(rule) = self.rules.get(places - 1) else { return };
        let segment = 1.0 / segments as f64;
        for k in 0..segments {
            let middle = (k as f64 + 0.5) * segment - 0.5;
            for &(place, weight) in rule {
                draw(middle + 0.5 * segment * place, weight * segment);
            }
        }
    }
}

/// Number of segments of a path, and of points within each.
fn segments(way_px: f64, sigma_px: Option<f64>) -> (usize, usize) {
    let way_px = if way_px < FARTHEST_PX { way_px } else { FARTHEST_PX };
    if way_px == 0.0 {
        return (1, 1);
    }
    let Some(sigma_px) = sigma_px else {
        return (ceil((way_px * SHARP_PER_PX).max(MIN_SHARP)) as usize, 1);
    };
    let sigmas = way_px / sigma_px;
    let segments = ceil(sigmas / SEGMENT_SIGMAS).max(1.0);
    // A Gaussian has waves of up to 4 rad per sigma. They take 4 / 4 points per sigma, and some more to
    // converge.
    let places = ceil(1.5 + 1.2 * sigmas / segments) as usize;
    (segments as usize, places.min(MAX_PLACES))
}

/// Gauss-Legendre rule: roots of Legendre's polynomial by Newton's method, and half of their weights.
fn gauss(places: usize) -> Vec<(f64, f64)> {
    let n = places as f64;
    let place = |k: usize| {
        let mut x = cos(core::f64::consts::PI * (k as f64 + 0.75) / (n + 0.5));
        let mut slope = 1.0;
        for _ in 0..8 {
            let (value, derivative) = legendre(places, x);
            slope = derivative;
            x -= value / slope;
        }
        (x, 1.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..places).map(place).collect()
}

/// Legendre's polynomial and its derivative within (-1, 1).
fn legendre(degree: usize, x: f64) -> (f64, f64) {
    let (mut before, mut value) = (1.0, x);
    for k in 2..=degree {
        let k = k as f64;
        (before, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * before) / k);
    }
    (value, degree as f64 * (before - x * value) / (1.0 - x * x))
}

/// Length of the longest path.
pub(crate) fn longest_px(ways: impl Iterator<Item = DVec2>) -> f64 {
    ways.map(DVec2::length).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gelstereo_core::math::erf;
    use proptest::prelude::*;

    #[test]
    fn rules_are_exact_for_polynomials() {
        for places in 1..=MAX_PLACES {
            let rule = gauss(places);
            for degree in 0..2 * places as i32 {
                let sum: f64 = rule.iter().map(|&(x, weight)| weight * x.powi(degree)).sum();
                let expected = if degree % 2 == 0 { 1.0 / f64::from(degree + 1) } else { 0.0 };
                assert!((sum - expected).abs() < 1e-14, "{places} places, x^{degree}: {sum}");
            }
        }
    }

    proptest! {
        /// A pixel's response to an edge that passes it.
        #[test]
        fn an_edge_is_smeared_as_its_integral_says(
            way in 0.0..40.0_f64, from in -9.0..9.0_f64, sigma_px in 0.5..3.0_f64,
        ) {
            let seen = |x: f64| 0.5 + 0.5 * erf(x / (sigma_px * core::f64::consts::SQRT_2));
            let mut sum = 0.0;
            Shutter::new(Some(sigma_px)).each(way, |share, weight| sum += weight * seen(from + share * way));
            let steps = 4000;
            let expected = (0..steps)
                .map(|k| seen(from + ((f64::from(k) + 0.5) / f64::from(steps) - 0.5) * way))
                .sum::<f64>()
                / f64::from(steps);
            prop_assert!((sum - expected).abs() < 2e-4, "{} of {expected}", sum - expected);
        }
    }
}
