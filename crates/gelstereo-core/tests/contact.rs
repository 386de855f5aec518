//! Rest plane, saliency, motion; and the frames from sensor to base.

use gelstereo_core::contact::{
    ContactError, Pressure, RestSurface, mean_motion_px, patch, saliency, variance_along,
};
use gelstereo_core::frames::{FingerKinematics, SensorMount, adjusted_gripper};
use gelstereo_core::math::{DVec2, DVec3, Pose, so3};
use gelstereo_core::track::MarkerState::{Held, Lost, Seen};
use proptest::prelude::*;

fn lattice(pose: &Pose) -> Vec<DVec3> {
    let at = |i: i32| DVec3::new(0.9 * f64::from(i % 7 - 3), 0.9 * f64::from(i / 7 - 3), 0.0);
    (0..49).map(|i| pose.transform_point(at(i))).collect()
}

proptest! {
    /// On a tilted gel the indentation is measured along the gel's normal, whatever way the markers slid.
    #[test]
    fn indentation_is_along_the_normal(
        tilt in prop::array::uniform3(-0.3..0.3_f64),
        height in -1.0..2.0_f64,
        slide in prop::array::uniform2(-1.0..1.0_f64),
    ) {
        let pose =
            Pose { rotation: so3::exp(DVec3::from_array(tilt)), translation_mm: DVec3::new(4.0, 0.0, 28.7) };
        let rest = RestSurface::new(&lattice(&pose)).unwrap();
        let moved = lattice(&(pose * Pose::from_translation_mm(DVec3::new(slide[0], slide[1], -height))));
        let mut indentation = Vec::new();
        rest.indentation_mm(&moved, &mut indentation).unwrap();
        prop_assert!(rest.normal().z < 0.0);
        for h in indentation {
            prop_assert!((h - height).abs() < 1e-12 * 30.0, "{h} {height}");
        }
    }
}

fn on_face(i: usize) -> bool {
    (4..10).contains(&(i / 15)) && (4..10).contains(&(i % 15))
}

/// Heights over 15 x 15 markers 0.9 mm apart: the free membrane beside a flat face over rows and columns 4 to
/// 9, and noise.
fn pressed_face(noise: &[f64]) -> Vec<f64> {
    let (n, reach2) = (15, (2.5_f64 / 0.9).powi(2));
    let mut heights: Vec<f64> = (0..n * n).map(|i| if on_face(i) { 0.8 } else { 0.0 }).collect();
    for _ in 0..2000 {
        for i in (0..n * n).filter(|&i| !on_face(i)) {
            let at = |exists: bool, j: usize| if exists { (heights[j], 1.0) } else { (0.0, 0.0) };
            let ring = [
                at(i % n > 0, i.wrapping_sub(1)),
                at(i % n + 1 < n, i + 1),
                at(i >= n, i.wrapping_sub(n)),
                at(i + n < n * n, i + n),
            ];
            let (sum, count) = ring.iter().fold((0.0, 0.0), |(s, c), (h, one)| (s + h, c + one));
            heights[i] = reach2 * sum / (1.0 + reach2 * count);
        }
    }
    heights.iter().zip(noise).map(|(h, e)| h + 0.005 * e).collect()
}

fn square(pose: &Pose) -> RestSurface {
    let at = |i: i32| DVec3::new(0.9 * f64::from(i % 15), 0.9 * f64::from(i / 15), 0.0);
    RestSurface::new(&(0..225).map(|i| pose.transform_point(at(i))).collect::<Vec<_>>()).unwrap()
}

