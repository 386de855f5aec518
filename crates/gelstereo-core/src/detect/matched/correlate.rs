//! Sums of products of levels with weights, in whole numbers: plain loops over rows of fixed width.

use crate::image::GrayView;

/// Widest row of weights.
pub(super) const MOST_COLUMNS: usize = 32;

/// Where a support lies in an image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch<'a> {
    pub image: GrayView<'a>,
    /// First column and row, and pixels on a side; all lie within the image.
    pub first: (usize, usize),
    pub side: usize,
}

impl Patch<'_> {
    /// Sums of the products of the levels with each kernel, in rows of `columns` numbers (a multiple of eight).
    #[inline]
    pub fn correlate<const N: usize>(&self, columns: usize, kernels: [&[i16]; N]) -> [i32; N] {
        match columns {
            8 => self.correlate_rows::<N, 8>(kernels),
            16 => self.correlate_rows::<N, 16>(kernels),
            24 => self.correlate_rows::<N, 24>(kernels),
            _ => self.correlate_rows::<N, MOST_COLUMNS>(kernels),
        }
    }

    fn correlate_rows<const N: usize, const WIDTH: usize>(&self, kernels: [&[i16]; N]) -> [i32; N] {
        let kernels = kernels.map(|kernel| kernel.as_chunks::<WIDTH>().0);
        let mut sums = [[0_i32; 4]; N];
        for row in 0..self.side {
            let levels: [i16; WIDTH] = self.row(row).map(i16::from);
            for (sums, kernel) in sums.iter_mut().zip(kernels) {
                add_products(sums, &levels, &kernel[row]);
            }
        }
        sums.map(|sums| sums.iter().fold(0, |all: i32, &sum| all.wrapping_add(sum)))
    }

    /// Σ r and Σ r² of what is left of the levels without a disc of this contrast, over the pixels of the mask.
    #[inline]
    pub fn residual(&self, columns: usize, share: &[i16], mask: &[i16], contrast: i16) -> (i32, i32) {
        match columns {
            8 => self.residual_rows::<8>(share, mask, contrast),
            16 => self.residual_rows::<16>(share, mask, contrast),
            24 => self.residual_rows::<24>(share, mask, contrast),
            _ => self.residual_rows::<MOST_COLUMNS>(share, mask, contrast),
        }
    }

    fn residual_rows<const WIDTH: usize>(&self, share: &[i16], mask: &[i16], contrast: i16) -> (i32, i32) {
        let (share, mask) = (share.as_chunks::<WIDTH>().0, mask.as_chunks::<WIDTH>().0);
        let (mut sums, mut squares) = ([0_i32; 4], [0_i32; 4]);
        for row in 0..self.side {
            let levels = self.row::<WIDTH>(row);
            let (share, mask) = (&share[row], &mask[row]);
            let left: [i16; WIDTH] = core::array::from_fn(|k| {
                let disc = (i32::from(share[k]) * i32::from(contrast)) >> 16;
                i16::from(levels[k]).wrapping_sub(disc as i16) & mask[k]
            });
            add_products(&mut sums, &left, mask);
            add_products(&mut squares, &left, &left);
        }
        let all = |sums: [i32; 4]| sums.iter().fold(0, |all: i32, &sum| all.wrapping_add(sum));
        (all(sums).wrapping_neg(), all(squares))
    }

    /// A row's levels; beyond the image's right border, where no weight is, zero.
    #[inline]
    fn row<const WIDTH: usize>(&self, row: usize) -> [u8; WIDTH] {
        let row = &self.image.row(self.first.1 + row)[self.first.0..];
        row.first_chunk().copied().unwrap_or_else(|| {
            let mut padded = [0; WIDTH];
            padded[..row.len()].copy_from_slice(row);
            padded
        })
    }
}

/// Adds products of neighbours in pairs, as vector instructions do.
#[inline]
fn add_products<const WIDTH: usize>(sums: &mut [i32; 4], a: &[i16; WIDTH], b: &[i16; WIDTH]) {
    let ((a, _), (b, _)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    for (a, b) in a.iter().zip(b) {
        for (k, sum) in sums.iter_mut().enumerate() {
            let product = |k: usize| i32::from(a[k]) * i32::from(b[k]);
            *sum = sum.wrapping_add(product(2 * k).wrapping_add(product(2 * k + 1)));
        }
    }
}
