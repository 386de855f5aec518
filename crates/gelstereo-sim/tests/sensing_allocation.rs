//! Sensing allocates nothing after the rest frame and the first that is tracked, whatever later frames show,
//! and holds less than 16 MB at 640 x 480.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use crate::counting;

use counting::{ALLOCATIONS, HELD, PEAK};
use gelstereo_core::image::GrayView;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{ForceMethod, ForceParams, LabelMethod, Params, Saliency, Search, SlipMethod};
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

fn with_known_gel() -> ForceParams {
    ForceParams { thickness_mm: Some(5.0), young_kpa: Some(100.0), ..ForceParams::default() }
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
                (_, LabelMethod::Lattice) => {
                    let method = ForceMethod::Bounded;
                    params.force = ForceParams { method, ..with_known_gel() };
                    params.slip.method = SlipMethod::Rigid;
                }
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

/// Whichever rungs the limits leave, also those of the first limited frame.
#[test]
fn limits_of_work_allocate_nothing_after_the_first_frames() {
    let (pairs, rig) = (pairs(), Scene::default_rig());
    for preset in ["balanced", "exact"] {
        let held_before = HELD.get();
        PEAK.set(held_before);
        let mut pipeline = Pipeline::new(&rig, &Params::preset(preset).unwrap()).unwrap();
        let mut frame = Frame::default();
        let mut within = |pair: &Pair, limit: u64| {
            let [left, right] = pair;
            pipeline.process_within(view(left), view(right), Some(limit), &mut frame).unwrap();
            (frame.left.searched, frame.left.is_degraded, frame.left.labels == LabelSource::Held)
        };
        within(&pairs[0], u64::MAX);
        within(&pairs[1], u64::MAX);
        let before = ALLOCATIONS.get();
        let mut seen = std::collections::BTreeMap::new();
        let made = ALLOCATIONS.get();
        let limits = [0, u64::MAX, 12_000, 40_000];
        let mut ways = [(Searched::Whole, false, false); 120];
        for (n, way) in ways.iter_mut().enumerate() {
            *way = within(&pairs[[2, 3, 4, 5, 4, 3][n % 6]], limits[n % 4]);
        }
        assert_eq!(ALLOCATIONS.get() - made, 0, "{preset}");
        assert!(before > 0, "the counter counts");
        for (searched, degraded, held) in ways {
            *seen.entry((searched as u8, degraded, held)).or_insert(0) += 1;
        }
        let bytes = (PEAK.get() - held_before) as usize;
        println!("{preset}: {bytes} bytes, {seen:?}");
        assert!(bytes < 16_000_000 && seen.len() >= 4, "{preset}: {bytes} bytes, {seen:?}");
    }
}
