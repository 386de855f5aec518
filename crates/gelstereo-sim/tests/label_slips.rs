//! Labels of the two views that slip against each other are caught, and no true press is.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{press, simulator};
use gelstereo_core::contact::{RestSurface, StereoMismatch};
use gelstereo_core::image::GrayView;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::params::{LabelMethod, Params, TriangulateMethod, TriangulateParams};
use gelstereo_core::pipeline::{Frame, Pipeline};
use gelstereo_core::track::MarkerState;
use gelstereo_core::triangulate::{Centres, Triangulator};
use gelstereo_sim::{Effects, GelKeyframe, Scene, Shape, Simulator, Truth};
use proptest::prelude::*;
use std::ops::Range;

/// Standard deviation of a centre along each axis that is twice the worst rung's, pixels.
const NOISE_PX: f64 = 0.2;

/// Noise of fine lattices, as a share of the pitch: still above the worst rung's 0.09 px on the finest, of
/// 6.2 px. A threshold of 0.3 pitches separates neighbours that are a slip apart from others. The difference
/// of two disparities has twice a centre's noise, so 0.3 pitches are nine of its standard deviations.
const NOISE_OF_PITCH: f64 = 1.0 / 60.0;

/// Rest and one frame of a scene, in which what follows the rest frame is done by hand.
struct Sensor {
    cols: usize,
    triangulator: Triangulator,
    max_epipolar_px: f64,
    rest: RestSurface,
    slips: StereoMismatch,
    left_px: Vec<DVec2>,
    right_px: Vec<DVec2>,
}

impl Sensor {
    fn new(scene: &Scene, press_mm: f64, seed: u64) -> Self {
        let params = TriangulateParams { method: TriangulateMethod::Rays, ..Default::default() };
        let triangulator = Triangulator::new(&scene.rig, &params).unwrap();
        let mut truth = Truth::default();
        simulator(scene).truth(None, &mut truth);
        let noise_px = NOISE_PX.min(NOISE_OF_PITCH * truth.left_px[0].distance(truth.left_px[1]));
        let mut stream = Stream::new(seed, "centres");
        let mut noisy = |positions_px: &[DVec2]| -> Vec<DVec2> {
            let mut noise = || noise_px * stream.normal();
            positions_px.iter().map(|&p| p + DVec2::new(noise(), noise())).collect()
        };
        let (left_px, right_px) = (noisy(&truth.left_px), noisy(&truth.right_px));
        let (mut stereo, covariance_px2) = (Vec::new(), vec![[[0.04, 0.0], [0.0, 0.04]]; left_px.len()]);
        let centres = |positions_px| Centres { positions_px, covariance_px2: &covariance_px2 };
        triangulator.run(centres(&left_px), centres(&right_px), &mut stereo).unwrap();
        let points_mm: Vec<DVec3> = stereo.iter().map(|s| s.point_mm).collect();
        let rest = RestSurface::new(&points_mm).unwrap();
        let mut slips = StereoMismatch::default();
        let pitch_px = left_px[0].distance(left_px[1]);
        let views = [centres(&left_px), centres(&right_px)];
        slips.learn(&triangulator, &rest, views, scene.gel.cols, pitch_px);
        if press_mm > 0.0 {
            let contact = press(scene, DVec3::new(0.1, 0.05, 0.3), DVec2::new(1.0, -0.7), press_mm);
            simulator(scene).truth(Some(&contact), &mut truth);
        }
        let (left_px, right_px) = (noisy(&truth.left_px), noisy(&truth.right_px));
        let max_epipolar_px = params.max_epipolar_px;
        Self { cols: scene.gel.cols, triangulator, max_epipolar_px, rest, slips, left_px, right_px }
    }

    /// Gives the markers of these rows and columns of a view the positions of those so many rows and columns
    /// on; those whose label slipped, where there is another to take.
    fn slip(&mut self, right: bool, [rows, cols]: [Range<usize>; 2], by: [isize; 2]) -> Vec<usize> {
        let view = if right { &mut self.right_px } else { &mut self.left_px };
        let (before, height, width) = (view.clone(), view.len() / self.cols, self.cols);
        let mut slipped = Vec::new();
        for (row, col) in rows.flat_map(|r| cols.clone().map(move |c| (r, c))) {
            let (Some(r), Some(c)) = (row.checked_add_signed(by[0]), col.checked_add_signed(by[1])) else {
                continue;
            };
            if r < height && c < width {
                view[row * width + col] = before[r * width + c];
                slipped.push(row * width + col);
            }
        }
        slipped
    }

    /// States as the pipeline makes them: pairs without a point are held, then those that slipped.
    fn states(&mut self) -> Vec<MarkerState> {
        let covariance_px2 = vec![[[0.04, 0.0], [0.0, 0.04]]; self.left_px.len()];
        let centres = |positions_px| Centres { positions_px, covariance_px2: &covariance_px2 };
        let (left, right) = (centres(&self.left_px), centres(&self.right_px));
        let mut points_mm = self.rest.points_mm().to_vec();
        let mut state = Vec::new();
        for (i, point_mm) in points_mm.iter_mut().enumerate() {
            state.push(match self.triangulator.point(i, &left.at(i), &right.at(i)) {
                Ok(found) if found.epipolar_px.abs() <= self.max_epipolar_px => {
                    *point_mm = found.point_mm;
                    MarkerState::Seen
                }
                _ => MarkerState::Held,
            });
        }
        let mut heights_mm = Vec::new();
        self.rest.indentation_mm(&points_mm, &mut heights_mm).unwrap();
        let seen = state.iter().filter(|&&s| s == MarkerState::Seen).count();
        let held = self.slips.hold(&heights_mm, &mut state, |_| {});
        assert_eq!(state.iter().filter(|&&s| s == MarkerState::Seen).count(), seen - held);
        state
    }
}

