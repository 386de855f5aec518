//! How a marker's weights fall off with the distance from its centre, and what noise does to the centre of such weights.

use crate::detect::fit::Noise;
use crate::math::{erf, exp, sqrt};
use core::f64::consts::{FRAC_1_SQRT_2, TAU};

/// Rings of equal area: a quarter of a pixel wide at the outline of a disc of any radius.
const RINGS: usize = 64;
const RING_PX: f64 = 0.25;
/// Variance of rounding weights to whole grey levels, as the image's levels are.
const ROUNDING_LEVELS2: f64 = 1.0 / 12.0;
/// Grain that is less alike than e to the minus this is not counted.
const UNLIKE: f64 = 8.0;
/// Nor are rings whose pixels answer by less: a ten-thousandth of what those of the edge do.
const LEAST_ANSWER: f64 = 1e-4;

/// A window about a marker as its gel is measured: at its corners.
#[derive(Clone, Copy, Debug)]
pub(in crate::detect) struct Frame {
    /// Contrast over which a pixel's weight grows, grey levels.
    pub band: f64,
    /// Level of the gel.
    pub gel_level: f64,
    /// Share of the band that gel without noise has: it is negative.
    pub gel_share: f64,
    /// Side of the squares in the corners, and how far they are apart, pixels.
    pub corner_px: f64,
    pub apart_px: f64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Ring {
    pixels: f64,
    /// Sum of the pixels' shares of the band.
    shares: f64,
}

/// Mean shares of the band around the centres of some markers: over a ring of some markers the noise of single pixels is averaged
/// out, and over places within a pixel what those few pixels of an edge that lie within the band differ by.
#[derive(Clone, Debug)]
pub(super) struct Profile {
    rings: [Ring; RINGS],
    per_px2: f64,
    windows: f64,
    /// Sums over the windows.
    per_band2: f64,
    gel_levels: f64,
    frame: Option<Frame>,
}

/// Variances of a coordinate, px²: from white noise and from grain, of a marker of the usual band.
#[derive(Clone, Copy, Debug)]
pub(super) struct Variances {
    pub white: f64,
    pub grain: f64,
    /// Mean of 1 / band².
    pub per_band2: f64,
    /// Power of 1 / band² by which the part of white noise grows: one where noise keeps pixels within the band, and more where
    /// gel gets into it; never less, as noise beyond the band would have it.
    pub power: f64,
    /// Standard deviation of a pixel over the band.
    pub noise_share: f64,
}

impl Profile {
    /// Of discs of about this radius.
    pub fn new(radius_px: f64) -> Self {
        Self {
            rings: [Ring::default(); RINGS],
            per_px2: 1.0 / (2.0 * radius_px.max(1.0) * RING_PX),
            windows: 0.0,
            per_band2: 0.0,
            gel_levels: 0.0,
            frame: None,
        }
    }

    /// Adds a pixel: its squared distance from its marker's centre, and its contrast as a share of the band.
    #[inline]
    pub fn add(&mut self, distance_px2: f64, share: f64) {
        let ring = &mut self.rings[((distance_px2 * self.per_px2) as usize).min(RINGS - 1)];
        ring.pixels += 1.0;
        ring.shares += share;
    }

    /// The window whose pixels were added.
    pub fn close(&mut self, frame: Frame) {
        self.windows += 1.0;
        self.per_band2 += 1.0 / (frame.band * frame.band);
        self.gel_levels += frame.gel_level;
        self.frame = Some(frame);
    }

    /// Mean share of a ring; that of the gel where there are no pixels.
    fn share(&self, ring: usize) -> f64 {
        let Ring { pixels, shares } = self.rings[ring];
        if pixels > 0.0 { shares / pixels } else { self.frame.map_or(0.0, |frame| frame.gel_share) }
    }

