//! Detection against dots whose centres are known.

use crate::support;

use gelstereo_core::detect::{DetectError, Detector, Markers};
use gelstereo_core::digest::Digest;
use gelstereo_core::image::GrayView;
use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::{Background, Centre, DetectParams, Params, Polarity, Threshold};
use proptest::prelude::*;
use support::{Dots, errors, lattice, paper_lattice, view};

fn detect(params: &DetectParams, image: &[u8], width: usize) -> Result<Markers, DetectError> {
    let mut markers = Markers::default();
    Detector::new(params).run(view(image, width), &mut markers)?;
    Ok(markers)
}

fn every_rung() -> Vec<DetectParams> {
    let mut rungs = Vec::new();
    for background in [Background::Gaussian, Background::Blocks] {
        for threshold in [Threshold::Fixed, Threshold::Auto] {
            for centre in [Centre::Binary, Centre::Grey, Centre::SoftThreshold] {
                rungs.push(DetectParams { background, threshold, centre, ..DetectParams::default() });
            }
        }
    }
    rungs
}

#[test]
fn every_rung_finds_every_dot() {
    let truth = paper_lattice();
    for noise in [0.0, 2.0] {
        let dots = Dots { noise, ..Dots::new(640, 480, truth.clone()) };
        for params in every_rung() {
            let markers = detect(&params, &dots.render(), 640).unwrap();
            let (rms, near) = errors(&markers.centres_px, &truth);
            assert_eq!((markers.centres_px.len(), near), (625, 625));
            // Binary: an edge pixel counts or not, 2 pi r = 27 pixels of variance 1/12 at lever r / sqrt 2,
            // over 58. Band: the share of an edge pixel is stretched about 0.4 and cut off, by a variance of
            // 0.021.
            let most = match params.centre {
                Centre::Binary => 0.13,
                Centre::SoftThreshold => 0.065,
                _ => 0.02,
            };
            assert!(rms <= most, "{params:?} noise {noise}: {rms}");
        }
    }
}

#[test]
fn bright_dots_are_dark_dots_of_the_inverted_image() {
    let dark = Dots {
        noise: 2.0,
        ..Dots::new(160, 120, support::lattice(5, 7, 17.0, DVec2::new(80.2, 60.1), 3.0, 0.0))
    }
    .render();
    let bright: Vec<u8> = dark.iter().map(|v| 255 - v).collect();
    for params in every_rung() {
        let expected = detect(&params, &dark, 160).unwrap();
        assert_eq!(expected.centres_px.len(), 35);
        let found = detect(&DetectParams { polarity: Polarity::Bright, ..params }, &bright, 160).unwrap();
        assert_eq!(found.area_px2, expected.area_px2);
        for (a, b) in found.centres_px.iter().zip(&expected.centres_px) {
            // Rounding of the fixed-point filters is not symmetric.
            assert!(a.distance(*b) < 1e-3, "{a} {b}");
        }
    }
}

/// Whether a flood of 8-neighbours over the mask from `start` comes to the outermost pixels.
fn flood_reaches_the_border(mask: &[u8], (width, height): (usize, usize), start: (usize, usize)) -> bool {
    let (mut seen, mut open) = (vec![false; mask.len()], vec![start]);
    let mut reaches = false;
    while let Some((x, y)) = open.pop() {
        if mask[y * width + x] == 0 || std::mem::replace(&mut seen[y * width + x], true) {
            continue;
        }
        reaches |= x == 0 || y == 0 || x == width - 1 || y == height - 1;
        for v in y.saturating_sub(1)..(y + 2).min(height) {
            open.extend((x.saturating_sub(1)..(x + 2).min(width)).map(|u| (u, v)));
        }
    }
    reaches
}

/// A border that cuts a marker hides part of it: such markers are dropped, by the rule that no component may
/// reach the outermost pixels. The oracle floods the detector's own mask from every pixel near the dot.
#[test]
fn row_30_markers_on_the_border_are_dropped_and_no_others() {
    const SIZE: (usize, usize) = (64, 48);
    let inner = DVec2::new(32.0, 24.3);
    let mut cut = [0; 4];
    for step in 0..24 {
        let x = -4.0 + 0.5 * f64::from(step);
        let sides = [(x, 20.0), (63.0 - x, 20.0), (20.0, x), (20.0, 47.0 - x)];
        for (side, centre) in sides.map(DVec2::from).into_iter().enumerate() {
            let image = Dots::new(SIZE.0, SIZE.1, vec![centre, inner]).render();
            for params in every_rung() {
                let mut detector = Detector::new(&params);
                let mut markers = Markers::default();
                detector.run(view(&image, SIZE.0), &mut markers).unwrap();
                let mut mask = Vec::new();
                detector.mask(&mut mask);
                let pixels = (0..SIZE.1).flat_map(|v| (0..SIZE.0).map(move |u| (u, v)));
                let touches = pixels
                    .filter(|&(u, v)| DVec2::new(u as f64, v as f64).distance(centre) < 3.0)
                    .any(|start| flood_reaches_the_border(&mask, SIZE, start));
                cut[side] += usize::from(touches);
                let near = markers.centres_px.iter().filter(|c| c.distance(centre) < 1.0).count();
                // Whose centre lies outside may not show at all; with it a radius and a pixel and a half
                // inside, the dot is whole for certain.
                assert!(near == usize::from(!touches) || x < 0.0, "{centre} {params:?}");
                assert!(x < 6.0 || near == 1, "{centre} {params:?}");
                assert!(markers.centres_px.iter().any(|c| c.distance(inner) < 0.2));
                assert!(markers.centres_px.len() <= 2);
            }
        }
    }
    assert!(cut.iter().all(|&times| times > 20), "the dots hardly touched a border: {cut:?}");
}

