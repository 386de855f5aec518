//! Bounds of effects against what the effects change: true change <= bound, in every scene and whichever
//! other effects are on.
#![allow(clippy::unwrap_used)]

use crate::every_effect;

use gelstereo_core::camera::{Camera, Layer, Layers};
use gelstereo_core::math::{DVec2, DVec3, Pose, so3};
use gelstereo_core::params::{Pitch, PrintLayout};
use gelstereo_core::rig::Rig;
use gelstereo_sim::effects::{
    Defocus, Drag, ElasticLayer, Grain, Jpeg, Misprint, MotionBlur, SensorNoise, ShotNoise, Shoulder, Smears,
    Specks, Spread, UnevenLight, Wear,
};
use gelstereo_sim::plan::Bound;
use gelstereo_sim::{
    Asked, ContactState, Effects, Gel, GelKeyframe, Keyframe, OtherPart, Plan, Relief, Scene, Shape,
    Simulator, Switch, Truth,
};
use proptest::prelude::*;

/// What the simulator gives for the frames of a scene.
struct Seen {
    truths: Vec<Truth>,
    images: Vec<Vec<u8>>,
}

fn see(scene: &Scene, rendered: bool) -> Seen {
    let mut simulator = Simulator::new(scene, None).unwrap();
    let mut seen = Seen { truths: Vec::new(), images: Vec::new() };
    for frame in 0..simulator.frames() {
        let mut truth = Truth::default();
        simulator.moment(simulator.contact(frame).as_ref(), frame as u64, &mut truth);
        if rendered {
            let (mut left, mut right) = (Vec::new(), Vec::new());
            simulator.render(&truth, frame as u64, &mut left, &mut right);
            seen.images.extend([left, right]);
        }
        seen.truths.push(truth);
    }
    seen
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, f64::max)
}

/// How far two are apart, in dots that both show.
fn apart(rig: &Rig, a: &Seen, b: &Seen) -> Bound {
    let truths = || a.truths.iter().zip(&b.truths);
    let dots = |truth: &Truth| -> Vec<_> {
        truth.left_dots.iter().chain(&truth.right_dots).map(|dot| dot.outline.centre_px).collect()
    };
    let size = DVec2::new(rig.left.width_px as f64, rig.left.height_px as f64);
    let within = |at: &DVec2| at.cmpge(DVec2::splat(-0.5)).all() && at.cmple(size - 0.5).all();
    let pairs = truths().flat_map(|(a, b)| dots(a).into_iter().zip(dots(b)));
    let px = pairs.filter(|(a, b)| within(a) && within(b)).map(|(a, b)| (a - b).length());
    let um = truths()
        .flat_map(|(a, b)| a.points_mm.iter().zip(&b.points_mm))
        .map(|(a, b)| 1e3 * (*a - *b).length());
    let images = a.images.iter().flatten().zip(b.images.iter().flatten());
    let levels = images.map(|(&a, &b)| f64::from(a.abs_diff(b)));
    Bound { px: largest(px), um: largest(um), levels: largest(levels) }
}

/// Those that random scenes have: what drops frames or needs the layer is tested elsewhere.
fn names() -> Vec<&'static str> {
    let apart = ["dropped_frames", "relaxation", "large_strain"];
    every_effect::names().into_iter().filter(|name| !apart.contains(name)).collect()
}

/// More than there are.
const MOST: u32 = 24;

/// A scene whose effects of these bits are off.
fn switched(scene: &Scene, off: u32) -> Scene {
    let mut scene = scene.clone();
    for (bit, name) in names().into_iter().enumerate().filter(|(bit, _)| off >> bit & 1 == 1) {
        *scene.switches.get_mut(name).unwrap_or_else(|| panic!("{bit}")) = Some(Switch::Off);
    }
    scene
}

fn cameras() -> impl Strategy<Value = Rig> {
    let layers = prop::option::of((4.0..15.0_f64, 0.0..4.0_f64, 1.0..1.8_f64, 1.0..1.6_f64, -0.05..0.05_f64));
    let lens = prop::option::of((-0.3..0.3_f64, -0.1..0.1_f64, -0.004..0.004_f64, -0.05..0.05_f64));
    (layers, lens, -0.05..0.05_f64, -0.05..0.05_f64, 4.0..9.0_f64).prop_map(
        |(layers, lens, turn, roll, baseline)| {
            let camera = Camera {
                width_px: 240,
                height_px: 180,
                fx_px: 230.0,
                fy_px: 226.0,
                cx_px: 118.0,
                cy_px: 91.0,
                distortion: lens.map_or([0.0; 5], |(k1, k2, p, k3)| [k1, k2, p, -0.5 * p, k3]),
            };
            let layers = layers.map(|(gap_mm, thickness_mm, index, gel_index, slant)| Layers {
                normal: DVec3::new(slant, -slant, 1.0).normalize(),
                gap_mm,
                plates: vec![Layer { thickness_mm, index }],
                gel_index,
            });
            let turned = so3::exp(DVec3::new(roll, turn, 0.3 * roll));
            let t_right_left =
                Pose { rotation: turned, translation_mm: turned * DVec3::new(-baseline, 0.0, 0.0) };
            Rig { left: camera.clone(), right: camera, t_right_left, layers }
        },
    )
}

