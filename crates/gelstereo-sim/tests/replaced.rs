//! A simulator made from another one is that of its scene, whatever the other one did.
#![allow(clippy::unwrap_used)]

use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::Pitch;
use gelstereo_sim::effects::{
    Defocus, ElasticLayer, Grain, Jpeg, Misprint, MotionBlur, Relaxation, SensorNoise, ShotNoise, Shoulder,
    Smears, Specks, Spread, UnevenLight, Wear,
};
use gelstereo_sim::{
    ContactState, Effects, Images, Keyframe, OtherPart, Relief, Scene, Shape, Simulator, Truth,
};
use proptest::prelude::*;

/// A small sensor with every effect that is shared in part.
fn base() -> Scene {
    let mut scene = Scene::default();
    for camera in [&mut scene.rig.left, &mut scene.rig.right] {
        for length in [&mut camera.fx_px, &mut camera.fy_px, &mut camera.cx_px, &mut camera.cy_px] {
            *length *= 0.2;
        }
        (camera.width_px, camera.height_px) = (128, 96);
    }
    (scene.gel.rows, scene.gel.cols) = (7, 8);
    scene.gel.pitch_mm = 1.8.into();
    let t_sensor_object = Pose::from_translation_mm(DVec3::new(4.0, 0.0, 32.0));
    let contact = ContactState { t_sensor_object, shear_mm: [0.2, 0.1], twist_rad: 0.1 };
    scene.indenter = Some(Shape::Sphere { radius_mm: 4.0 });
    scene.trajectory = vec![Keyframe { time_s: 0.0, contact }];
    scene.effects = Effects {
        elastic_layer: Some(ElasticLayer::default()),
        grain: Some(Grain::default()),
        uneven_light: Some(UnevenLight::default()),
        defocus: Some(Defocus::default()),
        shot_noise: Some(ShotNoise::default()),
        sensor_noise: Some(SensorNoise::default()),
        ..Effects::default()
    };
    scene
}

fn approximate(scene: &mut Scene) {
    let effects = &mut scene.effects;
    (effects.elastic_layer, effects.relaxation) = (None, None);
    (effects.shoulder, effects.spread) = (Some(Shoulder::default()), Some(Spread::default()));
}

fn relax(scene: &mut Scene) {
    scene.effects.relaxation = scene.effects.elastic_layer.is_some().then(Relaxation::default);
}

fn layer(change: impl Fn(&mut ElasticLayer)) -> impl Fn(&mut Scene) {
    move |scene| scene.effects.elastic_layer.iter_mut().for_each(&change)
}

type Change = Box<dyn Fn(&mut Scene)>;

