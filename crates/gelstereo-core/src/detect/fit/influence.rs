//! What the image's noise does to a fitted centre.

use super::noise::Noise;
use crate::math::{DVec2, exp};
use alloc::vec;
use alloc::vec::Vec;

/// Farthest pixel from the middle that is looked at. A larger marker has edges that are straight within the grain.
const REACH: i32 = 16;
const SIDE: usize = 2 * REACH as usize + 1;

/// How a centre answers to the pixels of a window, px per grey level.
#[derive(Clone, Debug)]
pub(super) struct Influence {
    answers: Vec<DVec2>,
    blurred: Vec<DVec2>,
    fits: bool,
}

impl Influence {
    pub fn new() -> Self {
        let zero = || vec![DVec2::ZERO; SIDE * SIDE];
        Self { answers: zero(), blurred: zero(), fits: true }
    }

    pub fn clear(&mut self) {
        self.answers.fill(DVec2::ZERO);
        self.fits = true;
    }

    pub fn set(&mut self, [x, y]: [i32; 2], answer: DVec2) {
        if x.abs() <= REACH && y.abs() <= REACH {
            self.answers[(y + REACH) as usize * SIDE + (x + REACH) as usize] = answer;
        } else {
            self.fits = false;
        }
    }

    /// Variance of both coordinates together, px²: gᵀ C g for the answers g and the noise's covariance C, whose grain is
    /// exp(-dx² / (4 l²)) exp(-dy² / (4 l²)). `None` for a window that is too large.
    pub fn variance_px2(&mut self, noise: &Noise) -> Option<f64> {
        if !self.fits {
            return None;
        }
        let l2 = noise.grain_size_px * noise.grain_size_px;
        let alike: [f64; SIDE] = core::array::from_fn(|d| exp(-0.25 * (d * d) as f64 / l2));
        blur(&self.answers, &mut self.blurred, &alike, SIDE);
        let white: f64 = self.answers.iter().map(|g| g.length_squared()).sum();
        let mut grain = 0.0;
        for (row, answers) in self.answers.chunks_exact(SIDE).enumerate() {
            if answers.iter().all(|&g| g == DVec2::ZERO) {
                continue;
            }
            for (other, blurred) in self.blurred.chunks_exact(SIDE).enumerate() {
                let product: f64 = answers.iter().zip(blurred).map(|(a, b)| a.dot(*b)).sum();
                grain += alike[row.abs_diff(other)] * product;
            }
        }
        Some(noise.white_levels2 * white + noise.grain_levels2 * grain)
    }
}

/// Convolves every row with a symmetric kernel.
fn blur(from: &[DVec2], to: &mut [DVec2], kernel: &[f64; SIDE], width: usize) {
    to.fill(DVec2::ZERO);
    for (from, to) in from.chunks_exact(width).zip(to.chunks_exact_mut(width)) {
        for (x, &value) in from.iter().enumerate().filter(|(_, value)| **value != DVec2::ZERO) {
            for (k, sum) in to.iter_mut().enumerate() {
                *sum += value * kernel[x.abs_diff(k)];
            }
        }
    }
}
