//! Triangulation against projection, and the disparities that mean nothing (hard cases 17 and 18).

use crate::rigs;

use gelstereo_core::camera::Camera;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::params::{TriangulateMethod, TriangulateParams};
use gelstereo_core::rig::{Rig, RigError, View};
use gelstereo_core::triangulate::{Centre, Centres, TriangulateError, Triangulator};
use proptest::prelude::*;
use rigs::{
    ALL, camera, centre, layered_rig, parallel, point, rest, stage, stage_without_map, triangulator,
    turned_rig,
};

proptest! {
    #[test]
    fn triangulation_inverts_projection(x in -8.0..8.0_f64, y in -8.0..8.0_f64, z in 22.0..40.0_f64) {
        let rig = turned_rig();
        let at = DVec3::new(x, y, z);
        let (left, right) = rig.project(at).unwrap();
        let found = point(&triangulator(&rig), left, right).unwrap();
        // 1e-13 px of round-off in each pixel is z^2 / (f B) = 0.36 mm/px of depth at most: 1e-12 leaves a
        // factor 10.
        prop_assert!((found.point_mm - at).length() < 1e-12 * 40.0, "{found:?} for {at:?}");
        prop_assert!(found.epipolar_px.abs() < 1e-10);
    }
}

proptest! {
    /// The exact rung gives back the point that was projected, from both sides of every interface.
    #[test]
    fn rays_invert_projection(x in -8.0..8.0_f64, y in -8.0..8.0_f64, z in 10.0..40.0_f64) {
        for rig in [turned_rig(), layered_rig()] {
            let at = DVec3::new(x, y, z);
            let Ok((left, right)) = rig.project(at) else { continue };
            let found = point(&stage_without_map(&rig), left, right).unwrap();
            // As for Q; through layers some 10 roundings more, each of an ulp of 40 mm, times depth over
            // baseline, 5.
            prop_assert!((found.point_mm - at).length() < 1e-11 * 40.0, "{found:?} for {at:?}");
            prop_assert!(found.epipolar_px.abs() < 1e-9);
        }
    }

    /// At the most likely point the weighted squared residuals have no slope, with any covariances.
    #[test]
    fn rays_give_the_least_squares(
        x in -8.0..8.0_f64, y in -8.0..8.0_f64, z in 25.0..33.0_f64,
        noise in prop::array::uniform4(-0.5..0.5_f64), sigmas in prop::array::uniform4(0.01..0.5_f64),
        correlation in -0.9..0.9_f64,
    ) {
        for rig in [turned_rig(), layered_rig()] {
            let Ok((left, right)) = rig.project(DVec3::new(x, y, z)) else { continue };
            let centre = |at: DVec2, [a, b]: [f64; 2]| Centre {
                at_px: at,
                covariance_px2: [[a * a, correlation * a * b], [correlation * a * b, b * b]],
            };
            let centres = [
                centre(left + DVec2::new(noise[0], noise[1]), [sigmas[0], sigmas[1]]),
                centre(right + DVec2::new(noise[2], noise[3]), [sigmas[2], sigmas[3]]),
            ];
            let found = stage_without_map(&rig).point(0, &centres[0], &centres[1]).unwrap();
            let (mut slope, mut total) = (DVec3::ZERO, 0.0);
            for (view, centre) in [View::Left, View::Right].into_iter().zip(&centres) {
                let seen = rig.view(view).project_with_jacobian(found.point_mm, 0.0).unwrap();
                let [[a, b], [_, d]] = centre.covariance_px2;
                let e = centre.at_px - seen.pixel_px;
                let weighted = DVec2::new(d * e.x - b * e.y, a * e.y - b * e.x) / (a * d - b * b);
                slope += seen.jacobian[0] * weighted.x + seen.jacobian[1] * weighted.y;
                total += e.length();
            }
            // A thousandth of the standard deviation may be left.
            let step = DVec3::from_array(core::array::from_fn(|i| {
                DVec3::from_array(found.covariance_mm2[i]).dot(slope)
            }));
            prop_assert!(step.dot(slope).max(0.0).sqrt() < 1e-3, "{step:?}");
            // The reported residual is linearised before the last step.
            prop_assert!((found.epipolar_px.abs() - total).abs() < 1e-4, "{found:?} {total}");
        }
    }

    /// Any two pixels are a finite point with a finite covariance, or an error.
    #[test]
    fn any_pair_of_pixels_has_an_answer(
        left in (-2e3..3e3_f64, -2e3..3e3_f64), right in (-2e3..3e3_f64, -2e3..3e3_f64),
        sigma_px in 1e-6..1e3_f64,
    ) {
        for rig in [parallel(), turned_rig(), layered_rig()] {
            for method in ALL {
                let (left, right) = (DVec2::new(left.0, left.1), DVec2::new(right.0, right.1));
                let params = TriangulateParams { method, ..Default::default() };
                let stage = Triangulator::new(&rig, &params).unwrap();
                let found = stage.point(0, &centre(left, sigma_px), &centre(right, sigma_px));
                if let Ok(found) = found {
                    prop_assert!(found.point_mm.is_finite() && found.epipolar_px.is_finite(), "{found:?}");
                    prop_assert!(found.covariance_mm2.iter().flatten().all(|c| c.is_finite()), "{found:?}");
                }
            }
        }
    }

    /// Within its reach the map is within 1 um of the exact point, its residual within 0.01 px and its
    /// covariance within 3 %.
    #[test]
    fn the_polynomial_is_within_a_micrometre_of_the_rays(
        x in -1.0..9.0_f64, y in -5.0..5.0_f64, shift in prop::array::uniform2(-1.7..1.7_f64),
        up in -0.6..2.5_f64, noise in -0.03..0.03_f64,
    ) {
        for (rig, map) in maps() {
            let at = DVec3::new(x + shift[0], y + shift[1], 29.0 - up);
            let (left, right) = rig.project(at).unwrap();
            let found = point(map, left, right).unwrap();
            prop_assert!((found.point_mm - at).length() < 1e-3, "{found:?} {at:?}");
            prop_assert!(found.epipolar_px.abs() < 0.01);
            // Both share the noise along the rows alike, to first order: 0.03 px is 1.5 um.
            let right = right + DVec2::new(0.0, noise);
            let (found, exact) =
                (point(map, left, right).unwrap(), point(&stage_without_map(rig), left, right).unwrap());
            prop_assert!(
                (found.point_mm - exact.point_mm).length() < 1e-3 + 0.05 * 1.5e-3,
                "{found:?} {exact:?}"
            );
            prop_assert!(
                (found.epipolar_px - exact.epipolar_px).abs() < 0.01 + 0.05 * noise.abs(),
                "{found:?} {exact:?}"
            );
            for i in 0..3 {
                for j in 0..3 {
                    let scale = (exact.covariance_mm2[i][i] * exact.covariance_mm2[j][j]).sqrt();
                    let off = found.covariance_mm2[i][j] - exact.covariance_mm2[i][j];
                    prop_assert!(off.abs() < 0.03 * scale, "{i} {j}: {found:?} {exact:?}");
                }
            }
        }
    }
}

