//! Where markers come to lie.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{press, rest, rigid, simulator, truth, with_effects};
use gelstereo_core::math::{DVec2, DVec3, sqrt};
use gelstereo_sim::effects::{ElasticLayer, Misprint, Relaxation, Specks, UnevenLight, Wear};
use gelstereo_sim::{ContactState, Effects, GelKeyframe, Scene, Shape, Truth};
use proptest::prelude::*;

const SPHERE: Shape = Shape::Sphere { radius_mm: 4.0 };
const PEG: Shape = Shape::Cylinder { radius_mm: 4.0, length_mm: 20.0 };
const ACROSS: DVec3 = DVec3::new(0.0, core::f64::consts::FRAC_PI_2, 0.0);

proptest! {
    #[test]
    fn sphere_imprint_equals_the_closed_form(
        radius in 1.0..12.0, x in -8.0..8.0, y in -8.0..8.0, depth in 0.0..3.0, turn in -3.0..3.0,
    ) {
        let mut scene = rigid(Shape::Sphere { radius_mm: radius });
        scene.gel.rotation_rad = turn;
        let found = truth(&scene, Some(&press(&scene, DVec3::ZERO, DVec2::new(x, y), depth)));
        for (point, height) in rest(&scene).points_mm.iter().zip(&found.indentation_mm) {
            let away = (*point - DVec3::new(4.0 + x, y, 28.7)).truncate().length_squared();
            let room = radius * radius - away;
            let expected = if room > 0.0 { (sqrt(room) - radius + depth).max(0.0) } else { 0.0 };
            // The root magnifies round-off (1e-15 of 12² mm²) near the silhouette, where it stays below 1e-7
            // mm.
            prop_assert!((height - expected).abs() < 1e-7, "{height} for {expected}");
        }
    }

    #[test]
    fn truth_reprojects_and_its_disparity_is_its_depth(
        depth in 0.0..3.0, x in -8.0..8.0, twist in -0.3..0.3,
    ) {
        let scene = with_effects(PEG, Effects::of_gel());
        let mut contact = press(&scene, ACROSS, DVec2::new(x, 0.5), depth);
        contact.shear_mm = [0.2, -0.1];
        contact.twist_rad = twist;
        let found = truth(&scene, Some(&contact));
        for (i, point) in found.points_mm.iter().enumerate() {
            let (left, right) = (found.left_px[i], found.right_px[i]);
            let z = 560.0 * 8.0 / (left.x - right.x);
            let back = DVec3::new((left.x - 319.5) * z / 560.0, (left.y - 239.5) * z / 560.0, z);
            // One ulp of a pixel coordinate (1e-13) is 2e-14 mm of depth.
            prop_assert!((back - *point).length() < 1e-11);
            prop_assert!((28.7 - point.z - found.indentation_mm[i]).abs() < 1e-12);
        }
    }

    #[test]
    fn placed_markers_look_as_those_of_a_press(depth in 0.0..3.0, x in -8.0..8.0, y in -8.0..8.0) {
        let scene = with_effects(SPHERE, Effects::of_gel());
        let pressed = truth(&scene, Some(&press(&scene, DVec3::ZERO, DVec2::new(x, y), depth)));
        let mut placed = Truth::default();
        simulator(&scene).placed(&pressed.points_mm, 0, &mut placed).unwrap();
        for (found, expected) in placed.indentation_mm.iter().zip(&pressed.indentation_mm) {
            prop_assert!((found - expected).abs() < 1e-12);
        }
        placed.indentation_mm.clone_from(&pressed.indentation_mm);
        // Which part touches is not known of placed markers.
        prop_assert!(placed.contacts.is_empty() && placed.touched_by.iter().all(Option::is_none));
        placed.in_contact.clone_from(&pressed.in_contact);
        placed.touched_by.clone_from(&pressed.touched_by);
        placed.contacts.clone_from(&pressed.contacts);
        prop_assert_eq!(placed, pressed);
    }

    #[test]
    fn markers_in_contact_lie_on_the_part_and_none_within(
        depth in 0.5..2.5, dx in -0.5..0.5, dy in -0.5..0.5, twist in -0.2..0.2,
    ) {
        let scene = with_effects(SPHERE, Effects::of_gel());
        let mut contact = press(&scene, DVec3::ZERO, DVec2::new(dx, dy), depth);
        contact.shear_mm = [dx, dy];
        contact.twist_rad = twist;
        let found = truth(&scene, Some(&contact));
        prop_assert!(found.in_contact.contains(&true));
        for (point, &touched) in found.points_mm.iter().zip(&found.in_contact) {
            let away = (*point - contact.t_sensor_object.translation_mm).length();
            prop_assert!(if touched { (away - 4.0).abs() < 1e-9 } else { away > 4.0 - 1e-9 }, "{away} mm");
        }
    }

    #[test]
    fn the_answer_does_not_depend_on_what_was_asked_before(a in 0.0..2.5, b in 0.0..2.5, shear in -0.5..0.5) {
        let scene = with_effects(PEG, Effects::of_gel());
        let [mut first, second] = [a, b].map(|depth| press(&scene, ACROSS, DVec2::ZERO, depth));
        first.shear_mm[0] = shear;
        let mut simulator = simulator(&scene);
        let mut out = Truth::default();
        simulator.truth(Some(&second), &mut out);
        simulator.truth(Some(&first), &mut out);
        prop_assert_eq!(out, truth(&scene, Some(&first)));
    }

    #[test]
    fn every_input_gives_finite_numbers(
        t in [any::<f64>(), any::<f64>(), any::<f64>()], s in any::<f64>(), w in any::<f64>(),
    ) {
        let scene = with_effects(SPHERE, Effects::of_gel());
        let mut contact = press(&scene, DVec3::ZERO, DVec2::ZERO, 1.0);
        contact.t_sensor_object.translation_mm = DVec3::from_array(t);
        contact.shear_mm[1] = s;
        contact.twist_rad = w;
        let found = truth(&scene, Some(&contact));
        prop_assert!(found.points_mm.iter().all(|p| p.is_finite()));
        prop_assert!(found.left_px.iter().chain(&found.right_px).all(|p| p.is_finite()));
        if contact.validate().is_err() {
            prop_assert_eq!(found, rest(&scene));
        }
    }
}

