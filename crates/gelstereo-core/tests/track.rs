//! Identity over frames, against displaced lattices.

use crate::support;

use gelstereo_core::detect::Markers;
use gelstereo_core::lattice::RestLattice;
use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::TrackParams;
use gelstereo_core::track::{MarkerState, Tracker, Tracks};
use proptest::prelude::*;
use support::paper_lattice;

const PITCH: f64 = 17.56;

fn start(filled: &[usize]) -> (Tracker, Tracks, Vec<DVec2>) {
    let truth = paper_lattice();
    let rest = RestLattice {
        rows: 25,
        cols: 25,
        positions_px: truth.clone(),
        detection: (0..truth.len()).map(|n| (!filled.contains(&n)).then_some(n as u32)).collect(),
        pitch_px: PITCH,
        left_out: [0; 4],
    };
    let (mut tracker, mut tracks) = (Tracker::new(&TrackParams::default()), Tracks::default());
    tracker.initialise(&rest, &Markers::at(truth.clone(), 0.1), &mut tracks);
    (tracker, tracks, truth)
}

/// All but these, moved, last marker first: the order of detections must not matter.
fn frame(truth: &[DVec2], without: &[usize], moved: impl Fn(DVec2) -> DVec2) -> Markers {
    let kept = (0..truth.len()).rev().filter(|n| !without.contains(n));
    Markers::at(kept.map(|n| moved(truth[n])).collect(), 0.1)
}

#[test]
fn a_filled_in_marker_is_held_for_ever_and_moves_with_its_neighbours() {
    let (mut tracker, mut tracks, truth) = start(&[0]);
    for step in 1..=200 {
        let shift = DVec2::new(0.3, -0.2) * f64::from(step);
        tracker.run(&frame(&truth, &[0], |p| p + shift), &mut tracks);
        assert_eq!(tracks.state[0], MarkerState::Held);
        assert!(tracks.positions_px[0].distance(truth[0] + shift) < 1e-9);
        assert!(tracks.state[1..].iter().all(|&s| s == MarkerState::Seen));
    }
    let shift = DVec2::new(0.3, -0.2) * 201.0;
    tracker.run(&frame(&truth, &[], |p| p + shift), &mut tracks);
    assert_eq!(tracks.state[0], MarkerState::Seen);
    // From then on it is a marker like the others.
    for _ in 0..16 {
        tracker.run(&frame(&truth, &[0], |p| p + shift), &mut tracks);
    }
    assert_eq!(tracks.state[0], MarkerState::Lost);
}

#[test]
fn an_unseen_marker_is_held_then_lost_then_found_where_its_neighbours_went() {
    let (mut tracker, mut tracks, truth) = start(&[]);
    // Out of sight for 20 frames while the gel moves by three pitches in all: frozen, it would meet another
    // marker.
    for step in 1..=20 {
        let shift = DVec2::new(0.15 * PITCH, 0.0) * f64::from(step);
        tracker.run(&frame(&truth, &[312], |p| p + shift), &mut tracks);
        let expected = if step <= 15 { MarkerState::Held } else { MarkerState::Lost };
        assert_eq!(tracks.state[312], expected, "{step}");
        assert!(tracks.positions_px[312].distance(truth[312] + shift) < 1e-9);
    }
    let shift = DVec2::new(0.15 * PITCH * 21.0, 0.0);
    tracker.run(&frame(&truth, &[], |p| p + shift), &mut tracks);
    assert_eq!(tracks.state[312], MarkerState::Seen);
    assert!(tracks.positions_px.iter().zip(&truth).all(|(p, t)| *p == *t + shift));
}

#[test]
fn two_markers_never_share_a_detection() {
    let (mut tracker, mut tracks, truth) = start(&[]);
    // Markers 312 and 313 merge into one blob midway.
    let mut detected = frame(&truth, &[312, 313], |p| p);
    detected.centres_px.push((truth[312] * 0.51 + truth[313] * 0.49) - DVec2::new(0.0, 0.1));
    tracker.run(&Markers::at(detected.centres_px, 0.1), &mut tracks);
    assert_eq!([tracks.state[312], tracks.state[313]], [MarkerState::Seen, MarkerState::Held]);
    // One of the eight neighbours that carry it is off by half a pitch.
    assert!(tracks.positions_px[313].distance(truth[313]) < PITCH / 16.0);
}

