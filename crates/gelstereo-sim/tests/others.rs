//! Several parts in one gel.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{press, simulator, with_effects};
use gelstereo_core::math::{DVec2, DVec3, Pose};
use gelstereo_core::slip::Stick;
use gelstereo_sim::effects::{ElasticLayer, LargeStrain, MotionBlur, Relaxation};
use gelstereo_sim::{ContactState, Effects, Keyframe, OtherPart, PartLoads, Scene, Shape, Simulator, Truth};
use proptest::prelude::*;

const BALL: Shape = Shape::Sphere { radius_mm: 2.0 };
const BLOCK: Shape = Shape::Box { size_mm: [3.0, 2.0, 4.0] };
/// Three solves are compared. Pressures and tractions of each end within 1e-4 mm.
const TOLERANCE_MM: f64 = 6e-4;

fn layer(friction: f64) -> Effects {
    Effects {
        elastic_layer: Some(ElasticLayer { friction, ..ElasticLayer::default() }),
        ..Effects::default()
    }
}

/// A ball, and a block as the other part; without trajectories.
fn scene(effects: Effects) -> Scene {
    let others = vec![OtherPart { indenter: BLOCK, trajectory: Vec::new() }];
    Scene { others, ..with_effects(BALL, effects) }
}

/// Contact of a part at a place over the gel.
fn at(scene: &Scene, part: usize, offset: DVec2, depth_mm: f64) -> ContactState {
    let above = (DVec2::from_array(scene.gel.centre_mm) + offset).extend(0.0);
    let pose = simulator(scene).pressed_of(part, Pose::from_translation_mm(above), depth_mm);
    ContactState::pressed(pose.unwrap())
}

fn moment(scene: &Scene, contacts: &[Option<ContactState>]) -> Truth {
    let mut truth = Truth::default();
    simulator(scene).moment_of(contacts, 0, &mut truth);
    truth
}

fn loads(truth: &Truth) -> &[PartLoads] {
    &truth.loads.as_ref().unwrap().parts
}

/// Markers touched by a part.
fn touched(truth: &Truth, part: u8) -> Vec<usize> {
    (0..truth.touched_by.len()).filter(|&marker| truth.touched_by[marker] == Some(part)).collect()
}

