//! The model fit against discs and ellipses whose centres, noise and blur are known.

use crate::support;

use gelstereo_core::detect::centre::fit::{DiscFit, Start};
use gelstereo_core::detect::{Detector, Markers};
use gelstereo_core::image::GrayView;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, erf};
use gelstereo_core::params::{Background, Centre, DetectParams};
use proptest::prelude::*;
use support::{Dots, errors, paper_lattice, view};

fn params() -> DetectParams {
    DetectParams { background: Background::Blocks, centre: Centre::Fit, ..DetectParams::default() }
}

fn detect(params: &DetectParams, image: &[u8], width: usize) -> Markers {
    let mut markers = Markers::default();
    Detector::new(params).run(view(image, width), &mut markers).unwrap();
    markers
}

/// An ellipse's blurred image: coverage by sampling, then a Gaussian, then slopes, noise and rounding.
/// Independent of the fit's profile.
#[derive(Clone, Copy, Debug)]
struct Ellipse {
    centre: DVec2,
    axes_px: DVec2,
    turn: f64,
    contrast: f64,
    slope: DVec2,
    blur_px: f64,
    noise: f64,
}

const SIDE: usize = 41;

impl Ellipse {
    fn image(&self, seed: u64) -> Vec<u8> {
        const SAMPLES: usize = 8;
        let (s, c) = self.turn.sin_cos();
        let inside = |p: DVec2| {
            let d = p - self.centre;
            (DVec2::new(c * d.x + s * d.y, c * d.y - s * d.x) / self.axes_px).length_squared() <= 1.0
        };
        let mut coverage = vec![0.0_f64; SIDE * SIDE];
        for (n, share) in coverage.iter_mut().enumerate() {
            let corner = DVec2::new((n % SIDE) as f64, (n / SIDE) as f64) - 0.5;
            let sub = |k: usize| DVec2::new((k % SAMPLES) as f64, (k / SAMPLES) as f64) + 0.5;
            let hits = (0..SAMPLES * SAMPLES).filter(|&k| inside(corner + sub(k) / SAMPLES as f64)).count();
            *share = hits as f64 / (SAMPLES * SAMPLES) as f64;
        }
        let reach = (4.0 * self.blur_px).ceil() as isize;
        let cumulative = |x: f64| 0.5 * erf(x / self.blur_px / 2.0_f64.sqrt());
        let kernel: Vec<f64> =
            (-reach..=reach).map(|k| cumulative(k as f64 + 0.5) - cumulative(k as f64 - 0.5)).collect();
        let blurred = |from: &[f64], step: isize| -> Vec<f64> {
            (0..from.len() as isize)
                .map(|n| {
                    let at = |k: isize| from.get((n + k * step) as usize).copied().unwrap_or(0.0);
                    kernel.iter().zip(-reach..).map(|(w, k)| w * at(k)).sum()
                })
                .collect()
        };
        let shares = blurred(&blurred(&coverage, 1), SIDE as isize);
        let mut noise = Stream::new(seed, "pixel noise");
        let levels = shares.iter().enumerate().map(|(n, share)| {
            let at = DVec2::new((n % SIDE) as f64, (n / SIDE) as f64) - self.centre;
            // Light scales gel and paint alike.
            let clean = (1.0 + self.slope.dot(at) / 170.0) * (170.0 - self.contrast * share);
            (clean + self.noise * noise.normal() + 0.5) as u8
        });
        levels.collect()
    }

    /// Bound of one coordinate for a circle of the same area, with the rounding's variance.
    fn sigma_px(&self) -> f64 {
        let blur = (self.blur_px * self.blur_px + 1.0 / 6.0).sqrt();
        let noise = (self.noise * self.noise + 1.0 / 12.0).sqrt();
        let radius = (self.axes_px.x * self.axes_px.y).sqrt();
        noise / self.contrast * (2.0 * blur / (std::f64::consts::PI.sqrt() * radius)).sqrt()
    }
}