fn shapes() -> impl Strategy<Value = Shape> {
    prop_oneof![
        (1.0..9.0_f64).prop_map(|radius_mm| Shape::Sphere { radius_mm }),
        (1.0..4.0_f64, 3.0..9.0_f64)
            .prop_map(|(radius_mm, length_mm)| Shape::Cylinder { radius_mm, length_mm }),
        (1.0..4.0_f64, 2.0..7.0_f64).prop_map(|(a, b)| Shape::Box { size_mm: [a, b, 3.0] }),
        (0.2..2.0_f64).prop_map(|protrusion_mm| Shape::Board {
            size_mm: [20.0, 20.0],
            block_mm: [5.0, 4.0],
            protrusion_mm,
        }),
    ]
}

/// A part that comes down, and moves and turns while it is there.
fn trajectories() -> impl Strategy<Value = Vec<(f64, ContactState)>> {
    let turns = prop::array::uniform3(-0.6..0.6_f64);
    let shear = prop::array::uniform2(-0.6..0.6_f64);
    let moments = (-0.2..1.8_f64, turns, shear, -0.3..0.3_f64, -2.0..2.0_f64, prop::bool::weighted(0.4));
    prop::collection::vec(moments, 1..4).prop_map(|moments| {
        let contact =
            |(press_mm, turn, shear_mm, twist_rad, x, still): (f64, [f64; 3], [f64; 2], f64, f64, bool)| {
                let turn =
                    if still { DVec3::new(core::f64::consts::PI, 0.0, 0.0) } else { DVec3::from_array(turn) };
                let pose =
                    Pose { rotation: so3::exp(turn), translation_mm: DVec3::new(4.0 + x, 0.5 * x, 0.0) };
                let contact = ContactState { shear_mm, twist_rad, ..ContactState::pressed(pose) };
                (
                    press_mm,
                    if still {
                        ContactState { shear_mm: [0.0; 2], twist_rad: 0.0, ..contact }
                    } else {
                        contact
                    },
                )
            };
        moments.into_iter().map(contact).collect()
    })
}

/// Any of an effect's sizes, small ones as often as large ones.
fn size(most: f64) -> impl Strategy<Value = f64> {
    (-4.0..0.0_f64).prop_map(move |exponent| most * 10.0_f64.powf(exponent))
}

