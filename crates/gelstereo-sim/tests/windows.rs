//! Search in windows finds what the search of the whole image finds, and notices when windows will not do.
#![allow(clippy::unwrap_used)]

use gelstereo_core::image::GrayView;
use gelstereo_core::math::{DVec2, DVec3, Pose};
use gelstereo_core::params::{Background, LabelMethod, Motion, Params, Search, Threshold};
use gelstereo_core::pipeline::{Frame, Pipeline, Searched};
use gelstereo_core::track::MarkerState;
use gelstereo_sim::effects::{Defocus, SensorNoise};
use gelstereo_sim::{ContactState, Effects, GelKeyframe, Scene, Shape, Simulator, Truth};

const WINDOWS: [Searched; 2] = [Searched::Windows; 2];
const WHOLE: [Searched; 2] = [Searched::Whole; 2];

type Pair = [Vec<u8>; 2];

fn params(method: LabelMethod, search: Search) -> Params {
    let mut params = Params::preset("fast").unwrap();
    (params.detect.background, params.detect.threshold) = (Background::Blocks, Threshold::Auto);
    (params.detect.search, params.label.method) = (search, method);
    params.track.motion = Motion::ConstantVelocity;
    params
}

fn scene() -> Scene {
    let effects = Effects { sensor_noise: Some(SensorNoise::default()), ..Effects::of_gel() };
    Scene { indenter: Some(Shape::Sphere { radius_mm: 6.0 }), effects, ..Scene::default() }
}

fn presses() -> Vec<Pair> {
    let mut simulator = Simulator::new(&scene(), None).unwrap();
    let (mut truth, pose) = (Truth::default(), Pose::from_translation_mm(DVec3::new(4.0, 0.0, 40.0)));
    let presses_mm = [0.0, 0.0, 0.2, 0.4, 0.7, 1.0, 1.3, 1.0, 0.6, 0.0];
    let mut look = |(press_mm, frame)| {
        let contact = simulator.pressed(pose, press_mm).map(ContactState::pressed);
        simulator.truth(contact.filter(|_| press_mm > 0.0).as_ref(), &mut truth);
        let mut pair = Pair::default();
        let [left, right] = &mut pair;
        simulator.render(&truth, frame, left, right);
        pair
    };
    presses_mm.into_iter().zip(0..).map(&mut look).collect()
}

fn process(pipeline: &mut Pipeline, [left, right]: &Pair, frame: &mut Frame) -> [Searched; 2] {
    let view = |pixels| GrayView::new(pixels, 640, 480, 640).unwrap();
    pipeline.process(view(left), view(right), frame).unwrap();
    [frame.left.searched, frame.right.searched]
}

/// Both searches weigh the same pixels, but windows lie where markers are predicted, or where the whole
/// image's components are, and take the gel's light from their own corners: the centres then differ by a part
/// of their own standard deviation (`detect.centre_sigma_px`), never by more than it.
#[test]
fn presses_are_followed_in_windows_as_in_the_whole_image() {
    let (pairs, rig) = (presses(), Scene::default_rig());
    for method in [LabelMethod::Lattice, LabelMethod::Foresight] {
        let (whole_params, params) = (params(method, Search::Whole), params(method, Search::Windows));
        let mut whole = Pipeline::new(&rig, &whole_params).unwrap();
        let mut windows = Pipeline::new(&rig, &params).unwrap();
        let (mut a, mut b) = (Frame::default(), Frame::default());
        let mut digests = Vec::new();
        for (n, pair) in pairs.iter().enumerate() {
            assert_eq!(process(&mut whole, pair, &mut a), WHOLE);
            let searched = process(&mut windows, pair, &mut b);
            assert_eq!(searched, if n == 0 { WHOLE } else { WINDOWS }, "{method:?}, frame {n}");
            assert_eq!(a.state, b.state);
            let positions = a.left_px.iter().zip(&b.left_px).chain(a.right_px.iter().zip(&b.right_px));
            let most_px = positions.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
            assert!(most_px <= params.detect.centre_sigma_px, "{method:?}, frame {n}: {most_px} px");
            digests.push(b.digest());
        }
        // Again, and from a checkpoint in the middle: the same bits.
        let mut again = Pipeline::new(&rig, &params).unwrap();
        for (n, pair) in pairs.iter().enumerate() {
            let mut resumed = again.clone();
            process(&mut again, pair, &mut b);
            assert_eq!(b.digest(), digests[n]);
            process(&mut resumed, pair, &mut b);
            assert_eq!(b.digest(), digests[n]);
        }
    }
}

