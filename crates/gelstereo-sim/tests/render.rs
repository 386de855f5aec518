//! Images against what the geometry says.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{images, press, rest, truth};
use core::f64::consts::{PI, TAU};
use gelstereo_core::math::{DVec2, DVec3, cos, sin};
use gelstereo_sim::effects::{Defocus, Grain, SensorNoise, UnevenLight};
use gelstereo_sim::{ContactState, Effects, Gel, Images, Scene, Shape, Sight, Simulator, Truth};
use proptest::prelude::*;

/// Four dots, 4.5 mm (88 px) apart.
fn sparse() -> Scene {
    Scene { gel: Gel { rows: 2, cols: 2, pitch_mm: 4.5.into(), ..Gel::default() }, ..Scene::default() }
}

fn with(effects: Effects) -> Scene {
    Scene { effects, ..Scene::default() }
}

fn render(scene: &Scene, contact: Option<&ContactState>) -> (Truth, [Vec<u8>; 2]) {
    let mut simulator = Simulator::new(scene, None).unwrap();
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    simulator.truth(contact, &mut truth);
    simulator.render(&truth, 0, &mut left, &mut right);
    (truth, [left, right])
}

/// Area (px²) and centroid of what differs from the gel's 170 within 20 px, in units of the contrast of 120.
fn blob(image: &[u8], near: DVec2) -> (f64, DVec2) {
    let (mut area, mut moment) = (0.0, DVec2::ZERO);
    let (x0, y0) = (near.x as usize, near.y as usize);
    for y in y0 - 20..=y0 + 20 {
        for x in x0 - 20..=x0 + 20 {
            let share = (170.0 - f64::from(image[y * 640 + x])) / 120.0;
            area += share;
            moment += DVec2::new(x as f64, y as f64) * share;
        }
    }
    (area, moment / area)
}

/// Centre of a dot's image: the middle of the box around its projected outline, which is an ellipse.
fn centre_of_outline(centre: DVec3, slope: DVec2, radius: f64) -> DVec2 {
    let outline = (0..20_000).map(|k| {
        let t = TAU * f64::from(k) / 20_000.0;
        let on_gel = DVec2::new(cos(t), sin(t)) * radius;
        let p = centre + on_gel.extend(slope.dot(on_gel));
        DVec2::new(319.5 + 560.0 * p.x / p.z, 239.5 + 560.0 * p.y / p.z)
    });
    let (low, high) = outline
        .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p: DVec2| (low.min(p), high.max(p)));
    (low + high) * 0.5
}

