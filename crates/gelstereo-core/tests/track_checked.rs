//! Identities over frames that bend, turn, jump and lose markers: right, or not claimed.

use crate::support;

use gelstereo_core::detect::Markers;
use gelstereo_core::detect::{Found, WindowObservation};
use gelstereo_core::math::DVec2;
use gelstereo_core::params::{Motion, TrackParams};
use gelstereo_core::track::{Certainty, MarkerState};
use proptest::prelude::*;
use support::sequence::{MARKERS, PITCH_PX, Run, Seeing, Warp, see};

fn params(motion: Motion) -> TrackParams {
    TrackParams { motion, ..TrackParams::default() }
}

const MOTIONS: [Motion; 2] = [Motion::Still, Motion::ConstantVelocity];

fn start(motion: Motion, seed: u64) -> Run {
    Run::start(&params(motion), &Warp::new(), &[], seed)
}

/// All that is detected is identified, but for one or two beside the image's border.
fn step_complete(run: &mut Run, warp: &Warp, seeing: &Seeing) {
    assert_eq!(run.step(warp, seeing).unwrap(), Certainty::Certain, "frame {}", run.frames);
    // One that comes into view may have too few neighbours yet.
    assert!(run.missed.len() < 3, "frame {}: {:?}", run.frames, run.missed);
}

/// Shear by 2 pitches, twist by 30 degrees and a press of 2 mm in so many frames, and back in as many.
fn grip(share: f64) -> Warp {
    Warp {
        press: 0.077 * share,
        shear_px: DVec2::new(1.6, 1.2) * (PITCH_PX * share),
        twist_rad: 30_f64.to_radians() * share,
        ..Warp::new()
    }
}

/// What is known to be nearest need not be searched for: whatever is said to be seen near a marker, right or
/// wrong, the tracks are those of a search, to the bit, as long as no two detections are closer than is said.
#[test]
fn sights_change_no_bit() {
    let mut used = 0;
    for (motion, seed) in MOTIONS.into_iter().flat_map(|motion| [motion; 4]).zip(0..) {
        let mut run = start(motion, seed);
        let (mut near, mut tracks) = (run.tracker.clone(), run.tracks.clone());
        for k in 0..12 {
            let seeing = Seeing { missing: 0.03, merged: 4, specks: 6, ..Seeing::default() };
            let warp =
                Warp { shift_px: DVec2::new(0.3, 0.8) * f64::from(k * k), ..grip(f64::from(k) / 12.0) };
            let frame = see(&run.rest_px, &warp, &seeing, &mut run.stream);
            let centres = &frame.markers.centres_px;
            let apart2 = |(n, a): (usize, &DVec2)| {
                centres[..n].iter().map(|b| a.distance_squared(*b)).fold(f64::INFINITY, f64::min)
            };
            let apart_px = centres.iter().enumerate().map(apart2).fold(f64::INFINITY, f64::min).sqrt();
            let mut sights = vec![WindowObservation::Nothing; MARKERS];
            for (m, identity) in (0..).zip(&frame.identity) {
                let Some(n) = *identity else { continue };
                // One in eight is that of another marker, or of none.
                let other = run.stream.below(8 * centres.len()) as u32;
                sights[n] =
                    WindowObservation::Marker(if (other as usize) < 2 * centres.len() { other } else { m });
            }
            let expected_px = near.predict(&tracks);
            used += (expected_px.iter().zip(&sights))
                .filter(|&(at, sight)| {
                    let m = match sight {
                        WindowObservation::Marker(m) => *m as usize,
                        _ => return false,
                    };
                    centres.get(m).is_some_and(|c| c.distance(*at) < 0.49 * apart_px)
                })
                .count();
            let found = Found { markers: frame.markers.clone(), sights, apart_px };
            let verdicts =
                [run.tracker.run(&frame.markers, &mut run.tracks), near.run_near(&found, &mut tracks)];
            assert_eq!(verdicts[0], verdicts[1], "frame {k}");
            assert_eq!(run.tracks, tracks, "frame {k}");
        }
    }
    assert!(used > 1000, "{used}");
}

#[test]
fn presses_shear_and_twist_keep_every_identity() {
    for motion in MOTIONS {
        for frames in [6, 12, 40] {
            let mut run = start(motion, 1);
            for k in (0..=frames).chain((0..frames).rev()) {
                step_complete(&mut run, &grip(f64::from(k) / f64::from(frames)), &Seeing::default());
            }
        }
    }
}

