//! Motion without a model, of parts whose markers are made: fixed to the part while it holds them.
#![allow(clippy::unwrap_used)]

use crate::counting::ALLOCATIONS;
use gelstereo_core::contact::RestSurface;
use gelstereo_core::force::MovedMarkers;
use gelstereo_core::math::linalg::Symmetric;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DMat3, DVec2, DVec3, Pose};
use gelstereo_core::motion::{MotionKind, MotionSource, MotionStatus, MotionTracker, PartMotion};
use gelstereo_core::params::{MotionParams, SlipParams};
use gelstereo_core::slip::{RigidMotion, SlipError, SlipStatus};
use gelstereo_core::track::MarkerState;
use proptest::prelude::*;

const COLS: usize = 21;
const ROWS: usize = 13;
const PITCH_MM: f64 = 0.9;
const Z_MM: f64 = 30.0;
const SIGMA_MM: [f64; 3] = [0.0015, 0.0015, 0.005];

fn rest_mm() -> Vec<DVec3> {
    let at = |i: usize, n: usize| PITCH_MM * (i as f64 - (n as f64 - 1.0) / 2.0);
    (0..COLS * ROWS).map(|i| DVec3::new(at(i % COLS, COLS), at(i / COLS, ROWS), Z_MM)).collect()
}

fn tracker_in(frame: &Pose) -> MotionTracker {
    let rest: Vec<DVec3> = rest_mm().iter().map(|&p| frame.transform_point(p)).collect();
    let rest = RestSurface::new(&rest).unwrap();
    MotionTracker::new(&SlipParams::default(), &MotionParams::default(), &rest, COLS).unwrap()
}

fn tracker() -> MotionTracker {
    tracker_in(&Pose::IDENTITY)
}

/// Markers as they are seen, in a frame of the sensor's that may be turned.
struct Gel {
    points_mm: Vec<DVec3>,
    covariance_mm2: Vec<Symmetric<3>>,
    state: Vec<MarkerState>,
    patch: Vec<bool>,
    /// Where each marker touched the part, part frame.
    touched_mm: Vec<Option<DVec3>>,
    random: Stream,
    frame: Pose,
}

impl Gel {
    fn new(seed: u64, frame: Pose) -> Self {
        let rest = rest_mm();
        let turn = frame.matrix();
        let diagonal = DMat3::from_diagonal(DVec3::from_array(SIGMA_MM.map(|sigma| sigma * sigma)));
        let covariance = (turn * diagonal * turn.transpose()).to_cols_array_2d();
        Self {
            covariance_mm2: vec![covariance; rest.len()],
            state: vec![MarkerState::Seen; rest.len()],
            patch: vec![false; rest.len()],
            touched_mm: vec![None; rest.len()],
            points_mm: rest,
            random: Stream::new(seed, "motion"),
            frame,
        }
    }

    /// A part at this pose holds the markers within a circle about `centre_mm`; new ones lie on a sphere.
    fn hold(&mut self, pose: &Pose, centre_mm: DVec2, radius_mm: f64) {
        for (i, rest) in rest_mm().into_iter().enumerate() {
            let away_mm = (rest.truncate() - centre_mm).length();
            self.patch[i] = away_mm <= radius_mm;
            if !self.patch[i] {
                self.touched_mm[i] = None;
                self.see(i, rest);
                continue;
            }
            let on_sphere = rest - DVec3::Z * (0.5 - away_mm * away_mm / 12.0);
            let touched = *self.touched_mm[i].get_or_insert(pose.inverse().transform_point(on_sphere));
            self.see(i, pose.transform_point(touched));
        }
    }

