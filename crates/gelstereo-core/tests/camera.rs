//! Pinhole, distortion and rectification against closed forms.

use gelstereo_core::camera::{Camera, CameraError};
use gelstereo_core::math::{DVec2, DVec3, Pose, so3};
use gelstereo_core::rig::{Rig, RigError};
use proptest::prelude::*;

fn camera(distortion: [f64; 5]) -> Camera {
    Camera {
        width_px: 640,
        height_px: 480,
        fx_px: 560.0,
        fy_px: 555.0,
        cx_px: 320.0,
        cy_px: 240.0,
        distortion,
    }
}

proptest! {
    /// Undistorting what was distorted gives the ray back, to the round-off of Newton's last step.
    #[test]
    fn undistort_inverts_distort(
        x in -0.5..0.5_f64, y in -0.4..0.4_f64,
        k1 in -0.25..0.3_f64, k2 in -0.1..0.2_f64, p1 in -0.01..0.01_f64, p2 in -0.01..0.01_f64,
    ) {
        let camera = camera([k1, k2, p1, p2, 0.0]);
        let ray = DVec3::new(x, y, 1.0) * 30.0;
        let pixel = camera.project(ray).unwrap();
        let back = camera.undistort(pixel).unwrap();
        // Pixels of up to 1000 carry 1e-13 of round-off, that is 2e-16 of the ray, amplified by at most 1 / J
        // < 10.
        prop_assert!((back - DVec2::new(x, y)).length() < 1e-13, "{back:?}");
    }

    /// Rectified rows of both views agree and Q gives the point back, for cameras turned by up to 10 degrees.
    #[test]
    fn rectified_rows_agree(
        turn in prop::array::uniform3(-0.17..0.17_f64),
        point in (-8.0..8.0_f64, -8.0..8.0_f64, 20.0..40.0_f64),
        baseline in (4.0..12.0_f64, -0.5..0.5_f64, -0.5..0.5_f64),
    ) {
        let rotation = so3::exp(DVec3::from_array(turn));
        let centre = DVec3::new(baseline.0, baseline.1, baseline.2);
        let rig = Rig {
            left: camera([0.0; 5]),
            right: camera([0.0; 5]),
            t_right_left: Pose { rotation, translation_mm: -(rotation * centre) },
            layers: None,
        };
        let rect = rig.rectification().unwrap();
        let p = DVec3::new(point.0, point.1, point.2);
        let to_ray = |q: DVec3| DVec2::new(q.x / q.z, q.y / q.z);
        let left = rect.rectify(&rect.r_left, to_ray(p)).unwrap();
        let right = rect.rectify(&rect.r_right, to_ray(rig.t_right_left.transform_point(p))).unwrap();
        prop_assert!((left.y - right.y).abs() < 1e-10);
        let h = rect.q().map(|row| row[0] * left.x + row[1] * left.y + row[2] * (left.x - right.x) + row[3]);
        let back = rect.r_left.transpose() * (DVec3::new(h[0], h[1], h[2]) / h[3]);
        prop_assert!((back - p).length() < 1e-10 * p.length() * p.z / baseline.0);
    }
}

#[test]
fn row_22_a_pixel_beyond_the_monotone_range_is_refused() {
    // k1 = -0.4 folds over at r = sqrt(1 / 1.2) = 0.913, where r_d = 0.6086.
    let camera = camera([-0.4, 0.0, 0.0, 0.0, 0.0]);
    let at = |r_d: f64| camera.undistort(DVec2::new(320.0 + 560.0 * r_d, 240.0));
    assert!(at(0.60).is_ok());
    for r_d in [0.61, 0.7, 5.0] {
        assert!(matches!(at(r_d), Err(CameraError::BeyondDistortion { .. })), "{r_d}");
    }
    assert_eq!(camera.undistort(DVec2::new(f64::NAN, 0.0)), Err(CameraError::PixelNotFinite));
}

