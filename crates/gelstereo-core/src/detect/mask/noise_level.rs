//! Noise estimate from a single image.

use crate::image::GrayView;
use alloc::vec::Vec;

/// Rows sampled: some ten thousand pixels of a camera image give the noise to a percent.
const SAMPLED_ROWS: usize = 16;

/// Largest response of the mask below: four corners of 1 and the centre's 4, on levels up to 255.
const MOST: usize = 8 * 255;

/// Standard deviation of the pixel noise by the mask 1 -2 1 / -2 4 -2 / 1 -2 1, which is blind to slopes
/// and to edges along rows or columns (Immerkær, "Fast noise variance estimation", CVIU 1996). It uses
/// the median instead of the mean, so that markers do not count as noise.
#[derive(Clone, Debug, Default)]
pub struct NoiseLevel {
    responses: Vec<i16>,
    histogram: Vec<u32>,
}

impl NoiseLevel {
    /// Standard deviation, grey levels; 0 for images less than three pixels wide or high.
    ///
    /// Rounding to whole levels hides noise below about a quarter of a level. Noise correlated between
    /// neighbouring pixels (grain, compression) is underestimated.
    pub fn sigma_levels(&mut self, image: GrayView<'_>) -> f64 {
        let (width, height) = (image.width(), image.height());
        if width < 3 || height < 3 {
            return 0.0;
        }
        self.histogram.clear();
        self.histogram.resize(MOST + 1, 0);
        self.responses.clear();
        self.responses.resize(width - 2, 0);
        let step = (height / SAMPLED_ROWS).max(1);
        for y in (1..height - 1).step_by(step) {
            respond(image.row(y - 1), image.row(y), image.row(y + 1), &mut self.responses);
            for response in &self.responses {
                self.histogram[usize::from(response.unsigned_abs())] += 1;
            }
        }
        // The mask's gain on white noise is 6; half of a normal distribution lies within 0.6745 sigma.
        self.median() / (6.0 * 0.6745)
    }

    /// Median of the magnitudes, each whole level spread evenly over ± half a level.
    fn median(&self) -> f64 {
        let half = 0.5 * f64::from(self.histogram.iter().sum::<u32>());
        let mut below = 0.0;
        for (value, &count) in self.histogram.iter().enumerate() {
            let count = f64::from(count);
            if below + count >= half && count > 0.0 {
                return (value as f64 - 0.5 + (half - below) / count).max(0.0);
            }
            below += count;
        }
        0.0
    }
}

/// Response of the mask along a row, from the second pixel on.
fn respond(above: &[u8], here: &[u8], below: &[u8], out: &mut [i16]) {
    let column = |x: usize| i16::from(above[x]) - 2 * i16::from(here[x]) + i16::from(below[x]);
    for (x, out) in out.iter_mut().enumerate() {
        *out = column(x) - 2 * column(x + 1) + column(x + 2);
    }
}
