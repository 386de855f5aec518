//! Gaussian smoothing and background, row by row in fixed point.
//!
//! Rows are unsigned with [`FRACTION_BITS`] fractional bits, so their differences avoid the double
//! rounding of 8-bit images. Every kernel sums to exactly one: a constant image stays constant.

use crate::image::GrayView;
use crate::math::exp;
use alloc::vec::Vec;

/// Fractional bits of a filtered grey level: 255 becomes 32 640, and the sum of two still fits 16 bits.
pub const FRACTION_BITS: u32 = 7;

/// Fractional bits of a kernel weight: the weight 1 still fits 16 bits.
const WEIGHT_BITS: u32 = 15;

/// Index that replaces `index` in a line of `len` pixels mirrored about its end pixels
/// (`gfedcb|abcdefgh|gfedcba`), repeatedly if needed.
#[must_use]
pub const fn reflect101(index: isize, len: usize) -> usize {
    if len < 2 {
        return 0;
    }
    let period = 2 * (len - 1);
    let folded = index.rem_euclid(period as isize) as usize;
    if folded < len { folded } else { period - folded }
}

/// Separable Gaussian FIR filter with mirrored borders, equal to `cv2.GaussianBlur(image, (k, k), 0)` up
/// to that function's coarser weights.
///
/// sigma = 0.3 ((k - 1) / 2 - 1) + 0.8 px; kernels up to 9 px are OpenCV's fixed ones.
#[derive(Clone, Debug)]
pub struct GaussianBlur {
    /// From the centre outwards.
    weights: Vec<u16>,
    sums: Vec<u32>,
    padded: Vec<u16>,
}

impl GaussianBlur {
    /// Creates the filter for an odd kernel side, 1 to 255 px; an even side counts as the next smaller
    /// odd one.
    #[must_use]
    pub fn new(kernel_px: usize) -> Self {
        Self { weights: gaussian_weights(kernel_px / 2), sums: Vec::new(), padded: Vec::new() }
    }

    /// Standard deviation of filtered white noise of unit variance: the sum of squared weights along one
    /// axis.
    #[must_use]
    pub fn noise_gain(&self) -> f64 {
        let one = f64::from(1_u32 << WEIGHT_BITS);
        let square = |weight: &u16| f64::from(*weight) * f64::from(*weight) / (one * one);
        square(&self.weights[0]) + 2.0 * self.weights[1..].iter().map(square).sum::<f64>()
    }

    /// Writes filtered row `y` of `image` to `out`, which has the image's width.
    pub fn row(&mut self, image: GrayView<'_>, y: usize, out: &mut [u16]) {
        let (width, height, radius) = (image.width(), image.height(), self.weights.len() - 1);
        self.sums.clear();
        self.sums.resize(width, 1 << (WEIGHT_BITS - FRACTION_BITS - 1));
        add_centre(&mut self.sums, image.row(y), self.weights[0]);
        for (k, &weight) in (1_isize..).zip(&self.weights[1..]) {
            let above = image.row(reflect101(y as isize - k, height));
            let below = image.row(reflect101(y as isize + k, height));
            add_pair(&mut self.sums, above, below, weight);
        }
        self.padded.clear();
        self.padded.resize(width + 2 * radius, 0);
        for (padded, &sum) in self.padded[radius..].iter_mut().zip(&self.sums) {
            *padded = (sum >> (WEIGHT_BITS - FRACTION_BITS)) as u16;
        }
        mirror_ends(&mut self.padded, radius);
        self.sums.fill(1 << (WEIGHT_BITS - 1));
        add_centre(&mut self.sums, &self.padded[radius..radius + width], self.weights[0]);
        for (k, &weight) in (1..).zip(&self.weights[1..]) {
            let (before, after) = (&self.padded[radius - k..], &self.padded[radius + k..]);
            add_pair(&mut self.sums, &before[..width], &after[..width], weight);
        }
        for (out, &sum) in out.iter_mut().zip(&self.sums) {
            *out = (sum >> WEIGHT_BITS) as u16;
        }
    }
}

/// Half a kernel from the centre outwards; the whole kernel sums to 2^15.
fn gaussian_weights(radius: usize) -> Vec<u16> {
    // OpenCV's kernels of 1 to 9 px, in 256ths.
    const FIXED: [&[u16]; 5] = [&[256], &[128, 64], &[96, 64, 16], &[72, 56, 28, 8], &[60, 51, 30, 13, 4]];
    if let Some(half) = FIXED.get(radius) {
        return half.iter().map(|w| w << (WEIGHT_BITS - 8)).collect();
    }
    let sigma_px = 0.3 * (radius as f64 - 1.0) + 0.8;
    let samples: Vec<f64> =
        (0..=radius).map(|k| exp(-0.5 * (k as f64 / sigma_px) * (k as f64 / sigma_px))).collect();
    let total = samples[0] + 2.0 * samples[1..].iter().sum::<f64>();
    let one = f64::from(1_u32 << WEIGHT_BITS);
    let mut weights: Vec<u16> = samples.iter().map(|s| crate::math::round(s / total * one) as u16).collect();
    // The rounding error goes to the centre weight, where it changes the variance least.
    let sides: u32 = weights[1..].iter().map(|&w| 2 * u32::from(w)).sum();
    weights[0] = ((1 << WEIGHT_BITS) - sides) as u16;
    weights
}

/// `sums += line * weight`. No sum of this module exceeds (255 << 7 | 127) << 15, which is below 2^31.
fn add_centre<T: Copy + Into<u32>>(sums: &mut [u32], line: &[T], weight: u16) {
    for (sum, &value) in sums.iter_mut().zip(line) {
        *sum = sum.wrapping_add(value.into() * u32::from(weight));
    }
}

/// `sums += (a + b) * weight`; adding first halves the multiplications of a symmetric kernel.
///
/// Not inlined: the compiler vectorises it only as a separate function, three times as fast.
#[inline(never)]
fn add_pair<T: Copy + Into<u16>>(sums: &mut [u32], a: &[T], b: &[T], weight: u16) {
    for ((sum, &a), &b) in sums.iter_mut().zip(a).zip(b) {
        let pair: u16 = a.into().wrapping_add(b.into()); // at most 2 x 32 640
        *sum = sum.wrapping_add(u32::from(pair).wrapping_mul(u32::from(weight)));
    }
}

/// Mirrors the line into `radius` elements at both ends.
fn mirror_ends<T: Copy>(padded: &mut [T], radius: usize) {
    let len = padded.len() - 2 * radius;
    for k in 1..=radius {
        padded[radius - k] = padded[radius + reflect101(-(k as isize), len)];
        padded[radius + len - 1 + k] = padded[radius + reflect101((len - 1 + k) as isize, len)];
    }
}