#[test]
fn a_detection_beyond_the_gate_is_no_marker() {
    let (mut tracker, mut tracks, truth) = start(&[]);
    let beyond = truth[24] + DVec2::new(0.5 * PITCH + 1e-9, 0.0);
    let mut detected = frame(&truth, &[24], |p| p);
    detected.centres_px.extend([beyond, DVec2::NAN, DVec2::INFINITY]);
    tracker.run(&Markers::at(detected.centres_px, 0.1), &mut tracks);
    assert_eq!(tracks.state[24], MarkerState::Held);
    assert_eq!(tracks.positions_px[24], truth[24]);
    tracker.run(&Markers::default(), &mut tracks);
    assert!(tracks.state.iter().all(|&s| s == MarkerState::Held));
    assert_eq!(tracks.positions_px, truth);
}

#[test]
fn before_it_is_initialised_it_does_nothing() {
    let mut tracks = Tracks::default();
    Tracker::new(&TrackParams::default()).run(&Markers::at(vec![DVec2::ZERO], 0.1), &mut tracks);
    assert_eq!(tracks, Tracks::default());
}

/// The part of row 35 that lies here: ids do not drift while markers flicker.
#[test]
fn row_35_positions_do_not_drift_while_markers_flicker() {
    let (mut tracker, mut tracks, truth) = start(&[0]);
    let mut stream = Stream::new(35, "flicker");
    for step in 0..3000 {
        let shift = DVec2::new(5.0 * (f64::from(step) * 0.05).sin(), 0.0);
        let without: Vec<usize> = (0..60).map(|_| stream.below(625)).chain([0]).collect();
        let jitter = 0.05;
        let detected: Vec<DVec2> = (0..625)
            .filter(|n| !without.contains(n))
            .map(|n| {
                let (x, y) = stream.normal_pair();
                truth[n] + shift + DVec2::new(x, y) * jitter
            })
            .collect();
        tracker.run(&Markers::at(detected, jitter), &mut tracks);
        for n in 0..625 {
            // A mean of few neighbours and the marker's own last error: 6 sigma of each, on both axes.
            let off = tracks.positions_px[n].distance(truth[n] + shift);
            assert!(off < 4.0 * 6.0 * jitter, "frame {step}, marker {n}: {off}");
        }
    }
    let no_longer_printed = tracks.state.iter().filter(|&&s| s == MarkerState::Lost).count();
    assert_eq!(no_longer_printed, 0);
    // The same two frames, the second without some markers, say the same as on the first day.
    let (mut fresh, mut fresh_tracks, _) = start(&[0]);
    for without in [vec![0], (0..625).filter(|n| n % 7 == 0).collect()] {
        let detected = frame(&truth, &without, |p| p * 1.003);
        tracker.run(&detected, &mut tracks);
        fresh.run(&detected, &mut fresh_tracks);
    }
    assert_eq!(tracks.state, fresh_tracks.state);
    assert_eq!(tracks.positions_px, fresh_tracks.positions_px);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// At most 5 + 0.005 x 210 px on each axis, below the gate of 8.78 px: whatever is missing, every other
    /// marker keeps its own detection.
    #[test]
    fn motion_within_the_gate_keeps_every_identity(
        shift_x in -5.0..5.0_f64, shift_y in -5.0..5.0_f64, stretch in -0.005..0.005_f64,
        missing in 0..40_usize, seed: u64,
    ) {
        let (mut tracker, mut tracks, truth) = start(&[]);
        let mut stream = Stream::new(seed, "missing");
        let without: Vec<usize> = (0..missing).map(|_| stream.below(625)).collect();
        let moved = |p: DVec2| p + DVec2::new(shift_x, shift_y) + (p - DVec2::new(320.0, 240.0)) * stretch;
        tracker.run(&frame(&truth, &without, moved), &mut tracks);
        for n in 0..625 {
            if without.contains(&n) {
                prop_assert_eq!(tracks.state[n], MarkerState::Held);
            } else {
                prop_assert_eq!(tracks.state[n], MarkerState::Seen);
                prop_assert_eq!(tracks.positions_px[n], moved(truth[n]));
            }
        }
    }

    /// Spots anywhere, from one for every five markers to four for each: none is a marker, and the lattice is
    /// found again.
    #[test]
    fn row_48_spots_anywhere_are_no_markers(per_marker in 0.2..4.0_f64, frames in 1..4_usize, seed: u64) {
        let (mut tracker, mut tracks, truth) = start(&[]);
        let mut stream = Stream::new(seed, "spots");
        for _ in 0..frames {
            let mut anywhere = |size: f64| (size + 80.0) * stream.uniform() - 40.0;
            let spots =
                (0..(per_marker * 625.0) as usize).map(|_| DVec2::new(anywhere(640.0), anywhere(480.0)));
            tracker.run(&Markers::at(spots.collect(), 0.1), &mut tracks);
            prop_assert!(tracks.state.iter().all(|&s| s == MarkerState::Held));
        }
        tracker.run(&frame(&truth, &[], |p| p), &mut tracks);
        prop_assert!(tracks.state.iter().all(|&s| s == MarkerState::Seen));
        prop_assert_eq!(tracks.positions_px, truth);
    }

    /// A few markers that are seen are as certain as many.
    #[test]
    fn a_lattice_of_which_little_is_seen_is_followed(side in 2..8_usize, step in -5.0..5.0_f64) {
        let (mut tracker, mut tracks, truth) = start(&[]);
        let without: Vec<usize> = (0..625).filter(|n| n / 25 >= side || n % 25 >= side).collect();
        tracker.run(&frame(&truth, &without, |p| p + DVec2::new(step, step)), &mut tracks);
        for n in (0..625).filter(|n| !without.contains(n)) {
            prop_assert_eq!(tracks.state[n], MarkerState::Seen);
        }
    }
}

