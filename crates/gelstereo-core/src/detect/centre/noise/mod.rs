//! Image noise, measured on the gel between the markers.

mod differences;

use crate::detect::centre::covered::GLARE_LEVEL;
use crate::detect::centre::region::Region;
use crate::detect::mask::bit_rows::BitRow;
use crate::detect::mask::components::Components;
use crate::detect::workload::Workload;
use crate::image::GrayView;
use crate::math::{DVec2, abs, exp, median, sqrt};
use alloc::vec::Vec;
use core::f64::consts::PI;
use core::ops::{Range, RangeInclusive};
use differences::{Differences, HALF_LAG_PX, MIN_DIFFERENCES, SLOPE_DIFFERENCES, each_piece};

/// Variance of rounding to whole grey levels: no image has less noise.
const ROUNDING_LEVELS2: f64 = 1.0 / 12.0;
/// Distance of the gel used from a marker's pixels, beyond any blurred edge.
pub(in crate::detect) const CLEARANCE_PX: usize = 4;
/// Least distance if markers are close: at 3 px from the outline and a blur of 0.8 px, 0.01 % of a
/// marker's contrast is left.
const MIN_CLEARANCE_PX: usize = 3;
/// Pixel pairs between the markers that give the noise to 5 %, twice as well as needed, and pairs that
/// also give faint grain. With fewer than the first, all gel of the image is used.
const ENOUGH_PAIRS: u64 = 1000;
const PLENTY_PAIRS: u64 = 16_000;
/// Prior of the grain size (grain of about a pixel, blurred by about a pixel), and the spread of its
/// logarithm.
const USUAL_SIZE_PX: f64 = 1.3;
const SPREAD_OF_SIZES: f64 = 0.4;
/// Limit on the logarithm of the size over the usual one: 0.4 to 4.3 px. Coarser grain is light, finer
/// grain is white.
const LARGEST_LOG_SIZE: f64 = 1.2;
/// Largest ratio between the grain at a gel level and the measured one.
const MAX_SHARE: f64 = 16.0;
/// Rows in which even faint grain is detected.
pub(in crate::detect) const ENOUGH_ROWS: usize = 240;
/// Outlier limit for pieces that are not gel, in median absolute deviations from the median.
const MAX_OFF: f64 = 7.0;

/// White noise and correlated grain: variances in squared grey levels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Variance of the noise that is independent between pixels.
    pub white_levels2: f64,
    /// Variance of the grain where the gel has the level `gel_level`. Grain belongs to the surface: in
    /// twice the light it has twice the contrast.
    pub grain_levels2: f64,
    /// The grain's correlation at distance d is exp(-d² / (4 l²)) with this l.
    pub grain_size_px: f64,
    /// Gel level to which the variances apply, grey levels; 0 if unknown.
    pub gel_level: f64,
}

impl Default for Noise {
    fn default() -> Self {
        Self { white_levels2: 1.0, grain_levels2: 0.0, grain_size_px: USUAL_SIZE_PX, gel_level: 0.0 }
    }
}

impl Noise {
    /// Power spectral density at a squared angular frequency (rad/px)².
    #[must_use]
    pub fn spectrum(&self, k2: f64) -> f64 {
        let l2 = self.grain_size_px * self.grain_size_px;
        self.white_levels2 + self.grain_levels2 * 4.0 * PI * l2 * exp(-k2 * l2)
    }

    /// Variance of one pixel.
    #[must_use]
    pub fn variance_levels2(&self) -> f64 {
        self.white_levels2 + self.grain_levels2
    }

    /// Ratio of the grain variance at another gel level to `grain_levels2`.
    pub(in crate::detect) fn grain_share(&self, gel_level: f64) -> f64 {
        let share = if self.gel_level > 0.0 { gel_level / self.gel_level } else { 1.0 };
        (share * share).clamp(1.0 / MAX_SHARE, MAX_SHARE)
    }

