//! The whole sensing pipeline on simulated stereo frames with known truth (sensor noise 2 grey levels).

use gelstereo_core::digest::Digest;
use gelstereo_core::image::GrayView;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{LabelMethod, Motion, Params, Saliency, Search};
use gelstereo_core::pipeline::{Frame, LabelSource, Pipeline, PipelineError, View};
use gelstereo_core::track::MarkerState;
use gelstereo_core::triangulate::{TriangulateError, Triangulator};
use gelstereo_sim::effects::{Defocus, Effects, SensorNoise};
use gelstereo_sim::{ContactState, Scene, Shape, Simulator, Truth};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

fn scene(missing: Vec<[usize; 2]>) -> Scene {
    let mut scene = Scene { indenter: Some(Shape::Sphere { radius_mm: 6.0 }), ..Scene::default() };
    scene.effects = Effects {
        defocus: Some(Defocus::default()),
        sensor_noise: Some(SensorNoise::default()),
        ..Effects::of_gel()
    };
    scene.gel.missing = missing;
    scene
}

/// A simulated sensor with its images and truth.
struct Sensor {
    simulator: Simulator,
    truth: Truth,
    left: Vec<u8>,
    right: Vec<u8>,
    frame: u64,
}

impl Sensor {
    fn new(scene: &Scene) -> Self {
        let simulator = Simulator::new(scene, None).unwrap();
        Self { simulator, truth: Truth::default(), left: vec![], right: vec![], frame: 0 }
    }

    /// The ball pressed so deep, in the gel's middle; 0 takes it away.
    fn look(&mut self, press_mm: f64) {
        let pose = Pose::from_translation_mm(DVec3::new(4.0, 0.0, 40.0));
        let contact = self.simulator.pressed(pose, press_mm).map(ContactState::pressed);
        self.simulator.truth(contact.filter(|_| press_mm > 0.0).as_ref(), &mut self.truth);
        self.simulator.render(&self.truth, self.frame, &mut self.left, &mut self.right);
        self.frame += 1;
    }

    fn views(&self) -> (GrayView<'_>, GrayView<'_>) {
        (view(&self.left), view(&self.right))
    }
}

fn view(pixels: &[u8]) -> GrayView<'_> {
    GrayView::new(pixels, WIDTH, HEIGHT, WIDTH).unwrap()
}

const PRESSES_MM: [f64; 8] = [0.0, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2];

/// Every frame's digest, and the last frame.
fn run(scene: &Scene, params: &Params, threads: bool) -> (Vec<u64>, Frame, Truth) {
    let mut sensor = Sensor::new(scene);
    let mut pipeline = Pipeline::new(&scene.rig, params).unwrap();
    let mut frame = Frame::default();
    let mut digests = Vec::new();
    for press_mm in PRESSES_MM {
        sensor.look(press_mm);
        let (left, right) = sensor.views();
        let result = if threads {
            pipeline.process_with(left, right, None, &mut frame, |a, b| {
                std::thread::scope(|scope| {
                    scope.spawn(a);
                    b();
                });
            })
        } else {
            pipeline.process(left, right, &mut frame)
        };
        result.unwrap();
        digests.push(frame.digest());
    }
    (digests, frame, sensor.truth)
}

/// Depths agree with the truth to what the centres allow.
///
/// The binary centroid errs by 0.126 px rms in 2-D, 0.09 px per axis and view, the grey one by 0.06 px and
/// the fit by 0.035 px in 2-D (docs/accuracy-vs-time.md). Disparity then errs by sqrt(2) of that and depth by
/// Z² / (f B) = 0.184 mm per pixel of it, as does the rest surface that is subtracted: sqrt(2) once more.
#[test]
fn a_press_is_measured_to_what_the_centres_allow() {
    for (preset, centre_sigma_px) in [("paper", 0.09), ("balanced", 0.04), ("exact", 0.025)] {
        let mut params = Params::preset(preset).unwrap();
        params.contact.saliency = Saliency::Depth;
        let (_, frame, truth) = run(&scene(vec![]), &params, false);
        assert!(frame.state.iter().all(|&s| s == MarkerState::Seen), "{preset}");
        let errors =
            frame.indentation_mm.iter().zip(&truth.indentation_mm).map(|(found, true_)| found - true_);
        let rms = (errors.map(|e| e * e).sum::<f64>() / 625.0).sqrt();
        let bound = 2.0 * 0.184 * centre_sigma_px;
        assert!(rms < bound, "{preset}: {rms} mm rms, bound {bound}");
        // Saliency agrees but for markers within four standard deviations of the threshold.
        for (i, &salient) in frame.salient.iter().enumerate() {
            let margin = truth.indentation_mm[i] - 0.35;
            assert!(
                margin.abs() < 4.0 * bound || salient == (margin > 0.0),
                "{preset}: marker {i}, {margin}"
            );
        }
        assert!(frame.salient.iter().filter(|&&s| s).count() > 40);
    }
}

