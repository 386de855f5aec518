//! Curved gels.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{press, rest, rigid, simulator, truth, with_effects};
use gelstereo_core::math::{DVec2, DVec3, sqrt};
use gelstereo_sim::effects::{ElasticLayer, Misprint};
use gelstereo_sim::{Effects, GelKeyframe, Relief, Scene, Shape, Simulator, Truth};
use proptest::prelude::*;

fn layer() -> Effects {
    Effects { elastic_layer: Some(ElasticLayer::default()), ..Effects::default() }
}

fn on(relief: Relief, scene: Scene) -> Scene {
    let mut scene = scene;
    scene.gel.relief = Some(relief);
    scene
}

/// A small gel with fine cells under a large ball.
fn fine(radius_mm: f64, relief: Option<Relief>) -> Scene {
    let mut scene = with_effects(Shape::Sphere { radius_mm }, layer());
    (scene.gel.rows, scene.gel.cols, scene.gel.dot_radius_mm) = (21, 21, 0.1);
    (scene.gel.pitch_mm, scene.gel.relief) = (0.4.into(), relief);
    scene
}

fn close(a: f64, b: f64, share: f64) -> bool {
    (a / b - 1.0).abs() < share
}

/// Radii of a dome or a cylinder that are long enough for the default gel.
fn radii() -> impl Strategy<Value = f64> {
    (50.0..400.0_f64, prop::bool::ANY).prop_map(|(radius, hollow)| if hollow { -radius } else { radius })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn markers_at_rest_lie_on_the_ball(
        radius_mm in radii(), rotation_rad in -3.0..3.0_f64, shift in -2.0..2.0_f64, misprint in 0.0..0.1_f64,
    ) {
        let effects = Effects {
            misprint: Some(Misprint { shift_mm: misprint, ..Misprint::default() }),
            ..Effects::default()
        };
        let mut scene = on(Relief::Dome { radius_mm }, Scene { effects, ..Scene::default() });
        scene.gel.rotation_rad = rotation_rad;
        scene.gel_motion = vec![GelKeyframe { time_s: 0.0, shift_mm: [shift, 1.0], rotation_rad: 0.3 }];
        // The dome bulges away from the camera, towards the parts.
        let centre = DVec3::new(4.0 + shift, 1.0, 28.7 - radius_mm);
        let found = rest(&scene);
        for (point, &normal) in found.points_mm.iter().zip(&found.normals) {
            prop_assert!(((*point - centre).length() - radius_mm.abs()).abs() < 1e-9);
            // Differences over two pitches (one at the border) of a sphere; misprints cancel.
            let outwards = (*point - centre) * -radius_mm.signum();
            prop_assert!(normal.dot(outwards.normalize()) > 0.9997, "{normal} {outwards}");
        }
        prop_assert!(found.indentation_mm.iter().all(|&height| height == 0.0));
    }

    #[test]
    fn markers_at_rest_lie_on_the_cylinder(
        radius_mm in radii(), axis_rad in -3.0..3.0_f64, turn in -3.0..3.0_f64,
    ) {
        let mut scene = on(Relief::Cylinder { radius_mm, axis_rad }, Scene::default());
        scene.gel.rotation_rad = turn;
        let along = DVec2::from_angle(turn + axis_rad);
        for point in rest(&scene).points_mm {
            let from = point - DVec3::new(4.0, 0.0, 28.7 - radius_mm);
            let across = from.truncate().dot(along.perp());
            prop_assert!((sqrt(across * across + from.z * from.z) - radius_mm.abs()).abs() < 1e-9);
        }
    }

    /// A map of zeros is the plane, bit for bit.
    #[test]
    fn no_relief_is_flat(
        x in -3.0..3.0_f64, depth in 0.2..1.2_f64, shear in -0.4..0.4_f64, of_layer in prop::bool::ANY,
    ) {
        let effects = if of_layer { layer() } else { Effects::of_gel() };
        let flat = with_effects(Shape::Cylinder { radius_mm: 2.0, length_mm: 5.0 }, effects);
        let zeros = Relief::Heights { size_mm: [9.0, 20.0], heights_mm: vec![vec![0.0; 3]; 4] };
        let curved = on(zeros, flat.clone());
        let mut contact = press(&flat, DVec3::new(0.3, 1.2, 0.1), DVec2::new(x, 0.5), depth);
        (contact.shear_mm, contact.twist_rad) = ([shear, 0.1], 0.1);
        prop_assert_eq!(truth(&curved, Some(&contact)), truth(&flat, Some(&contact)));
        if of_layer {
            let mut steps = [flat, curved].map(|scene| (simulator(&scene), Truth::default()));
            for (simulator, truth) in &mut steps {
                let mut pose = contact.t_sensor_object;
                for _ in 0..2 {
                    simulator.advance(Some(pose), 0, truth).unwrap();
                    pose.translation_mm.x += 0.1;
                }
            }
            prop_assert_eq!(&steps[0].1, &steps[1].1);
        }
    }

    /// Gap geometry: a rigid ball covers a circle of the relative curvature, 1 / R + 1 / Rg.
    #[test]
    fn a_rigid_ball_covers_the_circle_of_the_relative_curvature(
        radius_mm in 5.0..20.0_f64, gel_mm in radii(), depth in 0.05..0.5_f64,
    ) {
        let scene = on(Relief::Dome { radius_mm: gel_mm }, rigid(Shape::Sphere { radius_mm }));
        let found = truth(&scene, Some(&press(&scene, DVec3::ZERO, DVec2::ZERO, depth)));
        let still = rest(&scene);
        let sag = |radius_mm: f64, away2: f64| {
            (radius_mm.abs() - sqrt(radius_mm * radius_mm - away2)) * radius_mm.signum()
        };
        for (marker, point) in still.points_mm.iter().enumerate() {
            let away2 = (point.truncate() - DVec2::new(4.0, 0.0)).length_squared();
            let gap = if away2 < radius_mm * radius_mm {
                depth - sag(radius_mm, away2) - sag(gel_mm, away2)
            } else {
                -1.0
            };
            prop_assert!((found.indentation_mm[marker] - gap.max(0.0)).abs() < 1e-7, "{gap}");
            // To leading order this is Hertz's gap.
            let hertz = depth - 0.5 * away2 * (1.0 / radius_mm + 1.0 / gel_mm);
            prop_assert!(gap < 0.0 || (hertz - gap).abs() < 0.05 * depth + 1e-6, "{hertz} {gap}");
        }
    }

    /// Wherever a part comes down, its deepest place is as deep as asked.
    #[test]
    fn parts_are_pressed_as_deep_as_asked(
        gel_mm in radii(), x in -6.0..6.0_f64, y in -6.0..6.0_f64, depth in 0.1..1.0_f64,
        tilt in -0.3..0.3_f64, ball in prop::bool::ANY,
    ) {
        let peg = Shape::Cylinder { radius_mm: 4.0, length_mm: 30.0 };
        let shape = if ball { Shape::Sphere { radius_mm: 5.0 } } else { peg };
        let scene = on(Relief::Cylinder { radius_mm: gel_mm, axis_rad: 0.4 }, rigid(shape));
        let contact = press(&scene, DVec3::new(tilt, 1.5, 0.0), DVec2::new(x, y), depth);
        let mut finer = scene;
        (finer.gel.rows, finer.gel.cols, finer.gel.dot_radius_mm) = (217, 217, 0.04);
        finer.gel.pitch_mm = 0.1.into();
        let deepest = truth(&finer, Some(&contact)).indentation_mm.into_iter().fold(0.0, f64::max);
        // The markers are 0.1 mm apart; an edge of the cylinder lies between them.
        let (above, below) = if ball { (1e-9, 1.2e-3) } else { (5e-3, 0.03) };
        prop_assert!(deepest <= depth + above && deepest > depth - below, "{deepest} {depth}");
    }
}