    /// The same noise at another gel level.
    pub(super) fn at(&self, gel_level: f64) -> Self {
        let grain_levels2 = self.grain_levels2 * self.grain_share(gel_level);
        Self { grain_levels2, gel_level, ..*self }
    }

    /// Most likely noise.
    ///
    /// With x = exp(-1 / (4 l²)), half the variances of the differences of pixels 1, 2 and 4 px apart (a
    /// variogram without its drift) are w + g (1 - x), w + g (1 - x^4), w + g (1 - x^16). Faint grain hardly
    /// determines its size l, which has a prior around the usual one. Grain is shrunk by G / (1 + G) for a
    /// gain G in the sum of squares, so that chance fits count little (James and Stein 1961).
    fn from_variogram(variogram: &Variogram) -> Self {
        let Variogram { one, more: [two, four], sigma } = *variogram;
        let cost = |grain: f64, at: &[f64; 2]| {
            let (e, f) = ((two - grain * at[0]) / sigma, (four - grain * at[1]) / sigma);
            e * e + f * f
        };
        let fitted = |log_size: f64| {
            let x = correlation(USUAL_SIZE_PX * exp(log_size));
            let (x2, prior) = (x * x, log_size / SPREAD_OF_SIZES);
            let x4 = x2 * x2;
            let at = [x - x4, x - x4 * x4 * x4 * x4];
            let grain = ((at[0] * two + at[1] * four) / (at[0] * at[0] + at[1] * at[1])).max(0.0);
            (cost(grain, &at) + prior * prior, grain)
        };
        let (mut best, mut centre, mut reach) = ((f64::INFINITY, 0.0), 0.0, LARGEST_LOG_SIZE);
        for _ in 0..3 {
            let middle: f64 = centre;
            for k in -8..=8 {
                let log_size =
                    (middle + f64::from(k) * reach / 8.0).clamp(-LARGEST_LOG_SIZE, LARGEST_LOG_SIZE);
                let found = fitted(log_size);
                if found.0 < best.0 {
                    (best, centre) = (found, log_size);
                }
            }
            reach /= 8.0;
        }
        let gain = (cost(0.0, &[0.0; 2]) - best.0).max(0.0);
        let (grain_levels2, grain_size_px) = (best.1 * gain / (1.0 + gain), USUAL_SIZE_PX * exp(centre));
        let white_levels2 = (one - grain_levels2 * (1.0 - correlation(grain_size_px))).max(ROUNDING_LEVELS2);
        Self { white_levels2, grain_levels2, grain_size_px, gel_level: 0.0 }
    }
}

/// Correlation of the grain between neighbouring pixels.
fn correlation(size_px: f64) -> f64 {
    exp(-0.25 / (size_px * size_px))
}

/// Half the variance of the differences between neighbours, its excess 2 and 4 px apart, and the standard
/// deviation of either excess.
#[derive(Clone, Copy, Debug)]
struct Variogram {
    one: f64,
    more: [f64; 2],
    sigma: f64,
}

/// Where an image shows markers; the rest is gel.
#[derive(Clone, Copy, Debug)]
pub(in crate::detect) enum MarkerPixels<'a> {
    /// Bytes of the whole image: 255 at markers, otherwise 0.
    Mask(&'a [u8]),
    /// Components of the image reduced by `scale`.
    Components { components: &'a Components, scale: usize },
}

impl MarkerPixels<'_> {
    /// Sets the pixels of a row whose column belongs to a marker in any of these rows.
    fn cover(&self, rows: RangeInclusive<usize>, width: usize, near: &mut BitRow) {
        match *self {
            // A marker is at least two rows high.
            Self::Mask(mask) => rows.step_by(2).for_each(|row| near.set_where(&mask[row * width..])),
            Self::Components { components, scale } => components.cover(rows, scale, near),
        }
    }
}

