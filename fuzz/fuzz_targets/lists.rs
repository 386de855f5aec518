//! Lists of markers through labels and tracks: a lattice with gaps, strays and displacements that the bytes
//! choose, or anything at all. Answers are finite and complete, no detection has two labels, and undisturbed
//! markers keep theirs.
#![no_main]

use gelstereo_core::detect::Markers;
use gelstereo_core::lattice::{foresight_sort, rest_lattice};
use gelstereo_core::math::DVec2;
use gelstereo_core::params::Params;
use gelstereo_core::track::{Tracker, Tracks};
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

const PITCH_PX: f64 = 17.0;

/// A small displacement, or now and then any number.
fn shift(u: &mut Unstructured<'_>) -> Result<DVec2> {
    Ok(match u.int_in_range(0..=15_u8)? {
        0 => DVec2::new(u.arbitrary()?, u.arbitrary()?),
        1 => DVec2::new(f64::from(u.arbitrary::<i16>()?), f64::from(u.arbitrary::<i16>()?)) / 64.0,
        _ => DVec2::new(f64::from(u.arbitrary::<i8>()?), f64::from(u.arbitrary::<i8>()?)) / 64.0,
    })
}

fn disturbed(u: &mut Unstructured<'_>, lattice: &[DVec2]) -> Result<Vec<DVec2>> {
    let mut found = Vec::new();
    for &at in lattice {
        if u.ratio(15, 16)? {
            found.push(at + shift(u)?);
        }
    }
    for _ in 0..u.int_in_range(0..=4)? {
        found.push(DVec2::new(u.int_in_range(0..=200)?.into(), u.int_in_range(0..=200)?.into()));
    }
    Ok(found)
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let (rows, cols) = (u.int_in_range(2..=9)?, u.int_in_range(2..=9)?);
    let turn = f64::from(u.arbitrary::<i16>()?) / 32768.0 * core::f64::consts::PI;
    let (along, across) = (DVec2::from_angle(turn), DVec2::from_angle(turn).perp());
    let place = |n: usize| (along * (n % cols) as f64 + across * (n / cols) as f64) * PITCH_PX + 60.0;
    let lattice: Vec<DVec2> = (0..rows * cols).map(place).collect();
    let mut params = Params::default();
    params.lattice.rows = u.arbitrary::<bool>()?.then_some(rows);
    params.lattice.max_missing_share = f64::from(u.int_in_range(0..=30_u8)?) / 100.0;
    let first = Markers::at(disturbed(&mut u, &lattice)?, 0.1);
    let mut order = Vec::new();
    if foresight_sort(&first.centres_px, rows, cols, PITCH_PX / 3.0, &mut order).is_ok() {
        order.sort_unstable();
        assert!(order.iter().copied().eq(0..rows * cols));
    }
    let tolerance_pitches = params.label.tolerance_pitches;
    let Ok(rest) = rest_lattice(&first.centres_px, &params.lattice, tolerance_pitches) else { return Ok(()) };
    assert_eq!(rest.positions_px.len(), rest.rows * rest.cols);
    assert!(rest.positions_px.iter().all(|p| p.is_finite()) && rest.pitch_px > 0.0);
    let mut labelled: Vec<u32> = rest.detection.iter().flatten().copied().collect();
    let count = labelled.len();
    labelled.sort_unstable();
    labelled.dedup();
    assert_eq!(labelled.len(), count, "a detection has two labels");
    let (mut tracker, mut tracks) = (Tracker::new(&params.track), Tracks::default());
    tracker.initialise(&rest, &first, &mut tracks);
    while !u.is_empty() {
        tracker.run(&Markers::at(disturbed(&mut u, &lattice)?, 0.1), &mut tracks);
        assert_eq!(tracks.positions_px.len(), rest.rows * rest.cols);
        assert!(tracks.positions_px.iter().all(|p| p.is_finite()));
    }
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    // Bytes that run out end the run.
    let _ = run(Unstructured::new(bytes));
});