    /// As `hold`, but the part has bumps on its sphere.
    fn hold_bumps(&mut self, pose: &Pose, centre_mm: DVec2, radius_mm: f64) {
        let middle = DVec3::new(0.0, 0.0, Z_MM + 5.5);
        self.hold(pose, centre_mm, radius_mm);
        for (i, rest) in rest_mm().into_iter().enumerate() {
            if !self.patch[i] {
                continue;
            }
            let away_mm = (rest.truncate() - centre_mm).length();
            let on_sphere = rest - DVec3::Z * (0.5 - away_mm * away_mm / 12.0);
            if self.touched_mm[i].is_some_and(|p| pose.transform_point(p).distance(on_sphere) < 1e-9) {
                // Markers that are new.
                let d = (pose.inverse().transform_point(on_sphere) - middle).normalize();
                let bump = 0.25 * (7.0 * d.x + 3.0 * d.y).sin() * (6.0 * d.y + 2.0 * d.z).cos();
                self.touched_mm[i] = Some(middle + d * (6.0 + bump));
            }
            let touched = self.touched_mm[i].unwrap();
            self.see(i, pose.transform_point(touched));
        }
    }

    fn see(&mut self, i: usize, point_mm: DVec3) {
        let noise = DVec3::from_array(SIGMA_MM.map(|sigma| sigma * self.random.normal()));
        self.points_mm[i] = self.frame.transform_point(point_mm + noise);
    }

    fn run(&self, tracker: &mut MotionTracker) -> Option<PartMotion> {
        let Self { points_mm, covariance_mm2, state, patch, .. } = self;
        tracker.run(&MovedMarkers { points_mm, covariance_mm2, state, patch }).unwrap()
    }
}

fn about(centre_mm: DVec3, omega: DVec3, v_mm: DVec3) -> Pose {
    let centre = Pose::from_translation_mm(centre_mm);
    centre * Pose::exp(omega, v_mm) * centre.inverse()
}

/// Squared error, normalised by the covariance (6 components).
fn squared_error(found: &RigidMotion, truth: &Pose) -> f64 {
    let to = Pose::from_translation_mm(-found.about_mm);
    let (omega, v) = (to * *truth * found.pose.inverse() * to.inverse()).log();
    let error = [omega.x, omega.y, omega.z, v.x, v.y, v.z];
    let (mut a, mut b) = (found.covariance, error);
    for i in 0..6 {
        for j in i + 1..6 {
            let share = a[j][i] / a[i][i];
            (i..6).for_each(|k| a[j][k] -= share * a[i][k]);
            b[j] -= share * b[i];
        }
    }
    // The factorisation L D Lᵀ makes the sum of squares a sum over pivots.
    (0..6).map(|i| b[i] * b[i] / a[i][i]).sum()
}