/// Which rows of an image are used, and how near to the markers.
#[derive(Clone, Copy, Debug)]
pub(in crate::detect) struct NoiseRows {
    /// Number of rows, or a few more.
    pub rows: usize,
    /// Least distance from the pixels of markers.
    pub clearance_px: usize,
}

/// Every so many rows, and the least distance from markers.
#[derive(Clone, Copy)]
struct Rows {
    every: usize,
    clearance_px: usize,
}

/// Measures [`Noise`], with its scratch.
#[derive(Clone, Debug, Default)]
pub(in crate::detect) struct NoiseMeter {
    /// Set where a row's pixel is near a marker.
    near: BitRow,
    pieces: Vec<Piece>,
    scratch: Vec<f64>,
    /// Rows read of the last image, and rows whose markers were left out for each of them.
    rows: usize,
    beside: usize,
}

/// Variogram of one piece of gel.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// Half the variance of differences at the first lag, and its excess at the others.
    entries: [f32; 3],
    pairs: u32,
}

impl Piece {
    fn of(differences: &Differences) -> Self {
        let [one, two, four] = differences.squared().map(|sum| sum / (2 * differences.count) as f64);
        Self {
            entries: [one, two - one, four - one].map(|entry| entry as f32),
            pairs: differences.count as u32,
        }
    }
}

/// Sums over all rows used.
#[derive(Clone, Copy, Debug, Default)]
struct Total {
    pairs: u64,
    /// Sum of the levels of each pair's first pixel.
    levels: u64,
}

impl NoiseMeter {
    /// Measures on some rows of `image`, off its markers, which are at `centres_px`. Takes means over pieces,
    /// without outliers by scratches or edges. `None` if there is no such gel.
    ///
    /// What surrounds the lattice (tray, mount, walls, light that falls off) is not gel. It is used only
    /// if too little gel is clear among the markers.
    pub fn run(
        &mut self,
        image: GrayView<'_>,
        markers: MarkerPixels<'_>,
        centres_px: &[DVec2],
        rows: NoiseRows,
    ) -> Option<Noise> {
        let NoiseRows { rows, clearance_px } = rows;
        (self.rows, self.beside) = (0, 0);
        let every = (image.height() / rows).max(1);
        self.pieces.clear();
        // More rows among the markers are used only if these have too few pairs.
        let rows_px = (image.height() / every + 1) * (image.width() / SLOPE_DIFFERENCES + 1);
        self.pieces.reserve(rows_px.max(every * PLENTY_PAIRS as usize / MIN_DIFFERENCES));
        self.scratch.clear();
        self.scratch.reserve(self.pieces.capacity().max(centres_px.len()));
        let glares = image.reaches(GLARE_LEVEL);
        let cover = |rows: RangeInclusive<usize>, near: &mut BitRow| {
            markers.cover(rows.clone(), image.width(), near);
            // A light's reflection is not gel and hides markers, which the mask then lacks.
            if glares {
                rows.step_by(2).for_each(|row| near.set_bright(image.row(row), GLARE_LEVEL));
            }
        };
        if let Some(region) = Region::around(centres_px, &mut self.scratch) {
            let min_px = clearance_px.min(MIN_CLEARANCE_PX);
            let columns = |y| region.columns(y, image.width());
            let some = self.take_rows(image, columns, Rows { every, clearance_px }, &cover);
            if some.pairs >= PLENTY_PAIRS {
                return self.noise(&some);
            }
            // Among close markers few rows are clear: use all, and closer to the markers if that is still
            // too few.
            let expected = every as u64 * some.pairs;
            for (clearance_px, is_worth_it, enough) in
                [(clearance_px, expected >= PLENTY_PAIRS, PLENTY_PAIRS), (min_px, true, ENOUGH_PAIRS)]
            {
                if is_worth_it {
                    let all = self.take_rows(image, columns, Rows { every: 1, clearance_px }, &cover);
                    if all.pairs >= enough {
                        return self.noise(&all);
                    }
                }
            }
        }
        let all = self.take_rows(image, |_| 0..image.width(), Rows { every, clearance_px }, &cover);
        self.noise(&all)
    }

