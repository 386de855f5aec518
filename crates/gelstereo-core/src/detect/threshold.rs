//! How much darker than its surround a pixel of a marker is: a setting, or half the markers' contrast around it.

use super::blocks::{BLOCK_PX, Blocks, BoxSums};
use super::blur::FRACTION_BITS;
use alloc::vec::Vec;

/// Least threshold that is ever derived, grey levels: below, the camera's rounding and compression show.
pub const LEAST_LEVELS: u8 = 3;

/// Of the contrast between a marker's darkest pixel and its surround. The surround is the mean of gel and markers, so
/// that this is somewhat more than half way from the gel to the marker.
const SHARE: f64 = 0.45;

/// The contrast around a block counts as at least this share of the whole image's.
const LEAST_SHARE_OF_IMAGE: f64 = 0.6;

/// Below this share of the whole image's contrast no marker is near: what is seen there is grain and light. The surround
/// is then all gel, and a marker that stood there alone would show with the whole image's contrast.
const NO_MARKER: f64 = 0.35;

/// Share of the whole image's contrast that is asked for where no marker is near.
const SHARE_ALONE: f64 = 0.6;

/// Standard deviations of the smoothed image's noise: one pixel in 3 million of a blank image.
const NOISE_SIGMAS: f64 = 5.0;

/// How far beyond the surround's square contrasts are averaged, blocks on each side.
const WIDER_BLOCKS: usize = 2;

/// Fractional bits of contrasts: their cubes leave room for 2^30 blocks in 64 bits.
const DEPTH_BITS: u32 = 3;

/// The threshold of every block.
#[derive(Clone, Debug, Default)]
pub struct Thresholds {
    /// With [`FRACTION_BITS`].
    levels: Vec<u16>,
    cols: usize,
    feels_noise: bool,
    squares: Vec<u64>,
    cubes: Vec<u64>,
    square_sums: BoxSums,
    cube_sums: BoxSums,
}

impl Thresholds {
    /// The same for all blocks of an image.
    pub fn set_all(&mut self, levels: u8, width: usize, height: usize) {
        self.cols = width.div_ceil(BLOCK_PX);
        self.feels_noise = false;
        self.levels.clear();
        self.levels.resize(self.cols * height.div_ceil(BLOCK_PX), u16::from(levels) << FRACTION_BITS);
    }

    /// From the contrasts of an image whose surrounds are means over `radius` blocks, and from its noise after
    /// smoothing.
    ///
    /// The markers' contrast near a block is the mean of the blocks' depths, each weighted by its square: blocks
    /// without a marker have depths of a few times the noise and carry no weight beside the others.
    pub fn derive(&mut self, blocks: &Blocks, radius: usize, noise_levels: f64) {
        let unit = f64::from(1_u32 << DEPTH_BITS);
        self.cols = blocks.cols();
        self.squares.clear();
        self.squares.extend(blocks.depths(DEPTH_BITS).map(|d| d * d));
        self.cubes.clear();
        self.cubes.extend(blocks.depths(DEPTH_BITS).map(|d| d * d * d));
        // As signed numbers, which processors turn into floating point at once; sums stay far below 2^63.
        let mean = |cubes: u64, squares: u64| cubes as i64 as f64 / (squares.max(1) as i64 as f64 * unit);
        let whole = mean(self.cubes.iter().sum(), self.squares.iter().sum());
        let near = radius + WIDER_BLOCKS;
        let squares = self.square_sums.run(&self.squares, self.cols, near);
        let cubes = self.cube_sums.run(&self.cubes, self.cols, near);
        let floor = (NOISE_SIGMAS * noise_levels).max(f64::from(LEAST_LEVELS));
        self.feels_noise = floor > SHARE * LEAST_SHARE_OF_IMAGE * whole;
        self.levels.clear();
        self.levels.extend(squares.iter().zip(cubes).map(|(&squares, &cubes)| {
            let near = mean(cubes, squares);
            let levels = if near < NO_MARKER * whole {
                SHARE_ALONE * whole
            } else {
                SHARE * near.max(LEAST_SHARE_OF_IMAGE * whole)
            };
            (levels.max(floor) * f64::from(1_u32 << FRACTION_BITS)) as u16
        }));
    }

    /// Whether noise may raise some thresholds above what the markers' contrast asks for.
    #[must_use]
    pub const fn feels_noise(&self) -> bool {
        self.feels_noise
    }

    /// Thresholds of all blocks, row by row, with [`FRACTION_BITS`].
    #[must_use]
    pub fn levels(&self) -> &[u16] {
        &self.levels
    }

    /// Thresholds of the blocks of pixel row `y`, with [`FRACTION_BITS`].
    #[must_use]
    pub fn row(&self, y: usize) -> &[u16] {
        &self.levels[y / BLOCK_PX * self.cols..][..self.cols]
    }
}