/// A sphere of 6 mm that rolls by `step_rad` a frame towards an angle; the pose and the contact's centre.
fn rolled(step: u32, step_rad: f64, angle: f64) -> (Pose, DVec2) {
    let (radius_mm, turn) = (6.0, step_rad * f64::from(step));
    let towards = DVec2::from_angle(angle);
    let shift = towards * (radius_mm * turn);
    let axis = DVec3::new(towards.y, -towards.x, 0.0);
    // The point that touches the gel, 0.5 mm deep, is at rest.
    let centre = DVec3::Z * (Z_MM - 0.5 + radius_mm);
    let pose = Pose::from_translation_mm(shift.extend(0.0)) * about(centre, axis * -turn, DVec3::ZERO);
    (pose, shift)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// A part that is held is followed, however it moves; it rests on the gel.
    #[test]
    fn a_held_part_is_followed(
        seed in any::<u64>(), radius_mm in 1.9..4.5f64,
        omega in prop::array::uniform3(-0.004..0.004f64), v in prop::array::uniform3(-0.03..0.03f64),
    ) {
        let (mut tracker, mut gel) = (tracker(), Gel::new(seed, Pose::IDENTITY));
        let mut before = Pose::IDENTITY;
        for step in 0..20 {
            let by = f64::from(step);
            let (omega, v) = (DVec3::from_array(omega) * by, DVec3::from_array(v) * by);
            let pose = about(DVec3::Z * Z_MM, omega, v);
            gel.hold(&pose, DVec2::ZERO, radius_mm);
            let motion = gel.run(&mut tracker).unwrap();
            if step == 0 {
                prop_assert_eq!(motion.status, MotionStatus::Started);
                prop_assert_eq!(motion.since_touch.pose, Pose::IDENTITY);
                continue;
            }
            let found = (motion.status, motion.source, motion.keyframe, motion.kind);
            prop_assert_eq!(found, (MotionStatus::Tracked, MotionSource::Markers, 0, MotionKind::Rests));
            // Chance of a larger one: 1e-9 a frame.
            prop_assert!(squared_error(&motion.since_touch, &pose) < 55.0);
            prop_assert!(squared_error(&motion.step, &(pose * before.inverse())) < 55.0);
            before = pose;
        }
    }

    /// A sphere that rolls over half its circumference, so that no marker of the first contact is left.
    #[test]
    fn a_rolling_part_is_followed_from_keyframe_to_keyframe(
        seed in any::<u64>(), angle in -0.4..0.4f64, step_rad in 0.01..0.06f64,
    ) {
        let (mut tracker, mut gel) = (tracker(), Gel::new(seed, Pose::IDENTITY));
        let start = DVec2::from_angle(angle) * -5.0;
        let steps = (9.0 / (6.0 * step_rad)) as u32;
        let mut last = None;
        for step in 0..=steps {
            let (rolled, shift) = rolled(step, step_rad, angle);
            let to = Pose::from_translation_mm(start.extend(0.0));
            let pose = to * rolled * to.inverse();
            gel.hold(&pose, start + shift, 2.3);
            let motion = gel.run(&mut tracker).unwrap();
            if step > 0 {
                prop_assert_eq!(motion.status, MotionStatus::Tracked);
                let squared = squared_error(&motion.since_touch, &pose);
                prop_assert!(squared < 55.0, "{step}: {squared}");
            }
            last = Some(motion);
        }
        let last = last.unwrap();
        prop_assert_eq!(last.kind, MotionKind::Rolls);
        prop_assert!((3..9).contains(&last.keyframe), "{}", last.keyframe);
        let (over, travel) = (last.travel.over_part_mm, last.travel);
        prop_assert!(over.truncate().dot(DVec2::from_angle(angle)) > 0.9 * over.length());
        let expected_mm = 6.0 * step_rad * f64::from(travel.frames);
        // The centroid is less deep than the middle, by up to 4 % of the radius.
        let tolerance_mm = 4.0 * travel.over_part_sigma_mm + 0.04 * expected_mm;
        prop_assert!((over.length() - expected_mm).abs() < tolerance_mm, "{over} {expected_mm}");
        prop_assert!(travel.slid_mm.length() < 5.0 * travel.slid_sigma_mm);
    }

    /// The answer in another frame is the answer, in another frame.
    #[test]
    fn the_choice_of_the_frame_does_not_matter(
        seed in any::<u64>(), omega in prop::array::uniform3(-1.0..1.0f64),
        shift in prop::array::uniform3(-50.0..50.0f64), slips in any::<bool>(),
    ) {
        let frame = Pose::exp(DVec3::from_array(omega), DVec3::from_array(shift));
        let frames = [Pose::IDENTITY, frame];
        let mut runs = frames.map(|frame| (tracker_in(&frame), Gel::new(seed, frame)));
        for step in 0..12 {
            let (pose, centre) = rolled(step, 0.04, 0.3);
            let [a, b] = runs.each_mut().map(|(tracker, gel)| {
                if slips {
                    slide(gel, step);
                } else {
                    gel.hold(&pose, centre, 2.3);
                }
                gel.run(tracker).unwrap()
            });
            prop_assert_eq!((a.status, a.kind, a.keyframe), (b.status, b.kind, b.keyframe));
            prop_assert_eq!((a.stuck, a.surface, a.determined), (b.stuck, b.surface, b.determined));
            let same = frame * a.since_touch.pose * frame.inverse() * b.since_touch.pose.inverse();
            let about_mm = b.since_touch.about_mm;
            // Steps end below 1e-6; free directions are found by small numbers.
            prop_assert!(same.transform_point(about_mm).distance(about_mm) < 2e-5, "{step}");
            let trace = |m: &RigidMotion| (3..6).map(|k| m.covariance[k][k]).sum::<f64>();
            let (s, t) = (trace(&a.since_touch), trace(&b.since_touch));
            prop_assert!((s - t).abs() <= 1e-3 * s.max(1e-12), "{step} {s} {t}");
        }
    }
}

