//! The decay length told from presses of parts of any shape. The simulator's gel obeys the law that is
//! fitted: these figures show what noise and a wrong first guess do, not what a real gel does.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use gelstereo_core::contact::{Decay, DecayFit, Pressure, RestSurface};
use gelstereo_core::image::GrayView;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{ContactParams, Params, Saliency, Search};
use gelstereo_core::pipeline::{Frame, Pipeline};
use gelstereo_core::track::MarkerState;
use gelstereo_sim::effects::{Defocus, Effects, SensorNoise};
use gelstereo_sim::{ContactState, Scene, Shape, Simulator, Truth};
use std::f64::consts::{FRAC_PI_2, PI};

/// The simulator's, half of the gel's thickness.
const DECAY_MM: f64 = 2.5;
const SEEN: [MarkerState; 625] = [MarkerState::Seen; 625];

/// True heights of presses to four depths, each at another place.
fn heights_mm(shape: &Shape, turn: DVec3) -> (RestSurface, Vec<Vec<f64>>) {
    let scene = Scene { indenter: Some(shape.clone()), effects: Effects::of_gel(), ..Scene::default() };
    let mut simulator = Simulator::new(&scene, None).unwrap();
    let mut truth = Truth::default();
    simulator.truth(None, &mut truth);
    let rest = RestSurface::new(&truth.points_mm).unwrap();
    let presses = [0.6, 1.0, 1.4, 1.8].into_iter().enumerate().map(|(k, depth_mm)| {
        let at = DVec3::new(2.7 + 0.9 * k as f64, 1.5 - k as f64, 40.0);
        let above = Pose { translation_mm: at, ..Pose::exp(turn, DVec3::ZERO) };
        let contact = ContactState::pressed(simulator.pressed(above, depth_mm).unwrap());
        simulator.truth(Some(&contact), &mut truth);
        truth.indentation_mm.clone()
    });
    let presses = presses.collect();
    (rest, presses)
}

/// From these heights with noise, beginning with this length, and once more with the length that was found.
fn fit(rest: &RestSurface, presses: &[Vec<f64>], start_mm: f64, sigma_mm: f64, random: &mut Stream) -> Decay {
    let noisy: Vec<Vec<f64>> =
        presses.iter().map(|h| h.iter().map(|h| h + sigma_mm * random.normal()).collect()).collect();
    let mut decay_mm = start_mm;
    let mut found = None;
    for _ in 0..2 {
        let mut pressure = Pressure::new(rest, 25, 25, decay_mm).unwrap();
        let (mut fit, mut salient) = (DecayFit::default(), Vec::new());
        for heights in &noisy {
            let variances = std::iter::repeat_n(sigma_mm * sigma_mm, 625);
            pressure.run(heights, variances, &SEEN, &mut salient).unwrap();
            fit.add(&pressure, heights, &SEEN, &salient);
        }
        found = fit.decay();
        decay_mm = found.unwrap().decay_mm;
    }
    found.unwrap()
}

