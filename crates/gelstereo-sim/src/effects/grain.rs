//! Grain of the paint.

use crate::scene::SceneError;
use alloc::vec::Vec;
use gelstereo_core::camera::Camera;
use gelstereo_core::math::{exp, random::Stream, sqrt};

/// Speckle of the painted surface: the same in every frame of a sequence, drawn once for each view.
///
/// Limit: it stands still in the image while the gel moves below it, and the two views' grains are independent.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Grain {
    /// Standard deviation in grey levels. Default: `3`.
    pub sigma_levels: f64,
    /// Standard deviation of the Gaussian that makes neighbouring pixels alike. Default: `1` px.
    pub size_px: f64,
}

impl Default for Grain {
    fn default() -> Self {
        Self { sigma_levels: 3.0, size_px: 1.0 }
    }
}

impl Grain {
    pub(super) fn validate(&self) -> Result<(), SceneError> {
        let (sigma, size) = (self.sigma_levels, self.size_px);
        let name = "effects.grain.sigma_levels";
        SceneError::check((0.0..=128.0).contains(&sigma), name, sigma, "0 to 128 grey levels")?;
        SceneError::check((0.1..=20.0).contains(&size), "effects.grain.size_px", size, "0.1 to 20 px")
    }
}

/// The grain of one view.
#[derive(Clone, Debug)]
pub(crate) struct Texture(Vec<f32>);

impl Texture {
    pub(crate) fn new(grain: &Grain, seed: u64, view: &str, camera: &Camera) -> Self {
        let mut stream = Stream::new(seed, view);
        let (w, h) = (camera.width_px, camera.height_px);
        let mut levels: Vec<f32> = (0..w * h).map(|_| stream.normal() as f32).collect();
        let defocus = super::Defocus { sigma_px: grain.size_px };
        super::Blur::new(&defocus).apply(&mut levels, w);
        let gain = (grain.sigma_levels / remaining_sigma(grain.size_px)) as f32;
        levels.iter_mut().for_each(|v| *v *= gain);
        Self(levels)
    }

    pub(crate) fn apply(&self, image: &mut [f32]) {
        for (pixel, &grain) in image.iter_mut().zip(&self.0) {
            *pixel += grain;
        }
    }
}

/// Standard deviation that white noise of unit variance keeps under a sampled Gaussian, which is the root of the sum of the
/// squared weights along one axis, squared for two.
fn remaining_sigma(sigma: f64) -> f64 {
    let (mut sum, mut squares) = (0.0, 0.0);
    for k in -80..=80 {
        let weight = exp(-0.5 * f64::from(k * k) / (sigma * sigma));
        sum += weight;
        squares += weight * weight;
    }
    sqrt(squares) * sqrt(squares) / (sum * sum)
}
