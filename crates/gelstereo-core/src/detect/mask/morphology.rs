//! Morphological closing of a mask with an elliptic kernel.

use crate::math::{round_even, sqrt};
use alloc::vec::Vec;

/// Dilation followed by erosion with the elliptic kernel of `cv2.MORPH_ELLIPSE`. Pixels beyond the image
/// are ignored, as in OpenCV.
#[derive(Clone, Debug)]
pub struct Closing {
    /// Half width of the kernel's rows, from the top row down.
    half_widths: Vec<usize>,
    dilated: Vec<u8>,
    line: Vec<u8>,
}

impl Closing {
    /// Creates the closing for an odd kernel side; 1 changes nothing, an even side counts as the next
    /// smaller odd one.
    #[must_use]
    pub fn new(kernel_px: usize) -> Self {
        let radius = (kernel_px / 2) as isize;
        let half_width = |dy: isize| round_even(sqrt((radius * radius - dy * dy) as f64)) as usize;
        Self {
            half_widths: (-radius..=radius).map(half_width).collect(),
            dilated: Vec::new(),
            line: Vec::new(),
        }
    }

    /// Closes `mask` in place: rows of `width` bytes that are 0 or 255.
    pub fn run(&mut self, mask: &mut [u8], width: usize) {
        if self.half_widths.len() == 1 || width == 0 {
            return;
        }
        self.dilated.clear();
        self.dilated.resize(mask.len(), 0);
        let Self { half_widths, dilated, line } = self;
        sweep(mask, dilated, line, width, half_widths, 0, |a, b| a | b);
        sweep(dilated, mask, line, width, half_widths, u8::MAX, |a, b| a & b);
    }
}

/// Combines the pixels under the kernel with `join`, whose identity element is `neutral`.
fn sweep(
    from: &[u8],
    to: &mut [u8],
    line: &mut Vec<u8>,
    width: usize,
    half_widths: &[usize],
    neutral: u8,
    join: impl Fn(u8, u8) -> u8 + Copy,
) {
    let (height, radius) = (from.len() / width, half_widths.len() / 2);
    for (y, out) in to.chunks_exact_mut(width).enumerate() {
        out.fill(neutral);
        for (row, &half_width) in half_widths.iter().enumerate() {
            let Some(source) = (y + row).checked_sub(radius).filter(|&source| source < height) else {
                continue;
            };
            line.clear();
            line.resize(width + 2 * half_width, neutral);
            line[half_width..half_width + width].copy_from_slice(&from[source * width..][..width]);
            for shift in 0..=2 * half_width {
                for (out, &value) in out.iter_mut().zip(&line[shift..]) {
                    *out = join(*out, value);
                }
            }
        }
    }
}
