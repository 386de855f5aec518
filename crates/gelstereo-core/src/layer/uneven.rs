//! Motion of the surface around a cell by a pressure that is not uniform on it.

use super::{Influence, Layer};
use crate::math::sqrt;
use alloc::vec::Vec;

/// Difference of the motion by an uneven and by a uniform pressure of the same sum.
///
/// The uneven pressure rises from third to third of the cell along an axis, so that its centroid is off the
/// middle by the standard deviation of a place anywhere on the cell, which is the side over the root of 12.
#[derive(Clone, Debug)]
pub struct Uneven {
    side: usize,
    /// For each axis of the rise: into the layer, along x and along y, at offsets as of [`Influence`].
    motion: [Vec<[f64; 3]>; 2],
    /// Of the centroid from the middle, along x and along y.
    shift_mm: [f64; 2],
}

impl Uneven {
    /// For uniform pressures of one Young's modulus on cells of these sides, and offsets in these steps, of
    /// up to `side` of them.
    #[must_use]
    pub fn new(layer: &Layer, step_mm: [f64; 2], cell_mm: [f64; 2], side: usize) -> Self {
        let motion = [0, 1].map(|axis| {
            let mut strip_mm = cell_mm;
            strip_mm[axis] /= 3.0;
            let at = |shift: f64| {
                let mut shift_mm = [0.0; 2];
                shift_mm[axis] = shift * strip_mm[axis];
                Influence::shifted(layer, step_mm, strip_mm, shift_mm, side)
            };
            // A third that lies ahead of the middle is nearer to the marker.
            let (ahead, behind) = (at(-1.0), at(1.0));
            // Two thirds by a third of the side: the moment of this rise over that of the pressure by a side.
            let rise = 4.5 / sqrt(12.0);
            let list = |ahead: &[f64], behind: &[f64], i: usize| rise * (ahead[i] - behind[i]);
            let motion = |i: usize| {
                [
                    list(&ahead.normal, &behind.normal, i),
                    list(&ahead.cross[0], &behind.cross[0], i),
                    list(&ahead.cross[1], &behind.cross[1], i),
                ]
            };
            (0..side * side).map(motion).collect()
        });
        Self { side, motion, shift_mm: cell_mm.map(|mm| mm / sqrt(12.0)) }
    }

    /// Distance of the centroid from the middle of the cell, along x and along y.
    #[must_use]
    pub const fn shift_mm(&self) -> [f64; 2] {
        self.shift_mm
    }

    /// Motion into the layer, along x and along y at an offset in steps from a cell, under a pressure that
    /// rises along x, and under one that rises along y.
    #[must_use]
    pub fn effects(&self, right: isize, down: isize) -> [[f64; 3]; 2] {
        let i = down.unsigned_abs() * self.side + right.unsigned_abs();
        let sign = |offset: isize| if offset < 0 { -1.0 } else { 1.0 };
        let (x, y) = (sign(right), sign(down));
        let ([a, b, c], [d, e, f]) = (self.motion[0][i], self.motion[1][i]);
        // Odd along the axis of the rise where the uniform pressure's motion is even, and the reverse.
        [[x * a, b, x * y * c], [y * d, x * y * e, f]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against cells of a third of the side, of which the table has all offsets.
    #[test]
    fn an_uneven_pressure_is_that_of_its_thirds() {
        let layer = Layer { thickness_mm: 2.0, poisson_ratio: 0.47 };
        let (thirds, side) = (Influence::new(&layer, [0.3; 2], 30), 8);
        let uneven = Uneven::new(&layer, [0.9; 2], [0.9; 2], side);
        let rise = 4.5 / sqrt(12.0);
        for (right, down) in (-6..7).flat_map(|right| (-6..7).map(move |down| (right, down))) {
            let found = uneven.effects(right, down);
            for (axis, found) in found.into_iter().enumerate() {
                let strip = |shift: isize| {
                    let (x, y) = if axis == 0 { (shift, 0) } else { (0, shift) };
                    [-1, 0, 1].map(|along: isize| {
                        let (dx, dy) = if axis == 0 { (x, along) } else { (along, y) };
                        thirds.effect(3 * right - dx, 3 * down - dy)
                    })
                };
                let (ahead, behind) = (strip(1), strip(-1));
                for k in 0..3 {
                    let sum = |strip: &[[[f64; 3]; 3]; 3]| strip.iter().map(|cell| cell[k][0]).sum::<f64>();
                    let expected = rise * (sum(&ahead) - sum(&behind));
                    assert!(
                        (found[k] - expected).abs() < 1e-4 * thirds.normal[0],
                        "{right} {down} {axis} {k}"
                    );
                }
            }
        }
        // The moment over the sum of the pressures.
        let moment = rise * 2.0 * (0.9 / 3.0) * (0.9 / 3.0) / 0.9;
        assert!(uneven.shift_mm().iter().all(|mm| (mm - moment).abs() < 1e-12));
    }
}
