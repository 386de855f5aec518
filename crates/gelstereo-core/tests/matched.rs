//! The matched step against discs of which everything is known, and against the model fit, which it approximates.

use crate::support;

use gelstereo_core::detect::centre::fit::Noise;
use gelstereo_core::detect::centre::matched::{MAX_MISFIT, Matched, Refined};
use gelstereo_core::detect::{Detector, Markers};
use gelstereo_core::image::GrayView;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, erf};
use gelstereo_core::params::{Background, Centre, DetectParams, Polarity, Threshold};
use proptest::prelude::*;
use support::{Dots, errors, lattice, paper_lattice, view};

/// Of the lens, and with the width of a pixel.
const BLUR_PX: f64 = 0.8;
const ALL_BLUR_PX: f64 = 0.85;

fn params(centre: Centre) -> DetectParams {
    DetectParams {
        background: Background::Blocks,
        threshold: Threshold::Auto,
        centre,
        ..DetectParams::default()
    }
}

fn detect(params: &DetectParams, image: &[u8], width: usize) -> Markers {
    let mut markers = Markers::default();
    Detector::new(params).run(view(image, width), &mut markers).unwrap();
    markers
}

/// Share of a disc's contrast at distances from its centre behind a Gaussian lens, every 0.02 px: chord by chord, of
/// which a Gaussian sees the error function of its half length.
fn profile(radius_px: f64, blur_px: f64) -> Vec<f64> {
    const CHORDS: usize = 400;
    let share = |distance: f64| {
        let chord = |k: usize| {
            let x = radius_px * (2.0 * (k as f64 + 0.5) / CHORDS as f64 - 1.0);
            let z = (x - distance) / blur_px;
            let half = (radius_px * radius_px - x * x).sqrt();
            (-0.5 * z * z).exp() * erf(half / blur_px / 2.0_f64.sqrt())
        };
        let step = 2.0 * radius_px / CHORDS as f64;
        (0..CHORDS).map(chord).sum::<f64>() * step / blur_px / std::f64::consts::TAU.sqrt()
    };
    (0..700).map(|k| share(0.02 * f64::from(k))).collect()
}

/// Dots behind the lens, integrated over each pixel by 3 x 3 samples (Gauss), with white noise, in whole levels.
fn photograph(dots: &Dots) -> Vec<u8> {
    photograph_behind(dots, BLUR_PX)
}

/// Behind a lens of this blur.
fn photograph_behind(dots: &Dots, blur_px: f64) -> Vec<u8> {
    let profile = profile(dots.radius_px, blur_px);
    let at = |distance: f64| {
        let (place, part) = ((distance / 0.02) as usize, (distance / 0.02).fract());
        if place + 1 < profile.len() {
            profile[place] + part * (profile[place + 1] - profile[place])
        } else {
            0.0
        }
    };
    let nodes = [(-0.15_f64.sqrt(), 5.0 / 18.0), (0.0, 8.0 / 18.0), (0.15_f64.sqrt(), 5.0 / 18.0)];
    let mut levels = vec![dots.ground; dots.width * dots.height];
    for &centre in &dots.centres_px {
        let near = |c: f64, end: usize| (c - 11.0).max(0.0) as usize..((c + 12.0) as usize).min(end);
        for y in near(centre.y, dots.height) {
            for x in near(centre.x, dots.width) {
                for ((dx, wx), (dy, wy)) in nodes.iter().flat_map(|a| nodes.map(|b| (*a, b))) {
                    let sample = DVec2::new(x as f64 + dx, y as f64 + dy);
                    levels[y * dots.width + x] += dots.contrast * wx * wy * at(sample.distance(centre));
                }
            }
        }
    }
    let mut noise = Stream::new(dots.seed, "white");
    levels.iter().map(|level| (level + dots.noise * noise.normal() + 0.5) as u8).collect()
}

/// Standard deviation of one coordinate of a blurred circle's centre in white noise and rounding, by the closed form
/// for a long edge: sigma / C sqrt(2 b / (sqrt(pi) r)).
fn sigma_px(dots: &Dots) -> f64 {
    let noise = (dots.noise * dots.noise + 1.0 / 12.0).sqrt();
    let edge = 2.0 * ALL_BLUR_PX / (std::f64::consts::PI.sqrt() * dots.radius_px);
    noise / dots.contrast.abs() * edge.sqrt()
}

