//! The lattice of a single frame: every place right, whatever the disturbance, and how many are found.

use crate::disturbed;

use disturbed::{MIDDLE, PITCH, SIZE, Scene};
use gelstereo_core::detect::{CutMarker, Markers};
use gelstereo_core::lattice::{
    FoundLattice, LabelError, LatticeFinder, anchor, rest_lattice, rest_lattice_of,
};
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, cos, sin};
use gelstereo_core::params::LatticeParams;
use proptest::prelude::*;

const SEEDS: u64 = 200;

/// Runs a disturbance over fixed seeds: nothing wrong, and all markers placed in at least `least` of the
/// scenes.
fn rate(name: &str, least: u64, scene: impl Fn(&mut Stream) -> Scene) {
    let (mut finder, mut found) = (LatticeFinder::default(), FoundLattice::default());
    let (mut complete, mut refused, mut missed, mut wrong_scenes) = (0, 0, 0, 0);
    for seed in 0..SEEDS {
        let mut stream = Stream::new(seed, name);
        let scene = scene(&mut stream).shuffled(&mut stream);
        if finder.run_markers(&scene.markers(), Some(SIZE), &mut found).is_err() {
            refused += 1;
            continue;
        }
        let (wrong, _, without) = scene.judge(&found);
        wrong_scenes += u64::from(wrong > 0);
        if wrong > 0 {
            let strays =
                scene.labels.iter().zip(&found.places).filter(|(l, p)| l.is_none() && p.is_some()).count();
            println!("{name} seed {seed}: {wrong} wrong, {strays} strays, {without} without");
        }
        complete += u64::from(without == 0);
        missed += without;
    }
    println!(
        "{name}: complete {complete}, refused {refused}, markers without a place {missed}, wrong \
        {wrong_scenes}"
    );
    assert!(complete >= least, "{name}: {complete} of {SEEDS} complete");
    assert!(wrong_scenes == 0);
}

fn turn(p: DVec2, angle: f64) -> DVec2 {
    DVec2::new(cos(angle) * p.x - sin(angle) * p.y, sin(angle) * p.x + cos(angle) * p.y)
}

fn any_turn(stream: &mut Stream) -> f64 {
    stream.uniform() * 360.0
}

#[test]
fn row_15_any_rotation() {
    rate("rotation", SEEDS, |s| Scene::new(25, 25, any_turn(s)).shaken(0.1, s));
    rate("rotation of a strip", SEEDS, |s| Scene::new(7, 19, any_turn(s)).shaken(0.3, s));
}

#[test]
fn row_15_shear_of_two_pitches() {
    rate("shear", SEEDS, |s| {
        let (along, across) = (s.uniform() * 4.0 - 2.0, s.uniform() * 4.0 - 2.0);
        Scene::new(25, 25, any_turn(s))
            .moved(|p| p + DVec2::new(p.y * along, p.x * across) / 24.0)
            .shaken(0.2, s)
    });
    rate("local shear", SEEDS, |s| {
        let (at, push) =
            (DVec2::new(s.uniform() - 0.5, s.uniform() - 0.5) * 300.0, s.uniform() * 2.0 * PITCH);
        let (way, wide) = (turn(DVec2::X, s.uniform() * 7.0), 70.0 + 60.0 * s.uniform());
        Scene::new(25, 25, any_turn(s))
            .moved(|p| p + way * (push * (-p.distance_squared(at) / (2.0 * wide * wide)).exp()))
            .shaken(0.2, s)
    });
}

#[test]
fn row_15_twist_of_thirty_degrees() {
    rate("twist", SEEDS, |s| {
        let (angle, wide) = ((s.uniform() * 2.0 - 1.0) * 30.0_f64.to_radians(), 60.0 + 100.0 * s.uniform());
        Scene::new(25, 25, any_turn(s))
            .moved(|p| turn(p, angle * (-p.length_squared() / (2.0 * wide * wide)).exp()))
            .shaken(0.2, s)
    });
}

