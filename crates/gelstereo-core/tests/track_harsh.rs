//! Everything at once: a fifth to a quarter of the markers missing in every frame, twenty merged pairs, a
//! smear of 90 to 320 px that may move, narrow contacts that squeeze the lattice to half a pitch, jumps, and
//! every fifth frame dropped. Much is held then; nothing is taken for another marker.

use crate::support;

use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::{Motion, TrackParams};
use support::sequence::{PITCH_PX, Run, Seeing, Warp};

/// A grip that is closed and opened again, and how badly it is seen.
struct Harsh {
    motion: Motion,
    grip: Warp,
    seeing: Seeing,
    smear_from_px: DVec2,
    smear_to_px: DVec2,
    smear_radius_px: f64,
    frames: u32,
    /// Longest jump of the whole lattice from one frame to the next, pixels.
    jump_px: f64,
}

impl Harsh {
    fn draw(seed: u64, s: &mut Stream) -> Self {
        let mut between = |low: f64, high: f64| low + (high - low) * s.uniform();
        let way = between(0.0, 6.3);
        let grip = Warp {
            contact_px: DVec2::new(between(200.0, 460.0), between(120.0, 360.0)),
            radius_px: between(3.0, 5.0) * PITCH_PX,
            press: between(0.0, 0.077),
            shear_px: DVec2::from_angle(way) * (between(0.0, 2.0) * PITCH_PX),
            twist_rad: between(-30.0, 30.0).to_radians(),
            ..Warp::new()
        };
        let seeing = Seeing {
            missing: between(0.2, 0.25),
            merged: 20,
            specks: between(0.0, 6.0) as usize,
            unprinted: if between(0.0, 1.0) < 0.5 { &[0, 30, 312, 313] } else { &[] },
            ..Seeing::default()
        };
        let smear_from_px = DVec2::new(between(0.0, 640.0), between(0.0, 480.0));
        let stays = between(0.0, 1.0) < 0.5;
        let smear_to_px =
            if stays { smear_from_px } else { DVec2::new(between(0.0, 640.0), between(0.0, 480.0)) };
        Self {
            grip,
            seeing,
            smear_from_px,
            smear_to_px,
            smear_radius_px: if seed.is_multiple_of(2) { between(45.0, 80.0) } else { between(90.0, 160.0) },
            frames: between(12.0, 40.0) as u32,
            motion: if between(0.0, 1.0) < 0.5 { Motion::Still } else { Motion::ConstantVelocity },
            jump_px: if between(0.0, 1.0) < 0.5 { 0.0 } else { 1.3 * PITCH_PX },
        }
    }

    fn frame(&self, share: f64, shift_px: DVec2) -> (Warp, Seeing) {
        let warp = Warp {
            press: self.grip.press * share,
            shear_px: self.grip.shear_px * share,
            twist_rad: self.grip.twist_rad * share,
            shift_px,
            ..self.grip
        };
        let smear = Some((self.smear_from_px.lerp(self.smear_to_px, share), self.smear_radius_px));
        (warp, Seeing { smear, ..self.seeing.clone() })
    }
}

/// What a sequence came to.
#[derive(Default)]
struct Score {
    frames: usize,
    certain: usize,
    seen: usize,
    strays: usize,
    /// Markers that were detected.
    shown: usize,
}

/// Runs the sequence of a seed; an error names the markers that are taken for others.
fn play(seed: u64, score: &mut Score) -> Result<(), String> {
    let mut s = Stream::new(seed, "harsh");
    let harsh = Harsh::draw(seed, &mut s);
    let params = TrackParams { motion: harsh.motion, ..TrackParams::default() };
    let mut run = Run::start(&params, &Warp::new(), harsh.seeing.unprinted, seed);
    let mut shift_px = DVec2::ZERO;
    for k in (0..=harsh.frames).chain((0..harsh.frames).rev()).filter(|k| k % 5 > 0) {
        if s.uniform() < 0.3 {
            let by = DVec2::from_angle(6.3 * s.uniform()) * (s.uniform() * harsh.jump_px);
            shift_px += if (shift_px + by).length() < 40.0 { by } else { -by };
        }
        let (warp, seeing) = harsh.frame(f64::from(k) / f64::from(harsh.frames), shift_px);
        run.step(&warp, &seeing).map_err(|error| format!("seed {seed}, {error}"))?;
        score.shown += run.last_seen + run.missed.len();
    }
    score.frames += run.frames;
    score.certain += run.certain;
    score.seen += run.seen;
    score.strays += run.strays;
    Ok(())
}

fn play_all(seeds: impl IntoIterator<Item = u64>) -> Score {
    let mut score = Score::default();
    for seed in seeds {
        play(seed, &mut score).unwrap();
    }
    score
}

/// Beyond a zone that bent too far to be followed lies an island of markers in agreement, a pitch off. Once
/// nothing ties it to the others, it may not be claimed.
#[test]
fn an_island_beyond_torn_gel_is_held() {
    play_all([17, 31, 40]);
}

/// The border row was detected, but too sparsely to be matched where it was not expected; without it a shift
/// by one row or three explained the matches best, and all markers were taken for others.
#[test]
fn detections_that_match_nothing_count_against_a_shift() {
    play_all([67, 245, 278]);
}

/// All had moved alike, so that an island was believed where it was expected: but its markers had been hidden
/// for frames, and in gel that was squeezed to half a pitch the expectation was wrong by one.
#[test]
fn an_island_of_markers_that_were_hidden_is_held() {
    play_all([491, 1281]);
}

/// Far from all matches nobody knows where a place is: rows extrapolated over half the lattice looked
/// occupied, and hid that a border row was missing.
#[test]
fn places_far_from_all_matches_say_nothing_about_a_shift() {
    play_all([999]);
}

#[test]
fn harsh_sequences_mislabel_nothing_and_hold_little() {
    let score = play_all(0..40);
    println!(
        "seen {} of {} detected, certain {} of {} frames, {} strays",
        score.seen, score.shown, score.certain, score.frames, score.strays
    );
    assert!(score.strays * 10_000 <= score.seen);
    // Measured 0.92 and 0.96 over 400 seeds.
    assert!(10 * score.seen > 9 * score.shown && 10 * score.certain > 9 * score.frames);
}
