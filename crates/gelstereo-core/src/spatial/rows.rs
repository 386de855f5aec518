//! Share of points that stand in rows: a measure of how much they look like a print.

use crate::math::DVec2;

/// Smallest number of points with a share: three rows of three.
pub const MIN_POINTS: usize = 9;
/// Share from which points look like a lattice. With a quarter of its places hidden, a lattice of 4 x 6 still
/// has half of its points in rows; of points at random, a tenth to a seventh are.
pub const MIN_SHARE: f64 = 1.0 / 3.0;
/// Largest distance of a near point, relative to the nearest one. At an edge of a lattice the nearest one may
/// lie inward, with nothing opposite to it.
const MAX_FARTHER: f64 = 1.25;
/// Largest distance of a point from the place opposite to a near one, in steps.
const MAX_OFF: f64 = 0.25;

/// Share of points with two opposite neighbours at equal distance, from a sample of them; `None` for fewer
/// than nine points.
///
/// `points` iterates over all of them, once or twice for each point of the sample.
pub fn share_in_rows<I: Iterator<Item = DVec2>>(points: &impl Fn() -> I, max_sampled: usize) -> Option<f64> {
    let count = points().count();
    if count < MIN_POINTS {
        return None;
    }
    let (mut sampled, mut in_rows) = (0_u32, 0_u32);
    for point in points().step_by(count.div_ceil(max_sampled.max(1))) {
        sampled += 1;
        in_rows += u32::from(is_in_row(point, points));
    }
    Some(f64::from(in_rows) / f64::from(sampled))
}

/// Whether one of the nearest points has another one opposite to it, at the same distance.
fn is_in_row<I: Iterator<Item = DVec2>>(point: DVec2, points: &impl Fn() -> I) -> bool {
    let steps = || points().map(|other| other - point).filter(|step| *step != DVec2::ZERO);
    let nearest2 = steps().map(DVec2::length_squared).fold(f64::INFINITY, f64::min);
    let is_near = |step: &DVec2| step.length_squared() <= MAX_FARTHER * MAX_FARTHER * nearest2;
    steps().filter(is_near).any(|near| {
        let max_off2 = MAX_OFF * MAX_OFF * near.length_squared();
        steps().any(|step| (step + near).length_squared() <= max_off2)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    proptest! {
        /// The share distinguishes a lattice with noise and missing points, at any angle, from random points.
        #[test]
        fn lattices_have_rows_and_random_points_have_few(
            turn in 0.0..6.3_f64, rows in 5_usize..12, cols in 5_usize..12,
            noise in prop::collection::vec((-0.05..0.05_f64, -0.05..0.05_f64), 144),
            hidden in prop::collection::btree_set(0..144_usize, 0..14),
            random in prop::collection::vec((0.0..10.0_f64, 0.0..10.0_f64), 100),
        ) {
            let place = |n: usize| DVec2::new((n % cols) as f64, (n / cols) as f64);
            let off = |n: usize| DVec2::new(noise[n].0, noise[n].1);
            let seen = (0..rows * cols).filter(|n| !hidden.contains(n));
            let lattice: Vec<DVec2> = seen
                .map(|n| DVec2::from_angle(turn).rotate(place(n) + off(n)))
                .collect();
            let share = share_in_rows(&|| lattice.iter().copied(), 256).unwrap();
            prop_assert!(share > 0.5, "{share}");
            let random: Vec<DVec2> = random.iter().map(|&(x, y)| DVec2::new(x, y)).collect();
            let share = share_in_rows(&|| random.iter().copied(), 256).unwrap();
            prop_assert!(share < MIN_SHARE, "{share}");
        }
    }

    #[test]
    fn few_and_equal_points_have_an_answer() {
        let same = [DVec2::ONE; 12];
        assert_eq!(share_in_rows(&|| same.iter().copied(), 256), Some(0.0));
        assert_eq!(share_in_rows(&|| same[..8].iter().copied(), 256), None);
    }
}