/// Dots of two pixels across: the rest frame shows all of them, not only those that come after it.
#[test]
fn the_finest_print_is_seen_whole_at_rest() {
    let noise = (Some(SensorNoise::default()), Some(Defocus::default()));
    let effects = Effects { sensor_noise: noise.0, defocus: noise.1, ..Effects::of_gel() };
    let scene = Scene { effects, ..Scene::preset("640x480-71").unwrap() };
    let mut simulator = Simulator::new(&scene, None).unwrap();
    let (mut truth, mut frame, mut pair) = (Truth::default(), Frame::default(), Pair::default());
    simulator.truth(None, &mut truth);
    let [left, right] = &mut pair;
    simulator.render(&truth, 0, left, right);
    for preset in ["fast", "balanced", "exact"] {
        let mut params = Params::preset(preset).unwrap();
        params.lattice.pitch_mm = scene.gel.pitch_mm;
        let mut pipeline = Pipeline::new(&scene.rig, &params).unwrap();
        assert_eq!(process(&mut pipeline, &pair, &mut frame), WHOLE);
        let seen = frame.state.iter().filter(|&&state| state == MarkerState::Seen).count();
        assert_eq!((seen, frame.left.detected, frame.right.detected), (5041, 5041, 5041), "{preset}");
    }
}

/// A lattice that moved by a pitch and a bit fills nearly all windows with the wrong markers.
#[test]
fn a_jump_by_more_than_a_pitch_is_noticed_in_windows() {
    let pitch_mm = 0.9;
    for step in [[1.3, 0.0], [-1.3, 0.0], [0.0, 1.0], [1.0, 0.0], [-0.6, 0.0]] {
        let shift_mm = [step[0] * pitch_mm, step[1] * pitch_mm];
        let still = |time_s, shift_mm| GelKeyframe { time_s, shift_mm, rotation_rad: 0.0 };
        let rest_mm = [0.0, 0.0];
        let gel_motion = vec![still(0.0, rest_mm), still(0.1, rest_mm), still(4.0 / 30.0, shift_mm)];
        let scene = Scene { gel_motion, ..scene() };
        let mut simulator = Simulator::new(&scene, None).unwrap();
        let mut params = params(LabelMethod::Lattice, Search::Windows);
        params.lattice.pitch_mm = scene.gel.pitch_mm;
        let mut pipeline = Pipeline::new(&scene.rig, &params).unwrap();
        let (mut truth, mut frame, mut pair) = (Truth::default(), Frame::default(), Pair::default());
        let mut all = Vec::new();
        for n in 0..9 {
            simulator.moment(None, n, &mut truth);
            let [left, right] = &mut pair;
            simulator.render(&truth, n, left, right);
            all.push(process(&mut pipeline, &pair, &mut frame));
            let seen = (0..625).filter(|&i| frame.state[i] == MarkerState::Seen);
            let most_px = seen.map(|i| frame.left_px[i].distance(truth.left_px[i])).fold(0.0, f64::max);
            assert!(most_px < 1.0, "{step:?}, frame {n}: a label is off by {most_px} px");
        }
        assert_eq!(all[1], WINDOWS, "{step:?}: {all:?}");
        // The jump itself, and what a constant velocity predicts after it.
        assert!(all[4..6].iter().flatten().all(|&searched| searched == Searched::Whole), "{step:?}: {all:?}");
        assert_eq!(all[8], WINDOWS, "{step:?}: {all:?}");
    }
}