fn parts() -> [(&'static str, Shape, DVec3); 4] {
    let board = Shape::Board { size_mm: [30.0, 30.0], block_mm: [8.0, 8.0], protrusion_mm: 4.0 };
    let cylinder = Shape::Cylinder { radius_mm: 4.0, length_mm: 10.0 };
    [
        ("ball", Shape::Sphere { radius_mm: 4.0 }, DVec3::ZERO),
        ("large ball", Shape::Sphere { radius_mm: 8.0 }, DVec3::ZERO),
        ("lying cylinder", cylinder, DVec3::new(FRAC_PI_2, 0.0, 0.0)),
        ("tilted block", board, DVec3::new(PI - 0.04, 0.05, 0.3)),
    ]
}

/// The simulator's gel comes to rest on the very lattice of markers, so that second differences are exact:
/// there is nothing but noise, of which 32 fits are within four standard deviations, and a thousandth for rim
/// markers that pass for free.
#[test]
fn any_part_tells_the_decay_length_from_a_guess_that_is_too_long() {
    let mut random = Stream::new(1, "decay");
    for (name, shape, turn) in parts() {
        let (rest, presses) = heights_mm(&shape, turn);
        for (start_mm, sigma_mm) in
            [2.5, 3.5, 5.0, 8.0].into_iter().flat_map(|start| [(start, 1e-4), (start, 0.01)])
        {
            let found = fit(&rest, &presses, start_mm, sigma_mm, &mut random);
            println!("{name}, from {start_mm} mm, noise {sigma_mm} mm: {found:?}");
            let bound = 1e-3 * DECAY_MM + 4.0 * found.sigma_mm;
            assert!((found.decay_mm - DECAY_MM).abs() < bound, "{name}, {start_mm} mm: {found:?}");
            assert!(found.sigma_mm < 0.1, "{name}: {found:?}");
        }
    }
}

/// The standard deviation of 200 draws has an error of 5 %. The stated one must agree within three times
/// that.
#[test]
fn the_uncertainty_is_the_spread() {
    let (_, shape, turn) = &parts()[0];
    let (rest, presses) = heights_mm(shape, *turn);
    let mut random = Stream::new(2, "decay");
    let found: Vec<Decay> =
        (0..200).map(|_| fit(&rest, &presses[3..], DECAY_MM, 0.005, &mut random)).collect();
    let mean = found.iter().map(|d| d.decay_mm).sum::<f64>() / 200.0;
    let spread = (found.iter().map(|d| (d.decay_mm - mean).powi(2)).sum::<f64>() / 199.0).sqrt();
    let told = found.iter().map(|d| d.sigma_mm).sum::<f64>() / 200.0;
    println!("mean {mean}, spread {spread}, told {told}");
    assert!((told / spread - 1.0).abs() < 0.15, "spread {spread}, told {told}");
}

#[test]
fn frames_without_contact_tell_nothing() {
    let (rest, presses) = heights_mm(&parts()[0].1, DVec3::ZERO);
    let mut pressure = Pressure::new(&rest, 25, 25, DECAY_MM).unwrap();
    let (mut fit, mut salient) = (DecayFit::default(), Vec::new());
    assert_eq!(fit.decay(), None);
    let level = vec![0.0; 625];
    pressure.run(&level, std::iter::repeat_n(1e-4, 625), &SEEN, &mut salient).unwrap();
    fit.add(&pressure, &level, &SEEN, &salient);
    assert_eq!(fit.decay(), None);
    // A list of another length is not this frame.
    fit.add(&pressure, &presses[3][1..], &SEEN, &[true; 625]);
    assert_eq!(fit.decay(), None);
}

/// The pipeline begins with a length that is 60 % too long, and learns from presses of a ball until it judges
/// by what it found. The noise of the rest frame is in all heights alike, so that it counts as one frame's
/// does: four standard deviations of that are 0.2 mm.
#[test]
fn a_pipeline_learns_the_decay_length() {
    let effects = Effects {
        defocus: Some(Defocus::default()),
        sensor_noise: Some(SensorNoise::default()),
        ..Effects::of_gel()
    };
    let scene = Scene { indenter: Some(Shape::Sphere { radius_mm: 4.0 }), effects, ..Scene::default() };
    let mut simulator = Simulator::new(&scene, None).unwrap();
    let mut params = Params::preset("balanced").unwrap();
    params.contact =
        ContactParams { saliency: Saliency::Pressure, decay_mm: 4.0, learn_decay: true, ..params.contact };
    params.detect.search = Search::Whole;
    let mut pipeline = Pipeline::new(&scene.rig, &params).unwrap();
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    let mut frame = Frame::default();
    for index in 0..16_u64 {
        let above = Pose::from_translation_mm(DVec3::new(4.5, -0.4, 40.0));
        let press_mm = 0.2 * (index as f64).min(7.0);
        let contact = (index > 0).then(|| ContactState::pressed(simulator.pressed(above, press_mm).unwrap()));
        simulator.truth(contact.as_ref(), &mut truth);
        simulator.render(&truth, index, &mut left, &mut right);
        let view = |pixels| GrayView::new(pixels, 640, 480, 640).unwrap();
        pipeline.process(view(&left), view(&right), &mut frame).unwrap();
        if index == 0 {
            assert_eq!(pipeline.decay(), None);
        }
    }
    let found = pipeline.decay().unwrap();
    println!("{found:?}");
    assert!((found.decay_mm - DECAY_MM).abs() < 0.2 && found.sigma_mm < 0.02 * found.decay_mm, "{found:?}");
    let both = |salient: &[bool]| salient.iter().zip(&truth.in_contact).filter(|&(&a, &b)| a && b).count();
    let all = frame.salient.iter().chain(&truth.in_contact).filter(|&&b| b).count();
    assert!(2.0 * both(&frame.salient) as f64 / all as f64 > 0.9);
    pipeline.reset();
    assert_eq!(pipeline.decay(), None);
}

#[test]
fn only_the_rung_of_pressure_learns() {
    let mut params = Params::preset("fast").unwrap();
    params.contact.learn_decay = true;
    let error = params.validate().unwrap_err().to_string();
    assert!(error.contains("contact.learn_decay") && error.contains("pressure"), "{error}");
}
