//! Which printed row is which, where the frame alone or the prediction alone would mislead: right, or not
//! claimed.
#![allow(clippy::unwrap_used)]

use crate::disturbed;

use disturbed::{MIDDLE, PITCH, SIZE, Scene};
use gelstereo_core::lattice::{Anchor, FoundLattice, LatticeFinder, anchor};
use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;
use proptest::prelude::*;

/// The anchor of a scene whose markers are predicted at `before`.
fn anchored(
    scene: &Scene,
    before: &Scene,
    size_px: Option<(usize, usize)>,
) -> (FoundLattice, Option<Anchor>) {
    let mut found = FoundLattice::default();
    LatticeFinder::default().run(&scene.points, size_px, &mut found).unwrap();
    let anchor = anchor(&found, &scene.points, scene.rows, scene.cols, &before.truth);
    (found, anchor)
}

/// Up to 10 degrees beside a quarter turn: an image's corner then cuts two sides of a lattice, and no more.
fn upright() -> impl Strategy<Value = f64> {
    (0..4_u8, -10.0..10.0_f64).prop_map(|(quarter, off)| 90.0 * f64::from(quarter) + off)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, failure_persistence: None, ..ProptestConfig::default() })]

    /// A border row or two that the detector missed altogether, gel in view where they are: the sides seem to
    /// end there, but lie too near to each other.
    #[test]
    fn row_15_a_hidden_border_row_shifts_no_label(
        turn_deg in 0.0..360.0_f64, hidden in prop::array::uniform4(0..3_usize), motion in 0.0..0.3_f64,
        seed: u64,
    ) {
        let mut s = Stream::new(seed, "hidden rows");
        let before = Scene::new(15, 15, turn_deg);
        let by = DVec2::from_angle(s.uniform() * 7.0) * (motion * PITCH);
        let [upper, right, lower, left] = hidden;
        let is_hidden =
            |r: usize, c: usize| r < upper || r + lower >= 15 || c < left || c + right >= 15;
        let scene = before.clone().moved(|p| p + by).thinned(1.0, &mut s, is_hidden);
        let scene = scene.shaken(0.2, &mut s).shuffled(&mut s);
        let (found, anchor) = anchored(&scene, &before, Some(SIZE));
        prop_assert!(found.sides.iter().all(|side| side.ends), "{:?}", found.sides);
        prop_assert!(anchor.is_some() || hidden != [0; 4]);
        if let Some(anchor) = anchor {
            prop_assert_eq!(scene.wrong_labels(&found, &anchor), 0);
        }
    }

    /// Two borders out of view and two in it, and a move by about a pitch, by which the frame looks as
    /// predicted but for the borders in view.
    #[test]
    fn row_15_one_border_in_view_contradicts_a_prediction_one_pitch_off(
        turn_deg in upright(), away in (180.0..280.0_f64, 110.0..200.0_f64),
        sign in (any::<bool>(), any::<bool>()), pitches in (-1..2_i32, -1..2_i32),
        off in (-0.2..0.2_f64, -0.2..0.2_f64), seed: u64,
    ) {
        let mut s = Stream::new(seed, "one border");
        let signed = |length: f64, negative: bool| if negative { -length } else { length };
        let away = DVec2::new(signed(away.0, sign.0), signed(away.1, sign.1));
        let by = DVec2::new(f64::from(pitches.0) + off.0, f64::from(pitches.1) + off.1) * PITCH;
        let before = Scene::new(15, 15, turn_deg).moved(|p| p + away);
        let by = DVec2::from_angle(turn_deg.to_radians()).rotate(by);
        let scene = before.clone().moved(|p| p + by).shaken(0.2, &mut s).cut().shuffled(&mut s);
        prop_assume!(scene.points.len() > 40);
        let (found, anchor) = anchored(&scene, &before, Some(SIZE));
        let sides_seen = |low: usize, high: usize| found.sides[low].ends || found.sides[high].ends;
        prop_assume!(sides_seen(0, 2) && sides_seen(1, 3));
        // The prediction is right, and the borders agree: there is no reason to hold.
        prop_assert!(anchor.is_some() || pitches != (0, 0));
        if let Some(anchor) = anchor {
            prop_assert_eq!(scene.wrong_labels(&found, &anchor), 0);
        }
    }

    /// Rows foreshortened to a share of the columns' pitch, seen through a slit along them that shows no
    /// border. Of a move by m of their steps the nearest shift is off by m or 1 - m, the next by the other:
    /// no move of up to 1.8 / 2.8 of a step, less noise, may be taken for the nearest row's.
    #[test]
    fn row_15_foreshortened_rows_are_not_taken_for_the_next_ones(
        turn_deg in 0.0..360.0_f64, share in 0.6..0.8_f64, moved in -0.62..0.62_f64, seed: u64,
    ) {
        let mut s = Stream::new(seed, "foreshortened");
        let along = DVec2::from_angle(turn_deg.to_radians());
        let squeeze = |p: DVec2| along * p.dot(along) + along.perp() * (p.dot(along.perp()) * share);
        let before = Scene::new(41, 41, turn_deg).moved(squeeze);
        let by = along.perp() * (moved * share * PITCH);
        let mut scene = before.clone().moved(|p| p + by);
        let in_slit =
            |p: DVec2| (p - MIDDLE).dot(along).abs() < 250.0 && (p - MIDDLE).perp_dot(along).abs() < 90.0;
        scene.labels.retain(|label| label.is_some_and(|n| in_slit(scene.truth[n])));
        scene.points.retain(|&p| in_slit(p));
        let scene = scene.shaken(0.2, &mut s).shuffled(&mut s);
        let (found, anchor) = anchored(&scene, &before, None);
        prop_assert!(anchor.is_some() || moved.abs() > 0.34, "{moved}");
        if let Some(anchor) = anchor {
            prop_assert_eq!(scene.wrong_labels(&found, &anchor), 0);
        }
    }
}

proptest! {
    /// The print ends at a side if two fifths of the places beyond it are in view, by half a pitch, and
    /// empty.
    #[test]
    fn row_15_a_side_ends_where_enough_beyond_it_is_in_view(turn_deg in -4.0..4.0_f64, off in -0.6..0.6_f64) {
        let scene = Scene::new(15, 15, turn_deg);
        let row = &scene.truth[14 * 15..];
        let down = row[0] - scene.truth[13 * 15];
        let height = (row[7].y + (1.5 + off) * PITCH) as usize;
        let mut found = FoundLattice::default();
        LatticeFinder::default().run(&scene.points, Some((640, height)), &mut found).unwrap();
        // Within a pixel of the bound, where the image is said to end decides.
        let in_view = |allowance_px: f64| {
            let last = height as f64 - 0.5 * PITCH + allowance_px;
            row.iter().filter(|&&at| (at + down).y <= last).count()
        };
        if 5 * in_view(-1.0) >= 2 * 15 {
            prop_assert!(found.sides[2].ends, "{:?}", found.sides[2]);
        } else if 5 * in_view(1.0) < 2 * 15 {
            prop_assert!(!found.sides[2].ends, "{:?}", found.sides[2]);
        }
    }
}
