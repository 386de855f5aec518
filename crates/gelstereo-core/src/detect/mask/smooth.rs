//! Smoothing to whole grey levels. Output is dark markers on a bright gel for both polarities.

use super::blur::{FRACTION_BITS, GaussianBlur, reflect101};
use crate::image::GrayView;
use crate::params::Polarity;
use alloc::vec::Vec;

/// Smooths single rows of an image and inverts them if markers are bright.
#[derive(Clone, Debug)]
pub struct Smoother {
    kernel: Kernel,
    /// XOR mask; 255 inverts.
    flip: u8,
    /// Standard deviation of filtered white noise of unit variance.
    noise_gain: f64,
}

#[derive(Clone, Debug)]
enum Kernel {
    None,
    Binomial(Vec<u8>),
    Gaussian(GaussianBlur, Vec<u16>),
}

impl Smoother {
    /// Creates the smoother for an odd kernel side; 3 is the binomial kernel, 1 leaves the image unchanged.
    #[must_use]
    pub fn new(kernel_px: usize, polarity: Polarity) -> Self {
        let blur = GaussianBlur::new(kernel_px);
        let noise_gain = blur.noise_gain();
        let kernel = match kernel_px {
            0..=2 => Kernel::None,
            3 | 4 => Kernel::Binomial(Vec::new()),
            _ => Kernel::Gaussian(blur, Vec::new()),
        };
        Self { kernel, flip: if polarity == Polarity::Bright { u8::MAX } else { 0 }, noise_gain }
    }

    /// Standard deviation of filtered white noise of unit variance.
    #[must_use]
    pub const fn noise_gain(&self) -> f64 {
        self.noise_gain
    }

    /// Writes smoothed row `y` of `image` to `out`, which has the image's width.
    pub fn row(&mut self, image: GrayView<'_>, y: usize, out: &mut [u8]) {
        let flip = self.flip;
        match &mut self.kernel {
            Kernel::None => {
                for (out, &level) in out.iter_mut().zip(image.row(y)) {
                    *out = level ^ flip;
                }
            }
            Kernel::Binomial(columns) => binomial_row(image, y, flip, columns, out),
            Kernel::Gaussian(blur, row) => {
                row.clear();
                row.resize(out.len(), 0);
                blur.row(image, y, row);
                for (out, &level) in out.iter_mut().zip(row.iter()) {
                    *out = ((level + (1 << (FRACTION_BITS - 1))) >> FRACTION_BITS) as u8 ^ flip;
                }
            }
        }
    }
}

/// Binomial kernel 1 2 1 in both directions, mirrored at the borders. The mean of the outer two is
/// rounded down, its mean with the middle one rounded up. On average both roundings add an eighth of a
/// level per direction.
fn binomial_row(image: GrayView<'_>, y: usize, flip: u8, columns: &mut Vec<u8>, out: &mut [u8]) {
    let (width, height) = (image.width(), image.height());
    let row = |dy: isize| image.row(reflect101(y as isize + dy, height));
    columns.resize(width + 2, 0);
    average(row(-1), row(0), row(1), flip, &mut columns[1..=width]);
    columns[0] = columns[1 + reflect101(-1, width)];
    columns[width + 1] = columns[1 + reflect101(width as isize, width)];
    average(&columns[..width], &columns[1..=width], &columns[2..], 0, out);
}

/// (a + 2 b + c) / 4 of the inverted or plain levels. The mean of two bytes is a single instruction.
#[inline(never)]
fn average(a: &[u8], b: &[u8], c: &[u8], flip: u8, out: &mut [u8]) {
    let up = |a: u8, b: u8| ((u16::from(a) + u16::from(b) + 1) >> 1) as u8;
    for (((out, &a), &b), &c) in out.iter_mut().zip(a).zip(b).zip(c) {
        let outer = !up(!(a ^ flip), !(c ^ flip));
        *out = up(outer, b ^ flip);
    }
}
