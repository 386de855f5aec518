//! Photon shot noise.

use super::noise::{QUANTILES, quantile_of, quantiles_of};
use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use alloc::boxed::Box;
use alloc::sync::Arc;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::{random::Stream, sqrt};

/// Photon shot noise: noise of every pixel of every frame whose variance is proportional to its level.
///
/// Level 255 is a full pixel. Electron counts are Poisson distributed, so the variance in levels is 255
/// · level / `full_well_electrons` (EMVA 1288, photon transfer). Limit: drawn from the normal
/// distribution, which is accurate from some 20 electrons on.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct ShotNoise {
    /// Number of electrons at level 255. Default: `10000`, 2.1 levels of noise at level 170.
    pub full_well_electrons: f64,
}

impl Default for ShotNoise {
    fn default() -> Self {
        Self { full_well_electrons: 10_000.0 }
    }
}

impl ShotNoise {
    fn sigma_levels(&self, level: f64) -> f64 {
        sqrt(255.0 * level / self.full_well_electrons)
    }

    /// Largest noise at a level: that of the outermost of 4096 quantiles.
    pub(crate) fn most_levels(&self, level: f64) -> f64 {
        f64::from(quantile_of(QUANTILES - 1, 1.0)) * self.sigma_levels(level)
    }
}

impl Effect for ShotNoise {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let found = self.full_well_electrons;
        let name = "effects.shot_noise.full_well_electrons";
        SceneError::check((255.0..=1e9).contains(&found), name, found, "255 to 1e9 electrons")
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        let brightest =
            if facts.scene.effects.smears.is_some() { 255.0 } else { facts.levels()[1].clamp(0.0, 255.0) };
        // Half a level more because the noise is looked up by rounded level.
        Bound::of_levels(self.most_levels(brightest + 0.5))
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        5.7 * facts.pixels()
    }
}

/// Precomputed tables.
#[derive(Clone, Debug)]
pub(crate) struct Shots {
    seed: u64,
    /// Of unit variance.
    quantiles: Arc<[f32; QUANTILES]>,
    /// By level.
    sigma_levels: Box<[f32; 256]>,
}

impl Shots {
    /// Takes the quantiles, which are the same for every scene, from `before`.
    pub(crate) fn new(noise: &ShotNoise, seed: u64, before: Option<&Self>) -> Self {
        Self {
            seed,
            quantiles: before.map_or_else(|| quantiles_of(1.0).into(), |before| before.quantiles.clone()),
            sigma_levels: Box::new(core::array::from_fn(|level| noise.sigma_levels(level as f64) as f32)),
        }
    }

    /// Random stream of one view (by name) of one frame.
    pub(crate) fn stream(&self, view: &str, frame: u64) -> Stream {
        Stream::new(Digest::new().u64(self.seed).u64(frame).bytes(view.as_bytes()).value(), "shot_noise")
    }

    /// Adds noise to the next row.
    pub(crate) fn add(&self, stream: &mut Stream, row: &mut [f32]) {
        for pixels in row.chunks_mut(5) {
            let mut bits = stream.next_u64();
            for pixel in pixels {
                // To the nearest level; `as` clamps to 0 and 255.
                let sigma = self.sigma_levels[usize::from((*pixel + 0.5) as u8)];
                *pixel += sigma * self.quantiles[bits as usize % QUANTILES];
                bits >>= 12;
            }
        }
    }
}