fn nearest_error(centre: DVec2, truth: &[DVec2]) -> DVec2 {
    truth.iter().map(|t| centre - *t).min_by(|a, b| a.length().total_cmp(&b.length())).unwrap()
}

/// What is left of a displacement, third order in it, is below 0.005 px per axis; rounding to levels adds its own.
#[test]
fn every_dot_of_a_lattice_is_found_where_it_is() {
    let truth = paper_lattice();
    for radius_px in [2.5, 4.3, 6.1] {
        for noise in [0.0, 2.0, 8.0] {
            let dots = Dots { noise, radius_px, ..Dots::new(640, 480, truth.clone()) };
            let markers = detect(&params(Centre::Matched), &photograph(&dots), 640);
            let (rms, near) = errors(&markers.centres_px, &truth);
            assert_eq!((markers.centres_px.len(), near, markers.unfitted), (625, 625, 0));
            // The closed form, and a quarter for curvature and for the parameters that are not known either.
            let most = 1.25 * sigma_px(&dots) * 2.0_f64.sqrt() + 0.005 * 2.0_f64.sqrt();
            assert!(rms <= most, "radius {radius_px}, noise {noise}: {rms} above {most}");
        }
    }
}

/// Mean errors over 5 x 5 parts of a pixel, 40 dots each without noise: neither the places of the weights nor rounding
/// pull them. Rounding's own error is 0.003 px, over 40 dots 0.0005 px.
#[test]
fn where_in_a_pixel_a_dot_lies_does_not_matter() {
    let mut sums = vec![(DVec2::ZERO, 0.0); 25];
    for frame in 0..2 {
        let at = DVec2::new(330.3, 240.7) + 0.31 * f64::from(frame);
        let truth = lattice(22, 22, 18.234, at, 3.0, 0.0);
        let markers = detect(&params(Centre::Matched), &photograph(&Dots::new(640, 480, truth.clone())), 640);
        assert_eq!((markers.centres_px.len(), markers.unfitted), (484, 0));
        for centre in &markers.centres_px {
            let error = nearest_error(*centre, &truth);
            let part = |x: f64| (5.0 * x.rem_euclid(1.0)) as usize;
            let (sum, count) = &mut sums[5 * part(centre.y) + part(centre.x)];
            *sum += error;
            *count += 1.0;
        }
    }
    for (part, (sum, count)) in sums.iter().enumerate() {
        let mean = *sum / *count;
        assert!(*count >= 15.0 && mean.length() < 0.005, "part {part}: {mean} of {count}");
    }
}

/// Normalised squared errors of n markers are 1 in the mean, with a standard deviation of 1 / sqrt(n); 99 %, and 3 %
/// for the variance of the noise, which is measured.
#[test]
fn covariances_are_calibrated_in_white_noise() {
    let truth = paper_lattice();
    for (noise, contrast) in [(2.0, -120.0), (6.0, -120.0), (18.0, -120.0), (2.0, -40.0)] {
        let (mut sum, mut count) = (0.0, 0.0);
        for seed in 0..2 {
            let dots = Dots { noise, contrast, seed, ..Dots::new(640, 480, truth.clone()) };
            let markers = detect(&params(Centre::Matched), &photograph(&dots), 640);
            for (centre, [[xx, _], [_, yy]]) in markers.centres_px.iter().zip(&markers.covariance_px2) {
                let error = nearest_error(*centre, &truth);
                sum += 0.5 * (error.x * error.x / xx + error.y * error.y / yy);
                count += 1.0;
            }
        }
        let nees = sum / count;
        let band = 2.6 / f64::sqrt(count) + 0.03;
        assert!((nees - 1.0).abs() < band, "noise {noise}, contrast {contrast}: {nees} of {count}");
    }
}