/// Changes of a scene, each valid beside every other one.
fn changes() -> Vec<Change> {
    vec![
        Box::new(|scene| scene.effects.sensor_noise = Some(SensorNoise { sigma_levels: 4.0 })),
        Box::new(|scene| scene.effects.sensor_noise = None),
        Box::new(|scene| scene.effects.shot_noise = Some(ShotNoise { full_well_electrons: 900.0 })),
        Box::new(|scene| scene.effects.shot_noise = None),
        Box::new(|scene| {
            scene.effects.uneven_light = Some(UnevenLight { across: -0.3, ..UnevenLight::default() });
        }),
        Box::new(|scene| scene.effects.uneven_light = None),
        Box::new(|scene| scene.effects.grain = Some(Grain { sigma_levels: 6.0, size_px: 1.0 })),
        Box::new(|scene| scene.effects.grain = None),
        Box::new(|scene| scene.effects.defocus = Some(Defocus { sigma_px: 1.4 })),
        Box::new(|scene| scene.effects.defocus = None),
        Box::new(|scene| scene.effects.jpeg = Some(Jpeg::default())),
        Box::new(|scene| scene.effects.smears = Some(Smears { random: 3, ..Smears::default() })),
        Box::new(|scene| scene.effects.specks = Some(Specks { count: 5, ..Specks::default() })),
        Box::new(|scene| {
            scene.effects.misprint = Some(Misprint { shift_mm: 0.03, ..Misprint::default() });
        }),
        Box::new(|scene| scene.effects.wear = Some(Wear::default())),
        Box::new(|scene| scene.effects.motion_blur = Some(MotionBlur::default())),
        Box::new(relax),
        Box::new(layer(|layer| layer.friction = 0.2)),
        Box::new(layer(|layer| layer.young_kpa = 200.0)),
        Box::new(layer(|layer| layer.poisson_ratio = 0.4)),
        Box::new(layer(|layer| layer.border_pitches = 3)),
        Box::new(layer(|layer| layer.cells_per_pitch = 3)),
        Box::new(approximate),
        Box::new(|scene| scene.seed = 2),
        Box::new(|scene| scene.gel.thickness_mm = 4.0),
        Box::new(|scene| scene.gel.pitch_mm = Pitch { x_mm: 1.7, y_mm: 1.9 }),
        Box::new(|scene| scene.gel.rows = 8),
        Box::new(|scene| scene.gel.bright_dots = true),
        Box::new(|scene| scene.gel.bright_level = 190),
        Box::new(|scene| scene.gel.missing = vec![[2, 3]]),
        Box::new(|scene| {
            // As many pixels as before.
            for camera in [&mut scene.rig.left, &mut scene.rig.right] {
                (camera.width_px, camera.height_px) = (192, 64);
            }
        }),
        Box::new(|scene| scene.indenter = Some(Shape::Box { size_mm: [4.0, 3.0, 3.0] })),
        Box::new(|scene| scene.images = Images::Exact),
        Box::new(|scene| scene.gel.relief = Some(Relief::Dome { radius_mm: 100.0 })),
        Box::new(|scene| {
            let indenter = Shape::Sphere { radius_mm: 2.0 };
            let t_sensor_object = Pose::from_translation_mm(DVec3::new(7.0, 1.0, 30.2));
            let contact = ContactState::pressed(t_sensor_object);
            scene.others = vec![OtherPart { indenter, trajectory: vec![Keyframe { time_s: 0.0, contact }] }];
        }),
        Box::new(|scene| scene.frame_rate_hz = 60.0),
    ]
}

/// The base scene with the changes whose bits are set.
fn scene(bits: u64) -> Scene {
    let mut scene = base();
    let set = changes().into_iter().enumerate().filter(|(k, _)| bits >> k & 1 == 1);
    set.for_each(|(_, change)| change(&mut scene));
    scene
}

fn frame(simulator: &mut Simulator, number: u64) -> (Truth, Vec<u8>, Vec<u8>) {
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    simulator.moment(simulator.contact(0).as_ref(), number, &mut truth);
    simulator.render(&truth, number, &mut left, &mut right);
    (truth, left, right)
}

/// Compares everything that they hold, and a frame.
fn assert_same(found: &mut Simulator, expected: &mut Simulator) {
    assert!(format!("{found:?}") == format!("{expected:?}"), "other state");
    assert!(frame(found, 1) == frame(expected, 1), "other frame");
}

/// Random sets of changes, most of them small.
fn sets() -> impl Strategy<Value = u64> {
    prop::collection::vec(0..changes().len(), 0..6)
        .prop_map(|set| set.iter().fold(0, |bits, k| bits | 1 << k))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn a_replaced_simulator_is_that_of_its_scene(from in sets(), to in sets()) {
        let (from, to) = (scene(from), scene(to));
        let mut first = Simulator::new(&from, None).unwrap();
        let before = frame(&mut first, 1);
        let pose = from.trajectory.first().map(|key| key.contact.t_sensor_object);
        let _ = first.advance(pose, 0, &mut Truth::default());
        let mut replaced = first.replaced(&to, None).unwrap();
        assert_same(&mut replaced, &mut Simulator::new(&to, None).unwrap());
        // The first one is as it was, and can be had again.
        prop_assert!(frame(&mut first, 1) == before);
        assert_same(&mut replaced.replaced(&from, None).unwrap(), &mut Simulator::new(&from, None).unwrap());
    }
}

#[test]
fn every_single_change_is_seen_by_a_replaced_simulator() {
    let whole = base();
    let first = Simulator::new(&whole, None).unwrap();
    for change in changes() {
        let mut to = whole.clone();
        change(&mut to);
        let found = format!("{:?}", first.replaced(&to, None).unwrap());
        assert!(found == format!("{:?}", Simulator::new(&to, None).unwrap()));
        assert!(found != format!("{first:?}"), "the change is none");
    }
}