fn in_contact(
    rest: &RestSurface,
    heights: &[f64],
    state: &[gelstereo_core::track::MarkerState],
) -> Vec<bool> {
    let mut found = Vec::new();
    let mut pressure = Pressure::new(rest, 15, 15, 2.5).unwrap();
    pressure.run(heights, std::iter::repeat_n(25e-6, 225), state, &mut found).unwrap();
    found
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// Rows and columns may be swapped or counted from the other end, and the gel may lie in space as it
    /// likes.
    #[test]
    fn pressure_does_not_depend_on_the_view(
        noise in prop::collection::vec(-1.7..1.7_f64, 225),
        tilt in prop::array::uniform3(-0.3..0.3_f64),
    ) {
        let heights = pressed_face(&noise);
        let flat = square(&Pose::IDENTITY);
        let found = in_contact(&flat, &heights, &[Seen; 225]);
        // A free marker beside the face's edge is called in contact beyond 2.8 standard deviations: 0.06 of
        // the 24 are.
        prop_assert!((0..225).filter(|&i| found[i] != on_face(i)).count() <= 3);
        let views: [fn(usize) -> usize; 3] =
            [|i| i / 15 * 15 + 14 - i % 15, |i| (14 - i / 15) * 15 + i % 15, |i| i % 15 * 15 + i / 15];
        for view in views {
            let seen: Vec<f64> = (0..225).map(|i| heights[view(i)]).collect();
            let again = in_contact(&flat, &seen, &[Seen; 225]);
            prop_assert!((0..225).all(|i| again[i] == found[view(i)]));
        }
        let pose =
            Pose { rotation: so3::exp(DVec3::from_array(tilt)), translation_mm: DVec3::new(4.0, 0.0, 28.7) };
        let tilted = square(&pose);
        let cloud: Vec<DVec3> =
            tilted.points_mm().iter().zip(&heights).map(|(&p, &h)| p + tilted.normal() * h).collect();
        let mut measured = Vec::new();
        tilted.indentation_mm(&cloud, &mut measured).unwrap();
        prop_assert_eq!(in_contact(&tilted, &measured, &[Seen; 225]), found);
    }

    /// Whatever the height said of a marker that is not seen, it is not salient and changes nothing else.
    #[test]
    fn pressure_does_without_markers_that_are_not_seen(
        noise in prop::collection::vec(-1.7..1.7_f64, 225),
        gone in prop::collection::vec(0..225_usize, 1..8), height in -5.0..5.0_f64,
    ) {
        let mut heights = pressed_face(&noise);
        let mut state = [Seen; 225];
        gone.iter().for_each(|&i| state[i] = Held);
        let found = in_contact(&square(&Pose::IDENTITY), &heights, &state);
        gone.iter().for_each(|&i| heights[i] = if i % 2 == 0 { height } else { f64::NAN });
        prop_assert_eq!(&in_contact(&square(&Pose::IDENTITY), &heights, &state), &found);
        prop_assert!(gone.iter().all(|&i| !found[i]));
        // A marker beside one that is not seen may be judged wrongly; elsewhere it is as above.
        let wrong = |&i: &usize| state[i] == Seen && found[i] != on_face(i);
        let near =
            |i: usize| gone.iter().any(|&g| (g / 15).abs_diff(i / 15) + (g % 15).abs_diff(i % 15) <= 2);
        prop_assert!((0..225).filter(wrong).filter(|&i| !near(i)).count() <= 3);
    }
}

#[test]
fn pressure_refuses_what_it_cannot_judge() {
    let rest = square(&Pose::IDENTITY);
    let mismatch = |found| ContactError::LengthMismatch { rest: 225, found };
    assert_eq!(Pressure::new(&rest, 15, 14, 2.5).unwrap_err(), mismatch(210));
    assert!(Pressure::new(&rest, 15, 15, f64::NAN).is_err());
    let mut pressure = Pressure::new(&rest, 15, 15, 2.5).unwrap();
    let mut out = vec![true];
    for (heights, variances, states) in [(224, 225, 225), (225, 224, 225), (225, 225, 224)] {
        let variance = std::iter::repeat_n(25e-6, variances);
        let error = pressure.run(&vec![0.0; heights], variance, &vec![Seen; states], &mut out);
        assert_eq!(error, Err(mismatch(224)));
        assert!(out.is_empty());
    }
    let (mut heights, mut variance) = (vec![0.0; 225], vec![25e-6; 225]);
    for bad in [f64::NAN, f64::INFINITY] {
        heights[9] = bad;
        let error = pressure.run(&heights, variance.iter().copied(), &[Seen; 225], &mut out);
        assert_eq!(error, Err(ContactError::NotFinite { index: 9 }));
    }
    let mut state = [Seen; 225];
    state[9] = Lost;
    pressure.run(&heights, variance.iter().copied(), &state, &mut out).unwrap();
    assert_eq!(out, [false; 225]);
    (heights[9], variance[7]) = (0.0, -1.0);
    let error = pressure.run(&heights, variance.iter().copied(), &[Seen; 225], &mut out);
    assert_eq!(error, Err(ContactError::NotFinite { index: 7 }));
    let covariance = [[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 9.0]];
    assert_eq!(variance_along(&covariance, DVec3::Z), 9.0);
    assert!((variance_along(&covariance, DVec3::new(0.6, 0.8, 0.0)) - 3.68).abs() < 1e-15);
}

