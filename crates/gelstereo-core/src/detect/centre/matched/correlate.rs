//! Integer sums of products of levels with weights, in plain loops that compilers vectorise.

use super::design::MAX_SUPPORT_PX;
use crate::image::GrayView;

/// Fractional bits of the stored share of a disc: its product with a contrast of 255 fits 16 bits.
pub(super) const SHARE_BITS: u32 = 7;

/// Numbers multiplied at once.
const BLOCK: usize = 32;
/// Largest number of entries of a patch.
const MOST: usize = (MAX_SUPPORT_PX + 1) * BLOCK;

/// Columns of a patch of this side, padded to a multiple of eight.
pub(super) const fn columns(side: usize) -> usize {
    side.next_multiple_of(8)
}

/// Entries of a patch of this side, padded to whole blocks.
pub(super) const fn numbers(side: usize) -> usize {
    (side * columns(side)).next_multiple_of(BLOCK)
}

/// Levels of a square of pixels, row by row; padding has no weight.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    levels: [[i16; BLOCK]; MOST / BLOCK],
    rest: [[i16; BLOCK]; MOST / BLOCK],
}

impl Default for Patch {
    fn default() -> Self {
        Self { levels: [[0; BLOCK]; MOST / BLOCK], rest: [[0; BLOCK]; MOST / BLOCK] }
    }
}

impl Patch {
    /// Copies the square whose first pixel is `first`; it must lie within the image.
    #[inline]
    pub fn load(&mut self, image: GrayView<'_>, first: (usize, usize), side: usize) {
        match columns(side) {
            8 => self.load_rows::<8>(image, first, side),
            16 => self.load_rows::<16>(image, first, side),
            24 => self.load_rows::<24>(image, first, side),
            _ => self.load_rows::<32>(image, first, side),
        }
    }

    #[inline]
    fn load_rows<const WIDTH: usize>(&mut self, image: GrayView<'_>, (x, y): (usize, usize), side: usize) {
        let rows = self.levels.as_flattened_mut().as_chunks_mut::<WIDTH>().0;
        for (row, to) in rows.iter_mut().take(side).enumerate() {
            let from = &image.row(y + row)[x..];
            if let Some(from) = from.first_chunk::<WIDTH>() {
                for k in 0..WIDTH {
                    to[k] = i16::from(from[k]);
                }
            } else {
                // The image ends here, and no weight lies beyond.
                to.iter_mut().zip(from).for_each(|(to, &from)| *to = i16::from(from));
            }
        }
    }

    /// Sum of the products of the levels with a kernel.
    #[inline]
    pub fn correlate(&self, kernel: &[i16]) -> i32 {
        product(&self.levels, kernel.as_chunks().0)
    }

    /// Σ r and Σ r² of the residuals after subtracting a disc of this contrast, over the pixels where the
    /// mask is -1.
    #[inline]
    pub fn residual(&mut self, share: &[i16], mask: &[i16], contrast: i16) -> (i32, i32) {
        let (share, mask) = (share.as_chunks::<BLOCK>().0, mask.as_chunks::<BLOCK>().0);
        for (((rest, levels), share), mask) in self.rest.iter_mut().zip(&self.levels).zip(share).zip(mask) {
            for k in 0..BLOCK {
                let disc = share[k].wrapping_mul(contrast) >> SHARE_BITS;
                rest[k] = levels[k].wrapping_sub(disc) & mask[k];
            }
        }
        (product(&self.rest, mask).wrapping_neg(), product(&self.rest, &self.rest[..mask.len()]))
    }
}

/// Σ a b over the shorter of the two.
#[inline(never)]
fn product(a: &[[i16; BLOCK]], b: &[[i16; BLOCK]]) -> i32 {
    let mut sum = 0_i32;
    for (a, b) in a.iter().zip(b) {
        let mut block = 0_i32;
        for k in 0..BLOCK {
            block = block.wrapping_add(i32::from(a[k]) * i32::from(b[k]));
        }
        sum = sum.wrapping_add(block);
    }
    sum
}
