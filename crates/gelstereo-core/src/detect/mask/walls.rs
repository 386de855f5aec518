//! Marker contrast beside something that is not gel: a tray's wall, a frame, a light's reflection.
//!
//! A mean over gel and tray is the level of neither, and a wall's depth below it is not a marker's
//! contrast. A marker has gel on two opposite sides in every direction; a wall has it on one side, or
//! along itself only.

use super::blocks::Blocks;
use super::blur::FRACTION_BITS;
use alloc::vec::Vec;

/// Blocks belong to the same gel, or to a marker on it, if their means differ by less than this share of
/// the contrast.
const SAME_GEL: f64 = 1.25;

/// Least share of the surrounding blocks that must belong to the same gel, beside a wall.
const MIN_SAME: f64 = 0.4;

/// Mean level of a block, grey levels, above which it is a reflection and not gel. Reflections saturate
/// at 255; one value was tried.
pub(super) const BRIGHTEST_GEL: u16 = 230;

/// Half of the directions to opposite blocks.
const DIRECTIONS: [(isize, usize); 4] = [(1, 0), (0, 1), (1, 1), (-1, 1)];

/// The gel's level at every block, estimated from opposite blocks, with [`FRACTION_BITS`].
#[derive(Clone, Debug, Default)]
pub(in crate::detect) struct Walls {
    gel: Vec<u16>,
    /// The same in one direction.
    sides: Vec<u16>,
}

impl Walls {
    /// Reserves memory for this many blocks.
    pub fn reserve(&mut self, blocks: usize) {
        for levels in [&mut self.gel, &mut self.sides] {
            levels.clear();
            levels.reserve(blocks);
        }
    }

    /// Estimates the gel's level of an image whose backgrounds are means over `radius` blocks.
    pub fn look(&mut self, blocks: &Blocks, radius: usize) {
        let (Self { gel, sides }, means) = (self, blocks.means());
        gel.clear();
        gel.resize(means.len(), u16::MAX);
        for (dx, dy) in DIRECTIONS {
            sides.clear();
            sides.resize(means.len(), 0);
            for away in 1..=radius {
                brighten(means, blocks.cols(), (dx * away as isize, dy * away), sides);
            }
            // Blocks on the border have no opposite ones in some directions.
            let known = sides.iter().map(|&level| if level > 0 { level } else { u16::MAX });
            gel.iter_mut().zip(known).for_each(|(gel, level)| *gel = level.min(*gel));
        }
        // Blocks in the corners have none at all.
        gel.iter_mut().filter(|level| **level == u16::MAX).for_each(|level| *level = 0);
    }

    /// Contrast of each block's darkest pixel to the gel on all its sides, in 1 / 2^`bits` grey levels.
    pub fn depths(&self, blocks: &Blocks, bits: u32) -> impl Iterator<Item = u16> {
        self.gel.iter().zip(blocks.darkest()).map(move |(&gel, &darkest)| {
            gel.saturating_sub(u16::from(darkest) << FRACTION_BITS) >> (FRACTION_BITS - bits)
        })
    }

    /// Mean over the blocks within `radius` of one, in rows of `cols`, that belong to the same gel, given
    /// the markers' contrast there in grey levels. `None` if too few do or if it is a reflection.
    pub fn background(
        &self,
        means: &[u16],
        block: usize,
        cols: usize,
        radius: usize,
        contrast: f64,
    ) -> Option<u16> {
        let (x, y) = (block % cols, block / cols);
        let level = self.gel[block].max(means[block]);
        let max = (SAME_GEL * contrast * f64::from(1_u32 << FRACTION_BITS)) as u16;
        let (columns, rows) =
            (x.saturating_sub(radius)..(x + radius + 1).min(cols), y.saturating_sub(radius));
        let (mut sum, mut count) = (0_u32, 0_u32);
        for row in means.chunks_exact(cols).take(y + radius + 1).skip(rows) {
            for &mean in row[columns.clone()].iter().filter(|mean| mean.abs_diff(level) <= max) {
                sum += u32::from(mean);
                count += 1;
            }
        }
        let all = (2 * radius as u32 + 1).pow(2);
        let mean = ((sum + count / 2) / count.max(1)) as u16;
        let is_gel = f64::from(count) >= MIN_SAME * f64::from(all) && mean < BRIGHTEST_GEL << FRACTION_BITS;
        is_gel.then_some(mean)
    }
}

/// Raises `sides` to the darker of the two opposite blocks at offset ±(`dx`, `dy`).
fn brighten(means: &[u16], cols: usize, (dx, dy): (isize, usize), sides: &mut [u16]) {
    let (rows, wide) = (means.len() / cols.max(1), dx.unsigned_abs());
    if cols <= 2 * wide || rows <= 2 * dy {
        return;
    }
    let inner = cols - 2 * wide;
    // First column read in the row above, and in the row below: opposite sides of the first inner column.
    let (before, behind) = if dx < 0 { (2 * wide, 0) } else { (0, 2 * wide) };
    for y in dy..rows - dy {
        let above = &means[(y - dy) * cols + before..][..inner];
        let below = &means[(y + dy) * cols + behind..][..inner];
        let sides = &mut sides[y * cols + wide..][..inner];
        for ((level, &a), &b) in sides.iter_mut().zip(above).zip(below) {
            *level = a.min(b).max(*level);
        }
    }
}