fn offset() -> impl Strategy<Value = DVec2> {
    (-3.0..3.0_f64, -3.0..3.0_f64).prop_map(|(x, y)| DVec2::new(x, y))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// One part in two pieces is that part: both touch the same gel.
    #[test]
    fn two_parts_at_one_place_are_the_deeper_one(
        place in offset(), a in 0.2..1.2_f64, b in 0.2..1.2_f64, shear in -0.4..0.4_f64,
        of_layer in prop::bool::ANY,
    ) {
        let effects = if of_layer { layer(0.6) } else { Effects::of_gel() };
        let scene = Scene {
            others: vec![OtherPart { indenter: BALL, trajectory: Vec::new() }],
            ..with_effects(BALL, effects)
        };
        let pressed = |depth_mm| ContactState { shear_mm: [shear, 0.1], ..at(&scene, 0, place, depth_mm) };
        let (deep, other) = (pressed(a.max(b)), pressed(a.min(b)));
        let both = moment(&scene, &[Some(other), Some(deep)]);
        let alone = moment(&scene, &[Some(deep), None]);
        prop_assert_eq!(&both.points_mm, &alone.points_mm);
        prop_assert_eq!(&both.in_contact, &alone.in_contact);
        prop_assert!(touched(&both, 0).is_empty() && touched(&both, 1) == touched(&alone, 0));
    }

    /// The wrench of the gel is the sum of those of the parts, wherever they are.
    #[test]
    fn the_wrenches_add_up(
        a in offset(), b in offset(), deep in 0.3..1.0_f64, shear in -0.5..0.5_f64, twist in -0.2..0.2_f64,
    ) {
        let scene = scene(layer(0.5));
        let first = ContactState { shear_mm: [shear, 0.0], ..at(&scene, 0, a, deep) };
        let second = ContactState { twist_rad: twist, ..at(&scene, 1, b, 0.6) };
        let found = moment(&scene, &[Some(first), Some(second)]);
        prop_assert_eq!(&found.contacts, &vec![Some(first), Some(second)]);
        let sum = |of: fn(&PartLoads) -> DVec3| loads(&found).iter().map(of).sum::<DVec3>();
        let whole = found.loads.as_ref().unwrap();
        prop_assert!((sum(|part| part.force_n) - whole.force_n).length() < 1e-12);
        prop_assert!((sum(|part| part.torque_nmm) - whole.torque_nmm).length() < 1e-10);
        for (marker, part) in found.touched_by.iter().enumerate() {
            prop_assert_eq!(part.is_some(), found.in_contact[marker]);
        }
    }

    /// Who is the first part does not matter.
    #[test]
    fn parts_may_change_places(
        a in offset(), b in offset(), shear in -0.4..0.4_f64, of_layer in prop::bool::ANY,
    ) {
        let effects = if of_layer { layer(0.4) } else { Effects::of_gel() };
        let scene = scene(effects);
        let others = vec![OtherPart { indenter: BALL, trajectory: Vec::new() }];
        let turned = Scene { indenter: Some(BLOCK), others, ..scene.clone() };
        let first = ContactState { shear_mm: [shear, 0.0], ..at(&scene, 0, a, 0.8) };
        let second = at(&scene, 1, b, 0.5);
        let [found, other] =
            [(&scene, [first, second]), (&turned, [second, first])].map(|(scene, contacts)| {
                moment(scene, &contacts.map(Some))
            });
        prop_assert_eq!(found.points_mm, other.points_mm);
        prop_assert_eq!(found.loads.map(|l| l.force_n), other.loads.map(|l| l.force_n));
    }

    /// Parts that are far from each other touch the gel as each alone would, and the motions that they cause
    /// add up.
    #[test]
    fn far_parts_are_each_as_alone(
        shear in -0.3..0.3_f64, deep in 0.3..0.8_f64, of_layer in prop::bool::ANY,
    ) {
        let mut scene = scene(if of_layer { layer(0.6) } else { Effects::default() });
        // Thin gel forgets within a millimetre or two what happens 16 mm away.
        scene.gel.thickness_mm = 1.5;
        let first = ContactState { shear_mm: [shear, 0.0], ..at(&scene, 0, DVec2::new(-8.0, 0.0), deep) };
        let second = at(&scene, 1, DVec2::new(8.0, 1.0), 0.4);
        let both = moment(&scene, &[Some(first), Some(second)]);
        let alone = [moment(&scene, &[Some(first), None]), moment(&scene, &[None, Some(second)])];
        let rest = moment(&scene, &[]);
        for (marker, point) in both.points_mm.iter().enumerate() {
            let sum = alone[0].points_mm[marker] + alone[1].points_mm[marker] - rest.points_mm[marker];
            let off_mm = (*point - sum).length();
            prop_assert!(off_mm < TOLERANCE_MM, "{off_mm} mm");
        }
        for part in 0..2 {
            // At the block's walls, 1e-4 mm decide whether a marker is beneath it.
            let [found, expected] = [&both, &alone[usize::from(part)]].map(|truth| touched(truth, part));
            let other = found.iter().filter(|marker| !expected.contains(marker)).count();
            prop_assert!(other <= 3 && found.len().abs_diff(expected.len()) <= 3, "{found:?} {expected:?}");
            if of_layer {
                let [found, expected] =
                    [&both, &alone[usize::from(part)]].map(|truth| loads(truth)[usize::from(part)].force_n);
                prop_assert!((found - expected).length() < 2e-3 * expected.length(), "{found} {expected}");
            }
        }
    }
}

