//! Ratio of the actual to the stated noise of the centres, from the rest frame.
//!
//! A marker's rows in both views agree up to the noise of its centres, whatever the print and the gel. So
//! the epipolar residuals of the rest frame measure that noise, including everything the image model
//! omits: a marker's place within the pixel, the lens, compression, and errors of the noise measured
//! beside the gel. Errors of the rig's calibration are smooth over the image and are removed by a
//! polynomial.

use crate::lattice::Topology;
use crate::math::{Factor, abs, median, sqrt};
use crate::track::MarkerState;
use crate::triangulate::{Centres, StereoPoint};
use alloc::vec::Vec;

/// Total order of the polynomial over rows and columns. On path-traced images order 3 leaves refraction
/// in the residuals, up to ten times the noise; 4 to 8 agree to 4 %.
const ORDER: usize = 4;
/// Number of its terms.
pub(super) const TERMS: usize = (ORDER + 1) * (ORDER + 2) / 2;
/// Fewest rows and columns that determine it, with a margin.
const MIN_SIDE: usize = ORDER + 3;
/// Outlier limit: residuals above this multiple of the median one are of badly measured markers, such as
/// under a glint.
const MAX_OFF: f64 = 6.0;
/// Rounds of outlier rejection.
const ROUNDS: usize = 3;
/// Residuals up to this many standard deviations are chance; 1 in 16 000 is above.
const CHANCE: f64 = 4.0;
/// Standard deviations by which the mean squared residual must exceed 1 to be significant.
const SURE: f64 = 4.0;
/// Largest accepted factor. Path-traced images have shown up to 1.5, and 35 with JPEG.
const MOST: f64 = 1000.0;

/// Noise of the centres, estimated from the rest frame's epipolar residuals.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Epipolar {
    /// Factor for the variances of the centres; 1 where it is unknown or not significant.
    pub scale: f64,
    /// Residual of the calibration as coefficients of [`terms`]; `None` where it is unknown.
    pub smooth: Option<[f64; TERMS]>,
    /// The same at every marker, px.
    smooth_px: Vec<f64>,
}

impl Default for Epipolar {
    fn default() -> Self {
        Self { scale: 1.0, smooth: None, smooth_px: Vec::new() }
    }
}

impl Epipolar {
    /// From the rest frame of a print.
    pub fn learn(
        topology: Topology,
        stereo: &[StereoPoint],
        state: &[MarkerState],
        left: Centres<'_>,
        right: Centres<'_>,
    ) -> Self {
        if topology.rows().min(topology.cols()) < MIN_SIDE {
            return Self::default();
        }
        let sample = |i: usize| Sample {
            terms: terms_at(topology, i),
            residual_px: stereo[i].epipolar_px,
            variance_px2: variance_px2(left, right, i),
        };
        let mut samples = Vec::with_capacity(stereo.len());
        samples.extend((0..stereo.len()).filter(|&i| state[i] == MarkerState::Seen).map(sample));
        for _ in 0..ROUNDS {
            let Some(smooth) = fit(&samples) else { return Self::default() };
            let off = |sample: &Sample| abs(sample.residual_px - dot(&smooth, &sample.terms));
            let Some(usual) = median(&mut samples.iter().map(off).collect::<Vec<_>>()) else { break };
            let count = samples.len();
            samples.retain(|sample| off(sample) <= MAX_OFF * usual);
            if samples.len() == count {
                break;
            }
        }
        let (Some(smooth), Some(free)) = (fit(&samples), samples.len().checked_sub(TERMS + 1)) else {
            return Self::default();
        };
        let squared = |sample: &Sample| {
            let off = sample.residual_px - dot(&smooth, &sample.terms);
            off * off / sample.variance_px2
        };
        let scale = samples.iter().map(squared).sum::<f64>() / (free + 1) as f64;
        let chance = SURE * sqrt(2.0 / (free + 1) as f64);
        // Errors shared by both views, from the pixel grid, cancel in the residuals, so a smaller factor
        // proves nothing.
        let is_noisier = scale - 1.0 > chance;
        Self::resume(topology, if is_noisier { scale.min(MOST) } else { 1.0 }, Some(smooth))
    }

