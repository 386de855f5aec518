//! Covariance of the points due to bending of the gel within a dot.

use crate::detect::fold_law::{add_moved, add_weighed};
use crate::lattice::Topology;
use crate::math::DVec3;
use crate::math::linalg::Symmetric;

/// Radius of a dot in pitches where it is unknown: 0.2 to 0.3 are usual.
const USUAL_RADIUS_PITCHES: f64 = 0.25;
/// Square of a fold that noise explains, over the variance of a point: twice the mean, which is the sum of
/// the squared coefficients in `fold` for both frames. Once to three times: mean point NSE 1.04 to 1.12 of
/// `balanced` (path-traced, development half). With once, noise alone widens covariances by a tenth.
const MAX_FOLD_NOISE: f64 = 2.0 * 2.0 * 17.5;

/// Adds the effect of bending within the dots to the points' covariances.
///
/// At the rim of a contact the gel folds; [`fold_law`](crate::detect::fold_law) has what that does to a dot.
/// Where a fold lies between the markers is unknown. Its square is therefore the mean over the marker (half)
/// and its neighbours on both sides (a quarter each). What noise alone makes of it changes no weight. The sum
/// over the three axes of a hexagonal print counts every bend one and a half times.
pub(super) fn add(
    topology: Topology,
    radius_pitches: Option<f64>,
    (rest_mm, points_mm): (&[DVec3], &[DVec3]),
    covariance_mm2: &mut [Symmetric<3>],
) {
    let radius = radius_pitches.unwrap_or(USUAL_RADIUS_PITCHES);
    let cube = radius * radius * radius;
    let share_of_axis = 2.0 / topology.axes() as f64;
    for (i, covariance) in covariance_mm2.iter_mut().enumerate() {
        let noise = MAX_FOLD_NOISE * (covariance[0][0] + covariance[1][1] + covariance[2][2]);
        let place = (i / topology.cols(), i % topology.cols());
        for axis in 0..topology.axes() {
            let line: [Option<usize>; 7] =
                core::array::from_fn(|k| topology.step_from(place, axis, k as isize - 3));
            let (Some(before), Some(after)) = (line[2], line[4]) else { continue };
            let mut square = 0.0;
            for (k, share) in [(2, 0.25), (3, 0.5), (4, 0.25)] {
                if let [Some(a), Some(b), Some(c), Some(d), Some(e)] = line[k - 2..=k + 2] {
                    let fold = fold([a, b, c, d, e].map(|i| points_mm[i] - rest_mm[i]));
                    let share = share * share_of_axis;
                    add_moved(covariance, cube, share, fold.to_array());
                    square += share * fold.length_squared();
                }
            }
            let along = (points_mm[after] - points_mm[before]).normalize_or_zero();
            add_weighed(covariance, cube, (square - noise).max(0.0), along.to_array());
        }
    }
}

/// The fold near a marker: the second difference there of the motion since rest, minus the mean of those at
/// its neighbours. It is zero for a smooth bend, where all three are equal.
fn fold([a, before, here, after, b]: [DVec3; 5]) -> DVec3 {
    let (beside, beyond) = (before + after, a + b);
    // a(i) - (a(i - 1) + a(i + 1)) / 2 of the second differences a.
    beside * 2.0 - here * 3.0 - beyond * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{abs, sqrt};
    use alloc::vec::Vec;
    use core::f64::consts::PI;

    const COLS: usize = 9;
    const MIDDLE: usize = 4 * COLS + 4;
    const RADIUS: f64 = 0.25;
    /// Small, so that the surface stays along x.
    const ANGLE: f64 = 1e-3;

    fn rest_mm() -> Vec<DVec3> {
        (0..COLS * COLS).map(|i| DVec3::new((i % COLS) as f64, (i / COLS) as f64, 0.0)).collect()
    }

    /// Covariance added at the centre of a lattice of pitch 1 whose markers rise by this.
    fn added(before_mm2: f64, rise_mm: impl Fn(DVec3) -> f64) -> Symmetric<3> {
        let rest_mm = rest_mm();
        let points_mm: Vec<DVec3> = rest_mm.iter().map(|&p| p + DVec3::Z * rise_mm(p)).collect();
        let mut covariance_mm2 = [[[before_mm2; 3]; 3]; COLS * COLS];
        add(Topology::square(COLS, COLS), Some(RADIUS), (&rest_mm, &points_mm), &mut covariance_mm2);
        covariance_mm2[MIDDLE].map(|row| row.map(|entry| entry - before_mm2))
    }

    /// Sum of this over folds by a small angle anywhere within three pitches of the centre, a hundred in a
    /// pitch.
    fn summed<T: core::iter::Sum>(of: impl Fn(f64) -> T) -> T {
        (0..600).map(|n| of((n as f64 + 0.5) / 100.0 - 3.0)).sum()
    }

    #[test]
    fn a_smooth_bend_adds_nothing() {
        let smooth = added(0.0, |p| 0.3 - 0.1 * p.x + 0.02 * p.x * p.x - 0.05 * p.x * p.y);
        assert!(smooth.as_flattened().iter().all(|entry| abs(*entry) < 1e-28), "{smooth:?}");
    }

    /// Compared with the squared offsets of a disc's mean from its centre, by sums over strips of the disc.
    #[test]
    fn folds_anywhere_add_the_mean_square_of_what_they_move() {
        const STRIPS: usize = 400;
        // Share of the disc and place of each strip, in pitches.
        let strips: Vec<(f64, f64)> = (0..STRIPS)
            .map(|n| (n as f64 + 0.5) / STRIPS as f64 * 2.0 - 1.0)
            .map(|x| (sqrt(1.0 - x * x) * 4.0 / (PI * STRIPS as f64), RADIUS * x))
            .collect();
        let mean = |of: &dyn Fn(f64) -> f64| strips.iter().map(|&(share, x)| share * of(x)).sum::<f64>();
        let beyond = |x: f64, fold: f64| (x - fold).max(0.0);
        let moved = summed(|fold| {
            let off = ANGLE * (mean(&|x| beyond(x, fold)) - beyond(0.0, fold));
            off * off
        });
        let weighed = summed(|fold| {
            let off = ANGLE * mean(&|x| if x > fold { x } else { 0.0 });
            off * off
        });
        let found =
            |entry: usize| summed(|fold| added(0.0, |p| ANGLE * beyond(p.x - 4.0, fold))[entry][entry]);
        assert!(abs(found(2) / moved - 1.0) < 0.02, "{} {moved}", found(2));
        assert!(abs(found(0) / weighed - 1.0) < 0.02, "{} {weighed}", found(0));
        assert!(found(1) < 1e-9 * weighed);
    }

    #[test]
    fn what_noise_explains_changes_no_weight() {
        let fold = |p: DVec3| ANGLE * (p.x - 4.0).max(0.0);
        let known = added(0.0, fold)[0][0];
        let noisy = added(ANGLE * ANGLE, fold)[0][0];
        assert!(known > 0.0 && noisy == 0.0, "{known} {noisy}");
    }
}