#[test]
fn row_15_perspective_and_barrel() {
    rate("perspective", SEEDS, |s| {
        let (x, y, k) = (s.uniform() * 0.5 - 0.25, s.uniform() * 0.5 - 0.25, s.uniform() * 0.2 - 0.12);
        Scene::new(25, 25, any_turn(s))
            .moved(|p| {
                let p = p / (1.0 + (p.x * x + p.y * y) / 500.0);
                p * (1.0 + k * p.length_squared() / 90_000.0)
            })
            .shaken(0.2, s)
    });
}

#[test]
fn row_15_a_fifth_missing() {
    let interior = |r: usize, c: usize| r > 0 && c > 0 && r < 24 && c < 24;
    rate("missing", SEEDS, |s| Scene::new(25, 25, any_turn(s)).shaken(0.2, s).thinned(0.2, s, interior));
    rate("missing anywhere", SEEDS, |s| {
        Scene::new(25, 25, any_turn(s)).shaken(0.2, s).thinned(0.2, s, |_, _| true)
    });
    rate("missing, bent, with specks", 133, |s| {
        let k = s.uniform() * 0.4 - 0.3;
        Scene::new(25, 25, any_turn(s))
            .moved(|p| p * (1.0 + k * p.length_squared() / 90_000.0))
            .shaken(0.2, s)
            .thinned(0.2, s, |_, _| true)
            .speckled(20, s)
    });
}

#[test]
fn row_15_merged_and_specks() {
    rate("merged", SEEDS - 2, |s| Scene::new(25, 25, any_turn(s)).shaken(0.2, s).merged(20, s));
    rate("specks", SEEDS - 12, |s| Scene::new(25, 25, any_turn(s)).shaken(0.2, s).speckled(20, s));
    rate("merged and missing and specks", SEEDS - 5, |s| {
        Scene::new(25, 25, any_turn(s))
            .shaken(0.2, s)
            .merged(10, s)
            .thinned(0.1, s, |_, _| true)
            .speckled(10, s)
    });
}

#[test]
fn row_15_out_of_view_and_smeared() {
    rate("out of view", SEEDS - 22, |s| {
        let shift = DVec2::new(s.uniform() - 0.5, s.uniform() - 0.5) * 300.0;
        Scene::new(25, 25, any_turn(s)).moved(|p| p + shift).shaken(0.2, s).cut()
    });
    rate("smear", SEEDS - 2, |s| {
        let at = MIDDLE + DVec2::new(s.uniform() - 0.5, s.uniform() - 0.5) * 300.0;
        let (axis, long) = (turn(DVec2::X, s.uniform() * 7.0), 40.0 + 80.0 * s.uniform());
        let mut scene = Scene::new(25, 25, any_turn(s)).shaken(0.2, s);
        let hidden = |p: DVec2| (p - at).dot(axis).abs() < long && (p - at).perp_dot(axis).abs() < 0.4 * long;
        for n in (0..scene.points.len()).rev() {
            if hidden(scene.points[n]) {
                scene.points.swap_remove(n);
                scene.labels.swap_remove(n);
            }
        }
        scene.points.push(at);
        scene.labels.push(None);
        scene.smear = Some(at);
        scene
    });
}

/// A quarter missing, merged pairs, specks, and contacts so narrow that they squeeze the lattice to half a
/// pitch.
#[test]
fn row_15_all_at_once() {
    let narrow = |s: &mut Stream, missing: f64, specks: usize| {
        let at = DVec2::new(s.uniform() - 0.5, s.uniform() - 0.5) * 300.0;
        let (way, radius) = (turn(DVec2::X, s.uniform() * 7.0), (3.0 + 2.0 * s.uniform()) * PITCH);
        let (push, twist) = (s.uniform() * 2.0 * PITCH, (s.uniform() - 0.5) * 60.0_f64.to_radians());
        let bend = |p: DVec2| {
            let near = (-p.distance_squared(at) / (radius * radius)).exp();
            at + turn(p - at, twist * near) + way * (push * near)
        };
        Scene::new(25, 25, any_turn(s))
            .moved(bend)
            .shaken(0.1, s)
            .joined(20, s)
            .thinned(missing, s, |_, _| true)
            .speckled(specks, s)
    };
    rate("narrow contacts, a tenth missing", 100, |s| narrow(s, 0.1, 0));
    rate("narrow contacts, a quarter missing, specks", 57, |s| narrow(s, 0.25, 6));
}