#[test]
fn at_rest_the_lattice_is_where_the_rig_sees_it() {
    let found = rest(&Scene::default());
    assert_eq!(found.points_mm.len(), 625);
    let (first, last) = (found.left_px[0], found.left_px[624]);
    let width = 24.0 * 0.9 * 560.0 / 28.7;
    assert!((last.x - first.x - width).abs() < 1e-9 && (last.y - first.y - width).abs() < 1e-9);
    assert!((found.left_px[1].x - first.x - width / 24.0).abs() < 1e-9, "a row runs along x");
    assert!((first.x - found.right_px[0].x - 560.0 * 8.0 / 28.7).abs() < 1e-9);
    assert!(found.indentation_mm.iter().all(|&h| h == 0.0) && !found.in_contact.contains(&true));
}

#[test]
fn the_support_plate_stops_the_part() {
    let scene = rigid(Shape::Box { size_mm: [40.0, 40.0, 10.0] });
    let found = truth(&scene, Some(&press(&scene, DVec3::ZERO, DVec2::ZERO, 7.0)));
    assert!(found.indentation_mm.iter().all(|&h| h == scene.gel.thickness_mm));
}

/// The paper's gripper stops closing at a mean motion of 10 px (section V-B).
#[test]
fn a_realistic_grasp_reaches_the_stop_trigger() {
    let scene = with_effects(PEG, Effects::of_gel());
    let still = rest(&scene);
    let motion = |depth: f64, shear: f64| {
        let contact =
            ContactState { shear_mm: [shear, 0.0], ..press(&scene, ACROSS, DVec2::new(shear, 0.0), depth) };
        let found = truth(&scene, Some(&contact));
        found.left_px.iter().zip(&still.left_px).map(|(a, b)| (*a - *b).length()).sum::<f64>() / 625.0
    };
    assert!(motion(2.0, 0.4) > 10.0 && motion(2.4, 0.0) > 10.0);
    assert!(motion(2.0, 0.0) < 10.0 && motion(1.0, 0.5) < 10.0, "nor at the first touch");
}

