//! Contact without adhesion between a rigid part and the layer.
//!
//! Where the part presses, the surface lies on it; elsewhere the surface lies below it and carries no
//! pressure. The pressures p >= 0 minimise ½ p·Kp - p·g, where K is the compliance and g the part's
//! height above the undeformed surface. The solver is modified proportioning with reduced gradient
//! projections (Dostál and Schöberl 2005). It uses conjugate gradients while the contact set is
//! constant, and projections when it changes. Convergence is proven, and a conjugate gradient step costs
//! one product with K. Within a contact, the gradients are preconditioned by the centre of the inverse
//! kernel.

use super::operator::{Operator, Scratch};
use alloc::vec::Vec;
use gelstereo_core::stop::Stop;

/// Outcome of a solve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Convergence {
    /// Whether the residual fell below the tolerance.
    pub converged: bool,
    /// Products with the compliance.
    pub products: usize,
    /// Largest distance between part and surface in contact, or overlap out of contact, mm.
    pub residual_mm: f64,
}

/// Products after which a solve gives up: ten times the maximum of the tests.
const MAX_PRODUCTS: usize = 1000;

/// Fields over a window, kept between solves.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pressing {
    /// Kp - g: depth of the surface below the part.
    gap: Vec<f64>,
    free: Vec<f64>,
    descent: Vec<f64>,
    direction: Vec<f64>,
    product: Vec<f64>,
    scratch: Scratch,
}