/// The ball is dragged until it slips; the block stays where it is, and sticks.
#[test]
fn one_part_slips_while_the_other_sticks() {
    let scene = scene(layer(0.3));
    let mut poses = [at(&scene, 0, DVec2::new(-5.0, 0.0), 0.8), at(&scene, 1, DVec2::new(5.0, 0.0), 0.5)]
        .map(|contact| Some(contact.t_sensor_object));
    let (mut simulator, mut truth) = (simulator(&scene), Truth::default());
    for _ in 0..8 {
        simulator.advance_of(&poses, 0, &mut truth).unwrap();
        poses[0].as_mut().unwrap().translation_mm.x += 0.1;
    }
    let loads = truth.loads.as_ref().unwrap();
    let of =
        |part: u8| touched(&truth, part).into_iter().map(|marker| loads.stick[marker]).collect::<Vec<_>>();
    assert!(of(0).len() > 4 && of(0).iter().all(|&stick| stick == Stick::Slips), "{:?}", of(0));
    assert!(of(1).len() > 4 && of(1).contains(&Stick::Stuck), "{:?}", of(1));
    let ratio = |part: &PartLoads| part.force_n.x / -part.force_n.z;
    assert!((ratio(&loads.parts[0]) - 0.3).abs() < 0.01 && ratio(&loads.parts[1]).abs() < 0.03);
}

/// Each part has its own history: the one that goes away is forgotten, the other is not.
#[test]
fn histories_are_the_parts_own() {
    let scene = scene(layer(0.6));
    let [ball, block] =
        [(0, -4.0), (1, 4.0)].map(|(part, x)| at(&scene, part, DVec2::new(x, 0.0), 0.6).t_sensor_object);
    let dragged = Pose { translation_mm: block.translation_mm + DVec3::new(0.2, 0.0, 0.0), ..block };
    let after = |steps: &[[Option<Pose>; 2]]| {
        let (mut simulator, mut truth) = (simulator(&scene), Truth::default());
        steps.iter().for_each(|poses| simulator.advance_of(poses, 0, &mut truth).unwrap());
        truth
    };
    let with_ball = after(&[[Some(ball), Some(block)], [None, Some(block)], [None, Some(dragged)]]);
    let without = after(&[[None, Some(block)], [None, Some(dragged)]]);
    assert!(
        (loads(&with_ball)[1].force_n - loads(&without)[1].force_n).length()
            < 0.01 * loads(&without)[1].force_n.length()
    );
    assert!(loads(&with_ball)[1].force_n.x > 0.02, "{:?}", loads(&with_ball)[1]);
    assert_eq!(loads(&with_ball)[0], PartLoads::default());
    // A part that comes back has been dragged by nothing.
    let back = after(&[[None, Some(dragged)]]);
    let again = after(&[[None, Some(block)], [None, None], [None, Some(dragged)]]);
    assert_eq!(again.points_mm, back.points_mm);
}

/// On their trajectories, by calls and in parts: the same bits.
#[test]
fn trajectories_and_calls_agree() {
    for effects in [
        Effects { motion_blur: Some(MotionBlur { exposure_s: 0.01 }), ..Effects::of_gel() },
        Effects {
            large_strain: Some(LargeStrain::default()),
            relaxation: Some(Relaxation::default()),
            ..layer(0.5)
        },
    ] {
        let mut scene = scene(effects);
        let key = |time_s, contact| Keyframe { time_s, contact };
        let ends = [0.2, 0.9].map(|depth| at(&scene, 0, DVec2::new(-2.0, 0.0), depth));
        scene.trajectory = vec![key(0.0, ends[0]), key(0.2, ends[1])];
        let ends = [0.1, 0.7].map(|depth| at(&scene, 1, DVec2::new(2.0, 1.0), depth));
        scene.others[0].trajectory = vec![key(0.0, ends[0]), key(0.4, ends[1])];
        let (mut by_frames, mut by_calls) = (simulator(&scene), simulator(&scene));
        assert_eq!((by_frames.frames(), by_frames.parts()), (13, 2));
        let (mut found, mut expected) = (Truth::default(), Truth::default());
        for frame in [3, 5, 9] {
            let contacts = by_calls.planned(frame);
            by_frames.moment(by_calls.contact(frame).as_ref(), frame as u64, &mut found);
            by_calls.moment_of(&contacts, frame as u64, &mut expected);
            assert!(found == expected && found.contacts == contacts, "frame {frame}");
            assert!(!touched(&found, 0).is_empty() && !touched(&found, 1).is_empty());
            let mut replaced = by_frames.replaced(&scene, None).unwrap();
            replaced.moment(contacts[0].as_ref(), frame as u64, &mut found);
            assert!(found == expected);
        }
    }
}

