//! Onset of a touch: the position at which the marker motion begins to grow.
//!
//! The trigger fires later, when the part has dragged the gel by some tenths of a millimetre. The motion
//! grows with the travel after the first touch. A line through the frames up to the trigger therefore
//! meets the previous motion level at the position of the touch.

use gelstereo_core::math::sqrt;

/// A frame of the slow move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// Travel of the hand since the move began.
    pub(super) travel_mm: f64,
    /// Mean marker motion.
    pub(super) motion_px: f64,
}

/// Position of the first touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Onset {
    /// Travel of the hand at the touch.
    pub(super) travel_mm: f64,
    /// Its standard deviation from the fit alone.
    pub(super) sigma_mm: f64,
}

/// Least number of frames for the level before the touch. With fewer, the part may have touched before
/// the move.
const MIN_QUIET: usize = 3;
/// Fraction of the motion at the trigger above which a frame belongs to the line. Below it, marker noise
/// adds to the motion lengths of the drag.
const RAMP_SHARE: f64 = 0.1;

/// First touch of a move that a trigger ended at the last sample; `None` if the move did not start quietly.
pub(super) fn onset(samples: &[Sample]) -> Option<Onset> {
    let last = samples.last()?;
    let first = samples.first()?;
    let threshold_px = first.motion_px + RAMP_SHARE * (last.motion_px - first.motion_px);
    let ramp = samples.iter().rev().take_while(|sample| sample.motion_px >= threshold_px).count();
    let (quiet, ramp) = samples.split_at(samples.len() - ramp);
    // The frame before the line may already show up to this fraction of the motion.
    let (before, quiet) = quiet.split_last()?;
    if quiet.len() < MIN_QUIET {
        return None;
    }
    let level_px = quiet.iter().map(|sample| sample.motion_px).sum::<f64>() / quiet.len() as f64;
    line_onset(ramp, level_px).or_else(|| {
        let gap_mm = ramp.first()?.travel_mm - before.travel_mm;
        Some(Onset { travel_mm: before.travel_mm + 0.5 * gap_mm, sigma_mm: gap_mm / sqrt(12.0) })
    })
}

/// Intersection of the line with the level; `None` for fewer than three frames, which leave no residual.
fn line_onset(ramp: &[Sample], level_px: f64) -> Option<Onset> {
    if ramp.len() < 3 {
        return None;
    }
    let count = ramp.len() as f64;
    let mean_mm = ramp.iter().map(|sample| sample.travel_mm).sum::<f64>() / count;
    let mean_px = ramp.iter().map(|sample| sample.motion_px).sum::<f64>() / count;
    let spread = ramp.iter().map(|sample| (sample.travel_mm - mean_mm).powi(2)).sum::<f64>();
    let joint =
        ramp.iter().map(|sample| (sample.travel_mm - mean_mm) * (sample.motion_px - mean_px)).sum::<f64>();
    let slope = joint / spread;
    if !(slope > 0.0 && slope.is_finite()) {
        return None;
    }
    let residuals = ramp.iter().map(|sample| {
        let line_px = mean_px + slope * (sample.travel_mm - mean_mm);
        (sample.motion_px - line_px).powi(2)
    });
    let variance_px = residuals.sum::<f64>() / (count - 2.0);
    let back_mm = (mean_px - level_px) / slope;
    // Variance from the line's height and slope (Draper and Smith, Applied Regression Analysis, 3.2).
    let variance_mm = variance_px / (slope * slope) * (1.0 / count + back_mm * back_mm / spread);
    Some(Onset { travel_mm: mean_mm - back_mm, sigma_mm: sqrt(variance_mm) })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use gelstereo_core::math::random::Stream;
    use proptest::prelude::*;

    /// A move with `step_mm` between frames; the motion grows from `at_mm` until the trigger at 5 px.
    fn moved(step_mm: f64, at_mm: f64, slope: f64, noise_px: f64, seed: u64) -> Vec<Sample> {
        let mut stream = Stream::new(seed, "onset");
        let mut samples: Vec<Sample> = Vec::new();
        for k in 1.. {
            let travel_mm = f64::from(k) * step_mm;
            let motion_px = 0.02 + slope * (travel_mm - at_mm).max(0.0) + noise_px * stream.normal();
            samples.push(Sample { travel_mm, motion_px });
            if motion_px >= 5.0 {
                break;
            }
        }
        samples
    }

    /// Of lines through five noisy frames, the mean stated variance is that of the positions found. Each
    /// variance has three degrees of freedom; the mean of 4000 is known to 1.3 %, the spread of the positions
    /// to 2.2 %.
    #[test]
    fn a_short_line_knows_how_well_it_is_known() {
        let mut stream = Stream::new(5, "lines");
        let (mut stated, mut squares) = (0.0, 0.0);
        for _ in 0..4000 {
            let sample = |k: i32| Sample {
                travel_mm: 1.0 + 0.03 * f64::from(k),
                motion_px: 0.45 * f64::from(k + 1) + 0.01 * stream.normal(),
            };
            let found = line_onset(&(0..5).map(sample).collect::<Vec<_>>(), 0.0).unwrap();
            stated += found.sigma_mm * found.sigma_mm;
            squares += (found.travel_mm - 0.97) * (found.travel_mm - 0.97);
        }
        assert!((stated / squares - 1.0).abs() < 4.0 * 0.026, "{}", stated / squares);
    }

    proptest! {
        #[test]
        fn the_touch_is_found_within_its_own_sigmas(
            step_mm in 0.01..0.05_f64, at_mm in 0.5..2.0_f64, slope in 8.0..20.0_f64, seed in 0..1000_u64,
        ) {
            let found = onset(&moved(step_mm, at_mm, slope, 0.01, seed)).unwrap();
            // The residual of a few frames is inaccurate: 0.002 mm is twice the noise over the slope.
            prop_assert!((found.travel_mm - at_mm).abs() < 6.0 * found.sigma_mm + 2e-3, "{found:?} {at_mm}");
            prop_assert!(found.sigma_mm < 5e-3, "{found:?}");
        }
    }

    /// The trigger itself is late by the compliance of the gel.
    #[test]
    fn the_line_is_far_better_than_the_trigger() {
        let samples = moved(0.033, 1.0, 15.0, 0.01, 1);
        let found = onset(&samples).unwrap();
        assert!((found.travel_mm - 1.0).abs() < 5e-3, "{found:?}");
        assert!(samples.last().unwrap().travel_mm > 1.3);
    }

    #[test]
    fn a_fast_move_leaves_the_way_between_two_frames() {
        let found = onset(&moved(0.4, 1.7, 15.0, 0.01, 1)).unwrap();
        assert!((found.travel_mm - 1.7).abs() < 0.4 && found.sigma_mm > 0.1, "{found:?}");
    }

    #[test]
    fn a_part_that_touched_from_the_beginning_has_no_onset() {
        assert_eq!(onset(&moved(0.033, 0.0, 15.0, 0.01, 1)), None);
        assert_eq!(onset(&moved(0.033, 0.08, 15.0, 0.01, 1)), None);
        assert_eq!(onset(&[]), None);
    }
}