/// What the border cuts is listed apart, and the covariance says how far off its visible part is: across the
/// border by no more than a standard deviation (a bound, for a straight cut), along it like any marker.
#[test]
fn row_30_markers_cut_by_the_border_are_listed_with_what_is_known() {
    let inner = support::lattice(3, 3, 18.0, DVec2::new(50.1, 45.3), 0.0, 0.0);
    let mut seen = 0;
    for step in 0..20 {
        let x = -2.0 + 0.3 * f64::from(step);
        let sides = [(x, 44.0), (99.0 - x, 44.0), (48.0, x), (48.0, 89.0 - x)].map(DVec2::from);
        for (side, at) in sides.into_iter().enumerate() {
            let mut centres = inner.clone();
            centres.push(at);
            let image = Dots::new(100, 90, centres).render();
            for params in every_rung() {
                let found = detect(&params, &image, 100).unwrap();
                assert!(found.cut.len() <= 1 && found.centres_px.len() + found.cut.len() <= 10);
                for cut in &found.cut {
                    let [across, along] = if side < 2 { [0, 1] } else { [1, 0] };
                    let (off, covariance) = (cut.centre_px - at, cut.covariance_px2);
                    assert!(off[across].abs() <= covariance[across][across].sqrt(), "{at} {off} {params:?}");
                    assert!(off[along].abs() < 0.3 && (covariance[along][along].sqrt() - 0.09).abs() < 1e-12);
                    seen += 1;
                }
            }
        }
    }
    assert!(seen > 400, "hardly any was cut: {seen}");
}

#[test]
fn row_30_images_without_contrast_are_refused_by_name() {
    for params in every_rung() {
        let threshold_levels = if params.threshold == Threshold::Auto { 3 } else { 35 };
        for level in [0, 127, 255_u8] {
            let error = detect(&params, &[level; 640 * 4], 64).unwrap_err();
            assert_eq!(error, DetectError::Flat { low: level, high: level, threshold_levels });
        }
        let text = |level: u8| detect(&params, &[level; 640 * 4], 64).unwrap_err().to_string();
        assert!(text(0).contains("black") && text(255).contains("saturated"));
        for (width, height) in [(1, 640), (640, 1), (4, 4), (1, 1)] {
            let image: Vec<u8> = (0..width * height).map(|n| (n * 89) as u8).collect();
            let found = detect(&params, &image, width);
            assert_eq!(found, Err(DetectError::TooSmall { width, height, min_side_px: 5 }));
        }
        // Contrast, but no marker: not an error.
        let ramp: Vec<u8> = (0..64 * 48).map(|n| (n % 64 * 3) as u8).collect();
        assert_eq!(detect(&params, &ramp, 64), Ok(Markers::default()));
    }
}

#[test]
fn row_30_rows_of_a_wider_frame_give_the_same_markers() {
    let centres = support::lattice(5, 7, 17.0, DVec2::new(80.2, 60.1), 3.0, 0.0);
    let image = Dots { noise: 2.0, ..Dots::new(160, 120, centres) }.render();
    let mut wide = vec![77_u8; 400 * 120];
    for (wide, row) in wide.chunks_exact_mut(400).zip(image.chunks_exact(160)) {
        wide[130..290].copy_from_slice(row);
    }
    for params in every_rung() {
        let mut markers = Markers::default();
        let part = view(&wide, 400).crop(130, 0, 160, 120).unwrap();
        Detector::new(&params).run(part, &mut markers).unwrap();
        assert_eq!(markers, detect(&params, &image, 160).unwrap());
    }
}

fn digest(markers: &Markers) -> u64 {
    let centres = Digest::new().f64s(markers.centres_px.iter().flat_map(|c| [c.x, c.y]));
    markers.area_px2.iter().fold(centres, |digest, &area| digest.u64(u64::from(area))).value()
}