#[test]
fn placed_markers_that_are_none_are_refused() {
    let scene = rigid(SPHERE);
    let (mut simulator, mut out) = (simulator(&scene), rest(&scene));
    let mut points = out.points_mm.clone();
    points[7].y = f64::NAN;
    let error = simulator.placed(&points, 0, &mut out).unwrap_err();
    assert_eq!(error.to_string(), "points_mm is NaN; valid is -10000 to 10000 mm");
    points.truncate(3);
    let error = simulator.placed(&points, 0, &mut out).unwrap_err();
    assert_eq!(error.to_string(), "number of points_mm is 3; valid is gel.rows * gel.cols");
    assert_eq!(out, rest(&scene));
}

/// The point cloud alone is that of the whole truth.
#[test]
fn a_field_is_the_moment_without_its_views() {
    let effects = Effects { elastic_layer: Some(ElasticLayer::default()), ..Effects::default() };
    for scene in [with_effects(SPHERE, Effects::of_gel()), with_effects(SPHERE, effects)] {
        let mut simulator = simulator(&scene);
        let contact = press(&scene, DVec3::ZERO, DVec2::ZERO, 1.2);
        let (mut whole, mut field) = (Truth::default(), Truth::default());
        simulator.moment(Some(&contact), 3, &mut whole);
        simulator.moment(None, 3, &mut field);
        simulator.field(Some(&contact), 3, &mut field);
        let expected = Truth {
            points_mm: whole.points_mm,
            indentation_mm: whole.indentation_mm,
            in_contact: whole.in_contact,
            touched_by: whole.touched_by,
            contacts: vec![Some(contact)],
            loads: whole.loads,
            ..Truth::default()
        };
        assert!(field == expected && expected.in_contact.contains(&true));
    }
}

/// What the cameras see may be worked out later, when the simulator has long gone on.
#[test]
fn who_looks_at_a_field_sees_the_moment() {
    let effects = Effects {
        misprint: Some(Misprint::default()),
        wear: Some(Wear::default()),
        specks: Some(Specks { count: 9, ..Specks::default() }),
        uneven_light: Some(UnevenLight::default()),
        ..Effects::of_gel()
    };
    let (elastic_layer, relaxation) = (Some(ElasticLayer::default()), Some(Relaxation::default()));
    let soft = Effects { elastic_layer, relaxation, ..Effects::default() };
    for scene in [with_effects(SPHERE, effects), with_effects(SPHERE, soft)] {
        let gel_at = |time_s| GelKeyframe { time_s, shift_mm: [time_s, 0.2], rotation_rad: 0.05 };
        let gel_motion = vec![gel_at(0.0), gel_at(1.0)];
        let scene = Scene { gel_motion, ..scene };
        let (mut whole, mut lazy) = (simulator(&scene), simulator(&scene));
        let contact = press(&scene, DVec3::ZERO, DVec2::ZERO, 1.2);
        let mut moments = vec![Truth::default(); 3];
        let mut fields = moments.clone();
        for (frame, (moment, field)) in moments.iter_mut().zip(&mut fields).enumerate() {
            whole.moment(Some(&contact), 5 * frame as u64, moment);
            lazy.field(Some(&contact), 5 * frame as u64, field);
        }
        assert_ne!(moments[0].points_mm, moments[2].points_mm, "time plays no part");
        for (frame, (moment, field)) in moments.iter().zip(&mut fields).enumerate() {
            lazy.look(5 * frame as u64, field).unwrap();
            assert!(field == moment, "frame {frame}");
        }
    }
    let error = simulator(&rigid(SPHERE)).look(0, &mut Truth::default()).unwrap_err();
    assert_eq!(error.to_string(), "number of points_mm is 0; valid is gel.rows * gel.cols");
}
