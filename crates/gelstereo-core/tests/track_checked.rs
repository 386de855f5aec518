//! Identities over frames that bend, turn, jump and lose markers: right, or not claimed.

mod support;

use gelstereo_core::math::DVec2;
use gelstereo_core::params::{Motion, TrackParams};
use gelstereo_core::track::{MarkerState, Verdict};
use proptest::prelude::*;
use support::sequence::{MARKERS, PITCH_PX, Run, SIDE, Seeing, Warp};

fn params(motion: Motion) -> TrackParams {
    TrackParams { motion, ..TrackParams::default() }
}

const MOTIONS: [Motion; 2] = [Motion::Still, Motion::ConstantVelocity];

fn start(motion: Motion, seed: u64) -> Run {
    Run::start(&params(motion), &Warp::new(), &[], seed)
}

/// All that is detected is identified.
fn step_complete(run: &mut Run, warp: &Warp, seeing: &Seeing) {
    assert_eq!(run.step(warp, seeing).unwrap(), Verdict::Certain, "frame {}", run.frames);
    assert_eq!(run.missed, [], "frame {}", run.frames);
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
            step_complete(&mut run, &Warp { shift_px, ..Warp::new() }, &Seeing::default());
        }
    }
}

fn seeing() -> impl Strategy<Value = Seeing> {
    let smear = prop::option::of((0.0..640.0_f64, 0.0..480.0_f64, 10.0..90.0_f64));
    (0.0..0.2_f64, 0..8_usize, 0..8_usize, smear, any::<bool>()).prop_map(
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

/// A pose that the gel reaches over some frames, or jumps to. Two of them are turned by less than 45 degrees against each
/// other: a square lattice looks the same after a jump by 90.
fn pose() -> impl Strategy<Value = Warp> {
    let contact = (200.0..460.0_f64, 120.0..360.0_f64, 5.0..9.0_f64);
    let grip = (0.0..0.077_f64, -2.0..2.0_f64, -2.0..2.0_f64, -30.0..30.0_f64);
    let whole = (-20.0..20.0_f64, -1.3..1.3_f64, -1.3..1.3_f64);
    (contact, grip, whole).prop_map(|((x, y, radius), (press, sx, sy, twist), (turn, u, v))| Warp {
        contact_px: DVec2::new(x, y),
        radius_px: radius * PITCH_PX,
        press,
        shear_px: DVec2::new(sx, sy) * (PITCH_PX * radius / 9.0),
        twist_rad: twist.to_radians(),
        turn_rad: turn.to_radians(),
        shift_px: DVec2::new(u, v) * PITCH_PX,
    })
}

fn between(from: &Warp, to: &Warp, share: f64) -> Warp {
    let mix = |a: f64, b: f64| a + (b - a) * share;
    Warp {
        press: mix(from.press, to.press),
        shear_px: from.shear_px.lerp(to.shear_px, share),
        twist_rad: mix(from.twist_rad, to.twist_rad),
        turn_rad: mix(from.turn_rad, to.turn_rad),
        // At once.
        shift_px: to.shift_px,
        ..*to
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, cases: 512, ..ProptestConfig::default() })]

    /// Everything at once: what is claimed is right, and a clean frame is identified as soon as it comes.
    #[test]
    fn whatever_happens_no_marker_is_mislabelled(
        poses in prop::collection::vec((pose(), seeing(), 12..40_u32, 0..3_u32), 1..5), constant: bool, seed: u64,
    ) {
        let motion = if constant { Motion::ConstantVelocity } else { Motion::Still };
        let clean = Seeing { unprinted: poses[0].1.unprinted, ..Seeing::default() };
        let mut run = Run::start(&params(motion), &Warp::new(), clean.unprinted, seed);
        let mut from = Warp::new();
        for (to, seeing, frames, dropped) in poses {
            from = Warp { contact_px: to.contact_px, radius_px: to.radius_px, ..from };
            let seeing = Seeing { unprinted: clean.unprinted, ..seeing };
            for k in (1..=frames).filter(|k| k % 5 >= dropped) {
                run.step(&between(&from, &to, f64::from(k) / f64::from(frames)), &seeing)
                    .map_err(TestCaseError::fail)?;
            }
            from = to;
        }
        if std::env::var("SHARE").is_ok() { println!("SHARE {} {} {} {}", run.certain, run.frames, run.strays, run.seen); }
    }
}