fn shapes() -> [Shape; 3] {
    [
        Shape::Sphere { radius_mm: 4.0 },
        Shape::Cylinder { radius_mm: 3.0, length_mm: 6.0 },
        Shape::Box { size_mm: [7.0, 5.0, 5.0] },
    ]
}

fn scene(sensor: usize, shape: usize) -> Scene {
    let name = ["640x480-25", "640x480-45", "640x480-71", "1280x720-25", "640x480-25-refraction"][sensor];
    let indenter = Some(shapes()[shape].clone());
    Scene { indenter, effects: Effects::of_gel(), ..Scene::preset(name).unwrap() }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn no_true_press_of_up_to_2_mm_is_refused(
        sensor in 0_usize..5, shape in 0_usize..3, press_mm in 0.0..2.0, seed in 0_u64..1000,
    ) {
        let mut sensor = Sensor::new(&scene(sensor, shape), press_mm, seed);
        prop_assert!(sensor.slips.slip_mm() > 0.5 && sensor.slips.slip_mm() < 10.0);
        let held = sensor.states().iter().filter(|&&s| s != MarkerState::Seen).count();
        prop_assert_eq!(held, 0);
    }

    /// Of a whole view, a band, a block or a single marker, by a row or a column, under a press or none.
    #[test]
    fn every_slip_of_a_row_or_column_is_caught(
        sensor in 0_usize..5, shape in 0_usize..3, press_mm in 0.0..1.5, seed in 0_u64..1000, right: bool,
        rows in (0.0..1.0, 0.0..1.0), cols in (0.0..1.0, 0.0..1.0), extent in 0_usize..4,
        direction in 0_usize..4,
    ) {
        let mut sensor = Sensor::new(&scene(sensor, shape), press_mm, seed);
        let (width, height) = (sensor.cols, sensor.left_px.len() / sensor.cols);
        let span = |(from, share): (f64, f64), end: usize| {
            let first = (from * (end - 1) as f64) as usize;
            first..(first + 1 + (share * (end - first) as f64) as usize).min(end)
        };
        let (some_rows, some_cols) = (span(rows, height), span(cols, width));
        let part = match extent {
            0 => [0..height, 0..width],
            1 => [some_rows, 0..width],
            2 => [some_rows, some_cols],
            _ => [some_rows.start..some_rows.start + 1, some_cols.start..some_cols.start + 1],
        };
        let slipped = sensor.slip(right, part, [[0, 1], [0, -1], [1, 0], [-1, 0]][direction]);
        let states = sensor.states();
        for &i in &slipped {
            prop_assert!(states[i] != MarkerState::Seen, "marker {} of {}", i, slipped.len());
        }
        // A slip of less than half of the lattice takes few others with it: those that slipped and a border
        // around them.
        let held = states.iter().filter(|&&s| s != MarkerState::Seen).count();
        if slipped.len() * 2 < states.len() {
            prop_assert_eq!(held, slipped.len());
        }
    }
}

/// Sorted labels follow the right view of a gel that creeps by a column while the left one stands still:
/// each view's labels are plausible by themselves, but the points of the last frames would lie 3 mm deeper.
#[test]
fn a_view_that_creeps_by_a_column_gives_no_wrong_point() {
    let still = Scene::default();
    for sign in [-1.0, 1.0] {
        let keyframe = |time_s, x| GelKeyframe { time_s, shift_mm: [x, 0.0], rotation_rad: 0.0 };
        let gel_motion = vec![keyframe(0.0, 0.0), keyframe(10.0 / 30.0, sign * 0.9)];
        let creeping = Scene { gel_motion, ..still.clone() };
        let mut params = Params::preset("balanced").unwrap();
        params.label.method = LabelMethod::Foresight;
        let mut pipeline = Pipeline::new(&still.rig, &params).unwrap();
        let (mut frame, mut truth) = (Frame::default(), Truth::default());
        let mut look = |scene: &Scene, n: u64| {
            let mut simulator = Simulator::new(scene, None).unwrap();
            simulator.moment(None, n, &mut truth);
            let (mut left, mut right) = (Vec::new(), Vec::new());
            simulator.render(&truth, n, &mut left, &mut right);
            [left, right]
        };
        for n in 0..=10 {
            let ([left, _], [_, right]) = (look(&still, n), look(&creeping, n));
            let view = |pixels| GrayView::new(pixels, 640, 480, 640).unwrap();
            pipeline.process(view(&left), view(&right), &mut frame).unwrap();
            let most_mm = frame.indentation_mm.iter().map(|h| h.abs()).fold(0.0, f64::max);
            // Half a slip, and the lattice's part that is nearer or farther than the median.
            assert!(most_mm < 0.6 * 3.3, "{sign}, frame {n}: {most_mm} mm");
        }
        assert_eq!(frame.mismatched, 625, "{sign}");
        assert!(frame.state.iter().all(|&s| s == MarkerState::Held));
    }
}