/// Covers a marker with the brightness of the gel beside it.
fn cover(image: &mut [u8], at_px: DVec2) {
    let (x, y) = (at_px.x.round() as usize, at_px.y.round() as usize);
    let gel = image[(y + 9) * 640 + x + 9];
    for row in y - 7..=y + 7 {
        image[row * 640 + x - 7..=row * 640 + x + 7].fill(gel);
    }
}

#[test]
fn a_marker_is_lost_and_found_again_in_windows() {
    let (mut pairs, rig, marker) = (presses(), Scene::default_rig(), 12 * 25 + 12);
    let params = params(LabelMethod::Lattice, Search::Windows);
    let (mut clear, mut covered) =
        (Pipeline::new(&rig, &params).unwrap(), Pipeline::new(&rig, &params).unwrap());
    let (mut a, mut b) = (Frame::default(), Frame::default());
    for (n, pair) in pairs.iter_mut().enumerate() {
        process(&mut clear, pair, &mut a);
        let hidden = (3..6).contains(&n);
        if hidden {
            cover(&mut pair[0], a.left_px[marker]);
        }
        let searched = process(&mut covered, pair, &mut b);
        assert!(n == 0 || searched == WINDOWS, "frame {n}: {searched:?}");
        assert_eq!(b.state[marker], if hidden { MarkerState::Held } else { MarkerState::Seen }, "frame {n}");
        assert_eq!(b.state.iter().filter(|&&s| s != MarkerState::Seen).count(), usize::from(hidden));
    }
    assert_eq!(a.left_px[marker], b.left_px[marker]);
}

/// Markers 3 px wide and 7 px apart: the windows around larger ones would not fit between their neighbours.
/// Centres are as good as their covariance says, in the first frame, which is searched whole, and after it.
#[test]
fn dense_lattices_are_searched_in_windows() {
    let effects = Effects { sensor_noise: Some(SensorNoise::default()), ..Effects::of_gel() };
    let indenter = Some(Shape::Sphere { radius_mm: 6.0 });
    let scene = Scene { indenter, effects, ..Scene::preset("1280x720-71").unwrap() };
    let mut params = params(LabelMethod::Lattice, Search::Windows);
    params.lattice.pitch_mm = scene.gel.pitch_mm;
    let (mut simulator, mut pipeline) =
        (Simulator::new(&scene, None).unwrap(), Pipeline::new(&scene.rig, &params).unwrap());
    let (mut truth, mut frame) = (Truth::default(), Frame::default());
    let (mut left, mut right) = (Vec::new(), Vec::new());
    let pose = Pose::from_translation_mm(DVec3::new(4.0, 0.0, 40.0));
    for (n, press_mm) in [0.0, 0.0, 0.2, 0.4].into_iter().enumerate() {
        let contact = simulator.pressed(pose, press_mm).map(ContactState::pressed);
        simulator.truth(contact.filter(|_| press_mm > 0.0).as_ref(), &mut truth);
        simulator.render(&truth, n as u64, &mut left, &mut right);
        let view = |pixels| GrayView::new(pixels, 1280, 720, 1280).unwrap();
        pipeline.process(view(&left), view(&right), &mut frame).unwrap();
        let searched = [frame.left.searched, frame.right.searched];
        assert_eq!(searched, if n == 0 { WHOLE } else { WINDOWS }, "frame {n}");
        let seen = (0..frame.state.len()).filter(|&i| frame.state[i] == MarkerState::Seen);
        let (sum, count) = seen.fold((0.0, 0.0), |(sum, count), i| {
            let off2 = frame.left_px[i].distance_squared(truth.left_px[i]);
            (sum + off2 + frame.right_px[i].distance_squared(truth.right_px[i]), count + 2.0)
        });
        assert!(count > 1.95 * frame.state.len() as f64, "frame {n}: {count}");
        // Two coordinates, and a tenth for what the lattice's few thousand dots have in common.
        let most_px = 1.1 * f64::sqrt(2.0) * params.detect.centre_sigma_px;
        assert!((sum / count).sqrt() < most_px, "frame {n}: {} px", (sum / count).sqrt());
    }
}