/// Rounding to grey levels moves the centroid by at most Σ|x| / 2 over contrast times area: with the about 34
/// border pixels of a dot of 4.3 px radius that is 34 · 4.3 · 0.64 / 2 / (120 · 58) = 0.007 px along each
/// axis.
const ROUNDING_PX: f64 = 0.0095;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn an_untilted_dot_lies_on_its_projected_centre(x in -1.0..1.0, y in -1.0..1.0, turn in 0.0..3.0) {
        let mut scene = sparse();
        scene.gel.centre_mm = [4.0 + x, y];
        scene.gel.rotation_rad = turn;
        let (truth, [left, right]) = render(&scene, None);
        let radius_px: f64 = 0.22 * 560.0 / 28.7;
        for (image, at) in [(&left, &truth.left_px), (&right, &truth.right_px)] {
            for &centre in at {
                let (area, found) = blob(image, centre);
                prop_assert!((found - centre).length() < ROUNDING_PX, "{found} for {centre}");
                prop_assert!((area / (PI * radius_px * radius_px) - 1.0).abs() < 0.005, "{area} px²");
            }
        }
    }

    #[test]
    fn a_tilted_dot_lies_where_the_ellipse_of_its_outline_does(
        tilt in -0.5..0.5, about in 0.0..TAU,
    ) {
        let mut scene = sparse();
        scene.gel.dot_radius_mm = 0.5;
        scene.indenter = Some(Shape::Box { size_mm: [30.0, 30.0, 30.0] });
        let axis = DVec3::new(cos(about), sin(about), 0.0);
        let mut contact = press(&scene, axis * tilt, DVec2::ZERO, 0.0);
        // Its near face is a plane through the gel's middle that all four dots lie on.
        contact.t_sensor_object.translation_mm =
            DVec3::new(4.0, 0.0, 26.5) + contact.t_sensor_object.transform_vector(DVec3::Z) * 15.0;
        let (truth, [left, _]) = render(&scene, Some(&contact));
        let normal = contact.t_sensor_object.transform_vector(DVec3::NEG_Z);
        let slope = -normal.truncate() / normal.z;
        prop_assume!(truth.indentation_mm.iter().all(|&h| h > 0.0 && h < 5.0));
        for (&point, &centre) in truth.points_mm.iter().zip(&truth.left_px) {
            let (_, found) = blob(&left, centre);
            let expected = centre_of_outline(point, slope, 0.5);
            prop_assert!((found - expected).length() < ROUNDING_PX, "{found} for {expected}");
            // f r² tan a / Z² for a dot that keeps its radius in the rest plane, and what is off the axis.
            let bound = 560.0 * 0.25 * slope.length() / (point.z * point.z) * 1.3;
            prop_assert!((found - centre).length() < bound + ROUNDING_PX);
        }
    }

    #[test]
    fn dots_may_leave_the_image(x in -40.0..40.0, y in -40.0..40.0, turn in -7.0..7.0) {
        let mut scene = Scene::default();
        scene.gel.centre_mm = [x, y];
        scene.gel.rotation_rad = turn;
        let (truth, views) = render(&scene, None);
        prop_assert_eq!(truth.left_px.len(), 625);
        for (image, at) in views.iter().zip([&truth.left_px, &truth.right_px]) {
            let visible = |p: &&DVec2| (5.0..634.0).contains(&p.x) && (5.0..474.0).contains(&p.y);
            for p in at.iter().filter(visible) {
                prop_assert_eq!(image[p.y as usize * 640 + p.x as usize], 50);
            }
            if at.iter().all(|p| p.x < -5.0 || p.x > 645.0 || p.y < -5.0 || p.y > 485.0) {
                prop_assert!(image.iter().all(|&v| v == 170));
            }
        }
    }
}

#[test]
fn a_missing_marker_is_in_truth_but_not_in_the_images() {
    let mut scene = Scene::default();
    scene.gel.missing = vec![[0, 0], [12, 7]];
    let (truth, views) = render(&scene, None);
    let full = rest(&Scene::default());
    assert_eq!((&truth.points_mm, &truth.left_px), (&full.points_mm, &full.left_px));
    assert_eq!((truth.left_dots[0].sight, full.left_dots[0].sight), (Sight::NotPrinted, Sight::Whole));
    for (image, at) in views.iter().zip([&truth.left_px, &truth.right_px]) {
        for (i, p) in at.iter().enumerate() {
            let expected = if i == 0 || i == 12 * 25 + 7 { 170 } else { 50 };
            assert_eq!(image[p.y as usize * 640 + p.x as usize], expected, "marker {i}");
        }
    }
}

#[test]
fn bright_dots_are_the_negative() {
    let mut scene = Scene::default();
    let [dark, _] = images(&scene, 0);
    scene.gel.bright_dots = true;
    let [bright, _] = images(&scene, 0);
    // 170 and 50 swap; both round half a level upwards.
    assert!(dark.iter().zip(&bright).all(|(&a, &b)| (219..=221).contains(&(u32::from(a) + u32::from(b)))));
    assert_eq!((dark[0], bright[0]), (170, 50));
}

#[test]
fn noise_has_the_mean_and_variance_it_was_given() {
    for sigma in [0.5, 2.0, 8.0] {
        let effects =
            Effects { sensor_noise: Some(SensorNoise { sigma_levels: sigma }), ..Effects::default() };
        let [left, _] = images(&with(effects), 7);
        // The left view has no dots left of column 150.
        let levels: Vec<f64> =
            left.chunks(640).flat_map(|row| row[..150].iter().map(|&v| f64::from(v))).collect();
        let n = levels.len() as f64;
        let mean = levels.iter().sum::<f64>() / n;
        let variance = levels.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (n - 1.0);
        // Five standard errors: of the mean σ / √n, of the variance σ² √(2 / n). Sheppard's 1/12 of rounding
        // holds to 1 % down to σ = 0.5.
        let expected = sigma * sigma + 1.0 / 12.0;
        assert!((mean - 170.0).abs() < 5.0 * (expected / n).sqrt(), "σ {sigma}: mean {mean}");
        assert!((variance / expected - 1.0).abs() < 5.0 * (2.0 / n).sqrt() + 0.01, "σ {sigma}: {variance}");
    }
}