    /// Variances in this noise; `None` where there is no marker.
    ///
    /// The centre is Σ w p / Σ w over pixels p of weights w, which are the shares kept to 0..=1. To first order it answers to the
    /// noise n of a pixel by P p / Σ w, with P the probability that noise leaves the pixel within the band; and to the slope of
    /// the gel, which is the difference of its corners, by A = Σ P x² / Σ w. White noise: Σ var(w) x² / (Σ w)² with the variance
    /// of the kept weight itself, which is less than P times the noise's; A² times the variance of the slope; and less for what
    /// the corners, which are among the pixels, have in both. Grain is the same, but neighbours are alike; P serves, for it is small
    /// beside the band.
    pub fn variances(&self, noise: &Noise) -> Option<Variances> {
        let frame = self.frame?;
        let per_band2 = self.per_band2 / self.windows;
        let grain_levels2 = noise.grain_levels2 * noise.grain_share(self.gel_levels / self.windows);
        let white = (noise.white_levels2 + ROUNDING_LEVELS2) * per_band2;
        let grain = grain_levels2 * per_band2;
        let noise_share = sqrt(white + grain);
        let (mut weight, mut slope, mut edge) = (0.0, 0.0, 0.0);
        // Their derivatives by the logarithm of all noise's variance.
        let (mut weight_grows, mut slope_grows, mut edge_grows) = (0.0, 0.0, 0.0);
        // Of each ring, what its pixels answer by, and its radius.
        let mut answers = [(0.0, 0.0); RINGS];
        for (n, (ring, answer)) in self.rings.iter().zip(&mut answers).enumerate() {
            if !(ring.pixels > 0.0) {
                continue;
            }
            let distance_px2 = (n as f64 + 0.5) / self.per_px2;
            // The shares of a ring's pixels are spread evenly between those of its neighbours: two halves, each with the variance of
            // what is left.
            let steep = 0.5 * (self.share((n + 1).min(RINGS - 1)) - self.share(n.saturating_sub(1)));
            let spread = steep * steep / 48.0;
            let mut answers_by = 0.0;
            for half in [-0.25, 0.25] {
                let share = self.share(n) + half * steep;
                let kept = Kept::of(share, sqrt(white + grain + spread));
                let Kept { mean, variance, within, growth } = kept;
                weight += 0.5 * ring.pixels * mean;
                weight_grows += 0.5 * ring.pixels * growth.mean * (white + grain);
                slope += 0.25 * ring.pixels * distance_px2 * within;
                slope_grows += 0.25 * ring.pixels * distance_px2 * growth.within * (white + grain);
                let own = variance - (grain + spread) * within * within;
                let alike_grows = 2.0 * (grain + spread) * within * growth.within * (white + grain);
                let own_grows = growth.variance * (white + grain) - grain * within * within - alike_grows;
                edge += 0.25 * ring.pixels * distance_px2 * own;
                edge_grows += 0.25 * ring.pixels * distance_px2 * own_grows;
                answers_by += 0.5 * within;
            }
            let radius_px = sqrt(distance_px2);
            *answer = (ring.pixels * radius_px * answers_by, radius_px);
        }
        if !(weight > 0.0) {
            return None;
        }
        let per_weight = weight_grows / weight;
        let (per_slope, per_edge) = (slope_grows / slope - per_weight, edge_grows / edge - 2.0 * per_weight);
        let (slope, weight) = (slope / weight, weight / self.windows);
        let edge = edge / (self.windows * weight * weight);
        answers.iter_mut().for_each(|(answer, _)| *answer /= self.windows * weight);
        let Frame { corner_px, apart_px, gel_share, .. } = frame;
        let tilt = slope / (corner_px * apart_px);
        let Kept { within, growth, .. } = Kept::of(gel_share, noise_share);
        let (plane, both) = (tilt * tilt * white, 2.0 * slope * white / weight);
        let white_px2 = edge + plane - both * within;
        let both_grows = (1.0 + per_slope - per_weight) * within + growth.within * (white + grain);
        let white_grows = per_edge * edge + (1.0 + 2.0 * per_slope) * plane - both * both_grows;
        let size_px = noise.grain_size_px;
        let corner = side_alike(corner_px as usize, size_px) / corner_px;
        let both = 4.0 * tilt / corner_px * near_corner(&answers, &frame, size_px);
        let grain_px2 = (around(&answers, size_px) + tilt * tilt * corner * corner - both) * grain;
        (white_px2 > 0.0 && grain_px2 >= 0.0).then_some(Variances {
            white: white_px2,
            grain: grain_px2,
            per_band2,
            power: (white_grows / white_px2).max(1.0),
            noise_share,
        })
    }
}

/// A normal variable that is kept to 0..=1.
struct Kept {
    mean: f64,
    variance: f64,
    /// How often it need not be.
    within: f64,
    growth: Growth,
}

/// Derivatives by the variance of the variable before it is kept.
struct Growth {
    mean: f64,
    variance: f64,
    within: f64,
}

impl Kept {
    fn of(mean: f64, deviation: f64) -> Self {
        let below = |z: f64| 0.5 + 0.5 * erf(z * FRAC_1_SQRT_2);
        let density = |z: f64| exp(-0.5 * z * z) / sqrt(TAU);
        let (low, high) = (-mean / deviation, (1.0 - mean) / deviation);
        let (within, above) = (below(high) - below(low), below(-high));
        let (at_low, at_high) = (deviation * density(low), deviation * density(high));
        let first = mean * within + at_low - at_high + above;
        let second =
            (mean * mean + deviation * deviation) * within + mean * at_low - (mean + 1.0) * at_high + above;
        // Of the mean of any g it is that of g'' / 2, which has steps of slope at both ends.
        let per = 0.5 / (deviation * deviation);
        let mean_grows = (at_low - at_high) * per;
        let growth = Growth {
            mean: mean_grows,
            variance: within - 2.0 * at_high * per - 2.0 * first * mean_grows,
            within: (low * at_low - high * at_high) * per / deviation,
        };
        Self { mean: first, variance: (second - first * first).max(0.0), within, growth }
    }
}

/// What a point at a distance s has in common with a ring of radius r in grain of variance 1, whose correlation
/// exp(-d² / (4 l²)) is averaged over the ring with the cosine of the angle: exp(-(r² + s²) / (4 l²)) I1(r s / (2 l²)). `None`
/// where that is nothing.
fn alike(r: f64, s: f64, grain_size_px: f64) -> Option<f64> {
    let per_l2 = 0.25 / (grain_size_px * grain_size_px);
    let unlike = (r - s) * (r - s) * per_l2;
    (unlike < UNLIKE).then(|| exp(-unlike) * bessel_i1_scaled(2.0 * per_l2 * r * s))
}

/// Rings of these answers that have any, with their radii.
fn felt(answers: &[(f64, f64)]) -> impl Iterator<Item = (usize, (f64, f64))> {
    answers.iter().copied().enumerate().filter(|(_, (answer, _))| *answer > LEAST_ANSWER)
}

/// Variance of a coordinate of Σ P p / Σ w in grain of variance 1: half the sum over all pairs of rings.
fn around(answers: &[(f64, f64); RINGS], grain_size_px: f64) -> f64 {
    let mut sum = 0.0;
    for (k, (a, r)) in felt(answers) {
        for (j, (b, s)) in felt(&answers[..=k]) {
            let both = if j == k { 0.5 } else { 1.0 };
            sum += both * a * b * alike(r, s, grain_size_px).unwrap_or(0.0);
        }
    }
    sum
}

/// What the pixels of one corner have in common with the rings, each by the cosine of its angle.
fn near_corner(answers: &[(f64, f64); RINGS], frame: &Frame, grain_size_px: f64) -> f64 {
    let (corner, outermost) = (frame.corner_px as usize, 0.5 * (frame.apart_px + frame.corner_px - 1.0));
    let mut sum = 0.0;
    for (row, column) in
        (0..corner * corner).map(|n| (n / corner, n % corner)).filter(|(row, column)| column <= row)
    {
        let (x, y) = (outermost - column as f64, outermost - row as f64);
        let far_px = sqrt(x * x + y * y);
        let cosines = (if row == column { x } else { x + y }) / far_px;
        for (_, (a, r)) in felt(answers) {
            sum += a * cosines * alike(r, far_px, grain_size_px).unwrap_or(0.0);
        }
    }
    sum
}

/// Sum over all pairs of so many pixels in a row of what they have in common in grain of variance 1.
fn side_alike(pixels: usize, grain_size_px: f64) -> f64 {
    let per_l2 = 0.25 / (grain_size_px * grain_size_px);
    let at = |apart: usize| exp(-per_l2 * (apart * apart) as f64);
    let pairs = |apart: usize| 2.0 * (pixels - apart) as f64;
    (1..pixels).map(|apart| pairs(apart) * at(apart)).sum::<f64>() + pixels as f64
}

/// exp(-x) I1(x) for x >= 0, to 3e-7 (Abramowitz and Stegun 1964, 9.8.3 and 9.8.4).
fn bessel_i1_scaled(x: f64) -> f64 {
    const NEAR: [f64; 7] =
        [0.5, 0.878_905_94, 0.514_988_69, 0.150_849_34, 0.026_587_33, 0.003_015_32, 0.000_324_11];
    const FAR: [f64; 9] = [
        0.398_942_28,
        -0.039_880_24,
        -0.003_620_18,
        0.001_638_01,
        -0.010_315_55,
        0.022_829_67,
        -0.028_953_12,
        0.017_876_54,
        -0.004_200_59,
    ];
    let sum = |terms: &[f64], t: f64| terms.iter().rev().fold(0.0, |sum, term| sum * t + term);
    let t = x / 3.75;
    if t < 1.0 { x * exp(-x) * sum(&NEAR, t * t) } else { sum(&FAR, 1.0 / t) / sqrt(x) }
}

#[cfg(test)]
mod tests {
    use super::{Frame, Kept, Profile, RING_PX, bessel_i1_scaled};
    use crate::detect::fit::Noise;
    use crate::math::{abs, erf, exp, ln, sqrt};
    use alloc::vec::Vec;
    use core::f64::consts::PI;