/// Rigs with their maps, fitted once.
fn maps() -> &'static [(Rig, Triangulator)] {
    static MAPS: std::sync::OnceLock<Vec<(Rig, Triangulator)>> = std::sync::OnceLock::new();
    MAPS.get_or_init(|| {
        let rigs = [parallel(), turned_rig(), layered_rig()];
        rigs.map(|rig| (rig.clone(), stage(&rig, TriangulateMethod::Polynomial))).into()
    })
}

/// Beyond the map's reach, and when no polynomial comes near, the point is exact.
#[test]
fn beyond_its_reach_the_polynomial_is_the_rays_to_the_bit() {
    let rig = layered_rig();
    let (map, exact) = (stage(&rig, TriangulateMethod::Polynomial), stage(&rig, TriangulateMethod::Rays));
    assert!(map.map_error_mm().unwrap() <= 5e-4);
    for far in [DVec3::new(4.0, 0.0, 45.0), DVec3::new(4.0, -9.0, 29.0), DVec3::new(-5.0, 0.0, 29.0)] {
        let (left, right) = rig.project(far).unwrap();
        assert_eq!(point(&map, left, right), point(&exact, left, right), "{far}");
    }
    let (left, right) = rig.project(DVec3::new(4.0, 0.0, 28.0)).unwrap();
    assert_ne!(point(&map, left, right), point(&exact, left, right), "within reach the map answers");
    let mut unfit = Triangulator::new(
        &rig,
        &TriangulateParams { method: TriangulateMethod::Polynomial, ..Default::default() },
    )
    .unwrap();
    for rest in [vec![], vec![DVec3::NAN], vec![-DVec3::Z]] {
        unfit.fit_map(&rest);
        assert_eq!(unfit.map_error_mm(), None);
        assert_eq!(point(&unfit, left, right), point(&exact, left, right));
    }
}

