//! Grain of the paint.

use super::{Blur, Defocus};
use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use alloc::sync::Arc;
use alloc::vec::Vec;
use gelstereo_core::camera::Camera;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::random::Stream;

/// Speckle of the painted surface, drawn once per view: the same in every frame of a sequence.
///
/// Limit: it is static in the image while the gel moves, and the two views' grains are independent.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Grain {
    /// Standard deviation in grey levels. Default: `3`.
    pub sigma_levels: f64,
    /// Standard deviation of the Gaussian that correlates neighbouring pixels. Default: `1` px.
    pub size_px: f64,
}

impl Default for Grain {
    fn default() -> Self {
        Self { sigma_levels: 3.0, size_px: 1.0 }
    }
}

impl Effect for Grain {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let (sigma, size) = (self.sigma_levels, self.size_px);
        let name = "effects.grain.sigma_levels";
        SceneError::check((0.0..=128.0).contains(&sigma), name, sigma, "0 to 128 grey levels")?;
        SceneError::check((0.1..=20.0).contains(&size), "effects.grain.size_px", size, "0.1 to 20 px")
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        Bound::of_levels(self.most_levels() * facts.gain())
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        0.01 * facts.pixels()
    }
}

impl Grain {
    /// Upper bound: the blur's weights sum to 1, so no pixel exceeds the largest number that
    /// [`Stream::normal`] can draw, sqrt(2 ln 2^53).
    pub(crate) fn most_levels(&self) -> f64 {
        const LARGEST: f64 = 8.572;
        LARGEST * self.sigma_levels
            / f64::from(Blur::new(&Defocus { sigma_px: self.size_px }).remaining_sigma())
    }
}

/// The grain of one view.
#[derive(Debug)]
pub(crate) struct Texture {
    settings: Grain,
    seed: u64,
    size: [usize; 2],
    levels: Vec<f32>,
}

impl Texture {
    /// That of `before`, which is of the same view, if it has the same settings.
    pub(crate) fn shared(
        grain: &Grain,
        seed: u64,
        (view, camera): (&str, &Camera),
        before: Option<&Arc<Self>>,
    ) -> Arc<Self> {
        let size = [camera.width_px, camera.height_px];
        let same = |before: &&Arc<Self>| (&before.settings, before.seed, before.size) == (grain, seed, size);
        before.filter(same).cloned().unwrap_or_else(|| Arc::new(Self::new(grain, seed, view, camera)))
    }

    fn new(grain: &Grain, seed: u64, view: &str, camera: &Camera) -> Self {
        let mut stream = Stream::new(Digest::new().u64(seed).bytes(view.as_bytes()).value(), "grain");
        let (w, h) = (camera.width_px, camera.height_px);
        let mut levels: Vec<f32> = (0..w * h).map(|_| stream.normal() as f32).collect();
        let defocus = Defocus { sigma_px: grain.size_px };
        let mut blur = Blur::new(&defocus);
        blur.apply(&mut levels, w);
        let gain = grain.sigma_levels as f32 / blur.remaining_sigma();
        levels.iter_mut().for_each(|v| *v *= gain);
        Self { settings: grain.clone(), seed, size: [w, h], levels }
    }

    /// Adds the grain to the view's levels.
    pub(crate) fn apply(&self, levels: &mut [f32]) {
        levels.iter_mut().zip(&self.levels).for_each(|(level, grain)| *level += grain);
    }
}