#[test]
fn meshes_are_handed_over_in_order() {
    let file = |name: &str| Shape::Mesh { path: name.into(), units: "mm".into() };
    let [ball, block] = [BALL, BLOCK].map(|shape| shape.mesh(0.01).unwrap());
    let solid = scene(Effects::of_gel());
    let mut meshed = solid.clone();
    (meshed.indenter, meshed.others[0].indenter) = (Some(file("ball.stl")), file("block.stl"));
    let contacts =
        [at(&solid, 0, DVec2::new(-3.0, 0.0), 0.8), at(&solid, 1, DVec2::new(3.0, 0.0), 0.6)].map(Some);
    let expected = moment(&solid, &contacts);
    let mut found = Truth::default();
    Simulator::new(&meshed, [&ball, &block]).unwrap().moment_of(&contacts, 0, &mut found);
    assert_eq!(touched(&found, 1), touched(&expected, 1));
    assert!(found.points_mm.iter().zip(&expected.points_mm).all(|(a, b)| (*a - *b).length() < 0.02));
    let missing = Simulator::new(&meshed, Some(&ball)).unwrap_err().to_string();
    assert_eq!(missing, "a part is the mesh file \"block.stl\"; read it and hand its triangles over, in mm");
    assert!(Simulator::new(&solid, Some(&ball)).is_err());
}

#[test]
fn a_scene_with_others_is_written_and_read() {
    let text = "
        [indenter]
        kind = \"sphere\"
        radius_mm = 2
        [[others]]
        indenter = { kind = \"box\", size_mm = [3, 2, 4] }
        trajectory = [{ time_s = 0, position_mm = [4, 0, 40] }]
        [[others]]
        indenter = { kind = \"sphere\", radius_mm = 1 }";
    let scene: Scene = toml::from_str(text).unwrap();
    scene.validate().unwrap();
    assert_eq!((scene.parts().count(), scene.others[0].trajectory.len()), (3, 1));
    assert_eq!(toml::from_str::<Scene>(&toml::to_string(&scene).unwrap()).unwrap(), scene);
    let ball = |radius_mm: f64| Shape::Sphere { radius_mm };
    let key = |time_s| Keyframe { time_s, contact: ContactState::pressed(Pose::IDENTITY) };
    let backwards = vec![key(1.0), key(0.0)];
    for (indenter, other, trajectory, message) in [
        (None, ball(1.0), vec![], "number of others without an indenter is 1; valid is 0"),
        (Some(ball(1.0)), ball(-1.0), vec![], "radius_mm is -1"),
        (Some(ball(1.0)), ball(1.0), backwards, "keyframe 1 of a trajectory of others is at 0 s"),
    ] {
        let others = vec![OtherPart { indenter: other, trajectory }];
        let error = Scene { indenter, others, ..Scene::default() }.validate().unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    let unknown = toml::from_str::<Scene>("[[others]]\nshape = { kind = \"sphere\", radius_mm = 1 }");
    assert!(unknown.unwrap_err().to_string().contains("unknown field `shape`"));
    let press_of_none = press(&Scene { others: Vec::new(), ..scene.clone() }, DVec3::ZERO, DVec2::ZERO, 0.5);
    assert_eq!(moment(&scene, &[Some(press_of_none); 9]).contacts.len(), 3);
}