/// A sphere of 6 mm that is dragged along x by 0.03 mm a frame. The markers are pushed about, so that no
/// three of them stick.
fn slide(gel: &mut Gel, step: u32) -> DVec3 {
    let drag = DVec3::X * (0.03 * f64::from(step));
    let centre = DVec3::new(0.0, 0.0, Z_MM + 5.5) + drag;
    for (i, rest) in rest_mm().into_iter().enumerate() {
        gel.patch[i] = (rest - centre).truncate().length() <= 3.3;
        // Smooth, as gel is.
        let wave = |x: f64, y: f64| 0.15 * (1.9 * f64::from(step) + 0.9 * x + 0.4 * y).sin();
        let push = DVec2::new(wave(rest.x, rest.y), wave(rest.y, -rest.x));
        let place = (rest - centre).truncate() + push;
        let z_mm = centre.z - (36.0 - place.length_squared().min(30.0)).sqrt();
        gel.see(i, DVec3::new(centre.x + place.x, centre.y + place.y, z_mm));
    }
    drag
}

/// The mean normalised squared error of 6 components. Keyframes share few markers, so that errors of the
/// chain are almost independent.
#[test]
fn the_covariance_of_a_chain_holds() {
    let (mut sum, mut steps) = (0.0, 0.0);
    let count = 150;
    for seed in 0..count {
        let (mut tracker, mut gel) = (tracker(), Gel::new(seed, Pose::IDENTITY));
        let mut before = Pose::IDENTITY;
        for step in 0..=20 {
            let (pose, centre) = rolled(step, 0.06, 0.2);
            gel.hold(&pose, centre - DVec2::X * 3.0, 2.3);
            let motion = gel.run(&mut tracker).unwrap();
            if step == 20 {
                assert!(motion.keyframe > 2);
                sum += squared_error(&motion.since_touch, &pose);
                steps += squared_error(&motion.step, &(pose * before.inverse()));
            }
            before = pose;
        }
    }
    let [mean, mean_step] = [sum, steps].map(|sum| sum / count as f64);
    // The mean's standard deviation is 0.28. Cauchy's weights cost efficiency.
    assert!((5.0..7.5).contains(&mean), "{mean}");
    assert!((5.0..7.5).contains(&mean_step), "{mean_step}");
}

/// The centre of a sphere that slides is known from its surface; its rotation is not, and says so.
#[test]
fn a_sphere_that_slides_is_followed_by_its_surface() {
    let mut squares = 0.0;
    for seed in 0..20 {
        let (mut tracker, mut gel) = (tracker(), Gel::new(seed, Pose::IDENTITY));
        let centre = DVec3::new(0.0, 0.0, Z_MM + 5.5);
        for step in 0..30 {
            let drag = slide(&mut gel, step);
            let motion = gel.run(&mut tracker).unwrap();
            if step < 4 {
                continue;
            }
            assert_eq!(motion.slip.status, SlipStatus::Gross, "{step}");
            assert_eq!((motion.status, motion.source), (MotionStatus::Partial, MotionSource::Surface));
            assert_eq!((motion.determined, motion.kind), (3, MotionKind::Slides));
            let off = motion.since_touch.pose.transform_point(centre) - (centre + drag);
            assert!(off.length() < 0.03, "{step} {off}");
            let free = motion.since_touch.covariance[0][0];
            let frames = f64::from(step);
            assert!(free > 0.25 * (0.02 * frames).powi(2) && free < (0.02 * (frames + 1.0)).powi(2));
            squares += if step == 29 {
                squared_error(&motion.since_touch, &Pose::from_translation_mm(drag))
            } else {
                0.0
            };
        }
    }
    // Three components have errors by noise; the others did not move.
    assert!((0.5..6.0).contains(&(squares / 20.0)), "{}", squares / 20.0);
}

