//! Threshold for the difference to the background: a setting, or about half the local marker contrast.

use super::blocks::{BLOCK_PX, Blocks, BoxSums};
use super::blur::FRACTION_BITS;
use super::walls::Walls;
use alloc::vec::Vec;

/// Least derived threshold, grey levels; below it, camera rounding and compression become visible.
pub const MIN_LEVELS: u8 = 3;

/// Threshold as a share of the contrast between a marker's darkest pixel and the background. The background
/// is the mean of gel and markers, so this is somewhat more than half way from the gel to the marker.
pub(super) const SHARE: f64 = 0.45;

/// Least contrast around a block, as a share of the whole image's.
const MIN_SHARE_OF_IMAGE: f64 = 0.6;

/// Below this share of the whole image's contrast no marker is near; the contrast is grain and light. The
/// background is then gel only, and a single marker there would have the whole image's contrast.
const NO_MARKER: f64 = 0.35;

/// Threshold where no marker is near, as a share of the whole image's contrast.
const SHARE_ALONE: f64 = 0.6;

/// In standard deviations of the smoothed image's noise: one false pixel in 3 million of a blank image.
const NOISE_SIGMAS: f64 = 5.0;

/// Margin around the background's square over which contrasts are averaged, blocks on each side.
const WIDER_BLOCKS: usize = 2;

/// If the backgrounds span less than this multiple of the whole image's contrast, no wall hides markers.
/// With a wall in view, the whole image's contrast is up to 0.7 of its height.
const UNEVEN: f64 = 1.2;

/// The same holds below this multiple of the markers' contrast. Beside a wall, the background lacks half
/// the wall's height, which leaves half the markers' contrast. (Simulated trays, contrasts of 25 to 110
/// levels: all markers are found up to 1.9; from 2.6 on 0.5 to 100 % are missed.)
const WALL: f64 = 2.0;

/// Contrasts beyond this multiple of the contrast of spots with gel on two opposite sides are not the
/// markers'.
const NOT_MARKERS: f64 = 1.5;

/// A background that lacks this share of the markers' contrast contains something darker than gel and
/// markers.
const MISSING: f64 = 0.15;

/// Fractional bits of contrasts: their cubes leave room for 2^30 blocks in 64 bits.
const DEPTH_BITS: u32 = 3;

/// Contrasts (depths) of an image's blocks, from which the markers' contrast follows.
#[derive(Clone, Debug, Default)]
struct Contrasts {
    depths: Vec<u16>,
    square_sums: BoxSums,
    cube_sums: BoxSums,
}

impl Contrasts {
    /// Stores the depths of all blocks with [`DEPTH_BITS`] and returns the contrast of the whole image.
    fn take(&mut self, depths: impl Iterator<Item = u16>) -> f64 {
        self.depths.clear();
        self.depths.extend(depths);
        contrast(self.depths.iter().copied())
    }

    /// Contrast around each block.
    fn around(&mut self, cols: usize, radius: usize) -> impl Iterator<Item = f64> {
        let squares = self.square_sums.run(&self.depths, square, cols, radius);
        let cubes = self.cube_sums.run(&self.depths, cube, cols, radius);
        squares.iter().zip(cubes).map(|(&squares, &cubes)| mean(cubes, squares))
    }
}

fn square(depth: u16) -> u64 {
    u64::from(depth).pow(2)
}

fn cube(depth: u16) -> u64 {
    u64::from(depth).pow(3)
}

/// Contrast of blocks with these depths, which have [`DEPTH_BITS`].
fn contrast(depths: impl Iterator<Item = u16>) -> f64 {
    let (squares, cubes) = depths.fold((0, 0), |(squares, cubes), d| (squares + square(d), cubes + cube(d)));
    mean(cubes, squares)
}

/// Mean of depths, each weighted by its square. Signed, since processors convert those to floating point
/// directly; sums stay far below 2^63.
fn mean(cubes: u64, squares: u64) -> f64 {
    cubes as i64 as f64 / (squares.max(1) as i64 as f64 * f64::from(1_u32 << DEPTH_BITS))
}

/// Threshold of every block.
#[derive(Clone, Debug, Default)]
pub struct Thresholds {
    /// With [`FRACTION_BITS`].
    levels: Vec<u16>,
    cols: usize,
    feels_noise: bool,
    /// Least threshold, grey levels.
    floor_levels: f64,
    contrasts: Contrasts,
    walls: Walls,
    /// Contrasts around the blocks, walls included.
    near: Vec<f64>,
}

impl Thresholds {
    /// Sums that are free before an image's thresholds are derived.
    pub(super) fn scratch(&mut self) -> &mut BoxSums {
        &mut self.contrasts.square_sums
    }

