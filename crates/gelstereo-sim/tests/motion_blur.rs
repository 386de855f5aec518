//! Motion blur against the mean of many short exposures, which a scene without it and with more frames per
//! second gives.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::simulator;
use gelstereo_core::math::{DVec2, DVec3, Pose};
use gelstereo_sim::effects::{Defocus, Misprint, MotionBlur, Specks, UnevenLight};
use gelstereo_sim::{ContactState, Effects, Gel, GelKeyframe, Images, Keyframe, Scene, Shape, Truth};
use proptest::prelude::*;

/// Moments of an exposure.
const MOMENTS: usize = 48;

const RATE_HZ: f64 = 10.0;

const WIDTH: usize = 240;
const HEIGHT: usize = 180;

fn effects() -> Effects {
    Effects {
        defocus: Some(Defocus::default()),
        specks: Some(Specks { count: 3, ..Specks::default() }),
        misprint: Some(Misprint { merged: vec![[4, 4, 4, 5]], ..Misprint::default() }),
        uneven_light: Some(UnevenLight::default()),
        ..Effects::of_gel()
    }
}

/// A ball that comes down, drags and turns the gel, which itself is shaken, seen by a small camera.
fn scene(exposure_s: f64, shift_mm: f64, turn_rad: f64, dive_mm: f64, effects: Effects) -> Scene {
    let camera = gelstereo_core::camera::Camera {
        width_px: WIDTH,
        height_px: HEIGHT,
        fx_px: 280.0,
        fy_px: 280.0,
        cx_px: 119.5,
        cy_px: 89.5,
        distortion: [0.0; 5],
    };
    let contact = |share: f64| ContactState {
        t_sensor_object: Pose::from_translation_mm(DVec3::new(
            4.0 + 0.3 * share,
            0.0,
            32.2 - dive_mm * share,
        )),
        shear_mm: [0.2 + 0.3 * share, 0.1 * share],
        twist_rad: 0.0,
    };
    let trajectory = [0.0, 1.0].map(|share| Keyframe { time_s: 0.4 * share, contact: contact(share) });
    let gel_motion = [0.0, 1.0].map(|share| GelKeyframe {
        time_s: 0.4 * share,
        shift_mm: [shift_mm * share, -0.4 * shift_mm * share],
        rotation_rad: turn_rad * share,
    });
    Scene {
        frame_rate_hz: RATE_HZ,
        rig: gelstereo_core::rig::Rig::parallel(camera, 6.0),
        gel: Gel { rows: 9, cols: 9, pitch_mm: 1.3.into(), dot_radius_mm: 0.35, ..Gel::default() },
        indenter: Some(Shape::Sphere { radius_mm: 4.0 }),
        trajectory: trajectory.into(),
        gel_motion: gel_motion.into(),
        effects: Effects { motion_blur: Some(MotionBlur { exposure_s }), ..effects },
        ..Scene::default()
    }
}

/// Truth and both images of a frame.
fn frame(scene: &Scene, frame: u64) -> (Truth, [Vec<u8>; 2]) {
    let mut simulator = simulator(scene);
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    let contact = simulator.contact(frame as usize);
    simulator.moment(contact.as_ref(), frame, &mut truth);
    simulator.render(&truth, frame, &mut left, &mut right);
    (truth, [left, right])
}

/// Mean of images about frame 2, each of which is taken in no time: frames of a scene with so many more of
/// them, whose keyframes come earlier by what lies before the first moment.
fn mean(scene: &Scene) -> [Vec<f64>; 2] {
    let exposure_s = scene.effects.motion_blur.as_ref().unwrap().exposure_s;
    let step_s = exposure_s / MOMENTS as f64;
    let first_s = 2.0 / RATE_HZ - 0.5 * exposure_s + 0.5 * step_s;
    let whole = simulator(scene);
    let mut sharp = Scene { frame_rate_hz: 1.0 / step_s, ..scene.clone() };
    sharp.effects.motion_blur = None;
    // All is linear between two keyframes, so that the way may begin at the first moment.
    let share = first_s / scene.trajectory[1].time_s;
    let [from, to] = [0, 1].map(|k| scene.trajectory[k].contact);
    let [at, end] = [from, to].map(|contact| contact.t_sensor_object.translation_mm);
    let mix = |from: f64, to: f64| from + (to - from) * share;
    sharp.trajectory[0].contact = ContactState {
        t_sensor_object: Pose::from_translation_mm(at.lerp(end, share)),
        shear_mm: [0, 1].map(|axis| mix(from.shear_mm[axis], to.shear_mm[axis])),
        twist_rad: 0.0,
    };
    let [gel, moved] = [0, 1].map(|k| scene.gel_motion[k]);
    sharp.gel_motion[0].shift_mm = [0, 1].map(|axis| mix(gel.shift_mm[axis], moved.shift_mm[axis]));
    sharp.gel_motion[0].rotation_rad = mix(gel.rotation_rad, moved.rotation_rad);
    sharp.trajectory[1].time_s -= first_s;
    sharp.gel_motion[1].time_s -= first_s;
    let mut simulator = simulator(&sharp);
    assert!(whole.frames() == 5 && simulator.frames() >= MOMENTS);
    let mut sums = [(); 2].map(|()| vec![0.0; WIDTH * HEIGHT]);
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    for moment in 0..MOMENTS {
        let contact = simulator.contact(moment);
        simulator.moment(contact.as_ref(), moment as u64, &mut truth);
        simulator.render(&truth, moment as u64, &mut left, &mut right);
        for (sums, image) in sums.iter_mut().zip([&left, &right]) {
            sums.iter_mut().zip(image).for_each(|(sum, &level)| *sum += f64::from(level) / MOMENTS as f64);
        }
    }
    sums
}

