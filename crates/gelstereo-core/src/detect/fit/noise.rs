//! Noise of the image, measured on the gel between the markers.

use crate::detect::row_bits::RowBits;
use crate::image::GrayView;
use crate::math::{abs, exp, median, sqrt};
use alloc::vec::Vec;
use core::f64::consts::PI;
use core::ops::Range;

/// Variance of rounding to whole grey levels: no image has less noise.
const ROUNDING_LEVELS2: f64 = 1.0 / 12.0;
/// Pixels between the gel that counts and a marker's pixels: out of any blurred edge.
pub(in crate::detect) const CLEARANCE_PX: usize = 4;
/// Differences from which the slope of the light is taken: few enough that it is the same for all of them, and enough that
/// the noise of their mean, of which a share of 4 stretches / differences² is lost with it, is below a percent.
const SLOPE_DIFFERENCES: usize = 64;
/// Fewer say nothing.
const LEAST_DIFFERENCES: usize = 16;
/// Size of grain of about a pixel behind a lens that blurs by about a pixel, and the spread of its logarithm.
const USUAL_SIZE_PX: f64 = 1.3;
const SPREAD_OF_SIZES: f64 = 0.4;
/// Logarithm of the largest size over the usual one: 4.3 px and 0.4 px. Coarser grain is light, finer grain is white.
const LARGEST_LOG_SIZE: f64 = 1.2;
/// Grain is believed to differ by at most this factor from that of the gel on which it was measured.
const MOST_SHARE: f64 = 16.0;
/// Rows in which even faint grain shows.
pub(in crate::detect) const ENOUGH_ROWS: usize = 240;
/// Grain must explain this much more of the sum of squares than none at all (Akaike's criterion, one parameter) where fewer
/// rows are looked at: chance is then larger than grain that matters, and its share above 0 would count.
const LEAST_GAIN: f64 = 2.0;
/// Rows that are farther from the median than this many times the median distance from it show something else than gel.
const MOST_OFF: f64 = 7.0;
/// Distances at which pixels are compared.
const LAGS: [usize; 3] = [1, 2, 4];
/// Half of the farthest.
const HALF_LAG_PX: usize = LAGS[2] / 2;

/// White noise, and grain whose neighbouring pixels are alike: variances in squared grey levels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Variance of the noise that differs from pixel to pixel.
    pub white_levels2: f64,
    /// Variance of the grain where the gel has the level `gel_level`. It is of the surface: in twice the light it has
    /// twice the contrast.
    pub grain_levels2: f64,
    /// The grain's correlation at distance d is exp(-d² / (4 l²)) with this l.
    pub grain_size_px: f64,
    /// Level of the gel that the variances are for, grey levels; 0 when unknown.
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

    /// Variance of the grain over `grain_levels2`, where the gel has another level.
    pub(in crate::detect) fn grain_share(&self, gel_level: f64) -> f64 {
        let share = if self.gel_level > 0.0 { gel_level / self.gel_level } else { 1.0 };
        (share * share).clamp(1.0 / MOST_SHARE, MOST_SHARE)
    }

    /// The same noise where the gel has another level.
    pub(super) fn at(&self, gel_level: f64) -> Self {
        let grain_levels2 = self.grain_levels2 * self.grain_share(gel_level);
        Self { grain_levels2, gel_level, ..*self }
    }

    /// The likeliest noise.
    ///
    /// With x = exp(-1 / (4 l²)), half the variances of the differences of pixels 1, 2 and 4 px apart (a variogram
    /// without its drift) are w + g (1 - x), w + g (1 - x^4), w + g (1 - x^16). Faint grain says too little about its
    /// size l: that has the usual one as its prior. Without a least gain, grain too faint to be told from chance counts all the
    /// same: else the noise would be too small in the mean.
    fn from_variogram(variogram: &Variogram, least_gain: f64) -> Self {
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
        if cost(0.0, &[0.0; 2]) - best.0 < least_gain {
            return Self { white_levels2: one.max(ROUNDING_LEVELS2), ..Self::default() };
        }
        let (grain_levels2, grain_size_px) = (best.1, USUAL_SIZE_PX * exp(centre));
        let white_levels2 = (one - grain_levels2 * (1.0 - correlation(grain_size_px))).max(ROUNDING_LEVELS2);
        Self { white_levels2, grain_levels2, grain_size_px, gel_level: 0.0 }
    }
}