    /// As learned before.
    pub fn resume(topology: Topology, scale: f64, smooth: Option<[f64; TERMS]>) -> Self {
        let at =
            |smooth: [f64; TERMS]| (0..topology.places()).map(move |i| dot(&smooth, &terms_at(topology, i)));
        Self { scale, smooth, smooth_px: smooth.map(|smooth| at(smooth).collect()).unwrap_or_default() }
    }

    /// Factor for the variance of a marker's point with this epipolar residual. It exceeds the scale
    /// where the residual is not chance: then something other than noise, a reflection or dirt, moved a
    /// centre, and about as far along the row (Birge 1932).
    pub fn widening(&self, i: usize, epipolar_px: f64, variance_px2: f64) -> f64 {
        let Some(smooth_px) = self.smooth_px.get(i) else { return self.scale };
        let off_px = epipolar_px - smooth_px;
        let squared = off_px * off_px / variance_px2.max(f64::MIN_POSITIVE);
        if squared > CHANCE * CHANCE * self.scale { squared } else { self.scale }
    }
}

/// Variance of a marker's epipolar residual from the stated covariances of its centres, px².
pub(super) fn variance_px2(left: Centres<'_>, right: Centres<'_>, i: usize) -> f64 {
    left.covariance_px2[i][1][1] + right.covariance_px2[i][1][1]
}

/// The terms at a marker.
fn terms_at(topology: Topology, i: usize) -> [f64; TERMS] {
    let along = |at: f64, count: usize| 2.0 * at / (count - 1) as f64 - 1.0;
    let row = i / topology.cols();
    terms(along(topology.along(i), topology.cols()), along(row as f64, topology.rows()))
}

/// One marker of the rest frame.
struct Sample {
    terms: [f64; TERMS],
    residual_px: f64,
    variance_px2: f64,
}

/// Products of Chebyshev polynomials up to the order, for coordinates from -1 to 1.
fn terms(x: f64, y: f64) -> [f64; TERMS] {
    let chebyshev = |x: f64| {
        let mut values = [1.0; ORDER + 1];
        values[1] = x;
        for k in 2..=ORDER {
            values[k] = 2.0 * x * values[k - 1] - values[k - 2];
        }
        values
    };
    let (across, down) = (chebyshev(x), chebyshev(y));
    let (mut terms, mut next) = ([0.0; TERMS], 0);
    for a in 0..=ORDER {
        for b in 0..=ORDER - a {
            terms[next] = across[a] * down[b];
            next += 1;
        }
    }
    terms
}

/// Least squares; `None` where the samples do not determine a term.
fn fit(samples: &[Sample]) -> Option<[f64; TERMS]> {
    let (mut matrix, mut right) = ([[0.0; TERMS]; TERMS], [0.0; TERMS]);
    for Sample { terms, residual_px, .. } in samples {
        for i in 0..TERMS {
            right[i] += terms[i] * residual_px;
            for j in 0..=i {
                matrix[i][j] += terms[i] * terms[j];
            }
        }
    }
    Some(Factor::new(&matrix)?.solve(&right))
}

