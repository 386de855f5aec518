//! Friction: tractions that make the surface follow the part, within Coulomb's bound.
//!
//! Where the part sticks, the surface follows it. Where it slips, the traction is at its bound μp and
//! points in the direction of the part's motion. For given pressures, and a motion that grows from zero,
//! these tractions minimise ½ q·Gq - q·d subject to |q| <= μp (Johnson 1985, 7.2; Kalker 1990), where G
//! is the compliance and d the requested motion. They are found by projected gradients with spectral
//! steps and an exact line search (Birgin, Martínez and Raydan 2000). Each step costs one product with
//! G, and every step reduces the objective.

use super::contact::{Convergence, dot};
use super::operator::{Operator, Scratch};
use alloc::vec::Vec;
use gelstereo_core::math::sqrt;
use gelstereo_core::stop::Stop;

/// As in [`super::contact`].
const MAX_PRODUCTS: usize = 1000;

/// Fields over a window, kept between solves.
#[derive(Clone, Debug, Default)]
pub(crate) struct Holding {
    /// Gq - d.
    lag: [Vec<f64>; 2],
    step: [Vec<f64>; 2],
    product: [Vec<f64>; 2],
    scratch: Scratch,
}

impl Holding {
    /// Solves for tractions no longer than `bound` that carry the surface to `asked_mm` where possible,
    /// starting from `traction`.
    pub(crate) fn solve(
        &mut self,
        operator: &Operator,
        bound: &[f64],
        asked_mm: &[Vec<f64>; 2],
        (tolerance_mm, stop): (f64, Stop<'_>),
        traction: &mut [Vec<f64>; 2],
    ) -> Convergence {
        for (i, &bound) in bound.iter().enumerate() {
            [traction[0][i], traction[1][i]] = shortened([traction[0][i], traction[1][i]], bound);
        }
        operator.shear(traction, &mut self.scratch, &mut self.lag);
        for (lag, asked) in self.lag.iter_mut().zip(asked_mm) {
            lag.iter_mut().zip(asked).for_each(|(lag, asked)| *lag -= asked);
        }
        // This step length never overshoots.
        let safe = 1.0 / operator.stiffest[1];
        let mut length = 2.0 * safe;
        let mut found = Convergence { products: 1, ..Convergence::default() };
        while found.products < MAX_PRODUCTS && !stop() {
            found.residual_mm = self.aim(safe, bound, traction) / safe;
            found.converged = found.residual_mm <= tolerance_mm;
            if found.converged {
                break;
            }
            self.aim(length, bound, traction);
            operator.shear(&self.step, &mut self.scratch, &mut self.product);
            found.products += 1;
            let both = |a: &[Vec<f64>; 2], b: &[Vec<f64>; 2]| dot(&a[0], &b[0]) + dot(&a[1], &b[1]);
            let along = both(&self.step, &self.product);
            if !(along > 0.0) {
                break;
            }
            let share = (-both(&self.lag, &self.step) / along).min(1.0);
            for axis in 0..2 {
                traction[axis].iter_mut().zip(&self.step[axis]).for_each(|(q, s)| *q += share * s);
                self.lag[axis].iter_mut().zip(&self.product[axis]).for_each(|(lag, g)| *lag += share * g);
            }
            // Alternates the two spectral step lengths (Dai and Fletcher 2005).
            length = if found.products.is_multiple_of(2) {
                both(&self.step, &self.step) / along
            } else {
                along / both(&self.product, &self.product)
            };
        }
        found
    }

    /// Stores the projected gradient step in `step` and returns its largest length.
    fn aim(&mut self, length: f64, bound: &[f64], traction: &[Vec<f64>; 2]) -> f64 {
        for step in &mut self.step {
            step.clear();
            step.resize(bound.len(), 0.0);
        }
        let mut largest = 0.0_f64;
        for (i, &bound) in bound.iter().enumerate() {
            if bound > 0.0 {
                let from = [traction[0][i], traction[1][i]];
                let to = [from[0] - length * self.lag[0][i], from[1] - length * self.lag[1][i]];
                let to = shortened(to, bound);
                let step = [to[0] - from[0], to[1] - from[1]];
                largest = largest.max(step[0] * step[0] + step[1] * step[1]);
                [self.step[0][i], self.step[1][i]] = step;
            }
        }
        sqrt(largest)
    }
}

/// Clips the vector to length `bound`.
fn shortened([x, y]: [f64; 2], bound: f64) -> [f64; 2] {
    let squared = x * x + y * y;
    if squared <= bound * bound {
        return [x, y];
    }
    let share = bound / sqrt(squared);
    [x * share, y * share]
}