fn effects() -> impl Strategy<Value = Effects> {
    let gel = (
        // The elastic layer stands for the three below.
        prop::option::weighted(
            0.2,
            (0.0..0.5_f64, 0.0..2.0_f64).prop_map(|(poisson_ratio, friction)| ElasticLayer {
                poisson_ratio,
                friction,
                ..ElasticLayer::default()
            }),
        ),
        prop::option::of((0.05..1.5_f64).prop_map(|decay_thicknesses| Shoulder { decay_thicknesses })),
        prop::option::of(
            (size(1.0), 0.3..3.0_f64)
                .prop_map(|(strength, decay_thicknesses)| Spread { strength, decay_thicknesses }),
        ),
        prop::option::of((0.1..1.5_f64).prop_map(|decay_thicknesses| Drag { decay_thicknesses })),
        prop::option::of((size(0.149), size(0.5), prop::bool::ANY).prop_map(
            |(shift_mm, radius_share, merged)| Misprint {
                shift_mm,
                radius_share,
                merged: if merged { vec![[3, 4, 3, 5]] } else { Vec::new() },
                bridge_share: 0.7,
            },
        )),
        prop::option::of((0..3_usize).prop_map(|count| Specks { count, ..Specks::default() })),
    );
    let image = (
        prop::option::of(
            (size(10.0), 0.1..3.0_f64).prop_map(|(sigma_levels, size_px)| Grain { sigma_levels, size_px }),
        ),
        prop::option::of((0.2..1.6_f64, size(0.9), size(-0.9), size(0.9)).prop_map(
            |(gain, across, down, corner_loss)| UnevenLight {
                gain: if gain > 1.3 { 1.0 } else { gain },
                across,
                down,
                corner_loss,
            },
        )),
        prop::option::of((0..3_usize).prop_map(|random| Smears {
            random,
            lasting_s: 1.0,
            ..Smears::default()
        })),
        prop::option::of((0.1..2.0_f64).prop_map(|sigma_px| Defocus { sigma_px })),
        prop::option::of(size(10.0).prop_map(|sigma_levels| SensorNoise { sigma_levels })),
        prop::option::of((300.0..1e6_f64).prop_map(|full_well_electrons| ShotNoise { full_well_electrons })),
        prop::option::weighted(0.3, (1..=100_u8).prop_map(|quality| Jpeg { quality })),
        prop::option::of(
            (size(1.0), size(2.0), 0.0..1.0_f64).prop_map(|(share, share_per_s, uneven_share)| Wear {
                share,
                share_per_s,
                uneven_share,
            }),
        ),
        prop::option::weighted(0.3, size(0.5).prop_map(|exposure_s| MotionBlur { exposure_s })),
    );
    (gel, image).prop_map(|((elastic_layer, shoulder, spread, drag, misprint, specks), image)| {
        let beside = elastic_layer.is_none();
        let (grain, uneven_light, smears, defocus, sensor_noise, shot_noise, jpeg, wear, motion_blur) = image;
        Effects {
            elastic_layer,
            shoulder: shoulder.filter(|_| beside),
            spread: spread.filter(|_| beside),
            drag: drag.filter(|_| beside),
            misprint,
            specks,
            grain,
            uneven_light,
            smears,
            defocus,
            sensor_noise,
            shot_noise,
            jpeg,
            wear,
            motion_blur,
            ..Effects::default()
        }
    })
}

fn scenes() -> impl Strategy<Value = Scene> {
    let pitch = (0.6..1.4_f64, 1.0..1.4_f64, 1.0..1.4_f64);
    let gel =
        (6..14_usize, 6..14_usize, pitch, 0.1..0.45_f64, 2.0..6.0_f64, -0.3..0.3_f64, any::<[bool; 2]>());
    let gel = gel.prop_map(
        |(rows, cols, pitch, share, thickness_mm, rotation_rad, [bright_dots, is_hexagonal])| {
            let (pitch_mm, right, down) = pitch;
            let down = if is_hexagonal { right } else { down };
            let layout = if is_hexagonal { PrintLayout::Hexagonal } else { PrintLayout::Square };
            let dot_radius_mm = share * pitch_mm;
            let pitch_mm = Pitch { x_mm: right * pitch_mm, y_mm: down * pitch_mm };
            Gel {
                rows,
                cols,
                layout,
                pitch_mm,
                dot_radius_mm,
                thickness_mm,
                rotation_rad,
                bright_dots,
                ..Gel::default()
            }
        },
    );
    let other = prop::option::of((shapes(), trajectories()));
    let relief = (90.0..300.0_f64, prop::bool::ANY).prop_map(|(radius_mm, hollow)| Relief::Dome {
        radius_mm: if hollow { -radius_mm } else { radius_mm },
    });
    let gel = (gel, prop::option::of(relief)).prop_map(|(gel, relief)| Gel { relief, ..gel });
    (cameras(), gel, shapes(), trajectories(), other, effects(), 0..1000_u64).prop_map(
        |(rig, gel, shape, moments, other, effects, seed)| {
            let mut scene = Scene { seed, frame_rate_hz: 4.0, rig, gel, effects, ..Scene::default() };
            scene.indenter = Some(shape);
            let (second_shape, second) = other.unzip();
            let second_part = |indenter| OtherPart { indenter, trajectory: Vec::new() };
            scene.others = second_shape.into_iter().map(second_part).collect();
            // How deep the part goes is the same without effects, some of which take long to begin.
            let bare = Scene { effects: Effects::default(), ..scene.clone() };
            let simulator = Simulator::new(&bare, None).unwrap();
            let key = |part: usize, (k, (press_mm, contact)): (usize, (f64, ContactState))| {
                let pose = simulator.pressed_of(part, contact.t_sensor_object, press_mm);
                let contact = ContactState { t_sensor_object: pose.unwrap(), ..contact };
                Keyframe { time_s: 0.5 * k as f64, contact }
            };
            scene.trajectory = moments.into_iter().enumerate().map(|moment| key(0, moment)).collect();
            if let Some(moments) = second {
                scene.others[0].trajectory =
                    moments.into_iter().enumerate().map(|moment| key(1, moment)).collect();
            }
            scene
        },
    )
}

