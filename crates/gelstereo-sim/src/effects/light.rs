//! Uneven light.

use crate::plan::{Bound, Effect, Facts};
use crate::render::rows_of;
use crate::scene::{Gel, SceneError};
use alloc::vec::Vec;
use gelstereo_core::camera::Camera;
use gelstereo_core::math::DVec2;

/// Light that falls off from one side to the other and towards the corners: a gain on every pixel, the same in
/// both views. `{ gain = 0.35, across = 0, down = 0, corner_loss = 0 }` is 35 % of the light everywhere.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct UnevenLight {
    /// Gain at the image's centre, which the other three are shares of. Default: `1`.
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
        let (least, most) = self.span();
        Bound::of_levels(
            (1.0 - least).max(most - 1.0).max(0.0)
                * (f64::from(facts.scene.gel.bright_level) + facts.grain_levels()),
        )
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        5.0 * facts.pixels() * facts.fineness()
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

    /// The gain at a pixel of an image of that size.
    pub(crate) fn gain(&self, at: DVec2, size: DVec2) -> f64 {
        let DVec2 { x, y } = (at + 0.5) / size - 0.5;
        // x² + y² is 1/2 in the corners.
        let share = 1.0 + self.across * x + self.down * y - self.corner_loss * 2.0 * (x * x + y * y);
        (self.gain * share).max(0.0)
    }
}

/// The gain of every pixel of a view.
#[derive(Clone, Debug)]
pub(crate) struct Gain(Vec<f32>);

impl Gain {
    pub(crate) fn new(light: &UnevenLight, camera: &Camera) -> Self {
        let (w, h) = (camera.width_px, camera.height_px);
        let size = DVec2::new(w as f64, h as f64);
        let gain = |row, col| light.gain(DVec2::new(col as f64, row as f64), size) as f32;
        let gain = &gain;
        Self((0..h).flat_map(|row| (0..w).map(move |col| gain(row, col))).collect())
    }

    /// On a canvas whose pixels are so many `times` as narrow as the view's.
    pub(crate) fn apply(&self, canvas: &mut [f32], width: usize, times: usize) {
        for (row, gains) in rows_of(canvas, &self.0, width, times) {
            for (pixels, gain) in row.chunks_exact_mut(times).zip(gains) {
                pixels.iter_mut().for_each(|pixel| *pixel *= gain);
            }
        }
    }
}