#[test]
fn row_34_the_past_of_the_scratch_changes_no_bit() {
    let image = Dots { noise: 2.0, ..Dots::new(640, 480, paper_lattice()) }.render();
    let mut stream = Stream::new(34, "other images");
    let noise: Vec<u8> = (0..800 * 600).map(|_| stream.next_u64() as u8).collect();
    for params in every_rung() {
        let params = DetectParams { morphology_kernel_px: 3, ..params };
        let expected = digest(&detect(&params, &image, 640).unwrap());
        let (mut detector, mut markers) = (Detector::new(&params), Markers::default());
        for (width, height) in [(800, 600), (64, 48), (33, 7)] {
            let other = GrayView::new(&noise, width, height, width).unwrap();
            detector.run(other, &mut markers).unwrap();
            for _ in 0..2 {
                detector.run(view(&image, 640), &mut markers).unwrap();
                assert_eq!(digest(&markers), expected, "{params:?}");
            }
        }
    }
}

/// Light that falls off by half a level a pixel, and neighbours on one side only: the grey centre must not be
/// drawn by either.
#[test]
fn grey_centres_have_no_bias_at_the_lattice_edge_or_under_a_slope_of_light() {
    let truth = support::lattice(5, 5, 17.56, DVec2::new(80.0, 80.0), 0.0, 0.0);
    for phase in 0..8 {
        let shift = DVec2::new(0.13, 0.37) * f64::from(phase);
        let centres: Vec<DVec2> = truth.iter().map(|&c| c + shift).collect();
        let dots =
            Dots { slope: DVec2::new(0.5, 0.0), contrast: -100.0, ..Dots::new(160, 160, centres.clone()) };
        let params = DetectParams { centre: Centre::Grey, ..DetectParams::default() };
        let markers = detect(&params, &dots.render(), 160).unwrap();
        let (rms, near) = errors(&markers.centres_px, &centres);
        assert!(near == 25 && rms < 0.02, "{rms}");
    }
}

/// Dots with 3.4 px of gel between them, which is the margin of 2 px and a pixel's diagonal: the box around
/// one reaches into the other across, but the pixels that count do not.
#[test]
fn grey_centres_ignore_what_belongs_to_a_neighbour() {
    let params = DetectParams { centre: Centre::Grey, ..DetectParams::default() };
    for phase in 0..10 {
        let first = DVec2::new(30.2, 30.1) + DVec2::new(0.13, 0.29) * f64::from(phase);
        for step in [DVec2::new(12.0, 0.0), DVec2::new(8.49, 8.49), DVec2::new(-8.49, 8.49)] {
            let centres = vec![first, first + step];
            let markers = detect(&params, &Dots::new(70, 70, centres.clone()).render(), 70).unwrap();
            let (rms, near) = errors(&markers.centres_px, &centres);
            assert!(near == 2 && rms < 0.03, "{rms} px, {near} found, {step}");
        }
    }
}

