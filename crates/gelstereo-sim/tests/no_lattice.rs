//! Frames that do not show the lattice, or the wrong view's, and lattices that moved by more than half a
//! pitch.
#![allow(clippy::unwrap_used)]

use gelstereo_core::image::GrayView;
use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::Params;
use gelstereo_core::pipeline::{Frame, Pipeline};
use gelstereo_core::track::MarkerState;
use gelstereo_sim::{Scene, Simulator, Truth};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

struct Sensor {
    scene: Scene,
    truth: Truth,
    rest: [Vec<u8>; 2],
}

impl Sensor {
    fn new() -> Self {
        let scene = Scene::preset("640x480-25").unwrap();
        let (mut truth, [mut left, mut right]) = (Truth::default(), [Vec::new(), Vec::new()]);
        let mut simulator = Simulator::new(&scene, None).unwrap();
        simulator.truth(None, &mut truth);
        simulator.render(&truth, 0, &mut left, &mut right);
        Self { scene, truth, rest: [left, right] }
    }

    /// The frame that follows the rest frame, with a preset.
    fn follow(&self, preset: &str, pair: &[Vec<u8>; 2]) -> Frame {
        let params = Params::preset(preset).unwrap();
        let mut pipeline = Pipeline::new(&self.scene.rig, &params).unwrap();
        let mut frame = Frame::default();
        for [left, right] in [&self.rest, pair] {
            let [left, right] =
                [left, right].map(|pixels| GrayView::new(pixels, WIDTH, HEIGHT, WIDTH).unwrap());
            pipeline.process(left, right, &mut frame).unwrap();
        }
        frame
    }
}

fn seen(frame: &Frame) -> usize {
    frame.state.iter().filter(|&&state| state == MarkerState::Seen).count()
}

/// Levels anywhere, their means over squares of `side` pixels spread over the same range.
fn noise(seed: u64, side: usize) -> Vec<u8> {
    let mut stream = Stream::new(seed, "noise");
    let cols = WIDTH / side;
    let cells: Vec<u8> = (0..cols * HEIGHT / side).map(|_| stream.below(256) as u8).collect();
    (0..WIDTH * HEIGHT).map(|i| cells[i / WIDTH / side * cols + i % WIDTH / side]).collect()
}

/// An image moved to the right, with its own left border behind.
fn moved(image: &[u8], by_px: usize) -> Vec<u8> {
    image.chunks(WIDTH).flat_map(|row| (0..WIDTH).map(|x| row[x.saturating_sub(by_px)])).collect()
}

#[test]
fn row_48_noise_has_no_marker_that_is_seen() {
    let sensor = Sensor::new();
    for preset in Params::PRESETS {
        for side in [1, 2, 4, 5, 8] {
            let frame = sensor.follow(preset, &[noise(1, side), noise(2, side)]);
            assert_eq!(seen(&frame), 0, "{preset}, squares of {side} px");
        }
    }
}

#[test]
fn row_48_one_view_given_twice_and_views_swapped_have_no_marker_that_is_seen() {
    let sensor = Sensor::new();
    let [left, right] = &sensor.rest;
    for preset in Params::PRESETS {
        for pair in [[left, left], [right, right], [right, left]] {
            assert_eq!(seen(&sensor.follow(preset, &pair.map(Vec::clone))), 0, "{preset}");
        }
    }
}

/// Eq. 1 of the paper: where all markers are found, labels come from the sort alone.
#[test]
fn row_48_a_lattice_in_view_that_moves_by_a_pitch_in_a_frame_keeps_its_identities() {
    let sensor = Sensor::new();
    let pitch_px = sensor.truth.left_px[0].distance(sensor.truth.left_px[1]);
    for preset in Params::PRESETS {
        for pitches in [0.4, 0.6, 0.8, 1.0] {
            let by_px = (pitches * pitch_px) as usize;
            let frame = sensor.follow(preset, &sensor.rest.clone().map(|image| moved(&image, by_px)));
            assert_eq!(seen(&frame), frame.state.len(), "{preset}, {pitches} pitches");
            for (found_px, rest_px) in frame.left_px.iter().zip(&sensor.truth.left_px) {
                let off_px = found_px.distance(*rest_px + DVec2::new(by_px as f64, 0.0));
                assert!(off_px < 0.3 * pitch_px, "{preset}, {pitches} pitches: {off_px} px");
            }
        }
    }
}