#[test]
fn large_lattices() {
    rate("71 x 71", SEEDS - 1, |s| {
        Scene::new(71, 71, any_turn(s)).shaken(0.5, s).thinned(0.1, s, |_, _| true).shuffled(s)
    });
}

/// The whole lattice in view is anchored whatever the motion; the prediction only tells the turn.
#[test]
fn row_15_extents_anchor_a_frame_that_moved_by_more_than_half_a_pitch() {
    let (mut finder, mut found) = (LatticeFinder::default(), FoundLattice::default());
    for seed in 0..SEEDS {
        let mut s = Stream::new(seed, "extents");
        let (turn_deg, motion) = (any_turn(&mut s), turn(DVec2::X, s.uniform() * 7.0) * 1.3 * PITCH);
        let before = Scene::new(15, 15, turn_deg);
        let scene = before.clone().moved(|p| p + motion).shaken(0.2, &mut s);
        let scene = scene.thinned(0.1, &mut s, |_, _| true).speckled(5, &mut s).shuffled(&mut s);
        finder.run(&scene.points, Some(SIZE), &mut found).unwrap();
        let Some(anchored) = anchor(&found, &scene.points, 15, 15, &before.truth) else {
            panic!("{seed}: {:?} {} x {}", found.sides, found.rows, found.cols);
        };
        assert!(anchored.evidence.by_extents);
        assert_eq!(scene.wrong_labels(&found, &anchored), 0, "{seed}");
    }
}