/// Correlation of the grain of neighbouring pixels.
fn correlation(size_px: f64) -> f64 {
    exp(-0.25 / (size_px * size_px))
}

/// Half the variance of the differences between neighbours, how much more it is 2 and 4 px apart, and the standard
/// deviation of either of the latter.
#[derive(Clone, Copy, Debug)]
struct Variogram {
    one: f64,
    more: [f64; 2],
    sigma: f64,
}

/// Measures [`Noise`], with its scratch.
#[derive(Clone, Debug, Default)]
pub(in crate::detect) struct NoiseMeter {
    /// Set where a row's pixel is near a marker.
    near: RowBits,
    rows: Vec<Row>,
    scratch: Vec<f64>,
}

/// What one row of the image says.
#[derive(Clone, Copy, Debug)]
struct Row {
    /// Half the variance of differences at the first lag, and how much more it is at the others.
    entries: [f32; 3],
    pairs: u32,
}

impl NoiseMeter {
    /// From the pixels of every so many rows of `image` (faint grain shows in no fewer than [`ENOUGH_ROWS`]) that lie so many pixels off
    /// the set pixels of `mask`: means over the rows, without those that a scratch or a smear reaches. `None` when there is no
    /// such gel.
    pub fn run(
        &mut self,
        image: GrayView<'_>,
        mask: &[u8],
        every: usize,
        clearance_px: usize,
    ) -> Option<Noise> {
        let width = image.width();
        self.run_rows(image, every, clearance_px, |rows, near| {
            // A marker is at least two rows high.
            for row in rows.step_by(2) {
                near.set_where(&mask[row * width..]);
            }
        })
    }

    /// As [`Self::run`]; `cover` sets the pixels of one row that have some of the mask in the same column of these rows.
    pub fn run_rows(
        &mut self,
        image: GrayView<'_>,
        every: usize,
        clearance_px: usize,
        mut cover: impl FnMut(core::ops::RangeInclusive<usize>, &mut RowBits),
    ) -> Option<Noise> {
        let (width, height) = (image.width(), image.height());
        self.rows.clear();
        self.rows.reserve(height);
        self.scratch.clear();
        self.scratch.reserve(height);
        let (mut pairs, mut levels) = (0, 0);
        for y in (clearance_px..height.saturating_sub(clearance_px)).step_by(every) {
            self.near.start(width);
            cover(y - clearance_px..=y + clearance_px, &mut self.near);
            // Most gaps between markers are too short to say anything: they close.
            self.near.widen(clearance_px + HALF_LAG_PX);
            let row = spread_of(image.row(y), &self.near, clearance_px);
            if row.count >= LEAST_DIFFERENCES {
                let [one, two, four] = row.sums.map(|sum| sum / (2 * row.count) as f64);
                let entries = [one, two - one, four - one].map(|entry| entry as f32);
                self.rows.push(Row { entries, pairs: row.count as u32 });
                pairs += row.count as u64;
                levels += row.levels;
            }
        }
        let (one, more) = (self.mean(0)?, [self.mean(1)?, self.mean(2)?]);
        // In white noise, as the difference of two covariances of so many pairs.
        let sigma = (one + more[1].max(0.0)).max(ROUNDING_LEVELS2) * sqrt(2.0 / pairs as f64);

        let enough = every == 1 || height / every >= ENOUGH_ROWS;
        let least_gain = if enough { 0.0 } else { LEAST_GAIN };
        let noise = Noise::from_variogram(&Variogram { one, more, sigma }, least_gain);
        Some(Noise { gel_level: levels as f64 / pairs as f64, ..noise })
    }

    /// Mean of an entry over the rows, each as often as it has pairs; a median would be too small, for variances are skewed.
    fn mean(&mut self, entry: usize) -> Option<f64> {
        let Self { rows, scratch, .. } = self;
        let mut middle = |value: &dyn Fn(&Row) -> f64| {
            scratch.clear();
            scratch.extend(rows.iter().map(value));
            median(scratch)
        };
        let usual = middle(&|row| f64::from(row.entries[entry]))?;
        let off = |row: &Row| abs(f64::from(row.entries[entry]) - usual);
        let most = MOST_OFF * middle(&off)?;
        let (mut sum, mut pairs) = (0.0, 0.0);
        for row in rows.iter().filter(|row| off(row) <= most) {
            sum += f64::from(row.pairs) * f64::from(row.entries[entry]);
            pairs += f64::from(row.pairs);
        }
        Some(sum / pairs)
    }
}

