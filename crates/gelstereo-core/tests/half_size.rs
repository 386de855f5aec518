//! Markers found at half the image's size against those of the search at its own.
#![allow(clippy::unwrap_used)]

use crate::support;

use gelstereo_core::detect::MarkerSize;
use gelstereo_core::detect::{Detector, Markers};
use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::{DetectParams, FindAt, Params, Polarity};
use proptest::prelude::*;
use support::{Dots, lattice, paper_lattice, view};

fn params(find_at: FindAt) -> DetectParams {
    DetectParams { find_at, ..Params::preset("fast").unwrap().detect }
}

fn search(params: &DetectParams, image: &[u8], width: usize) -> (Markers, FindAt) {
    let (mut detector, mut markers) = (Detector::new(params), Markers::default());
    // What does not find anything finds no markers.
    let _ = detector.run(view(image, width), &mut markers);
    (markers, detector.found_at())
}

/// Both searches of an image, and where the first found its markers.
fn both(image: &[u8], width: usize) -> (Markers, Markers, FindAt) {
    let (half, found_at) = search(&params(FindAt::HalfSize), image, width);
    (half, search(&params(FindAt::FullSize), image, width).0, found_at)
}

/// Farthest that two centres of one marker may lie apart. Both weigh the same pixels, but their windows may
/// lie a pixel apart, so that other corners tell the gel's slope: to noise / 20 a pixel, where a corner has 4
/// pixels and the next is 10 px away. Over an edge of 2 px that shifts the centre by a tenth of the slope
/// over half the contrast's share of 120 levels: 0.005 px a level of noise, 0.007 px between two. A largest
/// of some hundred is 3.5 times that; rounding to whole levels adds as much as a level of noise.
fn most_apart_px(noise: f64, contrast: f64) -> f64 {
    3.5 * 0.007 * (noise + 1.0) * 120.0 / contrast
}

/// Farthest apart where the corners of windows reach other markers, which must not be taken for it: a window
/// of one centre may have them on one side, that of the other, a pixel away, on the other side, so this is
/// twice what one does. That is the larger of two, which pull to opposite sides. The gel's plane tilts: by
/// 0.35 of the contrast at most from corners to corners. The share of an edge that is followed, half the
/// contrast, is as wide as half a pixel's diagonal, and its weights change over half the contrast: over a
/// ring of radius r that moves the centre by 2 * 0.35 r / 2^0.5 over the corners' distance. And what reaches
/// into the window weighs itself: at most one pixel in its outermost line, at half its side, over the
/// marker's area.
fn most_apart_beside_others_px(markers: &Markers) -> f64 {
    let count = markers.area_px2.len().max(1) as f64;
    let area_px2 = markers.area_px2.iter().map(|&area| f64::from(area)).sum::<f64>() / count;
    let Some(size) = MarkerSize::of(area_px2) else { return 0.0 };
    let side_px = size.side_px as f64;
    let corner_px = (side_px / 5.0).floor().max(2.0);
    let tilted_px = 0.7 * size.radius_px * 0.5_f64.sqrt() / (side_px - corner_px);
    2.0 * tilted_px.max(0.5 * side_px / area_px2)
}

/// Each has the other's markers, within a distance.
fn agree(half: &Markers, full: &Markers, most_px: f64) -> Result<(), TestCaseError> {
    prop_assert_eq!(half.centres_px.len(), full.centres_px.len());
    for centre in &half.centres_px {
        let apart = full.centres_px.iter().map(|c| c.distance(*centre)).fold(f64::INFINITY, f64::min);
        prop_assert!(apart <= most_px, "{} px apart, at most {}", apart, most_px);
    }
    Ok(())
}

fn dots(side: usize, pitch_px: f64, size_px: (usize, usize)) -> Dots {
    let middle = DVec2::new(size_px.0 as f64, size_px.1 as f64) * 0.5;
    let centres = lattice(side, side, pitch_px, middle + DVec2::new(0.3, -0.2), 0.0, 0.0);
    Dots { noise: 2.0, ..Dots::new(size_px.0, size_px.1, centres) }
}