/// Rows that end within a pitch of the image's border: that no marker stands beyond them cannot be seen. A
/// part pressed into half of the gel moves it by 0.4 to 0.7 pitches, so that the prediction does not tell
/// either. But all that were printed are there, and the frame is anchored; with one marker hidden it may not
/// be, and is never wrong.
#[test]
fn row_15_all_markers_anchor_a_frame_whose_border_is_out_of_sight() {
    let (mut finder, mut found) = (LatticeFinder::default(), FoundLattice::default());
    for seed in 0..SEEDS {
        let mut s = Stream::new(seed, "out of sight");
        let before = Scene::new(25, 25, 0.0).moved(|p| p * 1.1);
        let way = turn(DVec2::X, s.uniform() * 7.0) * (0.55 + 0.2 * s.uniform()) * PITCH;
        let pressed = |p: DVec2| p + way / (1.0 + (0.005 * p.length()).powi(6));
        let scene = before.clone().moved(pressed).shaken(0.1, &mut s).shuffled(&mut s);
        finder.run(&scene.points, Some(SIZE), &mut found).unwrap();
        assert!(found.sides.iter().any(|side| !side.ends), "{:?}", found.sides);
        let anchored = anchor(&found, &scene.points, 25, 25, &before.truth).unwrap();
        assert_eq!(scene.wrong_labels(&found, &anchored), 0, "{seed}");
        let mut hidden = scene;
        let m = (s.uniform() * 625.0) as usize;
        hidden.points.remove(m);
        hidden.labels.remove(m);
        finder.run(&hidden.points, Some(SIZE), &mut found).unwrap();
        if let Some(anchored) = anchor(&found, &hidden.points, 25, 25, &before.truth) {
            assert_eq!(hidden.wrong_labels(&found, &anchored), 0, "{seed}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// Out of view, thinned and moved: anchored right or not at all.
    #[test]
    fn row_15_anchors_are_right_or_none(
        seed: u64, turn_deg in 0.0..360.0_f64, motion in 0.0..0.4_f64, shift in 0.0..200.0_f64,
        specks in 0..20_usize, share in 0.0..0.25_f64, pairs in 0..=20_usize,
    ) {
        let mut s = Stream::new(seed, "anchor");
        let (mut finder, mut found) = (LatticeFinder::default(), FoundLattice::default());
        let (away, by) =
            (turn(DVec2::X, s.uniform() * 7.0) * shift, turn(DVec2::X, s.uniform() * 7.0) * motion * PITCH);
        let before = Scene::new(25, 25, turn_deg).moved(|p| p + away);
        let scene = before.clone().moved(|p| p + by).shaken(0.2, &mut s).cut();
        let scene = scene.joined(pairs, &mut s).thinned(share, &mut s, |_, _| true);
        let scene = scene.speckled(specks, &mut s).shuffled(&mut s);
        if finder.run_markers(&scene.markers(), Some(SIZE), &mut found).is_ok() {
            let anchored = anchor(&found, &scene.points, 25, 25, &before.truth);
            // Two specks beyond a corner that is cut by the image may look like one more row.
            let misled = scene.judge(&found).0 > 0;
            let few = scene.points.len() < 200;
            prop_assert!(anchored.is_some() || motion > 0.3 || few || misled, "{:?}", found.sides);
            if let Some(anchored) = anchored {
                prop_assert_eq!(scene.wrong_labels(&found, &anchored), 0);
            }
        }
    }

    /// Any points: an answer, and one that fits its own lists.
    #[test]
    fn any_points_are_placed_or_refused(
        points in prop::collection::vec((-4..5_i8, -4..5_i8, -0.3..0.3_f64), 0..80),
        scale in prop_oneof![Just(0.0), Just(1e-300), Just(1e-3), Just(20.0), Just(1e5), Just(1e300)],
    ) {
        let points: Vec<DVec2> = points
            .iter()
            .map(|&(x, y, off)| DVec2::new(f64::from(x) + off, f64::from(y) - off) * scale)
            .collect();
        let mut found = FoundLattice::default();
        if LatticeFinder::default().run(&points, Some(SIZE), &mut found).is_ok() {
            prop_assert_eq!(found.places.len(), points.len());
            let sites = found.sites();
            for (m, place) in found.places.iter().enumerate() {
                prop_assert!(place.is_none_or(|p| sites.at(p) == Some(m)));
            }
        }
        let _ = anchor(&found, &points, 5, 5, &[DVec2::NAN; 25]);
    }

    /// Rows and columns counted with a fifth missing, border rows too, at any turn: right or refused.
    #[test]
    fn row_15_rest_rows_and_columns_are_counted_right(
        seed: u64, turn_deg in 0.0..360.0_f64, rows in 6..20_usize, cols in 6..20_usize,
        share in 0.0..0.2_f64, specks in 0..10_usize,
    ) {
        let mut s = Stream::new(seed, "rest");
        let scene = Scene::new(rows, cols, turn_deg).shaken(0.2, &mut s);
        let scene = scene.thinned(share, &mut s, |_, _| true).speckled(specks, &mut s).shuffled(&mut s);
        let lattice = LatticeParams { max_missing_share: 0.4, ..LatticeParams::default() };
        match rest_lattice(&scene.points, &lattice, 1.0 / 3.0) {
            Ok(rest) if rest.left_out != [0; 4] => prop_assert!(scene.is_part(&rest)),
            Ok(rest) => {
                prop_assert!(
                    (rest.rows, rest.cols) == (rows, cols) || (rest.rows, rest.cols) == (cols, rows)
                );
                let fits = |turns| {
                    let turned = rest.turned(turns);
                    turned.cols == cols
                        && turned
                            .positions_px
                            .iter()
                            .zip(&scene.truth)
                            .all(|(a, b)| a.distance(*b) < 0.5 * PITCH)
                };
                prop_assert!((0..4).any(fits));
                // Rows run most nearly from left to right.
                let [row, _] = rest.directions();
                prop_assert!(row.x > row.y.abs() * 0.98);
            }
            Err(LabelError::Border { .. } | LabelError::Irregular { .. } | LabelError::Slipped { .. }) => {}
            Err(other) => prop_assert!(specks > 5 || share > 0.15, "{other}"),
        }
    }
}

/// Found by seed 1165789028306446064 of the test above. A whole column was unseen by chance, among specks.
/// The column outside it was then left out, so that 7 x 12 markers were labelled as 7 x 10.
#[test]
fn row_15_a_column_beyond_an_empty_one_is_a_column() {
    let lattice = LatticeParams { max_missing_share: 0.4, ..LatticeParams::default() };
    let mut counted = 0;
    for (turn, specks) in (0..24).flat_map(|turn| (1..10).map(move |specks| (turn, specks))) {
        for share in [0.155, 0.165, 0.175, 0.185, 0.195] {
            let mut s = Stream::new(1_165_789_028_306_446_064, "rest");
            let scene = Scene::new(7, 12, 15.0 * f64::from(turn)).shaken(0.2, &mut s);
            let scene = scene.thinned(share, &mut s, |_, _| true).speckled(specks, &mut s).shuffled(&mut s);
            match rest_lattice(&scene.points, &lattice, 1.0 / 3.0) {
                Ok(rest) => {
                    assert_eq!(rest.rows.min(rest.cols), 7, "turn {turn}, {specks} specks, share {share}");
                    assert_eq!(rest.rows.max(rest.cols), 12, "turn {turn}, {specks} specks, share {share}");
                    counted += 1;
                }
                Err(LabelError::Torn { .. } | LabelError::Slipped { .. }) => {}
                Err(other) => panic!("turn {turn}, {specks} specks, share {share}: {other}"),
            }
        }
    }
    println!("{counted} of 1080 counted");
    assert!(counted > 800, "{counted} of 1080 counted");
}

/// The error of a marker that is hardly too far off once said that 5.9 px is more than 5.9 px, and that of
/// labels that have slipped said that a distance within the limit is beyond it.
#[test]
fn errors_of_labels_say_two_different_numbers() {
    let text = |off_px, most_px| LabelError::Irregular { row: 1, col: 2, off_px, most_px }.to_string();
    assert!(text(5.863, 5.853).contains("lies 5.86 px"), "{}", text(5.863, 5.853));
    assert!(text(5.863, 5.853).contains("at most 5.85 px"));
    assert!(text(9.04, 5.85).contains("lies 9.0 px"));
    let next = 5.86_f64.next_up();
    assert!(text(next, 5.86).contains(&format!("lies {next} px")));
    let slipped = LabelError::Slipped { row: 1, col: 2, off_px: 1.23 }.to_string();
    assert!(slipped.contains("without a label stands 1.2 px from there"), "{slipped}");
}

/// Found by fuzzing: a speck beside the marker that the lattice was grown from was given the same place.
#[test]
fn a_speck_beside_the_seed_has_no_place() {
    let (mut finder, mut found) = (LatticeFinder::default(), FoundLattice::default());
    for n in 0..25 {
        let mut scene = Scene::new(5, 5, 10.0);
        scene.points.push(scene.truth[n] + DVec2::new(2.0, 1.0));
        if finder.run(&scene.points, Some(SIZE), &mut found).is_ok() {
            let sites = found.sites();
            for (m, place) in found.places.iter().enumerate() {
                assert!(place.is_none_or(|place| sites.at(place) == Some(m)), "speck at {n}");
            }
        }
    }
}

/// Two views of one print, near the angle at which either turn is as upright: one is turned like the other.
#[test]
fn row_15_both_views_are_turned_alike_at_45_degrees() {
    for (rows, cols) in [(15, 15), (11, 17)] {
        let one =
            rest_lattice(&Scene::new(rows, cols, 44.0).truth, &LatticeParams::default(), 1.0 / 3.0).unwrap();
        let other =
            rest_lattice(&Scene::new(rows, cols, 46.0).truth, &LatticeParams::default(), 1.0 / 3.0).unwrap();
        assert!(
            one.positions_px[0].distance(other.positions_px[0]) > 5.0 * PITCH,
            "they differ as they come"
        );
        let other = other.turned_like(&one);
        assert_eq!((other.rows, other.cols), (one.rows, one.cols));
        let near = |(a, b): (&DVec2, &DVec2)| a.distance(*b) < PITCH;
        assert!(one.positions_px.iter().zip(&other.positions_px).all(near));
    }
}

/// Corners that were never printed tell the turn, and do not count as missing.
#[test]
fn row_16_markers_never_printed_tell_the_turn() {
    let missing = vec![[0, 0], [0, 1], [2, 14]];
    for turn_deg in [0.0, 80.0, 135.0, 190.0, 271.0] {
        let mut scene = Scene::new(15, 15, turn_deg);
        for label in [32 + 12, 1, 0] {
            scene.points.remove(label);
        }
        let lattice =
            LatticeParams { max_missing_share: 0.0, missing: missing.clone(), ..LatticeParams::default() };
        let rest = rest_lattice(&scene.points, &lattice, 1.0 / 3.0).unwrap();
        let near = |(a, b): (&DVec2, &DVec2)| a.distance(*b) < 1e-6;
        assert!(rest.positions_px.iter().zip(&scene.truth).all(near), "{turn_deg}");
        let wrong =
            LatticeParams { missing: vec![[7, 7]], max_missing_share: 0.1, ..LatticeParams::default() };
        assert!(matches!(
            rest_lattice(&scene.points, &wrong, 1.0 / 3.0),
            Err(LabelError::NeverPrinted { .. })
        ));
    }
}

/// A border row of a few markers is left out, unless the settings say what it is; a speck is none.
#[test]
fn row_15_a_border_row_of_few_markers_is_for_the_settings_to_decide() {
    let scene = Scene::new(16, 15, 10.0);
    let few: Vec<DVec2> = scene.truth.iter().copied().take(15 * 15 + 5).collect();
    let set = |rows| LatticeParams { rows, max_missing_share: 0.05, ..LatticeParams::default() };
    let fit = |points: &[DVec2], rows| rest_lattice(points, &set(rows), 1.0 / 3.0);
    let rest = fit(&few, None).unwrap();
    assert_eq!((rest.rows, rest.cols, rest.left_out), (15, 15, [0, 0, 1, 0]));
    assert_eq!(rest.positions_px, scene.truth[..225]);
    assert_eq!(fit(&few, Some(16)).unwrap().rows, 16);
    assert_eq!(fit(&few, Some(15)).unwrap().positions_px, scene.truth[..225]);
    let speck: Vec<DVec2> = scene.truth.iter().copied().take(15 * 15 + 1).collect();
    assert_eq!(fit(&speck, None).unwrap().rows, 15);
    assert!(matches!(fit(&speck, Some(17)), Err(LabelError::Shape { rows: 15, cols: 15, .. })));
}

proptest! {
    /// A border row is labelled if at least half of its markers are seen, and otherwise left out.
    #[test]
    fn row_15_a_border_row_counts_from_half_its_markers_on(half in 3usize..8, seen_less in -2i32..=2) {
        let cols = 2 * half;
        let scene = Scene::new(11, cols, 10.0);
        let seen = (half as i32 + seen_less) as usize;
        let points: Vec<DVec2> = scene.truth.iter().copied().take(10 * cols + seen).collect();
        let params = LatticeParams { max_missing_share: 0.1, ..LatticeParams::default() };
        let found = rest_lattice(&points, &params, 1.0 / 3.0);
        if 2 * seen >= cols {
            prop_assert_eq!(found.map(|rest| (rest.rows, rest.cols)), Ok((11, cols)));
        } else if seen > 1 {
            prop_assert_eq!(found.map(|rest| (rest.rows, rest.left_out)), Ok((10, [0, 0, 1, 0])));
        }
    }
}

/// Markers cut by the image's border show where a row is, but do not count as its detections.
#[test]
fn row_15_cut_markers_are_no_detections() {
    let scene = Scene::new(12, 9, 3.0);
    let (whole, cut) = scene.truth.split_at(11 * 9);
    let cut = cut.iter().map(|&centre_px| CutMarker {
        centre_px,
        covariance_px2: [[4.0, 0.0], [0.0, 4.0]],
        area_px2: 9,
    });
    let detected = Markers { cut: cut.collect(), ..Markers::at(whole.to_vec(), 0.1) };
    let params = LatticeParams { rows: Some(12), max_missing_share: 0.2, ..LatticeParams::default() };
    let rest = rest_lattice_of(&detected, &params, 1.0 / 3.0).unwrap();
    assert_eq!((rest.rows, rest.cols), (12, 9));
    for (n, detection) in rest.detection.iter().enumerate() {
        assert_eq!(*detection, (n < whole.len()).then_some(n as u32), "{n}");
    }
}
