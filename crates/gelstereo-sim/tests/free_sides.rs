//! An elastic layer with free sides.
#![allow(clippy::unwrap_used)]

use super::common::{press, simulator, truth, with_effects};
use gelstereo_core::contact::RestSurface;
use gelstereo_core::force::{ForceEstimator, MovedMarkers};
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::params::{ForceMethod, ForceParams};
use gelstereo_core::track::MarkerState;
use gelstereo_sim::effects::{Effects, ElasticLayer, LargeStrain};
use gelstereo_sim::{ContactState, Gel, Scene, Shape, Truth};

const SPHERE: Shape = Shape::Sphere { radius_mm: 5.0 };

fn scene(rim_mm: Option<f64>, friction: f64) -> Scene {
    let elastic_layer = Some(ElasticLayer { rim_mm, friction, ..ElasticLayer::default() });
    let scene = with_effects(SPHERE, Effects { elastic_layer, ..Effects::default() });
    // 15 markers, so that half of the gel is 1.4 times its thickness.
    let gel = Gel { rows: 15, cols: 15, ..scene.gel.clone() };
    Scene { gel, ..scene }
}

fn pressed(scene: &Scene, aside: DVec2, shear_mm: [f64; 2]) -> (Truth, f64) {
    let pose = press(scene, DVec3::ZERO, aside, 0.8);
    let found = truth(scene, Some(&ContactState { shear_mm, ..pose }));
    let force_n = found.loads.as_ref().unwrap().force_n.z;
    (found, force_n)
}

/// Farthest motion of a marker that free sides cause.
fn change_mm(one: &Truth, other: &Truth) -> f64 {
    one.points_mm.iter().zip(&other.points_mm).map(|(a, b)| (*a - *b).length()).fold(0.0, f64::max)
}

#[test]
fn far_sides_are_none_and_near_ones_soften_the_gel() {
    let (endless, force_n) = pressed(&scene(None, 0.8), DVec2::ZERO, [0.0; 2]);
    let mut last_mm = f64::INFINITY;
    for (rim_mm, most_mm) in [(0.9, 0.4), (3.0, 0.15), (10.0, 0.01), (60.0, 1e-7)] {
        let (found, softer_n) = pressed(&scene(Some(rim_mm), 0.8), DVec2::ZERO, [0.0; 2]);
        let changed_mm = change_mm(&found, &endless);
        assert!(changed_mm < most_mm && changed_mm < last_mm, "{rim_mm}: {changed_mm}");
        assert!(rim_mm > 20.0 || softer_n.abs() < force_n.abs(), "{rim_mm}: {softer_n} {force_n}");
        last_mm = changed_mm;
    }
    let (near, softer_n) = pressed(&scene(Some(0.9), 0.8), DVec2::ZERO, [0.0; 2]);
    assert!(change_mm(&near, &endless) > 0.03 && softer_n / force_n < 0.97, "{}", softer_n / force_n);
}

/// Sides of a square gel under a ball in its middle: four mirror axes, also where the part drags and sticks.
#[test]
fn a_square_gel_keeps_its_symmetry() {
    let scene = scene(Some(1.0), 0.5);
    let still = simulator_rest(&scene);
    let (found, _) = pressed(&scene, DVec2::ZERO, [0.0; 2]);
    let (dragged, _) = pressed(&scene, DVec2::ZERO, [0.1, 0.0]);
    let (back, _) = pressed(&scene, DVec2::ZERO, [-0.1, 0.0]);
    let last = still.len() - 1;
    for i in 0..still.len() {
        let moved = |truth: &Truth, i: usize| truth.points_mm[i] - still[i];
        let (a, b) = (moved(&found, i), moved(&found, last - i));
        assert!((a - DVec3::new(-b.x, -b.y, b.z)).length() < 1e-6, "{i}");
        let transposed = (i % 15) * 15 + i / 15;
        let c = moved(&found, transposed);
        assert!((a - DVec3::new(c.y, c.x, c.z)).length() < 1e-6, "{i}");
        let (a, b) = (moved(&dragged, i), moved(&back, last - i));
        assert!((a - DVec3::new(-b.x, -b.y, b.z)).length() < 2e-4, "{i} {a} {b}");
    }
}

