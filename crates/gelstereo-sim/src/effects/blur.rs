//! Blur of the lens.

use crate::plan::{Bound, Effect, Facts};
use crate::render::Lens;
use crate::scene::{Gel, SceneError};
use alloc::vec::Vec;
use gelstereo_core::math::{ceil, erf};

/// Blur of a slightly defocused lens: a Gaussian, the same everywhere in the image.
///
/// Limit: a real defocus disc has a rim and grows with the distance from the focal plane.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Defocus {
    /// Standard deviation. Valid: 0.1 to 20 px. Default: `0.8` px. Change it to the lens that is simulated.
    pub sigma_px: f64,
}

impl Default for Defocus {
    fn default() -> Self {
        Self { sigma_px: 0.8 }
    }
}

impl Effect for Defocus {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let sigma = self.sigma_px;
        SceneError::check((0.1..=20.0).contains(&sigma), "effects.defocus.sigma_px", sigma, "0.1 to 20 px")
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        let [low, high] = facts.levels();
        // A pixel keeps own² of its level; the rest comes from its neighbours, for gel and ink alike.
        // (1e-4: kernel truncation.)
        let own = self.lens().pixel(0.0);
        Bound::of_levels((high - low) * (1.0 - own * own + 1e-4))
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        let dot_px = facts.dot_radius_mm() * facts.optics.lateral_px_per_mm;
        let lines = 2.0 + 2.2 * dot_px / self.sigma_px;
        let reach_px = self.lens().reach_px();
        // Each line sums rows times columns, four at once. Sharp dots take eight lines per pixel.
        let soft = lines * (100.0 + 2.0 * reach_px * (1.0 + 0.6 * (dot_px + reach_px)));
        let sharp = 2.0 * 8.0 * dot_px * 19.5;
        2.0 * facts.markers() * (soft - sharp).max(0.0)
    }
}

impl Defocus {
    /// The renderer's lens for this blur.
    pub(crate) fn lens(&self) -> Lens {
        Lens { sigma_px: self.sigma_px }
    }
}

/// Separable Gaussian with border pixels repeated.
#[derive(Clone, Debug)]
pub(crate) struct Blur {
    /// Weights from the middle outwards; the whole kernel sums to 1.
    weights: Vec<f32>,
    rows: Vec<f32>,
    padded: Vec<f32>,
}

impl Blur {
    pub(crate) fn new(defocus: &Defocus) -> Self {
        // Gaussian integrated over each pixel, cut off at 4 sigma, where 6e-5 of it is left.
        let radius = ceil(4.0 * defocus.sigma_px) as usize;
        let scale = 1.0 / (defocus.sigma_px * core::f64::consts::SQRT_2);
        let cumulative = |x: f64| 0.5 * erf(x * scale);
        let whole = 2.0 * cumulative(radius as f64 + 0.5);
        let weight = |k: usize| (cumulative(k as f64 + 0.5) - cumulative(k as f64 - 0.5)) / whole;
        Self::weighted((0..=radius).map(|k| weight(k) as f32).collect())
    }

    /// Response of a lens to pixels of uniform brightness.
    pub(crate) fn of_pixels(lens: Lens) -> Self {
        let weights: Vec<f64> = (0..=lens.reach()).map(|k| lens.pixel(k as f64)).collect();
        let whole = 2.0 * weights.iter().sum::<f64>() - weights[0];
        Self::weighted(weights.into_iter().map(|weight| (weight / whole) as f32).collect())
    }

    fn weighted(weights: Vec<f32>) -> Self {
        Self { weights, rows: Vec::new(), padded: Vec::new() }
    }

    /// Standard deviation of white noise of unit variance after the blur: the sum of the squared weights
    /// along one axis (its root, once for each axis).
    pub(crate) fn remaining_sigma(&self) -> f32 {
        let beside: f32 = self.weights[1..].iter().map(|w| w * w).sum();
        self.weights[0] * self.weights[0] + 2.0 * beside
    }

    pub(crate) fn apply(&mut self, image: &mut [f32], width: usize) {
        self.along_rows(image, width);
        let height = image.len() / width;
        for (y, out) in image.chunks_exact_mut(width).enumerate() {
            let row = |y: usize| &self.rows[y * width..][..width];
            for (pixel, &v) in out.iter_mut().zip(row(y)) {
                *pixel = v * self.weights[0];
            }
            for (k, &weight) in self.weights.iter().enumerate().skip(1) {
                let above = row(y.saturating_sub(k));
                let below = row((y + k).min(height - 1));
                for ((pixel, &a), &b) in out.iter_mut().zip(above).zip(below) {
                    *pixel += weight * (a + b);
                }
            }
        }
    }

    fn along_rows(&mut self, image: &[f32], width: usize) {
        let radius = self.weights.len() - 1;
        self.rows.clear();
        self.rows.resize(image.len(), 0.0);
        for (row, out) in image.chunks_exact(width).zip(self.rows.chunks_exact_mut(width)) {
            self.padded.clear();
            self.padded.resize(radius, row[0]);
            self.padded.extend_from_slice(row);
            self.padded.resize(width + 2 * radius, row[width - 1]);
            for (pixel, &v) in out.iter_mut().zip(row) {
                *pixel = v * self.weights[0];
            }
            for (k, &weight) in self.weights.iter().enumerate().skip(1) {
                let (left, right) = (&self.padded[radius - k..], &self.padded[radius + k..]);
                for ((pixel, &a), &b) in out.iter_mut().zip(left).zip(right) {
                    *pixel += weight * (a + b);
                }
            }
        }
    }
}