proptest! {
    /// With a gate of nearly a pitch a hidden marker's nearest detection is its neighbour's: it stays without
    /// one.
    #[test]
    fn no_detection_is_given_to_two_markers(
        gate_pitches in 0.5..0.95_f64, shift in (0.0..0.3_f64, 0.0..6.3_f64),
        hidden in prop::collection::vec(0..625_usize, 0..40),
    ) {
        let truth = paper_lattice();
        let rest = RestLattice {
            rows: 25,
            cols: 25,
            positions_px: truth.clone(),
            detection: (0..truth.len()).map(|n| Some(n as u32)).collect(),
            pitch_px: PITCH,
            left_out: [0; 4],
        };
        let params = TrackParams { gate_pitches, ..TrackParams::default() };
        let (mut tracker, mut tracks) = (Tracker::new(&params), Tracks::default());
        tracker.initialise(&rest, &Markers::at(truth.clone(), 0.1), &mut tracks);
        let shift = DVec2::from_angle(shift.1) * (shift.0 * PITCH);
        tracker.run(&frame(&truth, &hidden, |p| p + shift), &mut tracks);
        for (n, &state) in tracks.state.iter().enumerate() {
            let expected = if hidden.contains(&n) { MarkerState::Held } else { MarkerState::Seen };
            prop_assert_eq!(state, expected, "{}", n);
            let is_there = tracks.positions_px[n] == truth[n] + shift;
            prop_assert!(is_there || hidden.contains(&n), "{n}");
        }
    }
}

/// A marker has the covariance of its own last detection, and keeps it while it is hidden.
#[test]
fn covariances_are_those_of_the_last_detections() {
    let (mut tracker, mut tracks, truth) = start(&[]);
    for step in 1..=4 {
        let sigma_px = 0.1 * f64::from(step);
        let centres_px = frame(&truth, &[312], |p| p).centres_px;
        tracker.run(&Markers::at(centres_px, sigma_px), &mut tracks);
        for (n, covariance) in tracks.covariance_px2.iter().enumerate() {
            let sigma_px = if n == 312 { 0.1 } else { sigma_px };
            assert_eq!(*covariance, [[sigma_px * sigma_px, 0.0], [0.0, sigma_px * sigma_px]], "{step} {n}");
        }
    }
}