fn simulator_rest(scene: &Scene) -> Vec<DVec3> {
    super::common::rest(scene).points_mm
}

/// Where it touches and sticks, the gel is on the part and goes with it.
#[test]
fn gel_in_contact_follows_the_part() {
    for large_strain in [None, Some(LargeStrain::default())] {
        let mut scene = scene(Some(0.9), 1e3);
        scene.effects.large_strain = large_strain;
        let still = simulator_rest(&scene);
        let (found, _) = pressed(&scene, DVec2::new(1.0, -0.6), [0.15, 0.1]);
        let mut touching = 0;
        for i in (0..still.len()).filter(|&i| found.in_contact[i]) {
            let moved = found.points_mm[i] - still[i];
            assert!((moved.truncate() - DVec2::new(0.15, 0.1)).length() < 1e-3, "{i} {moved}");
            touching += 1;
        }
        assert!(touching > 8, "{touching}");
    }
}

/// Nothing presses where there is no gel, and a path that is dragged ends where it began.
#[test]
fn parts_meet_no_gel_beyond_its_sides() {
    let scene = scene(Some(0.5), 0.8);
    let (found, _) = pressed(&scene, DVec2::new(9.0, 0.0), [0.0; 2]);
    assert!(found.points_mm.iter().all(|p| p.is_finite()));
    let mut simulator = simulator(&scene);
    let pose = press(&scene, DVec3::ZERO, DVec2::ZERO, 0.8).t_sensor_object;
    let (mut advanced, mut at_once) = (Truth::default(), Truth::default());
    simulator.advance(Some(pose), 1, &mut advanced).unwrap();
    simulator.field(Some(&ContactState::pressed(pose)), 1, &mut at_once);
    assert!(change_mm(&advanced, &at_once) < 5e-3, "{}", change_mm(&advanced, &at_once));
}

#[test]
fn a_rim_within_the_print_is_refused() {
    let check = |rim_mm| scene(Some(rim_mm), 0.8).validate().unwrap_err().to_string();
    for rim_mm in [0.0, -1.0, 0.44, 101.0, f64::NAN] {
        assert!(check(rim_mm).contains("effects.elastic_layer.rim_mm"), "{}", check(rim_mm));
    }
}

/// The force of a simulated press, by the markers of a gel with these sides and of one without an end.
#[test]
fn the_force_is_that_of_the_gel_with_its_sides() {
    let scene = scene(Some(0.9), 0.8);
    let still = simulator_rest(&scene);
    let (found, force_n) = pressed(&scene, DVec2::new(1.8, 0.9), [0.0; 2]);
    let layer = scene.effects.elastic_layer.as_ref().unwrap();
    let covariance_mm2 = vec![[[2e-6, 0.0, 0.0], [0.0, 2e-6, 0.0], [0.0, 0.0, 2e-5]]; still.len()];
    let estimate = |rim_mm| {
        let params = ForceParams {
            method: ForceMethod::Ridge,
            thickness_mm: Some(scene.gel.thickness_mm),
            young_kpa: Some(layer.young_kpa),
            poisson_ratio: layer.poisson_ratio,
            rim_mm,
            ..ForceParams::default()
        };
        let rest = RestSurface::new(&still).unwrap();
        let mut estimator = ForceEstimator::new(&params, &rest, scene.gel.cols, &covariance_mm2).unwrap();
        let state = vec![MarkerState::Seen; still.len()];
        let (points_mm, patch) = (&found.points_mm, &found.in_contact);
        let moved = MovedMarkers { points_mm, covariance_mm2: &covariance_mm2, state: &state, patch };
        estimator.run(&moved, &mut Vec::new()).unwrap().unwrap().force_n.z / force_n
    };
    let (with, without) = (estimate(Some(0.9)), estimate(None));
    assert!((with - 1.0).abs() < 0.02, "{with}");
    assert!(without > 1.04, "{without}");
    // Sides that are too far to matter.
    assert_eq!(estimate(Some(500.0)), without);
}