/// Beside the border only a part of the surround is there.
#[test]
fn grey_centres_hold_beside_the_border() {
    let params = DetectParams { centre: Centre::Grey, ..DetectParams::default() };
    for step in 0..30 {
        let inset = 6.0 + 0.1 * f64::from(step);
        for centre in
            [DVec2::new(inset, 30.2), DVec2::new(59.0 - inset, 59.0 - inset), DVec2::new(30.4, inset)]
        {
            let markers = detect(&params, &Dots::new(60, 60, vec![centre]).render(), 60).unwrap();
            let (rms, near) = errors(&markers.centres_px, &[centre]);
            assert!(near == 1 && rms < 0.04, "{rms} px at {centre}, {near} found");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever the image and the settings, an answer is an error by name or markers within the image.
    #[test]
    fn row_30_any_image_has_an_answer(
        (width, bytes) in (1..40_usize, 1..40_usize).prop_flat_map(|(width, height)| {
            (Just(width), prop::collection::vec(prop_oneof![Just(0), Just(255), any::<u8>()], width * height))
        }),
        (background, grey, dark, fixed) in (0..2_usize, any::<bool>(), any::<bool>(), any::<bool>()),
        (smooth, surround, kernel) in (0..4_usize, 0..30_usize, 0..3_usize),
        threshold_levels in 1..=255_u8,
        min_area_px2 in 1..20_u32,
    ) {
        let params = DetectParams {
            polarity: if dark { Polarity::Dark } else { Polarity::Bright },
            background: [Background::Gaussian, Background::Blocks][background],
            threshold: if fixed { Threshold::Fixed } else { Threshold::Auto },
            centre: if grey { Centre::Grey } else { Centre::Binary },
            smooth_kernel_px: 2 * smooth + 1,
            background_kernel_px: 2 * surround + 1,
            morphology_kernel_px: 2 * kernel + 1,
            threshold_levels,
            min_area_px2,
            min_fill: 0.0,
            ..DetectParams::default()
        };
        if let Ok(markers) = detect(&params, &bytes, width) {
            prop_assert_eq!(markers.centres_px.len(), markers.area_px2.len());
            let last = DVec2::new((width - 1) as f64, (bytes.len() / width - 1) as f64);
            for centre in markers.centres_px {
                prop_assert!(centre.cmpge(DVec2::ZERO).all() && centre.cmple(last).all(), "{centre}");
            }
        }
    }
}

/// Diameters are another form of the bounds of the area, in every search.
#[test]
fn a_diameter_bounds_the_area() {
    let mut dots = Dots::new(400, 400, lattice(9, 9, 30.0, DVec2::new(200.0, 200.0), 0.0, 0.0));
    dots.radius_px = 5.0;
    let image = dots.render();
    for preset in ["paper", "fast", "balanced", "exact"] {
        let preset = Params::preset(preset).unwrap().detect;
        let with = |dot_px| detect(&DetectParams { dot_px, ..preset.clone() }, &image, 400);
        let [given, free] = [Some([8.0, 12.0]), None].map(|dot_px| with(dot_px).unwrap().centres_px);
        assert_eq!((given.len(), &given), (81, &free));
        for other in [[1.0, 8.0], [12.0, 30.0]] {
            assert_eq!(with(Some(other)).unwrap().centres_px.len(), 0, "{other:?}");
        }
    }
    let bad = |dot_px| DetectParams { dot_px: Some(dot_px), ..DetectParams::default() }.validate();
    for dot_px in [[0.5, 8.0], [9.0, 8.0], [9.0, 1001.0], [f64::NAN, 9.0], [9.0, f64::NAN]] {
        assert!(bad(dot_px).unwrap_err().to_string().contains("detect.dot_px"), "{dot_px:?}");
    }
}

/// Stripes two pixels wide: twice the runs of pixels that an image of markers may have.
#[test]
fn row_30_an_image_of_nothing_but_stripes_is_refused_by_name() {
    let (width, height) = (640, 480);
    let image: Vec<u8> = (0..width * height).map(|n| if n % 4 < 2 { 0 } else { 255 }).collect();
    let params = DetectParams::default();
    let error = detect(&params, &image, width).unwrap_err();
    assert!(matches!(error, DetectError::TooMany { found, max } if found > max && max == 38_400), "{error}");
    assert!(error.to_string().contains("noise"), "{error}");
    // The detector is good for the next image.
    let dots = Dots::new(width, height, paper_lattice()).render();
    let (mut detector, mut markers) = (Detector::new(&params), Markers::default());
    assert_eq!(detector.run(view(&image, width), &mut markers), Err(error));
    assert!(markers.centres_px.is_empty());
    detector.run(view(&dots, width), &mut markers).unwrap();
    assert_eq!(markers, detect(&params, &dots, width).unwrap());
}

/// Gel that is squeezed beside a dragged part brings two dots within a window of each other. Each has a
/// component of its own, and a centre of its own: once both were given that of their middle, 4.4 px off.
#[test]
fn two_markers_within_a_window_have_two_centres() {
    let params = Params::preset("fast").unwrap().detect;
    let mut wide = lattice(9, 9, 17.6, DVec2::new(100.0, 100.0), 0.0, 0.0);
    let gap = wide.swap_remove(40);
    let mut stream = Stream::new(1, "pairs");
    for pair in 0..40 {
        // Dots of 3 px radius leave 1.2 px of gel and more between them.
        let (apart_px, way) = (7.2 + 1.3 * stream.uniform(), 3.2 * stream.uniform());
        let half = 0.5 * apart_px * DVec2::new(way.cos(), way.sin());
        let near = DVec2::new(stream.uniform(), stream.uniform()) + gap;
        let narrow = vec![near - half, near + half];
        let image = Dots { noise: 2.0, seed: pair, ..Dots::new(200, 200, wide.clone()) }.render();
        let thin = Dots { radius_px: 3.0, ..Dots::new(200, 200, narrow.clone()) }.render();
        let image: Vec<u8> = image.iter().zip(&thin).map(|(a, b)| *a.min(b)).collect();
        let mut found = Markers::default();
        Detector::new(&params).run(view(&image, 200), &mut found).unwrap();
        for truth in wide.iter().chain(&narrow) {
            let off = found.centres_px.iter().map(|c| c.distance(*truth)).fold(f64::INFINITY, f64::min);
            assert!(off < 0.5, "pair {pair}, {apart_px} px apart: {off} px");
        }
    }
}
