//! Noise of the mean marker motion at rest.

use serde::Serialize;

/// Frames for a relative standard error of the scale of one fifth. The median absolute deviation has 37 %
/// of the efficiency of the standard deviation on normal noise: 1 / (2 * 0.37 * 0.2²) = 34 frames.
pub(crate) const FRAMES: usize = 34;
/// Standard deviation of a normal distribution divided by its median absolute deviation.
const NORMAL_MAD: f64 = 1.4826;
/// Mean marker motion relative to the rest frame, with nothing touching the gel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct RestNoise {
    /// Median; not zero, because lengths of motions are positive.
    pub(crate) level_px: f64,
    /// Robust standard deviation.
    pub(crate) sigma_px: f64,
    pub(crate) frames: usize,
}

impl RestNoise {
    pub(crate) fn of(mut motions_px: Vec<f64>) -> Self {
        let frames = motions_px.len();
        let level_px = median(&mut motions_px);
        let mut deviations: Vec<f64> = motions_px.iter().map(|motion| (motion - level_px).abs()).collect();
        Self { level_px, sigma_px: NORMAL_MAD * median(&mut deviations), frames }
    }

    /// Motion this many sigmas above the level.
    pub(crate) fn at(&self, sigmas: f64) -> f64 {
        self.level_px + sigmas * self.sigma_px
    }

    /// How far a motion is above the level, in standard deviations; `None` without noise.
    pub(crate) fn sigmas(&self, motion_px: f64) -> Option<f64> {
        (self.sigma_px > 0.0).then(|| (motion_px - self.level_px) / self.sigma_px)
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}
