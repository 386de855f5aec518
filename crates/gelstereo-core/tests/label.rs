//! Labels against generated lattices: right, or refused.

use crate::support;

use gelstereo_core::lattice::{LabelError, foresight_sort, rest_lattice};
use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::LatticeParams;
use proptest::prelude::*;
use support::lattice;

const PITCH: f64 = 17.56;
const TOLERANCE: f64 = 1.0 / 3.0;

fn params(rows: usize, cols: usize, max_missing: usize) -> LatticeParams {
    let max_missing_share = max_missing as f64 / (rows * cols) as f64;
    LatticeParams { rows: Some(rows), cols: Some(cols), max_missing_share, ..LatticeParams::default() }
}

/// A permutation of 0..n from a random stream.
fn shuffled(n: usize, stream: &mut Stream) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, stream.below(i + 1));
    }
    order
}

/// Detections of a lattice: some missing, some spurious (none where a marker could be, missing or not),
/// shaken and shuffled.
fn detections(truth: &[DVec2], missing: usize, spurious: usize, jitter_px: f64, seed: u64) -> Vec<DVec2> {
    let mut stream = Stream::new(seed, "detections");
    let mut kept = shuffled(truth.len(), &mut stream);
    kept.truncate(truth.len() - missing);
    let mut found: Vec<DVec2> = kept
        .iter()
        .map(|&n| {
            let (dx, dy) = stream.normal_pair();
            truth[n] + DVec2::new(dx, dy) * jitter_px
        })
        .collect();
    while found.len() < truth.len() - missing + spurious {
        let at = DVec2::new(stream.uniform() * 640.0, stream.uniform() * 480.0);
        if truth.iter().all(|t| t.distance(at) > 0.4 * PITCH) {
            found.push(at);
        }
    }
    let order = shuffled(found.len(), &mut stream);
    order.iter().map(|&n| found[n]).collect()
}

/// The truth, labelled as it is seen: a square lattice turned by more than 45 degrees is one turned back by a
/// quarter.
fn as_seen(side: usize, turn_deg: f64, shear: f64) -> Vec<DVec2> {
    let turn_deg = if turn_deg > 45.0 { turn_deg - 90.0 } else { turn_deg };
    lattice(side, side, PITCH, DVec2::new(330.3, 240.7), turn_deg, shear)
}

/// Two dots of 0.22 mm radius at 0.9 mm pitch that overlap.
fn touching(dots: &[(DVec2, Vec<usize>)]) -> Option<(usize, usize)> {
    let diameter = 0.44 / 0.9 * PITCH;
    let near = |a: usize, b: usize| dots[a].0.distance(dots[b].0) < diameter;
    (0..dots.len()).find_map(|a| (a + 1..dots.len()).find(|&b| near(a, b)).map(|b| (a, b)))
}

/// Dots and the markers in them; the centre of a merged one is the mean of its markers.
fn merge(dots: &mut Vec<(DVec2, Vec<usize>)>, a: usize, b: usize) {
    let (other, mut markers) = dots.remove(b);
    let (mine, theirs) = (dots[a].1.len() as f64, markers.len() as f64);
    dots[a].0 = (dots[a].0 * mine + other * theirs) / (mine + theirs);
    dots[a].1.append(&mut markers);
}

