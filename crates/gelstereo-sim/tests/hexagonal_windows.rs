//! Search in windows on hexagonal prints: the names and centres of the whole search, and jumps by a step of
//! the lattice.
#![allow(clippy::unwrap_used)]

use gelstereo_core::image::GrayView;
use gelstereo_core::math::{DVec2, DVec3, Pose, sqrt};
use gelstereo_core::params::{Background, LabelMethod, Motion, Params, PrintLayout, Search, Threshold};
use gelstereo_core::pipeline::{Frame, Pipeline, Searched};
use gelstereo_core::track::MarkerState;
use gelstereo_sim::effects::SensorNoise;
use gelstereo_sim::{ContactState, Effects, Gel, GelKeyframe, Scene, Shape, Simulator, Truth};
use proptest::prelude::*;

const WINDOWS: [Searched; 2] = [Searched::Windows; 2];
const WHOLE: [Searched; 2] = [Searched::Whole; 2];

type Pair = [Vec<u8>; 2];

fn params(search: Search) -> Params {
    let mut params = Params::preset("fast").unwrap();
    (params.detect.background, params.detect.threshold) = (Background::Blocks, Threshold::Auto);
    (params.detect.search, params.label.method) = (search, LabelMethod::Lattice);
    params.lattice.layout = PrintLayout::Hexagonal;
    params.track.motion = Motion::ConstantVelocity;
    params
}

fn scene(odd_rows_forward: bool) -> Scene {
    let effects = Effects { sensor_noise: Some(SensorNoise::default()), ..Effects::of_gel() };
    let gel = Gel { rows: 22, cols: 19, layout: PrintLayout::Hexagonal, odd_rows_forward, ..Gel::default() };
    Scene { gel, indenter: Some(Shape::Sphere { radius_mm: 6.0 }), effects, ..Scene::default() }
}

fn look(simulator: &mut Simulator, truth: &Truth, frame: u64) -> Pair {
    let mut pair = Pair::default();
    let [left, right] = &mut pair;
    simulator.render(truth, frame, left, right);
    pair
}

fn process(pipeline: &mut Pipeline, [left, right]: &Pair, frame: &mut Frame) -> [Searched; 2] {
    let view = |pixels| GrayView::new(pixels, 640, 480, 640).unwrap();
    pipeline.process(view(left), view(right), frame).unwrap();
    [frame.left.searched, frame.right.searched]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(5))]

    /// The centres differ by less than their own standard deviation, as those of a square print. (Where
    /// motion reverses within a frame, up to one marker in 200 may be missed in its window, on any print.)
    #[test]
    fn presses_are_followed_in_windows_as_in_the_whole_image(
        forward in any::<bool>(), x in -3.0..3.0_f64, y in -3.0..3.0_f64, most_mm in 0.3..1.3_f64,
        shear_mm in prop::array::uniform2(-0.3..0.3_f64),
    ) {
        let mut simulator = Simulator::new(&scene(forward), None).unwrap();
        let (whole, windows) = (params(Search::Whole), params(Search::Windows));
        let rig = Scene::default_rig();
        let mut pipelines = [&whole, &windows].map(|params| Pipeline::new(&rig, params).unwrap());
        let (mut truth, mut frames) = (Truth::default(), [Frame::default(), Frame::default()]);
        let above = Pose::from_translation_mm(DVec3::new(4.0 + x, y, 40.0));
        for n in 0..7_u32 {
            let share = f64::from(n) / 6.0;
            let pose = simulator.pressed(above, share * most_mm).unwrap();
            let shear_mm = shear_mm.map(|mm| mm * share);
            let contact = ContactState { shear_mm, ..ContactState::pressed(pose) };
            simulator.truth(Some(&contact).filter(|_| n > 0), &mut truth);
            let pair = look(&mut simulator, &truth, u64::from(n));
            let [whole, near] = &mut pipelines;
            let [a, b] = &mut frames;
            prop_assert_eq!(process(whole, &pair, a), WHOLE);
            prop_assert_eq!(process(near, &pair, b), if n == 0 { WHOLE } else { WINDOWS }, "frame {}", n);
            prop_assert_eq!(&a.state, &b.state);
            let [left, right] =
                [(&a.left_px, &b.left_px, &truth.left_px), (&a.right_px, &b.right_px, &truth.right_px)];
            for (whole_px, near_px, truth_px) in [left, right] {
                for ((whole_px, near_px), truth_px) in whole_px.iter().zip(near_px).zip(truth_px) {
                    prop_assert!(whole_px.distance(*near_px) <= windows.detect.centre_sigma_px);
                    prop_assert!(near_px.distance(*truth_px) < 1.0, "frame {}: a name is wrong", n);
                }
            }
        }
    }
}

/// A lattice that moved by one of its steps fills nearly all windows with the wrong markers.
#[test]
fn a_jump_by_a_step_of_the_lattice_is_noticed_in_windows() {
    let (pitch_mm, height) = (0.9, sqrt(0.75));
    for step in [[1.0, 0.0], [-1.0, 0.0], [0.5, height], [-0.5, height], [0.5, -height], [-0.5, -height]] {
        let shift_mm = step.map(|step| 1.1 * step * pitch_mm);
        let still = |time_s, shift_mm| GelKeyframe { time_s, shift_mm, rotation_rad: 0.0 };
        let rest_mm = [0.0, 0.0];
        let gel_motion = vec![still(0.0, rest_mm), still(0.1, rest_mm), still(4.0 / 30.0, shift_mm)];
        let scene = Scene { gel_motion, indenter: None, ..scene(true) };
        let mut simulator = Simulator::new(&scene, None).unwrap();
        let mut pipeline = Pipeline::new(&scene.rig, &params(Search::Windows)).unwrap();
        let (mut truth, mut frame) = (Truth::default(), Frame::default());
        let mut all = Vec::new();
        for n in 0..8 {
            simulator.moment(None, n, &mut truth);
            let pair = look(&mut simulator, &truth, n);
            all.push(process(&mut pipeline, &pair, &mut frame));
            let seen = (0..frame.state.len()).filter(|&i| frame.state[i] == MarkerState::Seen);
            let off_px = |i: usize| DVec2::distance(frame.left_px[i], truth.left_px[i]);
            let most_px = seen.map(off_px).fold(0.0, f64::max);
            assert!(most_px < 1.0, "{step:?}, frame {n}: a label is off by {most_px} px");
        }
        assert_eq!(all[1], WINDOWS, "{step:?}: {all:?}");
        assert!(all[4].iter().all(|&searched| searched == Searched::Whole), "{step:?}: {all:?}");
        assert_eq!(all[7], WINDOWS, "{step:?}: {all:?}");
    }
}
