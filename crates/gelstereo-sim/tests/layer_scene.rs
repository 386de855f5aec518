//! Scenes whose gel is an elastic layer.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{press, rest, rigid, simulator, truth, with_effects, xy};
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_sim::effects::{Drag, ElasticLayer, LargeStrain, Misprint, Relaxation, Shoulder, Spread};
use gelstereo_sim::{ContactState, Effects, Gel, Keyframe, Plan, Scene, SceneError, Shape, Switch, Truth};
use proptest::prelude::*;

const SPHERE: Shape = Shape::Sphere { radius_mm: 4.0 };

fn layered(poisson_ratio: f64, friction: f64) -> Effects {
    let elastic_layer = Some(ElasticLayer { poisson_ratio, friction, ..ElasticLayer::default() });
    Effects { elastic_layer, ..Effects::default() }
}

/// Sideways motion of every marker, and its height.
fn motion(scene: &Scene, contact: &ContactState) -> (Vec<DVec2>, Truth) {
    let (still, found) = (rest(scene), truth(scene, Some(contact)));
    (found.points_mm.iter().zip(&still.points_mm).map(|(&a, &b)| xy(a - b)).collect(), found)
}

/// A 1 mm press on an incompressible layer lifts the gel beside it by tens of micrometres and pushes markers
/// out; friction holds them.
#[test]
fn a_press_makes_a_bulge_and_moves_markers_outwards() {
    let scene = with_effects(SPHERE, layered(0.5, 0.0));
    let contact = press(&scene, DVec3::ZERO, DVec2::ZERO, 1.0);
    let (aside, found) = motion(&scene, &contact);
    let imprint = truth(&rigid(SPHERE), Some(&contact));
    let still = rest(&scene);
    let arm = |i: usize| xy(still.points_mm[i]) - DVec2::new(4.0, 0.0);
    for i in 0..625 {
        assert!(aside[i].dot(arm(i)) > -1e-6, "marker {i} moves inwards");
        assert!((aside[i] + aside[624 - i]).length() < 1e-6, "the two sides mirror each other");
        assert!((found.indentation_mm[i] - found.indentation_mm[624 - i]).abs() < 1e-6);
        assert!(!found.in_contact[i] || imprint.in_contact[i] || found.indentation_mm[i] > 0.0);
    }
    let rise = found.indentation_mm.iter().fold(0.0, |rise: f64, &h| rise.max(-h));
    assert!((0.02..0.08).contains(&rise), "{rise} mm");
    let most = |aside: &[DVec2]| aside.iter().map(|u| u.length()).fold(0.0, f64::max);
    assert!((0.03..0.12).contains(&most(&aside)), "{}", most(&aside));
    // Where the part sticks nothing moves sideways.
    let (held, found) = motion(&with_effects(SPHERE, layered(0.5, 1e3)), &contact);
    let within = held.iter().zip(&found.in_contact).filter(|&(_, &touches)| touches);
    let off = within.map(|(u, _)| u.length()).fold(0.0, f64::max);
    assert!(off < 1e-3, "{off} mm");
}

/// A part that sticks carries its markers along, to where it is; one that does not leaves them.
#[test]
fn friction_carries_markers() {
    for (friction, slack) in [(1e3, 1e-3), (0.0, f64::INFINITY)] {
        let scene = with_effects(SPHERE, layered(0.48, friction));
        let pose = press(&scene, DVec3::ZERO, DVec2::new(0.2, -0.1), 1.0);
        let contact = ContactState { shear_mm: [0.2, -0.1], twist_rad: 0.05, ..pose };
        let (aside, found) = motion(&scene, &contact);
        let still = rest(&scene);
        for i in (0..625).filter(|&i| found.in_contact[i]) {
            // The ball touches the lattice's centre first, so that this is where it turns.
            let arm = xy(still.points_mm[i]) - DVec2::new(4.0, 0.0);
            let carried = DVec2::new(0.2, -0.1) + arm.perp() * 0.05_f64.sin() - arm * (1.0 - 0.05_f64.cos());
            assert!((aside[i] - carried).length() < slack, "{:?} {carried:?}", aside[i]);
        }
        if friction == 0.0 {
            assert!(aside.iter().all(|u| u.length() < 0.08), "a part that slips carries nothing");
        }
    }
}

