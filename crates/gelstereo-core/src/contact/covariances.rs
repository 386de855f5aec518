//! Covariances of the pressures of neighbouring markers, and prediction of one marker's noise from them.

use super::sharing::{HEXAGONAL, SQUARE, Sharing};
use super::stencils::Stencils;
use crate::lattice::Offset;
use crate::math::sqrt;
use alloc::vec::Vec;

/// Prediction of a pressure's noise from the free markers around it, for the two layouts of a print.
#[derive(Clone, Debug)]
pub(super) enum Prediction {
    /// Stencils have five taps, and share heights with those of twelve markers.
    Square(Kriging<5, 12, 7>),
    /// Stencils have seven taps, and share heights with those of eighteen markers.
    Hexagonal(Kriging<7, 18, 10>),
}

impl Default for Prediction {
    fn default() -> Self {
        Self::Square(Kriging::new(&SQUARE))
    }
}

impl Prediction {
    pub fn new(is_hexagonal: bool) -> Self {
        if is_hexagonal { Self::Hexagonal(Kriging::new(&HEXAGONAL)) } else { Self::default() }
    }

    pub fn reserve(&mut self, markers: usize) {
        match self {
            Self::Square(kriging) => kriging.shared.reserve(markers),
            Self::Hexagonal(kriging) => kriging.shared.reserve(markers),
        }
    }

    /// Computes the prediction in a regular lattice with these weights along the axes.
    pub fn set_even(&mut self, axes: [f64; 3]) {
        match self {
            Self::Square(kriging) => kriging.even = Even::new(kriging.sharing, axes),
            Self::Hexagonal(kriging) => kriging.even = Even::new(kriging.sharing, axes),
        }
    }

    /// Computes the covariances of pressures whose heights have these variances.
    pub fn measure(&mut self, lattice: &Stencils, variance_mm2: &[f64]) {
        match self {
            Self::Square(kriging) => kriging.measure(lattice, variance_mm2),
            Self::Hexagonal(kriging) => kriging.measure(lattice, variance_mm2),
        }
    }

    /// What a regular lattice of free markers leaves of a marker's pressure, and the share of its variance
    /// that remains. The marker is at least three rows and columns from the border.
    pub fn left_over(&self, lattice: &Stencils, i: usize, pressure_mm: &[f64]) -> (f64, f64) {
        match self {
            Self::Square(kriging) => kriging.left_over(lattice, i, pressure_mm),
            Self::Hexagonal(kriging) => kriging.left_over(lattice, i, pressure_mm),
        }
    }

    /// Predicts a marker's pressure from those of the free markers around it. Returns the prediction and the
    /// remaining variance.
    pub fn predict(
        &self,
        lattice: &Stencils,
        i: usize,
        is_free: impl Fn(usize) -> bool,
        pressure_mm: &[f64],
    ) -> (f64, f64) {
        match self {
            Self::Square(kriging) => kriging.predict(lattice, i, is_free, pressure_mm),
            Self::Hexagonal(kriging) => kriging.predict(lattice, i, is_free, pressure_mm),
        }
    }
}

/// Simple kriging where a stencil has `T` taps, and shares heights with those of `A` other markers, of which
/// `S - 1` are no mirror images.
#[derive(Clone, Debug)]
pub(super) struct Kriging<const T: usize, const A: usize, const S: usize> {
    sharing: &'static Sharing<T, A, S>,
    /// Covariances with the markers at the offsets `sharing.shared`, row by row.
    shared: Vec<[f64; S]>,
    even: Even<A>,
}

/// A free marker around one: its index in `Sharing::around`, and its own.
#[derive(Clone, Copy, Default)]
struct Near {
    place: usize,
    marker: usize,
}

impl<const T: usize, const A: usize, const S: usize> Kriging<T, A, S> {
    const fn new(sharing: &'static Sharing<T, A, S>) -> Self {
        Self { sharing, shared: Vec::new(), even: Even { weights: [0.0; A], left: 1.0 } }
    }

