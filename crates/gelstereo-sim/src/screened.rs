//! Constrained screened membranes: u - l² Δu = 0 over the marker lattice, with free borders, beside
//! prescribed values or above an obstacle.
//!
//! Nodes are stored by chessboard colour (Young 1954). All neighbours of a node have the other colour,
//! so one colour is updated at once in plain loops. Steps are over-relaxed by Chebyshev's factors (Golub
//! and Varga 1961). They converge to the optimal over-relaxation factor and, unlike it, do not let
//! errors grow at first. Above an obstacle this is projected over-relaxation (Cryer 1971), which
//! converges for this operator.

use crate::lattice::Lattice;
use alloc::vec;
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, sqrt};

/// Largest distance of a node from the exact solution: a nanometre is 2e-5 px on the default rig.
const LEFT_MM: f64 = 1e-6;
/// About 11 sweeps per pitch of decay length are needed: enough for 350 pitches.
const MAX_SWEEPS: usize = 4000;
/// Nodes that are updated at once.
const LANES: usize = 4;

/// Value of a membrane at a node.
pub(crate) trait Node: Copy + PartialEq {
    /// Applies `make` to each component of some nodes.
    fn each<const N: usize>(of: [Self; N], make: impl Fn([f64; N]) -> f64) -> Self;

    fn even(number: f64) -> Self {
        Self::each([], |[]| number)
    }
}

/// A height.
impl Node for f64 {
    #[inline(always)]
    fn each<const N: usize>(of: [Self; N], make: impl Fn([f64; N]) -> f64) -> Self {
        make(of)
    }
}

/// Both components of a motion, independent of each other. The alignment lets a register be loaded at
/// once, because the neighbours of single numbers are never all aligned.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(16))]
pub(crate) struct Motion(pub(crate) DVec2);

impl Node for Motion {
    #[inline(always)]
    fn each<const N: usize>(of: [Self; N], make: impl Fn([f64; N]) -> f64) -> Self {
        Self(DVec2::new(make(of.map(|Self(u)| u.x)), make(of.map(|Self(u)| u.y))))
    }
}

/// A membrane and its constraints.
///
/// Rows are stored consecutively, each padded with zeros to an odd length. The padding serves as the
/// missing neighbours at the border. Places of one colour are those of one parity, and the offsets to
/// their neighbours are the same everywhere.
#[derive(Clone, Debug)]
pub(crate) struct Screened<U> {
    rows: usize,
    cols: usize,
    /// Half of a row's length, rounded down.
    half: usize,
    /// Upper bound of the spectral radius of Jacobi's method: that of a constant field.
    jacobi: f64,
    /// Weight of a neighbour along a column beside one along a row: the squared ratio of their distances.
    down: f64,
    /// Per colour: l² / (1 + n l²) for nodes with n neighbours, those along a column by their weight; 0 in
    /// the padding.
    weights: [Vec<U>; 2],
    /// Node values, with zeros for the neighbours above the first row and below the last.
    nodes: [Vec<U>; 2],
    /// Constraint of each node, interpreted by the caller's rule; 0 in the padding.
    held: [Vec<U>; 2],
}

impl<U: Node> Screened<U> {
    pub(crate) fn new(lattice: &Lattice, length_mm: f64) -> Self {
        let (rows, cols, [l2, below]) = (lattice.rows, lattice.cols, lattice.squared_pitches(length_mm));
        let (down, half) = (below / l2, cols.div_ceil(2));
        let places = (rows * (2 * half + 1)).div_ceil(2).next_multiple_of(LANES);
        let zeros = |places: usize| [0, 1].map(|_| vec![U::even(0.0); places]);
        let (weights, nodes, held) = (zeros(places), zeros(places + 2 * (half + 1)), zeros(places));
        let all = 2.0 + 2.0 * down;
        let jacobi = all * l2 / (1.0 + all * l2);
        let mut new = Self { rows, cols, half, jacobi, down, weights, nodes, held };
        let beside = |at: usize, n: usize| (usize::from(at > 0) + usize::from(at + 1 < n)) as f64;
        let weight = |i: usize| {
            let count = down * beside(i / cols, rows) + beside(i % cols, cols);
            U::even(l2 / (1.0 + l2 * count))
        };
        put([rows, cols, half], weight, &mut new.weights, 0);
        new
    }

    /// Sets the initial values of the solution.
    pub(crate) fn start(&mut self, value: impl Fn(usize) -> U) {
        put([self.rows, self.cols, self.half], value, &mut self.nodes, self.half + 1);
    }

    /// Sets the constraints of the nodes, for one solve only.
    pub(crate) fn hold(&mut self, value: impl Fn(usize) -> U) {
        put([self.rows, self.cols, self.half], value, &mut self.held, 0);
    }