/// A marker that has slipped is no longer the same point of the part, even if it sticks again.
#[test]
fn markers_that_slipped_do_not_count_until_the_next_keyframe() {
    let (mut tracker, mut gel) = (tracker(), Gel::new(4, Pose::IDENTITY));
    let slips = |p: &DVec3| p.x > 0.5 && p.y > 0.5;
    let mut counts = Vec::new();
    for step in 0..40 {
        let pose = Pose::from_translation_mm(DVec3::X * (0.05 * f64::from(step)));
        gel.hold(&pose, DVec2::ZERO, 3.2);
        for (touched, rest) in gel.touched_mm.iter_mut().zip(rest_mm()) {
            // They stay behind once.
            if let Some(touched) = touched.as_mut().filter(|_| step == 3 && slips(&rest)) {
                touched.x -= 0.1;
            }
        }
        let motion = gel.run(&mut tracker).unwrap();
        if step > 0 {
            assert!(squared_error(&motion.since_touch, &pose) < 55.0);
            counts.push((motion.stuck as usize, motion.keyframe));
        }
    }
    let touched = gel.patch.iter().filter(|&&touches| touches).count();
    let slipped = gel.patch.iter().zip(rest_mm()).filter(|(touches, p)| **touches && slips(p)).count();
    assert_eq!(counts[0], (touched, 0));
    assert!(slipped > 5 && counts[4..].iter().all(|&found| found == (touched - slipped, 0)), "{counts:?}");
}

#[test]
fn a_part_that_is_not_seen_is_where_it_was_with_a_larger_variance() {
    let (mut tracker, mut gel) = (tracker(), Gel::new(1, Pose::IDENTITY));
    for step in 0..4 {
        gel.hold(&Pose::from_translation_mm(DVec3::X * (0.02 * f64::from(step))), DVec2::ZERO, 3.0);
        gel.run(&mut tracker).unwrap();
    }
    gel.state.fill(MarkerState::Held);
    let unseen: Vec<PartMotion> = (0..2).map(|_| gel.run(&mut tracker).unwrap()).collect();
    for motion in &unseen {
        assert_eq!((motion.status, motion.source), (MotionStatus::Predicted, MotionSource::Nothing));
        let moved = motion.since_touch.pose.transform_point(DVec3::Z * Z_MM);
        assert!((moved - DVec3::new(0.06, 0.0, Z_MM)).length() < 0.02);
    }
    let variance = |motion: &PartMotion| motion.since_touch.covariance[3][3];
    assert!(variance(&unseen[0]) > 0.08 && variance(&unseen[1]) > 1.9 * variance(&unseen[0]));
    // Without contact, the next touch is another contact.
    gel.patch.fill(false);
    assert_eq!(gel.run(&mut tracker), None);
    gel.state.fill(MarkerState::Seen);
    gel.hold(&Pose::IDENTITY, DVec2::ZERO, 3.0);
    let again = gel.run(&mut tracker).unwrap();
    assert_eq!((again.status, again.contact, again.keyframe), (MotionStatus::Started, 1, 0));
}

#[test]
fn no_frame_allocates() {
    let (mut tracker, mut gel) = (tracker(), Gel::new(2, Pose::IDENTITY));
    for step in 0..40 {
        let (pose, centre) = rolled(step, 0.05, 0.0);
        if step < 20 {
            gel.hold(&pose, centre, 2.0 + 0.1 * f64::from(step))
        } else {
            let _ = slide(&mut gel, step);
        }
        let before = ALLOCATIONS.get();
        gel.run(&mut tracker);
        assert_eq!(ALLOCATIONS.get() - before, 0, "{step}");
    }
}

