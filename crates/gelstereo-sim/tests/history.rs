//! Contacts that move on: drag, stick and slip along a path.
#![allow(clippy::unwrap_used)]

use super::common::{press, simulator, with_effects};
use gelstereo_core::math::{DVec2, DVec3, Pose, so3};
use gelstereo_core::slip::Stick;
use gelstereo_sim::effects::{Effects, ElasticLayer, Relaxation};
use gelstereo_sim::{ContactState, Loads, Scene, SceneError, Shape, Simulator, Truth};

const RADIUS_MM: f64 = 5.0;

fn scene(friction: f64) -> Scene {
    let layer = ElasticLayer { friction, cells_per_pitch: 3, ..Default::default() };
    with_effects(
        Shape::Sphere { radius_mm: RADIUS_MM },
        Effects { elastic_layer: Some(layer), ..Effects::default() },
    )
}

fn shifted(pose: Pose, x: f64) -> Pose {
    Pose { translation_mm: pose.translation_mm + DVec3::X * x, ..pose }
}

fn at(simulator: &mut Simulator, pose: Pose) -> Loads {
    let mut truth = Truth::default();
    simulator.advance(Some(pose), 0, &mut truth).unwrap();
    truth.loads.unwrap()
}

fn pressed(scene: &Scene, depth_mm: f64) -> Pose {
    press(scene, DVec3::ZERO, DVec2::ZERO, depth_mm).t_sensor_object
}

fn count(loads: &Loads, stick: Stick) -> usize {
    loads.stick.iter().filter(|&&s| s == stick).count()
}

/// Dragged one way from rest, many steps are one: with a constant normal load, Coulomb's law has no other
/// path (Cattaneo 1938).
#[test]
fn a_drag_in_many_steps_is_a_drag_in_one() {
    let scene = scene(0.5);
    let pose = pressed(&scene, 0.5);
    let mut simulator = simulator(&scene);
    at(&mut simulator, pose);
    let stepped = (1..=8).map(|n| at(&mut simulator, shifted(pose, 0.02 * f64::from(n)))).last().unwrap();
    let mut once = Truth::default();
    let contact = ContactState { shear_mm: [0.16, 0.0], ..ContactState::pressed(shifted(pose, 0.16)) };
    simulator.field(Some(&contact), 0, &mut once);
    let once = once.loads.unwrap();
    // Pressing with friction differs by its path: in one step the gel is held where it first touches.
    assert!((stepped.force_n - once.force_n).length() < 0.02 * once.force_n.x.abs(), "{stepped:?} {once:?}");
}

/// Under a steady drag the zone that sticks shrinks (Cattaneo 1938): no marker sticks again.
#[test]
fn a_zone_that_slips_goes_on_slipping() {
    for friction in [0.2, 0.5, 0.8] {
        let scene = scene(friction);
        let pose = pressed(&scene, 0.8);
        let mut simulator = simulator(&scene);
        let stuck =
            (0..24).map(|n| count(&at(&mut simulator, shifted(pose, 0.012 * f64::from(n))), Stick::Stuck));
        let stuck: Vec<usize> = stuck.collect();
        // A marker that comes under the moving ball may touch without slip.
        assert!(stuck.windows(2).all(|pair| pair[1] <= pair[0] + 1), "{friction}: {stuck:?}");
        assert!(stuck[0] > 10 && stuck[23] < stuck[0], "{friction}: {stuck:?}");
    }
}

/// Markers under a part that does not slip go where it goes.
#[test]
fn markers_that_stick_follow_the_part() {
    let scene = scene(20.0);
    let pose = pressed(&scene, 0.5);
    let mut simulator = simulator(&scene);
    let (mut before, mut after) = (Truth::default(), Truth::default());
    simulator.advance(Some(pose), 0, &mut before).unwrap();
    simulator.advance(Some(shifted(pose, 0.12)), 1, &mut after).unwrap();
    let touches = before.in_contact.iter().zip(&after.in_contact).map(|(a, b)| *a && *b);
    let mut count = 0;
    for ((a, b), touches) in before.points_mm.iter().zip(&after.points_mm).zip(touches) {
        // At the border, where the pressure vanishes, it slips with any friction.
        let middle = pose.translation_mm.truncate();
        if touches && a.truncate().distance(middle) < 1.3 {
            assert!((b.x - a.x - 0.12).abs() < 0.002 && (b.y - a.y).abs() < 0.002, "{a} {b}");
            count += 1;
        }
    }
    assert!(count >= 5, "{count}");
}

/// Dragged far, the gel slips everywhere, and the force is Coulomb's.
#[test]
fn a_far_drag_slips_with_coulombs_force() {
    let scene = scene(0.3);
    let pose = pressed(&scene, 0.5);
    let mut simulator = simulator(&scene);
    at(&mut simulator, pose);
    let held = at(&mut simulator, shifted(pose, 0.05));
    assert!(count(&held, Stick::Stuck) > count(&held, Stick::Slips), "{held:?}");
    let slid = at(&mut simulator, shifted(pose, 1.5));
    assert_eq!(count(&slid, Stick::Stuck), 0);
    let [x, z] = [slid.force_n.x, -slid.force_n.z];
    assert!((x / z - 0.3).abs() < 0.003, "{x} {z}");
    // On the way back it sticks first, and then slips the other way.
    let back = at(&mut simulator, shifted(pose, 1.48));
    assert!(back.force_n.x < 0.95 * x && count(&back, Stick::Stuck) > 0);
    let other = at(&mut simulator, shifted(pose, 0.0));
    assert!((other.force_n.x + 0.3 * -other.force_n.z).abs() < 0.003 * x, "{other:?}");
}

