//! Uneven illumination.

use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use alloc::vec::Vec;
use gelstereo_core::camera::Camera;
use gelstereo_core::math::DVec2;

/// Illumination that falls off from one side to the other and towards the corners: a gain on every
/// pixel, the same in both views. `{ gain = 0.35, across = 0, down = 0, corner_loss = 0 }` is 35 % of
/// the light everywhere.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct UnevenLight {
    /// Gain at the image's centre. The other three settings are relative to it. Default: `1`.
    pub gain: f64,
    /// Change of the gain from the left edge to the right one. Default: `0.15`.
    pub across: f64,
    /// Change of the gain from the top edge to the bottom one. Default: `-0.1`.
    pub down: f64,
    /// Loss at the corners, growing with the square of the distance from the centre. Default: `0.25`.
    pub corner_loss: f64,
}

impl Default for UnevenLight {
    fn default() -> Self {
        Self { gain: 1.0, across: 0.15, down: -0.1, corner_loss: 0.25 }
    }
}

impl Effect for UnevenLight {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let gain = self.gain;
        SceneError::check((0.0..=10.0).contains(&gain), "effects.uneven_light.gain", gain, "0 to 10")?;
        let settings = [
            ("effects.uneven_light.across", self.across),
            ("effects.uneven_light.down", self.down),
            ("effects.uneven_light.corner_loss", self.corner_loss),
        ];
        settings.into_iter().try_for_each(|(name, found)| {
            SceneError::check((-1.0..=1.0).contains(&found), name, found, "-1 to 1")
        })
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        let (min_gain, max_gain) = self.span();
        Bound::of_levels(
            (1.0 - min_gain).max(max_gain - 1.0).max(0.0)
                * (f64::from(facts.scene.gel.bright_level) + facts.grain_levels()),
        )
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        0.4 * facts.pixels()
    }
}

impl UnevenLight {
    /// Smallest and largest gain over any image: a parabola along each axis.
    pub(crate) fn span(&self) -> (f64, f64) {
        let along = |slope: f64| {
            let loss = 2.0 * self.corner_loss;
            let at = |x: f64| slope * x - loss * x * x;
            let top = if loss == 0.0 { 0.0 } else { (0.5 * slope / loss).clamp(-0.5, 0.5) };
            let [a, b, c] = [at(-0.5), at(0.5), at(top)];
            (a.min(b).min(c), a.max(b).max(c))
        };
        let ((left, right), (top, bottom)) = (along(self.across), along(self.down));
        let gain = |share: f64| (self.gain * (1.0 + share)).max(0.0);
        (gain(left + top), gain(right + bottom))
    }

    /// The gain at a pixel of an image of this size.
    pub(crate) fn gain(&self, at: DVec2, size: DVec2) -> f64 {
        let DVec2 { x, y } = (at + 0.5) / size - 0.5;
        // x² + y² is 1/2 in the corners.
        let share = 1.0 + self.across * x + self.down * y - self.corner_loss * 2.0 * (x * x + y * y);
        (self.gain * share).max(0.0)
    }

    /// Gradient of the gain's logarithm at a pixel, per px; 0 where there is no light.
    pub(crate) fn growth(&self, at: DVec2, size: DVec2) -> DVec2 {
        let gain = self.gain(at, size);
        if gain <= 0.0 {
            return DVec2::ZERO;
        }
        let place = (at + 0.5) / size - 0.5;
        let slope = DVec2::new(self.across, self.down) - place * (4.0 * self.corner_loss);
        slope * (self.gain / gain) / size
    }
}

/// The gain of every pixel of a view, as the sum of a column term and a row term.
#[derive(Clone, Debug)]
pub(crate) struct Gain {
    columns: Vec<f32>,
    rows: Vec<f32>,
}

impl Gain {
    pub(crate) fn new(light: &UnevenLight, camera: &Camera) -> Self {
        let places = |side: usize| (0..side).map(move |k| (k as f64 + 0.5) / side as f64 - 0.5);
        let bend = -2.0 * light.corner_loss;
        let column = |x: f64| (light.gain * x * (light.across + bend * x)) as f32;
        let row = |y: f64| (light.gain * (1.0 + y * (light.down + bend * y))) as f32;
        Self {
            columns: places(camera.width_px).map(column).collect(),
            rows: places(camera.height_px).map(row).collect(),
        }
    }

    /// The term of a row, and those of the columns.
    pub(crate) fn of_row(&self, y: usize) -> (f32, &[f32]) {
        (self.rows[y], &self.columns)
    }

    /// Gain of a pixel with these terms.
    #[inline(always)]
    pub(crate) fn of(row: f32, column: f32) -> f32 {
        let gain = column + row;
        if gain > 0.0 { gain } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gelstereo_core::math::{abs, ln};
    use proptest::prelude::*;

    proptest! {
        /// The growth is the slope of the gain's logarithm, by central differences.
        #[test]
        fn growth_is_the_slope_of_the_gain(
            across in -0.3..0.3_f64, down in -0.3..0.3_f64, corner_loss in -0.3..0.3_f64,
            at in (0.0..639.0_f64, 0.0..479.0_f64),
        ) {
            let light = UnevenLight { gain: 0.9, across, down, corner_loss };
            let (at, size) = (DVec2::new(at.0, at.1), DVec2::new(640.0, 480.0));
            let log = |by: DVec2| ln(light.gain(at + by, size));
            let growth = light.growth(at, size);
            for (axis, along) in [(DVec2::X, growth.x), (DVec2::Y, growth.y)] {
                let slope = 0.5 * (log(axis) - log(-axis));
                // The third derivative over 6: at most 2 (1.5 / 480)³ where the gain is above a half.
                prop_assume!(light.gain(at, size) > 0.5);
                prop_assert!(abs(slope - along) < 1e-7, "{slope} {along}");
            }
        }
    }
}
