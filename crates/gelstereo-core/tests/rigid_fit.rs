//! Rows 5, 6 and 9 of the hard cases for the rigid motion between two sets of points.
// A test may stop at what it did not expect.
#![allow(clippy::unwrap_used)]

use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DMat3, DQuat, DVec3, Pose, so3};
use gelstereo_core::register::{RigidFitError, rigid_fit};
use proptest::prelude::*;

const EPS: f64 = f64::EPSILON;

fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-limit..limit).prop_map(DVec3::from_array)
}

fn angle_between(a: DQuat, b: DQuat) -> f64 {
    so3::log(a * b.conjugate()).length()
}

fn sum_of_squares(pose: &Pose, source: &[DVec3], target: &[DVec3]) -> f64 {
    source.iter().zip(target).map(|(&a, &b)| pose.transform_point(a).distance_squared(b)).sum()
}

proptest! {
    #[test]
    fn row_05_a_rigid_motion_is_found_again(
        points in prop::collection::vec(vector(10.0), 4..30), omega in vector(1.8), v in vector(50.0),
    ) {
        let truth = Pose::exp(omega, v);
        let target: Vec<DVec3> = points.iter().map(|&p| truth.transform_point(p)).collect();
        let fit = rigid_fit(&points, &target, &[]).unwrap();
        // Rotation by round-off of the coordinates, up to 100 mm, over the radius of the second principal
        // axis.
        let radius = second_radius(&points);
        prop_assume!(radius > 1e-3);
        let bound = 32.0 * EPS * 100.0 / radius;
        prop_assert_eq!(fit.free_rotations, 0);
        prop_assert!(angle_between(fit.t_target_source.rotation, truth.rotation) <= bound);
        for (&p, &q) in points.iter().zip(&target) {
            prop_assert!(fit.t_target_source.transform_point(p).distance(q) <= 40.0 * bound);
        }
    }

    #[test]
    fn row_05_mirrored_points_get_the_best_rotation_and_never_a_reflection(
        points in prop::collection::vec(vector(10.0), 4..20),
        others in prop::collection::vec(vector(1.5), 64),
    ) {
        let target: Vec<DVec3> = points.iter().map(|p| DVec3::new(-p.x, p.y, p.z)).collect();
        let fit = rigid_fit(&points, &target, &[]).unwrap();
        let pose = fit.t_target_source;
        prop_assert!((DMat3::from_quat(pose.rotation).determinant() - 1.0).abs() < 16.0 * EPS);
        let best = sum_of_squares(&pose, &points, &target);
        // No other rotation about the centroids does better, near or far.
        for omega in others {
            for scale in [1.0, 1e-3] {
                let rotation = so3::exp(omega * scale) * pose.rotation;
                let source_mean = gelstereo_core::math::centroid(&points);
                let target_mean = gelstereo_core::math::centroid(&target);
                let other = Pose { rotation, translation_mm: target_mean - rotation * source_mean };
                prop_assert!(sum_of_squares(&other, &points, &target) >= best * (1.0 - 64.0 * EPS));
            }
        }
    }

    #[test]
    fn row_05_a_pair_with_weight_two_counts_like_two_pairs(
        points in prop::collection::vec(vector(10.0), 5..10),
        shifts in prop::collection::vec(vector(1.0), 10),
    ) {
        let target: Vec<DVec3> = points.iter().zip(&shifts).map(|(&p, &s)| p + s).collect();
        let mut weights = vec![1.0; points.len()];
        weights[0] = 2.0;
        weights[1] = 0.0;
        let weighted = rigid_fit(&points, &target, &weights).unwrap().t_target_source;
        let with = |v: &[DVec3]| { let mut v = v.to_vec(); v[1] = v[0]; v };
        let doubled = rigid_fit(&with(&points), &with(&target), &[]).unwrap().t_target_source;
        // Condition: the smallest gap of Horn's eigenvalues is at least the square of the second radius.
        let radius = second_radius(&with(&points));
        prop_assume!(radius > 1.0);
        prop_assert!(angle_between(weighted.rotation, doubled.rotation) <= 1e4 * EPS / (radius * radius));
    }
}

/// Rms distance of the points from the line that is nearest to them.
fn second_radius(points: &[DVec3]) -> f64 {
    let mean = gelstereo_core::math::centroid(points);
    let mut scatter = [[0.0; 3]; 3];
    for &p in points {
        let d = (p - mean).to_array();
        for i in 0..3 {
            for j in 0..3 {
                scatter[i][j] += d[i] * d[j] / points.len() as f64;
            }
        }
    }
    let values = gelstereo_core::math::linalg::eigen(&scatter).values;
    (values[0] + values[1]).max(0.0).sqrt()
}

