//! Noise of image sensor and light, against the normal distribution it stands for.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::images;
use gelstereo_sim::effects::{SensorNoise, ShotNoise};
use gelstereo_sim::{Effects, Scene};

const SIGMA: f64 = 20.0;

/// Deviations from the gel's level in units of the standard deviation, of both views and three frames: the
/// scene has no markers but the four of its corners, out of sight.
fn deviations() -> Vec<Vec<f64>> {
    let noise = SensorNoise { sigma_levels: SIGMA };
    let effects = Effects { sensor_noise: Some(noise), ..Effects::default() };
    let mut scene = Scene { effects, ..Scene::default() };
    (scene.gel.rows, scene.gel.cols, scene.gel.centre_mm) = (2, 2, [200.0, 0.0]);
    (scene.gel.bright_level, scene.gel.dark_level) = (128, 0);
    let unit = |image: Vec<u8>| image.into_iter().map(|level| (f64::from(level) - 128.0) / SIGMA).collect();
    (0..3).flat_map(|frame| images(&scene, frame)).map(unit).collect()
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    values.sum::<f64>() / n
}

/// Bands are five standard errors of n independent normal numbers: of the mean 1 / √n, of the variance
/// √(2/n), of the third moment √(15/n), of the fourth √(96/n); rounding adds a variance of 1/12 level².
#[test]
fn moments_are_the_normal_distributions() {
    for values in deviations() {
        let n = values.len() as f64;
        let moment = |power: i32| mean(values.iter().map(|v| v.powi(power)));
        assert!(moment(1).abs() < 5.0 / n.sqrt());
        assert!((moment(2) - 1.0 - 1.0 / 12.0 / (SIGMA * SIGMA)).abs() < 5.0 * (2.0 / n).sqrt());
        assert!(moment(3).abs() < 5.0 * (15.0 / n).sqrt());
        // 4096 quantiles end at 3.7 and so have a fourth moment of 2.988; of a sum of two half of the excess
        // is left.
        let kurtosis = moment(4) / moment(2).powi(2);
        assert!((kurtosis - 2.994).abs() < 5.0 * (96.0 / n).sqrt(), "{kurtosis}");
    }
}

#[test]
fn tails_are_as_heavy_as_they_should_be() {
    // Two-sided shares beyond 1, 2 and 3 standard deviations, half a level further out since levels are
    // rounded.
    for (beyond, share) in [(1.025, 0.30536), (2.025, 0.042867), (3.025, 0.0024863)] {
        for values in deviations() {
            let n = values.len() as f64;
            let found = values.iter().filter(|v| v.abs() > beyond).count() as f64 / n;
            // Five standard errors, and one quantile of 4096 at either end.
            let band = 5.0 * (share / n).sqrt() + 2.0 / 4096.0;
            assert!((found - share).abs() < band, "{found} beyond {beyond}");
        }
    }
}

/// Five standard errors of a correlation of n independent pairs, 1 / √n each.
#[test]
fn pixels_views_and_frames_are_independent() {
    let images = deviations();
    let correlation =
        |a: &[f64], b: &[f64]| mean(a.iter().zip(b).map(|(a, b)| a * b)) * (a.len() as f64).sqrt();
    for image in &images {
        // And of their squares, which a generator with a memory would show.
        let squares: Vec<f64> = image.iter().map(|v| (v * v - 1.0) / 2.0_f64.sqrt()).collect();
        for values in [image, &squares] {
            // Neighbours, those that one random number serves, rows above each other and diagonals.
            for apart in (1..=16).chain([639, 640, 641, 1280]) {
                let found = correlation(&values[apart..], &values[..values.len() - apart]);
                assert!(found.abs() < 5.0, "{apart} apart: {found} standard errors");
            }
        }
    }
    for (i, a) in images.iter().enumerate() {
        for b in &images[..i] {
            assert!(correlation(a, b).abs() < 5.0);
        }
    }
}

/// Variance in proportion to the level, and no other frame's or view's numbers. Five standard errors, √(2/n),
/// and a hundredth for rounding.
#[test]
fn shot_noise_grows_with_the_root_of_the_level() {
    let noise = ShotNoise { full_well_electrons: 2000.0 };
    for level in [40_u8, 90, 160, 215] {
        let effects = Effects { shot_noise: Some(noise.clone()), ..Effects::default() };
        let mut scene = Scene { effects, ..Scene::default() };
        (scene.gel.rows, scene.gel.cols, scene.gel.centre_mm) = (2, 2, [200.0, 0.0]);
        (scene.gel.bright_level, scene.gel.dark_level) = (level, 0);
        let [left, right] = images(&scene, 0);
        assert_ne!(left, right);
        assert_ne!(left, images(&scene, 1)[0]);
        let off: Vec<f64> = left.iter().map(|&found| f64::from(found) - f64::from(level)).collect();
        let n = off.len() as f64;
        let expected = 255.0 * f64::from(level) / 2000.0 + 1.0 / 12.0;
        assert!(mean(off.iter().copied()).abs() < 5.0 * (expected / n).sqrt(), "{level}");
        let variance = mean(off.iter().map(|v| v * v));
        assert!((variance / expected - 1.0).abs() < 5.0 * (2.0 / n).sqrt() + 0.01, "{level}: {variance}");
    }
}