#[test]
fn points_that_span_no_plane_are_refused() {
    let line: Vec<_> = (0..9).map(|i| DVec3::new(f64::from(i), 2.0 * f64::from(i), 28.7)).collect();
    assert_eq!(RestSurface::new(&line), Err(ContactError::NoPlane { points: 9 }));
    assert_eq!(RestSurface::new(&[]), Err(ContactError::NoPlane { points: 0 }));
    let nan = [DVec3::ZERO, DVec3::X, DVec3::Y * f64::NAN];
    assert_eq!(RestSurface::new(&nan), Err(ContactError::NotFinite { index: 2 }));
    let rest = RestSurface::new(&lattice(&Pose::IDENTITY)).unwrap();
    let error = rest.indentation_mm(&line, &mut Vec::new()).unwrap_err();
    assert_eq!(error, ContactError::LengthMismatch { rest: 49, found: 9 });
}

#[test]
fn only_seen_markers_are_salient_or_move_the_mean() {
    let state = [Seen, Held, Seen, Lost];
    let mut salient = Vec::new();
    saliency(&[0.36, 0.9, 0.35, 0.9], &state, 0.35, &mut salient);
    assert_eq!(salient, [true, false, false, false]);
    let reference = [DVec2::ZERO; 4];
    let now = [DVec2::new(3.0, 4.0), DVec2::splat(99.0), DVec2::new(0.0, 1.0), DVec2::splat(99.0)];
    assert_eq!(mean_motion_px(&reference, &now, &state), 3.0);
    assert_eq!(mean_motion_px(&reference, &now, &[Lost; 4]), 0.0);
}

#[test]
fn the_patch_leaves_the_shoulder_out() {
    let (indentation, salient) = ([2.0, 1.3, 1.2, 3.0, 0.4], [true, true, true, false, true]);
    let mut found = Vec::new();
    patch(&indentation, &salient, 0.65, &mut found);
    assert_eq!(found, [true, true, false, false, false]);
    patch(&indentation, &salient, 0.0, &mut found);
    assert_eq!(found, salient);
    patch(&indentation, &[false; 5], 0.65, &mut found);
    assert_eq!(found, [false; 5]);
}

proptest! {
    /// The pad's x is half the width whatever the linkage, and width and advance follow the crank's circle.
    #[test]
    fn parallelogram_pads_run_on_a_circle(width_mm in 1.0..85.0_f64) {
        let pad = FingerKinematics::robotiq_2f85().pad_mm(width_mm).unwrap();
        prop_assert_eq!(pad.x, 0.5 * width_mm);
        // Around the crank's pivot (offset, reach) the radius is |(a, b)|.
        let radius = ((pad.x - 5.0808).powi(2) + (pad.z - 87.324).powi(2)).sqrt();
        prop_assert!((radius - 37.6_f64.hypot(43.0)).abs() < 1e-12 * 200.0);
    }

    /// After the adjustment the held object stands at its goal (Eq. 8 closed to a loop).
    #[test]
    fn adjustment_brings_the_object_to_the_goal(
        goal in prop::array::uniform6(-1.0..1.0_f64), grasp in prop::array::uniform6(-1.0..1.0_f64),
    ) {
        let pose =
            |t: [f64; 6]| Pose::exp(DVec3::new(t[0], t[1], t[2]), DVec3::new(t[3], t[4], t[5]) * 100.0);
        let reached = adjusted_gripper(&pose(goal), &pose(grasp)) * pose(grasp);
        prop_assert!((reached.translation_mm - pose(goal).translation_mm).length() < 1e-12 * 400.0);
        prop_assert!(reached.rotation.dot(pose(goal).rotation).abs() > 1.0 - 1e-14);
    }
}

