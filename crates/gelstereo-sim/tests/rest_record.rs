//! A pipeline that resumes from a recorded rest frame, on simulated frames (sensor noise 2 grey levels).
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{press, simulator};
use gelstereo_core::image::GrayView;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::params::{Centre, LabelMethod, Params, Search, TriangulateMethod};
use gelstereo_core::pipeline::{
    Frame, LabelSource, Pipeline, PipelineError, RestRecord, RestRecordError, Searched,
};
use gelstereo_core::track::MarkerState;
use gelstereo_sim::effects::{Defocus, Effects, SensorNoise};
use gelstereo_sim::{ContactState, Scene, Shape, Truth};
use proptest::prelude::*;

fn scene(shape: Shape) -> Scene {
    let effects = Effects {
        defocus: Some(Defocus::default()),
        sensor_noise: Some(SensorNoise::default()),
        ..Effects::of_gel()
    };
    Scene { indenter: Some(shape), effects, ..Scene::default() }
}

fn ball() -> Scene {
    scene(Shape::Sphere { radius_mm: 6.0 })
}

fn look(scene: &Scene, contact: Option<&ContactState>, n: u64, truth: &mut Truth) -> [Vec<u8>; 2] {
    let mut simulator = simulator(scene);
    simulator.truth(contact, truth);
    let (mut left, mut right) = (Vec::new(), Vec::new());
    simulator.render(truth, n, &mut left, &mut right);
    [left, right]
}

fn process(pipeline: &mut Pipeline, scene: &Scene, [left, right]: &[Vec<u8>; 2], frame: &mut Frame) {
    let (width, height) = (scene.rig.left.width_px, scene.rig.left.height_px);
    let view = |pixels| GrayView::new(pixels, width, height, width).unwrap();
    pipeline.process(view(left), view(right), frame).unwrap();
}

/// A pipeline that has seen the rest frame.
fn rested(scene: &Scene, params: &Params) -> Pipeline {
    let (mut pipeline, mut frame) = (Pipeline::new(&scene.rig, params).unwrap(), Frame::default());
    assert!(pipeline.rest_record().is_none());
    process(&mut pipeline, scene, &look(scene, None, 0, &mut Truth::default()), &mut frame);
    pipeline
}

fn resumed(scene: &Scene, params: &Params, record: &RestRecord) -> Pipeline {
    let mut pipeline = Pipeline::new(&scene.rig, params).unwrap();
    pipeline.resume(record).unwrap();
    pipeline
}

/// Seen markers whose position is not where the truth has that label.
fn mislabelled(frame: &Frame, truth: &Truth, most_px: f64) -> usize {
    let off = |i: usize| {
        let (l, r) = (frame.left_px[i] - truth.left_px[i], frame.right_px[i] - truth.right_px[i]);
        l.length().max(r.length()) > most_px
    };
    (0..frame.state.len()).filter(|&i| frame.state[i] == MarkerState::Seen && off(i)).count()
}