    fn measure(&mut self, lattice: &Stencils, variance_mm2: &[f64]) {
        let Self { sharing, shared, .. } = self;
        shared.clear();
        shared.resize(lattice.weights.len(), [0.0; S]);
        for (k, &variance) in variance_mm2.iter().enumerate() {
            let from = lattice.topology.row_and_col(k);
            // Markers whose stencils include this one, and its weight there.
            let (mut whose, mut weights) = ([k; T], [0.0; T]);
            for (tap, &offset) in sharing.taps.iter().enumerate() {
                if let Some(i) = lattice.topology.offset_from(from, offset) {
                    // Taps are sorted, so that the opposite one is as far from the end.
                    (whose[tap], weights[tap]) = (i, lattice.weight(i, sharing.kinds[T - 1 - tap]));
                }
            }
            for (a, &i) in whose.iter().enumerate().filter(|&(a, _)| weights[a] != 0.0) {
                let scaled = weights[a] * variance;
                for b in a..T {
                    shared[i][sharing.cross[a][b]] += scaled * weights[b];
                }
            }
        }
    }

    fn left_over(&self, lattice: &Stencils, i: usize, pressure_mm: &[f64]) -> (f64, f64) {
        let from = lattice.topology.row_and_col(i);
        let mut left_mm = pressure_mm[i];
        for (&offset, weight) in self.sharing.around.iter().zip(&self.even.weights) {
            if let Some(k) = lattice.topology.offset_from(from, offset) {
                left_mm -= weight * pressure_mm[k];
            }
        }
        (left_mm, self.even.left)
    }

    fn predict(
        &self,
        lattice: &Stencils,
        i: usize,
        is_free: impl Fn(usize) -> bool,
        pressure_mm: &[f64],
    ) -> (f64, f64) {
        let from = lattice.topology.row_and_col(i);
        let (mut near, mut values, mut count) = ([Near::default(); A], [0.0; A], 0);
        for (place, &offset) in self.sharing.around.iter().enumerate() {
            let Some(marker) = lattice.topology.offset_from(from, offset) else { continue };
            if is_free(marker) {
                (near[count], values[count]) = (Near { place, marker }, pressure_mm[marker]);
                count += 1;
            }
        }
        let near = &near[..count];
        let mut noise = Noise { own: self.shared[i][0], cross: [0.0; A], among: [[0.0; A]; A] };
        for (k, &Near { place, marker }) in near.iter().enumerate() {
            noise.cross[k] = if self.sharing.around[place] < (0, 0) {
                self.shared[marker][self.sharing.own[place]]
            } else {
                self.shared[i][self.sharing.own[place]]
            };
            for (among, other) in noise.among[k].iter_mut().zip(&near[..=k]) {
                let pair = self.sharing.pairs[place][other.place];
                *among = self.shared[other.marker].get(pair).copied().unwrap_or(0.0);
            }
        }
        noise.predict(count, &values)
    }
}

/// Variance of a marker's pressure, and its covariances with, and among, those around it.
struct Noise<const A: usize> {
    own: f64,
    cross: [f64; A],
    /// Lower triangle.
    among: [[f64; A]; A],
}

