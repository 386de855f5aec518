//! JPEG compression.

use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use gelstereo_core::math::{cos, round};

/// Encodes and decodes each image with a baseline JPEG codec, as cameras with MJPEG do. Blocks of 8 by 8
/// pixels are transformed to cosines (ITU-T T.81, A.3). Their coefficients are rounded to multiples of the
/// standard luminance table (K.1) at the codec's quality. The entropy coding that follows in a real file is
/// lossless and omitted.
///
/// This is the last effect on the image: the other effects' bounds apply to the levels before it.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Jpeg {
    /// Quality on the scale of the Independent JPEG Group, 1 to 100. Default: `90`.
    pub quality: u8,
}

impl Default for Jpeg {
    fn default() -> Self {
        Self { quality: 90 }
    }
}

const SIDE: usize = 8;

type Block = [[i32; SIDE]; SIDE];

/// Table K.1 of T.81.
const LUMINANCE: Block = [
    [16, 11, 10, 16, 24, 40, 51, 61],
    [12, 12, 14, 19, 26, 58, 60, 55],
    [14, 13, 16, 24, 40, 57, 69, 56],
    [14, 17, 22, 29, 51, 87, 80, 62],
    [18, 22, 37, 56, 68, 109, 103, 77],
    [24, 35, 55, 64, 81, 104, 113, 92],
    [49, 64, 78, 87, 103, 121, 120, 101],
    [72, 92, 95, 98, 112, 100, 103, 99],
];

impl Jpeg {
    fn table(&self) -> Block {
        let quality = i32::from(self.quality);
        let percent = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
        LUMINANCE.map(|row| row.map(|step| ((step * percent + 50) / 100).clamp(1, 255)))
    }
}

impl Effect for Jpeg {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let quality = self.quality;
        let name = "effects.jpeg.quality";
        SceneError::check((1..=100).contains(&quality), name, f64::from(quality), "1 to 100")
    }

    fn bound(&self, _facts: &Facts<'_>) -> Bound {
        // Every coefficient is off by up to half a step, and all errors can add up in one pixel. The
        // root of 8 is the factor of the constant coefficient. Two more levels for rounding in and after
        // the transforms.
        let share = |k: usize| if k == 0 { 1.0 / (2.0 * core::f64::consts::SQRT_2) } else { 0.5 };
        let steps = self.table().into_iter().enumerate().flat_map(|(v, row)| {
            row.into_iter().enumerate().map(move |(u, step)| share(u) * share(v) * 0.5 * f64::from(step))
        });
        Bound::of_levels((steps.sum::<f64>() + 2.0).min(255.0))
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        35.0 * facts.pixels()
    }
}

/// Fractional bits of the cosines, and of the values between the two passes of a transform.
const BITS: u32 = 13;
const PASS_BITS: u32 = 4;

/// A codec with precomputed tables.
#[derive(Clone, Debug)]
pub(crate) struct Codec {
    table: Block,
    /// Row u holds c(u) / 2 cos((2 x + 1) u π / 16), in units of 2^-BITS.
    cosines: Block,
}

impl Codec {
    pub(crate) fn new(jpeg: &Jpeg) -> Self {
        let cosine = |u: usize, x: usize| {
            let scale = if u == 0 { core::f64::consts::FRAC_1_SQRT_2 } else { 1.0 };
            let angle = ((2 * x + 1) * u) as f64 * core::f64::consts::PI / 16.0;
            round(0.5 * scale * cos(angle) * f64::from(1 << BITS)) as i32
        };
        Self {
            table: jpeg.table(),
            cosines: core::array::from_fn(|u| core::array::from_fn(|x| cosine(u, x))),
        }
    }

    /// Encodes and decodes an image in place. Blocks that extend beyond it are padded with its last
    /// pixels.
    pub(crate) fn pass(&self, image: &mut [u8], width: usize) {
        let height = image.len() / width;
        for top in (0..height).step_by(SIDE) {
            for left in (0..width).step_by(SIDE) {
                let at = |x: usize, y: usize| (top + y).min(height - 1) * width + (left + x).min(width - 1);
                let block =
                    core::array::from_fn(|y| core::array::from_fn(|x| i32::from(image[at(x, y)]) - 128));
                let block = self.backward(self.quantised(self.forward(block)));
                for (y, row) in block.iter().enumerate().take(height - top) {
                    for (x, &level) in row.iter().enumerate().take(width - left) {
                        image[at(x, y)] = (level + 128).clamp(0, 255) as u8;
                    }
                }
            }
        }
    }