/// Differences of the gel of one row, of which all that is `clearance_px` and [`HALF_LAG_PX`] near to a marker is set.
fn spread_of(levels: &[u8], near: &RowBits, clearance_px: usize) -> Spread {
    let (mut row, mut group) = (Spread::default(), Differences::default());
    for clear in near.clear_stretches() {
        // What is left has its farthest partner clear of the next marker. The row ends as a marker begins.
        let start = if clear.start == 0 { clearance_px } else { clear.start - HALF_LAG_PX };
        let end = if clear.end == levels.len() {
            clear.end.saturating_sub(clearance_px)
        } else {
            clear.end + HALF_LAG_PX
        };
        if end > start + LAGS[2] {
            group.add(levels, start..end);
        }
        if group.count >= SLOPE_DIFFERENCES {
            row.add(&core::mem::take(&mut group));
        }
    }
    row.add(&group);
    row
}

/// Differences at every lag between pixels of one region of a row.
#[derive(Clone, Copy, Debug, Default)]
struct Differences {
    count: usize,
    /// Sum of the levels of each pair's first pixel.
    levels: u64,
    sums: [i64; 3],
    squares: [u64; 3],
    /// Pixels that are in a sum of differences once: all others cancel. Half of them.
    ends: [usize; 3],
}

impl Differences {
    /// Adds a stretch of gel, longer than the farthest lag, of a row.
    fn add(&mut self, row: &[u8], gel: Range<usize>) {
        let stretch = &row[gel.clone()];
        let count = stretch.len() - LAGS[2];
        self.count += count;
        for ((sum, ends), lag) in self.sums.iter_mut().zip(&mut self.ends).zip(LAGS) {
            // All pixels but the first ones less all but the last ones: what both have is left out.
            let both = lag.min(count);
            let last = stretch[count.max(lag)..][..both].iter();
            *sum += last.zip(stretch).map(|(&end, &start)| i64::from(end) - i64::from(start)).sum::<i64>();
            *ends += both;
        }
        for at in (0..count).step_by(LANES) {
            let masked = &MASK[LANES - LANES.min(count - at)..];
            let (Some(mask), rest) = (masked.first_chunk(), &row[gel.start + at..]) else { return };
            let mut end = [0; SPAN];
            let pixels = rest.first_chunk().unwrap_or_else(|| {
                end[..rest.len()].copy_from_slice(rest);
                &end
            });
            self.levels += u64::from(sum_of_levels(pixels, mask));
            let squares = [squares::<{ LAGS[0] }>, squares::<{ LAGS[1] }>, squares::<{ LAGS[2] }>];
            for (sum, squares) in self.squares.iter_mut().zip(squares) {
                *sum += u64::from(squares(pixels, mask));
            }
        }
    }
}

/// Σ (difference - mean difference)² at every lag.
#[derive(Clone, Copy, Debug, Default)]
struct Spread {
    count: usize,
    levels: u64,
    sums: [f64; 3],
}

impl Spread {
    /// Adds differences in which the light's slope is one; too few are left out.
    fn add(&mut self, group: &Differences) {
        if group.count < LEAST_DIFFERENCES {
            return;
        }
        self.count += group.count;
        self.levels += group.levels;
        let count = group.count as f64;
        for (lag, total) in self.sums.iter_mut().enumerate() {
            let (sum, square) = (group.sums[lag] as f64, group.squares[lag] as f64);
            // White noise of variance s² leaves 2 s² in each square, and 2 s² for each pair of ends in the square of the sum. The
            // part that is lost with the mean is larger for far pixels: it would be missed as grain.
            *total += (square - sum * sum / count) / (1.0 - group.ends[lag] as f64 / (count * count));
        }
    }
}

/// Pixels whose squares are added at once, and those that they are compared with too.
const LANES: usize = 32;
const SPAN: usize = LANES + LAGS[2];
/// From place [`LANES`] - n on it lets n pixels through.
const MASK: [u8; 2 * LANES] = {
    let (mut mask, mut x) = ([0; 2 * LANES], 0);
    while x < LANES {
        (mask[x], x) = (u8::MAX, x + 1);
    }
    mask
};