#[test]
fn row_05_coplanar_collinear_single_and_identical_points_turn_no_more_than_they_must() {
    let quarter = Pose::exp(DVec3::Z * std::f64::consts::FRAC_PI_2, DVec3::new(1.0, 2.0, 3.0));
    let moved = |points: &[DVec3]| points.iter().map(|&p| quarter.transform_point(p)).collect::<Vec<_>>();
    let plane = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(1.0, 1.0, 0.0)];
    let fit = rigid_fit(&plane, &moved(&plane), &[]).unwrap();
    assert_eq!(fit.free_rotations, 0);
    assert!(angle_between(fit.t_target_source.rotation, quarter.rotation) < 8.0 * EPS);

    // The line turns by a quarter about z; the spin about it stays out.
    let line = [DVec3::ZERO, DVec3::X, DVec3::X * 3.0];
    let fit = rigid_fit(&line, &moved(&line), &[]).unwrap();
    assert_eq!(fit.free_rotations, 1);
    assert!(angle_between(fit.t_target_source.rotation, quarter.rotation) < 8.0 * EPS);

    // A line reversed: half a turn about some axis across it.
    let reversed: Vec<DVec3> = line.iter().map(|&p| -p).collect();
    let fit = rigid_fit(&line, &reversed, &[]).unwrap();
    assert_eq!(fit.free_rotations, 1);
    assert!(sum_of_squares(&fit.t_target_source, &line, &reversed) < 1e-29);

    for same in [vec![DVec3::new(5.0, 1.0, -2.0)], vec![DVec3::new(0.1, 0.2, 0.3); 7]] {
        let fit = rigid_fit(&same, &moved(&same), &[]).unwrap();
        assert_eq!((fit.free_rotations, fit.t_target_source.rotation), (3, DQuat::IDENTITY));
        assert!(sum_of_squares(&fit.t_target_source, &same, &moved(&same)) < 1e-28);
    }
    // So far away for their distance that not even the bound of round-off is a number.
    let far = [DVec3::new(1e150, 0.0, 0.0), DVec3::new(1e150, 1e-300, 0.0)];
    assert_eq!(rigid_fit(&far, &[DVec3::ONE; 2], &[]).unwrap().free_rotations, 3);
}

proptest! {
    /// Collinear points turn by the angle between their lines, about the axis across both: others turn more.
    #[test]
    fn row_05_a_line_turns_no_more_than_it_must(
        (a, b) in (vector(1.0), vector(1.0)), steps in prop::collection::vec(-3.0..3.0_f64, 2..12),
        from in vector(1e3), to in vector(1e3),
    ) {
        let (a, b) = (a.normalize_or(DVec3::X), b.normalize_or(DVec3::Y));
        let spread = steps.iter().fold(0.0_f64, |m, s| m.max((s - steps[0]).abs()));
        prop_assume!(spread > 0.1 && a.dot(b).abs() < 0.99);
        let line = |at: DVec3, along: DVec3| steps.iter().map(|s| at + along * *s).collect::<Vec<_>>();
        let fit = rigid_fit(&line(from, a), &line(to, b), &[]).unwrap();
        prop_assert_eq!(fit.free_rotations, 1);
        let least = so3::exp(a.cross(b).normalize() * a.angle_between(b));
        // A direction is known to the coordinates' rounding over the line's length, and the axis of the turn
        // to that over the sine of the angle.
        let bound = 64.0 * EPS * 1e3 / spread / a.cross(b).length();
        prop_assert!(angle_between(fit.t_target_source.rotation, least) <= bound.max(1e-14));
    }
}

/// A line that is 1e-12 off straight determines the spin, and one that is straight to the rounding of its
/// coordinates, far away, does not, whatever it is matched with.
#[test]
fn row_05_a_line_is_straight_to_its_own_round_off() {
    let targets =
        [DVec3::ZERO, DVec3::new(1.0, 0.2, 0.1), DVec3::new(2.1, -0.3, 0.6), DVec3::new(2.7, 0.4, -0.5)];
    let line = |along: DVec3, bend: f64, at: f64| -> Vec<DVec3> {
        let point = |k: u32| along * f64::from(k) + DVec3::new(at, -at, 0.5 * at);
        (0..4).map(|k| point(k) + DVec3::new(0.0, 1.0, -1.0) * bend * f64::from(k * k)).collect()
    };
    let free = |source: &[DVec3]| rigid_fit(source, &targets, &[]).unwrap().free_rotations;
    assert_eq!(free(&line(DVec3::X, 1e-12, 0.0)), 0);
    assert_eq!(free(&line(DVec3::X, 0.0, 0.0)), 1);
    // Thirds are rounded differently at every place.
    assert_eq!(free(&line(DVec3::new(1.0, 1.0 / 3.0, 0.7), 0.0, 1e6 / 3.0)), 1);
}

/// Sums over far-off clouds are taken from their means, not from the origin.
#[test]
fn row_09_a_fit_of_many_points_far_away_rounds_no_more_than_their_coordinates() {
    let mut random = Stream::new(9, "far");
    let source: Vec<DVec3> =
        (0..40_000).map(|_| DVec3::new(random.normal(), random.normal(), random.normal())).collect();
    let far = DVec3::new(1e9, -1e9, 5e8);
    let target: Vec<DVec3> = source.iter().map(|&p| p + far).collect();
    let shift = rigid_fit(&source, &target, &[]).unwrap().t_target_source;
    // Every coordinate is rounded by eps/2 of 1e9 at most, and their mean by as much again; the source is
    // where it was.
    let mean = gelstereo_core::math::centroid(&source);
    assert!((shift.transform_point(mean) - mean - far).length() <= 3.0 * EPS * 1e9);
}

