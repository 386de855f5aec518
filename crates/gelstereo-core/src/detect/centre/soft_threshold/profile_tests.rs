//! Compares the profile with the mean marker and with sub-pixel positions.

use super::{Frame, Kept, Profile, RING_PX, RINGS, bessel_i1_scaled};
use crate::detect::centre::noise::Noise;
use crate::math::{abs, erf, exp, ln, sqrt};
use alloc::vec::Vec;
use core::f64::consts::PI;

const SIDE: usize = 16;
const CORNER: usize = 3;
const GEL_SHARE: f64 = -0.4;

/// Share of the band at a distance from a disc's centre, with a blur of 0.86 px: 2.5 bands of contrast.
fn share(radius_px: f64, distance_px: f64) -> f64 {
    GEL_SHARE + 2.0 * 0.5 * (1.0 - erf((distance_px - radius_px) / (0.86 * core::f64::consts::SQRT_2)))
}

/// Pixels of a window, relative to a centre at this offset from its middle.
fn places([x, y]: [f64; 2]) -> Vec<[f64; 2]> {
    let middle = 0.5 * (SIDE as f64 - 1.0);
    let at = |n: usize, off: f64| n as f64 - middle - off;
    (0..SIDE * SIDE).map(|n| [at(n % SIDE, x), at(n / SIDE, y)]).collect()
}

fn phases() -> impl Iterator<Item = [f64; 2]> {
    (0..64).map(|n| [f64::from(n % 8) / 8.0 - 0.4375, f64::from(n / 8) / 8.0 - 0.4375])
}

/// Variance of x pixel by pixel, from white noise and from grain, mean over sub-pixel positions.
fn reference(radius_px: f64, band: f64, noise: &Noise) -> [f64; 2] {
    let white = (noise.white_levels2 + 1.0 / 12.0) / (band * band);
    let grain = noise.grain_levels2 / (band * band);
    let alike = |d2: f64| exp(-0.25 * d2 / (noise.grain_size_px * noise.grain_size_px));
    let mut sums = [0.0; 2];
    for phase in phases() {
        let places = places(phase);
        let kept: Vec<Kept> = places
            .iter()
            .map(|[x, y]| Kept::of(share(radius_px, sqrt(x * x + y * y)), sqrt(white + grain)))
            .collect();
        let weight: f64 = kept.iter().map(|kept| kept.mean).sum();
        let slope: f64 =
            places.iter().zip(&kept).map(|([x, _], kept)| x * x * kept.within).sum::<f64>() / weight;
        let per = slope / (2.0 * (CORNER * CORNER * (SIDE - CORNER)) as f64);
        let end = |n: usize| match n {
            n if n < CORNER => -1.0,
            n if n >= SIDE - CORNER => 1.0,
            _ => 0.0,
        };
        let plane = |n: usize| per * end(n % SIDE) * abs(end(n / SIDE));
        let answer = |n: usize| plane(n) - kept[n].within * places[n][0] / weight;
        for n in 0..places.len() {
            // The part beyond first order is independent between pixels.
            let x = places[n][0] / weight;
            let more = kept[n].variance - (white + grain) * kept[n].within * kept[n].within;
            sums[0] += white * answer(n) * answer(n) + more * x * x;
            for m in 0..places.len() {
                let [dx, dy] = [places[n][0] - places[m][0], places[n][1] - places[m][1]];
                sums[1] += grain * answer(n) * answer(m) * alike(dx * dx + dy * dy);
            }
        }
    }
    sums.map(|sum| sum / 64.0)
}

fn profile(radius_px: f64, band: f64) -> Profile {
    let mut profile = Profile::new(radius_px);
    for phase in phases() {
        for [x, y] in places(phase) {
            profile.add(x * x + y * y, share(radius_px, sqrt(x * x + y * y)));
        }
        let (corner_px, apart_px) = (CORNER as f64, (SIDE - CORNER) as f64);
        profile.close(Frame { band, gel_level: 150.0, gel_share: GEL_SHARE, corner_px, apart_px });
    }
    profile
}

/// Marker that a profile approximates: the mean over sub-pixel positions, sampled on pixels of an eighth.
/// White noise, grain, and the grain in rings cut by the window or shared by the corners and the marker.
struct MeanMarker {
    white: f64,
    grain: f64,
    cut: f64,
    common: f64,
    /// Part of white noise and grain that is due to the slope of the gel.
    tilted: [f64; 2],
    weight: f64,
}

