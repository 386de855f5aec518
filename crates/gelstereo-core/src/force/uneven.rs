//! Error of the wrench because pressures are not uniform on their cells.
//!
//! The contact's edge crosses cells, and the pressure may be anywhere on them. Along each axis, its centroid
//! is off the middle of the cell by the side over the root of 12 (rms). Markers feel that, and the estimate
//! takes it up by the pressures of the neighbours, but not entirely: what it misses is the torque of the
//! offset less the change of the estimated wrench by the motion that comes with it. That of shears and of the
//! twist is left out: pressures move them by a hundredth of it.

use super::cells::{Cell, Cells};
use super::grid::Grid;
use crate::layer::{Layer, Uneven};
use crate::math::linalg::Symmetric;
use crate::math::{DVec3, InverseFactor};
use alloc::vec::Vec;

/// What the estimate misses.
#[derive(Clone, Debug)]
pub(super) struct UnevenCells {
    uneven: Uneven,
    /// Pressing force, and torques about the two other axes, of unit tractions; and what they were solved to:
    /// derivatives by the right side of the normal equations.
    half: Vec<f64>,
    solved: [Vec<f64>; 3],
    /// Of these, for each cell and axis, and a pressure of 1.
    missed: Vec<[[f64; 3]; 2]>,
    /// The wrench of each.
    wrenches: [[f64; 6]; 3],
}

impl UnevenCells {
    pub fn new(layer: &Layer, grid: &Grid) -> Self {
        let counts = grid.counts();
        let uneven = Uneven::new(layer, grid.step_mm(), grid.sides_mm, counts[0].max(counts[1]));
        Self {
            uneven,
            half: Vec::new(),
            solved: Default::default(),
            missed: Vec::new(),
            wrenches: Default::default(),
        }
    }

    pub fn reserve(&mut self, size: usize, cells: usize) {
        self.solved.iter_mut().chain([&mut self.half]).for_each(|list| list.reserve(size));
        self.missed.reserve(cells);
    }

    /// Begins with the torques of offset pressures. `halves` are of unit loads, and `scale` is the load of a
    /// cell.
    pub fn begin(
        &mut self,
        (factor, halves): (&InverseFactor, &[Vec<f64>; 6]),
        axes: &[DVec3; 3],
        (scale, cells): (f64, usize),
    ) {
        let [[a, b, c], [d, e, f], [g, h, i]] = axes.map(|axis| axis.to_array());
        self.wrenches = [[a, b, c, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, d, e, f], [0.0, 0.0, 0.0, g, h, i]];
        for (solved, wrench) in self.solved.iter_mut().zip(&self.wrenches) {
            self.half.clear();
            let sum = |k: usize| wrench.iter().zip(halves).map(|(share, half)| share * half[k]).sum::<f64>();
            self.half.extend((0..halves[0].len()).map(sum));
            factor.whole(&self.half, solved);
        }
        let shifts_mm = self.uneven.shift_mm();
        let torques = [0, 1].map(|axis| {
            let torque = (axes[1 + axis] * shifts_mm[axis]).cross(axes[0] * scale);
            [0.0, torque.dot(axes[1]), torque.dot(axes[2])]
        });
        self.missed.clear();
        self.missed.resize(cells, torques);
    }

    /// Derivatives of the three components by the right side of the normal equations.
    pub const fn solved(&self) -> &[Vec<f64>; 3] {
        &self.solved
    }

    /// Subtracts what the motion of one marker changes, by the derivatives of the components by this
    /// motion.
    pub fn subtract(&mut self, cells: &Cells, (row, col): (usize, usize), by_motion: &[[f64; 3]; 3]) {
        for (missed, cell) in self.missed.iter_mut().zip(&cells.cells) {
            let (right, down) = (col as isize - cell.col as isize, row as isize - cell.row as isize);
            for (missed, motion) in missed.iter_mut().zip(self.uneven.effects(right, down)) {
                for (missed, by) in missed.iter_mut().zip(by_motion) {
                    *missed -= by[0] * motion[0] + by[1] * motion[1] + by[2] * motion[2];
                }
            }
        }
    }

    /// Covariance of the wrench, with the pressures of the blocks.
    pub fn covariance(&self, cells: &[Cell], pressure: impl Fn(usize) -> f64) -> Symmetric<6> {
        let mut own = [[0.0; 3]; 3];
        for (missed, cell) in self.missed.iter().zip(cells) {
            let pressure = pressure(cell.block);
            for missed in missed {
                for (i, k) in (0..9).map(|ik| (ik / 3, ik % 3)) {
                    own[i][k] += missed[i] * missed[k] * (pressure * pressure);
                }
            }
        }
        let product = |i: usize, k: usize, ab: usize| {
            let (a, b) = (ab / 3, ab % 3);
            self.wrenches[a][i] * own[a][b] * self.wrenches[b][k]
        };
        core::array::from_fn(|i| core::array::from_fn(|k| (0..9).map(|ab| product(i, k, ab)).sum()))
    }
}
