//! What a rendered stereo frame costs.
#![allow(clippy::unwrap_used)]

use gelstereo_sim::effects::{Defocus, Grain, SensorNoise, UnevenLight};
use gelstereo_sim::{Effects, Scene, Simulator, Truth};
use std::time::Instant;

fn main() {
    let frames: u64 = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(20);
    let effects = Effects {
        defocus: Some(Defocus::default()),
        sensor_noise: Some(SensorNoise::default()),
        grain: Some(Grain::default()),
        uneven_light: Some(UnevenLight::default()),
        ..Effects::default()
    };
    let scene = Scene { effects, ..Scene::default() };
    let mut simulator = Simulator::new(&scene, None).unwrap();
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    simulator.truth(None, &mut truth);
    let mut best = f64::INFINITY;
    for frame in 0..frames {
        let start = Instant::now();
        simulator.render(&truth, frame, &mut left, &mut right);
        best = best.min(start.elapsed().as_secs_f64());
    }
    println!("{:.3} ms per stereo frame (least of {frames})", best * 1e3);
}