fn mean_marker(radius_px: f64, band: f64, noise: &Noise) -> MeanMarker {
    const FINE: usize = 8 * SIDE;
    let at = |n: usize| (n as f64 - 0.5 * (FINE as f64 - 1.0)) / 8.0;
    let white = (noise.white_levels2 + 1.0 / 12.0) / (band * band);
    let grain = noise.grain_levels2 / (band * band);
    let alike = |apart: f64| exp(-0.25 * apart * apart / (noise.grain_size_px * noise.grain_size_px));
    let places: Vec<[f64; 2]> = (0..FINE * FINE).map(|n| [at(n % FINE), at(n / FINE)]).collect();
    let share = |[x, y]: &[f64; 2]| share(radius_px, sqrt(x * x + y * y));
    let kept: Vec<Kept> = places.iter().map(|at| Kept::of(share(at), sqrt(white + grain))).collect();
    let weight = kept.iter().map(|kept| kept.mean).sum::<f64>() / 64.0;
    let squares = places.iter().zip(&kept).map(|([x, _], kept)| x * x * kept.within);
    let per = squares.sum::<f64>() / 64.0 / weight / (2 * CORNER * CORNER * (SIDE - CORNER)) as f64;
    let end = |n: usize| f64::from(u8::from(n >= SIDE - CORNER)) - f64::from(u8::from(n < CORNER));
    let plane = |n: usize| per * end(n % SIDE) * abs(end(n / SIDE));
    // Covariance of each pixel of a window with its corners.
    let cornered: Vec<f64> = (0..SIDE * SIDE)
        .map(|n| {
            let apart = |m: usize| [m % SIDE, m / SIDE].map(|k| k as f64);
            let [x, y] = apart(n);
            (0..SIDE * SIDE).map(|m| plane(m) * alike(x - apart(m)[0]) * alike(y - apart(m)[1])).sum()
        })
        .collect();
    let pixel = |n: usize| n % FINE / 8 + n / FINE / 8 * SIDE;
    let answers: Vec<f64> = (0..FINE * FINE).map(|n| -kept[n].within * places[n][0] / weight).collect();
    let rows: Vec<f64> = (0..FINE * FINE)
        .map(|n| (0..FINE).map(|k| alike(at(k) - at(n % FINE)) * answers[n / FINE * FINE + k]).sum::<f64>())
        .collect();
    let around = |n: usize| -> f64 {
        answers[n] * (0..FINE).map(|k| alike(at(k) - at(n / FINE)) * rows[k * FINE + n % FINE]).sum::<f64>()
    };
    let tilted = (0..SIDE * SIDE).map(|n| plane(n) * cornered[n]).sum::<f64>() * grain;
    let plane2 = (0..SIDE * SIDE).map(|n| plane(n) * plane(n)).sum::<f64>() * white;
    let mut sums =
        MeanMarker { white: 0.0, grain: tilted, cut: 0.0, common: 0.0, tilted: [plane2, tilted], weight };
    for n in 0..FINE * FINE {
        let [x, y] = places[n];
        let more = kept[n].variance - (white + grain) * kept[n].within * kept[n].within;
        let answer = answers[n] + plane(pixel(n));
        sums.white += (white * answer * answer + more * x * x / (weight * weight)) / 64.0;
        let common = 2.0 * cornered[pixel(n)] * answers[n] / 64.0 * grain;
        sums.grain += common + around(n) / (64.0 * 64.0) * grain;
        sums.common += abs(common);
        // The side of a window is this near if its marker is half a pixel off its middle.
        if sqrt(x * x + y * y) > 0.5 * SIDE as f64 - 0.9375 {
            sums.cut += abs(common);
        }
    }
    sums
}

const CASES: [(f64, f64, f64, f64); 6] = [
    (4.6, 60.0, 4.0, 4.0),
    (4.6, 14.0, 4.0, 0.2),
    (4.6, 73.0, 324.0, 4.0),
    (3.5, 60.0, 4.0, 4.0),
    (4.1, 40.0, 4.0, 1.0),
    (5.0, 60.0, 1.0, 4.0),
];

fn noise_of(white_levels2: f64, grain_levels2: f64) -> Noise {
    Noise { white_levels2, grain_levels2, grain_size_px: 1.38, gel_level: 150.0 }
}

/// Width of the edge over which weights grow, px: where the blurred contrast is between 0.2 and 0.7 of
/// the total.
const EDGE_PX: f64 = (0.8416 + 0.5244) * 0.86;