#[test]
fn every_dot_of_a_lattice_is_fitted() {
    let truth = paper_lattice();
    for noise in [0.0, 2.0, 8.0] {
        let image = Dots { noise, ..Dots::new(640, 480, truth.clone()) }.render();
        let markers = detect(&params(), &image, 640);
        let (rms, near) = errors(&markers.centres_px, &truth);
        assert_eq!((markers.centres_px.len(), near, markers.unfitted), (625, 625, 0));
        // These edges have no blur but the pixels'; the closed form with 1.3 for curvature and slopes, and
        // the 16 x 16 samples of the picture.
        let sigma = (noise * noise + 1.0 / 12.0_f64).sqrt() / 120.0 * (2.0 * 0.3 / (1.77 * 4.3_f64)).sqrt();
        let most = 1.5 * sigma * 2.0_f64.sqrt() + 0.012;
        assert!(rms <= most, "noise {noise}: {rms} above {most}");
    }
}

/// Normalised squared errors of n markers' centres are chi² with 2 n degrees of freedom when the covariance
/// is right: their mean over 2 n is 1, with the standard deviation 1 / sqrt(n).
#[test]
fn covariances_are_calibrated_in_white_noise() {
    let truth = paper_lattice();
    for (noise, contrast) in [(2.0, -120.0), (6.0, -120.0), (18.0, -120.0), (2.0, -40.0)] {
        let mut sum = 0.0;
        let mut count = 0.0;
        for seed in 0..3 {
            let picture =
                Dots { noise, contrast, seed, radius_px: 4.0, ..Dots::new(640, 480, truth.clone()) };
            let image = blurred(&picture.render_levels(), 640, noise, seed);
            let settings = DetectParams { threshold_levels: 20, min_area_px2: 20, ..params() };
            let markers = detect(&settings, &image, 640);
            for (centre, [[xx, xy], [_, yy]]) in markers.centres_px.iter().zip(&markers.covariance_px2) {
                let error =
                    truth.iter().map(|t| *centre - *t).min_by(|a, b| a.length().total_cmp(&b.length()));
                let error = error.unwrap();
                assert!(error.length() < 1.5);
                sum += (yy * error.x * error.x - 2.0 * xy * error.x * error.y + xx * error.y * error.y)
                    / (xx * yy - xy * xy);
                count += 1.0;
            }
        }
        let nees = sum / (2.0 * count);
        // 95 % of the means lie within 1.96 / sqrt(n); four settings, so 99 % each. The kernel's variance is
        // 3 % uncertain.
        let band = 2.6 / f64::sqrt(count) + 0.03;
        assert!((nees - 1.0).abs() < band, "noise {noise} contrast {contrast}: {nees}");
    }
}

