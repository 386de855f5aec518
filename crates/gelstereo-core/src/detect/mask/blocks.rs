//! Image reduced to blocks of 8 x 8 pixels: mean and darkest level of each. Both give the gel's level
//! around each block and the markers' contrast.
//!
//! All levels are those of dark markers on a bright gel; images of bright markers are inverted first.

use super::blur::{FRACTION_BITS, reflect101};
use alloc::vec::Vec;

/// Side of a block, pixels. It may exceed the gap between markers, since only means and extremes are used.
pub const BLOCK_PX: usize = 8;

/// Blocks of an image with their statistics.
#[derive(Clone, Debug, Default)]
pub struct Blocks {
    /// Blocks per row.
    cols: usize,
    /// Mean of each block, with [`FRACTION_BITS`].
    mean: Vec<u16>,
    /// Darkest smoothed level of each block.
    darkest: Vec<u8>,
    /// Background (mean of gel and markers) around each block, with [`FRACTION_BITS`].
    background: Vec<u16>,
    columns: Columns,
}

/// Sums and minima of each pixel column within a row of blocks.
#[derive(Clone, Debug, Default)]
struct Columns {
    sum: Vec<u16>,
    darkest: Vec<u8>,
}

impl Blocks {
    /// Starts an image of this size.
    pub fn start(&mut self, width: usize, height: usize) {
        self.cols = width.div_ceil(BLOCK_PX);
        let blocks = self.cols * height.div_ceil(BLOCK_PX);
        self.mean.clear();
        self.mean.reserve(blocks);
        self.darkest.clear();
        self.darkest.reserve(blocks);
        self.columns.sum.resize(width, 0);
        self.columns.darkest.resize(width, 0);
    }

    /// Adds the next row of blocks: [`BLOCK_PX`] rows of pixels, fewer only at the lower border.
    pub fn push(&mut self, rows: &[u8]) {
        self.columns.add_up(rows);
        let Columns { sum, darkest } = &self.columns;
        let height = rows.len() / sum.len().max(1);
        let mean = |total: u32, area: u32| (((total << FRACTION_BITS) + area / 2) / area) as u16;
        let (whole_sums, last_sum) = sum.as_chunks::<BLOCK_PX>();
        let (whole_darkest, last_darkest) = darkest.as_chunks::<BLOCK_PX>();
        let totals = whole_sums.iter().map(|sum| sum.iter().map(|&s| u32::from(s)).sum());
        if height == BLOCK_PX {
            const AREA: u32 = (BLOCK_PX * BLOCK_PX) as u32;
            self.mean.extend(totals.map(|total| mean(total, AREA)));
        } else {
            self.mean.extend(totals.map(|total| mean(total, (BLOCK_PX * height) as u32)));
        }
        let min = |levels: &[u8]| levels.iter().fold(u8::MAX, |low, &level| low.min(level));
        self.darkest.extend(whole_darkest.iter().map(|levels| min(levels)));
        if !last_sum.is_empty() {
            let total = last_sum.iter().map(|&s| u32::from(s)).sum();
            self.mean.push(mean(total, (last_sum.len() * height) as u32));
            self.darkest.push(min(last_darkest));
        }
    }

    /// Ends the image and computes the background: the mean of the blocks within `radius` blocks,
    /// mirrored at the borders. `boxes` is scratch.
    pub fn finish(&mut self, radius: usize, boxes: &mut BoxSums) {
        let area = (2 * radius as u64 + 1).pow(2);
        let sums = boxes.run(&self.mean, u64::from, self.cols, radius);
        self.background.clear();
        self.background.extend(sums.iter().map(|sum| ((sum + area / 2) / area) as u16));
    }

    /// Blocks per row.
    #[must_use]
    pub const fn cols(&self) -> usize {
        self.cols
    }

    /// Background around each block with [`FRACTION_BITS`], row by row.
    #[must_use]
    pub fn background(&self) -> &[u16] {
        &self.background
    }

    /// Means of the blocks, and their backgrounds, which are replaced beside a wall ([`super::walls`]).
    pub(in crate::detect) fn means_and_background_mut(&mut self) -> (&[u16], &mut [u16]) {
        (&self.mean, &mut self.background)
    }

    /// Mean of each block with [`FRACTION_BITS`], row by row.
    pub(in crate::detect) fn means(&self) -> &[u16] {
        &self.mean
    }