    const SIDE: usize = 16;
    const CORNER: usize = 3;
    const GEL_SHARE: f64 = -0.4;

    /// Share of the band at a distance from a disc's centre, behind a blur of 0.86 px: 2.5 bands of contrast.
    fn share(radius_px: f64, distance_px: f64) -> f64 {
        GEL_SHARE + 2.0 * 0.5 * (1.0 - erf((distance_px - radius_px) / (0.86 * core::f64::consts::SQRT_2)))
    }

    /// Pixels of a window about a centre so far from its middle: places from the centre.
    fn places([x, y]: [f64; 2]) -> Vec<[f64; 2]> {
        let middle = 0.5 * (SIDE as f64 - 1.0);
        let at = |n: usize, off: f64| n as f64 - middle - off;
        (0..SIDE * SIDE).map(|n| [at(n % SIDE, x), at(n / SIDE, y)]).collect()
    }

    fn phases() -> impl Iterator<Item = [f64; 2]> {
        (0..64).map(|n| [f64::from(n % 8) / 8.0 - 0.4375, f64::from(n / 8) / 8.0 - 0.4375])
    }

    /// Variance of x pixel by pixel, from white noise and from grain, mean over places within a pixel.
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
                // Beyond its first order a pixel's own noise is nobody else's.
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