    /// Coefficients in units of 2^-PASS_BITS.
    fn forward(&self, block: Block) -> Block {
        let rows = product(&block, &transposed(&self.cosines), BITS - PASS_BITS);
        product(&self.cosines, &rows, BITS)
    }

    fn quantised(&self, mut amplitudes: Block) -> Block {
        for (row, steps) in amplitudes.iter_mut().zip(&self.table) {
            for (amplitude, step) in row.iter_mut().zip(steps) {
                // To the nearest multiple, halves away from zero.
                let step_units = step << PASS_BITS;
                let whole = (amplitude.abs() + step_units / 2) / step_units;
                *amplitude = amplitude.signum() * whole * step;
            }
        }
        amplitudes
    }

    fn backward(&self, amplitudes: Block) -> Block {
        let columns = product(&transposed(&self.cosines), &amplitudes, BITS - PASS_BITS);
        product(&columns, &self.cosines, BITS + PASS_BITS)
    }
}

fn transposed(block: &Block) -> Block {
    core::array::from_fn(|y| core::array::from_fn(|x| block[x][y]))
}

/// Matrix product, shifted and rounded. Coefficients are below 2^12 with 4 fractional bits, and cosines
/// below 2^12: eight products stay below 2^31.
fn product(a: &Block, b: &Block, shift: u32) -> Block {
    let mut sums = [[1 << (shift - 1); SIDE]; SIDE];
    for (sums, factors) in sums.iter_mut().zip(a) {
        for (factor, row) in factors.iter().zip(b) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += factor * value;
            }
        }
        sums.iter_mut().for_each(|sum| *sum >>= shift);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// T.81, A.3.3, in floating point, term by term.
    fn amplitudes(block: &Block) -> [[f64; SIDE]; SIDE] {
        let angle = |x: usize, u: usize| cos(((2 * x + 1) * u) as f64 * core::f64::consts::PI / 16.0);
        let scale = |u: usize| if u == 0 { core::f64::consts::FRAC_1_SQRT_2 } else { 1.0 };
        core::array::from_fn(|v| {
            core::array::from_fn(|u| {
                let terms = (0..SIDE * SIDE)
                    .map(|i| f64::from(block[i / SIDE][i % SIDE]) * angle(i % SIDE, u) * angle(i / SIDE, v));
                0.25 * scale(u) * scale(v) * terms.sum::<f64>()
            })
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn transforms_are_the_standards(
            levels in prop::array::uniform8(prop::array::uniform8(-128..128_i32)),
        ) {
            let codec = Codec::new(&Jpeg { quality: 100 });
            let found = codec.forward(levels);
            for (found, expected) in found.iter().flatten().zip(amplitudes(&levels).iter().flatten()) {
                // Cosines are off by 2^-14. Over 64 pixels of 128 levels that is at most half a level,
                // typically a tenth.
                let found = f64::from(*found) / f64::from(1 << PASS_BITS);
                prop_assert!((found - expected).abs() < 0.5, "{found} for {expected}");
            }
        }

        #[test]
        fn no_pixel_is_farther_off_than_the_bound(
            seed in prop::collection::vec(any::<u8>(), 13 * 11), quality in 1..=100_u8,
        ) {
            let jpeg = Jpeg { quality };
            let mut image = seed.clone();
            Codec::new(&jpeg).pass(&mut image, 13);
            let scene = crate::Scene::default();
            let bound = jpeg.bound(&Facts::of(&scene, &[])).levels;
            let off = image.iter().zip(&seed).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0);
            prop_assert!(f64::from(off) <= bound);
            // Uniform images are off by half the constant coefficient's step at most (an eighth of that
            // per pixel), and by rounding.
            let mut even = alloc::vec![seed[0]; 64];
            Codec::new(&jpeg).pass(&mut even, 8);
            let step = f64::from(jpeg.table()[0][0]) / 16.0 + 1.0;
            prop_assert!(even.iter().all(|&level| f64::from(level.abs_diff(seed[0])) <= step));
        }
    }
}
