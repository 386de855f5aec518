//! Whether a part with a smooth surface explains the heights of a region of markers.
//!
//! A marker in contact lies on the part, and most parts are smooth over a contact of a few millimetres.
//! Free gel leaves the part at the border of the contact, by more than noise within a pitch or two. So a
//! region in which one quadratic polynomial gives all heights is hardly larger than the contact.

use crate::lattice::Topology;
use crate::math::Factor;

/// Terms of a quadratic polynomial in two coordinates.
const TERMS: usize = 6;
/// Fewest markers that test a polynomial, which leaves four residuals. With 8, 10 and 14 the mean F1 of the
/// adaptive rule over five laws is 0.914, 0.912 and 0.906 (deviations of 2 %, a share of the score of 0.8).
const MIN_MARKERS: u32 = 10;

/// Mean squared residual of a region's heights from their quadratic polynomial by least squares, over their
/// variances and per degree of freedom. `None` with too few markers, or if they lie on a conic section.
pub(super) fn mean_square(
    topology: Topology,
    heights_mm: &[f64],
    region: &[bool],
    variance_mm2: impl Fn(usize) -> f64,
) -> Option<f64> {
    let markers = || region.iter().enumerate().filter(|(_, is_in)| **is_in).map(|(i, _)| i);
    let place = |i: usize| [topology.along(i), topology.row_and_col(i).0 as f64];
    let (mut count, mut sums) = (0_u32, [0.0; 2]);
    for i in markers() {
        let [x, y] = place(i);
        (count, sums) = (count + 1, [sums[0] + x, sums[1] + y]);
    }
    if count < MIN_MARKERS {
        return None;
    }
    let middle = sums.map(|sum| sum / f64::from(count));
    // A polynomial stays one under a linear map, so coordinates in places of the print do for any print.
    let terms = |i: usize| {
        let [x, y] = place(i);
        let (x, y) = (x - middle[0], y - middle[1]);
        [1.0, x, y, x * x, x * y, y * y]
    };
    let (mut matrix, mut right) = ([[0.0; TERMS]; TERMS], [0.0; TERMS]);
    for i in markers() {
        let (terms, weight) = (terms(i), 1.0 / variance_mm2(i));
        for a in 0..TERMS {
            right[a] += weight * terms[a] * heights_mm[i];
            (0..=a).for_each(|b| matrix[a][b] += weight * terms[a] * terms[b]);
        }
    }
    let polynomial = Factor::new(&matrix)?.solve(&right);
    let square = |i: usize| {
        let height_mm: f64 = terms(i).iter().zip(&polynomial).map(|(term, factor)| term * factor).sum();
        let off_mm = heights_mm[i] - height_mm;
        off_mm * off_mm / variance_mm2(i)
    };
    Some(markers().map(square).sum::<f64>() / (f64::from(count) - TERMS as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::random::Stream;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    const SIDE: usize = 15;

    proptest! {
        /// Noise gives the mean of a chi-squared distribution over its degrees of freedom, whatever the
        /// polynomial and the print. Of 100 draws with 107 degrees of freedom it is 1 within five times
        /// √(2 / 10700).
        #[test]
        fn a_polynomial_with_noise_has_a_mean_square_of_one(
            factors in prop::array::uniform6(-0.1..0.1_f64),
            seed in any::<u64>(),
            is_hexagonal in any::<bool>(),
        ) {
            let topology = if is_hexagonal {
                Topology::hexagonal(SIDE, SIDE, true)
            } else {
                Topology::square(SIDE, SIDE)
            };
            let region: Vec<bool> = (0..topology.places()).map(|i| {
                let (row, col) = topology.row_and_col(i);
                row.abs_diff(7).pow(2) + col.abs_diff(7).pow(2) <= 36
            }).collect();
            let mut stream = Stream::new(seed, "smooth");
            let count = region.iter().filter(|is_in| **is_in).count();
            let mut sum = 0.0;
            for _ in 0..100 {
                let heights_mm: Vec<f64> = (0..topology.places()).map(|i| {
                    let [x, y] = [0.7 * topology.along(i), 0.6 * topology.row_and_col(i).0 as f64];
                    let terms = [1.0, x, y, x * x, x * y, y * y];
                    terms.iter().zip(factors).map(|(term, factor)| term * factor).sum::<f64>()
                        + 0.01 * stream.normal()
                }).collect();
                sum += mean_square(topology, &heights_mm, &region, |_| 1e-4).unwrap() / 100.0;
            }
            let sigma = crate::math::sqrt(2.0 / (100.0 * (count - TERMS) as f64));
            prop_assert!((sum - 1.0).abs() < 5.0 * sigma, "{sum}");
        }
    }

    #[test]
    fn too_few_markers_and_markers_in_one_row_test_nothing() {
        let topology = Topology::square(SIDE, SIDE);
        let heights_mm = [0.1; SIDE * SIDE];
        let first = |count: usize| (0..SIDE * SIDE).map(|i| i < count).collect::<Vec<_>>();
        assert_eq!(mean_square(topology, &heights_mm, &first(9), |_| 1e-4), None);
        assert_eq!(mean_square(topology, &heights_mm, &first(SIDE), |_| 1e-4), None);
    }
}