/// What switches an effect off.
fn bit(effect: &str) -> u32 {
    1 << names().iter().position(|&name| name == effect).unwrap()
}

/// Changes of one effect, with those of `off` away.
fn change(scene: &Scene, effect: &str, off: u32) -> Bound {
    let (own, off) = (bit(effect), off & !bit(effect));
    apart(&scene.rig, &see(&switched(scene, off), true), &see(&switched(scene, off | own), true))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(120))]

    #[test]
    fn no_effect_changes_more_than_its_bound(
        scene in scenes(), name in prop::sample::select(names()), off in 0..1_u32 << MOST,
    ) {
        let plan = Plan::of(&scene, None).unwrap();
        if let Some(entry) = plan.entries.iter().find(|entry| entry.effect == name) {
            let (found, bound) = (change(&scene, name, off), entry.bound);
            // 1e-6 mm is what the relaxation leaves.
            prop_assert!(found.um <= bound.um + 2e-3, "{name}: {} um, bound {}", found.um, bound.um);
            prop_assert!(found.px <= bound.px + 1e-5, "{name}: {} px, bound {}", found.px, bound.px);
            // Rounded to whole levels.
            prop_assert!(
                found.levels <= bound.levels.ceil(),
                "{name}: {} levels, bound {}",
                found.levels,
                bound.levels
            );
        }
    }

    /// What moves is smeared by no more than its pace allows: seldom among all effects, so once more by
    /// itself.
    #[test]
    fn motion_blur_changes_no_more_than_its_bound(
        scene in scenes(), exposure_s in size(0.2), gel_mm in size(2.0), off in 0..1_u32 << MOST,
    ) {
        let mut scene = scene;
        scene.effects.motion_blur = Some(MotionBlur { exposure_s });
        let moved = |time_s| {
            let shift_mm = [gel_mm * time_s, 0.0];
            GelKeyframe { time_s, shift_mm, rotation_rad: 0.1 * gel_mm * time_s }
        };
        scene.gel_motion = [0.0, 1.0].map(moved).into();
        let plan = Plan::of(&switched(&scene, off & !bit("motion_blur")), None).unwrap();
        let bound = plan.entries.iter().find(|entry| entry.effect == "motion_blur").unwrap().bound;
        let found = change(&scene, "motion_blur", off);
        prop_assert!(found.px == 0.0 && found.um == 0.0 && bound.px == 0.0 && bound.um == 0.0);
        prop_assert!(found.levels <= bound.levels.ceil(), "{} levels, bound {}", found.levels, bound.levels);
    }

    /// Whatever is switched off on auto, what is left is within the tolerance of the whole scene.
    #[test]
    fn together_they_stay_within_the_tolerance(
        scene in scenes(), kind in 0..3_usize, exponent in -3.0..2.5_f64,
    ) {
        let tolerance = 10.0_f64.powf(exponent);
        let asked = match kind {
            0 => Asked::Positions { tolerance_px: tolerance },
            1 => Asked::Points { tolerance_um: tolerance },
            _ => Asked::Images { tolerance_levels: tolerance },
        };
        let planned = Scene { asked: Some(asked), ..scene.clone() };
        let plan = Plan::of(&planned, None).unwrap();
        prop_assert!(plan.left_out() <= tolerance);
        let least_on =
            plan.entries.iter().filter(|e| e.on).map(|e| asked.of(&e.bound)).fold(f64::INFINITY, f64::min);
        prop_assert!(plan.left_out() + least_on > tolerance, "one more could be off");
        let found = asked.of(&apart(&scene.rig, &see(&scene, kind == 2), &see(&planned, kind == 2)));
        let slack = [1e-5, 2e-3, 1.0][kind];
        prop_assert!(found <= tolerance + slack, "{found} {}, asked {tolerance}", asked.unit());
    }
}

fn keyframe(time_s: f64, at_mm: [f64; 3], turn_rad: f64, shear_mm: f64, twist_rad: f64) -> Keyframe {
    let rotation = so3::exp(DVec3::new(turn_rad, 0.0, 0.0));
    let t_sensor_object = Pose { rotation, translation_mm: DVec3::from_array(at_mm) };
    Keyframe { time_s, contact: ContactState { t_sensor_object, shear_mm: [shear_mm, 0.0], twist_rad } }
}