    /// Sets the same threshold for all blocks of an image.
    pub fn set_all(&mut self, levels: u8, width: usize, height: usize) {
        self.cols = width.div_ceil(BLOCK_PX);
        self.feels_noise = false;
        self.levels.clear();
        self.levels.resize(self.cols * height.div_ceil(BLOCK_PX), u16::from(levels) << FRACTION_BITS);
    }

    /// Derives the thresholds from the image's contrasts and its noise after smoothing. Backgrounds are
    /// means over `radius` blocks; those that include something other than gel and markers are corrected.
    ///
    /// The markers' contrast near a block is the mean of the blocks' depths, each weighted by its square.
    /// Blocks without a marker have depths of a few times the noise, so their weight is negligible.
    pub fn derive(&mut self, blocks: &mut Blocks, radius: usize, noise_levels: f64) {
        self.cols = blocks.cols();
        self.near.clear();
        self.near.reserve(blocks.means().len());
        self.walls.reserve(blocks.means().len());
        let floor = (NOISE_SIGMAS * noise_levels).max(f64::from(MIN_LEVELS));
        self.floor_levels = floor;
        let whole = self.contrasts.take(blocks.depths(DEPTH_BITS));
        if self.hides_markers(blocks, radius, whole) {
            self.derive_beside_walls(blocks, radius, whole, floor);
            return;
        }
        self.feels_noise = floor > SHARE * MIN_SHARE_OF_IMAGE * whole;
        self.levels.clear();
        let near = self.contrasts.around(self.cols, radius + WIDER_BLOCKS);
        self.levels.extend(near.map(|near| threshold(near, whole, floor)));
    }

    /// Whether an image of this contrast may have walls that hide the markers beside them.
    fn hides_markers(&mut self, blocks: &Blocks, radius: usize, whole: f64) -> bool {
        let span = span_levels(blocks.background());
        radius > 0 && span > UNEVEN * whole && {
            self.walls.look(blocks, radius);
            span > WALL * contrast(self.walls.depths(blocks, DEPTH_BITS))
        }
    }

    /// As [`Self::derive`], where some contrasts may be those of walls.
    fn derive_beside_walls(&mut self, blocks: &mut Blocks, radius: usize, with_walls: f64, floor: f64) {
        let Self { cols, walls, contrasts, near, .. } = self;
        near.extend(contrasts.around(*cols, radius + WIDER_BLOCKS));
        let spots = contrasts.take(walls.depths(blocks, DEPTH_BITS));
        let whole = if with_walls > NOT_MARKERS * spots { spots } else { with_walls };
        self.feels_noise = floor > SHARE * MIN_SHARE_OF_IMAGE * whole;
        self.levels.clear();
        let unit = f64::from(1_u32 << FRACTION_BITS);
        let spots = contrasts.around(*cols, radius + WIDER_BLOCKS);
        let (means, background) = blocks.means_and_background_mut();
        let backgrounds = background.iter_mut().enumerate();
        for ((block, background), (&near, spots)) in backgrounds.zip(near.iter().zip(spots)) {
            let (contrast, is_wall) = (spots.max(MIN_SHARE_OF_IMAGE * whole), near > NOT_MARKERS * spots);
            let min = f64::from(*background) + if is_wall { 0.0 } else { MISSING * contrast * unit };
            let gel = walls.background(means, block, *cols, radius, contrast);
            self.levels.push(match gel.filter(|&gel| f64::from(gel) >= min) {
                Some(gel) => {
                    *background = gel;
                    threshold(spots, whole, floor)
                }
                // No better background is known: keep the threshold from all contrasts, walls included.
                None if is_wall => threshold(near, with_walls, floor),
                None => threshold(near, whole, floor),
            });
        }
    }

    /// Whether noise may raise some thresholds above those by the markers' contrast.
    #[must_use]
    pub const fn feels_noise(&self) -> bool {
        self.feels_noise
    }

    /// Least threshold derived, grey levels.
    #[must_use]
    pub const fn floor_levels(&self) -> f64 {
        self.floor_levels
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

/// Range from the darkest to the brightest background, grey levels.
fn span_levels(background: &[u16]) -> f64 {
    let (low, high) =
        background.iter().fold((u16::MAX, 0), |(low, high), &level| (low.min(level), high.max(level)));
    f64::from(high.saturating_sub(low)) / f64::from(1_u32 << FRACTION_BITS)
}

/// Threshold with [`FRACTION_BITS`], from the contrast near a block, the whole image's contrast and the
/// noise floor.
fn threshold(near: f64, whole: f64, floor: f64) -> u16 {
    let levels = if near < NO_MARKER * whole {
        SHARE_ALONE * whole
    } else {
        SHARE * near.max(MIN_SHARE_OF_IMAGE * whole)
    };
    (levels.max(floor) * f64::from(1_u32 << FRACTION_BITS)) as u16
}
