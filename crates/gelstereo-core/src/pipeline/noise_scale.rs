//! How much noisier or quieter the centres are than they state, from the rest frame.
//!
//! A marker's rows in both views fit together but for the noise of its centres, whatever the print and the gel. So
//! the epipolar residuals of the rest frame measure that noise, with all that the model of the image leaves out: a
//! marker's place within the pixel, the lens, compression, noise that was measured beside the gel. What the rig's
//! calibration leaves is smooth over the image, and a polynomial takes it away.

use crate::math::{Factor, abs, median, sqrt};
use crate::track::MarkerState;
use crate::triangulate::{Centres, StereoPoint};
use alloc::vec::Vec;

/// Order of the polynomial along rows and columns together. On path-traced images 3 leaves refraction in the
/// residuals, up to ten times the noise; 4 to 8 agree to 4 %.
const ORDER: usize = 4;
/// Its terms.
const TERMS: usize = (ORDER + 1) * (ORDER + 2) / 2;
/// Rows and columns from which it is determined, with some to spare.
const LEAST_SIDE: usize = ORDER + 3;
/// Residuals of more times the median one are of no marker that was measured well, such as one under a glint.
const MOST_OFF: f64 = 6.0;
/// Rounds of leaving such out.
const ROUNDS: usize = 3;
/// Standard deviations by which the mean squared residual must be off 1 to be believed.
const SURE: f64 = 4.0;
/// Largest factor that is believed. Path-traced images with a tray in view have shown 1/200 to 6.
const MOST: f64 = 1000.0;

/// What the variances of the centres are to be multiplied by; 1 where too little is seen to say, or nothing is wrong.
pub(super) fn noise_scale(
    (rows, cols): (usize, usize),
    stereo: &[StereoPoint],
    state: &[MarkerState],
    left: Centres<'_>,
    right: Centres<'_>,
) -> f64 {
    if rows < LEAST_SIDE || cols < LEAST_SIDE {
        return 1.0;
    }
    let sample = |i: usize| {
        let along = |at: usize, count: usize| 2.0 * at as f64 / (count - 1) as f64 - 1.0;
        Sample {
            terms: terms(along(i % cols, cols), along(i / cols, rows)),
            residual_px: stereo[i].epipolar_px,
            variance_px2: left.covariance_px2[i][1][1] + right.covariance_px2[i][1][1],
        }
    };
    let mut samples: Vec<Sample> =
        (0..stereo.len()).filter(|&i| state[i] == MarkerState::Seen).map(sample).collect();
    for _ in 0..ROUNDS {
        let Some(smooth) = fit(&samples) else { return 1.0 };
        let off = |sample: &Sample| abs(sample.residual_px - dot(&smooth, &sample.terms));
        let Some(usual) = median(&mut samples.iter().map(off).collect::<Vec<_>>()) else { return 1.0 };
        let count = samples.len();
        samples.retain(|sample| off(sample) <= MOST_OFF * usual);
        if samples.len() == count {
            break;
        }
    }
    let (Some(smooth), Some(free)) = (fit(&samples), samples.len().checked_sub(TERMS + 1)) else {
        return 1.0;
    };
    let squared = |sample: &Sample| {
        let off = sample.residual_px - dot(&smooth, &sample.terms);
        off * off / sample.variance_px2
    };
    let scale = samples.iter().map(squared).sum::<f64>() / (free + 1) as f64;
    let chance = SURE * sqrt(2.0 / (free + 1) as f64);
    if scale > 0.0 && abs(scale - 1.0) > chance { scale.clamp(1.0 / MOST, MOST) } else { 1.0 }
}

/// One marker of the rest frame.
struct Sample {
    terms: [f64; TERMS],
    residual_px: f64,
    variance_px2: f64,
}

/// Products of Chebyshev's polynomials up to the order, for coordinates from -1 to 1.
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

/// Least squares; `None` where the samples leave a term open.
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

    /// Residuals of centres that are `factor` times as noisy as they state, with what a poor calibration leaves.
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
        let (positions_px, covariance_px2) =
            ([DVec2::ZERO; MARKERS], [[[STATED_PX2, 0.0], [0.0, STATED_PX2]]; MARKERS]);
        let centres = Centres { positions_px: &positions_px, covariance_px2: &covariance_px2 };
        noise_scale((SIDE, SIDE), &stereo, state, centres, centres)
    }

    proptest! {
        /// The mean of 610 squares is known to 6 %; five times that is believed.
        #[test]
        fn the_noise_is_found_whatever_the_calibration_leaves(
            seed in any::<u64>(),
            log_factor in -5.0..3.0_f64,
            calibration_px in -2.0..2.0_f64,
        ) {
            let factor = crate::math::exp(log_factor);
            prop_assume!(!(0.6..1.6).contains(&factor));
            let scale = scale_of(&residuals_px(seed, factor, calibration_px), &[MarkerState::Seen; MARKERS]);
            prop_assert!((0.7..1.3).contains(&(scale / factor)), "{scale} for {factor}");
        }

        #[test]
        fn noise_as_stated_changes_no_bit(seed in any::<u64>(), calibration_px in -2.0..2.0_f64) {
            let scale = scale_of(&residuals_px(seed, 1.0, calibration_px), &[MarkerState::Seen; MARKERS]);
            prop_assert_eq!(scale, 1.0);
        }

        /// Markers under a glint, and those that are not seen, do not count.
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
            prop_assert!((0.7..1.3).contains(&scale), "{scale}");
        }
    }

    #[test]
    fn a_few_markers_say_nothing() {
        let mut state = [MarkerState::Held; MARKERS];
        state[..TERMS].fill(MarkerState::Seen);
        assert_eq!(scale_of(&[0.3; MARKERS], &state), 1.0);
    }
}