/// Weights that were made for one image serve the next one, whose blur may be a step and a half off theirs: what its
/// noise does is then another part of what they say, by a fifth of the variance here. As above, of six images behind
/// each lens.
#[test]
fn weights_for_another_blur_are_calibrated() {
    let truth = paper_lattice();
    for (first_px, then_px) in [(0.72, 0.86), (0.92, 0.78)] {
        let mut detector = Detector::new(&params(Centre::Matched));
        let (mut markers, mut sum, mut count) = (Markers::default(), 0.0, 0.0);
        let picture = |seed: u64, blur_px: f64| {
            photograph_behind(&Dots { noise: 6.0, seed, ..Dots::new(640, 480, truth.clone()) }, blur_px)
        };
        detector.run(view(&picture(0, first_px), 640), &mut markers).unwrap();
        for seed in 1..=6 {
            detector.run(view(&picture(seed, then_px), 640), &mut markers).unwrap();
            assert_eq!((markers.centres_px.len(), markers.unfitted), (625, 0));
            for (centre, [[xx, _], _]) in markers.centres_px.iter().zip(&markers.covariance_px2) {
                sum += 0.5 * nearest_error(*centre, &truth).length_squared() / xx;
                count += 1.0;
            }
        }
        let (nees, band) = (sum / count, 2.6 / f64::sqrt(count) + 0.03);
        assert!((nees - 1.0).abs() < band, "from {first_px} to {then_px} px: {nees}");
    }
}

/// How far centres without noise are from the truth for each px that the place of the weights is: the slope of errors over
/// what was left to step. None of it is left, whatever the blur the weights were made for; without a measured response it is 0.016.
/// It is measured on twelve markers, whose centres rounding to whole levels shifts by 0.003 px, between places 0.25 px apart:
/// 0.003 * 2^0.5 / 0.25 / 24^0.5 is 0.004, three of which are allowed.
#[test]
fn steps_go_as_far_as_discs_lie_off() {
    let at = DVec2::new(330.3, 240.7);
    let truth = lattice(22, 22, 18.234, at, 3.0, 0.0);
    for (first_px, then_px) in [(0.72, 0.86), (0.92, 0.78)] {
        let mut detector = Detector::new(&params(Centre::Matched));
        let mut markers = Markers::default();
        let mut slope = (0.0, 0.0);
        for (seed, blur_px) in [(0, first_px), (1, then_px)] {
            let picture = photograph_behind(&Dots { seed, ..Dots::new(640, 480, truth.clone()) }, blur_px);
            detector.run(view(&picture, 640), &mut markers).unwrap();
            slope = (0.0, 0.0);
            for centre in &markers.centres_px {
                let error = nearest_error(*centre, &truth);
                let off = to_step(*centre - error);
                slope = (slope.0 + off.dot(error), slope.1 + off.length_squared());
            }
        }
        let slope = slope.0 / slope.1;
        assert!(slope.abs() < 0.012, "from {first_px} to {then_px} px: {slope}");
    }
}

/// From the place of the weights that is nearest, the middle of a quarter of a pixel.
fn to_step(at: DVec2) -> DVec2 {
    let middle = |x: f64| ((x + 0.5) * 4.0).floor() / 4.0 + 0.125 - 0.5;
    at - DVec2::new(middle(at.x), middle(at.y))
}

/// The same information: no less precise than the fit by more than a tenth, and the two err alike.
#[test]
fn a_step_approximates_the_fit() {
    let truth = paper_lattice();
    let dots = Dots { noise: 4.0, ..Dots::new(640, 480, truth.clone()) };
    let image = photograph(&dots);
    let [step, fit] =
        [Centre::Matched, Centre::Fit].map(|centre| detect(&params(centre), &image, 640).centres_px);
    let (step_rms, fit_rms) = (errors(&step, &truth).0, errors(&fit, &truth).0);
    assert!(step_rms < 1.1 * fit_rms, "{step_rms} {fit_rms}");
    let (apart, near) = errors(&step, &fit);
    assert!(near == 625 && apart < 0.5 * fit_rms, "{apart} {fit_rms}");
}

/// Light marks on dark gel are the picture's negative: so are all sums.
#[test]
fn bright_markers_are_found_as_dark_ones_are() {
    let dots = Dots { noise: 2.0, ..Dots::new(640, 480, paper_lattice()) };
    let image = photograph(&dots);
    let negative: Vec<u8> = image.iter().map(|level| 255 - level).collect();
    let dark = detect(&params(Centre::Matched), &image, 640);
    let bright = DetectParams { polarity: Polarity::Bright, ..params(Centre::Matched) };
    let bright = detect(&bright, &negative, 640);
    let (apart, near) = errors(&bright.centres_px, &dark.centres_px);
    // Only the slope that light should have on the dot differs, and with it the weights: less than the error itself.
    assert!(near == 625 && bright.unfitted == 0 && apart < sigma_px(&dots) * 2.0_f64.sqrt(), "{apart}");
}