    /// Solves with nodes held by 0 fixed at their initial values, and nodes held by 1 free.
    pub(crate) fn settle_beside(&mut self) {
        self.relax(|old, step, free| old + step * free);
    }

    /// Returns the solution, row by row.
    pub(crate) fn values(&self) -> impl Iterator<Item = U> {
        let length = 2 * self.half + 1;
        let places = (0..self.rows).flat_map(move |row| row * length..row * length + self.cols);
        places.map(|place| self.nodes[place % 2][self.half + 1 + place / 2])
    }

    /// Freezes the components that are 0 in `moving`, so that each component ends as it would alone, bit
    /// for bit.
    fn stop(&mut self, moving: U) {
        let all = self.held.iter_mut().flatten();
        all.for_each(|held| *held = U::each([*held, moving], |[held, moving]| held * moving));
    }

    /// Sweeps until nothing is farther than [`LEFT_MM`] from the solution. `rule` computes the next
    /// value from a value, its step and its constraint.
    fn relax(&mut self, rule: impl Fn(f64, f64, f64) -> f64 + Copy) {
        let square = self.jacobi * self.jacobi;
        let root = sqrt(1.0 - square);
        // Asymptotic error reduction per sweep: the remaining error is a geometric sum of steps.
        let shrinks = (1.0 - root) / (1.0 + root);
        let least_mm = LEFT_MM * (1.0 - shrinks);
        let (mut over, mut moving) = ([1.0, 1.0 / (1.0 - 0.5 * square)], U::even(1.0));
        for _sweep in 0..MAX_SWEEPS {
            let longest = [0, 1].map(|colour| self.balance(colour, over[colour], rule));
            let moves = U::each(longest, |[a, b]| if a <= least_mm && b <= least_mm { 0.0 } else { 1.0 });
            if moves == U::even(0.0) {
                return;
            }
            if moves != moving {
                self.stop(moves);
                moving = moves;
            }
            over[0] = 1.0 / (1.0 - 0.25 * square * over[1]);
            over[1] = 1.0 / (1.0 - 0.25 * square * over[0]);
        }
    }

    /// Moves the nodes of one colour by `over` times the distance to the balance of their neighbours.
    /// Returns the longest step.
    fn balance(&mut self, colour: usize, over: f64, rule: impl Fn(f64, f64, f64) -> f64) -> U {
        let (half, down, places) = (self.half, self.down, self.weights[colour].len());
        let [even, odd] = &mut self.nodes;
        let (mine, other) = if colour == 0 { (even, odd) } else { (odd, even) };
        // Place p is node p / 2 of its colour, and a row is 2 half + 1 places long.
        let neighbours = [0, half, half + 1, 2 * half + 1];
        let [above, left, right, below] = neighbours.map(|at| lanes(&other[at + colour..][..places]));
        let mut longest = [U::even(0.0); LANES];
        let (here, _) = mine[half + 1..][..places].as_chunks_mut::<LANES>();
        let held = lanes(&self.weights[colour]).iter().zip(lanes(&self.held[colour]));
        let beside = left.iter().zip(right).zip(above.iter().zip(below));
        for ((here, ((left, right), (above, below))), (weight, held)) in here.iter_mut().zip(beside).zip(held)
        {
            let mut next = *here;
            for (k, next) in next.iter_mut().enumerate() {
                let near = [left[k], right[k], above[k], below[k], weight[k], *next, held[k]];
                *next = U::each(near, |[left, right, above, below, weight, here, held]| {
                    let sum = (left + right) + (above + below) * down;
                    rule(here, (sum * weight - here) * over, held)
                });
            }
            for (k, longest) in longest.iter_mut().enumerate() {
                *longest = U::each([next[k], here[k], *longest], |[next, here, longest]| {
                    let step = (next - here).abs();
                    if step > longest { step } else { longest }
                });
            }
            *here = next;
        }
        longest.into_iter().fold(U::even(0.0), |a, b| U::each([a, b], |[a, b]| a.max(b)))
    }
}

impl Screened<f64> {
    /// Solves with every node at or above its constraint.
    pub(crate) fn settle_above(&mut self) {
        self.relax(|old, step, floor| {
            let next = old + step;
            if next > floor { next } else { floor }
        });
    }
}

/// Writes a field, given by index, into its two colours, starting at offset `from`.
fn put<U>(
    [rows, cols, half]: [usize; 3],
    value: impl Fn(usize) -> U,
    colours: &mut [Vec<U>; 2],
    from: usize,
) {
    for row in 0..rows {
        let first = row * (2 * half + 1);
        for (place, i) in (first..first + cols).zip(row * cols..) {
            colours[place % 2][from + place / 2] = value(i);
        }
    }
}