/// The blur of an image is the same whatever its noise, though outlines follow the noise: they would take
/// 0.024 px of it here, by (b - (b² - <u²>)^0.5) with <u²> = 5 σ² b / (sqrt(π) r C²). The mean of sixty
/// images is known to a standard error of their own scatter, three of which must be less than that.
#[test]
fn strong_noise_takes_nothing_from_the_blur() {
    const IMAGES: usize = 60;
    let truth = paper_lattice();
    let (radius_px, contrast) = (4.0, -110.0);
    let levels = blurred_levels(
        &Dots { radius_px, contrast, ..Dots::new(640, 480, truth.clone()) }.render_levels(),
        640,
    );
    let spread_px2 = [[radius_px * radius_px, 0.0], [0.0, radius_px * radius_px]];
    let starts: Vec<Start> =
        truth.iter().map(|&centre_px| Start { centre_px, spread_px2, neighbour_px: f64::INFINITY }).collect();
    let mut mask = vec![0_u8; levels.len()];
    for at in &truth {
        for (dx, dy) in (-5..=5).flat_map(|dx| (-5..=5).map(move |dy| (dx, dy))) {
            mask[(at.y as isize + dy) as usize * 640 + (at.x as isize + dx) as usize] = 255;
        }
    }
    let mut fit = DiscFit::new(&params());
    let mut blur_px = |noise: f64, seed: u64| {
        fit.learn(view(&noisy(&levels, noise, seed), 640), &mask, &starts);
        fit.blur_px()
    };
    let quiet_px = blur_px(1.0, 0);
    let found: Vec<f64> = (1..=IMAGES as u64).map(|seed| blur_px(24.0, seed)).collect();
    let mean = found.iter().sum::<f64>() / IMAGES as f64;
    let variance = found.iter().map(|b| (b - mean).powi(2)).sum::<f64>() / (IMAGES - 1) as f64;
    let error = (variance / IMAGES as f64).sqrt();
    let taken2 =
        5.0 * 24.0 * 24.0 * quiet_px / (std::f64::consts::PI.sqrt() * radius_px * contrast * contrast);
    let taken_px = quiet_px - (quiet_px * quiet_px - taken2).sqrt();
    assert!(3.0 * error < taken_px, "{error} says nothing of {taken_px}");
    assert!((mean - quiet_px).abs() < 3.0 * error, "{mean} of {quiet_px}, error {error}");
}

fn blurred(levels: &[f64], width: usize, noise: f64, seed: u64) -> Vec<u8> {
    noisy(&blurred_levels(levels, width), noise, seed)
}

fn noisy(levels: &[f64], noise: f64, seed: u64) -> Vec<u8> {
    let mut stream = Stream::new(seed, "white");
    levels.iter().map(|l| (l + noise * stream.normal() + 0.5) as u8).collect()
}