#[test]
fn grain_has_the_spread_it_was_given_and_stays_from_frame_to_frame() {
    let grain = Grain { sigma_levels: 6.0, size_px: 1.0 };
    let scene = with(Effects { grain: Some(grain), ..Effects::default() });
    let [left, right] = images(&scene, 0);
    assert_eq!(images(&scene, 1), [left.clone(), right]);
    let levels: Vec<f64> =
        left.chunks(640).flat_map(|row| row[..150].iter().map(|&v| f64::from(v) - 170.0)).collect();
    let variance = levels.iter().map(|v| v * v).sum::<f64>() / levels.len() as f64;
    // About 4π σ² = 12.6 pixels share one independent value, so five standard errors are 5 √(2 · 12.6 / n) =
    // 9 %.
    assert!((variance / 36.0 - 1.0).abs() < 0.09, "{variance}");
}

#[test]
fn blur_keeps_the_sum_and_moves_no_dot() {
    let scene = sparse();
    let blurred = Scene {
        effects: Effects { defocus: Some(Defocus { sigma_px: 1.5 }), ..Effects::default() },
        ..scene.clone()
    };
    let (truth, [sharp, _]) = render(&scene, None);
    let (_, [soft, _]) = render(&blurred, None);
    for &at in &truth.left_px {
        let ((area, centre), (soft_area, soft_centre)) = (blob(&sharp, at), blob(&soft, at));
        assert!((soft_area / area - 1.0).abs() < 0.01 && (soft_centre - centre).length() < 0.01);
    }
    let steepest = |image: &[u8]| image.windows(2).map(|w| w[0].abs_diff(w[1])).max();
    assert!(steepest(&soft) < steepest(&sharp));
}

#[test]
fn light_is_uneven_as_it_was_asked_for() {
    let light = UnevenLight { gain: 1.0, across: 0.2, down: 0.0, corner_loss: 0.0 };
    let [left, _] = images(&with(Effects { uneven_light: Some(light), ..Effects::default() }), 0);
    // Gain 1 -+ 0.1 at the edges, half a pixel from them.
    assert_eq!((left[0], left[639]), (153, 187));
    let [corner, _] =
        images(&with(Effects { uneven_light: Some(UnevenLight::default()), ..Effects::default() }), 0);
    assert!(corner[0] < 128, "a quarter is lost in the corners");
}

#[test]
fn a_truth_of_another_lattice_shows_no_dots() {
    let mut simulator = Simulator::new(&Scene::default(), None).unwrap();
    let (mut left, mut right) = (Vec::new(), Vec::new());
    simulator.render(&truth(&sparse(), None), 0, &mut left, &mut right);
    assert!(left.len() == 640 * 480 && left.iter().chain(&right).all(|&v| v == 170));
}

/// Both rungs of `images`, on whatever a scene can hold: dots of other sizes, merged, cut, covered and among
/// dust, in uneven light. Levels differ by 0.02 (0.2 where dots merge) before they are rounded, so few round
/// to another number.
#[test]
fn fast_images_are_the_exact_ones() {
    let rough: Scene = toml::from_str(include_str!("../../../scenes/rough_ride.toml")).unwrap();
    for missing in [vec![], vec![[3, 3]]] {
        let mut scene = rough.clone();
        scene.gel.missing = missing;
        scene.gel.centre_mm = [1.0, -3.0];
        scene.effects.sensor_noise = None;
        let contact = press(&scene, DVec3::ZERO, DVec2::ZERO, 1.2);
        let (truth, fast) = render(&scene, Some(&contact));
        scene.images = Images::Exact;
        let (_, exact) = render(&scene, Some(&contact));
        for sight in [Sight::Whole, Sight::Cut, Sight::Merged, Sight::Outside] {
            assert!(truth.left_dots.iter().any(|dot| dot.sight == sight), "{sight:?}");
        }
        for (fast, exact) in fast.iter().zip(&exact) {
            assert!(fast.iter().zip(exact).all(|(a, b)| a.abs_diff(*b) <= 1));
            let other = fast.iter().zip(exact).filter(|(a, b)| a != b).count();
            assert!(other < fast.len() / 500, "{other} pixels");
        }
    }
}