    /// Darkest smoothed level of each block, row by row.
    pub(in crate::detect) fn darkest(&self) -> &[u8] {
        &self.darkest
    }

    /// Contrast of each block's darkest pixel to its background, row by row, in 1 / 2^`bits` grey levels.
    pub fn depths(&self, bits: u32) -> impl Iterator<Item = u16> {
        self.background.iter().zip(&self.darkest).map(move |(&background, &darkest)| {
            background.saturating_sub(u16::from(darkest) << FRACTION_BITS) >> (FRACTION_BITS - bits)
        })
    }

    /// Radius in blocks of the square whose side is nearest to `kernel_px`.
    #[must_use]
    pub const fn radius_of(kernel_px: usize) -> usize {
        // (2 r + 1) blocks of 8 px, rounded.
        kernel_px / (2 * BLOCK_PX)
    }
}

impl Columns {
    /// Computes them for these rows.
    fn add_up(&mut self, rows: &[u8]) {
        let Self { sum, darkest } = self;
        let width = sum.len();
        let row = |y: usize| &rows[y * width..][..width];
        if rows.len() == BLOCK_PX * width {
            // All rows at once: sums and minima stay in registers. A sum is at most 8 x 255.
            let all: [&[u8]; BLOCK_PX] = core::array::from_fn(row);
            for (x, sum) in sum.iter_mut().enumerate() {
                *sum = all.iter().fold(0, |sum, row| sum + u16::from(row[x]));
            }
            for (x, darkest) in darkest[..width].iter_mut().enumerate() {
                *darkest = all.iter().fold(u8::MAX, |low, row| low.min(row[x]));
            }
            return;
        }
        sum.fill(0);
        darkest.fill(u8::MAX);
        for row in rows.chunks_exact(width.max(1)) {
            for ((sum, darkest), &level) in sum.iter_mut().zip(&mut *darkest).zip(row) {
                *sum += u16::from(level);
                *darkest = level.min(*darkest);
            }
        }
    }
}

/// Sums over squares of blocks, mirrored at the borders.
#[derive(Clone, Debug, Default)]
pub struct BoxSums {
    columns: Vec<u64>,
    out: Vec<u64>,
}

impl BoxSums {
    /// Sums `weigh` over the blocks within `radius` of each, for rows of `cols` values. The total of a
    /// square must fit 64 bits.
    pub fn run<T: Copy>(
        &mut self,
        values: &[T],
        weigh: impl Fn(T) -> u64,
        cols: usize,
        radius: usize,
    ) -> &[u64] {
        let (rows, reach) = (values.len() / cols.max(1), radius as isize);
        let row = |y: isize| &values[reflect101(y, rows) * cols..][..cols];
        self.out.resize(values.len(), 0);
        self.columns.clear();
        self.columns.resize(cols, 0);
        for y in -reach..reach {
            for (column, &value) in self.columns.iter_mut().zip(row(y)) {
                *column += weigh(value);
            }
        }
        for (y, out) in (0_isize..).zip(self.out.chunks_exact_mut(cols.max(1))) {
            for (column, &value) in self.columns.iter_mut().zip(row(y + reach)) {
                *column += weigh(value);
            }
            sum_along(&self.columns, radius, out);
            for (column, &value) in self.columns.iter_mut().zip(row(y - reach)) {
                *column -= weigh(value);
            }
        }
        &self.out
    }
}

/// Running sums over `radius` elements to both sides, mirrored at the ends.
fn sum_along(line: &[u64], radius: usize, out: &mut [u64]) {
    let (len, reach) = (line.len(), radius as isize);
    // Mirroring an index needs a division; few indices need it.
    let mirrored = |x: isize| line.get(x as usize).copied().unwrap_or_else(|| line[reflect101(x, len)]);
    let mut sum: u64 = (-reach..reach).map(mirrored).sum();
    let first = radius.min(len);
    let last = len.saturating_sub(radius).max(first);
    let near_ends = |out: &mut [u64], from: usize, sum: &mut u64| {
        for (x, out) in (from as isize..).zip(out) {
            *sum += mirrored(x + reach);
            *out = *sum;
            *sum -= mirrored(x - reach);
        }
    };
    near_ends(&mut out[..first], 0, &mut sum);
    for ((out, &ahead), &behind) in
        out[first..last].iter_mut().zip(&line[(first + radius).min(len)..]).zip(line)
    {
        sum += ahead;
        *out = sum;
        sum -= behind;
    }
    near_ends(&mut out[last..], last, &mut sum);
}
