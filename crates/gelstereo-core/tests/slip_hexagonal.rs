//! Which markers the slip tracker takes for neighbours, on square and hexagonal prints.
#![allow(clippy::unwrap_used)]

use gelstereo_core::contact::RestSurface;
use gelstereo_core::force::MovedMarkers;
use gelstereo_core::lattice::Topology;
use gelstereo_core::math::linalg::Symmetric;
use gelstereo_core::math::{DVec2, DVec3, sqrt};
use gelstereo_core::params::{SlipMethod, SlipParams};
use gelstereo_core::slip::{Slip, SlipTracker, Stick};
use gelstereo_core::track::MarkerState;
use proptest::prelude::*;

const PITCH_MM: f64 = 0.9;
const SIDE: usize = 13;
const MARKERS: usize = SIDE * SIDE;
const COVARIANCE_MM2: Symmetric<3> = [[2e-6, 0.0, 0.0], [0.0, 2e-6, 0.0], [0.0, 0.0, 25e-6]];

fn rest_mm(topology: Topology) -> Vec<DVec3> {
    let row_mm = PITCH_MM * if topology.is_hexagonal() { sqrt(0.75) } else { 1.0 };
    let at = |i: usize| DVec3::new(PITCH_MM * topology.along(i), row_mm * (i / SIDE) as f64, 30.0);
    (0..MARKERS).map(at).collect()
}

/// States of sticking, and slip, after all markers have moved together by these steps.
fn drag(topology: Topology, patch: &[bool], steps_mm: &[f64]) -> (Vec<Stick>, Slip) {
    let rest = rest_mm(topology);
    let params = SlipParams { method: SlipMethod::Rigid, ..SlipParams::default() };
    let mut tracker = SlipTracker::on(&params, &RestSurface::new(&rest).unwrap(), topology).unwrap();
    let (mut stick, mut slip) = (Vec::new(), None);
    for &x_mm in steps_mm {
        let points_mm: Vec<DVec3> = rest.iter().map(|&p| p + DVec3::new(x_mm, 0.0, -0.3)).collect();
        let (covariance_mm2, state) = ([COVARIANCE_MM2; MARKERS], [MarkerState::Seen; MARKERS]);
        let moved =
            MovedMarkers { points_mm: &points_mm, covariance_mm2: &covariance_mm2, state: &state, patch };
        slip = tracker.run(&moved, &mut stick).unwrap();
    }
    (stick, slip.unwrap())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A marker is at the border of the contact if one of its nearest neighbours does not touch, and beside
    /// the contact if it is next to it, in a square print also across a corner.
    #[test]
    fn neighbours_are_those_of_the_print(
        hexagonal in any::<bool>(), forward in any::<bool>(), radius_mm in 1.5..3.5_f64,
        middle_mm in prop::array::uniform2(4.5..5.5_f64),
    ) {
        let square = Topology::square(SIDE, SIDE);
        let topology = if hexagonal { Topology::hexagonal(SIDE, SIDE, forward) } else { square };
        let rest = rest_mm(topology);
        let middle_mm = DVec2::from_array(middle_mm);
        let patch: Vec<bool> =
            rest.iter().map(|p| p.truncate().distance(middle_mm) < radius_mm).collect();
        let near = |i: usize, pitches: f64| {
            let is_near = |k: &usize| *k != i && rest[*k].distance(rest[i]) < pitches * PITCH_MM;
            (0..MARKERS).filter(is_near).collect::<Vec<_>>()
        };
        // At touch, nothing is known to slip, and all of the patch to stick in the next frame.
        let (stick, slip) = drag(topology, &patch, &[0.0, 0.01]);
        let is_stuck = |i: usize| stick[i] == Stick::Stuck;
        prop_assert!((0..MARKERS).all(|i| is_stuck(i) == patch[i]));
        let nearest = if hexagonal { 6 } else { 4 };
        let in_patch: Vec<usize> = (0..MARKERS).filter(|&i| patch[i]).collect();
        let is_border = |&&i: &&usize| near(i, 1.01).iter().filter(|&&k| patch[k]).count() < nearest;
        let (all, border) = (in_patch.len(), in_patch.iter().filter(is_border).count());
        // Up to one pitch around the contact may slip unseen.
        prop_assert!((slip.stick_range[0] - all as f64 / (all + border) as f64).abs() < 1e-12);

        // Gel beside the patch that does not lag behind it touches the part.
        let (stick, _) = drag(topology, &patch, &[0.0, 0.2, 0.25]);
        let reach = if hexagonal { 1.01 } else { 1.42 };
        for i in 0..MARKERS {
            let touches = patch[i] || near(i, reach).iter().any(|&k| patch[k]);
            prop_assert_eq!(stick[i] != Stick::Free, touches);
        }
    }
}