#[test]
fn a_rest_frame_at_any_rotation_and_a_lattice_that_turns_keep_every_identity() {
    for motion in MOTIONS {
        for degrees in (0..360).step_by(15) {
            let turn = |by: f64| Warp { turn_rad: (f64::from(degrees) + by).to_radians(), ..Warp::new() };
            let mut run = Run::start(&params(motion), &turn(0.0), &[0, 30], 2);
            for k in 0..20 {
                let seeing = Seeing { unprinted: &[0, 30], ..Seeing::default() };
                step_complete(&mut run, &turn(f64::from(k)), &seeing);
            }
        }
        // Twice around, with corners out of view half of the time; markers once lost are found again.
        let mut run = start(motion, 3);
        for k in 0..=480 {
            let warp = Warp { turn_rad: (1.5 * f64::from(k)).to_radians(), ..Warp::new() };
            step_complete(&mut run, &warp, &Seeing::default());
        }
        assert_eq!(run.last_seen, MARKERS);
    }
}

#[test]
fn jumps_by_more_than_a_pitch_are_noticed() {
    for motion in MOTIONS {
        let mut run = start(motion, 4);
        for k in 0..200 {
            let angle = f64::from(k * k) * 0.37;
            let jump = DVec2::from_angle(angle) * (f64::from(k % 14) * 0.1 * PITCH_PX);
            let shift_px = if k % 3 == 0 { jump } else { DVec2::ZERO };
            let verdict = run.step(&Warp { shift_px, ..Warp::new() }, &Seeing::default()).unwrap();
            assert_eq!(verdict, Certainty::Certain, "frame {k}");
            // Beside the image's border one may not stand out enough.
            assert!(run.missed.len() < 3, "frame {k}: {:?}", run.missed);
        }
    }
}

/// Up to 25 % missing, merged pairs, specks and a smear of up to 18 pitches in diameter.
fn seeing() -> impl Strategy<Value = Seeing> {
    let smear = prop::option::of((0.0..640.0_f64, 0.0..480.0_f64, 10.0..160.0_f64));
    (0.0..0.25_f64, 0..=20_usize, 0..6_usize, smear, any::<bool>()).prop_map(
        |(missing, merged, specks, smear, unprinted)| Seeing {
            missing,
            merged,
            specks,
            unprinted: if unprinted { &[0, 30, 312, 313] } else { &[] },
            smear: smear.map(|(x, y, r)| (DVec2::new(x, y), r)),
            ..Seeing::default()
        },
    )
}

/// A press of up to 2 mm with shear by up to 2 pitches and twist by up to 30 degrees.
fn gripped() -> impl Strategy<Value = Warp> {
    let contact = (200.0..460.0_f64, 120.0..360.0_f64, 3.0..10.0_f64);
    let shear = (0.0..2.0_f64, 0.0..std::f64::consts::TAU);
    (contact, 0.0..0.077_f64, shear, -30.0..30.0_f64).prop_map(
        |((x, y, radius), press, (shear, way), twist)| Warp {
            contact_px: DVec2::new(x, y),
            radius_px: radius * PITCH_PX,
            press,
            shear_px: DVec2::from_angle(way) * (shear * PITCH_PX),
            twist_rad: twist.to_radians(),
            ..Warp::new()
        },
    )
}

fn share(full: &Warp, share: f64) -> Warp {
    Warp {
        press: full.press * share,
        shear_px: full.shear_px * share,
        twist_rad: full.twist_rad * share,
        ..*full
    }
}