/// Squared differences of the pixels that a mask lets through from those at a lag. Differences as bytes, and products of 16
/// bits: there are instructions for both, which are found in a function of its own.
#[inline(never)]
fn squares<const LAG: usize>(pixels: &[u8; SPAN], mask: &[u8; LANES]) -> u32 {
    let mut apart = [0; LANES];
    for x in 0..LANES {
        let (a, b) = (pixels[x], pixels[x + LAG]);
        apart[x] = (a.saturating_sub(b) | b.saturating_sub(a)) & mask[x];
    }
    apart.iter().map(|&d| u32::from(d) * u32::from(d)).sum()
}

#[inline(never)]
fn sum_of_levels(pixels: &[u8; SPAN], mask: &[u8; LANES]) -> u32 {
    pixels.iter().zip(mask).map(|(&level, &mask)| u32::from(level & mask)).sum()
}

#[cfg(test)]
mod tests {
    use super::{Differences, HALF_LAG_PX, LAGS, LANES, spread_of};
    use crate::detect::row_bits::RowBits;
    use crate::math::abs;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    /// A row of gel in stretches of these lengths, with a marker of this width after each: how long it is, and what is near
    /// to markers.
    fn masked(gel: &[usize], marker: usize, clearance: usize) -> (usize, RowBits) {
        let mut near = RowBits::default();
        let length = gel.iter().sum::<usize>() + gel.len() * marker;
        near.start(length);
        let mut end = 0;
        for stretch in gel {
            near.set(end + stretch..end + stretch + marker);
            end += stretch + marker;
        }
        near.widen(clearance + HALF_LAG_PX);
        (length, near)
    }

    proptest! {
        /// White noise has the same variance at all distances, whatever its mean difference took. Of independent pixels
        /// of variance 1 the mean of a sum of squares is the sum of what it is of each pixel alone: no chance is left.
        #[test]
        fn a_slope_takes_no_more_noise_from_far_pixels_than_from_near_ones(
            gel in prop::collection::vec(14..90_usize, 1..12), marker in 1..12_usize, clearance in 1..5_usize,
        ) {
            let (length, near) = masked(&gel, marker, clearance);
            let (mut sums, mut levels) = ([0.0; 3], alloc::vec![0; length]);
            for x in 0..length {
                levels[x] = 1;
                let alone = spread_of(&levels, &near, clearance).sums;
                sums.iter_mut().zip(alone).for_each(|(sum, alone)| *sum += alone);
                levels[x] = 0;
            }
            let count = spread_of(&levels, &near, clearance).count as f64;
            for (sum, lag) in sums.iter().zip(LAGS) {
                prop_assert!(abs(sum - 2.0 * count) <= 1e-11 * count, "lag {}: {} of {}", lag, sum, 2.0 * count);
            }
        }

        /// Light that rises evenly along the row leaves what differences leave without it.
        #[test]
        fn a_slope_of_light_is_no_noise(
            gel in prop::collection::vec(14..40_usize, 1..5), marker in 1..12_usize, level in 0..20_u8,
            noise in prop::collection::vec(0..20_u8, 208),
        ) {
            let (length, near) = masked(&gel, marker, 1);
            let dark = &noise[..length];
            let lit: Vec<u8> = (0_u8..).zip(dark).map(|(x, noise)| noise + level + x).collect();
            let (dark, lit) = (spread_of(dark, &near, 1).sums, spread_of(&lit, &near, 1).sums);
            for (a, b) in dark.iter().zip(lit) {
                // Round-off of squares below 2^17.
                prop_assert!(abs(a - b) < 1e-9, "{} {}", a, b);
            }
        }
    }

    proptest! {
        /// Against one pair after the other, for lengths about those that are added at once, at either end of a row too.
        #[test]
        fn differences_add_up(
            row in prop::collection::vec(any::<u8>(), 5..4 * LANES), before in 0..9_usize, after in 0..40_usize
        ) {
            let start = before.min(row.len() - 5);
            let gel = start..row.len().saturating_sub(after).max(start + 5);
            let mut found = Differences::default();
            found.add(&row, gel.clone());
            let stretch = &row[gel];
            let count = stretch.len() - LAGS[2];
            prop_assert_eq!(found.count, count);
            prop_assert_eq!(found.levels, stretch[..count].iter().map(|&x| u64::from(x)).sum::<u64>());
            for (k, lag) in LAGS.into_iter().enumerate() {
                let apart = (0..count).map(|x| i64::from(stretch[x + lag]) - i64::from(stretch[x]));
                prop_assert_eq!(found.sums[k], apart.clone().sum::<i64>());
                prop_assert_eq!(found.squares[k], apart.map(|d| (d * d) as u64).sum::<u64>());
            }
        }
    }
}
