//! Effect of image noise on a fitted centre.

use crate::math::{DVec2, exp};
use alloc::vec;
use alloc::vec::Vec;

/// Largest pixel offset from the middle that is considered. Edges of larger markers are straight on the
/// scale of the grain.
const REACH: i32 = 16;
const SIDE: usize = 2 * REACH as usize + 1;
/// Largest number of pixels considered.
pub(in crate::detect) const MAX_PIXELS: usize = SIDE * SIDE;

/// Variances for unit variance of white noise and of grain.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::detect) struct Variances {
    pub white: f64,
    pub grain: f64,
}

/// Sensitivity of a centre to the pixels of a window, px per grey level.
#[derive(Clone, Debug)]
pub(in crate::detect) struct Influence {
    answers: Vec<DVec2>,
    blurred: Vec<DVec2>,
    /// Largest offset of a pixel with a sensitivity, along either axis.
    farthest: usize,
    fits: bool,
}

impl Influence {
    pub fn new() -> Self {
        let zero = || vec![DVec2::ZERO; SIDE * SIDE];
        Self { answers: zero(), blurred: zero(), farthest: 0, fits: true }
    }

    pub fn clear(&mut self) {
        self.answers.fill(DVec2::ZERO);
        (self.farthest, self.fits) = (0, true);
    }

    pub fn set(&mut self, [x, y]: [i32; 2], answer: DVec2) {
        if x.abs() <= REACH && y.abs() <= REACH {
            self.farthest = self.farthest.max(x.unsigned_abs().max(y.unsigned_abs()) as usize);
            self.answers[(y + REACH) as usize * SIDE + (x + REACH) as usize] = answer;
        } else {
            self.fits = false;
        }
    }

    /// Variance of both coordinates together, px² per squared grey level, for white noise and for grain:
    /// gᵀ C g with the sensitivities g and the noise correlation C, which is
    /// exp(-dx² / (4 l²)) exp(-dy² / (4 l²)) for grain. `None` if the window is too large.
    pub fn variances_px2(&mut self, grain_size_px: f64) -> Option<Variances> {
        if !self.fits {
            return None;
        }
        let l2 = grain_size_px * grain_size_px;
        let alike: [f64; SIDE] = core::array::from_fn(|d| exp(-0.25 * (d * d) as f64 / l2));
        let within = REACH as usize - self.farthest..REACH as usize + self.farthest + 1;
        let rows = within.start * SIDE..within.end * SIDE;
        let (answers, blurred) = (&self.answers[rows.clone()], &mut self.blurred[rows]);
        let (mut white, mut grain) = (0.0, 0.0);
        for (from, to) in answers.chunks_exact(SIDE).zip(blurred.chunks_exact_mut(SIDE)) {
            let from = &from[within.clone()];
            white += from.iter().map(|g| g.length_squared()).sum::<f64>();
            blur(from, &mut to[within.clone()], &alike);
        }
        for (row, answers) in answers.chunks_exact(SIDE).enumerate() {
            for (apart, blurred) in blurred.chunks_exact(SIDE).skip(row).enumerate() {
                let pairs = answers[within.clone()].iter().zip(&blurred[within.clone()]);
                // Each pair of different rows counts twice.
                let times = if apart == 0 { 1.0 } else { 2.0 };
                grain += times * alike[apart] * pairs.map(|(a, b)| a.dot(*b)).sum::<f64>();
            }
        }
        Some(Variances { white, grain })
    }
}

/// Convolves a row with a symmetric kernel.
fn blur(from: &[DVec2], to: &mut [DVec2], kernel: &[f64; SIDE]) {
    to.fill(DVec2::ZERO);
    let mirrored: [f64; 2 * SIDE - 1] = core::array::from_fn(|k| kernel[k.abs_diff(SIDE - 1)]);
    for (x, &value) in from.iter().enumerate().filter(|(_, value)| **value != DVec2::ZERO) {
        for (sum, share) in to.iter_mut().zip(&mirrored[SIDE - 1 - x..]) {
            *sum += value * share;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// gᵀ C g, pixel pair by pixel pair.
        #[test]
        fn variances_are_sums_over_all_pairs(
            answers in prop::collection::vec(
                (-REACH..=REACH, -REACH..=REACH, -1.0..1.0_f64, -1.0..1.0_f64), 1..40,
            ),
            size_px in 0.5..4.0_f64,
        ) {
            let mut influence = Influence::new();
            let mut pixels: Vec<([i32; 2], DVec2)> = Vec::new();
            for (x, y, across, down) in answers {
                pixels.retain(|(at, _)| *at != [x, y]);
                pixels.push(([x, y], DVec2::new(across, down)));
                influence.set([x, y], DVec2::new(across, down));
            }
            let found = influence.variances_px2(size_px).unwrap();
            let (mut white, mut grain) = (0.0, 0.0);
            for &([x, y], a) in &pixels {
                white += a.length_squared();
                for &([u, v], b) in &pixels {
                    let squared = f64::from((x - u) * (x - u) + (y - v) * (y - v));
                    grain += a.dot(b) * exp(-squared / (4.0 * size_px * size_px));
                }
            }
            // Round-off of at most 1600 terms up to 2.
            prop_assert!((found.white - white).abs() < 1e-12, "{} {white}", found.white);
            prop_assert!((found.grain - grain).abs() < 1e-11, "{} {grain}", found.grain);
        }
    }

    #[test]
    fn a_window_that_is_too_large_has_no_variance() {
        let mut influence = Influence::new();
        influence.set([REACH, -REACH], DVec2::X);
        assert!(influence.variances_px2(1.0).is_some());
        influence.set([REACH + 1, 0], DVec2::X);
        assert!(influence.variances_px2(1.0).is_none());
        influence.clear();
        assert!(influence.variances_px2(1.0).is_some_and(|v| v.white == 0.0 && v.grain == 0.0));
    }
}