/// Neighbours that stand nearer than others do, from 12 px on, which is 3.4 px of gel: only the rim of the support
/// sees their blurred edge, and pulls by less than the grey centroid of such dots is wrong (0.04 px). Dots nearer
/// still are given up.
#[test]
fn near_neighbours_do_not_pull() {
    for (gap_px, most_px) in [(12.0, 0.04), (13.0, 0.02), (14.0, 0.012), (10.0, 0.12)] {
        let mut truth = paper_lattice();
        for row in [3, 8, 13, 18] {
            truth[25 * row + 12] = truth[25 * row + 13] - DVec2::new(gap_px, 0.0);
        }
        let image = photograph(&Dots::new(640, 480, truth.clone()));
        let markers = detect(&params(Centre::Matched), &image, 640);
        for centre in &markers.centres_px {
            let error = nearest_error(*centre, &truth).length();
            assert!(error < most_px, "{error} at {centre}, {gap_px} px apart");
        }
        assert_eq!(markers.unfitted > 0, gap_px < 11.0, "{gap_px}");
    }
}

fn prepared(image: &[u8], truth: &[DVec2]) -> Matched {
    let settings = params(Centre::Binary);
    let markers = detect(&settings, image, 640);
    assert_eq!(markers.centres_px.len(), truth.len());
    let mut matched = Matched::new(&settings);
    let noise = Noise { white_levels2: 4.1, ..Noise::default() };
    matched.prepare(GrayView::new(image, 640, 480, 640).unwrap(), noise, &markers);
    matched
}

/// From a prediction up to 1.5 px off, steps come to the same centre as from the centre itself, but for what one step
/// leaves.
#[test]
fn predictions_lead_to_the_same_centre() {
    let truth = paper_lattice();
    let image = photograph(&Dots { noise: 2.0, ..Dots::new(640, 480, truth.clone()) });
    let mut matched = prepared(&image, &truth);
    assert!((matched.blur_px() - ALL_BLUR_PX).abs() < 0.05, "{}", matched.blur_px());
    let mut stream = Stream::new(3, "predictions");
    for at in truth.iter().step_by(3) {
        let seen = matched.refine(view(&image, 640), *at, 4.3).unwrap();
        assert!(seen.misfit < 0.5 * MAX_MISFIT && (seen.contrast_levels + 120.0).abs() < 6.0, "{seen:?}");
        let angle = std::f64::consts::TAU * stream.uniform();
        let off = 1.5 * stream.uniform() * DVec2::from_angle(angle);
        let found = matched.refine(view(&image, 640), *at + off, 4.3).unwrap();
        assert!(found.centre_px.distance(seen.centre_px) < 0.02, "{off}: {found:?} {seen:?}");
    }
}

/// Uneven light has components grow with their contrast, though discs are alike; and perspective has discs grow.
/// Weights of a radius 0.26 px off answer by 0.92 to a disc's displacement, a variance of a fifth, those half a step
/// off by 0.98.
#[test]
fn radii_follow_areas_only_as_far_as_discs_do() {
    let truth = paper_lattice();
    let picture = |radius_px: f64| photograph(&Dots { radius_px, ..Dots::new(640, 480, truth.clone()) });
    let (alike, small, large) = (picture(4.3), picture(4.0), picture(4.6));
    let halves: Vec<u8> = (0..640 * 480).map(|n| if n % 640 < 330 { small[n] } else { large[n] }).collect();
    let grown = |at: DVec2| 4.1 + 0.3 * (at.x - 330.0) / 210.0;
    let halved = |at: DVec2| if at.x < 330.0 { 4.0 } else { 4.6 };
    let even = |_: DVec2| 4.3;
    type Radius<'a> = &'a dyn Fn(DVec2) -> f64;
    let cases: [(&[u8], Radius<'_>, Radius<'_>); 2] = [(&alike, &grown, &even), (&halves, &halved, &halved)];
    for (image, component_px, disc_px) in cases {
        let area = |at: &DVec2| (std::f64::consts::PI * component_px(*at).powi(2)).round() as u32;
        let area_px2: Vec<u32> = truth.iter().map(area).collect();
        let markers = Markers { area_px2: area_px2.clone(), ..Markers::at(truth.clone(), 0.1) };
        let mut matched = Matched::new(&params(Centre::Matched));
        matched.prepare(view(image, 640), Noise::default(), &markers);
        for (at, area) in truth.iter().zip(area_px2).filter(|(at, _)| (at.x - 330.0).abs() > 9.0) {
            let found = matched.radius_px(area);
            assert!((found - disc_px(*at)).abs() < 0.125, "{found} for {} at {at}", disc_px(*at));
        }
    }
}