    /// What a profile approximates: the marker in the mean over places within a pixel, which is a marker on pixels of an eighth. White
    /// noise, grain, and what of the grain rings hold that the window cuts, or the corners have in common with the marker.
    struct MeanMarker {
        white: f64,
        grain: f64,
        cut: f64,
        common: f64,
        /// Part of white noise and grain that comes by the slope of the gel.
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
        // What each pixel of a window has in common with its corners.
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
            .map(|n| {
                (0..FINE).map(|k| alike(at(k) - at(n % FINE)) * answers[n / FINE * FINE + k]).sum::<f64>()
            })
            .collect();
        let around = |n: usize| -> f64 {
            answers[n]
                * (0..FINE).map(|k| alike(at(k) - at(n / FINE)) * rows[k * FINE + n % FINE]).sum::<f64>()
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
            // The side of a window is so near where its marker is half a pixel off its middle.
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

    /// Width of the edge over which weights grow, px: where the blurred contrast is between 0.2 and 0.7 of all.
    const EDGE_PX: f64 = (0.8416 + 0.5244) * 0.86;

    /// Rings and integrals around them against the mean marker on pixels of an eighth, which they approximate.
    ///
    /// White noise: shares of half a ring, even over a width of variance σ², are taken for normal ones, so that Var(kept | noise)
    /// loses <P>² σ² for its mean, not <P²> σ². Where weights end, P = Φ(z / s) in noise s, and ∫ <P²> - <P>² = (t - s) / π^0.5 with
    /// t² = s² + σ²: at both ends together at most 2 σ² (t - s) / π^0.5 more than the white noise over the band. A ring's points
    /// lie off its middle by the mean of so many, which is less than if they lay at random: three such deviations to either side.
    ///
    /// Grain: of an edge of width w, a ring of width δ that is half in it is put a quarter of δ outwards, which makes the variance of radii
    /// larger by up to δ² / 4, and that within rings is left out, δ² / 12: of two radii twice that, by half the kernel's curvature
    /// 1 / (2 l²). What corners have in common with the marker is taken from the window's middle, off which markers are by 1 / 12 px² in
    /// either direction: half the kernel's Laplacian, largest at the outermost pixel. And it is spread evenly over rings that the window
    /// cuts, whose pixels lie by the corners: at most all that these have is missing.
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
            let most = (curved + off) * around + offset * mean.common + mean.cut;
            let grains = found.grain - mean.grain;
            let text =
                alloc::format!("{radius_px} px, band {band}: {grains:e} of {:e}, {most:e}", mean.grain);
            assert!(abs(grains) < most, "grain {text}");
        }
    }

