//! Noise of the image, measured on the gel between the markers.

use crate::image::GrayView;
use crate::math::{cbrt, exp, ln, median};
use alloc::vec::Vec;
use core::f64::consts::PI;

/// Variance of rounding to whole grey levels: no image has less noise.
const ROUNDING_LEVELS2: f64 = 1.0 / 12.0;
/// Pixels between the gel that counts and a marker's pixels: out of its blurred edge.
const CLEARANCE_PX: usize = 4;
/// Differences from which the slope of the light is taken: few enough that it is the same for all of them, and enough that
/// the noise of their mean, of which a share of 4 stretches / differences² is lost with it, is below a percent.
const SLOPE_DIFFERENCES: usize = 64;
/// Fewer say nothing.
const LEAST_DIFFERENCES: usize = 16;
/// Distances at which pixels are compared.
const LAGS: [usize; 3] = [1, 2, 4];

/// White noise, and grain whose neighbouring pixels are alike: variances in squared grey levels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Variance of the noise that differs from pixel to pixel.
    pub white_levels2: f64,
    /// Variance of the grain.
    pub grain_levels2: f64,
    /// The grain's correlation at distance d is exp(-d² / (4 l²)) with this l.
    pub grain_size_px: f64,
}

impl Default for Noise {
    fn default() -> Self {
        Self { white_levels2: 1.0, grain_levels2: 0.0, grain_size_px: 1.0 }
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

    /// From half the variances of the differences of pixels 1, 2 and 4 px apart (a variogram without its drift): with x = exp(-1 / (4 l²)) they are w + g (1 - x), w + g (1 - x^4), w + g (1 - x^16).
    fn from_variogram([one, two, four]: [f64; 3]) -> Self {
        let white_only = Self { white_levels2: one.max(ROUNDING_LEVELS2), ..Self::default() };
        if !(two - one > 0.01 * one) {
            return white_only; // less than chance
        }
        // (x^4 - x^16) / (x - x^4) = y (1 + y) (1 + y²) grows with y = x³ from 0 to 4.
        let ratio = (four - two) / (two - one);
        let (mut low, mut high) = (0.0, 0.97);
        for _ in 0..40 {
            let y = 0.5 * (low + high);
            if y * (1.0 + y) * (1.0 + y * y) < ratio { low = y } else { high = y }
        }
        // Above x = 0.4 the grain is at least half a pixel wide; finer grain is white.
        let y = (0.5 * (low + high)).max(0.064);
        let x = cbrt(y);
        let grain_levels2 = (two - one) / (x - x * y);
        let white_levels2 = (one - grain_levels2 * (1.0 - x)).max(ROUNDING_LEVELS2);
        Self { white_levels2, grain_levels2, grain_size_px: crate::math::sqrt(-0.25 / ln(x)) }
    }
}

/// Measures [`Noise`], with its scratch.
#[derive(Clone, Debug, Default)]
pub(in crate::detect) struct NoiseMeter {
    /// Non-zero where a row's pixel is near a marker.
    near: Vec<u8>,
    /// One value per row and lag.
    rows: [Vec<f64>; 3],
}

impl NoiseMeter {
    /// From the pixels of every so many rows of `image` (faint grain shows in no fewer than all) that lie [`CLEARANCE_PX`]
    /// off the set pixels of `mask`: medians over the rows, which a scratch or a smear does not reach. `None` when there is
    /// no such gel.
    pub fn run(&mut self, image: GrayView<'_>, mask: &[u8], every: usize) -> Option<Noise> {
        let width = image.width();
        self.run_rows(image, every, |rows, near| {
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
        mut cover: impl FnMut(core::ops::RangeInclusive<usize>, &mut [u8]),
    ) -> Option<Noise> {
        let (width, height) = (image.width(), image.height());
        for rows in &mut self.rows {
            rows.clear();
            rows.reserve(height);
        }
        for y in (CLEARANCE_PX..height.saturating_sub(CLEARANCE_PX)).step_by(every) {
            self.near.clear();
            self.near.resize(width, 0);
            cover(y - CLEARANCE_PX..=y + CLEARANCE_PX, &mut self.near);
            self.row(image.row(y));
        }
        let mut variogram = [0.0; 3];
        for (value, rows) in variogram.iter_mut().zip(&mut self.rows) {
            *value = median(rows)?;
        }
        Some(Noise::from_variogram(variogram))
    }

    /// Adds one row.
    fn row(&mut self, levels: &[u8]) {
        let (mut row, mut group, mut end) = (Spread::default(), Differences::default(), 0);
        for clear in self.near.split(|&near| near != 0) {
            let start = end;
            end += clear.len() + 1;
            // What is left has its farthest partner clear of the next marker.
            if clear.len() > 2 * CLEARANCE_PX + LAGS[2] {
                group.add(&levels[start + CLEARANCE_PX..start + clear.len() - CLEARANCE_PX]);
            }
            if group.count >= SLOPE_DIFFERENCES {
                row.add(&core::mem::take(&mut group));
            }
        }
        row.add(&group);
        if row.count >= LEAST_DIFFERENCES {
            for (rows, sum) in self.rows.iter_mut().zip(row.sums) {
                rows.push(sum / (2 * row.count) as f64);
            }
        }
    }
}

/// Differences at every lag between pixels of one region of a row.
#[derive(Clone, Copy, Debug, Default)]
struct Differences {
    count: usize,
    sums: [i64; 3],
    squares: [u64; 3],
}

impl Differences {
    /// Adds a stretch of gel longer than the farthest lag.
    fn add(&mut self, stretch: &[u8]) {
        let count = stretch.len() - LAGS[2];
        let level = |levels: &[u8]| levels.iter().map(|&level| i64::from(level)).sum::<i64>();
        self.count += count;
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
    sums: [f64; 3],
}

impl Spread {
    /// Adds differences in which the light's slope is one; too few are left out.
    fn add(&mut self, group: &Differences) {
        if group.count < LEAST_DIFFERENCES {
            return;
        }
        self.count += group.count;
        for (total, (&sum, &square)) in self.sums.iter_mut().zip(group.sums.iter().zip(&group.squares)) {
            *total += square as f64 - (sum * sum) as f64 / group.count as f64;
        }
    }
}

/// Σ (a - b)² over the shorter of the two; exact below 66 000 pixels.
fn squared_difference(a: &[u8], b: &[u8]) -> u32 {
    let square = |(&a, &b): (&u8, &u8)| u32::from(a.abs_diff(b)) * u32::from(a.abs_diff(b));
    a.iter().zip(b).map(square).fold(0, u32::wrapping_add)
}
