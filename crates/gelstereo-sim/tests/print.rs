//! What is wrong with the print: displaced, merged and spurious dots.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{images, press, rest, truth};
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_sim::effects::{Misprint, Specks, Wear};
use gelstereo_sim::{Effects, Scene, Shape, Sight, Simulator, Truth};
use proptest::prelude::*;

fn misprinted(misprint: Misprint) -> Scene {
    Scene { effects: Effects { misprint: Some(misprint), ..Effects::default() }, ..Scene::default() }
}

/// Dark pixels that hang together with the one at `start`.
fn blob(image: &[u8], start: DVec2) -> Vec<usize> {
    let start = (start.y.round() as usize) * 640 + start.x.round() as usize;
    let (mut found, mut open) = (vec![false; image.len()], vec![start]);
    let mut pixels = Vec::new();
    while let Some(i) = open.pop() {
        if !found[i] && image[i] < 110 {
            found[i] = true;
            pixels.push(i);
            open.extend([i - 1, i + 1, i - 640, i + 640]);
        }
    }
    pixels
}

/// Area (px²) and centroid of the ink in a blob and the pixels around it.
fn inked(image: &[u8], pixels: &[usize]) -> (f64, DVec2) {
    let ring = [-641, -640, -639, -1, 0, 1, 639, 640, 641];
    let mut around: Vec<usize> =
        pixels.iter().flat_map(|&i| ring.map(|step| i.wrapping_add_signed(step))).collect();
    around.sort_unstable();
    around.dedup();
    let share = |i: usize| (170.0 - f64::from(image[i])) / 120.0;
    let area: f64 = around.iter().map(|&i| share(i)).sum();
    let moment: DVec2 =
        around.iter().map(|&i| DVec2::new((i % 640) as f64, (i / 640) as f64) * share(i)).sum();
    (area, moment / area)
}

fn centroid(pixels: &[usize]) -> DVec2 {
    let sum: DVec2 = pixels.iter().map(|&i| DVec2::new((i % 640) as f64, (i / 640) as f64)).sum();
    sum / pixels.len() as f64
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn misprinted_dots_are_where_truth_says(
        shift in 0.02..0.1, radius in 0.0..0.25, seed in any::<u64>(), turn in -3.0..3.0,
    ) {
        let mut scene = misprinted(Misprint { shift_mm: shift, radius_share: radius, ..Misprint::default() });
        scene.seed = seed;
        scene.gel.rotation_rad = turn;
        scene.gel.rows = 17; // stay in sight whatever the turn
        scene.gel.cols = 17;
        let found = rest(&scene);
        let ideal = rest(&Scene { effects: Effects::default(), ..scene.clone() });
        let [left, _] = images(&scene, 0);
        let mut away = Vec::new();
        for (i, dot) in found.left_dots.iter().enumerate() {
            let pixels = blob(&left, found.left_px[i]);
            let (ink, centre) = inked(&left, &pixels);
            // Half a level of 120 on each of 40 border pixels, about as far from the centre as the radius:
            // 0.02 px at most for the smallest dots.
            prop_assert!((centre - found.left_px[i]).length() < 0.02);
            let area = core::f64::consts::PI * dot.outline.radius_px() * dot.outline.radius_px();
            prop_assert!((ink - area).abs() < 0.2, "{ink} px² for {area}");
            let share = dot.outline.radius_px() / (0.22 * 560.0 / 28.7);
            prop_assert!((share - 1.0).abs() <= radius + 1e-9, "the flat gel stretches no dot: {share}");
            prop_assert!((found.normals[i] - DVec3::NEG_Z).length() < 1e-9);
            away.push((found.points_mm[i] - ideal.points_mm[i]).length());
        }
        let most = away.iter().fold(0.0_f64, |a, &b| a.max(b));
        prop_assert!(most <= shift && most > 0.9 * shift, "289 draws fill the disc: {most}");
        // Evenly over the disc: mean square of the distance is half the square of the radius, within five
        // standard errors of 289 draws (r² is uniform: 0.29 / 17).
        let mean = away.iter().map(|a| a * a).sum::<f64>() / 289.0 / (shift * shift);
        prop_assert!((mean - 0.5).abs() < 0.085, "{mean}");
    }

    /// A tilted plane strains all dots alike, wherever they were printed.
    #[test]
    fn a_misprint_is_no_strain(tilt in -0.3..0.3, seed in any::<u64>()) {
        let misprint = Some(Misprint { shift_mm: 0.2, ..Misprint::default() });
        let mut scene =
            Scene { seed, indenter: Some(Shape::Box { size_mm: [60.0, 60.0, 60.0] }), ..Scene::default() };
        let mut contact = press(&scene, DVec3::new(0.0, tilt, 0.0), DVec2::ZERO, 0.0);
        contact.t_sensor_object.translation_mm =
            DVec3::new(4.0, 0.0, 26.2) + contact.t_sensor_object.transform_vector(DVec3::Z) * 30.0;
        scene.effects.misprint = misprint;
        let found = truth(&scene, Some(&contact));
        let facing = contact.t_sensor_object.transform_vector(DVec3::NEG_Z);
        for (i, normal) in found.normals.iter().enumerate() {
            let inner = (i % 25).clamp(1, 23) == i % 25;
            let plane = found.indentation_mm.iter().all(|&h| h > 0.0 && h < 5.0);
            prop_assert!(!inner || !plane || (*normal - facing).length() < 1e-9, "{normal} for {facing}");
        }
    }
}