impl<const A: usize> Noise<A> {
    /// Simple kriging from the first `count` pressures, by a Cholesky factor of the covariance matrix.
    fn predict(&self, count: usize, pressure_mm: &[f64; A]) -> (f64, f64) {
        let (mut factor, mut half, mut values) = ([[0.0; A]; A], [0.0; A], [0.0; A]);
        let (mut predicted, mut left) = (0.0, self.own);
        for i in 0..count {
            let mut row = [0.0; A];
            let among = &self.among[i];
            for j in 0..i {
                let sum: f64 = row[..j].iter().zip(&factor[j][..j]).map(|(a, b)| a * b).sum();
                row[j] = (among[j] - sum) * factor[j][j];
            }
            let before = |list: &[f64; A]| row[..i].iter().zip(list).map(|(a, b)| a * b).sum::<f64>();
            let pivot = (among[i] - before(&row)).max(1e-9 * among[i]);
            // The inverse of the diagonal.
            let inverse = 1.0 / sqrt(pivot);
            (half[i], values[i]) =
                ((self.cross[i] - before(&half)) * inverse, (pressure_mm[i] - before(&values)) * inverse);
            row[i] = inverse;
            factor[i] = row;
            predicted += half[i] * values[i];
            left -= half[i] * half[i];
        }
        (predicted, left.max(1e-9 * self.own))
    }
}

/// Weights of the markers around one in the prediction of its pressure, in a regular lattice of heights of
/// equal variance, and the share of the variance that remains.
#[derive(Clone, Debug)]
struct Even<const A: usize> {
    weights: [f64; A],
    left: f64,
}

