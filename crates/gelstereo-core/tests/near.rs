//! The search near expected positions against the search of the whole image.

use crate::support;

use gelstereo_core::detect::{DetectError, Detector, Markers};
use gelstereo_core::detect::{Found, WindowObservation};
use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::{Background, Centre, DetectParams, Threshold};
use proptest::prelude::*;
use support::{Dots, lattice, one_marker_and_what_is_none, paper_lattice, view};

fn rungs() -> Vec<DetectParams> {
    let mut rungs = Vec::new();
    for background in [Background::Gaussian, Background::Blocks] {
        for threshold in [Threshold::Fixed, Threshold::Auto] {
            for (centre, morphology_kernel_px) in [(Centre::Binary, 1), (Centre::Grey, 1), (Centre::Grey, 3)]
            {
                let default = DetectParams::default();
                rungs.push(DetectParams { background, threshold, centre, morphology_kernel_px, ..default });
            }
        }
    }
    rungs
}

fn both(params: &DetectParams, image: &[u8], width: usize, at: &[DVec2], reach_px: f64) -> (Markers, Found) {
    let (mut detector, mut all, mut found) = (Detector::new(params), Markers::default(), Found::default());
    detector.run(view(image, width), &mut all).unwrap();
    detector.run_near(view(image, width), at, reach_px, &mut found).unwrap();
    assert_eq!(found.sights.len(), at.len());
    (all, found)
}

/// Index of the marker of `all` that has the same bits.
fn same(all: &Markers, found: &Markers, m: u32) -> Option<usize> {
    let m = m as usize;
    let index = all.centres_px.iter().position(|c| *c == found.centres_px[m])?;
    let equal =
        all.area_px2[index] == found.area_px2[m] && all.covariance_px2[index] == found.covariance_px2[m];
    equal.then_some(index)
}

/// Expected positions up to 3 px off: every marker is found, each by the position that belongs to it, with the same bits.
#[test]
fn markers_near_expected_positions_have_the_bits_of_the_whole_search() {
    let truth = paper_lattice();
    let mut stream = Stream::new(5, "predictions");
    for params in rungs() {
        let image = Dots { noise: 2.0, seed: 3, ..Dots::new(640, 480, truth.clone()) }.render();
        let mut off = || 6.0 * stream.uniform() - 3.0;
        let expected: Vec<DVec2> = truth.iter().map(|&t| t + DVec2::new(off(), off())).collect();
        let (all, found) = both(&params, &image, 640, &expected, 8.8);
        for (sight, truth) in found.sights.iter().zip(&truth) {
            let WindowObservation::Marker(m) = *sight else { panic!("{sight:?} at {truth}, {params:?}") };
            assert!(found.markers.centres_px[m as usize].distance(*truth) < 0.5);
            assert!(same(&all, &found.markers, m).is_some(), "{params:?}");
        }
    }
}

/// A marker that is not there, one beyond the lattice, one that the border cuts, two that touch, and a place outside the
/// image are not found.
#[test]
fn what_is_no_single_marker_is_not_found() {
    let (image, at) = one_marker_and_what_is_none();
    for params in rungs() {
        let (_, found) = both(&params, &image, 160, &at, 8.5);
        let expected = [WindowObservation::Marker(0), WindowObservation::Nothing, WindowObservation::Nothing];
        assert_eq!(found.sights[..3], expected, "{params:?}");
        assert_eq!(found.sights[3..], [WindowObservation::Unclear; 5], "{params:?}");
    }
}

/// Two positions beside one marker: the nearer one has it. Two markers in one window: neither.
#[test]
fn no_marker_is_given_twice_and_no_position_has_two() {
    let centres = lattice(3, 3, 17.0, DVec2::new(60.2, 50.1), 0.0, 0.0);
    let image = Dots::new(120, 100, centres.clone()).render();
    for params in rungs() {
        let near = centres[4] + DVec2::new(1.0, 0.0);
        let (_, found) = both(&params, &image, 120, &[centres[4] - DVec2::new(2.0, 1.0), near], 8.5);
        assert_eq!(found.sights, [WindowObservation::Unclear, WindowObservation::Marker(0)]);
        let between = (centres[3] + centres[4]) * 0.5;
        let (_, found) = both(&params, &image, 120, &[between], 15.0);
        assert_eq!(found.sights, [WindowObservation::Several]);
    }
}

