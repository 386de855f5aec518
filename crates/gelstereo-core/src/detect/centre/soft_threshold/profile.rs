//! Radial profile of a marker's weights, and the effect of noise on the centroid with such weights.

use crate::detect::centre::noise::Noise;
use crate::detect::mask::blob_filter::AREA_SPREAD;
use crate::detect::window::classifier::Frame;
use crate::math::{DVec2, abs, erf, exp, floor, sqrt};
use core::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

/// Rings of equal area: a quarter of a pixel wide at the outline of a disc of any radius.
const RINGS: usize = 64;
const RING_PX: f64 = 0.25;
/// Variance of rounding weights to whole grey levels, as the image's levels are.
const ROUNDING_LEVELS2: f64 = 1.0 / 12.0;
/// Grain correlations below exp(-UNLIKE) are neglected.
const UNLIKE: f64 = 8.0;
/// Rings whose pixels have less sensitivity are neglected: a ten-thousandth of that at the edge.
const MIN_ANSWER: f64 = 1e-4;

/// Positions per axis in one quadrant of a pixel, which by symmetry represents the others.
const PLACES: usize = 3;
/// Largest variance of the radii that counts, px²: beyond it their errors are evenly spread.
const MAX_RADII_PX2: f64 = 0.04;
/// Least deviation of a share for which its mean is computed.
const MIN_DEVIATION: f64 = 1e-3;

#[derive(Clone, Copy, Debug, Default)]
struct Ring {
    pixels: f64,
    /// Sum of the pixels' shares of the band.
    shares: f64,
}

/// Mean shares of the band around the centres of some markers. Averaging over a ring of several markers
/// removes pixel noise, and averaging over sub-pixel positions removes the sampling of the few edge
/// pixels within the band.
#[derive(Clone, Debug)]
pub(super) struct Profile {
    rings: [Ring; RINGS],
    per_px2: f64,
    windows: f64,
    /// Sums over the windows.
    per_band2: f64,
    gel_levels: f64,
    frame: Option<Frame>,
    /// Sum of the weights of the window whose pixels are being added.
    weight: f64,
    /// Number of windows, sum and sum of squares of their weights, without those unlike the usual marker.
    weights: [f64; 3],
    usual_weight: f64,
}

/// Variances of a coordinate, px², from white noise and from grain, for a marker of the usual band.
#[derive(Clone, Copy, Debug)]
pub(super) struct Variances {
    pub white: f64,
    pub grain: f64,
    /// Mean of 1 / band².
    pub per_band2: f64,
    /// Exponent of 1 / band² for the growth of the white noise part: one if noise keeps pixels within the
    /// band, more if gel enters it. Limited to one from below; noise beyond the band would give less.
    pub power: f64,
    /// Standard deviation of a pixel over the band.
    pub noise_share: f64,
}

impl Profile {
    /// Creates an empty profile for discs of about this radius.
    pub fn new(radius_px: f64) -> Self {
        Self {
            rings: [Ring::default(); RINGS],
            per_px2: 1.0 / (2.0 * radius_px.max(1.0) * RING_PX),
            windows: 0.0,
            per_band2: 0.0,
            gel_levels: 0.0,
            frame: None,
            weight: 0.0,
            weights: [0.0; 3],
            usual_weight: PI * radius_px * radius_px,
        }
    }

    /// Adds a pixel: its squared distance from its marker's centre, and its contrast as a share of the band.
    #[inline]
    pub fn add(&mut self, distance_px2: f64, share: f64) {
        let ring = &mut self.rings[((distance_px2 * self.per_px2) as usize).min(RINGS - 1)];
        ring.pixels += 1.0;
        ring.shares += share;
        self.weight += share.clamp(0.0, 1.0);
    }

    /// Completes the window whose pixels were added.
    pub fn close(&mut self, frame: Frame) {
        self.windows += 1.0;
        self.per_band2 += 1.0 / (frame.band * frame.band);
        self.gel_levels += frame.gel_level;
        self.frame = Some(frame);
        let weight = core::mem::take(&mut self.weight);
        if abs(weight / self.usual_weight - 1.0) <= AREA_SPREAD {
            let terms = [1.0, weight, weight * weight];
            self.weights.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        }
    }