/// Back where it began, a force remains in the gel that slipped in between (Mindlin and Deresiewicz 1953).
#[test]
fn slip_leaves_hysteresis_and_stick_does_not() {
    let left_over = |friction: f64| {
        let scene = scene(friction);
        let pose = pressed(&scene, 0.5);
        let mut simulator = simulator(&scene);
        let before = at(&mut simulator, pose).force_n.x;
        let most = at(&mut simulator, shifted(pose, 0.1)).force_n.x;
        (at(&mut simulator, pose).force_n.x - before) / most
    };
    let (stuck, slipped) = (left_over(20.0), left_over(0.3));
    assert!(stuck.abs() < 0.01, "{stuck}");
    assert!(slipped < -0.05, "{slipped}");
}

/// A ball that rolls carries no shear force; one that is dragged as far slips.
#[test]
fn a_rolling_ball_does_not_slip() {
    let scene = scene(0.4);
    let pose = pressed(&scene, 0.4);
    let mut simulator = simulator(&scene);
    at(&mut simulator, pose);
    let mut rolled = Loads::default();
    for n in 1..=20 {
        let x = 0.1 * f64::from(n);
        // About y, so that the lowest point, towards the camera at -z, stands still.
        let turn = so3::exp(DVec3::Y * (x / (RADIUS_MM - 0.2)));
        rolled = at(&mut simulator, Pose { rotation: turn * pose.rotation, ..shifted(pose, x) });
    }
    let ratio = rolled.force_n.x.abs() / -rolled.force_n.z;
    assert!(ratio < 0.06, "{ratio}");
    assert!(count(&rolled, Stick::Stuck) > 4 * count(&rolled, Stick::Slips), "{rolled:?}");
    let dragged = at(&mut simulator, shifted(pose, 4.0));
    assert!(dragged.force_n.x.abs() / -dragged.force_n.z > 0.39);
}

/// What was taken away is forgotten.
#[test]
fn a_new_touch_is_a_first_touch() {
    let scene = scene(0.5);
    let pose = pressed(&scene, 0.5);
    let (mut used, mut fresh) = (simulator(&scene), simulator(&scene));
    at(&mut used, pose);
    at(&mut used, shifted(pose, 0.2));
    let mut truth = Truth::default();
    used.advance(None, 0, &mut truth).unwrap();
    assert_eq!(truth.loads.unwrap().force_n, DVec3::ZERO);
    assert!(truth.indentation_mm.iter().all(|&h| h == 0.0));
    assert_eq!(at(&mut used, pose), at(&mut fresh, pose));
}

/// Presses in between, and searches for a force, do not change the path.
#[test]
fn other_contacts_in_between_change_nothing() {
    let scene = scene(0.4);
    let pose = pressed(&scene, 0.5);
    let (mut alone, mut between) = (simulator(&scene), simulator(&scene));
    for n in 0..4 {
        let next = shifted(pose, 0.08 * f64::from(n));
        let expected = at(&mut alone, next);
        assert_eq!(at(&mut between, next), expected);
        between.pressed_with(shifted(pose, 2.0), 0.7).unwrap();
        between.field(None, 0, &mut Truth::default());
    }
}

#[test]
fn a_history_needs_a_layer_without_memory() {
    let rigid = Scene { indenter: Some(Shape::Sphere { radius_mm: 4.0 }), ..Scene::default() };
    let mut creeping = scene(0.5);
    creeping.effects.relaxation = Some(Relaxation::default());
    for scene in [rigid, creeping] {
        let pose = pressed(&scene, 0.5);
        let found = simulator(&scene).advance(Some(pose), 0, &mut Truth::default());
        assert_eq!(found, Err(SceneError::NeedsHistory));
    }
}

/// The force of a press with a given force, and refusals.
#[test]
fn a_press_with_a_force_has_that_force() {
    let scene = scene(0.0);
    let mut simulator = simulator(&scene);
    let pose = pressed(&scene, 0.1);
    for force_n in [0.05, 0.4, 1.5] {
        let found = simulator.pressed_with(pose, force_n).unwrap().unwrap();
        let mut truth = Truth::default();
        simulator.field(Some(&ContactState::pressed(found)), 0, &mut truth);
        assert!((-truth.loads.unwrap().force_n.z / force_n - 1.0).abs() < 2e-4);
    }
    for force_n in [0.0, f64::NAN, 1e6] {
        assert!(matches!(simulator.pressed_with(pose, force_n), Err(SceneError::Invalid { .. })));
    }
    let rigid = Scene { indenter: Some(Shape::Sphere { radius_mm: 4.0 }), ..Scene::default() };
    assert_eq!(super::common::simulator(&rigid).pressed_with(pose, 1.0).unwrap(), None);
}
