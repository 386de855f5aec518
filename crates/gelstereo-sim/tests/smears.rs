//! Patches on the images, against their definition pixel by pixel.
#![allow(clippy::unwrap_used)]

use gelstereo_core::math::DVec2;
use gelstereo_sim::effects::{Patch, Smears, Views};
use gelstereo_sim::{Effects, Scene, Sight, Simulator, Truth};
use proptest::prelude::*;

fn scene(smears: Smears) -> Scene {
    Scene { effects: Effects { smears: Some(smears), ..Effects::default() }, ..Scene::default() }
}

fn frame(scene: &Scene, frame: u64) -> (Truth, [Vec<u8>; 2]) {
    let mut simulator = Simulator::new(scene, None).unwrap();
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    simulator.moment(None, frame, &mut truth);
    simulator.render(&truth, frame, &mut left, &mut right);
    (truth, [left, right])
}

/// Share of the patch at a pixel, written down again: 1 within, 0 outside, 3t² - 2t³ between.
fn share(patch: &Patch, x: f64, y: f64) -> f64 {
    let (dx, dy) = (x - patch.centre_px[0], y - patch.centre_px[1]);
    let (s, c) = patch.rotation_rad.sin_cos();
    let (u, v) = ((c * dx + s * dy) / patch.half_size_px[0], (c * dy - s * dx) / patch.half_size_px[1]);
    let t = ((1.0 - (u * u + v * v).sqrt()) / patch.soft_share).clamp(0.0, 1.0);
    patch.opacity * t * t * (3.0 - 2.0 * t)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn a_patch_blends_its_level_in(
        x in -30.0..670.0, y in -30.0..510.0, a in 1.0..80.0, b in 1.0..30.0, turn in -3.0..3.0,
        soft in 0.1..1.0, opacity in 0.1..1.0, level in any::<u8>(),
    ) {
        let patch = Patch {
            centre_px: [x, y],
            half_size_px: [a, b],
            rotation_rad: turn,
            soft_share: soft,
            opacity,
            level,
            ..Patch::default()
        };
        let (_, plain) = frame(&Scene::default(), 0);
        let (truth, smeared) = frame(&scene(Smears { patches: vec![patch.clone()], ..Smears::default() }), 0);
        for (before, after) in plain.iter().zip(&smeared) {
            for (i, (&p, &q)) in before.iter().zip(after).enumerate() {
                let share = share(&patch, (i % 640) as f64, (i / 640) as f64);
                let expected = f64::from(p) + share * (f64::from(level) - f64::from(p));
                // Both images were rounded, the first one before it was blended.
                prop_assert!((f64::from(q) - expected).abs() < 1.001, "pixel {}: {} for {}", i, q, expected);
            }
        }
        // Who is said to be clear of the patch has no pixel changed; a marker under its middle is covered.
        for (dots, (before, after)) in
            [&truth.left_dots, &truth.right_dots].into_iter().zip(plain.iter().zip(&smeared))
        {
            for dot in dots {
                let (at, reach) = (dot.outline.centre_px, dot.outline.reach_px());
                let (low, high) = ((at - reach - 1.0).ceil(), (at + reach + 1.0).floor());
                let within = (low.y as usize..=high.y as usize)
                    .flat_map(|y| (low.x as usize..=high.x as usize).map(move |x| y * 640 + x));
                // Pixels that the dot covers or touches: their centres are up to half a diagonal beyond its
                // rim.
                let touched = |i: &usize| {
                    let pixel = DVec2::new((i % 640) as f64, (i / 640) as f64);
                    (pixel - at).length() < reach.x + 0.71
                };
                let changed = within.filter(touched).filter(|&i| before[i] != after[i]).count();
                prop_assert!(dot.sight != Sight::Whole || changed == 0);
                prop_assert!(dot.sight == Sight::Covered || share_at(&patch, at) < 1e-9);
            }
        }
    }
}

fn share_at(patch: &Patch, at: DVec2) -> f64 {
    share(patch, at.x, at.y)
}

#[test]
fn patches_come_and_go_and_know_their_view() {
    let patch = Patch { views: Views::Right, from_s: 0.1, until_s: 0.2, ..Patch::default() };
    let scene = scene(Smears { patches: vec![patch], ..Smears::default() });
    let (_, plain) = frame(&Scene::default(), 0);
    // 30 Hz: frames 3 to 5 are at 0.1, 0.133 and 0.167 s.
    for index in 0..8 {
        let (truth, [left, right]) = frame(&scene, index);
        let covered = truth.right_dots.iter().filter(|dot| dot.sight == Sight::Covered).count();
        assert_eq!(left, plain[0], "frame {index}");
        assert_eq!(
            (right != plain[1], covered > 0),
            ((3..6).contains(&index), (3..6).contains(&index)),
            "{index}"
        );
        assert!(truth.left_dots.iter().all(|dot| dot.sight == Sight::Whole));
    }
}

#[test]
fn random_patches_are_the_seeds_and_differ_between_views() {
    let smears = Smears { random: 40, lasting_s: 1e4, ..Smears::default() };
    let (_, views) = frame(&scene(smears.clone()), 0);
    assert_eq!(views, frame(&scene(smears.clone()), 0).1);
    assert_ne!(views, frame(&Scene { seed: 2, ..scene(smears) }, 0).1);
    let [changed_left, changed_right] = {
        let (_, plain) = frame(&Scene::default(), 0);
        [0, 1].map(|v| (0..640 * 480).filter(|&i| plain[v][i] != views[v][i]).collect::<Vec<_>>())
    };
    assert_ne!(changed_left, changed_right);
    // 40 ellipses of 30 x 6 px on average over 307200 px, fewer where they overlap; dark on dark does not
    // show.
    assert!((5_000..25_000).contains(&changed_left.len()), "{}", changed_left.len());
}
