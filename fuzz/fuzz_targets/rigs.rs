//! Rigs of any numbers: refused by name, or points, pixels and covariances that are finite; what a valid rig
//! projects, it finds again or refuses, by every method.
#![no_main]

use gelstereo_core::camera::{Camera, Layer, Layers};
use gelstereo_core::math::linalg::eigen;
use gelstereo_core::math::{DVec2, DVec3, Pose, so3};
use gelstereo_core::params::{Params, TriangulateMethod};
use gelstereo_core::rig::Rig;
use gelstereo_core::triangulate::{Centre, Triangulator};
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

/// A plausible number near `usual`, or now and then any number.
fn number(u: &mut Unstructured<'_>, usual: f64, spread: f64) -> Result<f64> {
    Ok(match u.int_in_range(0..=31_u8)? {
        0 => u.arbitrary()?,
        _ => usual + spread * f64::from(u.arbitrary::<i16>()?) / 32768.0,
    })
}

fn vector(u: &mut Unstructured<'_>, usual: DVec3, spread: f64) -> Result<DVec3> {
    Ok(DVec3::new(number(u, usual.x, spread)?, number(u, usual.y, spread)?, number(u, usual.z, spread)?))
}

fn camera(u: &mut Unstructured<'_>) -> Result<Camera> {
    let mut distortion = [0.0; 5];
    if u.arbitrary()? {
        for k in &mut distortion {
            *k = number(u, 0.0, 0.3)?;
        }
    }
    let (fx_px, fy_px) = (number(u, 600.0, 300.0)?, number(u, 600.0, 300.0)?);
    let (cx_px, cy_px) = (number(u, 320.0, 100.0)?, number(u, 240.0, 100.0)?);
    Ok(Camera { width_px: 640, height_px: 480, fx_px, fy_px, cx_px, cy_px, distortion })
}

fn layers(u: &mut Unstructured<'_>) -> Result<Option<Layers>> {
    if u.arbitrary()? {
        return Ok(None);
    }
    let normal = vector(u, DVec3::Z, 0.3)?.normalize_or_zero();
    let plates = (0..u.int_in_range(0..=3)?)
        .map(|_| Ok(Layer { thickness_mm: number(u, 2.0, 2.0)?, index: number(u, 1.5, 0.6)? }))
        .collect::<Result<_>>()?;
    Ok(Some(Layers { normal, gap_mm: number(u, 15.0, 15.0)?, plates, gel_index: number(u, 1.4, 0.5)? }))
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let (left, right) = (camera(&mut u)?, camera(&mut u)?);
    let rotation = so3::exp(vector(&mut u, DVec3::ZERO, 0.3)?);
    let translation_mm = vector(&mut u, DVec3::new(-8.0, 0.0, 0.0), 4.0)?;
    let rig = Rig { left, right, t_right_left: Pose { rotation, translation_mm }, layers: layers(&mut u)? };
    let mut params = Params::default();
    params.triangulate.min_disparity_px = number(&mut u, 0.5, 0.499)?;
    let mut stages = Vec::new();
    for method in [TriangulateMethod::Q, TriangulateMethod::Polynomial, TriangulateMethod::Rays] {
        params.triangulate.method = method;
        let Ok(stage) = Triangulator::new(&rig, &params.triangulate) else { return Ok(()) };
        stages.push(stage);
    }
    stages[1].fit_map(&[vector(&mut u, DVec3::new(0.0, 0.0, 30.0), 15.0)?]);
    while !u.is_empty() {
        let covariances = [covariance(&mut u)?, covariance(&mut u)?];
        let point_mm = vector(&mut u, DVec3::new(0.0, 0.0, 30.0), 15.0)?;
        let pixels = vector(&mut u, DVec3::new(320.0, 240.0, 200.0), 300.0)?;
        let seen = rig.project(point_mm);
        if let Ok((left_px, right_px)) = seen {
            assert!(left_px.is_finite() && right_px.is_finite(), "{point_mm}: {left_px} {right_px}");
        }
        for stage in &stages {
            if let Ok((left_px, right_px)) = seen {
                check(stage, left_px, right_px, &covariances);
            }
            check(stage, pixels.truncate(), DVec2::new(pixels.z, pixels.y), &covariances);
        }
    }
    Ok(())
}

fn covariance(u: &mut Unstructured<'_>) -> Result<[[f64; 2]; 2]> {
    let (x, y) = (number(u, 0.05, 0.049)?, number(u, 0.05, 0.049)?);
    let shared = x * y * number(u, 0.0, 0.999)?;
    Ok([[x * x, shared], [shared, y * y]])
}

fn check(stage: &Triangulator, left_px: DVec2, right_px: DVec2, covariances_px2: &[[[f64; 2]; 2]; 2]) {
    let [left, right] = *covariances_px2;
    let left = Centre { at_px: left_px, covariance_px2: left };
    let right = Centre { at_px: right_px, covariance_px2: right };
    let Ok(found) = stage.point(0, &left, &right) else { return };
    let c = found.covariance_mm2;
    let numbers = c.iter().flatten().chain([&found.epipolar_px]);
    assert!(
        found.point_mm.is_finite() && numbers.into_iter().all(|x| x.is_finite()),
        "{left_px} {right_px}: {found:?}"
    );
    let trace = c[0][0] + c[1][1] + c[2][2];
    // A sum of squares, whose entries are rounded.
    let semi_definite = (0..3).all(|i| c[i][i] >= 0.0) && eigen(&c).values[0] >= -16.0 * f64::EPSILON * trace;
    assert!(semi_definite && (0..3).all(|i| (0..3).all(|j| c[i][j] == c[j][i])), "{found:?}");
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});
