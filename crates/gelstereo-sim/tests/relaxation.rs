//! A gel that relaxes and creeps back.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{press, rest, simulator, with_effects};
use gelstereo_core::math::{DVec2, DVec3, exp};
use gelstereo_sim::effects::{ElasticLayer, LargeStrain, Relaxation};
use gelstereo_sim::layer::PronyTerm;
use gelstereo_sim::{ContactState, Effects, Gel, Keyframe, Plan, Scene, SceneError, Shape, Switch, Truth};
use proptest::prelude::*;

const SPHERE: Shape = Shape::Sphere { radius_mm: 4.0 };

fn gel(terms: &[PronyTerm]) -> Effects {
    let elastic_layer = Some(ElasticLayer { friction: 0.5, cells_per_pitch: 1, ..ElasticLayer::default() });
    Effects { elastic_layer, relaxation: Some(Relaxation { terms: terms.to_vec() }), ..Effects::default() }
}

/// Pressed at once, held for a second, let go at once, at 50 frames a second.
fn held(effects: Effects) -> Scene {
    let mut scene = Scene { frame_rate_hz: 50.0, ..with_effects(SPHERE, effects) };
    scene.trajectory = [(0.0, 1.0), (1.0, 1.0), (1.02, -1.0), (1.5, -1.0)]
        .map(|(time_s, depth)| Keyframe {
            time_s,
            contact: ContactState {
                shear_mm: [0.1, 0.0],
                ..press(&scene, DVec3::ZERO, DVec2::new(0.1, 0.0), depth)
            },
        })
        .into();
    scene
}

fn moments(scene: &Scene) -> Vec<Truth> {
    let mut simulator = simulator(scene);
    (0..simulator.frames())
        .map(|frame| {
            let mut truth = Truth::default();
            simulator.moment(simulator.contact(frame).as_ref(), frame as u64, &mut truth);
            truth
        })
        .collect()
}

/// Free gel of one Prony term creeps back as e^(-(1 - g) t / τ), everywhere and in every direction.
#[test]
fn an_imprint_creeps_back_as_the_standard_solid() {
    let term = PronyTerm { share: 0.4, time_s: 0.25 };
    let (truths, still) = (moments(&held(gel(&[term]))), rest(&held(gel(&[term]))));
    let motion = |frame: usize, i: usize| truths[frame].points_mm[i] - still.points_mm[i];
    let deepest = (0..625).max_by(|&a, &b| motion(52, b).z.total_cmp(&motion(52, a).z)).unwrap();
    // Let go within a frame, 0.4 of the imprint is left but for what that frame took.
    let left = motion(52, deepest).z / motion(50, deepest).z;
    assert!((0.36..0.4).contains(&left), "{left}");
    assert!(truths[52].in_contact.iter().all(|&touches| !touches));
    for frame in 53..75 {
        // Linear steps of a share a = dt / τ err by a² / 12 of their exponent: 0.053 * 5e-4.
        let expected = exp(-(1.0 - term.share) * 0.02 / term.time_s);
        let ratio = motion(frame, deepest).length() / motion(frame - 1, deepest).length();
        assert!((ratio - expected).abs() < 5e-5, "{frame}: {ratio} {expected}");
    }
}

/// Held long enough, it lies as if it were elastic; while it is pressed it lies on the part.
#[test]
fn what_is_held_is_elastic_in_the_end() {
    let slow = moments(&held(gel(&[PronyTerm { share: 0.4, time_s: 0.05 }])));
    let elastic = moments(&held(Effects { relaxation: None, ..gel(&[]) }));
    for i in 0..625 {
        let off = (slow[50].points_mm[i] - elastic[50].points_mm[i]).length();
        // e^(-(1 - g) 20) is 6e-6; both solves end within 1e-4 mm.
        assert!(off < 5e-4, "marker {i}: {off}");
    }
}

/// Frames out of order have the bits of frames in order.
#[test]
fn memory_does_not_depend_on_the_order_of_frames() {
    let scene = held(gel(&Relaxation::default().terms));
    let ordered = moments(&scene);
    let mut simulator = simulator(&scene);
    for frame in [60, 3, 52, 51, 52] {
        let mut truth = Truth::default();
        simulator.moment(simulator.contact(frame).as_ref(), frame as u64, &mut truth);
        assert_eq!(truth, ordered[frame], "{frame}");
    }
}

/// A contact that somebody asks for beside the trajectory is not what the gel remembers.
#[test]
fn what_was_never_on_the_trajectory_is_not_remembered() {
    let scene = held(gel(&Relaxation::default().terms));
    let ordered = moments(&scene);
    let (mut simulator, mut truth) = (simulator(&scene), Truth::default());
    let pressed = simulator.contact(10);
    for contact in [None, Some(ContactState { shear_mm: [-0.3, 0.2], ..pressed.unwrap() })] {
        simulator.moment(contact.as_ref(), 10, &mut truth);
        simulator.moment(pressed.as_ref(), 11, &mut truth);
        assert_eq!(truth, ordered[11]);
    }
}