/// On the elastic layer a ball on a dome or in a hollow presses as the ball of the relative curvature on a
/// plane: same force, same circle, same motion of the skin.
#[test]
fn a_ball_on_a_dome_presses_as_a_smaller_one_on_a_plane() {
    for gel_mm in [40.0, -40.0] {
        let (radius_mm, depth) = (15.0, 0.1);
        let relative_mm = 1.0 / (1.0 / radius_mm + 1.0 / gel_mm);
        let curved = fine(radius_mm, Some(Relief::Dome { radius_mm: gel_mm }));
        let [found, flat, other] = [&curved, &fine(relative_mm, None), &fine(radius_mm, None)]
            .map(|scene| truth(scene, Some(&press(scene, DVec3::ZERO, DVec2::ZERO, depth))));
        let force = |truth: &Truth| -truth.loads.as_ref().unwrap().force_n.z;
        assert!(close(force(&found), force(&flat), 0.005), "{} {}", force(&found), force(&flat));
        assert!(!close(force(&found), force(&other), 0.1), "the relief plays no part");
        let touched = |truth: &Truth| truth.in_contact.iter().filter(|&&touches| touches).count();
        assert!(touched(&found).abs_diff(touched(&flat)) <= 4, "{} {}", touched(&found), touched(&flat));
        let (still, flat_still) = (rest(&curved), rest(&fine(relative_mm, None)));
        for (marker, point) in found.points_mm.iter().enumerate() {
            let moved = *point - still.points_mm[marker];
            let expected = flat.points_mm[marker] - flat_still.points_mm[marker];
            assert!((moved - expected).length() < 0.01 * depth, "{moved} {expected}");
        }
    }
}