    /// Adds the rows read of the last image.
    pub fn add_workload(&self, workload: &mut Workload) {
        workload.noise_rows += self.rows;
        workload.rows_beside_noise += self.beside;
    }

    /// Collects the pieces in these columns of rows.
    fn take_rows(
        &mut self,
        image: GrayView<'_>,
        columns: impl Fn(usize) -> Range<usize>,
        Rows { every, clearance_px }: Rows,
        cover: &impl Fn(RangeInclusive<usize>, &mut BitRow),
    ) -> Total {
        let (width, height) = (image.width(), image.height());
        let mut total = Total::default();
        self.pieces.clear();
        for y in (clearance_px..height.saturating_sub(clearance_px)).step_by(every) {
            let counted = columns(y);
            if counted.is_empty() {
                continue;
            }
            self.rows += 1;
            self.beside += 2 * clearance_px + 1;
            self.near.start(width);
            cover(y - clearance_px..=y + clearance_px, &mut self.near);
            // Most gaps between markers are too short for a piece; this closes them.
            self.near.widen(clearance_px + HALF_LAG_PX);
            self.near.set(0..counted.start);
            self.near.set(counted.end..width);
            let Self { near, pieces, .. } = self;
            each_piece(image.row(y), near, clearance_px, |piece| {
                total.pairs += piece.count as u64;
                total.levels += piece.levels;
                pieces.push(Piece::of(piece));
            });
        }
        total
    }

    /// Noise from the collected pieces.
    fn noise(&mut self, total: &Total) -> Option<Noise> {
        let (one, more) = (self.mean(0)?, [self.mean(1)?, self.mean(2)?]);
        let pairs = total.pairs as f64;
        // In white noise, as the difference of two covariances of this many pairs.
        let sigma = (one + more[1].max(0.0)).max(ROUNDING_LEVELS2) * sqrt(2.0 / pairs);
        let noise = Noise::from_variogram(&Variogram { one, more, sigma });
        Some(Noise { gel_level: total.levels as f64 / pairs, ..noise })
    }

    /// Mean of an entry over the pieces without outliers, weighted by pairs. A median would be too small,
    /// since variances are skewed.
    fn mean(&mut self, entry: usize) -> Option<f64> {
        let Self { pieces, scratch, .. } = self;
        let mut middle = |value: &dyn Fn(&Piece) -> f64| {
            scratch.clear();
            scratch.extend(pieces.iter().map(value));
            median(scratch)
        };
        let usual = middle(&|piece| f64::from(piece.entries[entry]))?;
        let off = |piece: &Piece| abs(f64::from(piece.entries[entry]) - usual);
        let max = MAX_OFF * middle(&off)?;
        let (mut sum, mut pairs) = (0.0, 0.0);
        for piece in pieces.iter().filter(|piece| off(piece) <= max) {
            sum += f64::from(piece.pairs) * f64::from(piece.entries[entry]);
            pairs += f64::from(piece.pairs);
        }
        Some(sum / pairs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Grain has the contrast of its light, so its variance grows by the square; white noise stays.
        #[test]
        fn grain_grows_with_the_square_of_the_light(
            grain_levels2 in 0.1..9.0_f64, gel_level in 20.0..200.0_f64, times in 0.3..3.0_f64,
        ) {
            let noise = Noise { grain_levels2, gel_level, ..Noise::default() };
            let there = noise.at(times * gel_level);
            prop_assert!((there.grain_levels2 / (grain_levels2 * times * times) - 1.0).abs() < 1e-14);
            prop_assert_eq!(there.white_levels2, noise.white_levels2);
            // And back again.
            prop_assert!((there.at(gel_level).grain_levels2 / grain_levels2 - 1.0).abs() < 1e-14);
        }
    }
}
