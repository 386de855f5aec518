//! The search in windows against known dots and against the search of the whole image.
#![allow(clippy::unwrap_used)]

use crate::support;

use gelstereo_core::detect::{Detector, Markers};
use gelstereo_core::detect::{Found, WindowObservation};
use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::{DetectParams, Params, Polarity};
use proptest::prelude::*;
use support::{Dots, lattice, one_marker_and_what_is_none, paper_lattice, view};

/// Area of the dots of [`Dots::new`], r = 4.3 px.
const AREA_PX2: f64 = 58.0;

const REACH_PX: f64 = 8.8;

fn params() -> DetectParams {
    Params::preset("fast").unwrap().detect
}

fn windows(params: &DetectParams, image: &[u8], width: usize, at: &[DVec2], reach_px: f64) -> Found {
    let (mut detector, mut found) = (Detector::new(params), Found::default());
    let size = detector.size_for_windows(AREA_PX2, 17.6).unwrap();
    detector.run_windows(view(image, width), at, reach_px, &size, &mut found);
    assert_eq!(found.sights.len(), at.len());
    found
}

/// Expected positions up to 3 px off. The search of the whole image weighs the same pixels, but its windows
/// may lie a pixel away, so that other corners tell the gel's slope. Each corner is the mean of 9 pixels, 13
/// px apart: the slope is known to noise / 39 a pixel, and over the 40 pixels of the edge, at a mean squared
/// distance of 9 px², against weights of 58 times half of 120 levels, shifts the centre by 0.1 / 39 px per
/// level of noise, here 0.005 px. A maximum of 1250 differences is 5 times that, and rounding to whole levels
/// as much again.
#[test]
fn markers_are_found_in_windows_as_in_the_whole_image() {
    let truth = paper_lattice();
    let mut stream = Stream::new(5, "predictions");
    for (noise, most_px) in [(0.0, 0.025), (2.0, 0.05)] {
        let image = Dots { noise, seed: 3, ..Dots::new(640, 480, truth.clone()) }.render();
        let mut all = Markers::default();
        Detector::new(&params()).run(view(&image, 640), &mut all).unwrap();
        let mut off = || 6.0 * stream.uniform() - 3.0;
        let expected: Vec<DVec2> = truth.iter().map(|&t| t + DVec2::new(off(), off())).collect();
        let found = windows(&params(), &image, 640, &expected, REACH_PX);
        for (sight, truth) in found.sights.iter().zip(&truth) {
            let WindowObservation::Marker(m) = *sight else { panic!("{sight:?} at {truth}, noise {noise}") };
            let centre = found.markers.centres_px[m as usize];
            assert!(centre.distance(*truth) < 0.2, "{centre} for {truth}");
            let apart = all.centres_px.iter().map(|c| c.distance(centre)).fold(f64::INFINITY, f64::min);
            assert!(apart <= most_px, "{apart} px, noise {noise}");
        }
    }
}

/// The fit from a window's centre, with the usual marker's form, errs by a tenth more at most than the fit
/// from a component's mean position and spread.
#[test]
fn fits_from_windows_are_as_good_as_those_of_the_whole_image() {
    let truth = paper_lattice();
    let params = Params::preset("balanced").unwrap().detect;
    let image = Dots { noise: 2.0, seed: 3, ..Dots::new(640, 480, truth.clone()) }.render();
    let (mut detector, mut all, mut found) = (Detector::new(&params), Markers::default(), Found::default());
    detector.run(view(&image, 640), &mut all).unwrap();
    let size = detector.size_for_windows(AREA_PX2, 17.6).unwrap();
    let expected: Vec<DVec2> = truth.iter().map(|&t| t + DVec2::new(1.3, -0.8)).collect();
    detector.run_windows(view(&image, 640), &expected, REACH_PX, &size, &mut found);
    assert_eq!((found.markers.centres_px.len(), found.markers.unfitted), (625, all.unfitted));
    let [whole_px, windows_px] = [&all, &found.markers].map(|m| support::errors(&m.centres_px, &truth).0);
    assert!(windows_px <= 1.1 * whole_px, "{windows_px} {whole_px}");
}

/// A marker that is not there, one beyond the lattice, one that the border cuts, two that touch, and a place
/// outside the image are not found.
#[test]
fn what_is_no_single_marker_is_not_found() {
    let (image, at) = one_marker_and_what_is_none();
    let found = windows(&params(), &image, 160, &at, 8.5);
    assert_eq!(
        found.sights[..3],
        [WindowObservation::Marker(0), WindowObservation::Nothing, WindowObservation::Nothing]
    );
    assert_eq!(found.sights[3..], [WindowObservation::Unclear; 5]);
    assert_eq!(found.markers.centres_px.len(), 1);
}

/// Two positions beside one marker: the nearer one has it. Two markers in reach: neither.
#[test]
fn no_marker_is_given_twice_and_no_position_has_two() {
    let centres = lattice(3, 3, 17.0, DVec2::new(60.2, 50.1), 0.0, 0.0);
    let image = Dots::new(120, 100, centres.clone()).render();
    let near = centres[4] + DVec2::new(1.0, 0.0);
    let found = windows(&params(), &image, 120, &[centres[4] - DVec2::new(2.0, 1.0), near], 8.5);
    assert_eq!(found.sights, [WindowObservation::Unclear, WindowObservation::Marker(0)]);
    let found = windows(&params(), &image, 120, &[near, centres[4] - DVec2::new(2.0, 1.0)], 8.5);
    assert_eq!(found.sights, [WindowObservation::Marker(0), WindowObservation::Unclear]);
    let between = (centres[3] + centres[4]) * 0.5;
    let found = windows(&params(), &image, 120, &[between], 15.0);
    assert_eq!(found.sights, [WindowObservation::Several]);
}