/// Turning the lattice in the plane turns what happens.
#[test]
fn a_turned_lattice_sees_the_same() {
    let straight = with_effects(SPHERE, layered(0.48, 0.5));
    let quarter = Gel { rotation_rad: core::f64::consts::FRAC_PI_2, ..Gel::default() };
    let turned = Scene { gel: quarter, ..straight.clone() };
    let contact = |shear: DVec2| ContactState {
        shear_mm: shear.to_array(),
        ..press(&straight, DVec3::ZERO, shear + DVec2::new(1.1, 0.4), 0.8)
    };
    let (a, first) = motion(&straight, &contact(DVec2::new(0.1, 0.05)));
    let (b, second) = motion(&turned, &contact(DVec2::new(0.1, 0.05)));
    let (places, moved) = (rest(&straight).points_mm, rest(&turned).points_mm);
    for i in 0..625 {
        // A quarter turn: a row becomes a column.
        let j = (24 - i % 25) * 25 + i / 25;
        assert!((moved[j] - places[i]).length() < 1e-9);
        // Two solves, each of which ends within 1e-4 mm of the part and of where friction holds.
        assert!((a[i] - b[j]).length() < 3e-4);
        assert!((first.indentation_mm[i] - second.indentation_mm[j]).abs() < 3e-4);
    }
}