/// From images: the ball's contact is found by pressure, with few wrong markers at its rim, where depth takes
/// the shoulder.
#[test]
fn pressure_finds_the_contact_in_images() {
    let mut params = Params::preset("balanced").unwrap();
    let wrong = |params: &Params| {
        let (_, frame, truth) = run(&scene(vec![]), params, false);
        frame.salient.iter().zip(&truth.in_contact).filter(|(found, truly)| found != truly).count()
    };
    let by_pressure = wrong(&params);
    params.contact.saliency = Saliency::Depth;
    let by_depth = wrong(&params);
    println!("wrong of 625: {by_depth} by depth, {by_pressure} by pressure");
    // A circle of 2.5 mm crosses 17 markers' cells.
    assert!(by_pressure <= 4 && by_depth > 20, "{by_depth} by depth, {by_pressure} by pressure");
}

#[test]
fn row_16_one_missing_corner_marker_is_filled_in_and_held() {
    let (_, frame, truth) = run(&scene(vec![[0, 0]]), &Params::default(), false);
    for (i, &state) in frame.state.iter().enumerate() {
        let expected = if i == 0 { MarkerState::Held } else { MarkerState::Seen };
        assert_eq!(state, expected, "marker {i}");
        // Right labels: less than a quarter pitch (17.6 px) from the truth.
        assert!((frame.left_px[i] - truth.left_px[i]).length() < 4.4, "marker {i}");
        assert!((frame.right_px[i] - truth.right_px[i]).length() < 4.4, "marker {i}");
    }
    assert!(!frame.salient[0]);
}

#[test]
fn row_34_one_thread_or_two_and_any_repeat_give_the_same_bits() {
    for preset in Params::PRESETS {
        let (scene, params) = (scene(vec![[0, 0], [12, 7]]), Params::preset(preset).unwrap());
        let (once, ..) = run(&scene, &params, false);
        assert_eq!(once, run(&scene, &params, false).0, "{preset}: repeat");
        assert_eq!(once, run(&scene, &params, true).0, "{preset}: two threads");
        let mut other = scene;
        other.seed += 1;
        assert_ne!(once, run(&other, &params, false).0, "{preset}: the digest must see another noise");
    }
}

/// A change of one bit anywhere from the scene to the points shows here. When results are meant to change,
/// take over the digests that the failure prints, and say in the commit what changed them. Debug and release
/// builds, and every x86-64 and aarch64, must give the same.
#[test]
fn row_34_the_bits_of_a_fixed_scene_are_known() {
    let known = [
        ("paper", 0x0763_b58a_8043_a909),
        ("fast", 0x25db_d52b_e802_480f),
        ("balanced", 0x7301_3fbf_d184_425c),
        ("exact", 0xebe7_21c0_734a_5309),
    ];
    assert_eq!(known.map(|(preset, _)| preset), Params::PRESETS, "every preset has its digest");
    let found = known.map(|(preset, _)| {
        let (digests, ..) = run(&scene(vec![[0, 0]]), &Params::preset(preset).unwrap(), false);
        (preset, digests.into_iter().fold(Digest::new(), Digest::u64).value())
    });
    assert!(found == known, "found {found:#018x?}; known {known:#018x?}");
}

#[test]
fn row_34_reset_and_another_past_change_no_bit() {
    let scene = scene(vec![]);
    for preset in Params::PRESETS {
        let params = Params::preset(preset).unwrap();
        let (expected, ..) = run(&scene, &params, false);
        let mut pipeline = Pipeline::new(&scene.rig, &params).unwrap();
        let mut frame = Frame::default();
        let mut other = Sensor::new(&Scene { seed: scene.seed + 7, ..scene.clone() });
        for press_mm in [0.0, 1.0, 0.3] {
            other.look(press_mm);
            let (left, right) = other.views();
            pipeline.process(left, right, &mut frame).unwrap();
        }
        pipeline.mark_reference();
        for _ in 0..2 {
            pipeline.reset();
            let mut sensor = Sensor::new(&scene);
            for (press_mm, &digest) in PRESSES_MM.into_iter().zip(&expected) {
                sensor.look(press_mm);
                let (left, right) = sensor.views();
                pipeline.process(left, right, &mut frame).unwrap();
                assert_eq!(frame.digest(), digest, "{preset}, {press_mm} mm");
            }
        }
    }
}