impl<const A: usize> Even<A> {
    /// For the weights of the neighbours along each axis.
    fn new<const T: usize, const S: usize>(sharing: &Sharing<T, A, S>, axes: [f64; 3]) -> Self {
        let stencil = |(row, col): Offset| match (row, col) {
            (0, 0) => 1.0 - 2.0 * (axes[0] + axes[1] + axes[2]),
            (0, -1 | 1) => axes[0],
            (-1 | 1, 0) => axes[1],
            (-1, 1) | (1, -1) => axes[2],
            _ => 0.0,
        };
        let alike = |(row, col): Offset| -> f64 {
            sharing.taps.iter().map(|&(r, c)| stencil((r, c)) * stencil((r - row, c - col))).sum()
        };
        let noise = Noise {
            own: alike((0, 0)),
            cross: sharing.around.map(alike),
            among: sharing.around.map(|(a, b)| sharing.around.map(|(row, col)| alike((row - a, col - b)))),
        };
        let mut even = Self { weights: [0.0; A], left: 1.0 };
        for k in 0..A {
            // The prediction is linear: the response to a unit pressure is its weight.
            let mut unit = [0.0; A];
            unit[k] = 1.0;
            (even.weights[k], even.left) = noise.predict(A, &unit);
        }
        even.left /= noise.own;
        even
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::RestSurface;
    use crate::lattice::Topology;
    use crate::math::{DVec3, abs};
    use proptest::prelude::*;

    const SIDE: usize = 7;
    const MARKERS: usize = SIDE * SIDE;

    /// A print of this layout, with its markers up to so far from their places.
    fn stencils(topology: Topology, shift_mm: &[f64]) -> Stencils {
        let row_mm = 0.9 * if topology.is_hexagonal() { sqrt(0.75) } else { 1.0 };
        let at = |i: usize| {
            let (x_mm, y_mm) = (0.9 * topology.along(i), row_mm * (i / SIDE) as f64);
            DVec3::new(x_mm + shift_mm[2 * i], y_mm + shift_mm[2 * i + 1], 30.0)
        };
        let rest = RestSurface::new(&(0..MARKERS).map(at).collect::<Vec<_>>()).unwrap();
        Stencils::new(&rest, topology, 2.0).unwrap()
    }

    /// Covariance of two pressures, from the weights of their stencils.
    fn covariance(lattice: &Stencils, variance_mm2: &[f64], a: usize, b: usize) -> f64 {
        let shared = |(k, weight): (usize, f64)| {
            let others = lattice.taps(b).filter(move |&(other, _)| other == k);
            others.map(move |(_, other)| weight * other * variance_mm2[k])
        };
        lattice.taps(a).flat_map(shared).sum()
    }

    /// Solution of a positive definite system, by elimination.
    fn solved(mut matrix: Vec<Vec<f64>>, mut right: Vec<f64>) -> Vec<f64> {
        for i in 0..right.len() {
            for j in (0..right.len()).filter(|&j| j != i) {
                let share = matrix[j][i] / matrix[i][i];
                let pivot = matrix[i].clone();
                matrix[j].iter_mut().zip(&pivot).for_each(|(a, b)| *a -= share * b);
                right[j] -= share * right[i];
            }
        }
        right.iter().enumerate().map(|(i, value)| value / matrix[i][i]).collect()
    }

    fn topologies() -> impl Strategy<Value = Topology> {
        prop_oneof![
            Just(Topology::square(SIDE, SIDE)),
            any::<bool>().prop_map(|forward| Topology::hexagonal(SIDE, SIDE, forward)),
        ]
    }

    proptest! {
        /// The prediction is the conditional mean given the free markers whose pressures correlate with it.
        #[test]
        fn predictions_are_conditional_means(
            topology in topologies(), i in 0..MARKERS,
            shift_mm in prop::collection::vec(-0.1..0.1_f64, 2 * MARKERS),
            variance_mm2 in prop::collection::vec(1e-6..1e-4_f64, MARKERS),
            pressure_mm in prop::collection::vec(-1.0..1.0_f64, MARKERS),
            free in prop::collection::vec(any::<bool>(), MARKERS),
        ) {
            let lattice = stencils(topology, &shift_mm);
            let mut prediction = Prediction::new(topology.is_hexagonal());
            prediction.measure(&lattice, &variance_mm2);
            let (predicted_mm, left_mm2) = prediction.predict(&lattice, i, |k| free[k], &pressure_mm);
            let of = |a: usize, b: usize| covariance(&lattice, &variance_mm2, a, b);
            let near: Vec<usize> =
                (0..MARKERS).filter(|&k| k != i && free[k] && of(i, k) != 0.0).collect();
            let among = near.iter().map(|&a| near.iter().map(|&b| of(a, b)).collect()).collect();
            let shares = solved(among, near.iter().map(|&k| of(i, k)).collect());
            let mean = |values: &dyn Fn(usize) -> f64| -> f64 {
                shares.iter().zip(&near).map(|(share, &k)| share * values(k)).sum()
            };
            let (expected_mm, expected_mm2) = (mean(&|k| pressure_mm[k]), of(i, i) - mean(&|k| of(i, k)));
            prop_assert!(abs(predicted_mm - expected_mm) < 1e-6 * (1.0 + abs(expected_mm)), "{predicted_mm}");
            prop_assert!(abs(left_mm2 - expected_mm2) < 1e-6 * of(i, i), "{left_mm2} {expected_mm2}");
        }

        /// Far from the border of a regular lattice, what is left of a pressure is as if it were predicted
        /// from all of the markers around it.
        #[test]
        fn a_regular_lattice_needs_no_covariances(
            topology in topologies(), pressure_mm in prop::collection::vec(-1.0..1.0_f64, MARKERS),
        ) {
            let lattice = stencils(topology, &[0.0; 2 * MARKERS]);
            let (mut prediction, i) = (Prediction::new(topology.is_hexagonal()), MARKERS / 2);
            prediction.measure(&lattice, &[1e-4; MARKERS]);
            let third = if topology.is_hexagonal() { lattice.weight(i, 5) } else { 0.0 };
            prediction.set_even([lattice.weight(i, 1), lattice.weight(i, 3), third]);
            let (predicted_mm, left_mm2) = prediction.predict(&lattice, i, |_| true, &pressure_mm);
            let (left_mm, share) = prediction.left_over(&lattice, i, &pressure_mm);
            prop_assert!(abs(pressure_mm[i] - predicted_mm - left_mm) < 1e-9);
            let own_mm2 = covariance(&lattice, &[1e-4; MARKERS], i, i);
            prop_assert!(abs(left_mm2 - share * own_mm2) < 1e-9 * own_mm2);
        }
    }
}