#[test]
fn a_layer_takes_the_place_of_its_approximations() {
    let layer = layered(0.48, 0.8);
    let listed = [
        ("shoulder", Effects { shoulder: Some(Shoulder::default()), ..layer.clone() }),
        ("spread", Effects { spread: Some(Spread::default()), ..layer.clone() }),
        ("drag", Effects { drag: Some(Drag::default()), ..layer.clone() }),
    ];
    for (effect, effects) in listed {
        let scene = with_effects(SPHERE, effects);
        assert_eq!(scene.validate().unwrap_err(), SceneError::TwoModels { effect });
    }
    for (name, wrong) in [
        ("poisson_ratio", ElasticLayer { poisson_ratio: 0.51, ..ElasticLayer::default() }),
        ("friction", ElasticLayer { friction: f64::NAN, ..ElasticLayer::default() }),
        ("cells_per_pitch", ElasticLayer { cells_per_pitch: 0, ..ElasticLayer::default() }),
        ("border_pitches", ElasticLayer { border_pitches: 65, ..ElasticLayer::default() }),
        ("along a side", ElasticLayer { cells_per_pitch: 16, ..ElasticLayer::default() }),
    ] {
        let scene = with_effects(SPHERE, Effects { elastic_layer: Some(wrong), ..Effects::default() });
        let error = scene.validate().unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
    let thin = Gel { thickness_mm: 0.3, ..Gel::default() };
    let error = Scene { gel: thin, ..with_effects(SPHERE, layer) }.validate().unwrap_err().to_string();
    assert!(error.contains("raise cells_per_pitch"), "{error}");
}

/// A frame's bits do not depend on the frames before it.
#[test]
fn any_order_of_frames_gives_the_same_bits() {
    let scene = with_effects(SPHERE, layered(0.45, 0.6));
    let contacts: Vec<ContactState> = [0.3, 0.9, 0.5]
        .map(|depth| ContactState {
            shear_mm: [0.1 * depth, 0.0],
            ..press(&scene, DVec3::ZERO, DVec2::new(depth, 0.2), depth)
        })
        .into();
    let mut simulator = simulator(&scene);
    let mut run = |order: [usize; 3]| {
        let mut truths = [Truth::default(), Truth::default(), Truth::default()];
        order.into_iter().for_each(|i| simulator.truth(Some(&contacts[i]), &mut truths[i]));
        truths
    };
    assert_eq!(run([0, 1, 2]), run([2, 0, 1]));
}

/// Printed beside its place, a marker moves as the surface does where it is.
#[test]
fn misprinted_markers_follow_the_surface() {
    let shifted =
        Effects { misprint: Some(Misprint { shift_mm: 0.05, ..Misprint::default() }), ..layered(0.5, 0.0) };
    let (scene, plain) = (with_effects(SPHERE, shifted), with_effects(SPHERE, layered(0.5, 0.0)));
    let contact = press(&plain, DVec3::ZERO, DVec2::ZERO, 1.0);
    let ((a, found), (b, expected)) = (motion(&scene, &contact), motion(&plain, &contact));
    for i in 0..625 {
        // 0.05 mm on a motion that changes by at most a third of itself per mm.
        assert!((a[i] - b[i]).length() < 0.003, "marker {i}: {:?} {:?}", a[i], b[i]);
        let part = 0.05 * 0.8;
        assert!((found.indentation_mm[i] - expected.indentation_mm[i]).abs() < part, "marker {i}");
    }
}

fn parts() -> impl Strategy<Value = Shape> {
    prop_oneof![
        (1.0..12.0_f64).prop_map(|radius_mm| Shape::Sphere { radius_mm }),
        (0.8..6.0_f64, 2.0..30.0_f64)
            .prop_map(|(radius_mm, length_mm)| Shape::Cylinder { radius_mm, length_mm }),
        (1.0..30.0_f64, 1.0..30.0_f64, 2.0..9.0_f64).prop_map(|(x, y, z)| Shape::Box { size_mm: [x, y, z] }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    /// The bound of the plan holds: what the layer changes of the rigid imprint is within it, and markers in
    /// contact lie on the part, no other one within it.
    #[test]
    fn true_change_is_within_the_bound(
        shape in parts(), poisson_ratio in 0.0..=0.5_f64, friction in prop_oneof![Just(0.0), 0.1..3.0_f64],
        depth in 0.1..1.2_f64, turn in -1.6..1.6_f64, x in -8.0..8.0_f64, shear in -0.4..0.4_f64,
        twist in -0.1..0.1_f64, refined in any::<bool>(),
    ) {
        let gel = Gel { rows: 13, cols: 15, pitch_mm: 1.4.into(), ..Gel::default() };
        let mut scene = Scene { gel, ..with_effects(shape.clone(), layered(poisson_ratio, friction)) };
        let contact = ContactState {
            shear_mm: [shear, 0.5 * shear],
            twist_rad: twist,
            ..press(&scene, DVec3::new(0.0, turn, 0.3 * turn), DVec2::new(x, 0.3 * x), depth)
        };
        scene.trajectory = vec![Keyframe { time_s: 0.0, contact }];
        let mut names = vec!["elastic_layer"];
        if refined {
            scene.effects.relaxation = Some(Relaxation::default());
            scene.effects.large_strain = Some(LargeStrain::default());
            names.extend(["relaxation", "large_strain"]);
        }
        let plan = Plan::of(&scene, None).unwrap();
        let found = truth(&scene, Some(&contact));
        let dots = |truth: &Truth| -> Vec<DVec2> {
            truth.left_dots.iter().chain(&truth.right_dots).map(|dot| dot.outline.centre_px).collect()
        };
        for name in names {
            let mut without = scene.clone();
            let switches = &mut without.switches;
            let switch = match name {
                "elastic_layer" => &mut switches.elastic_layer,
                "relaxation" => &mut switches.relaxation,
                _ => &mut switches.large_strain,
            };
            *switch = Some(Switch::Off);
            let other = truth(&without, Some(&contact));
            let bound = plan.entries.iter().find(|entry| entry.effect == name).unwrap().bound;
            let apart = found.points_mm.iter().zip(&other.points_mm).map(|(a, b)| (*a - *b).length());
            let um = 1e3 * apart.fold(0.0, f64::max);
            prop_assert!(um <= bound.um, "{name}: {um} um of {}", bound.um);
            let px =
                dots(&found).iter().zip(dots(&other)).map(|(a, b)| (*a - b).length()).fold(0.0, f64::max);
            prop_assert!(px <= bound.px, "{name}: {px} px of {}", bound.px);
        }
        prop_assert!(found.points_mm.iter().all(|point| point.is_finite()));
        prop_assert!(found.indentation_mm.iter().all(|&h| h <= 5.0 && h > -depth));
    }
}
