//! Tractions that do not pull, within Coulomb's bound.

use super::evidence::Posterior;
use crate::math::{abs, sqrt};

/// Sweeps after which the search ends anyway.
const MAX_SWEEPS: usize = 200;
/// Change of a traction, relative to the largest, below which it ends. With 1e-3 to 1e-5, tractions of 40
/// simulated contacts are equally accurate.
const SETTLED: f64 = 1e-4;

/// Projected Gauss-Seidel from the most probable tractions: each traction in turn is set to its optimum for
/// the present others, a pressure to at least 0, and the shear of a cell to at most `friction` times its
/// pressure.
pub(super) fn project(posterior: &mut Posterior, friction: Option<f64>) {
    let Posterior { matrix, right, x, .. } = posterior;
    let size = x.len();
    x.iter_mut().step_by(3).for_each(|pressure| *pressure = pressure.max(0.0));
    for _sweep in 0..MAX_SWEEPS {
        let (mut change, mut largest) = (0.0_f64, 0.0_f64);
        for block in (0..size).step_by(3) {
            let before = [x[block], x[block + 1], x[block + 2]];
            for i in block..block + 3 {
                let row = &matrix[i * size..][..size];
                let product: f64 = row.iter().zip(x.iter()).map(|(entry, x)| entry * x).sum();
                x[i] += (right[i] - product) / row[i];
                if i == block {
                    x[i] = x[i].max(0.0);
                }
            }
            // Where nothing presses, nothing drags.
            let bound = if x[block] > 0.0 { friction.map_or(f64::INFINITY, |mu| mu * x[block]) } else { 0.0 };
            let shear = sqrt(x[block + 1] * x[block + 1] + x[block + 2] * x[block + 2]);
            if shear > bound {
                x[block + 1] *= bound / shear;
                x[block + 2] *= bound / shear;
            }
            for (now, before) in x[block..].iter().zip(before) {
                change = change.max(abs(now - before));
                largest = largest.max(abs(*now));
            }
        }
        if change <= SETTLED * largest {
            break;
        }
    }
}