#[test]
fn a_frame_that_fails_leaves_the_tracks_alone() {
    let scene = scene(vec![]);
    let params = Params::default();
    let (expected, ..) = run(&scene, &params, false);
    let mut sensor = Sensor::new(&scene);
    let mut pipeline = Pipeline::new(&scene.rig, &params).unwrap();
    let mut frame = Frame::default();
    let black = vec![0; WIDTH * HEIGHT];
    for (&press_mm, &digest) in PRESSES_MM.iter().zip(&expected) {
        sensor.look(press_mm);
        let (left, right) = sensor.views();
        let failed = pipeline.process(left, view(&black), &mut frame);
        assert!(matches!(failed, Err(PipelineError::Detect { view: View::Right, .. })), "{failed:?}");
        pipeline.process(left, right, &mut frame).unwrap();
        assert_eq!(frame.digest(), digest);
    }
}

#[test]
fn row_17_swapped_views_are_refused_by_name() {
    let scene = scene(vec![]);
    let mut sensor = Sensor::new(&scene);
    sensor.look(0.0);
    let (left, right) = sensor.views();
    let mut pipeline = Pipeline::new(&scene.rig, &Params::default()).unwrap();
    let error = pipeline.process(right, left, &mut Frame::default()).unwrap_err();
    assert!(matches!(error, PipelineError::Triangulate(TriangulateError::Disparity { .. })), "{error:?}");
    assert!(error.to_string().contains("swapped"), "{error}");
}

#[test]
fn motion_is_measured_from_the_reference() {
    let scene = scene(vec![]);
    let mut sensor = Sensor::new(&scene);
    let mut pipeline = Pipeline::new(&scene.rig, &Params::preset("balanced").unwrap()).unwrap();
    let mut frame = Frame::default();
    let mut motion = |sensor: &mut Sensor, pipeline: &mut Pipeline, press_mm: f64| {
        sensor.look(press_mm);
        let (left, right) = sensor.views();
        pipeline.process(left, right, &mut frame).unwrap();
        frame.motion_px
    };
    assert_eq!(motion(&mut sensor, &mut pipeline, 0.0), 0.0);
    let pressed = motion(&mut sensor, &mut pipeline, 0.3);
    pipeline.mark_reference();
    let still = motion(&mut sensor, &mut pipeline, 0.3);
    // Noise alone: the mean length of a difference of two centres that err by 0.05 px (2-D) is about as
    // large.
    assert!(still < 0.1 && pressed > 3.0 * still, "{pressed} {still}");
}

#[test]
fn images_of_another_size_and_settings_that_make_no_sense_are_refused() {
    let rig = Scene::default_rig();
    let mut pipeline = Pipeline::new(&rig, &Params::default()).unwrap();
    let small = vec![0; 100];
    let small = GrayView::new(&small, 10, 10, 10).unwrap();
    let error = pipeline.process(small, small, &mut Frame::default()).unwrap_err().to_string();
    assert!(error.contains("10 x 10") && error.contains("640 x 480"), "{error}");
    let mut params = Params::default();
    params.track.gate_pitches = f64::NAN;
    let error = Pipeline::new(&rig, &params).unwrap_err().to_string();
    assert!(error.contains("track.gate_pitches is NaN"), "{error}");
    assert!(Triangulator::new(&rig, &params.triangulate).is_ok());
    let (_, frame, _) = run(&scene(vec![]), &Params::default(), false);
    assert_eq!(frame.left.labels, LabelSource::Foresight);
}

/// Checked tracks give what unchecked ones give, bit for bit, where nothing goes wrong, and say that they are
/// certain.
#[test]
fn checked_tracks_agree_with_unchecked_ones() {
    let mut params = Params::preset("balanced").unwrap();
    // Windows lie where markers are predicted, and each tracker predicts in its own way.
    params.detect.search = Search::Whole;
    params.label.method = LabelMethod::Foresight;
    let (_, unchecked, truth) = run(&scene(vec![[0, 0]]), &params, false);
    params.label.method = LabelMethod::Lattice;
    for motion in [Motion::Still, Motion::ConstantVelocity] {
        params.track.motion = motion;
        let (_, checked, _) = run(&scene(vec![[0, 0]]), &params, false);
        assert_eq!([checked.left.labels, checked.right.labels], [LabelSource::Lattice; 2]);
        assert_eq!(checked.state, unchecked.state);
        assert_eq!(checked.left_px[1..], unchecked.left_px[1..]);
        assert_eq!(checked.right_px[1..], unchecked.right_px[1..]);
        // The marker that was never printed is carried where its neighbours say.
        assert!(checked.left_px[0].distance(truth.left_px[0]) < 1.0);
    }
}