    /// Variance of the markers' radii, px²: a marker's weights sum to its area.
    fn radii_px2(&self) -> f64 {
        let [count, sum, squares] = self.weights;
        let mean = sum / count.max(1.0);
        let variance = (squares / count.max(1.0) - mean * mean).max(0.0);
        // A = π r², dA = 2 π r dr.
        if mean > 0.0 { variance / (4.0 * PI * mean) } else { 0.0 }
    }

    /// Mean share of a ring; that of the gel if it has no pixels.
    fn share(&self, ring: usize) -> f64 {
        let Ring { pixels, shares } = self.rings[ring];
        if pixels > 0.0 { shares / pixels } else { self.frame.map_or(0.0, |frame| frame.gel_share) }
    }

    /// Replaces the rings around the markers' edge by gel where few pixels say something else: those of a
    /// tray beside one marker.
    pub fn end_at_edge(&mut self) {
        let Some(gel_share) = self.frame.map(|frame| frame.gel_share) else { return };
        let is_gel = |ring: &Ring| ring.pixels > 0.0 && ring.shares < 0.5 * gel_share * ring.pixels;
        let Some(first) = self.rings.iter().position(is_gel) else { return };
        for ring in &mut self.rings[first..] {
            if !is_gel(ring) {
                ring.shares = gel_share * ring.pixels;
            }
        }
    }

