//! The threshold derived from the image, its parts against plain definitions, and what it finds.

use crate::support;

use gelstereo_core::detect::mask::blocks::{BLOCK_PX, Blocks, BoxSums};
use gelstereo_core::detect::mask::blur::reflect101;
use gelstereo_core::detect::mask::noise_level::NoiseLevel;
use gelstereo_core::detect::mask::smooth::Smoother;
use gelstereo_core::detect::{DetectError, Detector, Markers};
use gelstereo_core::math::DVec2;
use gelstereo_core::params::{Background, DetectParams, Polarity, Threshold};
use proptest::prelude::*;
use support::{Dots, errors, lattice, paper_lattice, view};

fn auto(background: Background) -> DetectParams {
    DetectParams { background, threshold: Threshold::Auto, ..DetectParams::default() }
}

fn detect(params: &DetectParams, image: &[u8], width: usize) -> Result<Markers, DetectError> {
    let mut markers = Markers::default();
    Detector::new(params).run(view(image, width), &mut markers)?;
    Ok(markers)
}

fn blank(width: usize, height: usize, noise: f64, seed: u64) -> Vec<u8> {
    Dots { noise, seed, ..Dots::new(width, height, vec![]) }.render()
}

/// Faint dots, little light, much noise, uneven light, sparse and dense lattices: all dots, and nothing else.
#[test]
fn the_derived_threshold_finds_all_dots_and_nothing_else() {
    let sparse = lattice(7, 9, 60.0, DVec2::new(320.3, 240.4), 2.0, 0.0);
    let dense = lattice(40, 50, 10.5, DVec2::new(320.3, 240.4), 1.0, 0.0);
    let paper = || Dots::new(640, 480, paper_lattice());
    let cases = [
        ("usual", Dots { noise: 2.0, ..paper() }),
        ("faint", Dots { noise: 2.0, contrast: -25.0, ..paper() }),
        ("dim", Dots { noise: 2.0, ground: 60.0, contrast: -42.0, ..paper() }),
        ("noisy", Dots { noise: 18.0, ..paper() }),
        ("slope", Dots { noise: 2.0, contrast: -60.0, slope: DVec2::new(0.2, -0.1), ..paper() }),
        (
            "large",
            Dots { noise: 1.0, contrast: -15.0, radius_px: 14.0, ..Dots::new(640, 480, sparse.clone()) },
        ),
        ("small on a wide pitch", Dots { noise: 2.0, ..Dots::new(640, 480, sparse) }),
        ("dense", Dots { noise: 2.0, radius_px: 2.5, ..Dots::new(640, 480, dense) }),
    ];
    for (name, dots) in cases {
        for seed in 1..4 {
            let image = Dots { seed, ..dots.clone() }.render();
            for background in [Background::Gaussian, Background::Blocks] {
                let found = detect(&auto(background), &image, 640).unwrap();
                let (_, near) = errors(&found.centres_px, &dots.centres_px);
                let all = dots.centres_px.len();
                assert_eq!((found.centres_px.len(), near), (all, all), "{name}, {background:?}, seed {seed}");
            }
        }
    }
}

/// The fixed threshold of 35 levels sees none of 25 levels of contrast; that is what the rung is for.
#[test]
fn the_fixed_threshold_misses_faint_dots() {
    let image = Dots { noise: 2.0, contrast: -25.0, ..Dots::new(640, 480, paper_lattice()) }.render();
    let fixed = DetectParams { background: Background::Blocks, ..DetectParams::default() };
    assert_eq!(detect(&fixed, &image, 640).unwrap(), Markers::default());
}

/// A gel without markers gives none, at any noise, also where the light falls by 90 levels across the image:
/// beside the border the mirrored background is off by 14 px of slope, which steeper light would show as a
/// marker.
#[test]
fn a_blank_gel_gives_no_markers() {
    for (seed, noise) in (1..).zip([0.3, 0.7, 1.0, 2.0, 5.0, 18.0, 40.0]) {
        for slope in [DVec2::ZERO, DVec2::new(0.1, 0.05)] {
            let image = Dots { noise, seed, slope, ground: 128.0, ..Dots::new(640, 480, vec![]) }.render();
            for background in [Background::Gaussian, Background::Blocks] {
                match detect(&auto(background), &image, 640) {
                    Ok(found) => assert_eq!(found.centres_px, [], "{noise} {background:?}"),
                    Err(error) => assert!(matches!(error, DetectError::Flat { .. })),
                }
            }
        }
    }
}