/// Rings and integrals around them against the mean marker that they approximate, on pixels of an eighth.
///
/// White noise: uniform shares within half a ring, of variance σ², are taken as normal. Var(kept | noise)
/// then loses <P>² σ² instead of <P²> σ². Where weights end, P = Φ(z / s) in noise s, and
/// ∫ <P²> - <P>² = (t - s) / π^0.5 with t² = s² + σ². Both ends together give at most 2 σ² (t - s) / π^0.5
/// more than the white noise over the band. The points of a ring are off its middle by their mean, less
/// than random points would be: three such deviations to either side are allowed.
///
/// Grain: for an edge of width w, a ring of width δ half inside it is placed δ / 4 too far out. This adds
/// up to δ² / 4 to the variance of radii; that within rings, δ² / 12, is neglected. Two radii give twice
/// that, times half the kernel's curvature 1 / (2 l²). The covariance of corners and marker assumes a
/// centred marker, while markers are off by 1 / 12 px² in either direction: half the kernel's Laplacian,
/// largest at the outermost pixel. It is also spread evenly over rings cut by the window, whose pixels
/// lie near the corners: at most the whole of these rings is missing.
#[test]
fn variances_are_those_of_the_mean_marker() {
    for (radius_px, band, white_levels2, grain_levels2) in CASES {
        let noise = noise_of(white_levels2, grain_levels2);
        let found = profile(radius_px, band).variances(&noise).unwrap();
        let mean = mean_marker(radius_px, band, &noise);
        let white = (white_levels2 + 1.0 / 12.0) / (band * band);
        let s = sqrt(white + grain_levels2 / (band * band));
        let steepest = 2.0 / (0.86 * sqrt(2.0 * PI)) * RING_PX;
        let spread = steepest * steepest / 48.0;
        let rings = 2.0 * spread * (sqrt(s * s + spread) - s) / sqrt(PI) / white;
        let points = 64.0 * 2.0 * PI * radius_px * EDGE_PX;
        let off = 3.0 * 2.0 * RING_PX / sqrt(12.0) / radius_px / sqrt(points);
        let whites = found.white / mean.white - 1.0;
        let text = alloc::format!("{radius_px} px, band {band}: {whites:.5}, {off:.5} {rings:.5}");
        assert!((-off..off + rings).contains(&whites), "white {text}");

        let l2 = noise.grain_size_px * noise.grain_size_px;
        let curved = RING_PX * RING_PX / 4.0 / (2.0 * l2);
        let far_px = 0.5 * (SIDE as f64 - 1.0) * sqrt(2.0) - radius_px;
        let offset = (far_px * far_px / (4.0 * l2 * l2) - 1.0 / l2).max(1.0 / l2) / 24.0;
        let around = mean.grain + mean.common;
        let max = (curved + off) * around + offset * mean.common + mean.cut;
        let grains = found.grain - mean.grain;
        let text = alloc::format!("{radius_px} px, band {band}: {grains:e} of {:e}, {max:e}", mean.grain);
        assert!(abs(grains) < max, "grain {text}");
    }
}

/// The mean marker against sums over all pixels and pairs, averaged over sub-pixel positions. The latter
/// variances are larger by the squares of the position-dependent terms.
///
/// By Poisson's summation, a sum over the grid's pixels varies with the position by the Fourier transform
/// of its terms at the wave vectors 2π n. For x P on an edge of radius r and width w that is at most
/// 2π r² cos ψ J1(q r) B(q) with J1² <= 2 / (π q r) and B <= 2 / q, q = 2π |n|; grain of variance 1
/// contributes its square. For x² P, of mean π r³ w, it is 2π r³ cos² ψ J0(q r) B(q). Sums over all n of
/// |n|^-3 are 9.034, of cos² ψ half of that, of cos⁴ ψ less.
#[test]
fn what_differs_from_place_to_place_adds_little_to_the_mean_marker() {
    const ALIASES: f64 = 9.034 / (8.0 * PI * PI * PI);
    for (radius_px, band, white_levels2, grain_levels2) in CASES {
        let noise = noise_of(white_levels2, grain_levels2);
        let mean = mean_marker(radius_px, band, &noise);
        let [white, grain] = reference(radius_px, band, &noise);
        let slopes = 32.0 / (PI * radius_px * EDGE_PX * EDGE_PX) * 0.5 * ALIASES;
        let max_white = slopes * mean.tilted[0];
        let around = 32.0 * PI * radius_px.powi(3) / (mean.weight * mean.weight) * 0.5 * ALIASES;
        let max_grain = around * grain_levels2 / (band * band) + slopes * mean.tilted[1];
        let more = [white - mean.white, grain - mean.grain];
        let text = alloc::format!("{radius_px} px, band {band}: {more:?} {max_white} {max_grain}");
        assert!((-1e-4 * white..max_white + 1e-4 * white).contains(&more[0]), "white {text}");
        assert!((0.0..max_grain).contains(&more[1]), "grain {text}");
    }
}