/// A part that is dragged across a dome loses the gel, and in a hollow it digs in.
#[test]
fn a_part_is_dragged_off_a_dome() {
    for (gel_mm, sign) in [(40.0, -1.0), (-40.0, 1.0)] {
        let scene = fine(6.0, Some(Relief::Dome { radius_mm: gel_mm }));
        let mut pose = press(&scene, DVec3::ZERO, DVec2::ZERO, 0.3).t_sensor_object;
        let (mut simulator, mut truth) = (simulator(&scene), Truth::default());
        let mut forces = [0.0; 2];
        for force in &mut forces {
            simulator.advance(Some(pose), 0, &mut truth).unwrap();
            *force = -truth.loads.as_ref().unwrap().force_n.z;
            pose.translation_mm.x += 2.0;
        }
        assert!((forces[1] / forces[0] - 1.0) * sign > 0.1, "{gel_mm}: {forces:?}");
    }
}

#[test]
fn a_map_of_heights_is_linear_between_them() {
    let heights_mm = vec![vec![0.0, 1.0, 0.0], vec![0.0, 3.0, 0.0]];
    let scene = on(Relief::Heights { size_mm: [20.0, 21.6], heights_mm }, Scene::default());
    for point in rest(&scene).points_mm {
        let (x, y) = (point.x - 4.0, point.y);
        let ridge = (1.0 - x.abs() / 10.0).max(0.0);
        let expected = ridge * (1.0 + 2.0 * (y / 21.6 + 0.5));
        assert!((point.z - 28.7 - expected).abs() < 1e-12, "{point} {expected}");
    }
}

