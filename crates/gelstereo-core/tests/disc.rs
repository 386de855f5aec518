//! Where a disc's image has its centre, against the outline traced through layers and lens.
#![allow(clippy::unwrap_used)]

use gelstereo_core::camera::{Camera, Layer, Layers};
use gelstereo_core::math::{DVec2, DVec3, Pose, cos, sin, so3};
use gelstereo_core::rig::{Disc, Rig, RigView, View};
use proptest::prelude::*;
use std::f64::consts::TAU;

fn rig(distortion: [f64; 5], layers: Option<Layers>) -> Rig {
    let (fx_px, fy_px, cx_px, cy_px) = (600.0, 590.0, 319.5, 239.5);
    let camera = Camera { width_px: 640, height_px: 480, fx_px, fy_px, cx_px, cy_px, distortion };
    let rotation = so3::exp(DVec3::new(0.01, -0.08, 0.02));
    let t_right_left = Pose { rotation, translation_mm: DVec3::new(-8.0, 0.1, -0.2) };
    Rig { left: camera.clone(), right: camera, t_right_left, layers }
}

/// Centroid of the region within the traced outline, by Green's theorem. With the trapezoid rule on a smooth
/// closed curve of 64 points nothing is left but round-off, some 1e-12 px.
fn traced_centroid_px(view: &RigView<'_>, disc: &Disc) -> DVec2 {
    const POINTS: usize = 64;
    let middle = view.project(disc.centre_mm).unwrap();
    let outline: Vec<DVec2> = (0..POINTS)
        .map(|k| {
            let t = TAU * k as f64 / POINTS as f64;
            let rim = disc.centre_mm + disc.half_mm[0] * cos(t) + disc.half_mm[1] * sin(t);
            view.project(rim).unwrap() - middle
        })
        .collect();
    // The derivative of the curve from its Fourier series.
    let series = |k: usize| {
        let angle = |n: usize| TAU * (k * n % POINTS) as f64 / POINTS as f64;
        outline.iter().enumerate().fold((DVec2::ZERO, DVec2::ZERO), |(c, s), (n, p)| {
            (c + *p * (cos(angle(n)) * 2.0 / POINTS as f64), s + *p * (sin(angle(n)) * 2.0 / POINTS as f64))
        })
    };
    let harmonics: Vec<_> = (0..8).map(series).collect();
    let (mut area, mut moment) = (0.0, DVec2::ZERO);
    for (n, p) in outline.iter().enumerate() {
        let t = TAU * n as f64 / POINTS as f64;
        let slope = harmonics.iter().enumerate().fold(DVec2::ZERO, |sum, (k, (c, s))| {
            let k = k as f64;
            sum + (*s * cos(k * t) - *c * sin(k * t)) * k
        });
        area += 0.5 * p.perp_dot(slope);
        moment += *p * (p.perp_dot(slope) / 3.0);
    }
    moment / area
}

fn discs() -> impl Strategy<Value = Disc> {
    let turn = prop::array::uniform3(-0.7..0.7_f64);
    let at = (-8.0..8.0_f64, -6.0..6.0_f64, 24.0..32.0_f64);
    (turn, at, 0.1..0.4_f64, 0.7..1.3_f64).prop_map(|(turn, (x, y, z), radius_mm, stretch)| {
        let turn = so3::exp(DVec3::from_array(turn));
        let half_mm = [turn * DVec3::X * radius_mm * stretch, turn * DVec3::Y * radius_mm];
        Disc { centre_mm: DVec3::new(x, y, z), half_mm }
    })
}

proptest! {
    /// What is left is of the fourth order in the disc's radius over its depth, and, through layers, their
    /// lift's second derivatives Q, below Σ d (n² - 1) / n³ / reach² = 2.9 mm / (21 mm)²: times the mean
    /// square r² / 4, the slope of 0.45 and about f / z each for the lift itself and for the area, a tenth of
    /// f r² / z² with a factor of 1.5 to spare.
    #[test]
    fn it_is_the_centroid_of_the_traced_outline(
        disc in discs(), lens in any::<bool>(), layered in any::<bool>(),
    ) {
        let distortion = if lens { [-0.2, 0.05, 2e-3, -1e-3, 0.01] } else { [0.0; 5] };
        let layers = layered.then(|| Layers {
            normal: DVec3::new(0.05, -0.03, 1.0).normalize(),
            gap_mm: 16.0,
            plates: vec![Layer { thickness_mm: 3.0, index: 1.49 }],
            gel_index: 1.41,
        });
        let rig = rig(distortion, layers);
        for view in [View::Left, View::Right] {
            let view = rig.view(view);
            let (found, exact) = (view.disc_bias_px(&disc).unwrap(), traced_centroid_px(&view, &disc));
            let size = disc.half_mm[0].length().max(disc.half_mm[1].length()) / 24.0;
            let bound = 600.0 * (4.0 * size.powi(4) + if layered { 0.1 * size * size } else { 0.0 });
            prop_assert!((found - exact).length() < bound, "{found} {exact} {bound:e}");
        }
    }
}

/// The textbook's case: on the axis, tilted by a, the bias is f r² sin a cos a / z².
#[test]
fn on_the_axis_it_is_the_textbooks() {
    let rig = rig([0.0; 5], None);
    for tilt in [0.0, 0.2, 0.5, 1.0] {
        let turn = so3::exp(DVec3::new(0.0, tilt, 0.0));
        let half_mm = [turn * DVec3::X * 0.3, turn * DVec3::Y * 0.3];
        let disc = Disc { centre_mm: DVec3::new(0.0, 0.0, 28.0), half_mm };
        let found = rig.view(View::Left).disc_bias_px(&disc).unwrap();
        let expected = 600.0 * 0.09 * sin(tilt) * cos(tilt) / (28.0 * 28.0);
        assert!(
            (found.length() - expected).abs() < 1e-15 * 600.0 && found.y.abs() < 1e-15,
            "{found} {expected}"
        );
    }
}

#[test]
fn a_disc_behind_the_camera_is_refused() {
    let disc = Disc { centre_mm: -DVec3::Z, half_mm: [DVec3::X, DVec3::Y] };
    assert!(rig([0.0; 5], None).view(View::Left).disc_bias_px(&disc).is_err());
}
