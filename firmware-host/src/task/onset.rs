//! Where on its way a part first touched: the place where the marker motion begins to grow.
//!
//! The trigger acts later, when the part has dragged the gel for some tenths of a millimetre. From the
//! first touch on the motion grows with the way, so that a line through the frames from there to the
//! trigger meets the motion before it at the place of the touch.

use gelstereo_core::math::sqrt;

/// A frame of the slow move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// Way of the hand since the move began.
    pub(super) travel_mm: f64,
    /// Mean marker motion.
    pub(super) motion_px: f64,
}

/// The place of the first touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Onset {
    /// Way of the hand until then.
    pub(super) travel_mm: f64,
    /// Standard deviation of that, by the fit alone.
    pub(super) sigma_mm: f64,
}

/// Frames before the touch that tell its level: fewer, and the part may have touched before the move began.
const MIN_QUIET: usize = 3;
/// Share of the motion at the trigger from which a frame belongs to the line. Below, lengths of motions of
/// the markers' noise add to those of the drag.
const RAMP_SHARE: f64 = 0.1;

/// The first touch of a move that a trigger ended, which is the last sample; none if the move was not quiet
/// at first.
pub(super) fn onset(samples: &[Sample]) -> Option<Onset> {
    let last = samples.last()?;
    let first = samples.first()?;
    let threshold_px = first.motion_px + RAMP_SHARE * (last.motion_px - first.motion_px);
    let ramp = samples.iter().rev().take_while(|sample| sample.motion_px >= threshold_px).count();
    let (quiet, ramp) = samples.split_at(samples.len() - ramp);
    // The frame before the line may show the first tenth of the motion.
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

/// Where the line through the frames meets the level; none of fewer than three, which leave no residual.
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
    // Of the line's height and slope (Draper and Smith, Applied Regression Analysis, 3.2).
    let variance_mm = variance_px / (slope * slope) * (1.0 / count + back_mm * back_mm / spread);
    Some(Onset { travel_mm: mean_mm - back_mm, sigma_mm: sqrt(variance_mm) })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use gelstereo_core::math::random::Stream;
    use proptest::prelude::*;

    /// A hand that goes so far between two frames; the motion grows from `at_mm` on until the trigger of 5
    /// px.
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

    proptest! {
        #[test]
        fn the_touch_is_found_within_its_own_sigmas(
            step_mm in 0.01..0.05_f64, at_mm in 0.5..2.0_f64, slope in 8.0..20.0_f64, seed in 0..1000_u64,
        ) {
            let found = onset(&moved(step_mm, at_mm, slope, 0.01, seed)).unwrap();
            // Of few frames the residual is known to a factor of some: 0.002 mm are the noise over the
            // slope, doubled.
            prop_assert!((found.travel_mm - at_mm).abs() < 6.0 * found.sigma_mm + 2e-3, "{found:?} {at_mm}");
            prop_assert!(found.sigma_mm < 5e-3, "{found:?}");
        }
    }

    /// The trigger itself is late by what the gel gives way.
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
