//! Blur, morphology and components against plain definitions.

use crate::support;

use gelstereo_core::detect::mask::blur::{FRACTION_BITS, GaussianBlur, reflect101};
use gelstereo_core::detect::mask::components::Components;
use gelstereo_core::detect::mask::morphology::Closing;
use gelstereo_core::image::MAX_SIDE_PX;
use proptest::prelude::*;
use support::view;

fn gaussian(image: &[u8], width: usize, kernel_px: usize) -> Vec<u16> {
    let mut blur = GaussianBlur::new(kernel_px);
    let mut out = vec![0; image.len()];
    for (y, row) in out.chunks_exact_mut(width).enumerate() {
        blur.row(view(image, width), y, row);
    }
    out
}

fn images() -> impl Strategy<Value = (Vec<u8>, usize)> {
    (1..24_usize, 1..24_usize)
        .prop_flat_map(|(width, height)| (prop::collection::vec(any::<u8>(), width * height), Just(width)))
}

/// Masks of 0 and 255 with a share of set pixels that makes long and winding components.
fn masks() -> impl Strategy<Value = (Vec<u8>, usize)> {
    // Some wider than the 64 pixels that components are made of at a time.
    (1..200_usize, 1..24_usize, 0.1..0.9_f64).prop_flat_map(|(width, height, share)| {
        let pixel = prop::bool::weighted(share).prop_map(|set| if set { 255 } else { 0 });
        (prop::collection::vec(pixel, width * height), Just(width))
    })
}

#[test]
fn a_constant_image_stays_constant() {
    for level in [0, 1, 100, 254, 255_u8] {
        for kernel_px in [1, 3, 5, 7, 9, 11, 31, 51, 255] {
            let image = vec![level; 40 * 30];
            let expected = u16::from(level) << FRACTION_BITS;
            assert!(gaussian(&image, 40, kernel_px).iter().all(|&v| v == expected), "{level} {kernel_px}");
        }
    }
}