/// A ball and a peg on the default sensor behind lenses that distort, and a board behind layers, with every
/// effect; and the peg on an elastic layer.
fn typical() -> [(&'static str, Scene); 4] {
    let effects = Effects {
        misprint: Some(Misprint { shift_mm: 0.04, radius_share: 0.15, ..Misprint::default() }),
        specks: Some(Specks::default()),
        grain: Some(Grain::default()),
        uneven_light: Some(UnevenLight::default()),
        smears: Some(Smears { random: 8, ..Smears::default() }),
        defocus: Some(Defocus::default()),
        sensor_noise: Some(SensorNoise::default()),
        ..Effects::of_gel()
    };
    let mut plain = Scene { frame_rate_hz: 2.0, effects: effects.clone(), ..Scene::default() };
    for camera in [&mut plain.rig.left, &mut plain.rig.right] {
        camera.distortion = [-0.2, 0.05, 0.001, -0.001, 0.0];
    }
    let ball = Scene {
        indenter: Some(Shape::Sphere { radius_mm: 4.0 }),
        trajectory: vec![keyframe(0.0, [4.0, 0.0, 31.2], 0.0, 0.0, 0.0)],
        ..plain.clone()
    };
    let lying = core::f64::consts::FRAC_PI_2;
    let peg = Scene {
        indenter: Some(Shape::Cylinder { radius_mm: 4.0, length_mm: 20.0 }),
        trajectory: vec![keyframe(0.0, [4.5, 0.0, 30.7], lying, 0.5, 0.1)],
        ..plain
    };
    let board = Scene {
        indenter: Some(Shape::Board { size_mm: [30.0, 30.0], block_mm: [8.0, 8.0], protrusion_mm: 0.8 }),
        trajectory: vec![keyframe(0.0, [5.0, 0.0, 28.0], core::f64::consts::PI, 0.0, 0.0)],
        effects,
        ..Scene::preset("640x480-25-refraction").unwrap()
    };
    let layer = Effects { elastic_layer: Some(ElasticLayer::default()), ..Effects::default() };
    let layer = Scene { effects: layer, ..peg.clone() };
    [("ball", ball), ("peg", peg), ("board", board), ("peg on a layer", layer)]
}

/// Effect, the unit it is judged in, and how many times too large its bound may be.
type Factor = (&'static str, Unit, f64);

/// Part of a bound, and whether it takes images to know it.
#[derive(Clone, Copy)]
struct Unit(fn(Bound) -> f64, bool);

const UM: Unit = Unit(|bound| bound.um, false);
const PX: Unit = Unit(|bound| bound.px, false);
const LEVELS: Unit = Unit(|bound| bound.levels, true);

/// Bounds are loose where they ask little of a scene, but not without limit: in typical scenes they are at
/// most so many times what happens. (Manual: the table of effects.)
#[test]
fn bounds_are_of_use() {
    let factors: [Factor; 15] = [
        ("shoulder", UM, 10.0),
        ("spread", UM, 20.0),
        ("drag", UM, 5.0),
        ("elastic_layer", UM, 10.0),
        ("misprint", LEVELS, 2.0),
        ("specks", LEVELS, 1.1),
        ("grain", LEVELS, 10.0),
        ("uneven_light", LEVELS, 2.0),
        ("smears", LEVELS, 2.0),
        ("motion_blur", LEVELS, 6.0),
        ("defocus", LEVELS, 7.0),
        ("sensor_noise", LEVELS, 1.2),
        ("refraction", PX, 1.5),
        ("lens_distortion", PX, 4.0),
        ("ellipse_bias", PX, 700.0),
    ];
    for (name, scene) in typical().into_iter().chain([sliding()]) {
        let plan = Plan::of(&scene, None).unwrap();
        let whole = see(&scene, true);
        for (effect, Unit(part, rendered), factor) in factors {
            let Some(entry) = plan.entries.iter().find(|entry| entry.effect == effect) else { continue };
            let without = see(&switched(&scene, bit(effect)), rendered);
            let (bound, found) = (part(entry.bound), part(apart(&scene.rig, &whole, &without)));
            assert!(bound <= factor * found, "{name}, {effect}: bound {bound}, found {found}");
        }
    }
}

/// Gel that passes by half a pixel while the shutter is open, before a sharp lens.
fn sliding() -> (&'static str, Scene) {
    let at = |time_s: f64| GelKeyframe { time_s, shift_mm: [2.5 * time_s, 0.0], rotation_rad: 0.0 };
    let scene = Scene {
        gel_motion: vec![at(0.0), at(2.0)],
        effects: Effects { motion_blur: Some(MotionBlur::default()), ..Effects::default() },
        frame_rate_hz: 1.0,
        ..Scene::default()
    };
    ("gel that slides", scene)
}