/// Every preset and every way to label: the same frame after the record as after the rest frame itself, bit
/// for bit where the tracks do not depend on how the frame before was labelled.
#[test]
fn a_first_frame_under_a_press_is_measured_as_after_a_rest_frame() {
    let scene = ball();
    let contact = press(&scene, DVec3::ZERO, DVec2::ZERO, 1.5);
    let (mut truth, mut a, mut b) = (Truth::default(), Frame::default(), Frame::default());
    for preset in Params::PRESETS {
        for method in [LabelMethod::Lattice, LabelMethod::Foresight] {
            let mut params = Params::preset(preset).unwrap();
            params.label.method = method;
            // Where windows lie depends on the frame before, and centres on that by a part of their noise.
            params.detect.search = Search::Whole;
            // The map's fit takes the first frames; points are exact until then, 1 um from the map's at most.
            if params.triangulate.method == TriangulateMethod::Polynomial {
                params.triangulate.method = TriangulateMethod::Rays;
            }
            let mut ongoing = rested(&scene, &params);
            let record = ongoing.rest_record().unwrap();
            let mut begins = resumed(&scene, &params, &record);
            assert_eq!(begins.rest(), ongoing.rest());
            // In steps, so that the ongoing pipeline's tracks need no gap.
            for (n, press_mm) in (1..).zip([0.4, 0.8, 1.2, 1.5]) {
                let step = press(&scene, DVec3::ZERO, DVec2::ZERO, press_mm);
                process(&mut ongoing, &scene, &look(&scene, Some(&step), n, &mut truth), &mut a);
            }
            let images = look(&scene, Some(&contact), 4, &mut truth);
            process(&mut begins, &scene, &images, &mut b);
            assert_eq!([b.left.labels, b.right.labels], [LabelSource::Lattice; 2], "{preset} {method:?}");
            assert_eq!((b.index, b.rows, b.cols), (1, 25, 25));
            assert_eq!(mislabelled(&b, &truth, 2.0), 0, "{preset} {method:?}");
            assert_eq!(b.state, a.state, "{preset} {method:?}");
            assert_eq!((&b.left_px, &b.right_px), (&a.left_px, &a.right_px), "{preset} {method:?}");
            assert_eq!(b.indentation_mm, a.indentation_mm, "{preset} {method:?}");
            assert_eq!((&b.salient, &b.patch), (&a.salient, &a.patch), "{preset} {method:?}");
            // What follows is followed.
            for n in 5..7 {
                let images = look(&scene, Some(&contact), n, &mut truth);
                process(&mut ongoing, &scene, &images, &mut a);
                process(&mut begins, &scene, &images, &mut b);
                assert_eq!((&a.points_mm, a.left.labels), (&b.points_mm, b.left.labels));
            }
            assert_eq!(begins.rest_record().unwrap(), record, "a record of a record is the same");
        }
    }
}

#[test]
fn markers_that_were_never_printed_stay_held() {
    let mut scene = ball();
    scene.gel.missing = vec![[0, 0], [12, 7]];
    let params = Params::preset("balanced").unwrap();
    let record = rested(&scene, &params).rest_record().unwrap();
    assert!(!record.left.shown[0] && !record.right.shown[12 * 25 + 7] && record.left.shown[1]);
    let (mut truth, mut frame) = (Truth::default(), Frame::default());
    let contact = press(&scene, DVec3::ZERO, DVec2::ZERO, 1.5);
    let images = look(&scene, Some(&contact), 3, &mut truth);
    let mut pipeline = resumed(&scene, &params, &record);
    // Longer than a marker that was hidden is held.
    for _ in 0..2 * params.track.max_held_frames {
        process(&mut pipeline, &scene, &images, &mut frame);
        assert_eq!(mislabelled(&frame, &truth, 2.0), 0);
        let state = |state| (0..625).filter(|&i| frame.state[i] == state).collect::<Vec<_>>();
        assert_eq!((state(MarkerState::Held), state(MarkerState::Lost)), (vec![0, 12 * 25 + 7], vec![]));
    }
}

/// A gel that was put back a pitch off, or turned by a quarter: what the record says of the print tells.
#[test]
fn a_gel_that_was_moved_keeps_its_labels_or_is_held() {
    let mut scene = ball();
    scene.gel.missing = vec![[0, 0], [12, 7]];
    let mut params = Params::preset("balanced").unwrap();
    params.lattice.missing.clone_from(&scene.gel.missing);
    let record = rested(&scene, &params).rest_record().unwrap();
    let (mut truth, mut frame) = (Truth::default(), Frame::default());
    for (shift_mm, turns, certain) in [
        ([0.0; 2], 0, true),
        ([0.9, 0.0], 0, true),
        ([0.0, -0.9], 0, true),
        ([0.0; 2], 1, false),
        ([0.0; 2], 2, false),
    ] {
        let mut moved = scene.clone();
        moved.gel.centre_mm = [4.0 + shift_mm[0], shift_mm[1]];
        moved.gel.rotation_rad = f64::from(turns) * core::f64::consts::FRAC_PI_2;
        let images = look(&moved, None, 7, &mut truth);
        let mut pipeline = resumed(&scene, &params, &record);
        for _ in 0..3 {
            process(&mut pipeline, &scene, &images, &mut frame);
            let found = frame.left.labels == LabelSource::Lattice;
            assert_eq!(
                (found, mislabelled(&frame, &truth, 2.0)),
                (certain, 0),
                "{shift_mm:?}, {turns} turns"
            );
        }
    }
}