proptest! {
    /// One radial term folds over at r = 1 / sqrt(-3 k1), where r_d = 2 r / 3: every pixel within has a ray
    /// of less slope, which leads back to it, and none beyond has any.
    #[test]
    fn row_22_one_radial_term_is_inverted_up_to_its_fold(
        k1 in -3.0..-0.05_f64, share in 0.0..3.0_f64, way in 0.0..6.3_f64,
    ) {
        prop_assume!((share - 1.0).abs() > 1e-6);
        let fold = (-3.0 * k1).sqrt().recip();
        let camera = camera([k1, 0.0, 0.0, 0.0, 0.0]);
        let distorted = share * 2.0 / 3.0 * fold * DVec2::new(way.cos(), way.sin());
        let pixel_px = DVec2::new(320.0, 240.0) + distorted * DVec2::new(560.0, 555.0);
        match camera.undistort(pixel_px) {
            Ok(p) => {
                prop_assert!(share < 1.0 && p.length() < fold, "{p} for {share} of the fold");
                // A pixel is off by round-off, the ray by that over the slope, which vanishes at the fold.
                let back = p * (1.0 + k1 * p.length_squared());
                prop_assert!(
                    back.distance(distorted) < 16.0 * f64::EPSILON * (1.0 + fold),
                    "{back} {distorted}"
                );
            }
            Err(error) => {
                prop_assert!(share > 1.0 && matches!(error, CameraError::BeyondDistortion { .. }), "{share}")
            }
        }
    }
}

#[test]
fn impossible_cameras_and_rigs_are_refused_by_name() {
    let mut bad = camera([0.0; 5]);
    bad.fy_px = -1.0;
    let message = Rig::parallel(bad, 8.0).validate().unwrap_err().to_string();
    assert!(
        message.contains("left camera") && message.contains("fy_px") && message.contains("-1"),
        "{message}"
    );
    let good = camera([0.0; 5]);
    assert!(matches!(Rig::parallel(good.clone(), 0.0).validate(), Err(RigError::NoBaseline { .. })));
    assert!(matches!(Rig::parallel(good, -8.0).validate(), Err(RigError::NotSideBySide { .. })));
}

/// Found by the fuzz target `rigs`: infinity times zero in the tangential terms.
#[test]
fn a_point_astronomically_far_aside_has_no_pixel() {
    let camera = camera([-0.1, 0.02, 0.001, -0.001, 0.0]);
    for y in [1e163, 1e200, f64::MAX] {
        assert_eq!(camera.project(DVec3::new(0.04, y, 30.0)), None, "{y}");
    }
}

/// Found by the fuzz target `rigs`: the path from the centre outwards took as many steps as the pixel is far.
#[test]
fn a_pixel_astronomically_far_aside_has_no_ray() {
    for distortion in [[0.0; 5], [0.1, 0.02, 0.001, -0.001, 0.0]] {
        for x in [1e6, 1e19, 1e163, f64::MAX] {
            let pixel_px = DVec2::new(x, 3.0);
            assert_eq!(
                camera(distortion).undistort(pixel_px),
                Err(CameraError::BeyondDistortion { pixel_px })
            );
        }
    }
}

proptest! {
    /// A pixel with a NaN or infinite coordinate has an error of its own, with and without lens distortion.
    /// It is not reported as lying beyond the range of the distortion.
    #[test]
    fn a_pixel_that_is_not_finite_has_no_ray(
        bad in prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY]),
        good in -100.0..700.0_f64, is_row in any::<bool>(), k1 in prop::sample::select(vec![0.0, -0.2]),
    ) {
        let pixel_px = if is_row { DVec2::new(good, bad) } else { DVec2::new(bad, good) };
        let found = camera([k1, 0.0, 0.0, 0.0, 0.0]).undistort(pixel_px);
        prop_assert_eq!(found, Err(CameraError::PixelNotFinite));
    }

    /// The right camera lies within 60 degrees of the left one's x axis, or the two are not side by side.
    #[test]
    fn the_right_camera_is_beside_the_left_one(
        off_deg in 0.0..180.0_f64, around in 0.0..6.3_f64, baseline_mm in 1.0..50.0_f64,
    ) {
        // Beside the bound, round-off decides.
        prop_assume!((off_deg - 60.0).abs() > 1e-6);
        let (sine, cosine) = off_deg.to_radians().sin_cos();
        let centre = DVec3::new(cosine, sine * around.cos(), sine * around.sin()) * baseline_mm;
        let t_right_left = Pose::from_translation_mm(-centre);
        let rig = Rig { t_right_left, ..Rig::parallel(camera([0.0; 5]), baseline_mm) };
        match rig.validate() {
            Ok(()) => prop_assert!(off_deg < 60.0),
            Err(error) => {
                prop_assert!(off_deg > 60.0 && matches!(error, RigError::NotSideBySide { .. }), "{error}")
            }
        }
    }
}
