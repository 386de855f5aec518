//! A gel that moves before the cameras, and frames that never arrive.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{images, rest, truth, xy};
use gelstereo_core::math::{DVec2, cos, sin};
use gelstereo_sim::effects::DroppedFrames;
use gelstereo_sim::{Effects, GelKeyframe, Scene, Shape, Sight, Simulator, Truth};
use proptest::prelude::*;

fn moving(keyframes: &[(f64, [f64; 2], f64)]) -> Scene {
    let keyframe = |&(time_s, shift_mm, rotation_rad): &_| GelKeyframe { time_s, shift_mm, rotation_rad };
    Scene { gel_motion: keyframes.iter().map(keyframe).collect(), ..Scene::default() }
}

fn at(scene: &Scene, frame: u64) -> Truth {
    let mut truth = Truth::default();
    Simulator::new(scene, None).unwrap().moment(None, frame, &mut truth);
    truth
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn the_lattice_moves_as_a_whole(
        x in -30.0..30.0, y in -30.0..30.0, turn in -7.0..7.0, printed in -3.0..3.0, frame in 0_u64..40,
    ) {
        let mut scene = moving(&[(0.0, [0.0, 0.0], 0.0), (1.0, [x, y], turn)]);
        scene.gel.rotation_rad = printed;
        let share = (frame as f64 / 30.0).min(1.0);
        let (still, found) = (rest(&scene), at(&scene, frame));
        let (s, c) = (sin(share * turn), cos(share * turn));
        for (a, b) in still.points_mm.iter().zip(&found.points_mm) {
            let arm = xy(*a) - DVec2::new(4.0, 0.0);
            let turned = DVec2::new(c * arm.x - s * arm.y, s * arm.x + c * arm.y);
            let expected = DVec2::new(4.0 + share * x, share * y) + turned;
            prop_assert!((xy(*b) - expected).length() < 1e-12 && b.z == 28.7);
        }
        // What is said to be cut crosses the border, what is whole does not.
        for dot in found.left_dots.iter().chain(&found.right_dots) {
            let (low, high) = (dot.outline.centre_px - 4.2927, dot.outline.centre_px + 4.2927);
            let inside = low.x > -0.5 && low.y > -0.5 && high.x < 639.5 && high.y < 479.5;
            let outside = high.x < -0.5 || high.y < -0.5 || low.x > 639.5 || low.y > 479.5;
            let expected = if inside { Sight::Whole } else if outside { Sight::Outside } else { Sight::Cut };
            prop_assert_eq!(dot.sight, expected);
        }
    }

    /// The part stands in the sensor's frame; the gel that comes under it is pressed there.
    #[test]
    fn a_moved_gel_is_pressed_where_it_is(x in -1.0..1.0, turn in -3.0..3.0) {
        let mut scene = moving(&[(0.0, [x, 0.3], turn)]);
        scene.indenter = Some(Shape::Sphere { radius_mm: 4.0 });
        let contact = common::press(&scene, gelstereo_core::math::DVec3::ZERO, DVec2::ZERO, 1.5);
        let moved = truth(&scene, Some(&contact));
        let mut printed = Scene { gel_motion: Vec::new(), ..scene };
        printed.gel.centre_mm = [4.0 + x, 0.3];
        printed.gel.rotation_rad = turn;
        let expected = truth(&printed, Some(&contact));
        for (a, b) in moved.points_mm.iter().zip(&expected.points_mm) {
            prop_assert!((*a - *b).length() < 1e-9);
        }
    }
}

#[test]
fn a_border_row_leaves_the_view_and_comes_back() {
    // 3 mm are 58 px; the lowest row is 29 px above the border.
    let scene = moving(&[(0.0, [0.0, 0.0], 0.0), (0.5, [0.0, 3.0], 0.0), (1.0, [0.0, 0.0], 0.0)]);
    let lowest = |frame| at(&scene, frame).left_dots[600..].iter().map(|dot| dot.sight).collect::<Vec<_>>();
    assert_eq!(Simulator::new(&scene, None).unwrap().frames(), 31);
    assert_eq!(lowest(0), vec![Sight::Whole; 25]);
    assert_eq!(lowest(15), vec![Sight::Outside; 25]);
    assert_eq!(lowest(30), vec![Sight::Whole; 25]);
    assert!((0..15).any(|frame| lowest(frame) == vec![Sight::Cut; 25]));
}

#[test]
fn one_frame_may_move_by_more_than_a_pitch() {
    let step = 1.3 * 0.9;
    let scene = moving(&[(0.0, [0.0, 0.0], 0.0), (1.0 / 30.0, [step, 0.0], 0.0)]);
    let (first, second) = (at(&scene, 0), at(&scene, 1));
    for (a, b) in first.left_px.iter().zip(&second.left_px) {
        assert!((b.x - a.x - 1.3 * 0.9 * 560.0 / 28.7).abs() < 1e-9);
    }
}

#[test]
fn dropped_frames_are_skipped_and_the_others_stay_the_same() {
    let mut scene = moving(&[(0.5, [0.0, 0.0], 0.0), (1.5, [2.0, 0.0], 0.0)]);
    scene.effects.sensor_noise = Some(gelstereo_sim::effects::SensorNoise::default());
    let whole = Simulator::new(&scene, None).unwrap();
    assert_eq!(
        (whole.frames(), whole.delivered(), whole.frame_of(30), whole.frame_of(31)),
        (31, 31, Some(30), None)
    );
    let drops = DroppedFrames { frames: vec![0, 7, 8, 30, 900], rate: 0.0 };
    scene.effects.dropped_frames = Some(drops);
    let some = Simulator::new(&scene, None).unwrap();
    let arrived: Vec<usize> = (0..some.delivered()).map(|i| some.frame_of(i).unwrap()).collect();
    assert_eq!(arrived, (1..30).filter(|i| ![7, 8].contains(i)).collect::<Vec<_>>());
    assert_eq!((some.frames(), some.frame_of(27)), (31, None));
    assert!((some.time_s(9) - (0.5 + 9.0 / 30.0)).abs() < 1e-12, "the clock does not stop");
    let without =
        Scene { effects: Effects { dropped_frames: None, ..scene.effects.clone() }, ..scene.clone() };
    assert_eq!(images(&scene, 9), images(&without, 9));
    // A rate: five standard errors of 30000 draws are 0.0087.
    scene.gel_motion[1].time_s = 1000.5;
    scene.effects.dropped_frames = Some(DroppedFrames { frames: Vec::new(), rate: 0.1 });
    let many = Simulator::new(&scene, None).unwrap();
    let share = many.delivered() as f64 / many.frames() as f64;
    assert!((share - 0.9).abs() < 0.0087, "{share}");
    assert_eq!(many.frame_of(0), Some(0), "the first one arrives");
}
