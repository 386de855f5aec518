//! Covariance of the points due to bending of the gel within a dot.

use crate::math::DVec3;
use crate::math::linalg::Symmetric;

/// Radius of a dot in pitches where it is unknown: 0.2 to 0.3 are usual.
const USUAL_RADIUS_PITCHES: f64 = 0.25;
/// Mean square offset of a dot's mean position from its centre, for a fold anywhere within a pitch of the
/// centre, divided by the cube of the radius in pitches and the square of the fold. It is half the
/// integral of (E max(x - t, 0) - max(-t, 0))² over t, for x across a disc of radius 1.
const FOLD: f64 = 0.5 * 0.015_6;

/// Adds the effect of bending within the dots to the points' covariances.
///
/// At the rim of a contact the gel folds, and a fold within a dot shifts the dot's mean position from its
/// centre. The fold near a marker is the second difference there of the motion since rest, minus the mean
/// of those at its neighbours: a smooth bend is equal at all three. Rows have `cols` markers. Markers in
/// the two outermost rows and columns only count the folds along them.
pub(super) fn add(
    cols: usize,
    radius_pitches: Option<f64>,
    (rest_mm, points_mm): (&[DVec3], &[DVec3]),
    covariance_mm2: &mut [Symmetric<3>],
) {
    let radius = radius_pitches.unwrap_or(USUAL_RADIUS_PITCHES);
    let share = FOLD * radius * radius * radius;
    let count = points_mm.len();
    let moved = |i: usize| points_mm[i] - rest_mm[i];
    for (i, covariance) in covariance_mm2.iter_mut().enumerate() {
        let (row_start, stride) = (i - i % cols, cols);
        let is_inner =
            [i >= row_start + 2 && i + 2 < row_start + cols, i >= 2 * stride && i + 2 * stride < count];
        for (step, _) in [1, stride].into_iter().zip(is_inner).filter(|(_, is_inner)| *is_inner) {
            let (beside, beyond) =
                (moved(i - step) + moved(i + step), moved(i - 2 * step) + moved(i + 2 * step));
            // a(i) - (a(i - 1) + a(i + 1)) / 2 of the second differences a.
            let fold = beside * 2.0 - moved(i) * 3.0 - beyond * 0.5;
            for (row, along) in covariance.iter_mut().zip(fold.to_array()) {
                for (entry, across) in row.iter_mut().zip(fold.to_array()) {
                    *entry += share * (along * across);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{abs, sqrt};
    use alloc::vec::Vec;

    const COLS: usize = 9;
    const MIDDLE: usize = 4 * COLS + 4;

    fn rest_mm() -> Vec<DVec3> {
        (0..COLS * COLS).map(|i| DVec3::new((i % COLS) as f64, (i / COLS) as f64, 0.0)).collect()
    }

    /// Variance along z added at the centre of a lattice of pitch 1 whose markers rise by this.
    fn added(rise_mm: impl Fn(DVec3) -> f64) -> f64 {
        let rest_mm = rest_mm();
        let points_mm: Vec<DVec3> = rest_mm.iter().map(|&p| p + DVec3::Z * rise_mm(p)).collect();
        let mut covariance_mm2 = [[[0.0; 3]; 3]; COLS * COLS];
        add(COLS, Some(0.25), (&rest_mm, &points_mm), &mut covariance_mm2);
        covariance_mm2[MIDDLE][2][2]
    }

    #[test]
    fn a_smooth_bend_adds_nothing() {
        assert!(added(|p| 0.3 - 0.1 * p.x + 0.02 * p.x * p.x - 0.05 * p.x * p.y) < 1e-28);
    }

    /// Compared with the squared offset of a disc's mean height from its centre's height, averaged over
    /// folds anywhere within a pitch of the centre, by sums over strips of the disc.
    #[test]
    fn a_fold_adds_the_mean_square_of_what_it_moves() {
        let (radius, folds, strips) = (0.25, 800, 400);
        let step = |n: usize, count: usize| (n as f64 + 0.5) / count as f64 * 2.0 - 1.0;
        let mut mean_square = 0.0;
        for fold in (0..folds).map(|n| step(n, folds)) {
            let (mut rise, mut width) = (0.0, 0.0);
            for x in (0..strips).map(|n| step(n, strips)) {
                let weight = sqrt(1.0 - x * x);
                rise += weight * (radius * x - fold).max(0.0);
                width += weight;
            }
            let off = rise / width - (-fold).max(0.0);
            mean_square += off * off / folds as f64;
        }
        let found = added(|p| (p.x - 4.0).max(0.0));
        assert!(abs(found / mean_square - 1.0) < 0.02, "{found} {mean_square}");
    }
}