#[test]
fn clear_markers_are_found_at_half_size() {
    let image = Dots { noise: 2.0, ..Dots::new(640, 480, paper_lattice()) }.render();
    let (half, full, found_at) = both(&image, 640);
    assert_eq!((found_at, half.centres_px.len()), (FindAt::HalfSize, 625));
    agree(&half, &full, most_apart_px(2.0, 120.0)).unwrap();
    let [of_half_px, of_full_px] = [&half, &full].map(|m| support::errors(&m.centres_px, &paper_lattice()).0);
    assert!(of_half_px <= 1.03 * of_full_px, "{of_half_px} {of_full_px}");
    // Bright markers have the bits of dark ones in the negative.
    let bright: Vec<u8> = image.iter().map(|level| !level).collect();
    let params = DetectParams { polarity: Polarity::Bright, ..params(FindAt::HalfSize) };
    let (found, found_at) = search(&params, &bright, 640);
    assert_eq!(found_at, FindAt::HalfSize);
    agree(&found, &half, most_apart_px(2.0, 120.0)).unwrap();
}

/// The mask of an image searched at half size is that of its own, but for edges: a pixel of half the size to
/// each side.
#[test]
fn the_mask_has_the_image_s_size() {
    let image = dots(9, 17.6, (201, 187)).render();
    let masks = [FindAt::HalfSize, FindAt::FullSize].map(|at| {
        let (mut detector, mut markers, mut mask) =
            (Detector::new(&params(at)), Markers::default(), Vec::new());
        detector.run(view(&image, 201), &mut markers).unwrap();
        assert_eq!((markers.centres_px.len(), detector.found_at()), (81, at));
        detector.mask(&mut mask);
        assert_eq!(mask.len(), image.len());
        mask
    });
    let [half, full] = masks.each_ref().map(|mask| mask.iter().filter(|&&set| set > 0).count() as f64);
    assert!((half / full - 1.0).abs() < 0.1, "{half} {full}");
    let differ = masks[0].iter().zip(&masks[1]).filter(|(a, b)| a != b).count() as f64;
    // An outline of 2 pi r pixels, half of whose pixels may fall to either side.
    assert!(differ / full < std::f64::consts::PI * 4.3 / 58.0, "{differ} of {full}");
}

/// Lattice without its middle.
fn dots_around_a_gap() -> Dots {
    let mut dots = dots(9, 17.6, (200, 200));
    dots.centres_px.retain(|c| (*c - 100.0).abs().max_element() > 40.0);
    dots
}

/// What half the size may hide is searched at full size, with the bits of that search.
#[test]
fn images_that_half_the_size_may_not_show_are_searched_at_their_own() {
    let clear = dots(9, 17.6, (200, 200));
    let mut pair = clear.clone();
    // 0.8 px of gel between two dots.
    pair.centres_px[40] = pair.centres_px[41] - DVec2::new(9.4, 0.0);
    let mut at_border = clear.clone();
    at_border.centres_px.push(DVec2::new(100.0, 5.6));
    let cases = [
        ("fine dots", Dots { radius_px: 2.5, ..clear.clone() }.render()),
        ("noise", Dots { noise: 18.0, ..clear.clone() }.render()),
        ("a pair", pair.render()),
        ("a pixel from the border", at_border.render()),
        ("the finest print", Dots { radius_px: 1.35, ..dots(41, 4.6, (200, 200)) }.render()),
        ("fine dots beside the middle", Dots { radius_px: 2.5, ..dots_around_a_gap() }.render()),
    ];
    for (name, image) in &cases {
        let (half, full, found_at) = both(image, 200);
        assert_eq!(found_at, FindAt::FullSize, "{name}");
        assert_eq!(half, full, "{name}");
    }
    assert_eq!(both(&clear.render(), 200).2, FindAt::HalfSize);
    // Settings with other centres never look at half size.
    let params = DetectParams { find_at: FindAt::HalfSize, ..Params::preset("balanced").unwrap().detect };
    assert_eq!(search(&params, &clear.render(), 200).1, FindAt::FullSize);
}