fn blurred_levels(levels: &[f64], width: usize) -> Vec<f64> {
    let sigma = 0.8;
    let kernel: Vec<f64> = (-4..=4).map(|k| (-0.5 * (f64::from(k) / sigma).powi(2)).exp()).collect();
    let total: f64 = kernel.iter().sum();
    let pass = |from: &[f64], step: isize| -> Vec<f64> {
        (0..from.len() as isize)
            .map(|n| {
                let at = |k: isize| from.get((n + k * step) as usize).copied().unwrap_or(180.0);
                kernel.iter().zip(-4..).map(|(w, k)| w * at(k)).sum::<f64>() / total
            })
            .collect()
    };
    pass(&pass(levels, 1), width as isize)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, failure_persistence: None, ..ProptestConfig::default() })]

    /// White noise on a slope of light is white noise of the same variance, with the rounding's.
    #[test]
    fn a_slope_of_light_is_no_grain(
        sigma in 1.0..3.0_f64, (slope_x, slope_y) in (-0.4..0.4, -0.4..0.4), seed in any::<u64>(),
    ) {
        const SIZE: usize = 200;
        let mut stream = Stream::new(seed, "noise");
        let image: Vec<u8> = (0..SIZE * SIZE)
            .map(|n| {
                let (x, y) = ((n % SIZE) as f64 - 100.0, (n / SIZE) as f64 - 100.0);
                (128.0 + slope_x * x + slope_y * y + sigma * stream.normal() + 0.5) as u8
            })
            .collect();
        let mut fit = DiscFit::new(&params());
        fit.learn(view(&image, SIZE), &vec![0; image.len()], &[]);
        let (found, expected) = (fit.noise(), sigma * sigma + 1.0 / 12.0);
        // Medians over at least 48 rows of 180 differences: 1.25 sqrt(2 * 1.5 / (48 * 180)) = 2.3 % of the
        // variance, five times.
        prop_assert!(
            (found.variance_levels2() / expected - 1.0).abs() < 5.0 * 0.023,
            "{found:?}, {expected}"
        );
        // By chance pixels 2 px apart differ 3 % less or more than those next to each other; the finest grain
        // there is (x = 0.4 in `from_variogram`) is 1 / 0.37 times that. The slope itself would be up to 1.3
        // levels².
        prop_assert!(found.grain_levels2 < 5.0 * 0.03 / 0.37 * expected, "{found:?}, {expected}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// One marker anywhere in a pixel: radius, tilt, contrast, light and noise at random.
    #[test]
    fn one_ellipse_is_found_where_it_is(
        (x, y) in (19.5..20.5, 19.5..20.5),
        radius in 2.2..6.0_f64, ratio in 0.6..1.0_f64, turn in 0.0..3.2_f64,
        contrast in 60.0..150.0_f64, (slope_x, slope_y) in (-0.5..0.5, -0.5..0.5),
        noise in 0.0..4.0_f64, blur_px in 0.6..1.1_f64, seed in any::<u64>(),
        (off_x, off_y) in (-0.1..0.1_f64, -0.1..0.1_f64),
    ) {
        let axes_px = DVec2::new(radius, radius * ratio);
        let (centre, slope) = (DVec2::new(x, y), DVec2::new(slope_x, slope_y));
        let dot = Ellipse { centre, axes_px, turn, contrast, slope, blur_px, noise };
        let image = dot.image(seed);
        let mean = radius * radius * ratio;
        let start = Start {
            centre_px: centre + DVec2::new(off_x, off_y),
            spread_px2: [[mean, 0.0], [0.0, mean]],
            neighbour_px: f64::INFINITY,
        };
        let mut fit = DiscFit::new(&params());
        let gel: Vec<u8> = (0..SIDE * SIDE)
            .map(|n| {
                let at = DVec2::new((n % SIDE) as f64, (n / SIDE) as f64);
                if at.distance(centre) < radius + 1.0 {
                    255
                } else {
                    0
                }
            })
            .collect();
        fit.learn(view(&image, SIDE), &gel, &[start]);
        let fitted = fit.run(view(&image, SIDE), &start);
        prop_assert!(fitted.is_some());
        let Some(fitted) = fitted else { return Ok(()) };
        let error = fitted.centre_px.distance(centre);
        // Five standard deviations per coordinate, 1.5 for small and tilted dots, whose short axis weighs
        // more, and the 8 x 8 samples of the picture with the profile's curvature.
        let most = 5.0 * 1.5 * dot.sigma_px() + 0.03;
        prop_assert!(error < most, "{error} above {most}: {fitted:?}");
        let expected = mean;
        let [[xx, xy], [_, yy]] = fitted.spread_px2;
        let found = (xx * yy - xy * xy).sqrt();
        prop_assert!(
            (found / expected).sqrt() > 0.85 && (found / expected).sqrt() < 1.15,
            "{found} {expected}"
        );
    }

    /// Any bytes and any start have an answer.
    #[test]
    fn row_30_any_window_has_an_answer(
        bytes in prop::collection::vec(any::<u8>(), 15 * 11),
        (x, y) in (-1e3..1e3_f64, -1e3..1e3_f64),
        (xx, xy, yy) in (-1.0..60.0_f64, -9.0..9.0_f64, -1.0..60.0_f64),
        neighbour_px in prop_oneof![0.0..20.0_f64, Just(f64::INFINITY), Just(f64::NAN)],
        near in any::<bool>(),
    ) {
        let centre_px = if near { DVec2::new(x, y) / 200.0 + 6.0 } else { DVec2::new(x, y) };
        let start = Start { centre_px, spread_px2: [[xx, xy], [xy, yy]], neighbour_px };
        let image = GrayView::new(&bytes, 15, 11, 15).unwrap();
        let mut fit = DiscFit::new(&params());
        fit.learn(image, &vec![0; bytes.len()], &[start; 3]);
        if let Some(fitted) = fit.run(image, &start) {
            prop_assert!(fitted.centre_px.distance(centre_px) < 60.0);
            let [[xx, xy], [_, yy]] = fitted.covariance_px2;
            prop_assert!(xx > 0.0 && yy > 0.0 && xx * yy > xy * xy);
        }
    }
}
