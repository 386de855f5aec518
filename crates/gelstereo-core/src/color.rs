//! One channel of a borrowed colour image.

use crate::image::{GrayView, ImageError};
use crate::params::{Channel, DetectParams, Polarity};
use alloc::vec;
use alloc::vec::Vec;

/// Bytes per pixel.
const SAMPLES: usize = 3;
/// OpenCV's weights of blue, green and red in grey, in 1/32768.
const GREY_WEIGHTS: [u32; SAMPLES] = [3735, 19235, 9798];
/// Every second row and column is enough to compare channels.
const STEP: usize = 2;
/// A channel replaces grey when its contrast over noise is larger by this factor. Grey averages three
/// channels, so a channel of equal contrast has up to 1.7 times the noise of grey. Where noise is below a
/// grey level, both have the same: then a print that shows in all channels keeps grey, even if one shows it a
/// fifth better.
const GAIN_OVER_GREY: f64 = 1.25;
/// Channels in the order of the bytes.
const COLOURS: [Channel; SAMPLES] = [Channel::Blue, Channel::Green, Channel::Red];

/// A borrowed 8-bit colour image: rows of blue, green and red bytes, pixel by pixel, as OpenCV orders them.
#[derive(Clone, Copy, Debug)]
pub struct ColorView<'a> {
    /// The same bytes as a grey image three times as wide.
    bytes: GrayView<'a>,
    width: usize,
}

impl<'a> ColorView<'a> {
    /// A view of rows that are `stride` bytes apart.
    ///
    /// # Errors
    /// As [`GrayView::new`], for rows of three bytes a pixel.
    pub fn new(data: &'a [u8], width: usize, height: usize, stride: usize) -> Result<Self, ImageError> {
        let bytes = GrayView::new(data, width.saturating_mul(SAMPLES), height, stride)?;
        Ok(Self { bytes, width })
    }

    /// Width in pixels.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.bytes.height()
    }

    /// Writes a channel, row by row, into `out`. [`Channel::Auto`] writes grey; [`Self::best_channel`]
    /// chooses.
    pub fn write(&self, channel: Channel, out: &mut Vec<u8>) {
        out.clear();
        out.reserve(self.width * self.height());
        let place = COLOURS.iter().position(|&colour| colour == channel);
        for y in 0..self.height() {
            let pixels = self.bytes.row(y).chunks_exact(SAMPLES);
            match place {
                Some(place) => out.extend(pixels.map(|pixel| pixel[place])),
                None => out.extend(pixels.map(grey)),
            }
        }
    }

    /// The channel in which the print stands out most from its noise: the mean square of what is darker
    /// (brighter, by `detect.polarity`) than the surroundings of `detect.background_kernel_px`, over the
    /// noise. Never [`Channel::Auto`].
    #[must_use]
    pub fn best_channel(&self, params: &DetectParams) -> Channel {
        let mut levels = Vec::new();
        let mut contrast = |channel| {
            self.write(channel, &mut levels);
            contrast_over_noise(&levels, self.width, params)
        };
        let (mut best, mut highest) = (Channel::Grey, contrast(Channel::Grey) * GAIN_OVER_GREY);
        for channel in COLOURS {
            let found = contrast(channel);
            if found > highest {
                (best, highest) = (channel, found);
            }
        }
        best
    }
}

fn grey(pixel: &[u8]) -> u8 {
    let sum: u32 = pixel.iter().zip(GREY_WEIGHTS).map(|(&level, weight)| u32::from(level) * weight).sum();
    // The weights add up to 32768, so the result is at most 255.
    ((sum + (1 << 14)) >> 15) as u8
}

/// Root mean square difference of pixels from the mean around them, of one sign, over the noise.
fn contrast_over_noise(levels: &[u8], width: usize, params: &DetectParams) -> f64 {
    let thinned: Vec<Vec<u8>> = levels
        .chunks_exact(width)
        .step_by(STEP)
        .map(|row| row.iter().step_by(STEP).copied().collect())
        .collect();
    let (rows, cols) = (thinned.len(), thinned.first().map_or(0, Vec::len));
    let half = (params.background_kernel_px / (2 * STEP)).max(1);
    let sums = summed(&thinned, cols);
    let mut squares = 0_u64;
    for (y, row) in thinned.iter().enumerate() {
        let (top, bottom) = (y.saturating_sub(half), (y + half + 1).min(rows));
        for (x, &level) in row.iter().enumerate() {
            let (left, right) = (x.saturating_sub(half), (x + half + 1).min(cols));
            let at = |y: usize, x: usize| sums[y * (cols + 1) + x];
            let sum = at(bottom, right) + at(top, left) - at(top, right) - at(bottom, left);
            let mean = sum / ((bottom - top) * (right - left)) as u64;
            let (level, mean) = (i64::from(level), mean as i64);
            let over = if params.polarity == Polarity::Dark { mean - level } else { level - mean };
            squares += over.max(0).unsigned_abs().pow(2);
        }
    }
    let mean_square = squares as f64 / (rows * cols).max(1) as f64;
    crate::math::sqrt(mean_square) / noise_levels(levels, width)
}

/// Sums of all pixels above and to the left, with a row and a column of zeros before them.
fn summed(rows: &[Vec<u8>], cols: usize) -> Vec<u64> {
    let mut sums = vec![0_u64; (rows.len() + 1) * (cols + 1)];
    for (y, row) in rows.iter().enumerate() {
        let mut along = 0;
        for (x, &level) in row.iter().enumerate() {
            along += u64::from(level);
            sums[(y + 1) * (cols + 1) + x + 1] = sums[y * (cols + 1) + x + 1] + along;
        }
    }
    sums
}

/// Standard deviation of the noise, at least one level: from the median second difference along the rows,
/// which edges do not change while they cover less than half of the image.
fn noise_levels(levels: &[u8], width: usize) -> f64 {
    let mut counts = [0_usize; 2 * 255 + 1];
    for row in levels.chunks_exact(width).step_by(STEP) {
        for three in row.windows(3) {
            let difference = 2 * i32::from(three[1]) - i32::from(three[0]) - i32::from(three[2]);
            counts[difference.unsigned_abs() as usize] += 1;
        }
    }
    let total: usize = counts.iter().sum();
    let mut below = 0;
    let median = counts.iter().position(|&count| {
        below += count;
        2 * below >= total
    });
    // The median of the absolute value of a normal number is 0.6745 standard deviations; a second difference
    // has the variance of six pixels.
    (median.unwrap_or(0) as f64 / (0.6745 * crate::math::sqrt(6.0))).max(1.0)
}
