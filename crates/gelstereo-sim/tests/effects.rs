//! Effects on the gel, against what their models say; and effects that are absent.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{images, press, rest, rigid, truth, with_effects, xy};
use gelstereo_core::math::{DVec2, DVec3, cos, sin};
use gelstereo_sim::effects::{
    Defocus, Drag, DroppedFrames, Grain, Misprint, SensorNoise, Shoulder, Smears, Specks, Spread, UnevenLight,
};
use gelstereo_sim::{ContactState, Effects, GelKeyframe, Scene, Shape};
use proptest::prelude::*;

const SPHERE: Shape = Shape::Sphere { radius_mm: 4.0 };
const TILTED: DVec3 = DVec3::new(0.3, 0.4, 0.0);

fn shoulder(decay_thicknesses: f64) -> Effects {
    Effects { shoulder: Some(Shoulder { decay_thicknesses }), ..Effects::default() }
}

fn drag() -> Effects {
    Effects { drag: Some(Drag::default()), ..Effects::default() }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn a_shoulder_obeys_its_membrane_and_is_never_below_the_part(
        decay in 0.05..1.5, depth in 0.2..2.5, x in -6.0..6.0, turned in any::<bool>(),
    ) {
        let shape = Shape::Board { size_mm: [12.0, 9.0], block_mm: [5.0, 4.0], protrusion_mm: 1.0 };
        let rotation = if turned { TILTED } else { DVec3::new(core::f64::consts::PI, 0.0, 0.0) };
        let scene = with_effects(shape.clone(), shoulder(decay));
        let contact = press(&scene, rotation, DVec2::new(x, 0.0), depth);
        let imprint = truth(&rigid(shape), Some(&contact));
        let found = truth(&scene, Some(&contact));
        let h = &found.indentation_mm;
        let l2 = (decay * 5.0 / 0.9) * (decay * 5.0 / 0.9);
        for i in 0..625 {
            prop_assert!(h[i] >= imprint.indentation_mm[i]);
            prop_assert!(!found.in_contact[i] || imprint.in_contact[i], "contact lies within the silhouette");
            let (row, col) = (i / 25, i % 25);
            let beside = [(row > 0, -25), (row < 24, 25), (col > 0, -1), (col < 24, 1)];
            let curvature: f64 = beside
                .iter()
                .filter(|&&(exists, _)| exists)
                .map(|&(_, step)| h[(i as isize + step) as usize] - h[i])
                .sum();
            let pressure = h[i] - l2 * curvature;
            // The solver leaves 1e-6 mm; an error e of h is at most (1 + 8 l²) e of pressure.
            let slack = 1e-6 * (1.0 + 8.0 * l2);
            prop_assert!(pressure > -slack, "the part does not pull: {pressure}");
            prop_assert!(
                found.in_contact[i] || pressure < slack,
                "nothing presses beside the part: {pressure}"
            );
        }
    }

    #[test]
    fn markers_in_contact_stick_to_a_dragging_part(
        dx in -0.5..0.5, dy in -0.5..0.5, twist in -0.3..0.3, depth in 0.5..2.5,
    ) {
        let scene = with_effects(SPHERE, drag());
        let contact = ContactState {
            shear_mm: [dx, dy],
            twist_rad: twist,
            ..press(&scene, TILTED, DVec2::new(dx, dy), depth)
        };
        let (still, found) = (rest(&scene), truth(&scene, Some(&contact)));
        let motion = |i: usize| xy(found.points_mm[i] - still.points_mm[i]);
        // Who touched the part when it came down; others may have come under it since, and do not stick.
        let first = truth(&scene, Some(&press(&scene, TILTED, DVec2::ZERO, depth)));
        let touched: Vec<usize> = (0..625).filter(|&i| first.in_contact[i]).collect();
        prop_assert!(touched.len() > 4);
        // One rigid motion for all: u(x) - u(y) = (R - 1)(x - y), whatever the centre is.
        let apart = |a: usize, b: usize| xy(still.points_mm[a] - still.points_mm[b]);
        for &i in &touched {
            let arm = apart(i, touched[0]);
            let turned =
                DVec2::new(cos(twist) * arm.x - sin(twist) * arm.y, sin(twist) * arm.x + cos(twist) * arm.y);
            prop_assert!((motion(i) - motion(touched[0]) - (turned - arm)).length() < 1e-12);
        }
        // The ball sits over the lattice's centre, so the twist's centre is there by symmetry, and shear is
        // what is left.
        let mean = touched.iter().map(|&i| motion(i)).sum::<DVec2>() / touched.len() as f64;
        prop_assert!((mean - DVec2::new(dx, dy)).length() < 1e-12);
        let fastest = touched.iter().map(|&i| motion(i).length()).fold(0.0, f64::max);
        prop_assert!((0..625).all(|i| motion(i).length() <= fastest * core::f64::consts::SQRT_2 + 1e-6));
        prop_assert!(motion(0).length() < 0.25 * fastest, "the corner hardly moves");
    }
}

