//! Sensing allocates nothing after the rest frame and the first that is tracked, whatever later frames show,
//! and holds less than 16 MB at 640 x 480.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use crate::counting;

use counting::{ALLOCATIONS, HELD, PEAK};
use gelstereo_core::image::GrayView;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{LabelMethod, Params, Saliency, Search};
use gelstereo_core::pipeline::{Frame, LabelSource, Pipeline, Searched};
use gelstereo_core::track::MarkerState;
use gelstereo_sim::effects::{Effects, SensorNoise};
use gelstereo_sim::{ContactState, Scene, Shape, Simulator, Truth};

type Pair = [Vec<u8>; 2];

/// Rest, presses up to 1.2 mm, and the last press with a third of the markers covered in the left view.
fn pairs() -> Vec<Pair> {
    let effects = Effects { sensor_noise: Some(SensorNoise::default()), ..Effects::of_gel() };
    let scene = Scene { indenter: Some(Shape::Sphere { radius_mm: 6.0 }), effects, ..Scene::default() };
    let mut simulator = Simulator::new(&scene, None).unwrap();
    let (mut truth, pose) = (Truth::default(), Pose::from_translation_mm(DVec3::new(4.0, 0.0, 40.0)));
    let mut pairs: Vec<Pair> = [0.0, 0.0, 0.4, 0.8, 1.2, 1.2]
        .into_iter()
        .zip(0..)
        .map(|(press_mm, frame)| {
            let contact = simulator.pressed(pose, press_mm).map(ContactState::pressed);
            simulator.truth(contact.filter(|_| press_mm > 0.0).as_ref(), &mut truth);
            let mut pair = Pair::default();
            let [left, right] = &mut pair;
            simulator.render(&truth, frame, left, right);
            pair
        })
        .collect();
    let covered = &mut pairs[5][0][..640 * 200];
    covered.fill(170);
    pairs
}

fn view(pixels: &[u8]) -> GrayView<'_> {
    GrayView::new(pixels, 640, 480, 640).unwrap()
}

fn process(pipeline: &mut Pipeline, [left, right]: &Pair, frame: &mut Frame) {
    pipeline.process(view(left), view(right), frame).unwrap();
}

#[test]
fn row_35_sensing_allocates_nothing_after_the_first_frames() {
    let (pairs, rig) = (pairs(), Scene::default_rig());
    for (preset, search) in
        [("paper", Search::Whole), ("balanced", Search::Whole), ("balanced", Search::Windows)]
    {
        for method in [LabelMethod::Foresight, LabelMethod::Lattice] {
            let mut params = Params::preset(preset).unwrap();
            (params.label.method, params.detect.search) = (method, search);
            match (preset, method) {
                ("paper", LabelMethod::Foresight) => params.contact.saliency = Saliency::Pressure,
                (_, LabelMethod::Foresight) => params.contact.saliency = Saliency::Adaptive,
                (_, LabelMethod::Lattice) => {}
            }
            let held_before = HELD.get();
            PEAK.set(held_before);
            let mut pipeline = Pipeline::new(&rig, &params).unwrap();
            let mut frame = Frame::default();
            // The first frame fits the lattice, the second tracks and sorts for the first time.
            process(&mut pipeline, &pairs[0], &mut frame);
            process(&mut pipeline, &pairs[1], &mut frame);
            let before = ALLOCATIONS.get();
            assert!(before > 0, "the counter counts");
            let (mut held, mut lost, mut sorted, mut windows) = (0, 0, 0, 0);
            // Covered long enough that held markers are given up, then seen again, several times over.
            let order = (2..6).chain([5; 40]).chain(0..5).cycle().take(150);
            for pair in order.map(|k| &pairs[k]) {
                process(&mut pipeline, pair, &mut frame);
                let count = |state| frame.state.iter().filter(|&&s| s == state).count();
                held += count(MarkerState::Held);
                lost += count(MarkerState::Lost);
                sorted += usize::from(frame.left.labels == LabelSource::Foresight);
                windows += usize::from(frame.left.searched == Searched::Windows);
            }
            assert_eq!(ALLOCATIONS.get() - before, 0, "{preset} {method:?}");
            let bytes = (PEAK.get() - held_before) as usize;
            println!("{preset} {method:?}: {bytes} bytes");
            assert!(bytes < 16_000_000, "{preset} {method:?}: {bytes} bytes");
            assert!(held > 1000 && lost > 1000, "{preset}: {held} held, {lost} lost");
            assert_eq!(windows > 0, search == Search::Windows);
            assert_eq!(sorted > 0, method == LabelMethod::Foresight);
        }
    }
}