fn farthest(image: &[u8], mean: &[f64]) -> f64 {
    image.iter().zip(mean).map(|(&level, mean)| (f64::from(level) - mean).abs()).fold(0.0, f64::max)
}

/// Both are rounded to levels, by half a level each at most. Ways of a gel that turns are bent by (way /
/// radius)² / 8 of the radius, 0.01 px, and a part of this pace bends no more; sharp edges take 2e-3 of the
/// contrast of 120: half a level in all.
const TOLERANCE: f64 = 1.5;

fn check(scene: &Scene) -> Result<(), TestCaseError> {
    let (_, images) = frame(scene, 2);
    for (image, mean) in images.iter().zip(mean(scene)) {
        let off = farthest(image, &mean);
        prop_assert!(off < TOLERANCE, "{off} levels");
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10))]

    /// Of a gel that moves as a whole, dots merged, among specks, in uneven light, with and without a lens.
    #[test]
    fn it_is_the_mean_of_many_short_exposures(
        exposure_s in 0.005..0.1_f64, shift_mm in -5.0..5.0_f64, turn_rad in -0.1..0.1_f64,
        lens in prop::bool::ANY,
    ) {
        let defocus = effects().defocus.filter(|_| lens);
        let mut scene = scene(exposure_s, shift_mm, turn_rad, 0.0, Effects { defocus, ..effects() });
        scene
            .trajectory
            .iter_mut()
            .for_each(|k| k.contact = ContactState::pressed(Pose::from_translation_mm(DVec3::Z * 40.0)));
        check(&scene)?;
    }

    /// Under a part that comes down and moves aside. (What it drags sticks from one moment to the next: no
    /// straight way.)
    #[test]
    fn so_it_is_under_a_part(
        exposure_s in 0.005..0.03_f64, shift_mm in -2.0..2.0_f64, dive_mm in 0.0..0.6_f64,
    ) {
        check(&scene(exposure_s, shift_mm, 0.0, dive_mm, Effects { drag: None, ..effects() }))?;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2))]

    /// The rung that draws on fine pixels, moment by moment.
    #[test]
    fn fast_images_are_the_exact_ones(
        exposure_s in 0.01..0.03_f64, shift_mm in -4.0..4.0_f64, turn_rad in -0.2..0.2_f64,
    ) {
        let mut scene = scene(exposure_s, shift_mm, turn_rad, 0.4, effects());
        let (_, fast) = frame(&scene, 2);
        scene.images = Images::Exact;
        let (_, exact) = frame(&scene, 2);
        for (fast, exact) in fast.iter().zip(&exact) {
            prop_assert!(fast.iter().zip(exact).all(|(a, b)| a.abs_diff(*b) <= 1));
            let other = fast.iter().zip(exact).filter(|(a, b)| a != b).count();
            prop_assert!(other < fast.len() / 200, "{other} pixels");
        }
    }
}

#[test]
fn what_stands_still_is_as_sharp_as_without_it() {
    let mut scene = scene(0.05, 0.0, 0.0, 0.0, effects());
    scene.trajectory.truncate(1);
    let (truth, blurred) = frame(&scene, 0);
    assert!(truth.left_motion_px.iter().all(|&way| way == DVec2::ZERO) && truth.left_motion_px.len() == 84);
    scene.effects.motion_blur = None;
    let (plain, sharp) = frame(&scene, 0);
    assert_eq!((blurred, plain.left_motion_px.len()), (sharp, 0));
}

/// Pace times exposure, for a gel that moves as a whole.
#[test]
fn truth_has_the_way_of_every_dot() {
    let sheet = |shift_mm| Scene {
        trajectory: Vec::new(),
        indenter: None,
        ..scene(0.02, shift_mm, 0.0, 0.0, Effects::default())
    };
    let (truth, _) = frame(&sheet(4.0), 2);
    // 10 mm/s and -4 mm/s at 28.7 mm.
    let expected = DVec2::new(10.0, -4.0) * (0.02 * 280.0 / 28.7);
    assert_eq!((truth.left_motion_px.len(), truth.right_motion_px.len()), (81, 81));
    for way in truth.left_motion_px.iter().chain(&truth.right_motion_px) {
        assert!((*way - expected).length() < 1e-9, "{way}");
    }
}

/// Markers that someone else has placed do not move.
#[test]
fn placed_markers_stand_still() {
    let scene = scene(0.05, 4.0, 0.1, 0.3, Effects::default());
    let mut simulator = simulator(&scene);
    let mut truth = Truth::default();
    simulator.moment(simulator.contact(2).as_ref(), 2, &mut truth);
    assert_eq!(truth.left_motion_px.len(), 81);
    let points = truth.points_mm.clone();
    simulator.placed(&points, 2, &mut truth).unwrap();
    assert!(truth.left_motion_px.is_empty() && truth.right_motion_px.is_empty());
}