#[test]
fn a_mesh_meets_a_dome_as_its_solid() {
    let solid = on(Relief::Dome { radius_mm: 60.0 }, with_effects(Shape::Sphere { radius_mm: 4.0 }, layer()));
    let mesh = solid.indenter.as_ref().unwrap().mesh(0.002).unwrap();
    let file = Shape::Mesh { path: "ball.stl".into(), units: "mm".into() };
    let mut meshed = Simulator::new(&Scene { indenter: Some(file), ..solid.clone() }, Some(&mesh)).unwrap();
    let contact = press(&solid, DVec3::ZERO, DVec2::new(4.0, 1.0), 0.8);
    let pose = meshed.pressed(contact.t_sensor_object, 0.8).unwrap();
    assert!((pose.translation_mm - contact.t_sensor_object.translation_mm).length() < 0.003);
    let mut found = Truth::default();
    meshed.moment(Some(&contact), 0, &mut found);
    let expected = truth(&solid, Some(&contact));
    assert!(found.points_mm.iter().zip(&expected.points_mm).all(|(a, b)| (*a - *b).length() < 0.005));
}

#[test]
fn placed_markers_have_heights_above_the_curved_skin() {
    let scene = on(Relief::Dome { radius_mm: 70.0 }, with_effects(Shape::Sphere { radius_mm: 4.0 }, layer()));
    let pressed = truth(&scene, Some(&press(&scene, DVec3::ZERO, DVec2::new(2.0, 1.0), 0.9)));
    let mut placed = Truth::default();
    simulator(&scene).placed(&pressed.points_mm, 0, &mut placed).unwrap();
    assert!(placed.indentation_mm.iter().zip(&pressed.indentation_mm).all(|(a, b)| (a - b).abs() < 1e-12));
    assert_eq!(placed.left_dots, pressed.left_dots);
}

#[test]
fn a_relief_that_the_layer_does_not_fit_is_refused() {
    let slope = "steepest slope of gel.relief is";
    let map = |heights_mm: Vec<Vec<f64>>| Relief::Heights { size_mm: [10.0, 10.0], heights_mm };
    for (relief, message) in [
        (Relief::Dome { radius_mm: 30.0 }, slope),
        (Relief::Cylinder { radius_mm: -12.0, axis_rad: 0.0 }, slope),
        (map(vec![vec![0.0, 5.0]; 2]), slope),
        (Relief::Dome { radius_mm: 0.0 }, "gel.relief.radius_mm is 0; valid is 1 to 1000000 mm"),
        (Relief::Dome { radius_mm: f64::NAN }, "gel.relief.radius_mm is NaN"),
        (Relief::Cylinder { radius_mm: 100.0, axis_rad: f64::NAN }, "gel.relief.axis_rad is NaN"),
        (map(vec![]), "rows of gel.relief.heights_mm is 0; valid is 2 to 1000"),
        (map(vec![vec![0.0; 2], vec![0.0; 3]]), "length of a row of gel.relief.heights_mm is 3"),
        (map(vec![vec![0.0, f64::INFINITY]; 2]), "gel.relief.heights_mm is inf"),
        (Relief::Heights { size_mm: [0.0, 1.0], heights_mm: vec![] }, "gel.relief.size_mm is 0"),
        (map(vec![vec![-30.0, -30.0]; 2]), "behind a camera"),
    ] {
        let mut scene = on(relief, Scene::default());
        // The last one leaves no room before the cameras.
        scene.gel.surface_mm = 28.7;
        let error = scene.validate().unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    let wide = on(Relief::Dome { radius_mm: 42.0 }, Scene::default());
    wide.validate().unwrap();
    // The layer's cells reach farther than the markers.
    assert!(Scene { effects: layer(), ..wide }.validate().unwrap_err().to_string().contains(slope));
}

#[test]
fn a_relief_is_written_and_read() {
    for text in [
        "[gel.relief]\nkind = \"dome\"\nradius_mm = 60",
        "[gel]\nrelief = { kind = \"cylinder\", radius_mm = -80, axis_rad = 0.5 }",
        "[gel]\nrelief = { kind = \"heights\", size_mm = [20, 20], heights_mm = [[0, 1], [0.5, 0]] }",
    ] {
        let scene: Scene = toml::from_str(text).unwrap();
        scene.validate().unwrap();
        assert_eq!(toml::from_str::<Scene>(&toml::to_string(&scene).unwrap()).unwrap(), scene);
    }
}