#[test]
fn row_05_a_mirrored_tetrahedron_has_no_unique_rotation_and_gets_a_valid_one() {
    let source =
        [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]].map(DVec3::from_array);
    let fit = rigid_fit(&source, &source.map(|p| -p), &[]).unwrap();
    assert_eq!(fit.free_rotations, 2);
    assert!((fit.t_target_source.rotation.length() - 1.0).abs() < 4.0 * EPS);
}

#[test]
fn row_06_weights_and_points_that_mean_nothing_are_refused() {
    let p = [DVec3::ZERO, DVec3::X, DVec3::Y];
    let weights = |w: [f64; 3]| rigid_fit(&p, &p, &w).map(|_| ());
    assert_eq!(weights([0.0; 3]), Err(RigidFitError::ZeroWeight));
    assert_eq!(weights([1.0, -1.0, 1.0]), Err(RigidFitError::Weight { index: 1, found: -1.0 }));
    assert!(matches!(weights([1.0, 1.0, f64::NAN]), Err(RigidFitError::Weight { index: 2, .. })));
    assert!(matches!(weights([f64::INFINITY, 1.0, 1.0]), Err(RigidFitError::Weight { index: 0, .. })));
    assert_eq!(rigid_fit(&[], &[], &[]).map(|_| ()), Err(RigidFitError::Empty));
    assert_eq!(
        rigid_fit(&p, &p[..2], &[]).map(|_| ()),
        Err(RigidFitError::Lengths { source: 3, target: 2, weights: 0 })
    );
    // In each coordinate by itself: a NaN beside numbers is no largest one. Squares of what is beyond 1e150
    // overflow.
    for (axis, bad) in (0..3).flat_map(|axis| [f64::NAN, f64::INFINITY, -1e151].map(|bad| (axis, bad))) {
        let mut q = p;
        q[1][axis] = bad;
        for (source, target) in [(&p, &q), (&q, &p)] {
            let found = rigid_fit(source, target, &[]).map(|_| ());
            assert_eq!(found, Err(RigidFitError::NotFinite { index: 1 }), "{axis} {bad}");
        }
    }
    assert!(rigid_fit(&p.map(|x| x * 1e150), &p, &[]).is_ok());
}

/// It is left out of sums, means and what is known of round-off, however far away it is; and one that hardly
/// counts leaves the others what they know.
#[test]
fn row_06_a_pair_of_weight_zero_does_not_count() {
    let mut random = Stream::new(6, "zero");
    let mut vector = |size: f64| DVec3::new(random.normal(), random.normal(), random.normal()) * size;
    let omega = vector(0.5);
    for (size, far, light) in [
        (1.0, 0.0, 0.0),
        (1.0, 1e12, 0.0),
        (1.0, 1e150, 0.0),
        (1e-200, 1e150, 0.0),
        (1.0, 1e12, 1e-45),
        (1.0, 1e140, 1e-300),
    ] {
        let truth = Pose::exp(omega, vector(3.0 * size));
        let source: Vec<DVec3> = (0..10).map(|_| vector(size)).collect();
        let target: Vec<DVec3> = source.iter().map(|&p| truth.transform_point(p)).collect();
        let weights: Vec<f64> = (0..10).map(|k| 1.0 - f64::from(k) / 13.0).collect();
        let alone = rigid_fit(&source, &target, &weights).unwrap();
        let with = |v: &[DVec3]| [&[DVec3::new(1.0, 1.0 / 3.0, -0.7) * far], v].concat();
        let fit =
            rigid_fit(&with(&source), &with(&target), &[&[light], weights.as_slice()].concat()).unwrap();
        assert_eq!(fit.free_rotations, 0);
        let (a, b) = (alone.t_target_source, fit.t_target_source);
        // Coordinates of 10 sizes, to rounding and the condition of ten points.
        assert!(angle_between(a.rotation, b.rotation) < 64.0 * EPS, "{far:e}");
        assert!(a.translation_mm.distance(b.translation_mm) < 640.0 * EPS * size, "{far:e}");
    }
}

#[test]
fn row_06_weights_of_any_size_count_by_their_ratios() {
    let source = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(0.3, 0.2, 1.0)];
    let target = [DVec3::Z, DVec3::X * 1.1, DVec3::Y * 0.9, DVec3::new(-0.3, 0.7, 1.5)];
    let fit = |unit: f64| rigid_fit(&source, &target, &[1.0, 0.5, 0.25, 0.75].map(|w| w * unit)).unwrap();
    // Powers of two, near the ends of what a number can be; sums of such weights overflow or lose all digits.
    for unit in [2.0_f64.powi(1023), 2.0_f64.powi(-1070)] {
        assert_eq!(fit(unit), fit(1.0));
    }
}