/// Nodes grouped into lanes.
fn lanes<U>(nodes: &[U]) -> &[[U; LANES]] {
    nodes.as_chunks().0
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::scene::Gel;
    use proptest::prelude::*;

    /// Reference solver for u - l² Δu = `source`: Gauss-Seidel node by node, where `hold` returns the
    /// allowed value. It ends when nothing moves by more than 1e-12, which leaves 1e-10 at these lengths
    /// of up to six pitches.
    pub(crate) fn plainly_relaxed(
        [rows, cols]: [usize; 2],
        length: f64,
        field: &mut [f64],
        source: impl Fn(usize) -> f64,
        hold: impl Fn(usize, f64) -> f64,
    ) {
        let l2 = length * length;
        loop {
            let mut longest = 0.0_f64;
            for i in 0..rows * cols {
                let (row, col) = (i / cols, i % cols);
                let beside = [(row > 0, -(cols as isize)), (row + 1 < rows, cols as isize)];
                let beside = beside.into_iter().chain([(col > 0, -1), (col + 1 < cols, 1)]);
                let (mut sum, mut count) = (0.0, 0.0);
                for (_, step) in beside.filter(|&(exists, _)| exists) {
                    sum += field[i.wrapping_add_signed(step)];
                    count += 1.0;
                }
                let next = hold(i, (source(i) + l2 * sum) / (1.0 + l2 * count));
                longest = longest.max((next - field[i]).abs());
                field[i] = next;
            }
            if longest < 1e-12 {
                return;
            }
        }
    }

    fn screened<U: Node>([rows, cols]: [usize; 2], length: f64) -> Screened<U> {
        Screened::new(&Lattice::new(&Gel { rows, cols, pitch_mm: 1.0.into(), ..Gel::default() }), length)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn held_membranes_are_what_plain_relaxation_ends_at(
            rows in 1..16_usize, cols in 1..16_usize, length in 0.05..6.0,
            values in prop::collection::vec(-2.0..2.0, 15 * 15), share in 0.0..1.0,
            places in prop::collection::vec(0.0..1.0, 15 * 15),
        ) {
            let mut found = screened([rows, cols], length);
            // The second solve must not depend on the state that the first one leaves.
            for _before in 0..2 {
                let held = |i: usize| places[i] < share;
                let at = |i: usize| if held(i) { values[i] } else { 0.0 };
                let mut plain: Vec<f64> = (0..rows * cols).map(at).collect();
                plainly_relaxed(
                    [rows, cols],
                    length,
                    &mut plain,
                    |_| 0.0,
                    |i, u| if held(i) { values[i] } else { u },
                );
                found.start(at);
                found.hold(|i| if held(i) { 0.0 } else { 1.0 });
                found.settle_beside();
                for (i, (found, plain)) in found.values().zip(&plain).enumerate() {
                    prop_assert!((found - plain).abs() < LEFT_MM, "{found} {plain}");
                    prop_assert!(!held(i) || found == values[i]);
                }

                let floor = |i: usize| if held(i) { values[i] } else { f64::NEG_INFINITY };
                let mut plain: Vec<f64> = (0..rows * cols).map(|i| floor(i).max(0.0)).collect();
                plainly_relaxed([rows, cols], length, &mut plain, |_| 0.0, |i, u| u.max(floor(i)));
                found.start(|i| floor(i).max(0.0));
                found.hold(floor);
                found.settle_above();
                for (i, (found, plain)) in found.values().zip(&plain).enumerate() {
                    prop_assert!((found - plain).abs() < LEFT_MM, "{found} {plain}");
                    prop_assert!(found >= floor(i));
                }
            }
        }

        /// Independent of which component converges first.
        #[test]
        fn each_component_of_a_motion_is_that_of_a_membrane_of_its_own(
            rows in 1..16_usize, cols in 1..16_usize, length in 0.05..6.0, share in 0.0..1.0,
            exponent in -9.0..0.0, values in prop::collection::vec(prop::array::uniform2(-2.0..2.0), 15 * 15),
            places in prop::collection::vec(0.0..1.0, 15 * 15),
        ) {
            let held = |i: usize| places[i] < share;
            let free = |i: usize| if held(i) { 0.0 } else { 1.0 };
            let small = 10.0_f64.powf(exponent);
            let at =
                |i: usize| if held(i) { DVec2::new(values[i][0] * small, values[i][1]) } else { DVec2::ZERO };
            let mut both = screened([rows, cols], length);
            both.start(|i| Motion(at(i)));
            both.hold(|i| Motion::even(free(i)));
            both.settle_beside();
            for axis in 0..2 {
                let mut alone: Screened<f64> = screened([rows, cols], length);
                alone.start(|i| at(i)[axis]);
                alone.hold(free);
                alone.settle_beside();
                for (Motion(both), alone) in both.values().zip(alone.values()) {
                    prop_assert!(both[axis] == alone, "{both} {alone}");
                }
            }
        }
    }
}
