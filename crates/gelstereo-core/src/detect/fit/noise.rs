//! Noise of the image, measured on the gel between the markers.

use crate::image::GrayView;
use crate::math::{abs, exp, median, sqrt};
use alloc::vec::Vec;
use core::f64::consts::PI;

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
    /// 255 where a row's pixel is near a marker, else 0.
    near: Vec<u8>,
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
                for (near, &set) in near.iter_mut().zip(&mask[row * width..]) {
                    *near |= set;
                }
            }
        })
    }

    /// As [`Self::run`]; `cover` sets the pixels of one row that have some of the mask in the same column of these rows.
    pub fn run_rows(
        &mut self,
        image: GrayView<'_>,
        every: usize,
        clearance_px: usize,
        mut cover: impl FnMut(core::ops::RangeInclusive<usize>, &mut [u8]),
    ) -> Option<Noise> {
        let (width, height) = (image.width(), image.height());
        self.rows.clear();
        self.rows.reserve(height);
        self.scratch.clear();
        self.scratch.reserve(height);
        let (mut pairs, mut levels) = (0, 0);
        for y in (clearance_px..height.saturating_sub(clearance_px)).step_by(every) {
            self.near.clear();
            self.near.resize(width, 0);
            cover(y - clearance_px..=y + clearance_px, &mut self.near);
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

/// Differences of the gel of one row.
fn spread_of(levels: &[u8], near: &[u8], clearance_px: usize) -> Spread {
    let (mut row, mut group) = (Spread::default(), Differences::default());
    for clear in stretches(near) {
        // What is left has its farthest partner clear of the next marker.
        if clear.len() > 2 * clearance_px + LAGS[2] {
            group.add(&levels[clear.start + clearance_px..clear.end - clearance_px]);
        }
        if group.count >= SLOPE_DIFFERENCES {
            row.add(&core::mem::take(&mut group));
        }
    }
    row.add(&group);
    row
}

/// Where a row of 0 and 255 is 0.
fn stretches(near: &[u8]) -> impl Iterator<Item = core::ops::Range<usize>> {
    let mut end = 0;
    core::iter::from_fn(move || {
        let start = end + alike(&near[end..], u8::MAX);
        end = start + alike(&near[start..], 0);
        (start < end).then_some(start..end)
    })
}

/// How many bytes are the same from the first on; eight at a time.
fn alike(bytes: &[u8], byte: u8) -> usize {
    let (words, rest) = bytes.as_chunks::<8>();
    let same = u64::from_le_bytes([byte; 8]);
    for (n, &word) in words.iter().enumerate() {
        let other = u64::from_le_bytes(word) ^ same;
        if other != 0 {
            return 8 * n + other.trailing_zeros() as usize / 8;
        }
    }
    bytes.len() - rest.len() + rest.iter().take_while(|&&other| other == byte).count()
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
    /// Adds a stretch of gel longer than the farthest lag.
    fn add(&mut self, stretch: &[u8]) {
        let count = stretch.len() - LAGS[2];
        let level = |levels: &[u8]| {
            let (whole, last) = levels.as_chunks::<LANES>();
            let sum = |levels: &[u8]| levels.iter().map(|&level| u32::from(level)).sum::<u32>();
            i64::from(whole.iter().map(|levels| sum(levels)).sum::<u32>() + sum(last))
        };
        self.count += count;
        self.levels += level(&stretch[..count]) as u64;
        self.ends.iter_mut().zip(LAGS).for_each(|(ends, lag)| *ends += lag.min(count));
        for ((sum, square), lag) in self.sums.iter_mut().zip(&mut self.squares).zip(LAGS) {
            // All pixels but the first ones less all but the last ones: what both have is left out.
            *sum += level(&stretch[count.max(lag)..][..lag.min(count)]) - level(&stretch[..lag.min(count)]);
            *square += u64::from(squared_difference(&stretch[..count], &stretch[lag..]));
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

/// Pixels whose squares are added at once.
const LANES: usize = 32;

/// Σ (a - b)² over the shorter of the two; exact below 66 000 pixels.
fn squared_difference(a: &[u8], b: &[u8]) -> u32 {
    let count = a.len().min(b.len());
    let ((a, last_a), (b, last_b)) = (a[..count].as_chunks::<LANES>(), b[..count].as_chunks::<LANES>());
    let square = |(&a, &b): (&u8, &u8)| u32::from(a.abs_diff(b)) * u32::from(a.abs_diff(b));
    let last = last_a.iter().zip(last_b).map(square).sum();
    a.iter().zip(b).map(|(a, b)| squares(a, b)).fold(last, u32::wrapping_add)
}

/// Differences as bytes, and products of 16 bits: there are instructions for both, which are found in a function of its own.
#[inline(never)]
fn squares(a: &[u8; LANES], b: &[u8; LANES]) -> u32 {
    let apart: [u8; LANES] = core::array::from_fn(|x| a[x].saturating_sub(b[x]) | b[x].saturating_sub(a[x]));
    apart.iter().map(|&d| u32::from(d) * u32::from(d)).sum()
}

#[cfg(test)]
mod tests {
    use super::{LAGS, LANES, spread_of, squared_difference, stretches};
    use crate::math::abs;
    use alloc::vec::Vec;
    use core::ops::Range;
    use proptest::prelude::*;

    /// Rows of gel in stretches of these lengths, with a marker of this width after each: 255 where the mask is set.
    fn masked(gel: &[usize], marker: usize) -> Vec<u8> {
        let row = |length: usize| (0..length + marker).map(move |x| if x < length { 0 } else { u8::MAX });
        gel.iter().flat_map(|&length| row(length)).collect()
    }

    proptest! {
        /// White noise has the same variance at all distances, whatever its mean difference took. Of independent pixels
        /// of variance 1 the mean of a sum of squares is the sum of what it is of each pixel alone: no chance is left.
        #[test]
        fn a_slope_takes_no_more_noise_from_far_pixels_than_from_near_ones(
            gel in prop::collection::vec(14..90_usize, 1..12), marker in 1..12_usize, clearance in 1..5_usize,
        ) {
            let mask = masked(&gel, marker);
            let (mut sums, mut levels) = ([0.0; 3], alloc::vec![0; mask.len()]);
            for x in 0..mask.len() {
                levels[x] = 1;
                let alone = spread_of(&levels, &mask, clearance).sums;
                sums.iter_mut().zip(alone).for_each(|(sum, alone)| *sum += alone);
                levels[x] = 0;
            }
            let count = spread_of(&levels, &mask, clearance).count as f64;
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
            let mask = masked(&gel, marker);
            let dark = &noise[..mask.len()];
            let lit: Vec<u8> = (0_u8..).zip(dark).map(|(x, noise)| noise + level + x).collect();
            let (dark, lit) = (spread_of(dark, &mask, 1).sums, spread_of(&lit, &mask, 1).sums);
            for (a, b) in dark.iter().zip(lit) {
                // Round-off of squares below 2^17.
                prop_assert!(abs(a - b) < 1e-9, "{} {}", a, b);
            }
        }
    }

    proptest! {
        /// Against a look at one pixel after the other.
        #[test]
        fn stretches_lie_between_set_pixels(runs in prop::collection::vec((any::<bool>(), 1..30_usize), 0..9)) {
            let level = |set: bool| if set { u8::MAX } else { 0 };
            let row: Vec<u8> = runs.iter().flat_map(|&(set, length)| (0..length).map(move |_| level(set))).collect();
            let mut expected: Vec<Range<usize>> = Vec::new();
            for x in (0..row.len()).filter(|&x| row[x] == 0) {
                match expected.last_mut() {
                    Some(stretch) if stretch.end == x => stretch.end = x + 1,
                    _ => expected.push(x..x + 1),
                }
            }
            prop_assert_eq!(stretches(&row).collect::<Vec<_>>(), expected);
        }

        /// Against one square after the other, for lengths about those that are added at once.
        #[test]
        fn squares_of_differences_add_up(pairs in prop::collection::vec(any::<(u8, u8)>(), 0..3 * LANES)) {
            let (a, b): (Vec<u8>, Vec<u8>) = pairs.iter().copied().unzip();
            let expected: i64 = pairs.iter().map(|&(a, b)| (i64::from(a) - i64::from(b)).pow(2)).sum();
            prop_assert_eq!(i64::from(squared_difference(&a, &b)), expected);
        }
    }
}
