//! Variances of tractions and noise that maximise the evidence.

use super::equations::Equations;
use crate::math::{InverseFactor, abs};
use alloc::vec::Vec;

/// Relative change of a variance below which the search ends. With 0.05, 0.005 and 0.0005, pressing forces of
/// a simulated ball differ by less than 0.02 %.
const SETTLED: f64 = 0.05;
/// Rounds after which it ends anyway. Contacts of a few cells, of which the data determine little, reach it;
/// the next frame goes on from there.
const MAX_ROUNDS: usize = 30;
/// Smallest variance of tractions, in squared Young's moduli, against a division by zero where nothing moves:
/// a millionth of the modulus, 0.1 Pa on a gel of 100 kPa.
const MIN_VARIANCE: f64 = 1e-12;

/// Variances of the prior and of the noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Variances {
    /// Of a pressure, in squared Young's moduli.
    pub pressure: f64,
    /// Of a traction along rows or columns.
    pub shear: f64,
    /// Factor of all covariances of motions, at least 1.
    pub noise: f64,
}

/// Posterior of the tractions under a prior.
#[derive(Clone, Debug, Default)]
pub(super) struct Posterior {
    /// Inverse covariance, by rows.
    pub matrix: Vec<f64>,
    /// Its product with the most probable tractions.
    pub right: Vec<f64>,
    pub factor: InverseFactor,
    /// Most probable tractions.
    pub x: Vec<f64>,
    pub half: Vec<f64>,
    /// Rounds of the last search.
    pub rounds: usize,
}

impl Posterior {
    pub fn reserve(&mut self, size: usize) {
        self.matrix.reserve(size * size);
        self.factor.reserve(size);
        for list in [&mut self.right, &mut self.x, &mut self.half] {
            list.reserve(size);
        }
    }

    /// Under this prior; returns whether it is determined, as it is for finite equations.
    fn update(&mut self, equations: &Equations, variances: &Variances) -> bool {
        let Self { matrix, right, factor, x, half, .. } = self;
        matrix.clear();
        matrix.extend(equations.matrix.iter().map(|entry| entry / variances.noise));
        right.clear();
        right.extend(equations.right.iter().map(|entry| entry / variances.noise));
        for i in 0..equations.size {
            let variance = if i % 3 == 0 { variances.pressure } else { variances.shear };
            matrix[i * equations.size + i] += 1.0 / variance;
        }
        if !factor.factor(equations.size, matrix) {
            return false;
        }
        factor.half(right, half);
        factor.whole(half, x);
        true
    }

    /// Maximises the evidence by MacKay's fixed point, beginning with these variances. Returns whether the
    /// tractions are determined.
    pub fn fit(&mut self, equations: &Equations, variances: &mut Variances) -> bool {
        for round in 1..=MAX_ROUNDS {
            self.rounds = round;
            if !self.update(equations, variances) {
                return false;
            }
            let next = self.next(equations, variances);
            let is_settled = |now: f64, next: f64| abs(next - now) <= SETTLED * now;
            let is_last = is_settled(variances.pressure, next.pressure)
                && is_settled(variances.shear, next.shear)
                && is_settled(variances.noise, next.noise)
                || round == MAX_ROUNDS;
            // The tractions are those of the variances that are kept.
            if is_last {
                break;
            }
            *variances = next;
        }
        true
    }

    /// Variances from the present tractions, and the number of them that the data determine.
    fn next(&self, equations: &Equations, now: &Variances) -> Variances {
        // Sum of squares and trace of the covariance, of pressures and of shears.
        let mut sums = [[0.0; 2]; 2];
        for (i, x) in self.x.iter().enumerate() {
            let sum = &mut sums[usize::from(i % 3 != 0)];
            sum[0] += x * x;
            sum[1] += self.factor.variance(i);
        }
        let blocks = equations.size as f64 / 3.0;
        let known = |[_, trace]: [f64; 2], count: f64, variance: f64| (count - trace / variance).max(1e-3);
        let (pressures, shears) =
            (known(sums[0], blocks, now.pressure), known(sums[1], 2.0 * blocks, now.shear));
        let left = equations.count as f64 - pressures - shears;
        Variances {
            pressure: (sums[0][0] / pressures).max(MIN_VARIANCE),
            shear: (sums[1][0] / shears).max(MIN_VARIANCE),
            noise: (equations.residual(&self.x) / left.max(1.0)).max(1.0),
        }
    }
}