fn motion() -> impl Strategy<Value = Motion> {
    prop::sample::select(MOTIONS.to_vec())
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, cases: 32, ..ProptestConfig::default() })]

    /// Gripped and let go, with every fifth frame dropped: no marker is taken for another, and at most one in
    /// ten thousand is taken to stand on a speck or a merged pair.
    #[test]
    fn grips_seen_badly_mislabel_nothing(
        grip in gripped(), seeing in seeing(), frames in 12..40_u32, motion in motion(), seed: u64,
    ) {
        let mut run = Run::start(&params(motion), &Warp::new(), seeing.unprinted, seed);
        for k in (0..=frames).chain((0..frames).rev()).filter(|k| k % 5 > 0) {
            run.step(&share(&grip, f64::from(k) / f64::from(frames)), &seeing).map_err(TestCaseError::fail)?;
        }
        prop_assert!(run.strays * 10_000 <= run.seen, "{} strays", run.strays);
        // As soon as nothing disturbs, all is certain again.
        let clean = Seeing { unprinted: seeing.unprinted, ..Seeing::default() };
        run.step(&Warp::new(), &clean).map_err(TestCaseError::fail)?;
        prop_assert_eq!(run.missed.len(), 0);
    }

    /// The lattice jumps by up to 1.3 pitches from any frame to the next, rows leave the view and come back.
    #[test]
    fn jumps_seen_badly_mislabel_nothing(
        jumps in prop::collection::vec((0.0..1.3_f64, 0.0..std::f64::consts::TAU), 1..40),
        aside in 0.0..60.0_f64, seeing in seeing(), motion in motion(), seed: u64,
    ) {
        let mut run = Run::start(&params(motion), &Warp::new(), seeing.unprinted, seed);
        let mut shift_px = DVec2::ZERO;
        prop_assume!(aside > 1.3 * PITCH_PX);
        for (length, way) in jumps {
            let jump = DVec2::from_angle(way) * (length * PITCH_PX);
            shift_px += if (shift_px + jump).length() < aside { jump } else { -jump };
            run.step(&Warp { shift_px, ..Warp::new() }, &seeing).map_err(TestCaseError::fail)?;
        }
        prop_assert!(run.strays * 10_000 <= run.seen, "{} strays", run.strays);
        let clean = Seeing { unprinted: seeing.unprinted, ..Seeing::default() };
        // A row that left at the moment of a jump is indistinguishable from one hidden: it must be back.
        for _ in 0..4 {
            run.step(&Warp::new(), &clean).map_err(TestCaseError::fail)?;
        }
        prop_assert_eq!(run.missed.len(), 0);
    }
}

/// The border is all that tells a whole pitch: when it is hidden together with a jump, everything is held,
/// and found again when it shows.
#[test]
fn a_jump_with_the_border_hidden_is_held() {
    let mut run = start(Motion::Still, 5);
    step_complete(&mut run, &Warp::new(), &Seeing::default());
    let shift_px = DVec2::new(PITCH_PX, 0.0);
    let lattice: Vec<DVec2> = run.rest_px.iter().map(|&p| p + shift_px).collect();
    let inner = (0..MARKERS).filter(|n| (1..24).contains(&(n % 25)) && (1..24).contains(&(n / 25)));
    let hidden = Markers::at(inner.map(|n| lattice[n]).collect(), 0.1);
    assert_eq!(run.tracker.run(&hidden, &mut run.tracks), Certainty::Uncertain);
    assert!(run.tracks.state.iter().all(|&s| s == MarkerState::Held));
    step_complete(&mut run, &Warp { shift_px, ..Warp::new() }, &Seeing::default());
}

/// Two rows at once, the last two of them out of view: of the shifts by one row the nearest looked best, and
/// was taken.
#[test]
fn a_move_by_two_rows_is_no_move_by_one() {
    for motion in MOTIONS {
        for rows in [-2.1, -1.9, 1.9, 2.1] {
            for pixels in [0.0, 4.0, 8.0] {
                let mut run = start(motion, 6);
                let near = Warp { shift_px: DVec2::new(0.0, pixels * f64::signum(rows)), ..Warp::new() };
                step_complete(&mut run, &near, &Seeing::default());
                let far = Warp { shift_px: near.shift_px + DVec2::new(0.0, rows * PITCH_PX), ..Warp::new() };
                run.step(&far, &Seeing::default()).unwrap();
                // With the velocity wrong once, at the latest the frame after is certain.
                assert_eq!(run.step(&far, &Seeing::default()).unwrap(), Certainty::Certain);
            }
        }
    }
}

/// Row 35: a day is 2.6 million frames; what could grow or drift in one of them shows in three thousand.
#[test]
fn row_35_identities_do_not_drift_on_a_long_walk() {
    let mut run = start(Motion::ConstantVelocity, 35);
    let mut at = DVec2::ZERO;
    let seeing = Seeing { missing: 0.05, ..Seeing::default() };
    for k in 0..3000 {
        let (x, y) = run.stream.normal_pair();
        at = at * 0.98 + DVec2::new(x, y) * 4.0;
        let share = 0.3 - 0.3 * (f64::from(k) * 0.02).cos();
        run.step(&Warp { shift_px: at, ..grip(share) }, &seeing).unwrap();
    }
    // Some twists and motions at once are too much for certainty: all is held for a frame.
    assert!(run.certain > 2_700, "{}", run.certain);
    // Let go at once: those that sprang back farthest are held for a frame or two.
    let released = Warp { shift_px: at, ..Warp::new() };
    for _ in 0..3 {
        run.step(&released, &Seeing::default()).unwrap();
    }
    step_complete(&mut run, &released, &Seeing::default());
}