/// Of markers of very different sizes either may be the usual one; what is a speck beside the largest only,
/// or is only as large as a pixel's rounding makes it, is searched at full size.
#[test]
fn specks_are_specks_beside_any_of_the_markers() {
    let images = [
        (
            10_942_344_925_863_980,
            vec![
                (17.383, 66.42, 5.595),
                (31.414, 92.739, 2.905),
                (78.953, 87.869, 4.803),
                (80.452, 37.915, 1.116),
            ],
        ),
        (80_153_246_442_961_485, vec![(139.558, 80.191, 2.594), (8.109, 102.787, 1.217)]),
    ];
    for (seed, places) in images {
        let image = disorder(&places, None, seed);
        let (half, full, _) = both(&image, 160);
        agree(&half, &full, most_apart_px(2.0, 120.0) + most_apart_beside_others_px(&half)).unwrap();
    }
}

/// A disc that covers a pixel less than the others of its size is still a marker: what is a speck beside one
/// that has them all is searched at full size.
#[test]
fn specks_are_specks_beside_a_marker_that_lacks_a_pixel() {
    let places = [
        (9.339805030280903, 75.3172002628108, 2.83818009628251),
        (86.98174563324311, 11.10813554612633, 4.74112023911647),
    ];
    let image = disorder(&places, None, 5_404_161_944_440_476_195);
    let (half, full, _) = both(&image, 160);
    agree(&half, &full, most_apart_px(2.0, 120.0) + most_apart_beside_others_px(&half)).unwrap();
}

/// A scratch a row high is gone at half the size. At its own it joins a marker, which is then none by its
/// shape: half the size shows one that the other hides.
#[test]
fn a_scratch_that_hides_a_marker_at_full_size_hides_none_at_half() {
    let places = [
        (85.947315103377, 14.134953067946961, 5.270321301729882),
        (76.12140214846397, 65.65559835576363, 5.892193312384194),
        (29.706007246277398, 37.227834179737755, 4.569679275952735),
    ];
    let scratch = (45, 64, 26);
    let image = disorder(&places, Some(scratch), 193_129_156_384_199_387);
    let (half, full, found_at) = both(&image, 160);
    assert_eq!((found_at, half.centres_px.len(), full.centres_px.len()), (FindAt::HalfSize, 3, 2));
    let most_px = most_apart_px(2.0, 120.0) + most_apart_beside_others_px(&half);
    agree_on_clear_dots((&half, &full), &places, Some(scratch), most_px).unwrap();
}

/// Smallest gap between two dots that are found as two at half the size. One clear pixel of gel must lie
/// between them. Its neighbours blur it from both sides, so two pixels are needed: four of full size.
const GAP_PX: f64 = 4.0;

/// Radii of one print differ by less. Among few dots whose areas differ by more than two times either size
/// may have the smaller one for a speck.
const ALIKE: f64 = 0.7;

/// Whether a dot (x, y, radius) lies clear of another.
fn is_clear(one: &(f64, f64, f64), other: &(f64, f64, f64)) -> bool {
    (one.0 - other.0).hypot(one.1 - other.1) >= one.2 + other.2 + GAP_PX
}

/// Whether a dot lies clear of a scratch (x, y, length).
fn is_off(dot: &(f64, f64, f64), scratch: (usize, usize, usize)) -> bool {
    let (x, y, length) = (scratch.0 as f64, scratch.1 as f64, scratch.2 as f64);
    (dot.0 - dot.0.clamp(x, x + length)).hypot(dot.1 - y) >= dot.2 + GAP_PX
}

/// Dots (x, y, radius) of a size with the widest that lie clear of all else and are found at full size are
/// found at half, and what is found at half only lies on a dot: what touches another, or a scratch, may be
/// one marker at one size, and two or none at the other.
fn agree_on_clear_dots(
    (half, full): (&Markers, &Markers),
    places: &[(f64, f64, f64)],
    scratch: Option<(usize, usize, usize)>,
    most_px: f64,
) -> Result<(), TestCaseError> {
    let apart_px = |at: DVec2, others: &[DVec2]| {
        others.iter().map(|other| other.distance(at)).fold(f64::INFINITY, f64::min)
    };
    let is_on = |at: DVec2, place: &(f64, f64, f64)| at.distance(DVec2::new(place.0, place.1)) <= place.2;
    let widest_px = places.iter().map(|place| place.2).fold(0.0, f64::max);
    for (n, place) in places.iter().enumerate() {
        let mut others = places[..n].iter().chain(&places[n + 1..]);
        let is_alone = others.all(|other| is_clear(place, other)) && scratch.is_none_or(|s| is_off(place, s));
        if !is_alone || place.2 < ALIKE * widest_px {
            continue;
        }
        for &centre in full.centres_px.iter().filter(|&&centre| is_on(centre, place)) {
            let apart = apart_px(centre, &half.centres_px);
            prop_assert!(apart <= most_px, "{} is lost: {} px, at most {}", centre, apart, most_px);
        }
    }
    for &centre in &half.centres_px {
        let apart = apart_px(centre, &full.centres_px);
        let is_dot = places.iter().any(|place| is_on(centre, place));
        prop_assert!(is_dot || apart <= most_px, "{} is none: {} px, at most {}", centre, apart, most_px);
    }
    Ok(())
}