#[test]
fn displaced_gel_moves_away_from_the_contact() {
    let effects = Effects { spread: Some(Spread::default()), ..Effects::default() };
    let scene = with_effects(SPHERE, effects);
    let found = truth(&scene, Some(&press(&scene, DVec3::ZERO, DVec2::ZERO, 1.5)));
    let still = rest(&scene);
    let motion: Vec<DVec2> = (0..625).map(|i| xy(found.points_mm[i] - still.points_mm[i])).collect();
    let arm = |i: usize| xy(still.points_mm[i]) - DVec2::new(4.0, 0.0);
    assert!(motion[312].length() < 1e-6, "the middle stays");
    for i in 0..625 {
        // 1e-6 mm is what the solver leaves; at the border one-sided differences turn the motion a little.
        assert!(motion[i].dot(arm(i)) > -1e-6, "marker {i} moves inwards");
        assert!((motion[i] + motion[624 - i]).length() < 1e-5, "the two sides mirror each other");
    }
    let most = motion.iter().map(|u| u.length()).fold(0.0, f64::max);
    assert!((0.05..0.4).contains(&most), "{most} mm");
}

fn later() -> GelKeyframe {
    GelKeyframe { time_s: 1.0, ..GelKeyframe::default() }
}

/// Effects draw from streams of their own: joining one changes nothing of what another one drew.
#[test]
fn effects_do_not_draw_from_each_other() {
    let only = |effects: Effects| Scene { effects, ..Scene::default() };
    let specks = Effects { specks: Some(Specks::default()), ..Effects::default() };
    let misprint =
        Effects { misprint: Some(Misprint { shift_mm: 0.1, ..Misprint::default() }), ..Effects::default() };
    let both = Effects {
        specks: specks.specks.clone(),
        smears: Some(Smears { random: 5, ..Smears::default() }),
        ..misprint.clone()
    };
    assert_eq!(rest(&only(both.clone())).points_mm, rest(&only(misprint)).points_mm);
    let flat = Effects { misprint: Some(Misprint::default()), ..both };
    assert_eq!(rest(&only(flat)).left_specks, rest(&only(specks)).left_specks);
}

/// Bits of a scene do not change when effects that do nothing join it: nobody draws from another's stream.
#[test]
fn absent_effects_leave_identical_bits() {
    let only = |effects: Effects| Scene { effects, ..Scene::default() };
    let noise = Effects { sensor_noise: Some(SensorNoise::default()), ..Effects::default() };
    let plain = images(&only(noise.clone()), 3);
    let joined = Effects {
        shoulder: Some(Shoulder::default()),
        spread: Some(Spread::default()),
        drag: Some(Drag::default()),
        grain: Some(Grain { sigma_levels: 0.0, size_px: 1.0 }),
        uneven_light: Some(UnevenLight { gain: 1.0, across: 0.0, down: 0.0, corner_loss: 0.0 }),
        misprint: Some(Misprint::default()),
        specks: Some(Specks { count: 0, ..Specks::default() }),
        smears: Some(Smears::default()),
        dropped_frames: Some(DroppedFrames::default()),
        ..noise.clone()
    };
    assert_eq!(images(&only(joined), 3), plain);
    let still = Scene { gel_motion: vec![GelKeyframe::default(), later()], ..only(noise.clone()) };
    assert_eq!(images(&still, 3), plain, "a gel that moves by nothing");
    assert_eq!(images(&only(noise), 3), plain, "and on every run");
}

#[test]
fn without_drag_and_spread_markers_move_along_the_view_only() {
    let scene = with_effects(SPHERE, shoulder(0.5));
    let contact = ContactState { shear_mm: [0.4, 0.2], ..press(&scene, DVec3::ZERO, DVec2::ZERO, 1.0) };
    let (found, still) = (truth(&scene, Some(&contact)), rest(&scene));
    assert!((0..625).all(|i| xy(found.points_mm[i]) == xy(still.points_mm[i])));
}

#[test]
fn streams_differ_between_views_frames_and_seeds() {
    let effects = Effects {
        sensor_noise: Some(SensorNoise::default()),
        defocus: Some(Defocus::default()),
        ..Effects::default()
    };
    let scene = Scene { effects, ..Scene::default() };
    let other = Scene { seed: 2, ..scene.clone() };
    let [left, right] = images(&scene, 0);
    // A part of the image without dots in either view: the rows above the lattice.
    let bare = |image: &[u8]| image[..640 * 20].to_vec();
    assert_ne!(bare(&left), bare(&right));
    assert_ne!(bare(&left), bare(&images(&scene, 1)[0]));
    assert_ne!(bare(&left), bare(&images(&other, 0)[0]));
}