impl Pressing {
    /// Solves for the pressures over the window under a part of these heights (negative infinity where
    /// there is none), starting from `pressure`.
    pub(crate) fn solve(
        &mut self,
        operator: &Operator,
        heights_mm: &[f64],
        (tolerance_mm, stop): (f64, Stop<'_>),
        pressure: &mut [f64],
    ) -> Convergence {
        operator.sink(pressure, &mut self.scratch, &mut self.gap);
        self.gap.iter_mut().zip(heights_mm).for_each(|(gap, height)| *gap -= height);
        let expansion = 1.9 / operator.stiffest[0];
        let mut found = Convergence { products: 1, ..Convergence::default() };
        self.restart(operator, pressure);
        while found.products < MAX_PRODUCTS && !stop() {
            let [free, reduced, chopped, largest] = self.measure(pressure, expansion);
            found.residual_mm = largest;
            found.converged = largest <= tolerance_mm;
            if found.converged {
                break;
            }
            found.products += if chopped <= reduced.min(free) {
                self.conjugate(operator, heights_mm, expansion, pressure)
            } else {
                self.release(operator, pressure)
            };
        }
        found
    }

    /// Squared norm of the free gradient, its product with the reduced gradient, squared norm of the
    /// chopped gradient, and the largest entry of the free and chopped ones.
    fn measure(&self, pressure: &[f64], expansion: f64) -> [f64; 4] {
        let [mut free, mut reduced, mut chopped, mut largest] = [0.0, 0.0, 0.0, 0.0_f64];
        for (&gap, &p) in self.gap.iter().zip(pressure) {
            if p > 0.0 {
                free += gap * gap;
                reduced += gap * gap.min(p / expansion);
                largest = largest.max(gap.abs());
            } else if gap < 0.0 {
                chopped += gap * gap;
                largest = largest.max(-gap);
            }
        }
        [free, reduced, chopped, largest]
    }

    /// Conjugate gradient step within the contact. If it would make a pressure negative, it stops there
    /// and takes a projected gradient step. Returns the number of products.
    fn conjugate(
        &mut self,
        operator: &Operator,
        heights_mm: &[f64],
        expansion: f64,
        pressure: &mut [f64],
    ) -> usize {
        operator.sink(&self.direction, &mut self.scratch, &mut self.product);
        let along = dot(&self.direction, &self.product);
        let step = dot(&self.descent, &self.free) / along;
        let mut feasible = f64::INFINITY;
        for (&p, &d) in pressure.iter().zip(&self.direction) {
            if d > 0.0 {
                feasible = feasible.min(p / d);
            }
        }
        if step <= feasible {
            self.advance(step, pressure);
            self.precondition(operator, pressure);
            // Only free cells have a descent; the product belongs to the old direction.
            let turn = dot(&self.descent, &self.product) / along;
            self.direction.iter_mut().zip(&self.descent).for_each(|(d, z)| *d = z - turn * *d);
            return 1;
        }
        self.advance(feasible, pressure);
        for (p, &gap) in pressure.iter_mut().zip(&self.gap) {
            if *p > 0.0 {
                *p = (*p - expansion * gap).max(0.0);
            }
        }
        operator.sink(pressure, &mut self.scratch, &mut self.gap);
        self.gap.iter_mut().zip(heights_mm).for_each(|(gap, height)| *gap -= height);
        self.restart(operator, pressure);
        2
    }

    /// Step that adds the overlapping cells to the contact. Returns the number of products.
    fn release(&mut self, operator: &Operator, pressure: &mut [f64]) -> usize {
        for ((d, &gap), &p) in self.direction.iter_mut().zip(&self.gap).zip(&*pressure) {
            *d = if p > 0.0 { 0.0 } else { gap.min(0.0) };
        }
        operator.sink(&self.direction, &mut self.scratch, &mut self.product);
        let step = dot(&self.direction, &self.direction) / dot(&self.direction, &self.product);
        self.advance(step, pressure);
        self.restart(operator, pressure);
        1
    }

    fn advance(&mut self, step: f64, pressure: &mut [f64]) {
        pressure.iter_mut().zip(&self.direction).for_each(|(p, d)| *p = (*p - step * d).max(0.0));
        self.gap.iter_mut().zip(&self.product).for_each(|(gap, k)| *gap -= step * k);
    }

    /// Restarts the conjugate gradients from here.
    fn restart(&mut self, operator: &Operator, pressure: &[f64]) {
        self.precondition(operator, pressure);
        self.direction.clone_from(&self.descent);
    }

    /// Gradient over the free cells, and its preconditioned form (approximate inverse of the
    /// compliance).
    fn precondition(&mut self, operator: &Operator, pressure: &[f64]) {
        let (rows, cols) = (operator.plane.rows, operator.plane.cols);
        self.free.clear();
        self.free.extend(self.gap.iter().zip(pressure).map(|(&gap, &p)| if p > 0.0 { gap } else { 0.0 }));
        self.descent.clear();
        self.descent.resize(rows * cols, 0.0);
        let [cell, side, corner] = operator.stencil;
        for row in 0..rows {
            let here = &self.free[row * cols..][..cols];
            let out = &mut self.descent[row * cols..][..cols];
            out.iter_mut().zip(here).for_each(|(z, f)| *z += cell * f);
            beside(out, here, side);
            for other in [row.checked_sub(1), Some(row + 1)].into_iter().flatten().filter(|&r| r < rows) {
                let there = &self.free[other * cols..][..cols];
                out.iter_mut().zip(there).for_each(|(z, f)| *z += side * f);
                beside(out, there, corner);
            }
        }
        for (z, &p) in self.descent.iter_mut().zip(pressure) {
            *z = if p > 0.0 { *z } else { 0.0 };
        }
    }
}

/// Adds the two neighbours along a row.
fn beside(out: &mut [f64], row: &[f64], weight: f64) {
    let last = row.len() - 1;
    out[1..].iter_mut().zip(&row[..last]).for_each(|(z, f)| *z += weight * f);
    out[..last].iter_mut().zip(&row[1..]).for_each(|(z, f)| *z += weight * f);
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    // Four independent sums shorten the dependency chain.
    let mut sums = [0.0; 4];
    let (mut fours, mut others) = (a.chunks_exact(4), b.chunks_exact(4));
    for (a, b) in fours.by_ref().zip(others.by_ref()) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f64 = fours.remainder().iter().zip(others.remainder()).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}
