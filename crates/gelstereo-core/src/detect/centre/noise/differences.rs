//! Differences between gel pixels of a row, from which the noise is estimated.

use crate::detect::mask::bit_rows::BitRow;
use core::ops::Range;

/// Differences per estimate of the light's slope: few enough that the slope is constant, and enough that
/// the noise lost with their mean, a share of 4 stretches / differences², is below a percent.
pub(super) const SLOPE_DIFFERENCES: usize = 20;
/// Least number of differences used.
pub(super) const MIN_DIFFERENCES: usize = 16;
/// Distances at which pixels are compared.
const LAGS: [usize; 3] = [1, 2, 4];
/// Half of the largest lag.
pub(super) const HALF_LAG_PX: usize = LAGS[2] / 2;

/// Passes the gel differences of one row to `tell`, in pieces of constant light slope; pieces that are
/// too short are left out. `near` must be set up to `clearance_px` + [`HALF_LAG_PX`] from any marker.
pub(super) fn each_piece(
    levels: &[u8],
    near: &BitRow,
    clearance_px: usize,
    mut tell: impl FnMut(&Differences),
) {
    let mut piece = Differences::default();
    for clear in near.clear_stretches() {
        // The farthest partner of each remaining pixel is clear of the next marker. Row ends count as
        // markers.
        let mut start = clear.start.saturating_sub(HALF_LAG_PX).max(clearance_px);
        let end = (clear.end + HALF_LAG_PX).min(levels.len().saturating_sub(clearance_px));
        while end > start + LAGS[2] {
            let left = end - start - LAGS[2];
            let count = if left < 2 * SLOPE_DIFFERENCES { left } else { SLOPE_DIFFERENCES };
            piece.add(levels, start..start + count + LAGS[2]);
            start += count;
            if piece.count >= SLOPE_DIFFERENCES {
                tell(&core::mem::take(&mut piece));
            }
        }
    }
    if piece.count >= MIN_DIFFERENCES {
        tell(&piece);
    }
}

/// Differences at every lag between pixels of one region of a row.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Differences {
    pub count: usize,
    /// Sum of the levels of each pair's first pixel.
    pub levels: u64,
    sums: [i64; 3],
    squares: [u64; 3],
    /// Half the number of pixels that do not cancel in the sum of differences.
    ends: [usize; 3],
}

impl Differences {
    /// Σ (difference - mean difference)² at every lag.
    pub fn squared(&self) -> [f64; 3] {
        let count = self.count as f64;
        core::array::from_fn(|lag| {
            let (sum, square) = (self.sums[lag] as f64, self.squares[lag] as f64);
            // White noise of variance s² adds 2 s² to each square, and 2 s² per pair of ends to the
            // squared sum. The part lost with the mean grows with the lag and would bias the grain.
            (square - sum * sum / count) / (1.0 - self.ends[lag] as f64 / (count * count))
        })
    }

    /// Adds a gel stretch of a row that is longer than the farthest lag.
    fn add(&mut self, row: &[u8], gel: Range<usize>) {
        let stretch = &row[gel.clone()];
        let count = stretch.len() - LAGS[2];
        self.count += count;
        for ((sum, ends), lag) in self.sums.iter_mut().zip(&mut self.ends).zip(LAGS) {
            // Sum over all but the first pixels minus sum over all but the last: the common part cancels.
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

/// Pixels whose squares are added at once, and with their comparison pixels.
const LANES: usize = 32;
const SPAN: usize = LANES + LAGS[2];
/// From index [`LANES`] - n on, it passes n pixels.
const MASK: [u8; 2 * LANES] = {
    let (mut mask, mut x) = ([0; 2 * LANES], 0);
    while x < LANES {
        (mask[x], x) = (u8::MAX, x + 1);
    }
    mask
};

/// Squared differences between the masked pixels and those at a lag. Byte differences and 16-bit products
/// compile to vector instructions only in a separate function.
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
    use super::{Differences, HALF_LAG_PX, LAGS, LANES, each_piece};
    use crate::detect::mask::bit_rows::BitRow;
    use crate::math::abs;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    /// A row of gel stretches of these lengths, each followed by a marker of this width: its length, and
    /// the pixels near markers.
    fn masked(gel: &[usize], marker: usize, clearance: usize) -> (usize, BitRow) {
        let mut near = BitRow::default();
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

    /// Sums over the pieces of a row: differences, and their squares at every lag.
    fn spread_of(levels: &[u8], near: &BitRow, clearance: usize) -> (usize, [f64; 3]) {
        let mut all = (0, [0.0; 3]);
        each_piece(levels, near, clearance, |piece| {
            all.0 += piece.count;
            all.1.iter_mut().zip(piece.squared()).for_each(|(all, one)| *all += one);
        });
        all
    }

    proptest! {
        /// White noise has the same variance at all lags after mean removal. For independent pixels of
        /// variance 1, the mean of a sum of squares is the sum over single pixels, so the test is exact.
        #[test]
        fn a_slope_takes_no_more_noise_from_far_pixels_than_from_near_ones(
            gel in prop::collection::vec(14..90_usize, 1..12), marker in 1..12_usize, clearance in 1..5_usize,
        ) {
            let (length, near) = masked(&gel, marker, clearance);
            let (mut sums, mut levels) = ([0.0; 3], alloc::vec![0; length]);
            for x in 0..length {
                levels[x] = 1;
                let alone = spread_of(&levels, &near, clearance).1;
                sums.iter_mut().zip(alone).for_each(|(sum, alone)| *sum += alone);
                levels[x] = 0;
            }
            let count = spread_of(&levels, &near, clearance).0 as f64;
            for (sum, lag) in sums.iter().zip(LAGS) {
                prop_assert!(abs(sum - 2.0 * count) <= 1e-11 * count, "lag {lag}: {sum} of {}", 2.0 * count);
            }
        }

        /// A linear light slope along the row does not change the differences' variance.
        #[test]
        fn a_slope_of_light_is_no_noise(
            gel in prop::collection::vec(14..40_usize, 1..5), marker in 1..12_usize, level in 0..20_u8,
            noise in prop::collection::vec(0..20_u8, 208),
        ) {
            let (length, near) = masked(&gel, marker, 1);
            let dark = &noise[..length];
            let lit: Vec<u8> = (0_u8..).zip(dark).map(|(x, noise)| noise + level + x).collect();
            let (dark, lit) = (spread_of(dark, &near, 1).1, spread_of(&lit, &near, 1).1);
            for (a, b) in dark.iter().zip(lit) {
                // Round-off of squares below 2^17.
                prop_assert!(abs(a - b) < 1e-9, "{} {}", a, b);
            }
        }
    }

    proptest! {
        /// Agrees with a pair-by-pair sum, for lengths around the vector length and at either end of a row.
        #[test]
        fn differences_add_up(
            row in prop::collection::vec(any::<u8>(), 5..4 * LANES), before in 0..9_usize,
            after in 0..40_usize,
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