#[test]
fn the_mounted_sensor_looks_across_the_gap() {
    let gel_centre = DVec3::new(4.0, 0.0, 28.7);
    let mount = SensorMount::facing(FingerKinematics::robotiq_2f85(), gel_centre);
    let (closed, open) = mount.kinematics.width_range_mm();
    // The figures that simulation models of the gripper give: 0.86 mm and 85.36 mm.
    assert!((closed - 0.86).abs() < 0.01 && (open - 85.36).abs() < 0.01, "{closed} {open}");
    let pose = mount.t_gripper_sensor(40.0).unwrap();
    let gel = pose.transform_point(gel_centre);
    assert!((gel - mount.kinematics.pad_mm(40.0).unwrap()).length() < 1e-12);
    assert!((pose.transform_vector(DVec3::Z) + DVec3::X).length() < 1e-15);
    let error = mount.t_gripper_sensor(90.0).unwrap_err().to_string();
    assert!(error.contains("90.000") && error.contains("85.3"), "{error}");
    assert!(mount.t_gripper_sensor(f64::NAN).is_err());
}

/// Found by fuzzing: the squares of such coordinates overflow, and the normal was NaN.
#[test]
fn coordinates_too_large_to_square_span_no_rest_plane() {
    for size in [1e160, 1e300, 1e308] {
        let points = [DVec3::ZERO, DVec3::X * size, DVec3::Y * size];
        assert_eq!(RestSurface::new(&points), Err(ContactError::NoPlane { points: 3 }));
    }
}

proptest! {
    /// A point that is not finite has no height, whichever of its coordinates it is; nothing is written.
    #[test]
    fn points_that_are_not_finite_have_no_height(
        index in 0usize..49, axis in 0usize..3, bad in prop::sample::select(vec![f64::NAN, f64::INFINITY]),
    ) {
        let mut points = lattice(&Pose::IDENTITY);
        let rest = RestSurface::new(&points).unwrap();
        points[index][axis] = bad;
        let mut indentation = vec![1.0];
        prop_assert_eq!(
            rest.indentation_mm(&points, &mut indentation),
            Err(ContactError::NotFinite { index })
        );
        prop_assert!(indentation.is_empty());
        prop_assert_eq!(RestSurface::new(&points), Err(ContactError::NotFinite { index }));
    }
}

proptest! {
    /// Another decay length leaves nothing of the one before.
    #[test]
    fn a_decay_length_that_is_set_is_one_from_the_start(
        first_mm in 0.3..6.0_f64, then_mm in 0.3..6.0_f64,
        heights in prop::collection::vec(-0.2..1.0_f64, 225),
    ) {
        let rest = square(&Pose::IDENTITY);
        let pressures = |pressure: &mut Pressure| {
            let mut found = Vec::new();
            pressure.run(&heights, std::iter::repeat_n(25e-6, 225), &[Seen; 225], &mut found).unwrap();
            pressure.pressure_mm().to_vec()
        };
        let mut changed = Pressure::new(&rest, 15, 15, first_mm).unwrap();
        changed.set_decay(then_mm).unwrap();
        let mut new = Pressure::new(&rest, 15, 15, then_mm).unwrap();
        for (changed, new) in pressures(&mut changed).into_iter().zip(pressures(&mut new)) {
            // Round-off of five terms of up to 4 (6 / 0.9)² times a height.
            prop_assert!((changed - new).abs() < 1e-12, "{changed} {new}");
        }
    }
}
