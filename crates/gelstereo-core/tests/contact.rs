//! Rest plane, saliency, motion; and the frames from sensor to base.

use gelstereo_core::contact::{ContactError, RestSurface, mean_motion_px, patch, saliency};
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
        let pose = Pose { rotation: so3::exp(DVec3::from_array(tilt)), translation_mm: DVec3::new(4.0, 0.0, 28.7) };
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
        let pose = |t: [f64; 6]| Pose::exp(DVec3::new(t[0], t[1], t[2]), DVec3::new(t[3], t[4], t[5]) * 100.0);
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