/// A fit in steps is exact until it is done, and then what one at once is.
#[test]
fn a_map_fitted_step_by_step_is_the_map() {
    for rig in [parallel(), turned_rig(), layered_rig()] {
        let (whole, exact) =
            (stage(&rig, TriangulateMethod::Polynomial), stage(&rig, TriangulateMethod::Rays));
        let params = TriangulateParams { method: TriangulateMethod::Polynomial, ..Default::default() };
        let mut stepped = Triangulator::new(&rig, &params).unwrap();
        let (left, right) = rig.project(DVec3::new(4.0, 0.5, 28.0)).unwrap();
        stepped.begin_map(&rest());
        let mut steps = 1;
        loop {
            assert_eq!(stepped.map_error_mm(), None);
            assert_eq!(point(&stepped, left, right), point(&exact, left, right), "step {steps}");
            steps += 1;
            if !stepped.continue_map() {
                break;
            }
        }
        // Outline, nodes, checks, polynomials and at most four cuts into tiles.
        assert!((5..=8).contains(&steps), "{steps} steps");
        assert_eq!(stepped.map_error_mm(), whole.map_error_mm());
        assert_eq!(point(&stepped, left, right), point(&whole, left, right));
        assert!(!stepped.continue_map(), "a finished map stays");
        assert!(stepped.map_error_mm().is_some());
    }
}

/// The first-order covariance against 20000 draws, on every rung. The sample variance of n normal numbers has
/// a relative standard deviation of sqrt(2 / n) = 1 %; 5 % is five of them.
#[test]
fn covariance_agrees_with_monte_carlo() {
    let cases =
        ALL.map(|method| (parallel(), method)).into_iter().chain([(layered_rig(), TriangulateMethod::Rays)]);
    for (rig, method) in cases {
        let (stage, at, sigma) = (stage(&rig, method), DVec3::new(5.0, -4.0, 28.7), 0.09);
        let (left, right) = rig.project(at).unwrap();
        let mut stream = Stream::new(1, "centre noise");
        let draws = 20_000;
        let (mut sums, mut residual) = ([[0.0; 3]; 3], 0.0);
        for _ in 0..draws {
            let mut noise = || {
                let (x, y) = stream.normal_pair();
                DVec2::new(x, y) * sigma
            };
            let found =
                stage.point(0, &centre(left + noise(), sigma), &centre(right + noise(), sigma)).unwrap();
            let d = found.point_mm - at;
            residual += found.epipolar_px * found.epipolar_px / f64::from(draws);
            for i in 0..3 {
                for j in 0..3 {
                    sums[i][j] += d[i] * d[j] / f64::from(draws);
                }
            }
        }
        let expected = stage.point(0, &centre(left, sigma), &centre(right, sigma)).unwrap().covariance_mm2;
        for i in 0..3 {
            for j in 0..3 {
                let scale = (expected[i][i] * expected[j][j]).sqrt();
                assert!(
                    (sums[i][j] - expected[i][j]).abs() < 0.05 * scale,
                    "{method:?} {i} {j}: {sums:?} {expected:?}"
                );
            }
        }
        // Two rows of equal noise: the difference has twice the variance, on every rung.
        assert!((residual / (2.0 * sigma * sigma) - 1.0).abs() < 0.05, "{method:?}: {residual}");
    }
}

#[test]
fn row_17_disparity_zero_tiny_and_negative_are_typed_errors() {
    for method in ALL {
        let stage = stage(&parallel(), method);
        let left = DVec2::new(300.0, 200.0);
        for disparity in [0.0, 1e-12, -1e-12, -150.0, 0.999] {
            let found = point(&stage, left, left - DVec2::new(disparity, 0.0));
            let Err(TriangulateError::Disparity { index: 7, disparity_px, min_px, .. }) = found else {
                panic!("{disparity}: {found:?}");
            };
            // 300 - d is rounded to 2^-44 px, and the pixel to ray and back once more.
            assert!((disparity_px - disparity).abs() < 1e-12 && min_px == 1.0, "{disparity_px}");
        }
        assert!(point(&stage, left, left - DVec2::new(1.001, 0.0)).is_ok());
    }
}

#[test]
fn row_17_swapped_views_are_named() {
    for (rig, method) in
        [turned_rig(), layered_rig()].into_iter().flat_map(|rig| ALL.map(|m| (rig.clone(), m)))
    {
        let points = (0..9).map(|i| DVec3::new(f64::from(i) - 4.0, 1.0, 28.7));
        let (left, right): (Vec<_>, Vec<_>) = points.map(|p| rig.project(p).unwrap()).unzip();
        let covariance_px2 = vec![[[1e-3, 0.0], [0.0, 1e-3]]; 9];
        let centres = |positions_px| Centres { positions_px, covariance_px2: &covariance_px2 };
        let (stage, mut out) = (stage(&rig, method), Vec::new());
        let error = stage.run(centres(&right), centres(&left), &mut out).unwrap_err();
        assert!(matches!(error, TriangulateError::Disparity { affected: 9, of: 9, .. }), "{error:?}");
        assert!(error.to_string().contains("swapped"), "{error}");
        assert!(stage.run(centres(&left), centres(&right), &mut out).is_ok());
        assert_eq!(out.len(), 9);
    }
}