/// Dots (x, y, radius) on white of 160 x 120 pixels, a scratch (x, y, length), and noise of 2 levels.
fn disorder(places: &[(f64, f64, f64)], scratch: Option<(usize, usize, usize)>, seed: u64) -> Vec<u8> {
    let mut image = vec![u8::MAX; 160 * 120];
    for &(x, y, radius_px) in places {
        let one = Dots { radius_px, ..Dots::new(160, 120, vec![DVec2::new(x, y)]) }.render();
        image.iter_mut().zip(one).for_each(|(level, other)| *level = other.min(*level));
    }
    if let Some((x, y, length)) = scratch {
        image[y * 160 + x..][..length.min(160 - x)].fill(70);
    }
    let mut stream = Stream::new(seed, "noise");
    image.iter().map(|&level| (f64::from(level) + 2.0 * stream.normal()) as u8).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever the lattice, the light and the noise, both find the same markers; those found at full size
    /// have its bits.
    #[test]
    fn the_same_markers_are_found_at_both_sizes(
        (pitch_px, share) in (9.0..26.0_f64, 0.17..0.3_f64),
        (turn_deg, shear) in (0.0..90.0_f64, -0.2..0.2_f64),
        (noise, contrast) in (0.0..8.0_f64, 25.0..140.0_f64),
        slope in (-0.1..0.1_f64, -0.1..0.1_f64),
        (width, height) in (190..222_usize, 190..222_usize),
        seed in any::<u64>(),
    ) {
        let middle = DVec2::new(width as f64, height as f64) * 0.5;
        let image = Dots {
            noise,
            seed,
            contrast: -contrast,
            slope: DVec2::from(slope),
            radius_px: share * pitch_px,
            ..Dots::new(width, height, lattice(6, 6, pitch_px, middle, turn_deg, shear))
        }
        .render();
        let (half, full, found_at) = both(&image, width);
        let radius_px = share * pitch_px;
        // Half the diagonal of a window, another marker beyond it with its edge, and shear.
        let apart_px = 0.9 * pitch_px - radius_px - 1.0 - 2.0_f64.sqrt() * (radius_px + 4.0);
        let others_px = if apart_px > 0.0 { 0.0 } else { most_apart_beside_others_px(&half) };
        let most_px = most_apart_px(noise, contrast) + others_px;
        match found_at {
            FindAt::HalfSize => agree(&half, &full, most_px)?,
            FindAt::FullSize => prop_assert_eq!(half, full),
        }
    }

    /// So do they in images of dots of all sizes, anywhere: touching, cut, specks, and scratches.
    #[test]
    fn the_same_markers_are_found_in_any_disorder(
        places in prop::collection::vec((-3.0..163.0_f64, -3.0..123.0_f64, 2.0..6.0_f64), 1..10),
        specks in prop::collection::vec((0.0..160.0_f64, 0.0..120.0_f64, 0.3..1.5_f64), 0..4),
        scratch in prop::option::of((0..150_usize, 0..118_usize, 1..40_usize)),
        seed in any::<u64>(),
    ) {
        let places: Vec<_> = places.into_iter().chain(specks).collect();
        let image = disorder(&places, scratch, seed);
        let (half, full, found_at) = both(&image, 160);
        match found_at {
            FindAt::HalfSize => {
                let most_px = most_apart_px(2.0, 120.0) + most_apart_beside_others_px(&half);
                agree_on_clear_dots((&half, &full), &places, scratch, most_px)?;
            }
            FindAt::FullSize => prop_assert_eq!(half, full),
        }
    }
}
