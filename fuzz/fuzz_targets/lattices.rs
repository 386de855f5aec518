//! The lattice of a single frame, its anchor, and identities that are checked: lists fit each other, no
//! detection has two places, answers are finite, and the same detections give the same again.
#![no_main]

use gelstereo_core::detect::Markers;
use gelstereo_core::lattice::{FoundLattice, LatticeFinder, anchor, rest_lattice};
use gelstereo_core::math::DVec2;
use gelstereo_core::params::{Motion, Params};
use gelstereo_core::track::{Certainty, MarkerState, Tracks, VerifiedTracker};
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

const PITCH_PX: f64 = 17.0;
const SIZE_PX: (usize, usize) = (240, 200);

/// A small displacement, or now and then any number.
fn shift(u: &mut Unstructured<'_>) -> Result<DVec2> {
    Ok(match u.int_in_range(0..=63_u8)? {
        0 => DVec2::new(u.arbitrary()?, u.arbitrary()?),
        1..=3 => DVec2::new(f64::from(u.arbitrary::<i16>()?), f64::from(u.arbitrary::<i16>()?)) / 256.0,
        _ => DVec2::new(f64::from(u.arbitrary::<i8>()?), f64::from(u.arbitrary::<i8>()?)) / 64.0,
    })
}

/// Some of the lattice's markers, moved together and each by itself, and specks; areas are those of markers,
/// pairs, or any.
fn detections(u: &mut Unstructured<'_>, lattice: &[DVec2]) -> Result<Markers> {
    let together = shift(u)? * f64::from(u.int_in_range(0..=12_u8)?);
    let dense = u.int_in_range(4..=32_u8)?;
    let mut found = Vec::new();
    for &at in lattice {
        if u.int_in_range(0..=dense)? < dense {
            found.push(at + together + shift(u)?);
        }
    }
    for _ in 0..u.int_in_range(0..=6)? {
        found.push(DVec2::new(u.int_in_range(0..=240)?.into(), u.int_in_range(0..=200)?.into()));
    }
    let mut markers = Markers::at(found, 0.1);
    for area in &mut markers.area_px2 {
        *area = *u.choose(&[60, 60, 60, 66, 120, 0, u32::MAX])?;
    }
    Ok(markers)
}

fn find(finder: &mut LatticeFinder, seen: &Markers, expected_px: &[DVec2], rows: usize, cols: usize) {
    let (mut found, mut again) = (FoundLattice::default(), FoundLattice::default());
    let result = finder.run_markers(seen, Some(SIZE_PX), &mut found);
    assert_eq!(result, finder.run_markers(seen, Some(SIZE_PX), &mut again));
    if result.is_err() {
        return;
    }
    assert_eq!(found, again);
    assert_eq!(found.places.len(), seen.centres_px.len());
    assert_eq!(found.places.iter().flatten().count(), found.placed);
    let sites = found.sites();
    for (m, place) in found.places.iter().enumerate() {
        assert!(place.is_none_or(|place| sites.at(place) == Some(m)), "a place of two detections");
    }
    for expected_px in [expected_px, &[]] {
        let Some(anchored) = anchor(&found, &seen.centres_px, rows, cols, expected_px) else { continue };
        let mut labels: Vec<usize> =
            found.places.iter().filter_map(|place| anchored.label((*place)?, rows, cols)).collect();
        let count = labels.len();
        labels.sort_unstable();
        labels.dedup();
        assert!(labels.len() == count && labels.iter().all(|&n| n < rows * cols));
    }
}

fn check(tracks: &Tracks, seen: &Markers, verdict: Certainty) {
    assert!(tracks.positions_px.iter().all(|p| p.is_finite()));
    let mut positions: Vec<DVec2> = tracks
        .positions_px
        .iter()
        .zip(&tracks.state)
        .filter(|&(_, &state)| state == MarkerState::Seen)
        .map(|(&p, _)| p)
        .collect();
    assert!(positions.iter().all(|p| seen.centres_px.contains(p)));
    assert!(verdict == Certainty::Certain || positions.is_empty());
    let count = |list: &[DVec2], p: DVec2| list.iter().filter(|&&q| q == p).count();
    while let Some(p) = positions.pop() {
        assert!(count(&positions, p) < count(&seen.centres_px, p), "a detection has two names");
    }
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let (rows, cols) = (u.int_in_range(3..=9)?, u.int_in_range(3..=9)?);
    let turn = f64::from(u.arbitrary::<i16>()?) / 32768.0 * core::f64::consts::PI;
    let along = DVec2::from_angle(turn) * PITCH_PX;
    let place = |n: usize| along * (n % cols) as f64 + along.perp() * (n / cols) as f64 + 90.0;
    let lattice: Vec<DVec2> = (0..rows * cols).map(place).collect();
    let mut params = Params::default();
    params.lattice.max_missing_share = 0.3;
    params.track.motion = *u.choose(&[Motion::Still, Motion::ConstantVelocity])?;
    let mut finder = LatticeFinder::default();
    let first = detections(&mut u, &lattice)?;
    find(&mut finder, &first, &lattice, rows, cols);
    let Ok(rest) = rest_lattice(&first.centres_px, &params.lattice, params.label.tolerance_pitches) else {
        return Ok(());
    };
    let (mut tracker, mut tracks) = (VerifiedTracker::new(&params.track, SIZE_PX), Tracks::default());
    tracker.initialise(&rest, &first, 4 * rows * cols, &mut tracks);
    while !u.is_empty() {
        let seen = detections(&mut u, &lattice)?;
        find(&mut finder, &seen, &tracks.positions_px, rest.rows, rest.cols);
        let (mut other, mut others) = (tracker.clone(), tracks.clone());
        let verdict = tracker.run(&seen, &mut tracks);
        assert_eq!(verdict, other.run(&seen, &mut others));
        assert_eq!(tracks, others);
        check(&tracks, &seen, verdict);
    }
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    // Bytes that run out end the run.
    let _ = run(Unstructured::new(bytes));
});