/// Uniform, black and saturated images, and those with a dead row, column or corner, are refused or have no
/// markers.
#[test]
fn row_30_images_without_markers_give_none_or_are_refused() {
    for background in [Background::Gaussian, Background::Blocks] {
        for level in [0, 128, 255_u8] {
            let error = detect(&auto(background), &[level; 97 * 53], 97).unwrap_err();
            assert_eq!(error, DetectError::Flat { low: level, high: level, threshold_levels: 3 });
            for dead in [level.wrapping_add(100), level.wrapping_sub(100)] {
                let lines: [&dyn Fn(usize) -> bool; 4] =
                    [&|n| n % 97 == 40, &|n| n / 97 == 20, &|n| n == 0, &|n| n == 97 * 53 - 1];
                for line in lines {
                    let image: Vec<u8> = (0..97 * 53).map(|n| if line(n) { dead } else { level }).collect();
                    let found = detect(&auto(background), &image, 97).unwrap();
                    assert_eq!(found.centres_px, [], "{background:?} {level} {dead}");
                }
            }
        }
    }
}

/// White noise of known strength, with markers and a slope that must not count. The median of 9 500
/// neighbouring responses is good to some 3 %; rounding adds 1/12 to the variance.
#[test]
fn noise_is_measured_beside_markers() {
    for sigma in [1.0, 2.0, 5.0, 18.0_f64] {
        let dots = Dots { noise: sigma, slope: DVec2::new(0.1, 0.1), ..Dots::new(640, 480, paper_lattice()) };
        let expected = (sigma * sigma + 1.0 / 12.0).sqrt();
        let bare = NoiseLevel::default().sigma_levels(view(&blank(640, 480, sigma, 3), 640));
        assert!((bare / expected - 1.0).abs() < 0.05, "{sigma}: {bare}");
        // Up to a third of the responses have an edge in them, which moves the median by that share of its
        // quantile.
        let found = NoiseLevel::default().sigma_levels(view(&dots.render(), 640));
        assert!(found > 0.95 * expected && found < 1.9 * expected, "{sigma}: {found}");
    }
    assert_eq!(NoiseLevel::default().sigma_levels(view(&[9; 2 * 7], 2)), 0.0);
}

fn smoothed(image: &[u8], width: usize, kernel_px: usize, polarity: Polarity) -> Vec<u8> {
    let (mut smoother, mut out) = (Smoother::new(kernel_px, polarity), vec![0; image.len()]);
    for (y, row) in out.chunks_exact_mut(width).enumerate() {
        smoother.row(view(image, width), y, row);
    }
    out
}

fn images() -> impl Strategy<Value = (Vec<u8>, usize)> {
    (1..40_usize, 1..40_usize)
        .prop_flat_map(|(width, height)| (prop::collection::vec(any::<u8>(), width * height), Just(width)))
}

