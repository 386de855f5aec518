//! Noise of the image sensor.

use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use alloc::boxed::Box;
use alloc::sync::Arc;
use alloc::vec::Vec;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::{erf, exp, random::Stream, sqrt};

/// Gaussian noise of every pixel of every frame, independent of its brightness.
///
/// Each value is the sum of two draws from 4096 equally likely values (quantiles of the normal
/// distribution), limited to 5.2 standard deviations. Eight pixels at a time take two runs of values
/// from random positions. The values are ordered so that those of a run are uncorrelated, and so are
/// their squares. The 8-bit rounding that follows adds a variance of 1/12.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct SensorNoise {
    /// Standard deviation in grey levels. Valid: 0 to 128 grey levels. Default: `2`. Change it to the camera
    /// that is simulated.
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
        Bound::of_levels(2.0 * f64::from(quantile_of(QUANTILES - 1, self.sigma_levels * HALF_SIGMA)))
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        0.75 * facts.pixels()
    }
}

pub(super) const QUANTILES: usize = 4096;

/// Pixels that share a run of quantiles.
pub(crate) const RUN: usize = 8;

/// Standard deviation of each of two values whose sum has 1.
const HALF_SIGMA: f64 = core::f64::consts::FRAC_1_SQRT_2;

/// Precomputed quantiles, ordered so that a run may start anywhere; the first ones are repeated at the
/// end.
#[derive(Clone, Debug)]
pub(crate) struct Noise {
    seed: u64,
    /// The quantiles of unit variance in that order, the same for every scene.
    order: Arc<[f32]>,
    round: Box<[f32; QUANTILES + RUN]>,
}

/// Mean square of the standard normal quantiles at the middles of 4096 intervals of equal probability.
const VARIANCE: f64 = 0.999_679_447_677_845_7;

/// Quantiles of the normal distribution, scaled to this standard deviation.
pub(super) fn quantiles_of(sigma: f64) -> Box<[f32; QUANTILES]> {
    Box::new(core::array::from_fn(|i| quantile_of(i, sigma)))
}

/// One of [`quantiles_of`].
pub(super) fn quantile_of(index: usize, sigma: f64) -> f32 {
    (standard_quantile(index) * (sigma / sqrt(VARIANCE))) as f32
}

fn standard_quantile(index: usize) -> f64 {
    normal_quantile((index as f64 + 0.5) / QUANTILES as f64)
}

impl Noise {
    /// Takes the order, which is laborious to find, from `before`.
    pub(crate) fn new(noise: &SensorNoise, seed: u64, before: Option<&Self>) -> Self {
        let order = before.map_or_else(|| uncorrelated(&quantiles_of(1.0)).into(), |b| b.order.clone());
        let scale = noise.sigma_levels * HALF_SIGMA;
        let value = |k: usize| (f64::from(order[k % QUANTILES]) * scale) as f32;
        Self { seed, round: Box::new(core::array::from_fn(value)), order }
    }

    /// Random stream of one view (by name) of one frame.
    pub(crate) fn stream(&self, view: &str, frame: u64) -> Stream {
        let key = Digest::new().u64(self.seed).u64(frame).bytes(view.as_bytes()).value();
        Stream::new(key, "sensor_noise")
    }

    /// Noise of the next two runs of pixels.
    #[inline(always)]
    pub(crate) fn next(&self, stream: &mut Stream) -> [f32; 2 * RUN] {
        let places = stream.next_u64();
        let run = |place: u64| {
            let mut run = [0.0; RUN];
            run.copy_from_slice(&self.round[place as usize % QUANTILES..][..RUN]);
            run
        };
        let [a, b, c, d] = [run(places), run(places >> 12), run(places >> 24), run(places >> 36)];
        core::array::from_fn(|k| if k < RUN { a[k] + b[k] } else { c[k - RUN] + d[k - RUN] })
    }
}

/// Orders the values cyclically so that those less than a run apart are uncorrelated, and so are their
/// squares: a shuffle, then random exchanges that reduce the correlations.
fn uncorrelated(values: &[f32; QUANTILES]) -> Vec<f32> {
    const EXCHANGES: usize = 30_000;
    let mut order = values.to_vec();
    let mut stream = Stream::new(0, "order of the quantiles");
    for k in (1..QUANTILES).rev() {
        order.swap(k, stream.below(k + 1));
    }
    let mut found: [[f64; 2]; RUN - 1] = [[0.0; 2]; RUN - 1];
    for k in 0..QUANTILES {
        add_products(&order, k, 0.5, &mut found); // each pair from both of its ends
    }
    let size = |found: &[[f64; 2]; RUN - 1]| found.as_flattened().iter().map(|sum| sum * sum).sum::<f64>();
    for _ in 0..EXCHANGES {
        let (i, j) = (stream.below(QUANTILES), stream.below(QUANTILES));
        if i.abs_diff(j) < RUN || i.abs_diff(j) > QUANTILES - RUN {
            continue; // their terms overlap
        }
        let mut exchanged = found;
        [i, j].iter().for_each(|&k| add_products(&order, k, -1.0, &mut exchanged));
        order.swap(i, j);
        [i, j].iter().for_each(|&k| add_products(&order, k, 1.0, &mut exchanged));
        if size(&exchanged) < size(&found) {
            found = exchanged;
        } else {
            order.swap(i, j);
        }
    }
    order
}

/// Adds `times` the contribution of one value to the correlations at every distance: of the values, and
/// of their squares' excess over 1.
fn add_products(order: &[f32], k: usize, times: f64, sums: &mut [[f64; 2]; RUN - 1]) {
    let pair = |k: usize| {
        let value = f64::from(order[k % QUANTILES]);
        [value, value * value - 1.0]
    };
    let own = pair(k);
    for (apart, sums) in (1..).zip(sums) {
        let (before, after) = (pair(k + QUANTILES - apart), pair(k + apart));
        for (m, sum) in sums.iter_mut().enumerate() {
            *sum += times * own[m] * (before[m] + after[m]);
        }
    }
}

/// Inverse of the standard normal distribution function, by Newton's method from 0. The function is
/// concave above 0 and convex below, so the steps never overshoot and always converge.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quantiles_have_the_variance_that_is_stated() {
        let sum: f64 = (0..QUANTILES).map(standard_quantile).map(|q| q * q).sum();
        assert_eq!(sum / QUANTILES as f64, VARIANCE);
    }

    /// A shuffle alone leaves 1 / sqrt(4096), 0.016. A thousandth is invisible in a million pixels.
    #[test]
    fn neighbours_in_a_run_are_uncorrelated_and_so_are_their_squares() {
        let order = uncorrelated(&quantiles_of(1.0));
        let mut sorted = order.clone();
        sorted.sort_unstable_by(f32::total_cmp);
        assert_eq!(sorted, quantiles_of(1.0).as_slice());
        for apart in 1..RUN {
            for excess in [|v: f64| v, |v: f64| (v * v - 1.0) / core::f64::consts::SQRT_2] {
                let at = |k: usize| excess(f64::from(order[k % QUANTILES]));
                let found = (0..QUANTILES).map(|k| at(k) * at(k + apart)).sum::<f64>() / QUANTILES as f64;
                assert!(found.abs() < 1e-3, "{found} at {apart}");
            }
        }
    }
}
