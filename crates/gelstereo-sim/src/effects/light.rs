//! Uneven light.

use crate::scene::SceneError;
use alloc::vec::Vec;
use gelstereo_core::camera::Camera;

/// Light that falls off from one side to the other and towards the corners: a gain on every pixel, the same in
/// both views, 1 at the image's centre.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct UnevenLight {
    /// Change of the gain from the left edge to the right one. Default: `0.15`.
    pub across: f64,
    /// Change of the gain from the top edge to the bottom one. Default: `-0.1`.
    pub down: f64,
    /// Loss at the corners, growing with the square of the distance from the centre. Default: `0.25`.
    pub corner_loss: f64,
}

impl Default for UnevenLight {
    fn default() -> Self {
        Self { across: 0.15, down: -0.1, corner_loss: 0.25 }
    }
}

impl UnevenLight {
    pub(super) fn validate(&self) -> Result<(), SceneError> {
        let settings = [
            ("effects.uneven_light.across", self.across),
            ("effects.uneven_light.down", self.down),
            ("effects.uneven_light.corner_loss", self.corner_loss),
        ];
        settings.into_iter().try_for_each(|(name, found)| {
            SceneError::check((-1.0..=1.0).contains(&found), name, found, "-1 to 1")
        })
    }
}

/// The gain of every pixel of a view.
#[derive(Clone, Debug)]
pub(crate) struct Gain(Vec<f32>);

impl Gain {
    pub(crate) fn new(light: &UnevenLight, camera: &Camera) -> Self {
        let (w, h) = (camera.width_px, camera.height_px);
        let from_centre = |i: usize, n: usize| (i as f64 + 0.5) / n as f64 - 0.5;
        let gain = |row, col| {
            let (x, y) = (from_centre(col, w), from_centre(row, h));
            // x² + y² is 1/2 in the corners.
            1.0 + light.across * x + light.down * y - light.corner_loss * 2.0 * (x * x + y * y)
        };
        let gain = &gain;
        Self((0..h).flat_map(|row| (0..w).map(move |col| gain(row, col).max(0.0) as f32)).collect())
    }

    pub(crate) fn apply(&self, image: &mut [f32]) {
        for (pixel, &gain) in image.iter_mut().zip(&self.0) {
            *pixel *= gain;
        }
    }
}