/// Row 31 for the filter of whole levels: an impulse keeps its mass to the rounding of nine pixels, and its
/// variance, half a pixel squared on each axis.
#[test]
fn row_31_the_smoother_has_the_mass_and_variance_of_its_kernel() {
    let mut image = [0_u8; 9 * 9];
    image[40] = 240;
    let response = smoothed(&image, 9, 3, Polarity::Dark);
    assert_eq!(response.iter().map(|&v| u32::from(v)).sum::<u32>(), 240);
    let variance: f64 =
        (0..81).map(|n| f64::from(response[n]) * ((n % 9) as f64 - 4.0).powi(2)).sum::<f64>() / 240.0;
    assert_eq!(variance, 0.5);
    // White noise keeps (1 + 4 + 1) / 16 of its standard deviation over both axes.
    assert_eq!(Smoother::new(3, Polarity::Dark).noise_gain(), 0.375);
    assert_eq!(Smoother::new(1, Polarity::Dark).noise_gain(), 1.0);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// Within a level of the exact mean: each of four roundings is half a level at most, and later ones halve
    /// earlier ones.
    #[test]
    fn the_smoother_is_its_definition((image, width) in images(), bright in any::<bool>()) {
        let polarity = if bright { Polarity::Bright } else { Polarity::Dark };
        let level = |v: u8| f64::from(if bright { 255 - v } else { v });
        let height = image.len() / width;
        let found = smoothed(&image, width, 3, polarity);
        prop_assert_eq!(
            smoothed(&image, width, 1, polarity).iter().map(|&v| f64::from(v)).collect::<Vec<_>>(),
            image.iter().map(|&v| level(v)).collect::<Vec<_>>()
        );
        for y in 0..height {
            for x in 0..width {
                let exact: f64 = (0..9)
                    .map(|n| {
                        let (dx, dy) = (n % 3 - 1, n / 3 - 1);
                        let weight = f64::from((2 - i32::abs(dx)) * (2 - i32::abs(dy))) / 16.0;
                        let at = reflect101(y as isize + dy as isize, height) * width
                            + reflect101(x as isize + dx as isize, width);
                        weight * level(image[at])
                    })
                    .sum();
                prop_assert!((f64::from(found[y * width + x]) - exact).abs() <= 1.0);
            }
        }
    }

    #[test]
    fn box_sums_are_sums_over_boxes(
        (values, cols) in (1..12_usize, 1..12_usize).prop_flat_map(|(cols, rows)| {
            (prop::collection::vec(0..u64::from(u32::MAX), cols * rows), Just(cols))
        }),
        radius in 0..15_isize,
    ) {
        let rows = values.len() / cols;
        let mut sums = BoxSums::default();
        let found = sums.run(&values, |value| value, cols, radius as usize);
        for (n, &found) in found.iter().enumerate() {
            let (x, y) = ((n % cols) as isize, (n / cols) as isize);
            let expected: u64 = (-radius..=radius).flat_map(|dy| (-radius..=radius).map(move |dx| (dx, dy)))
                .map(|(dx, dy)| values[reflect101(y + dy, rows) * cols + reflect101(x + dx, cols)]).sum();
            prop_assert_eq!(found, expected);
        }
    }

    /// Surround and depth of every block, also of those cut by the right and lower border, by their
    /// definitions.
    #[test]
    fn blocks_are_means_and_minima((image, width) in images(), radius in 0..4_isize) {
        let height = image.len() / width;
        let (cols, rows) = (width.div_ceil(BLOCK_PX), height.div_ceil(BLOCK_PX));
        let mut blocks = Blocks::default();
        blocks.start(width, height);
        image.chunks(BLOCK_PX * width).for_each(|rows| blocks.push(rows));
        blocks.finish(radius as usize, &mut BoxSums::default());
        let pixels = |bx: usize, by: usize| -> Vec<u8> {
            (by * BLOCK_PX..((by + 1) * BLOCK_PX).min(height))
                .flat_map(|y| {
                    image[y * width + bx * BLOCK_PX..y * width + ((bx + 1) * BLOCK_PX).min(width)].to_vec()
                })
                .collect()
        };
        let depths: Vec<u16> = blocks.depths(7).collect();
        for by in 0..rows {
            for bx in 0..cols {
                let means = (-radius..=radius).flat_map(|dy| (-radius..=radius).map(move |dx| (dx, dy))).map(
                    |(dx, dy)| {
                        let of =
                            pixels(reflect101(bx as isize + dx, cols), reflect101(by as isize + dy, rows));
                        of.iter().map(|&v| f64::from(v)).sum::<f64>() / of.len() as f64
                    },
                );
                let exact = 128.0 * means.sum::<f64>() / ((2 * radius + 1) * (2 * radius + 1)) as f64;
                let background = blocks.background()[by * cols + bx];
                // Half a last place for each block's mean and for the whole's.
                prop_assert!((f64::from(background) - exact).abs() <= 1.0, "{background} {exact}");
                let darkest = u16::from(pixels(bx, by).into_iter().min().unwrap_or(0)) << 7;
                prop_assert_eq!(depths[by * cols + bx], background.saturating_sub(darkest));
            }
        }
    }

    /// Blocks against fixed thresholds: the mask is the comparison of smoothed pixels with their blocks'
    /// backgrounds.
    #[test]
    fn the_mask_of_blocks_is_its_definition((image, width) in images(), threshold_levels in 1..60_u8) {
        let params = DetectParams {
            background: Background::Blocks,
            background_kernel_px: 17,
            threshold_levels,
            min_area_px2: 1,
            ..DetectParams::default()
        };
        let mut detector = Detector::new(&params);
        prop_assume!(detector.run(view(&image, width), &mut Markers::default()).is_ok());
        let (smooth, mut blocks, mut mask) =
            (smoothed(&image, width, 3, Polarity::Dark), Blocks::default(), Vec::new());
        detector.mask(&mut mask);
        blocks.start(width, image.len() / width);
        smooth.chunks(BLOCK_PX * width).for_each(|rows| blocks.push(rows));
        blocks.finish(1, &mut BoxSums::default());
        for (n, &level) in smooth.iter().enumerate() {
            let background = blocks.background()[n / width / BLOCK_PX * blocks.cols() + n % width / BLOCK_PX];
            let differs = i32::from(background) - (i32::from(level) << 7) >= i32::from(threshold_levels) << 7;
            prop_assert_eq!(mask[n] == 255, differs);
        }
    }
}
