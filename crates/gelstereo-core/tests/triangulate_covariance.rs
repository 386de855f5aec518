//! Covariances of points whatever the rig and the centres (hard case 32).

use crate::rigs;

use gelstereo_core::camera::{Camera, Layer, Layers};
use gelstereo_core::math::linalg::eigen;
use gelstereo_core::math::{DVec2, DVec3, Pose, so3};
use gelstereo_core::params::TriangulateParams;
use gelstereo_core::rig::Rig;
use gelstereo_core::triangulate::{Centre, TriangulateError, Triangulator};
use proptest::prelude::*;
use rigs::{ALL, camera, centre, layered_rig, parallel, point, stage_without_map};

/// A rig of which every number is anything that is let through, and two pixels.
fn absurd_rigs() -> impl Strategy<Value = (Rig, [DVec2; 2])> {
    let decades = |low: f64, high: f64| (low..high).prop_map(|x: f64| 10_f64.powf(x));
    let focal = move || prop_oneof![1 => decades(-6.0, 8.0), 1 => 300.0..900.0_f64];
    let layers = prop::option::of((
        prop::array::uniform3(-1.0..1.0_f64),
        decades(-9.0, 9.0),
        decades(-9.0, 9.0),
        1.0..4.0_f64,
    ));
    let pixels = prop::array::uniform4(prop_oneof![0.0..640.0_f64, -1e5..1e5_f64]);
    let rig = (
        [focal(), focal(), focal(), focal()],
        prop_oneof![decades(-3.0, 6.0), 1.0..20.0_f64],
        prop::array::uniform3(-0.5..0.5_f64),
        layers,
    );
    (rig, pixels).prop_map(|((f, baseline_mm, turn, layers), [u, v, right, row])| {
        let camera = |fx_px, fy_px| Camera { fx_px, fy_px, distortion: [0.0; 5], ..camera() };
        let rotation = so3::exp(DVec3::from_array(turn));
        let layers = layers.map(|(normal, gap_mm, thickness_mm, index)| Layers {
            normal: (DVec3::from_array(normal) + 1.5 * DVec3::Z).normalize(),
            gap_mm,
            plates: vec![Layer { thickness_mm, index }],
            gel_index: 1.41,
        });
        let t_right_left = Pose { rotation, translation_mm: rotation * DVec3::new(-baseline_mm, 0.0, 0.0) };
        (
            Rig { left: camera(f[0], f[1]), right: camera(f[2], f[3]), t_right_left, layers },
            [DVec2::new(u, v), DVec2::new(right, row)],
        )
    })
}

/// Why a covariance is none, if so: it must be equal to its transpose to the bit, and have no eigenvalue
/// below 0 by more than the rounding of its entries, some ulp of the largest.
fn no_covariance(c: &[[f64; 3]; 3]) -> Option<String> {
    let symmetric = (0..3).all(|i| (0..3).all(|j| c[i][j].to_bits() == c[j][i].to_bits()));
    let least = eigen(c).values[0];
    let ok = symmetric && c.iter().flatten().all(|x| x.is_finite()) && (0..3).all(|i| c[i][i] >= 0.0);
    let trace = c[0][0] + c[1][1] + c[2][2];
    (!(ok && least >= -16.0 * f64::EPSILON * trace)).then(|| format!("{least:e} of {trace:e}: {c:?}"))
}

proptest! {
    /// Whatever the rig, the covariance of a point is one, or the point is refused.
    #[test]
    fn row_32_covariances_are_semi_definite_whatever_the_rig(
        (rig, [left, right]) in absurd_rigs(), sigmas in prop::array::uniform4(1e-3..1.0_f64),
        correlation in -0.999..0.999_f64,
    ) {
        for method in ALL {
            let params = TriangulateParams { method, min_disparity_px: 1e-9, ..Default::default() };
            let Ok(mut stage) = Triangulator::new(&rig, &params) else { continue };
            let centre = |at_px, [a, b]: [f64; 2]| {
                Centre { at_px, covariance_px2: [[a * a, correlation * a * b], [correlation * a * b, b * b]] }
            };
            let centres = [centre(left, [sigmas[0], sigmas[1]]), centre(right, [sigmas[2], sigmas[3]])];
            let exact = stage.point(0, &centres[0], &centres[1]);
            let found = exact.clone().map_or(None, |found| no_covariance(&found.covariance_mm2));
            prop_assert!(found.is_none(), "{method:?} {}", found.unwrap());
            let Ok(exact) = exact else { continue };
            stage.fit_map(&[exact.point_mm]);
            let Ok(mapped) = stage.point(0, &centres[0], &centres[1]) else { continue };
            let found = no_covariance(&mapped.covariance_mm2);
            prop_assert!(found.is_none(), "{method:?} {}", found.unwrap());
        }
    }
}

/// Depths of up to 1e14 baselines, of which the inverse of an information matrix keeps no digit.
#[test]
fn row_32_covariances_of_distant_points_are_semi_definite() {
    let mut answers = 0;
    for (f, b, d) in (0..=8).flat_map(|f| (-3..=6).flat_map(move |b| (-9..=2).map(move |d| (f, b, d)))) {
        let [f_px, baseline_mm, disparity_px] = [f, b, d].map(|e| 10_f64.powi(e));
        let camera = Camera { distortion: [0.0; 5], fx_px: f_px, fy_px: f_px, ..camera() };
        let rig = Rig::parallel(camera, baseline_mm);
        for method in ALL {
            let params = TriangulateParams { method, min_disparity_px: 1e-9, ..Default::default() };
            let stage = Triangulator::new(&rig, &params).unwrap();
            let left = DVec2::new(380.0, 200.0);
            if let Ok(found) = point(&stage, left, left - DVec2::new(disparity_px, 0.0)) {
                let fault = no_covariance(&found.covariance_mm2);
                assert!(
                    fault.is_none(),
                    "{method:?}, f {f_px}, B {baseline_mm}, d {disparity_px}: {}",
                    fault.unwrap()
                );
                answers += 1;
            }
        }
    }
    assert!(answers > 2000, "{answers}");
}

/// A right centre that is known 1e16 times worse than the left one leaves nothing but round-off of the depth.
#[test]
fn row_32_a_point_that_round_off_alone_determines_is_refused() {
    for rig in [parallel(), layered_rig()] {
        let (left, right) = rig.project(DVec3::new(4.0, 1.0, 29.0)).unwrap();
        let stage = stage_without_map(&rig);
        assert!(stage.point(2, &centre(left, 1e-3), &centre(right, 1e9)).is_ok());
        let found = stage.point(2, &centre(left, 1e-3), &centre(right, 1e13));
        assert_eq!(found, Err(TriangulateError::Unknown { index: 2 }));
        assert!(found.unwrap_err().to_string().contains("no better than round-off"));
    }
}
