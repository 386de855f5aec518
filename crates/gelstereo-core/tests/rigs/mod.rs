//! Rigs that triangulation is tested on, and stages for them.
// Not every test uses all of them.
#![allow(dead_code)]

use gelstereo_core::camera::{Camera, Layer, Layers};
use gelstereo_core::math::{DVec2, DVec3, Pose, so3};
use gelstereo_core::params::{TriangulateMethod, TriangulateParams};
use gelstereo_core::rig::Rig;
use gelstereo_core::triangulate::{Centre, StereoPoint, TriangulateError, Triangulator};

pub fn camera() -> Camera {
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

pub fn turned_rig() -> Rig {
    let rotation = so3::exp(DVec3::new(0.01, -0.08, 0.02));
    Rig {
        left: camera(),
        right: Camera { fx_px: 570.0, ..camera() },
        t_right_left: Pose { rotation, translation_mm: DVec3::new(-8.0, 0.1, -0.2) },
        layers: None,
    }
}

/// A centre with the same noise along both axes.
pub fn centre(at_px: DVec2, sigma_px: f64) -> Centre {
    let variance = sigma_px * sigma_px;
    Centre { at_px, covariance_px2: [[variance, 0.0], [0.0, variance]] }
}

/// The point of two centres with equal noise.
pub fn point(stage: &Triangulator, left: DVec2, right: DVec2) -> Result<StereoPoint, TriangulateError> {
    stage.point(7, &centre(left, 0.03), &centre(right, 0.03))
}

pub const ALL: [TriangulateMethod; 3] =
    [TriangulateMethod::Q, TriangulateMethod::Polynomial, TriangulateMethod::Rays];

/// With the method's map fitted around a rest surface of 10 mm at z = 29 mm.
pub fn stage(rig: &Rig, method: TriangulateMethod) -> Triangulator {
    let params = TriangulateParams { method, ..Default::default() };
    let mut stage = Triangulator::new(rig, &params).unwrap();
    stage.fit_map(&rest());
    assert_eq!(stage.map_error_mm().is_some(), method == TriangulateMethod::Polynomial);
    stage
}

/// A rest surface of 10 mm.
pub fn rest() -> Vec<DVec3> {
    (0..121).map(|i| DVec3::new(f64::from(i % 11) - 1.0, f64::from(i / 11) - 5.0, 29.0)).collect()
}

/// 20 mm of air, 3 mm of acrylic, then gel, tilted; the second rig of the methods.
pub fn layered_rig() -> Rig {
    let layers = Layers {
        normal: DVec3::new(0.03, -0.02, 1.0).normalize(),
        gap_mm: 20.0,
        plates: vec![Layer { thickness_mm: 3.0, index: 1.49 }],
        gel_index: 1.41,
    };
    Rig { layers: Some(layers), ..turned_rig() }
}

pub fn triangulator(rig: &Rig) -> Triangulator {
    Triangulator::new(rig, &TriangulateParams::default()).unwrap()
}

pub fn parallel() -> Rig {
    Rig::parallel(Camera { distortion: [0.0; 5], ..camera() }, 8.0)
}

pub fn stage_without_map(rig: &Rig) -> Triangulator {
    let params =
        TriangulateParams { method: TriangulateMethod::Rays, min_disparity_px: 1e-3, ..Default::default() };
    Triangulator::new(rig, &params).unwrap()
}
