//! Motion blur during the exposure.

use crate::plan::{Bound, Effect, Facts};
use crate::render::Shutter;
use crate::scene::{Gel, SceneError};

/// Mean image over the exposure, half of it before the frame's time and half after it: moving dots are
/// smeared along their path.
///
/// Model: each dot keeps its shape. It moves straight from its place when the shutter opens to its place
/// when the shutter closes, with its place at the frame's time in the middle. Its image's centroid is
/// therefore that of the frame's time. A contact off the trajectory moves as the trajectory's part does
/// at that time. Limits: a curved path within the exposure would shift the centroid by a 24th of
/// acceleration times exposure squared; grain is static.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct MotionBlur {
    /// Exposure time. Default: `0.01` s.
    pub exposure_s: f64,
}

impl Default for MotionBlur {
    fn default() -> Self {
        Self { exposure_s: 0.01 }
    }
}

impl Effect for MotionBlur {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let found = self.exposure_s;
        SceneError::check(
            (1e-6..=1.0).contains(&found),
            "effects.motion_blur.exposure_s",
            found,
            "1e-6 to 1 s",
        )
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        let px = facts.passed_px(self.exposure_s);
        // A dot that moves by d enters or leaves at most √2 d of a pixel's area (a pixel is at most √2
        // wide). This is the mean over d from 0 to half the path, for two dots, the most that share a
        // pixel.
        let share = px * core::f64::consts::FRAC_1_SQRT_2;
        Bound::of_levels(facts.contrast_levels() * share.min(1.0))
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        let effects = &facts.scene.effects;
        let layer = effects.elastic_layer.as_ref().map_or(0.0, |effect| effect.cost_ns(facts));
        let beside = [
            effects.shoulder.as_ref().map(|effect| effect.cost_ns(facts)),
            effects.spread.as_ref().map(|effect| effect.cost_ns(facts)),
            effects.drag.as_ref().map(|effect| effect.cost_ns(facts)),
        ];
        let field = 100.0 * facts.markers() + layer + beside.into_iter().flatten().sum::<f64>();
        // Fields at both ends of the exposure, and several copies of every dot depending on its path.
        let sigma_px = effects.defocus.as_ref().map(|defocus| defocus.sigma_px);
        let times = Shutter::times(facts.followed_px(self.exposure_s), sigma_px);
        2.0 * field + 2600.0 * facts.markers() * (times as f64 - 1.0)
    }
}