    /// Variances in this noise; `None` if there is no marker.
    ///
    /// The centre is Σ w p / Σ w over pixels p with weights w, which are the shares clamped to 0..=1. To
    /// first order its sensitivity to the noise of a pixel is P p / Σ w, with P the probability that the
    /// pixel stays within the band. Its sensitivity to the gel's slope, the difference of the corners, is
    /// A = Σ P x² / Σ w. White noise gives Σ var(w) x² / (Σ w)² with the variance of the clamped weight,
    /// which is below P times the noise's. To this add A² times the variance of the slope, and subtract
    /// the covariance of both, since the corners are among the pixels. Grain gives the same with
    /// correlated neighbours; P suffices, since grain is small relative to the band.
    pub fn variances(&self, noise: &Noise) -> Option<Variances> {
        let frame = self.frame?;
        let per_band2 = self.per_band2 / self.windows;
        let grain_levels2 = noise.grain_levels2 * noise.grain_share(self.gel_levels / self.windows);
        let white = (noise.white_levels2 + ROUNDING_LEVELS2) * per_band2;
        let grain = grain_levels2 * per_band2;
        let noise_share = sqrt(white + grain);
        let (mut weight, mut slope, mut edge) = (0.0, 0.0, 0.0);
        // Their derivatives with respect to the logarithm of the total noise variance.
        let (mut weight_grows, mut slope_grows, mut edge_grows) = (0.0, 0.0, 0.0);
        // Sensitivity of each ring's pixels, and its radius.
        let mut answers = [(0.0, 0.0); RINGS];
        for (n, (ring, answer)) in self.rings.iter().zip(&mut answers).enumerate() {
            if !(ring.pixels > 0.0) {
                continue;
            }
            let distance_px2 = (n as f64 + 0.5) / self.per_px2;
            // Shares in a ring are taken as uniform between those of its neighbours: two halves, each
            // with the remaining variance.
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

impl Profile {
    /// Mean squared error of a coordinate without noise: weights that grow within a pixel depend on the
    /// pixel grid.
    ///
    /// It is the mean of (Σ w p / Σ w)² over sub-pixel positions of the centre, for weights that depend
    /// on the distance only, smoothed by noise of this deviation. The error repeats with the radius, by twice
    /// in a pixel. It is therefore the mean over the radii of the markers, too.
    pub fn grid_error_px2(&self, noise_share: f64) -> f64 {
        let deviation = noise_share.max(MIN_DEVIATION);
        let weights: [f64; RINGS] = core::array::from_fn(|ring| Kept::of(self.share(ring), deviation).mean);
        // Rings are of equal area; weights are linear between their middles.
        let weight_at = |distance_px2: f64| {
            let at = (distance_px2 * self.per_px2 - 0.5).max(0.0);
            let (ring, part) = (at as usize, at - floor(at));
            match (weights.get(ring), weights.get(ring + 1)) {
                (Some(here), Some(next)) => here + part * (next - here),
                _ => 0.0,
            }
        };
        let reach = sqrt(RINGS as f64 / self.per_px2) as i32 + 1;
        let error_px2 = |x: f64, y: f64, wider_px: f64| {
            let (mut sum, mut moment) = (0.0, DVec2::ZERO);
            for row in -reach..=reach {
                for column in -reach..=reach {
                    let at = DVec2::new(f64::from(column) - x, f64::from(row) - y);
                    let far_px = (at.length() - wider_px).max(0.0);
                    let weight = weight_at(far_px * far_px);
                    sum += weight;
                    moment += at * weight;
                }
            }
            0.5 * (moment / sum.max(f64::MIN_POSITIVE)).length_squared()
        };
        // Positions on either side of the quadrant's diagonal have the same error.
        let places = (0..PLACES).flat_map(|x| (0..=x).map(move |y| (x, y, if x == y { 1.0 } else { 2.0 })));
        let place = |n: usize| (n as f64 + 0.5) / (2 * PLACES) as f64;
        // Radii that differ: their mean by three nodes (Gauss and Hermite), exact to the fifth order.
        let radii_px2 = self.radii_px2().min(MAX_RADII_PX2);
        let apart_px = sqrt(3.0 * radii_px2);
        let mean_px2 = places
            .flat_map(|at| [(-apart_px, 1.0), (0.0, 4.0), (apart_px, 1.0)].map(|node| (at, node)))
            .map(|((x, y, twice), (wider_px, share))| {
                twice * share / 6.0 * error_px2(place(x), place(y), wider_px)
            })
            .sum::<f64>()
            / (PLACES * PLACES) as f64;
        // Means over rings of width w, and linear interpolation, smooth the weights by a variance of
        // w² / 12 + w² / 6. The amplitude of what repeats with the pixels falls by exp(-2 π² w² / 4).
        let outline = weights.iter().position(|&weight| weight < 0.5).unwrap_or(RINGS) as f64;
        let width_px2 = 0.25 / (outline.max(1.0) * self.per_px2);
        mean_px2 * exp(PI * PI * width_px2)
    }
}

/// Moments of a normal variable clamped to 0..=1.
struct Kept {
    mean: f64,
    variance: f64,
    /// Probability that it is not clamped.
    within: f64,
    growth: Growth,
}

/// Derivatives with respect to the variance of the unclamped variable.
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
        // The derivative of the mean of g is the mean of g'' / 2; clamping has steps of slope at both ends.
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

/// Covariance of a point at distance s with a ring of radius r in grain of variance 1. The correlation
/// exp(-d² / (4 l²)) is averaged over the ring with the cosine of the angle:
/// exp(-(r² + s²) / (4 l²)) I1(r s / (2 l²)). `None` if negligible.
fn alike(r: f64, s: f64, grain_size_px: f64) -> Option<f64> {
    let per_l2 = 0.25 / (grain_size_px * grain_size_px);
    let unlike = (r - s) * (r - s) * per_l2;
    (unlike < UNLIKE).then(|| exp(-unlike) * bessel_i1_scaled(2.0 * per_l2 * r * s))
}

/// Rings with a non-negligible sensitivity, with their radii.
fn felt(answers: &[(f64, f64)]) -> impl Iterator<Item = (usize, (f64, f64))> {
    answers.iter().copied().enumerate().filter(|(_, (answer, _))| *answer > MIN_ANSWER)
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

/// Covariance of the pixels of one corner with the rings, each times the cosine of its angle.
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

/// Sum of the correlations over all pairs of `pixels` adjacent pixels in a row, in grain of variance 1.
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
#[path = "profile_tests.rs"]
mod tests;