/// A marker in contact with dirt is not taken for a marker elsewhere: its window says that it is not clear.
#[test]
fn a_smear_over_half_a_marker_is_unclear() {
    let truth = paper_lattice();
    let mut image = Dots { noise: 2.0, ..Dots::new(640, 480, truth.clone()) }.render();
    let covered = truth[300];
    for y in covered.y as usize - 9..covered.y as usize + 9 {
        let x = covered.x as usize;
        image[y * 640 + x..y * 640 + x + 9].fill(60);
    }
    let found = windows(&params(), &image, 640, &truth, REACH_PX);
    assert_eq!(found.sights[300], WindowObservation::Unclear);
    let rest = found.sights.iter().filter(|s| matches!(s, WindowObservation::Marker(_))).count();
    assert_eq!(rest, 624);
}

/// Faint, dim and noisy: all found, none false, at every place and in the middle of four, where nothing is.
#[test]
fn markers_are_found_in_windows_under_all_conditions() {
    let truth = paper_lattice();
    let middles: Vec<DVec2> = truth.iter().map(|&t| t + DVec2::splat(8.8)).collect();
    let slope = DVec2::new(0.15, -0.1);
    for (ground, contrast, noise, slope) in [
        (170.0, -25.0, 2.0, DVec2::ZERO),
        (60.0, -40.0, 2.0, DVec2::ZERO),
        (170.0, -120.0, 18.0, DVec2::ZERO),
        (250.0, -245.0, 2.0, DVec2::ZERO),
        (40.0, -30.0, 1.0, DVec2::ZERO),
        (150.0, -60.0, 2.0, slope),
    ] {
        let dots = Dots { ground, contrast, noise, slope, seed: 7, ..Dots::new(640, 480, truth.clone()) };
        let image = dots.render();
        let condition = (ground, contrast, noise);
        let at: Vec<DVec2> = truth.iter().chain(&middles).copied().collect();
        let found = windows(&params(), &image, 640, &at, 6.0);
        let (seen, empty) = found.sights.split_at(truth.len());
        for (sight, truth) in seen.iter().zip(&truth) {
            let WindowObservation::Marker(m) = *sight else { panic!("{sight:?} at {truth}: {condition:?}") };
            assert!(found.markers.centres_px[m as usize].distance(*truth) < 1.0);
        }
        let false_ones = empty
            .iter()
            .filter(|s| matches!(s, WindowObservation::Marker(_) | WindowObservation::Several))
            .count();
        assert_eq!(false_ones, 0, "{condition:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever the image: every marker belongs to one position and lies within its reach; bright markers are
    /// dark ones of the inverted image; and a second look sees the same bits.
    #[test]
    fn any_image_is_searched_alike_twice(
        (width, bytes) in (16..80_usize, 12..60_usize).prop_flat_map(|(width, height)| {
            let level = prop_oneof![5 => Just(200_u8), 1 => Just(40), 1 => any::<u8>()];
            (Just(width), prop::collection::vec(level, width * height))
        }),
        dots in prop::collection::vec((0.0..80.0_f64, 0.0..60.0_f64), 0..6),
        at in prop::collection::vec((-10.0..90.0_f64, -10.0..70.0_f64), 1..12), reach_px in 0.0..40.0_f64,
    ) {
        let mut bytes = bytes;
        for (x, y) in dots {
            for (n, level) in bytes.iter_mut().enumerate() {
                let off = DVec2::new((n % width) as f64 - x, (n / width) as f64 - y);
                let length = off.length();
                if length < 9.0 {
                    *level = if length < 4.3 { 50 } else { 190 };
                }
            }
        }
        let at: Vec<DVec2> = at.into_iter().map(DVec2::from).collect();
        let found = windows(&params(), &bytes, width, &at, reach_px);
        prop_assert_eq!(&found, &windows(&params(), &bytes, width, &at, reach_px));
        let mut taken = Vec::new();
        for (sight, at) in found.sights.iter().zip(&at) {
            if let WindowObservation::Marker(m) = *sight {
                prop_assert!(!taken.contains(&m));
                taken.push(m);
                let off = found.markers.centres_px[m as usize] - *at;
                prop_assert!(off.abs().max_element() <= reach_px);
            }
        }
        prop_assert_eq!(taken.len(), found.markers.centres_px.len());
        for (n, a) in found.markers.centres_px.iter().enumerate() {
            prop_assert!(found.markers.centres_px[..n]
                .iter()
                .all(|b| a.distance(*b) > found.apart_px * (1.0 - 1e-9)));
            prop_assert!(found.apart_px > 1.0);
        }
        let inverted: Vec<u8> = bytes.iter().map(|level| 255 - level).collect();
        let bright = DetectParams { polarity: Polarity::Bright, ..params() };
        prop_assert_eq!(&found, &windows(&bright, &inverted, width, &at, reach_px));
    }
}
