//! Noise of the image sensor.

use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use alloc::boxed::Box;
use alloc::vec::Vec;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::{erf, exp, random::Stream, sqrt};

/// Gaussian noise of every pixel of every frame, independent of its brightness.
///
/// Drawn from 4096 equally likely values (the normal distribution's quantiles, scaled to unit variance), five
/// to a random number; they end at 3.7 standard deviations. The 8-bit rounding that follows adds a variance of
/// 1/12.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct SensorNoise {
    /// Standard deviation in grey levels. Default: `2`.
    pub sigma_levels: f64,
}

impl Default for SensorNoise {
    fn default() -> Self {
        Self { sigma_levels: 2.0 }
    }
}

impl Effect for SensorNoise {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let sigma = self.sigma_levels;
        let name = "effects.sensor_noise.sigma_levels";
        SceneError::check((0.0..=128.0).contains(&sigma), name, sigma, "0 to 128 grey levels")
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        let _ = facts;
        let most = Noise::new(self, 0).quantiles.iter().fold(0.0_f32, |most, q| most.max(q.abs()));
        Bound::of_levels(f64::from(most))
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        2.0 * facts.pixels()
    }
}

pub(super) const QUANTILES: usize = 4096;

/// Ready-made quantiles.
#[derive(Clone, Debug)]
pub(crate) struct Noise {
    seed: u64,
    quantiles: Box<[f32; QUANTILES]>,
}

/// The normal distribution's quantiles, scaled to that standard deviation.
pub(super) fn quantiles_of(sigma: f64) -> Box<[f32; QUANTILES]> {
    let quantiles: Vec<f64> =
        (0..QUANTILES).map(|i| normal_quantile((i as f64 + 0.5) / QUANTILES as f64)).collect();
    let variance = quantiles.iter().map(|q| q * q).sum::<f64>() / QUANTILES as f64;
    let scale = sigma / sqrt(variance);
    Box::new(core::array::from_fn(|i| (quantiles[i] * scale) as f32))
}

impl Noise {
    pub(crate) fn new(noise: &SensorNoise, seed: u64) -> Self {
        Self { seed, quantiles: quantiles_of(noise.sigma_levels) }
    }

    /// Of one view (by name) of one frame.
    pub(crate) fn stream(&self, view: &str, frame: u64) -> Stream {
        let key = Digest::new().u64(self.seed).u64(frame).bytes(view.as_bytes()).value();
        Stream::new(key, "sensor_noise")
    }

    /// Adds the noise of the next row.
    pub(crate) fn add(&self, stream: &mut Stream, row: &mut [f32]) {
        let (fives, rest) = row.as_chunks_mut::<5>();
        for pixels in fives {
            self.add_few(stream.next_u64(), pixels);
        }
        if !rest.is_empty() {
            self.add_few(stream.next_u64(), rest);
        }
    }

    fn add_few(&self, mut bits: u64, pixels: &mut [f32]) {
        for pixel in pixels {
            *pixel += self.quantiles[bits as usize % QUANTILES];
            bits >>= 12;
        }
    }
}

/// Inverse of the standard normal distribution, by Newton's method from 0. The distribution function is concave
/// above 0 and convex below, so the steps overshoot nowhere and always arrive.
fn normal_quantile(probability: f64) -> f64 {
    let mut x = 0.0;
    for _ in 0..64 {
        let excess = 0.5 * erf(x / core::f64::consts::SQRT_2) + 0.5 - probability;
        let density = exp(-0.5 * x * x) / sqrt(core::f64::consts::TAU);
        let step = excess / density;
        x -= step;
        if step.abs() < 1e-13 {
            break;
        }
    }
    x
}
