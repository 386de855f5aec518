//! Triangulation against projection, and the disparities that mean nothing (hard cases 17 and 18).

use gelstereo_core::camera::Camera;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, DVec3, Pose, so3};
use gelstereo_core::params::TriangulateParams;
use gelstereo_core::rig::{Rig, RigError};
use gelstereo_core::triangulate::{TriangulateError, Triangulator};
use proptest::prelude::*;

fn camera() -> Camera {
    Camera {
        width_px: 640,
        height_px: 480,
        fx_px: 560.0,
        fy_px: 560.0,
        cx_px: 319.5,
        cy_px: 239.5,
        distortion: [-0.1, 0.02, 0.001, -0.001, 0.0],
    }
}

fn turned_rig() -> Rig {
    let rotation = so3::exp(DVec3::new(0.01, -0.08, 0.02));
    Rig {
        left: camera(),
        right: Camera { fx_px: 570.0, ..camera() },
        t_right_left: Pose { rotation, translation_mm: DVec3::new(-8.0, 0.1, -0.2) },
        layers: None,
    }
}

fn triangulator(rig: &Rig) -> Triangulator {
    Triangulator::new(rig, &TriangulateParams::default()).unwrap()
}

fn parallel() -> Rig {
    Rig::parallel(Camera { distortion: [0.0; 5], ..camera() }, 8.0)
}

proptest! {
    #[test]
    fn triangulation_inverts_projection(x in -8.0..8.0_f64, y in -8.0..8.0_f64, z in 22.0..40.0_f64) {
        let rig = turned_rig();
        let point = DVec3::new(x, y, z);
        let (left, right) = rig.project(point).unwrap();
        let found = triangulator(&rig).point(0, left, right).unwrap();
        // 1e-13 px of round-off in each pixel is z^2 / (f B) = 0.36 mm/px of depth at most: 1e-12 leaves a factor 10.
        prop_assert!((found.point_mm - point).length() < 1e-12 * 40.0, "{found:?} for {point:?}");
        prop_assert!(found.epipolar_px.abs() < 1e-10);
    }
}

/// The first-order covariance against 20000 draws. The sample variance of n normal numbers has a relative standard
/// deviation of sqrt(2 / n) = 1 %; 5 % is five of them.
#[test]
fn covariance_agrees_with_monte_carlo() {
    let (rig, point, sigma) = (parallel(), DVec3::new(5.0, -6.0, 28.7), 0.09);
    let triangulator = triangulator(&rig);
    let (left, right) = rig.project(point).unwrap();
    let mut stream = Stream::new(1, "centre noise");
    let draws = 20_000;
    let mut sums = [[0.0; 3]; 3];
    for _ in 0..draws {
        let mut noise = || {
            let (x, y) = stream.normal_pair();
            DVec2::new(x, y) * sigma
        };
        let d = triangulator.point(0, left + noise(), right + noise()).unwrap().point_mm - point;
        for i in 0..3 {
            for j in 0..3 {
                sums[i][j] += d[i] * d[j] / f64::from(draws);
            }
        }
    }
    let expected = {
        let centre = [[sigma * sigma, 0.0], [0.0, sigma * sigma]];
        triangulator.covariance_mm2(point, &centre, &centre)
    };
    for i in 0..3 {
        for j in 0..3 {
            let scale = (expected[i][i] * expected[j][j]).sqrt();
            assert!((sums[i][j] - expected[i][j]).abs() < 0.05 * scale, "{i} {j}: {sums:?} {expected:?}");
        }
    }
}

#[test]
fn row_17_disparity_zero_tiny_and_negative_are_typed_errors() {
    let triangulator = triangulator(&parallel());
    let left = DVec2::new(300.0, 200.0);
    for disparity in [0.0, 1e-12, -1e-12, -150.0, 0.999] {
        let found = triangulator.point(7, left, left - DVec2::new(disparity, 0.0));
        let Err(TriangulateError::Disparity { index: 7, disparity_px, min_px, .. }) = found else {
            panic!("{disparity}: {found:?}");
        };
        // 300 - d is rounded to 2^-44 px, and the pixel to ray and back once more.
        assert!((disparity_px - disparity).abs() < 1e-12 && min_px == 1.0, "{disparity_px}");
    }
    assert!(triangulator.point(0, left, left - DVec2::new(1.001, 0.0)).is_ok());
}

#[test]
fn row_17_swapped_views_are_named() {
    let rig = turned_rig();
    let points = (0..9).map(|i| DVec3::new(f64::from(i) - 4.0, 1.0, 28.7));
    let (left, right): (Vec<_>, Vec<_>) = points.map(|p| rig.project(p).unwrap()).unzip();
    let mut out = Vec::new();
    let error = triangulator(&rig).run(&right, &left, &mut out).unwrap_err();
    assert!(matches!(error, TriangulateError::Disparity { affected: 9, of: 9, .. }), "{error:?}");
    assert!(error.to_string().contains("swapped"), "{error}");
    assert!(triangulator(&rig).run(&left, &right, &mut out).is_ok());
    assert_eq!(out.len(), 9);
}

/// With the baseline going to zero the depth's error grows as 1 / B, and below a micrometre there is no rig.
#[test]
fn row_18_a_vanishing_baseline_is_refused_not_divided_by() {
    let point = DVec3::new(1.0, 2.0, 28.7);
    let camera = Camera { distortion: [0.0; 5], ..camera() };
    let params = TriangulateParams { min_disparity_px: 1e-6, ..Default::default() };
    for baseline_mm in [8.0, 0.1, 0.001] {
        let rig = Rig::parallel(camera.clone(), baseline_mm);
        let (left, right) = rig.project(point).unwrap();
        let found = Triangulator::new(&rig, &params).unwrap().point(0, left, right).unwrap().point_mm;
        // Both pixels carry half an ulp of 512 (6e-14 px) from projection and as much from rectification.
        let bound = 4.0 * 6e-14 * point.length_squared() / (560.0 * baseline_mm) + 1e-12;
        assert!((found - point).length() < bound, "{baseline_mm}: {found:?}");
    }
    for baseline_mm in [1e-4, 1e-12, 0.0] {
        let error = Triangulator::new(&Rig::parallel(camera.clone(), baseline_mm), &params).unwrap_err();
        assert!(matches!(error, TriangulateError::Rig(RigError::NoBaseline { .. })), "{error:?}");
    }
}

/// Parallel rays have disparity zero wherever they point.
#[test]
fn row_18_parallel_rays_are_a_typed_error() {
    let rig = turned_rig();
    let triangulator = triangulator(&rig);
    for direction in [DVec3::Z, DVec3::new(0.2, -0.1, 1.0)] {
        let left = rig.left.project(direction).unwrap();
        let right = rig.right.project(rig.t_right_left.rotation * direction).unwrap();
        let found = triangulator.point(0, left, right);
        assert!(matches!(found, Err(TriangulateError::Disparity { .. })), "{found:?}");
    }
}

#[test]
fn views_of_different_length_are_refused() {
    let one = [DVec2::new(300.0, 200.0)];
    let error = triangulator(&parallel()).run(&one, &[], &mut Vec::new()).unwrap_err();
    assert_eq!(error, TriangulateError::LengthMismatch { left: 1, right: 0 });
}