#[test]
fn merged_dots_are_one_blob_and_two_truths() {
    let merged = vec![[3, 4, 3, 5], [10, 10, 11, 10], [24, 24, 24, 23]];
    let scene = misprinted(Misprint { merged: merged.clone(), ..Misprint::default() });
    let (found, views) = (rest(&scene), images(&scene, 0));
    assert_eq!(found.points_mm, rest(&Scene::default()).points_mm, "ink moves no marker");
    let joined = |i: usize| merged.iter().any(|&[r, c, s, d]| i == r * 25 + c || i == s * 25 + d);
    for (image, (at, dots)) in
        views.iter().zip([(&found.left_px, &found.left_dots), (&found.right_px, &found.right_dots)])
    {
        for &[r, c, s, d] in &merged {
            let (p, q) = (at[r * 25 + c], at[s * 25 + d]);
            let (first, mut second) = (blob(image, p), blob(image, q));
            let mut sorted = first.clone();
            sorted.sort_unstable();
            second.sort_unstable();
            assert_eq!(sorted, second, "one blob");
            assert!((centroid(&first) - (p + q) * 0.5).length() < 0.2, "in the middle of the two");
            // Two discs and the bar between them, which overlaps each disc by a bit less than its radius.
            let r = 0.22 * 560.0 / 28.7;
            let bar = 1.4 * r * (0.9 * 560.0 / 28.7 - 2.0 * r);
            let area = 2.0 * core::f64::consts::PI * r * r + bar;
            assert!((first.len() as f64 - area).abs() < 0.1 * area, "{} for {area}", first.len());
        }
        for (i, dot) in dots.iter().enumerate() {
            assert_eq!(dot.sight, if joined(i) { Sight::Merged } else { Sight::Whole });
        }
    }
}

#[test]
fn specks_lie_between_the_dots_and_stay_on_the_gel() {
    let effects = Effects { specks: Some(Specks { count: 9, ..Specks::default() }), ..Effects::default() };
    let scene = Scene { effects, ..Scene::default() };
    let (found, [left, right]) = (rest(&scene), images(&scene, 0));
    let plain = images(&Scene::default(), 0);
    assert_eq!(found.left_specks.len(), 9);
    for (image, plain, specks, dots) in [
        (&left, &plain[0], &found.left_specks, &found.left_px),
        (&right, &plain[1], &found.right_specks, &found.right_px),
    ] {
        let mut changed: Vec<usize> = (0..image.len()).filter(|&i| image[i] != plain[i]).collect();
        for speck in specks {
            let at = speck.centre_px;
            assert!(dots.iter().all(|&p| (p - at).length() > 4.3 + speck.radius_px()), "it touches no dot");
            changed.retain(|&i| {
                let off = DVec2::new((i % 640) as f64, (i / 640) as f64) - at;
                off.x.abs() > speck.reach_px().x + 1.0 || off.y.abs() > speck.reach_px().y + 1.0
            });
        }
        assert!(changed.is_empty(), "nothing else changes");
    }
    // 0.06 to 0.2 mm.
    assert!(found.left_specks.iter().all(|s| (1.17..3.91).contains(&s.radius_px())));
    // A plane that comes down flat moves dots and specks towards the camera alike.
    let mut pressed = Scene { indenter: Some(Shape::Box { size_mm: [60.0, 60.0, 10.0] }), ..scene.clone() };
    let down = press(&pressed, DVec3::ZERO, DVec2::ZERO, 1.0);
    let moved = truth(&pressed, Some(&down));
    for (before, after) in found.left_specks.iter().zip(&moved.left_specks) {
        let centre = DVec2::new(319.5, 239.5);
        let expected = centre + (before.centre_px - centre) * (28.7 / 27.7);
        assert!((after.centre_px - expected).length() < 1e-9);
    }
    pressed.seed = 2;
    assert_ne!(truth(&pressed, None).left_specks, found.left_specks);
}

/// Radii shrink as the model says, which is written down again; centres stay, and so does what the gel does.
#[test]
fn dots_wear_off_over_time() {
    let wear = Wear { share: 0.1, share_per_s: 0.6, uneven_share: 0.5 };
    let scene = Scene { effects: Effects { wear: Some(wear), ..Effects::default() }, ..Scene::default() };
    let fresh = rest(&Scene::default());
    let mut simulator = Simulator::new(&scene, None).unwrap();
    let mut truth = Truth::default();
    let mut before = vec![1.0; 625];
    for (frame, gone) in [(0, 0.1), (30, 0.7), (3000, 60.1)] {
        simulator.moment(None, frame, &mut truth);
        assert_eq!(truth.points_mm, fresh.points_mm);
        for (i, (dot, fresh)) in truth.left_dots.iter().zip(&fresh.left_dots).enumerate() {
            let left = dot.outline.radius_px() / fresh.outline.radius_px();
            let [least, most] = [1.5, 0.5].map(|pace: f64| (1.0 - pace * gone).max(0.01));
            assert!((least - 1e-9..=most + 1e-9).contains(&left), "{left} at frame {frame}");
            assert!(left <= before[i] + 1e-9);
            assert!((dot.outline.centre_px - fresh.outline.centre_px).length() < 1e-9);
            before[i] = left;
        }
    }
    // Nothing is left to see.
    let (mut left, mut right) = (Vec::new(), Vec::new());
    simulator.render(&truth, 3000, &mut left, &mut right);
    assert!(left.iter().chain(&right).all(|&level| level >= 169));
}