fn dot(a: &[f64; TERMS], b: &[f64; TERMS]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::random::Stream;
    use crate::math::{DVec2, DVec3};
    use alloc::vec;
    use proptest::prelude::*;

    const SIDE: usize = 25;
    const MARKERS: usize = SIDE * SIDE;
    const STATED_PX2: f64 = 4e-4;

    /// Residuals of centres with `factor` times the stated variance, plus a calibration error.
    fn residuals_px(seed: u64, factor: f64, calibration_px: f64) -> Vec<f64> {
        let mut stream = Stream::new(seed, "epipolar residuals");
        let sigma_px = sqrt(2.0 * STATED_PX2 * factor);
        (0..MARKERS)
            .map(|i| {
                let [x, y] = [i % SIDE, i / SIDE].map(|at| at as f64 / 12.0 - 1.0);
                calibration_px * (1.0 + x - y * y + x * y * y * y) + sigma_px * stream.normal()
            })
            .collect()
    }

    fn scale_of(residuals_px: &[f64], state: &[MarkerState]) -> f64 {
        let covariance_mm2 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let stereo: Vec<StereoPoint> = residuals_px
            .iter()
            .map(|&epipolar_px| StereoPoint { point_mm: DVec3::ZERO, covariance_mm2, epipolar_px })
            .collect();
        // Across the rows a centre may be as uncertain as it likes.
        let (positions_px, covariance_px2) =
            ([DVec2::ZERO; MARKERS], [[[25.0 * STATED_PX2, 0.0], [0.0, STATED_PX2]]; MARKERS]);
        let centres = Centres { positions_px: &positions_px, covariance_px2: &covariance_px2 };
        Epipolar::learn(Topology::square(SIDE, SIDE), &stereo, state, centres, centres).scale
    }

    proptest! {
        /// The mean of 610 squares has a standard error of 6 %; five times that is allowed.
        #[test]
        fn the_noise_is_found_whatever_the_calibration_leaves(
            seed in any::<u64>(),
            log_factor in 0.5..3.0_f64,
            calibration_px in -2.0..2.0_f64,
        ) {
            let factor = crate::math::exp(log_factor);
            let scale = scale_of(&residuals_px(seed, factor, calibration_px), &[MarkerState::Seen; MARKERS]);
            prop_assert!((0.7..1.3).contains(&(scale / factor)), "{scale} for {factor}");
        }

        #[test]
        fn noise_as_stated_or_less_changes_no_bit(
            seed in any::<u64>(),
            factor in 0.01..1.0_f64,
            calibration_px in -2.0..2.0_f64,
        ) {
            let scale = scale_of(&residuals_px(seed, factor, calibration_px), &[MarkerState::Seen; MARKERS]);
            prop_assert_eq!(scale, 1.0);
        }

        /// Markers under a glint and unseen ones do not count. The mean of the 565 or more other squares has
        /// a standard error of 6 %. Six times that is allowed: the chi-squared distribution exceeds five
        /// times (1.30) once in 400 000 cases.
        #[test]
        fn wild_residuals_do_not_count(seed in any::<u64>(), at in prop::collection::vec(0..MARKERS, 60)) {
            let mut residuals_px = residuals_px(seed, 1.0, 0.3);
            let mut state = vec![MarkerState::Seen; MARKERS];
            for (k, &i) in at.iter().enumerate() {
                residuals_px[i] = if k % 2 == 0 { 0.5 } else { -0.4 };
                if k % 3 == 0 {
                    (residuals_px[i], state[i]) = (f64::NAN, MarkerState::Held);
                }
            }
            let scale = scale_of(&residuals_px, &state);
            prop_assert!((0.64..1.36).contains(&scale), "{scale}");
        }
    }

    /// The uncertainty of a marker with inconsistent rows follows its residual; chance changes nothing,
    /// and a record keeps the model.
    #[test]
    fn a_residual_beyond_chance_widens_its_own_point() {
        let factor = 4.0;
        let residuals_px = residuals_px(7, factor, 0.3);
        let covariance_mm2 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let stereo: Vec<StereoPoint> = residuals_px
            .iter()
            .map(|&epipolar_px| StereoPoint { point_mm: DVec3::ZERO, covariance_mm2, epipolar_px })
            .collect();
        let covariance_px2 = [[[STATED_PX2, 0.0], [0.0, STATED_PX2]]; MARKERS];
        let centres = Centres { positions_px: &[DVec2::ZERO; MARKERS], covariance_px2: &covariance_px2 };
        let learned = Epipolar::learn(
            Topology::square(SIDE, SIDE),
            &stereo,
            &[MarkerState::Seen; MARKERS],
            centres,
            centres,
        );
        let kept = Epipolar::resume(Topology::square(SIDE, SIDE), learned.scale, learned.smooth);
        assert_eq!(kept, learned);
        let sigma_px = sqrt(2.0 * STATED_PX2 * learned.scale);
        let at = |i: usize, sigmas: f64| {
            let smooth_px = learned.smooth_px[i];
            learned.widening(i, smooth_px + sigmas * sigma_px, variance_px2(centres, centres, i))
        };
        for i in [0, 17, MARKERS - 1] {
            assert_eq!(at(i, 3.9), learned.scale);
            assert!(abs(at(i, 20.0) / (400.0 * learned.scale) - 1.0) < 1e-9);
        }
        assert_eq!(Epipolar::default().widening(3, 50.0, STATED_PX2), 1.0);
    }

    #[test]
    fn a_few_markers_say_nothing() {
        let mut state = [MarkerState::Held; MARKERS];
        state[..TERMS].fill(MarkerState::Seen);
        assert_eq!(scale_of(&[0.3; MARKERS], &state), 1.0);
    }
}
