//! Screened membranes over the marker lattice in closed form.
//!
//! On a lattice with free borders, the eigenvectors of the difference operator u - l² Δu are the cosines
//! cos(π k (i + ½) / n) along each axis (Strang 1999). Its eigenvalues are
//! 1 + l² (4 - 2 cos(π k / rows) - 2 cos(π m / cols)), with l in pitches of each axis. So a field is
//! solved by a cosine transform, a division and the inverse transform. These are products with four small
//! matrices, whatever the length l.

use alloc::vec::Vec;
use gelstereo_core::math::{cos, sqrt};

/// A chain of membranes, precomputed for a lattice.
#[derive(Clone, Debug)]
pub(crate) struct Membranes {
    rows: usize,
    cols: usize,
    /// Transform along columns and its inverse, row-major.
    down: [Vec<f64>; 2],
    /// The same along rows, for multiplication from the right.
    across: [Vec<f64>; 2],
    /// Factor of each cosine coefficient.
    gains: Vec<f64>,
}

impl Membranes {
    /// Squared decay lengths in pitches along a row and along a column.
    pub(crate) fn new([rows, cols]: [usize; 2], squares: &[[f64; 2]]) -> Self {
        let bend = |k: usize, n: usize| 2.0 - 2.0 * cos(core::f64::consts::PI * k as f64 / n as f64);
        let gain = |down: f64, across: f64| {
            squares.iter().map(|[x, y]| 1.0 / (1.0 + x * (y / x * down + across))).product()
        };
        let gains = (0..rows * cols).map(|i| gain(bend(i / cols, rows), bend(i % cols, cols))).collect();
        let [along, back] = cosines(cols);
        Self { rows, cols, down: cosines(rows), across: [back, along], gains }
    }

    /// Applies the membranes to a field, in place.
    pub(crate) fn settle(&self, field: &mut Vec<f64>, scratch: &mut Vec<f64>) {
        let Self { rows, cols, down, across, gains } = self;
        multiply(&down[0], field, [*rows, *rows, *cols], scratch);
        multiply(scratch, &across[0], [*rows, *cols, *cols], field);
        field.iter_mut().zip(gains).for_each(|(x, gain)| *x *= gain);
        multiply(field, &across[1], [*rows, *cols, *cols], scratch);
        multiply(&down[1], scratch, [*rows, *rows, *cols], field);
    }
}

/// The orthonormal cosine matrix, row-major, and its transpose.
fn cosines(n: usize) -> [Vec<f64>; 2] {
    let at = |k: usize, i: usize| {
        let scale = sqrt(if k == 0 { 1.0 } else { 2.0 } / n as f64);
        scale * cos(core::f64::consts::PI * k as f64 * (i as f64 + 0.5) / n as f64)
    };
    [(0..n * n).map(|e| at(e / n, e % n)).collect(), (0..n * n).map(|e| at(e % n, e / n)).collect()]
}

/// Product of an n×m and an m×p matrix.
fn multiply(a: &[f64], b: &[f64], [n, m, p]: [usize; 3], out: &mut Vec<f64>) {
    out.clear();
    out.resize(n * p, 0.0);
    for (a, out) in a.chunks_exact(m).zip(out.chunks_exact_mut(p)) {
        let (fours, rest) = a.as_chunks::<4>();
        let (of_fours, of_rest) = b.split_at(4 * p * fours.len());
        // Four at once: fewer loads and stores of the sums.
        for (a, b) in fours.iter().zip(of_fours.chunks_exact(4 * p)) {
            let [b0, b1, b2, b3] = [0, 1, 2, 3].map(|k| &b[k * p..][..p]);
            for ((((out, x), y), z), w) in out.iter_mut().zip(b0).zip(b1).zip(b2).zip(b3) {
                *out += (a[0] * x + a[1] * y) + (a[2] * z + a[3] * w);
            }
        }
        for (a, b) in rest.iter().zip(of_rest.chunks_exact(p)) {
            out.iter_mut().zip(b).for_each(|(out, x)| *out += a * x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::screened::tests::plainly_relaxed;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]

        /// The reference is relaxation, which leaves 1e-10; the rest is round-off.
        #[test]
        fn membranes_are_what_relaxation_ends_at(
            rows in 2..14_usize, cols in 2..14_usize, first in 0.05..4.0, second in 0.05..4.0,
            heights in prop::collection::vec(0.0..2.0, 13 * 13),
        ) {
            let mut found = heights[..rows * cols].to_vec();
            let mut relaxed = found.clone();
            let squares = [first, second].map(|length| [length * length; 2]);
            Membranes::new([rows, cols], &squares).settle(&mut found, &mut Vec::new());
            for length in [first, second] {
                let source = relaxed.clone();
                plainly_relaxed([rows, cols], length, &mut relaxed, |i| source[i], |_, u| u);
            }
            for (found, relaxed) in found.iter().zip(&relaxed) {
                prop_assert!((found - relaxed).abs() < 1e-9, "{found} {relaxed}");
            }
        }
    }
}