#[test]
fn windows_are_searched_from_the_second_frame_on() {
    let scene = ball();
    let mut params = Params::preset("balanced").unwrap();
    let record = rested(&scene, &params).rest_record().unwrap();
    params.detect.search = Search::Windows;
    let mut pipeline = resumed(&scene, &params, &record);
    let (mut truth, mut frame) = (Truth::default(), Frame::default());
    let contact = press(&scene, DVec3::ZERO, DVec2::ZERO, 1.0);
    let searched = [5, 6].map(|n| {
        let images = look(&scene, Some(&contact), n, &mut truth);
        process(&mut pipeline, &scene, &images, &mut frame);
        [frame.left.searched, frame.right.searched]
    });
    assert_eq!(searched, [[Searched::Whole; 2], [Searched::Windows; 2]]);
}

/// A gel that shows none of the record's lattice is held, and found as soon as it is back.
#[test]
fn what_is_not_certain_is_held_until_it_is() {
    let scene = ball();
    let params = Params::preset("balanced").unwrap();
    let record = rested(&scene, &params).rest_record().unwrap();
    let mut pipeline = resumed(&scene, &params, &record);
    let (mut truth, mut frame) = (Truth::default(), Frame::default());
    let mut images = look(&scene, None, 8, &mut truth);
    for image in &mut images {
        // All but a strip in the middle of the lattice, whose border tells nothing.
        image[..640 * 200].fill(170);
        image[640 * 260..].fill(170);
    }
    process(&mut pipeline, &scene, &images, &mut frame);
    assert_eq!([frame.left.labels, frame.right.labels], [LabelSource::Held; 2]);
    assert!(frame.state.iter().all(|&s| s != MarkerState::Seen) && !frame.salient.contains(&true));
    // From the same centres, by the map that is good to a micrometre.
    let off_mm = frame.points_mm.iter().zip(&record.points_mm).map(|(a, b)| a.distance(*b));
    assert!(off_mm.fold(0.0, f64::max) < 2e-3);
    process(&mut pipeline, &scene, &look(&scene, None, 9, &mut truth), &mut frame);
    assert_eq!(mislabelled(&frame, &truth, 2.0), 0);
    assert!(frame.state.iter().all(|&s| s == MarkerState::Seen));
}

#[test]
fn a_record_survives_toml_bit_for_bit() {
    let scene = ball();
    let record = rested(&scene, &Params::preset("exact").unwrap()).rest_record().unwrap();
    let text = toml::to_string(&record).unwrap();
    assert_eq!(toml::from_str::<RestRecord>(&text).unwrap(), record);
}