    /// The mean marker against every pixel and every pair of pixels, where in a pixel its centre may lie: these variances, of squares of
    /// what differs from place to place, are larger.
    ///
    /// By Poisson's summation a sum over the grid's pixels differs from place to place by the Fourier transform of its terms
    /// at the wave vectors 2π n. Of x P on an edge of radius r and width w that is at most 2π r² cos ψ J1(q r) B(q) with J1² <= 2 / (π q r)
    /// and B <= 2 / q, q = 2π |n|, of which grain of variance 1 shows the square; and of x² P, π r³ w in the mean,
    /// 2π r³ cos² ψ J0(q r) B(q). Sums over all n of |n|^-3 are 9.034, of cos² ψ half of that, of cos⁴ ψ less.
    #[test]
    fn what_differs_from_place_to_place_adds_little_to_the_mean_marker() {
        const ALIASES: f64 = 9.034 / (8.0 * PI * PI * PI);
        for (radius_px, band, white_levels2, grain_levels2) in CASES {
            let noise = noise_of(white_levels2, grain_levels2);
            let mean = mean_marker(radius_px, band, &noise);
            let [white, grain] = reference(radius_px, band, &noise);
            let slopes = 32.0 / (PI * radius_px * EDGE_PX * EDGE_PX) * 0.5 * ALIASES;
            let most_white = slopes * mean.tilted[0];
            let around = 32.0 * PI * radius_px.powi(3) / (mean.weight * mean.weight) * 0.5 * ALIASES;
            let most_grain = around * grain_levels2 / (band * band) + slopes * mean.tilted[1];
            let more = [white - mean.white, grain - mean.grain];
            let text = alloc::format!("{radius_px} px, band {band}: {more:?} {most_white} {most_grain}");
            assert!((-1e-4 * white..most_white + 1e-4 * white).contains(&more[0]), "white {text}");
            assert!((0.0..most_grain).contains(&more[1]), "grain {text}");
        }
    }

    /// Against differences of the same profile in slightly more noise: what a fainter marker of this shape has, over its band.
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

    /// Against sums over a normal distribution, and differences between them and others.
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
            let differs =
                |found: f64, at: fn(&Kept) -> f64| abs(found - 0.5 * (at(&more) - at(&less)) / step);
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
}