#[test]
fn row_30_images_without_contrast_are_refused_near_positions_too() {
    let mut found = Found::default();
    for params in rungs() {
        let mut detector = Detector::new(&params);
        let error = detector.run_near(view(&[7; 64 * 48], 64), &[DVec2::splat(20.0)], 8.0, &mut found);
        assert!(matches!(error, Err(DetectError::Flat { low: 7, high: 7, .. })));
        let error = detector.run_near(view(&[7; 64], 64), &[DVec2::splat(20.0)], 8.0, &mut found);
        assert!(matches!(error, Err(DetectError::TooSmall { .. })));
        assert_eq!(found, Found::default());
    }
}

/// Pieces of `mask` within the columns and rows of a window, by flood fill: pixels, and whether an outermost one belongs.
fn pieces(mask: &[u8], width: usize, first: (usize, usize), end: (usize, usize)) -> Vec<(u32, bool)> {
    let inside = |x: usize, y: usize| (first.0..end.0).contains(&x) && (first.1..end.1).contains(&y);
    let (mut seen, mut pieces) = (vec![false; mask.len()], Vec::new());
    for start in (first.1..end.1).flat_map(|y| (first.0..end.0).map(move |x| (x, y))) {
        let (mut open, mut area, mut partial) = (vec![start], 0, false);
        while let Some((x, y)) = open.pop() {
            let at = y * width + x;
            if mask[at] == 0 || std::mem::replace(&mut seen[at], true) {
                continue;
            }
            area += 1;
            partial |= x == first.0 || x == end.0 - 1 || y == first.1 || y == end.1 - 1;
            let around =
                (y.saturating_sub(1)..y + 2).flat_map(|v| (x.saturating_sub(1)..x + 2).map(move |u| (u, v)));
            open.extend(around.filter(|&(u, v)| inside(u, v)));
        }
        if area > 0 {
            pieces.push((area, partial));
        }
    }
    pieces
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// Against a flood fill of the whole search's mask, for any image: a position has a marker if its window has one whole
    /// piece of the right size, nothing if all pieces are too small, and it is always a marker of the whole search.
    #[test]
    fn windows_are_floods_of_the_mask(
        (width, bytes) in (12..80_usize, 12..60_usize).prop_flat_map(|(width, height)| {
            (Just(width), prop::collection::vec(prop_oneof![3 => Just(200_u8), 1 => Just(40)], width * height))
        }),
        at in (-10.0..90.0_f64, -10.0..70.0_f64),
        reach_px in 0.0..31.0_f64,
        blocks in any::<bool>(),
    ) {
        let params = DetectParams {
            background: if blocks { Background::Blocks } else { Background::Gaussian },
            smooth_kernel_px: 1, min_area_px2: 3, max_area_px2: 60, min_fill: 0.0, ..DetectParams::default()
        };
        let at = DVec2::from(at);
        let (mut detector, mut all, mut found) = (Detector::new(&params), Markers::default(), Found::default());
        prop_assume!(detector.run(view(&bytes, width), &mut all).is_ok());
        let mut mask = Vec::new();
        detector.mask(&mut mask);
        detector.run_near(view(&bytes, width), &[at], reach_px, &mut found).unwrap();
        let height = bytes.len() / width;
        let side = |at: f64, size: usize| {
            let first = (at - reach_px).ceil().max(0.0) as usize;
            (first, ((at + reach_px).floor() + 1.0).clamp(0.0, size as f64) as usize)
        };
        let ((x0, x1), (y0, y1)) = (side(at.x, width), side(at.y, height));
        if x0 >= x1 || y0 >= y1 {
            prop_assert_eq!(&found.sights, &[WindowObservation::Unclear]);
            return Ok(());
        }
        let pieces = pieces(&mask, width, (x0, y0), (x1, y1));
        let large = pieces.iter().filter(|(area, _)| *area >= 3);
        let whole = large.clone().filter(|(area, partial)| !partial && *area <= 60).count();
        match found.sights[0] {
            WindowObservation::Marker(m) => {
                prop_assert_eq!(whole, 1);
                prop_assert!(same(&all, &found.markers, m).is_some());
            }
            WindowObservation::Several => prop_assert!(whole > 1),
            WindowObservation::Nothing => prop_assert_eq!(large.count(), 0),
            WindowObservation::Unclear => prop_assert!(whole == 0 && large.count() > 0),
        }
    }
}