/// Against differences of the same profile in slightly more noise, as for a fainter marker of this shape.
#[test]
fn the_power_is_by_how_much_white_noise_grows() {
    for (white_levels2, grain_levels2) in [(4.0, 4.0), (324.0, 0.01), (324.0, 40.0)] {
        let at = |band: f64| {
            let noise = Noise { white_levels2, grain_levels2, grain_size_px: 1.38, gel_level: 150.0 };
            profile(4.6, band).variances(&noise).unwrap()
        };
        let (fainter, usual, stronger) = (at(72.0), at(73.0), at(74.0));
        let power = ln(fainter.white / stronger.white) / ln(fainter.per_band2 / stronger.per_band2);
        assert!(abs(usual.power / power - 1.0) < 0.03, "{} {power}", usual.power);
    }
}

/// Against numerical integrals over a normal distribution, and finite differences.
#[test]
fn kept_variables_have_these_moments() {
    for (mean, deviation) in [(-0.4, 0.25), (0.1, 0.05), (0.5, 1.0), (1.2, 0.3)] {
        let (mut sums, step) = ([0.0; 4], 1e-4);
        for k in -80_000..=80_000 {
            let z = f64::from(k) * step;
            let (density, value) = (step * exp(-0.5 * z * z) / sqrt(2.0 * PI), mean + deviation * z);
            let kept = value.clamp(0.0, 1.0);
            let within = f64::from(u8::from(kept == value));
            let terms = [1.0, kept, kept * kept, within];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += density * term);
        }
        let [_, first, second, within] = sums;
        let kept = Kept::of(mean, deviation);
        assert!(abs(kept.mean - first) < 1e-6 && abs(kept.variance - (second - first * first)) < 1e-6);
        assert!(abs(kept.within - within) < 1e-3);
        let step = 1e-4 * deviation * deviation;
        let [less, more] = [-step, step].map(|step| Kept::of(mean, sqrt(deviation * deviation + step)));
        let differs = |found: f64, at: fn(&Kept) -> f64| abs(found - 0.5 * (at(&more) - at(&less)) / step);
        let growth = &kept.growth;
        assert!(differs(growth.mean, |kept| kept.mean) < 1e-5 / deviation);
        assert!(differs(growth.variance, |kept| kept.variance) < 1e-5 / deviation);
        assert!(differs(growth.within, |kept| kept.within) < 1e-5 / (deviation * deviation));
    }
}

/// Against the integral of exp(x (cos t - 1)) cos t over the circle.
#[test]
fn the_bessel_function_is_its_integral() {
    for k in 0..100 {
        let x = 0.01 + 0.4 * f64::from(k);
        let term = |n: i32| {
            let c = crate::math::cos(2.0 * PI * f64::from(n) / 1000.0);
            exp(x * (c - 1.0)) * c / 1000.0
        };
        let expected: f64 = (0..1000).map(term).sum();
        assert!(abs(bessel_i1_scaled(x) - expected) < 3e-7, "{x}");
    }
}

/// Before, pixels of a tray beside a single marker made every error of its image eight times as large.
#[test]
fn a_tray_beside_one_marker_changes_no_error() {
    let clear = profile(4.1, 60.0);
    let mut beside = clear.clone();
    // As far as only the outermost pixels of a window.
    for (nearer, share) in [(0.0, 0.7), (3.0, 0.9)] {
        beside.add((RINGS as f64 - 1.0 - nearer) / clear.per_px2, share);
    }
    let (before, wrong) = (clear.grid_error_px2(0.03), beside.grid_error_px2(0.03));
    beside.end_at_edge();
    let after = beside.grid_error_px2(0.03);
    assert!(wrong > 2.0 * before && abs(after / before - 1.0) < 1e-9, "{before} {wrong} {after}");
}

/// The error of equal markers depends on their radius, and that of unequal ones is its mean.
#[test]
fn errors_by_the_grid_are_means_over_the_radii() {
    let mut mixed = profile(4.1, 60.0);
    assert!(mixed.radii_px2() < 1e-4, "{}", mixed.radii_px2());
    let frame = mixed.frame.unwrap();
    for radius_px in [4.1 - 0.15, 4.1 + 0.15] {
        for phase in phases() {
            for [x, y] in places(phase) {
                mixed.add(x * x + y * y, share(radius_px, sqrt(x * x + y * y)));
            }
            mixed.close(frame);
        }
    }
    // Two of three markers are 0.15 px off the mean.
    let expected_px2 = 2.0 / 3.0 * 0.15 * 0.15;
    assert!(abs(mixed.radii_px2() / expected_px2 - 1.0) < 0.1, "{}", mixed.radii_px2());
    let alike = [3.95, 4.1, 4.25].map(|radius_px| profile(radius_px, 60.0).grid_error_px2(0.03));
    let (least, largest) =
        (alike.into_iter().fold(f64::MAX, f64::min), alike.into_iter().fold(0.0, f64::max));
    let found = mixed.grid_error_px2(0.03);
    assert!((0.3 * least..1.5 * largest).contains(&found), "{found} {alike:?}");
}