fn farthest(found: &[DVec2], truth: &[DVec2]) -> f64 {
    assert_eq!(found.len(), truth.len());
    found.iter().zip(truth).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

#[test]
fn row_15_moderate_rotation_is_labelled_not_refused() {
    for turn_deg in [-39.0, -20.0, -5.0, 0.0, 3.0, 12.0, 30.0, 39.0] {
        let truth = as_seen(25, turn_deg, 0.0);
        let found = detections(&truth, 5, 5, 0.1, 3);
        let rest = rest_lattice(&found, &params(25, 25, 6), TOLERANCE).unwrap();
        assert!(farthest(&rest.positions_px, &truth) < 0.1 * PITCH, "{turn_deg}");
        assert_eq!(rest.detection.iter().filter(|d| d.is_none()).count(), 5);
        assert!((rest.pitch_px - PITCH).abs() < 0.1);
    }
}

#[test]
fn row_15_foresight_sorts_up_to_five_degrees() {
    let mut order = Vec::new();
    for turn_deg in [-5.0, -2.0, 0.0, 1.0, 5.0] {
        let truth = as_seen(25, turn_deg, 0.0);
        let found = detections(&truth, 0, 0, 0.1, 4);
        foresight_sort(&found, 25, 25, PITCH * TOLERANCE, &mut order).unwrap();
        let sorted: Vec<DVec2> = order.iter().map(|&n| found[n]).collect();
        assert!(farthest(&sorted, &truth) < 1.0, "{turn_deg}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any turn, shear, 10 missing, 5 spurious: right labels or a refusal.
    #[test]
    fn row_15_rest_lattice_never_mislabels(
        turn_deg in 0.0..90.0_f64, shear in -0.4..0.4_f64, missing in 0..=10_usize, spurious in 0..=5_usize,
        jitter_px in 0.0..0.8_f64, seed: u64,
    ) {
        let truth = lattice(25, 25, PITCH, DVec2::new(330.3, 240.7), turn_deg, shear);
        let found = detections(&truth, missing, spurious, jitter_px, seed);
        if let Ok(rest) = rest_lattice(&found, &params(25, 25, 6), TOLERANCE) {
            // A turned square is its own copy turned by a quarter: that labelling is as right, seen from the
            // image.
            let quarter: Vec<DVec2> = (0..625).map(|n| truth[(24 - n % 25) * 25 + n / 25]).collect();
            let off = farthest(&rest.positions_px, &truth).min(farthest(&rest.positions_px, &quarter));
            // Those filled in at an edge are extrapolated: 3 sigma of jitter times sqrt 5.
            prop_assert!(off < 0.5 * PITCH, "{off}");
        }
    }

    #[test]
    fn row_15_foresight_never_mislabels(
        turn_deg in 0.0..90.0_f64, shear in -0.4..0.4_f64, swapped in 0..=10_usize, jitter_px in 0.0..0.8_f64,
        seed: u64,
    ) {
        let truth = lattice(25, 25, PITCH, DVec2::new(330.3, 240.7), turn_deg, shear);
        // As many spurious as missing: the count alone says nothing.
        let found = detections(&truth, swapped, swapped, jitter_px, seed);
        let mut order = Vec::new();
        if foresight_sort(&found, 25, 25, PITCH * TOLERANCE, &mut order).is_ok() {
            let sorted: Vec<DVec2> = order.iter().map(|&n| found[n]).collect();
            let quarter: Vec<DVec2> = (0..625).map(|n| truth[(24 - n % 25) * 25 + n / 25]).collect();
            let off = farthest(&sorted, &truth).min(farthest(&sorted, &quarter));
            prop_assert!(off < 0.5 * PITCH, "{off}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// A bump that drags markers along by up to two pitches, over one to four pitches: rows bend, then fold
    /// over. Merged dots are two markers less and one midway.
    #[test]
    fn row_15_folded_rows_and_merged_dots_are_never_mislabelled(
        turn_deg in -8.0..8.0_f64, (x, y) in (150.0..500.0_f64, 60.0..420.0_f64), width in 1.0..4.0_f64,
        (push_x, push_y) in (-2.0..2.0_f64, -2.0..2.0_f64), merged in 0..4_usize, seed: u64,
    ) {
        let drag = |p: DVec2| {
            let reach = p.distance_squared(DVec2::new(x, y)) / (2.0 * width * width * PITCH * PITCH);
            p + DVec2::new(push_x, push_y) * PITCH * (-reach).exp()
        };
        let truth: Vec<DVec2> = as_seen(25, turn_deg, 0.0).into_iter().map(drag).collect();
        let mut order = Vec::new();
        let found = detections(&truth, 0, 0, 0.0, seed);
        if foresight_sort(&found, 25, 25, PITCH * TOLERANCE, &mut order).is_ok() {
            let sorted: Vec<DVec2> = order.iter().map(|&n| found[n]).collect();
            prop_assert_eq!(&sorted, &truth);
        }
        let mut stream = Stream::new(seed, "merged");
        let mut dots: Vec<(DVec2, Vec<usize>)> =
            truth.iter().enumerate().map(|(n, &p)| (p, vec![n])).collect();
        for _ in 0..merged {
            let n = stream.below(dots.len() - 1);
            // Neighbours only: not the end of a row and the start of the next.
            if dots[n].0.distance(dots[n + 1].0) < 2.0 * PITCH {
                merge(&mut dots, n, n + 1);
            }
        }
        // Dots whose discs touch are seen as one.
        while let Some((a, b)) = touching(&dots) {
            merge(&mut dots, a, b);
        }
        let found: Vec<DVec2> = dots.iter().map(|dot| dot.0).collect();
        // The steepest slope of the bump is push / width e^-1/2. Where it folds, a marker that slipped into
        // the place of a merged one looks as if it belonged there: then none may be missing.
        let steepest = DVec2::new(push_x, push_y).length() / width * 0.61;
        let max_missing = if steepest > 0.4 { 0 } else { 6 };
        let rest = rest_lattice(&found, &params(25, 25, max_missing), TOLERANCE);
        prop_assert!(rest.is_ok() || steepest > 0.2, "gentle bends must be labelled: {rest:?}");
        if let Ok(rest) = rest {
            // Whatever was detected; what is filled in where nothing regular is left cannot be known.
            for n in (0..625).filter(|&n| rest.detection[n].is_some()) {
                let (_, markers) = dots.iter().find(|dot| dot.0 == rest.positions_px[n]).unwrap();
                prop_assert!(markers.contains(&n), "{n} was given to {markers:?}");
            }
        }
    }
}

/// The paper's own sensor: the marker in the upper left corner was never printed.
#[test]
fn row_16_a_missing_corner_is_filled_in() {
    for corner in [0, 24, 600, 624] {
        let truth = as_seen(25, 2.0, 0.0);
        let found: Vec<DVec2> = (0..625).filter(|&n| n != corner).map(|n| truth[n]).collect();
        let rest = rest_lattice(&found, &params(25, 25, 6), TOLERANCE).unwrap();
        assert!(farthest(&rest.positions_px, &truth) < 1e-9);
        assert!((0..625).all(|n| rest.detection[n].is_none() == (n == corner)));
    }
}

#[test]
fn what_is_no_such_lattice_is_refused_by_name() {
    let truth = as_seen(25, 0.0, 0.0);
    let fit = |found: &[DVec2], rows, cols| rest_lattice(found, &params(rows, cols, 6), TOLERANCE);
    assert!(matches!(fit(&truth[..600], 25, 25), Err(LabelError::Shape { rows: 24, labelled: 600, .. })));
    let wider = lattice(25, 26, PITCH, DVec2::new(330.0, 240.0), 0.0, 0.0);
    let cut: Vec<DVec2> = (0..650).filter(|n| n % 26 != 25 || n / 26 % 2 == 0).map(|n| wider[n]).collect();
    for one_more in [&wider, &cut] {
        let rest = fit(one_more, 25, 25).unwrap();
        assert_eq!((rest.rows, rest.cols, rest.left_out), (25, 25, [0, 1, 0, 0]));
    }
    let nan: Vec<DVec2> = truth.iter().copied().chain([DVec2::NAN]).collect();
    assert_eq!(fit(&nan, 25, 25), Err(LabelError::NotFinite { index: 625 }));
    assert_eq!(fit(&[DVec2::ONE; 625], 25, 25), Err(LabelError::NoLattice { found: 625 }));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever the points, an answer is an error by name or a lattice of finite positions.
    #[test]
    fn any_points_have_an_answer(
        scale in prop_oneof![Just(0.0), Just(1e-300), Just(3.0), Just(1e3), Just(1e160), Just(1e308)],
        points in prop::collection::vec((-4..5_i8, -4..5_i8, -0.2..0.2_f64), 0..60),
        (rows, cols, max_missing) in (2..6_usize, 2..6_usize, 0..12_usize),
        strange in prop_oneof![4 => Just(None), 1 => Just(Some(f64::NAN)), 1 => Just(Some(f64::INFINITY))],
    ) {
        let mut points: Vec<DVec2> = points
            .iter()
            .map(|&(x, y, shake)| DVec2::new(f64::from(x) + shake, f64::from(y) - shake) * scale)
            .collect();
        points.extend(strange.map(|value| DVec2::new(1.0, value)));
        let lattice = params(rows, cols, max_missing);
        if let Ok(rest) = rest_lattice(&points, &lattice, TOLERANCE) {
            prop_assert!(
                rest.positions_px.len() == rows * cols && rest.positions_px.iter().all(|p| p.is_finite())
            );
            prop_assert!(rest.pitch_px > 0.0);
        }
        points.resize(rows * cols, DVec2::ONE);
        let mut order = Vec::new();
        let _ = foresight_sort(&points, rows, cols, 0.3 * scale, &mut order);
    }
}