/// With the baseline going to zero the depth's error grows as 1 / B, and below a micrometre there is no rig.
#[test]
fn row_18_a_vanishing_baseline_is_refused_not_divided_by() {
    let at = DVec3::new(1.0, 2.0, 28.7);
    let camera = Camera { distortion: [0.0; 5], ..camera() };
    for method in ALL {
        let params = TriangulateParams { method, min_disparity_px: 1e-6, ..Default::default() };
        for baseline_mm in [8.0, 0.1, 0.001] {
            let rig = Rig::parallel(camera.clone(), baseline_mm);
            let (left, right) = rig.project(at).unwrap();
            let found = point(&Triangulator::new(&rig, &params).unwrap(), left, right).unwrap().point_mm;
            // Both pixels carry half an ulp of 512 (6e-14 px) from projection and as much from rectification.
            let bound = 4.0 * 6e-14 * at.length_squared() / (560.0 * baseline_mm) + 1e-12;
            assert!((found - at).length() < bound, "{method:?} {baseline_mm}: {found:?}");
        }
        for baseline_mm in [1e-4, 1e-12, 0.0] {
            let error = Triangulator::new(&Rig::parallel(camera.clone(), baseline_mm), &params).unwrap_err();
            assert!(matches!(error, TriangulateError::Rig(RigError::NoBaseline { .. })), "{error:?}");
        }
    }
}

/// Parallel rays have disparity zero wherever they point; they are parallel in the gel as well.
#[test]
fn row_18_parallel_rays_are_a_typed_error() {
    for (rig, method) in
        [turned_rig(), layered_rig()].into_iter().flat_map(|rig| ALL.map(|m| (rig.clone(), m)))
    {
        let stage = stage(&rig, method);
        for direction in [DVec3::Z, DVec3::new(0.2, -0.1, 1.0)] {
            let left = rig.left.project(direction).unwrap();
            let right = rig.right.project(rig.t_right_left.rotation * direction).unwrap();
            let found = point(&stage, left, right);
            assert!(matches!(found, Err(TriangulateError::Disparity { .. })), "{found:?}");
            let rays = [rig.view(View::Left).ray(left).unwrap(), rig.view(View::Right).ray(right).unwrap()];
            assert!(rays[0].direction.cross(rays[1].direction).length() < 1e-15);
        }
    }
}

#[test]
fn centres_that_make_no_pair_are_refused_by_name() {
    let (stage, at, mut out) =
        (stage(&parallel(), TriangulateMethod::Rays), [DVec2::new(400.0, 200.0)], Vec::new());
    let good = [[[1e-3, 0.0], [0.0, 1e-3]]];
    let both = Centres { positions_px: &at, covariance_px2: &good };
    let none = Centres { positions_px: &[], covariance_px2: &[] };
    assert_eq!(stage.run(both, none, &mut out), Err(TriangulateError::LengthMismatch { left: 1, right: 0 }));
    let uncertain = Centres { covariance_px2: &[], ..both };
    assert_eq!(
        stage.run(both, uncertain, &mut out),
        Err(TriangulateError::CovarianceCount { view: View::Right, markers: 1, covariances: 0 })
    );
    let right = DVec2::new(250.0, 200.0);
    for covariance_px2 in
        [[[0.0; 2]; 2], [[1.0, 2.0], [2.0, 1.0]], [[-1.0, 0.0], [0.0, -1.0]], [[f64::NAN; 2]; 2]]
    {
        for method in ALL {
            let stage = self::stage(&parallel(), method);
            assert!(point(&stage, at[0], right).is_ok());
            let found = stage.point(3, &centre(at[0], 0.1), &Centre { at_px: right, covariance_px2 });
            assert_eq!(found, Err(TriangulateError::Covariance { index: 3, view: View::Right }));
        }
    }
    // Rows 300 px apart are 15 mm apart in space: an answer, with a residual that says so, or a refusal.
    let far = stage.point(3, &centre(at[0], 0.1), &centre(right + DVec2::new(0.0, 250.0), 0.1));
    assert!(far.is_err() || far.unwrap().epipolar_px.abs() > 200.0);
}

/// A map in progress belongs to the rest surface before: after clearing it nothing is fitted any more.
#[test]
fn a_cleared_map_is_not_finished() {
    let rig = layered_rig();
    let params = TriangulateParams { method: TriangulateMethod::Polynomial, ..Default::default() };
    let mut stepped = Triangulator::new(&rig, &params).unwrap();
    for steps in 0..4 {
        stepped.begin_map(&rest());
        (0..steps).for_each(|_| assert!(stepped.continue_map()));
        stepped.clear_map();
        assert!(!stepped.continue_map(), "{steps} steps");
        assert_eq!(stepped.map_error_mm(), None);
    }
}