/// How far markers are apart at most, in any frame: um in space, px in the images.
fn apart(a: &[Truth], b: &[Truth]) -> [f64; 2] {
    let dots = |truth: &Truth| -> Vec<DVec2> {
        truth.left_dots.iter().chain(&truth.right_dots).map(|dot| dot.outline.centre_px).collect()
    };
    let frames = || a.iter().zip(b);
    let um = frames()
        .flat_map(|(a, b)| a.points_mm.iter().zip(&b.points_mm))
        .map(|(a, b)| 1e3 * (*a - *b).length());
    let px = frames().flat_map(|(a, b)| dots(a).into_iter().zip(dots(b))).map(|(a, b)| (a - b).length());
    [um.fold(0.0, f64::max), px.fold(0.0, f64::max)]
}

/// A part that comes, goes, drags and turns over a gel of few markers.
fn visits() -> impl Strategy<Value = Scene> {
    let layer = (0.0..=0.5_f64, prop_oneof![Just(0.0), 0.1..2.0_f64]);
    let term = (0.0..0.9_f64, 0.02..2.0_f64).prop_map(|(share, time_s)| PronyTerm { share, time_s });
    let ways = prop::collection::vec((-0.4..1.2_f64, -2.0..2.0_f64, -0.3..0.3_f64, -0.1..0.1_f64), 2..5);
    (layer, term, prop::bool::weighted(0.2), ways).prop_map(
        |((poisson_ratio, friction), term, large, ways)| {
            let gel = Gel { rows: 9, cols: 11, pitch_mm: 1.4.into(), ..Gel::default() };
            let bare = Scene { gel, frame_rate_hz: 10.0, ..with_effects(SPHERE, Effects::default()) };
            let contact = |&(depth_mm, x, shear, twist_rad): &(f64, f64, f64, f64)| ContactState {
                shear_mm: [shear, -0.5 * shear],
                twist_rad,
                ..press(&bare, DVec3::ZERO, DVec2::new(x, 0.3 * x), depth_mm)
            };
            let keyframe = |(k, way)| Keyframe { time_s: 0.3 * k as f64, contact: contact(way) };
            let trajectory = ways.iter().enumerate().map(keyframe).collect();
            let layer =
                ElasticLayer { poisson_ratio, friction, cells_per_pitch: 1, ..ElasticLayer::default() };
            let effects = Effects {
                elastic_layer: Some(layer),
                relaxation: Some(Relaxation { terms: vec![term] }),
                large_strain: large.then(LargeStrain::default),
                ..Effects::default()
            };
            Scene { trajectory, effects, ..bare }
        },
    )
}

/// The same without what refines its layer by that name.
fn without(scene: &Scene, name: &str) -> Scene {
    let mut scene = scene.clone();
    *scene.switches.get_mut(name).unwrap() = Some(Switch::Off);
    scene
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// In no frame, however the part has come there, does a refinement of the layer change more than its
    /// bound.
    #[test]
    fn true_change_is_within_the_bound_all_the_way(scene in visits()) {
        let (plan, whole) = (Plan::of(&scene, None).unwrap(), moments(&scene));
        for entry in
            plan.entries.iter().filter(|entry| ["relaxation", "large_strain"].contains(&entry.effect))
        {
            let [um, px] = apart(&whole, &moments(&without(&scene, entry.effect)));
            prop_assert!(um <= entry.bound.um, "{}: {um} um of {}", entry.effect, entry.bound.um);
            prop_assert!(px <= entry.bound.px, "{}: {px} px of {}", entry.effect, entry.bound.px);
        }
    }
}

/// A bound that is above nothing says nothing: the gel that is let go is a tenth of its bound off.
#[test]
fn the_bound_is_of_use() {
    let scene = held(gel(&[PronyTerm { share: 0.8, time_s: 0.5 }]));
    let [um, _] = apart(&moments(&scene), &moments(&without(&scene, "relaxation")));
    let plan = Plan::of(&scene, None).unwrap();
    let bound = plan.entries.iter().find(|entry| entry.effect == "relaxation").unwrap().bound;
    assert!((0.1 * bound.um..bound.um).contains(&um), "{um} um of {}", bound.um);
}

#[test]
fn refinements_need_the_layer_and_sensible_numbers() {
    let alone = Effects { relaxation: Some(Relaxation::default()), ..Effects::default() };
    let error = with_effects(SPHERE, alone).validate().unwrap_err();
    assert_eq!(error, SceneError::NeedsLayer { effect: "relaxation" });
    let alone = Effects { large_strain: Some(LargeStrain::default()), ..Effects::default() };
    let error = with_effects(SPHERE, alone).validate().unwrap_err();
    assert_eq!(error, SceneError::NeedsLayer { effect: "large_strain" });
    let term = |share, time_s| PronyTerm { share, time_s };
    for bad in [
        vec![],
        vec![term(1.0, 1.0)],
        vec![term(-0.1, 1.0)],
        vec![term(0.1, 0.0)],
        vec![term(0.1, f64::NAN)],
        vec![term(0.6, 1.0), term(0.6, 2.0)],
    ] {
        assert!(with_effects(SPHERE, gel(&bad)).validate().is_err(), "{bad:?}");
    }
    let rounds = Effects { large_strain: Some(LargeStrain { rounds: 0 }), ..gel(&[term(0.1, 1.0)]) };
    assert!(with_effects(SPHERE, rounds).validate().is_err());
}