/// What is no whole disc alone fits badly, or not at all.
#[test]
fn misfits_tell_what_is_no_disc() {
    let truth = paper_lattice();
    let dots = Dots { noise: 2.0, ..Dots::new(640, 480, truth.clone()) };
    let clean = photograph(&dots);
    let mut matched = prepared(&clean, &truth);
    let mut fits = |image: &[u8], at: DVec2| {
        let refined: Option<Refined> = matched.refine(view(image, 640), at, 4.3);
        refined.is_some_and(|refined| refined.misfit <= MAX_MISFIT)
    };
    for at in truth.iter().step_by(17) {
        assert!(fits(&clean, *at));
        let (x, y) = (at.x.round() as usize, at.y.round() as usize);
        let painted = |level: u8, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>| {
            let mut image = clean.clone();
            for row in rows {
                image[640 * row..][columns.clone()].fill(level);
            }
            image
        };
        assert!(!fits(&painted(180, x..x + 8, y - 8..y + 9), *at), "half of it covered");
        assert!(!fits(&painted(60, x - 7..x + 8, y - 1..y + 2), *at), "a dark smear across");
        assert!(!fits(&painted(60, x + 3..x + 10, y - 4..y + 5), *at), "merged with another");
        assert!(!fits(&painted(180, x - 8..x + 9, y - 8..y + 9), *at), "gone");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any bytes, noise, place and radius have an answer: a centre near by with a covariance, or none.
    #[test]
    fn row_30_any_window_has_an_answer(
        bytes in prop::collection::vec(any::<u8>(), 40 * 33),
        (x, y) in prop_oneof![(-1e3..1e3_f64, -1e3..1e3_f64), (0.0..40.0_f64, 0.0..33.0_f64), Just((f64::NAN, 1e300))],
        radius_px in prop_oneof![-1.0..30.0_f64, 1.0..8.0_f64, Just(f64::NAN), Just(f64::INFINITY)],
        (white, grain, size) in (0.01..1e4_f64, 0.0..1e4_f64, 0.1..10.0_f64),
        areas in prop::collection::vec(0..4000_u32, 0..6),
        bright in any::<bool>(),
    ) {
        let polarity = if bright { Polarity::Bright } else { Polarity::Dark };
        let mut matched = Matched::new(&DetectParams { polarity, ..params(Centre::Matched) });
        let image = GrayView::new(&bytes, 40, 33, 40).unwrap();
        prop_assert!(matched.refine(image, DVec2::new(x, y), radius_px).is_none(), "nothing was learned");
        let places = (0..areas.len()).map(|k| DVec2::new(7.0 * k as f64, 40.0 - 8.0 * k as f64)).collect();
        let markers = Markers { area_px2: areas, ..Markers::at(places, 0.1) };
        let noise = Noise { white_levels2: white, grain_levels2: grain, grain_size_px: size, ..Noise::default() };
        matched.prepare(image, noise, &markers);
        if let Some(found) = matched.refine(image, DVec2::new(x, y), radius_px) {
            prop_assert!(found.centre_px.distance(DVec2::new(x, y)) < 7.0);
            let [[xx, _], [_, yy]] = found.covariance_px2;
            prop_assert!(xx > 0.0 && xx.is_finite() && yy > 0.0 && yy.is_finite(), "{found:?}");
            prop_assert!(found.misfit >= 0.0 && found.misfit.is_finite() && found.contrast_levels.is_finite());
        }
    }
}