#[test]
fn what_cannot_be_used_is_refused() {
    let rest = RestSurface::new(&rest_mm()).unwrap();
    let made = |params: &MotionParams, cols| MotionTracker::new(&SlipParams::default(), params, &rest, cols);
    for invalid in [
        MotionParams { keyframe_share: 1.0, ..MotionParams::default() },
        MotionParams { free_turn_rad: 0.0, ..MotionParams::default() },
        MotionParams { free_shift_mm: f64::NAN, ..MotionParams::default() },
        MotionParams { surface_sigma_mm: -1.0, ..MotionParams::default() },
        MotionParams { window_frames: 0, ..MotionParams::default() },
        MotionParams { loop_keyframes: 65, ..MotionParams::default() },
    ] {
        assert!(matches!(made(&invalid, COLS), Err(SlipError::Params(_))), "{invalid:?}");
    }
    let refused = made(&MotionParams::default(), 5).unwrap_err();
    assert_eq!(refused, SlipError::Lattice { markers: COLS * ROWS, cols: 5 });
    let gel = Gel::new(3, Pose::IDENTITY);
    let Gel { points_mm, covariance_mm2, state, .. } = &gel;
    let short = MovedMarkers { points_mm, covariance_mm2, state, patch: &[true] };
    assert_eq!(tracker().run(&short), Err(SlipError::Lengths { rest: COLS * ROWS, found: 1 }));
}

/// A sphere with bumps that rolls away and comes back: the last frame, its true pose, and the mean squared
/// error of the keyframes, normalised by their covariance.
fn there_and_back(seed: u64, loop_keyframes: u32) -> (PartMotion, Pose, f64) {
    let rest = RestSurface::new(&rest_mm()).unwrap();
    let params = MotionParams { loop_keyframes, ..MotionParams::default() };
    let mut tracker = MotionTracker::new(&SlipParams::default(), &params, &rest, COLS).unwrap();
    let (mut gel, mut last, mut truth) = (Gel::new(seed, Pose::IDENTITY), None, vec![Pose::IDENTITY]);
    for step in 0..=60_u32 {
        let (pose, centre) = rolled(30 - step.abs_diff(30), 0.04, 0.3);
        gel.hold_bumps(&pose, centre, 3.3);
        let motion = gel.run(&mut tracker).unwrap();
        if let Some((_, before)) = last.filter(|_| motion.keyframe as usize == truth.len()) {
            truth.push(before);
        }
        last = Some((motion, pose));
    }
    let errors: Vec<f64> = (tracker.keyframes().skip(1))
        .map(|(number, motion)| squared_error(&motion, &truth[number as usize]))
        .collect();
    let (motion, pose) = last.unwrap();
    (motion, pose, errors.iter().sum::<f64>() / errors.len() as f64)
}

/// Loops correct the pose of a part that came back, and the keyframes before, within their covariance.
/// Without loops, the error is that of the chain.
#[test]
fn a_surface_that_comes_back_corrects_the_poses() {
    let (mut with, mut without, mut squared, mut keyframes) = (0.0, 0.0, 0.0, 0.0);
    let count = 24;
    for seed in 0..count {
        let turned = |motion: &PartMotion, pose: Pose| {
            (pose * motion.since_touch.pose.inverse()).log().0.length_squared() / count as f64
        };
        let (motion, pose, _) = there_and_back(seed, 0);
        assert_eq!(motion.loops, 0);
        without += turned(&motion, pose);
        let (motion, pose, errors) = there_and_back(seed, 32);
        assert!(motion.loops >= 2, "{seed}: {}", motion.loops);
        with += turned(&motion, pose);
        squared += squared_error(&motion.since_touch, &pose) / count as f64;
        keyframes += errors / count as f64;
    }
    assert!(with < 0.5 * without, "{with} {without}");
    // Of six components; normals at the border are stated worse than they are.
    assert!((3.0..8.0).contains(&squared) && (3.0..8.0).contains(&keyframes), "{squared} {keyframes}");
}

/// A tracker that remembers few keyframes forgets those that show the same, and closes loops with the others.
#[test]
fn few_keyframes_close_loops_too() {
    let closed: u32 = (0..8).map(|seed| there_and_back(seed, 4).0.loops).sum();
    let (motion, pose, errors) = there_and_back(1, 4);
    assert!(closed >= 8 && motion.keyframe >= 4, "{closed} {}", motion.keyframe);
    assert!(squared_error(&motion.since_touch, &pose) < 40.0 && errors < 20.0, "{errors}");
    assert_eq!(there_and_back(1, 2).0.loops, 0);
}