/// Row 31 in the range of kernels that settings allow: sigma 0.8 to 38.6 px. An edge that runs through the
/// middle of the image is smoothed across only, so that the differences of a row are the kernel: its mass and
/// variance are those of the Gaussian's samples.
///
/// Weights are rounded to 1 / 2^15, and the levels after either pass to 1 / 2^7: the share of a column is off
/// by at most half of the first and, as a difference of two, twice half of the second over 255 levels from
/// either pass; each counts by its squared distance. Of a kernel of 51 px the variance is then known to 1.3
/// %.
#[test]
fn row_31_blur_has_the_mass_and_variance_of_its_gaussian() {
    for kernel_px in [11, 31, 51, 255] {
        let (side, radius) = (2 * kernel_px + 1, (kernel_px / 2) as i32);
        let sigma = 0.3 * f64::from(radius - 1) + 0.8;
        let samples = (-radius..=radius).map(|k| (k, (-0.5 * (f64::from(k) / sigma).powi(2)).exp()));
        let moment = |order: i32| -> f64 { samples.clone().map(|(k, s)| s * f64::from(k).powi(order)).sum() };
        let expected = moment(2) / moment(0);
        let rounding = 0.5 / f64::from(1 << 15) + 2.0 / 128.0 / 255.0;
        let lever: f64 = (-radius..=radius).map(|k| f64::from(k * k)).sum();
        for down in [false, true] {
            let bright = |n: usize| if down { n / side > kernel_px } else { n % side > kernel_px };
            let image: Vec<u8> = (0..side * side).map(|n| if bright(n) { 255 } else { 0 }).collect();
            let levels = gaussian(&image, side, kernel_px);
            let at = |k: usize| if down { k * side + kernel_px } else { kernel_px * side + k };
            let level = |k: usize| f64::from(levels[at(k)]) / f64::from(1 << FRACTION_BITS) / 255.0;
            // Column k + 1 has what column k lacks by the weight of the bright column that it alone sees.
            let shares = (0..side - 1).map(|k| (k as f64 - kernel_px as f64, level(k + 1) - level(k)));
            let mass: f64 = shares.clone().map(|(_, share)| share).sum();
            assert!((mass - 1.0).abs() <= 2.0 * rounding, "{kernel_px}: mass {mass}");
            let variance: f64 = shares.map(|(k, share)| share * k * k).sum();
            let most = rounding * lever;
            assert!(
                (variance - expected).abs() <= most,
                "{kernel_px}: variance {variance}, expected {expected}, most {most}"
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Against the definition in floating point. Rounding: 1/2^15 a weight and side on 255 levels, half of
    /// 1/128 after each pass.
    #[test]
    fn gaussian_is_the_sum_of_its_definition((image, width) in images(), radius in 5..30_usize) {
        let height = image.len() / width;
        let sigma = 0.3 * (radius as f64 - 1.0) + 0.8;
        let side = radius as isize;
        let sample = |k: isize| (-0.5 * (k as f64 / sigma).powi(2)).exp();
        let total: f64 = (-side..=side).map(sample).sum();
        let found = gaussian(&image, width, 2 * radius + 1);
        let most = 2.0 * 255.0 * (2 * radius + 1) as f64 / f64::from(1 << 15) + 1.0 / 128.0;
        for y in 0..height {
            for x in 0..width {
                let mut sum = 0.0;
                for dy in -side..=side {
                    for dx in -side..=side {
                        let at =
                            reflect101(y as isize + dy, height) * width + reflect101(x as isize + dx, width);
                        sum += sample(dy) * sample(dx) * f64::from(image[at]);
                    }
                }
                let level = f64::from(found[y * width + x]) / 128.0;
                prop_assert!((level - sum / total / total).abs() <= most);
            }
        }
    }

    #[test]
    fn closing_is_dilation_then_erosion_by_definition((mask, width) in masks(), radius in 0..5_isize) {
        let height = mask.len() / width;
        let in_kernel = |dx: isize, dy: isize| {
            let half = ((radius * radius - dy * dy) as f64).sqrt().round_ties_even() as isize;
            dx.abs() <= half
        };
        let sweep = |from: &[u8], dilate: bool| -> Vec<u8> {
            (0..from.len())
                .map(|n| {
                    let (x, y) = ((n % width) as isize, (n / width) as isize);
                    let mut hit = false;
                    for dy in -radius..=radius {
                        for dx in -radius..=radius {
                            let inside = (0..width as isize).contains(&(x + dx))
                                && (0..height as isize).contains(&(y + dy));
                            if inside && in_kernel(dx, dy) {
                                hit |= (from[((y + dy) * width as isize + x + dx) as usize] != 0) == dilate;
                            }
                        }
                    }
                    if hit == dilate {
                        255
                    } else {
                        0
                    }
                })
                .collect()
        };
        let expected = sweep(&sweep(&mask, true), false);
        let mut found = mask.clone();
        Closing::new(2 * radius as usize + 1).run(&mut found, width);
        prop_assert_eq!(found, expected);
    }

    /// Against a flood fill that starts at each pixel not yet reached, in raster order.
    #[test]
    fn components_are_those_of_a_flood_fill((mask, width) in masks()) {
        let height = mask.len() / width;
        let mut reached = vec![false; mask.len()];
        let mut expected = Vec::new();
        for start in 0..mask.len() {
            if mask[start] == 0 || reached[start] {
                continue;
            }
            let (mut stack, mut pixels) = (vec![start], Vec::new());
            reached[start] = true;
            while let Some(n) = stack.pop() {
                pixels.push((n % width, n / width));
                for y in (n / width).saturating_sub(1)..(n / width + 2).min(height) {
                    for x in (n % width).saturating_sub(1)..(n % width + 2).min(width) {
                        if mask[y * width + x] != 0 && !reached[y * width + x] {
                            reached[y * width + x] = true;
                            stack.push(y * width + x);
                        }
                    }
                }
            }
            let xs = || pixels.iter().map(|p| p.0 as u16);
            let ys = || pixels.iter().map(|p| p.1 as u16);
            expected.push((
                pixels.len() as u32,
                xs().map(u64::from).sum::<u64>(), ys().map(u64::from).sum::<u64>(),
                [xs().min(), ys().min(), xs().max(), ys().max()].map(Option::unwrap),
            ));
        }
        let mut components = Components::default();
        let found: Vec<_> = components.run(view(&mask, width)).iter()
            .map(|b| (b.area_px2, b.sum_x, b.sum_y, [b.left, b.top, b.right, b.bottom])).collect();
        prop_assert_eq!(&found, &expected);
        // Runs from first to last, which are the pixels again.
        let mut painted = vec![0; mask.len()];
        for blob in components.blobs() {
            let runs: Vec<_> = components.runs(blob).map(|run| (run.y, run.start, run.end)).collect();
            prop_assert!(runs.is_sorted());
            let mut area_px2 = 0;
            for &(y, start, end) in &runs {
                painted[usize::from(y) * width..][usize::from(start)..usize::from(end)].fill(255);
                area_px2 += u32::from(end - start);
            }
            prop_assert_eq!(area_px2, blob.area_px2);
        }
        prop_assert_eq!(painted, mask);
    }
}

/// Sums by the formula of an arithmetic series.
#[test]
fn the_widest_and_the_highest_image_have_one_component() {
    let most = MAX_SIDE_PX as u64;
    let mask = vec![255; 2 * MAX_SIDE_PX];
    let (half, sum) = (most * (most - 1) / 2, most);
    for (width, sums, last) in
        [(MAX_SIDE_PX, (2 * half, sum), (u16::MAX - 1, 1)), (2, (sum, 2 * half), (1, u16::MAX - 1))]
    {
        let mut components = Components::default();
        let found = components.run(view(&mask, width));
        assert_eq!(found.len(), 1);
        let blob = &found[0];
        assert_eq!(u64::from(blob.area_px2), 2 * most);
        assert_eq!((blob.sum_x, blob.sum_y), sums);
        assert_eq!((blob.left, blob.top, blob.right, blob.bottom), (0, 0, last.0, last.1));
    }
}

proptest! {
    /// Four times the covariance of a component's pixels, each a square with a variance of its own of 1/12
    /// px².
    #[test]
    fn spreads_are_those_of_the_pixels((mask, width) in masks()) {
        let mut components = Components::default();
        components.run(view(&mask, width));
        for blob in components.blobs() {
            let runs = || components.runs(blob);
            let pixels =
                runs().flat_map(|run| (run.start..run.end).map(|x| [f64::from(x), f64::from(run.y)]));
            let (area, mean) = (f64::from(blob.area_px2), blob.mean_px().to_array());
            let mut spread_px2 = [[1.0 / 3.0, 0.0], [0.0, 1.0 / 3.0]];
            for pixel in pixels {
                for (i, row) in spread_px2.iter_mut().enumerate() {
                    for (j, entry) in row.iter_mut().enumerate() {
                        *entry += 4.0 * (pixel[i] - mean[i]) * (pixel[j] - mean[j]) / area;
                    }
                }
            }
            let found = blob.spread_px2(runs());
            for (found, expected) in found.iter().flatten().zip(spread_px2.iter().flatten()) {
                // Round-off of squares of up to the mask's size.
                prop_assert!((found - expected).abs() < 1e-9, "{found} {expected}");
            }
        }
    }
}