#[test]
fn records_that_are_damaged_or_of_another_sensor_are_refused_by_name() {
    let scene = ball();
    let params = Params::preset("balanced").unwrap();
    let good = rested(&scene, &params).rest_record().unwrap();
    let refusal = |params: &Params, change: &dyn Fn(&mut RestRecord)| {
        let mut record = good.clone();
        change(&mut record);
        let mut pipeline = Pipeline::new(&scene.rig, params).unwrap();
        let error = pipeline.resume(&record).unwrap_err();
        // As before: the next frame is the rest frame.
        assert!(pipeline.rest().is_none() && pipeline.rest_record().is_none());
        match error {
            PipelineError::Record(error) => error,
            error => panic!("{error}"),
        }
    };
    let length = |list, found| RestRecordError::Length { list, found, expected: 625 };
    let same = |change: &dyn Fn(&mut RestRecord)| refusal(&params, change);
    assert_eq!(same(&|r| r.points_mm.truncate(600)), length("points_mm", 600));
    assert_eq!(same(&|r| r.right.shown.clear()), length("right.shown", 0));
    let value = |list, index| RestRecordError::Value { list, index };
    assert_eq!(same(&|r| r.left.positions_px[7].y = f64::NAN), value("left.positions_px", 7));
    assert_eq!(same(&|r| r.variance_mm2[3] = -1.0), value("variance_mm2", 3));
    assert_eq!(same(&|r| (r.rows, r.cols) = (2, 312)), RestRecordError::Lattice { rows: 2, cols: 312 });
    assert_eq!(
        same(&|r| (r.rows, r.cols) = (usize::MAX, 3)),
        RestRecordError::Lattice { rows: usize::MAX, cols: 3 }
    );
    assert!(matches!(same(&|r| r.right.pitch_px = 0.0), RestRecordError::Pitch { .. }));
    assert_eq!(same(&|r| r.rig.left.fx_px += 1e-9), RestRecordError::Rig);
    let mut other = params.clone();
    other.detect.centre = Centre::Binary;
    assert_eq!(refusal(&other, &|_| ()), RestRecordError::Settings { table: "detect" });
    let mut other = params.clone();
    other.lattice.cols = Some(24);
    assert_eq!(refusal(&other, &|_| ()), RestRecordError::Settings { table: "lattice" });
    let flat = same_points_are_no_surface(&scene, &params, &good);
    assert!(matches!(flat, PipelineError::Contact(_)), "{flat}");
}

fn same_points_are_no_surface(scene: &Scene, params: &Params, good: &RestRecord) -> PipelineError {
    let mut record = good.clone();
    record.points_mm.fill(DVec3::ONE);
    Pipeline::new(&scene.rig, params).unwrap().resume(&record).unwrap_err()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever presses, shears or turns the gel in the first frame: labels are right or not claimed.
    #[test]
    fn a_first_frame_is_labelled_right_or_held(
        shape in 0_usize..3, press_mm in 0.2..1.5, x in -3.0..3.0, y in -3.0..3.0, tilt in -0.15..0.15,
        shear in prop::array::uniform2(-1.0..1.0), twist_rad in -0.3..0.3, lattice in 0_usize..2,
        seed in 0_u64..1000,
    ) {
        let shapes = [
            Shape::Sphere { radius_mm: 5.0 },
            Shape::Cylinder { radius_mm: 3.0, length_mm: 6.0 },
            Shape::Box { size_mm: [7.0, 5.0, 5.0] },
        ];
        let base = Scene::preset(["640x480-25", "640x480-45"][lattice]).unwrap();
        let scene = Scene { seed, rig: base.rig, gel: base.gel, ..scene(shapes[shape].clone()) };
        let params = Params::preset("balanced").unwrap();
        let record = rested(&scene, &params).rest_record().unwrap();
        let mut contact = press(&scene, DVec3::new(tilt, 0.0, 0.0), DVec2::new(x, y), press_mm);
        (contact.shear_mm, contact.twist_rad) = (shear, twist_rad);
        let (mut truth, mut frame) = (Truth::default(), Frame::default());
        let images = look(&scene, Some(&contact), 1, &mut truth);
        process(&mut resumed(&scene, &params, &record), &scene, &images, &mut frame);
        // A third of a pitch: a wrong label is half a pitch off or more.
        prop_assert_eq!(mislabelled(&frame, &truth, record.left.pitch_px / 3.0), 0);
        let seen = frame.state.iter().filter(|&&s| s == MarkerState::Seen).count();
        // Held as a whole or nearly complete: a fold or a torn rim may hide some.
        let certain = [frame.left.labels, frame.right.labels] == [LabelSource::Lattice; 2];
        prop_assert_eq!(seen > 0, certain);
        // Heights to six standard deviations of both frames' noise, or of the least that a grey centroid
        // allows.
        for i in (0..frame.state.len()).filter(|&i| frame.state[i] == MarkerState::Seen) {
            let sigma_mm = (2.0 * record.variance_mm2[i]).sqrt();
            prop_assert!(
                (frame.indentation_mm[i] - truth.indentation_mm[i]).abs() < 6.0 * sigma_mm.max(0.02)
            );
        }
    }
}
