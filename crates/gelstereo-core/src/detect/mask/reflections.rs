//! Marker pixels beside reflections, which the mean background does not show.
//!
//! A reflection adds light to gel and markers. Where it ends, the mean of its surroundings is the level of
//! neither, and a marker inside may be brighter than that mean. The gel's level is therefore taken from the
//! closing of the image there: the least brightness that some square without a marker has (Serra 1982).

use super::blocks::{BLOCK_PX, Blocks};
use super::blur::FRACTION_BITS;
use super::threshold::SHARE;
use super::walls::BRIGHTEST_GEL;
use alloc::vec::Vec;

/// Side of the background's kernel over that of the closing's square, which must be wider than a marker. The
/// kernel spans about three pitches. Sides of 13, 15 and 17 px find as many markers under drawn smears.
const SQUARE: usize = 3;

/// Rows of blocks around one, itself included. Four at a time, with those beside them, would be closed in a
/// tenth less time of a whole frame, but then `fast` with 5041 markers takes more than 16 MB.
const AROUND: usize = 3;

/// Levels below which pixels beside a reflection belong to a marker, for a row of blocks at a time.
#[derive(Clone, Debug)]
pub(super) struct Reflections {
    side_px: usize,
    /// Closing of the image in the rows of this row of blocks and of those beside it, from row `first` on.
    closed: Vec<u8>,
    first: usize,
    /// Deepest contrast of these blocks.
    depths: Vec<u8>,
    /// Least differences in this row of blocks; `None` where no reflection is beside them.
    limits: Vec<Option<u8>>,
    /// A row of pixels.
    row: Vec<u8>,
    /// Pixels closed in this image, counted each time.
    closed_px: usize,
}

impl Reflections {
    /// For a background's kernel of this side.
    pub const fn new(kernel_px: usize) -> Self {
        let side_px = (kernel_px / SQUARE) | 1;
        Self {
            side_px,
            closed: Vec::new(),
            first: 0,
            depths: Vec::new(),
            limits: Vec::new(),
            row: Vec::new(),
            closed_px: 0,
        }
    }

    /// Pixels closed in the last image, counted each time.
    pub const fn closed_px(&self) -> usize {
        self.closed_px
    }

    /// Reserves what an image of this width needs.
    pub fn start(&mut self, width: usize) {
        self.closed.clear();
        self.closed.reserve((AROUND * BLOCK_PX + 2 * self.side_px) * width);
        self.depths.clear();
        self.depths.reserve(AROUND * width.div_ceil(BLOCK_PX));
        self.limits.clear();
        self.limits.reserve(width.div_ceil(BLOCK_PX));
        self.row.resize(width, 0);
        self.closed_px = 0;
    }

    /// Whether a block of the row of blocks that begins at row `y` of pixels, or one beside it, is in a
    /// reflection. Closes the image, which was smoothed to these levels, around that row if so. The least
    /// difference of markers is `floor`, grey levels.
    pub fn close_around(
        &mut self,
        y: usize,
        smoothed: &[u8],
        width: usize,
        blocks: &Blocks,
        floor: f64,
    ) -> bool {
        let (block, height, cols) = (y / BLOCK_PX, smoothed.len() / width, blocks.cols());
        let first_block = block.saturating_sub(1);
        let rows = first_block * BLOCK_PX..((block + 2) * BLOCK_PX).min(height);
        let means = &blocks.means()[first_block * cols..rows.end.div_ceil(BLOCK_PX) * cols];
        if !means.iter().any(is_bright) {
            return false;
        }
        // Squares that contain a pixel of these rows.
        self.first = rows.start.saturating_sub(self.side_px);
        let end = (rows.end + self.side_px).min(height);
        self.closed.clear();
        self.closed.extend_from_slice(&smoothed[self.first * width..end * width]);
        close(&mut self.closed, &mut self.row, self.side_px);
        self.closed_px += self.closed.len();
        self.depths.clear();
        self.depths.resize(rows.len().div_ceil(BLOCK_PX) * cols, 0);
        for y in rows {
            let closed = &self.closed[(y - self.first) * width..][..width];
            let depths = &mut self.depths[(y / BLOCK_PX - first_block) * cols..][..cols];
            let blocks = closed.chunks(BLOCK_PX).zip(smoothed[y * width..][..width].chunks(BLOCK_PX));
            for (depth, (closed, levels)) in depths.iter_mut().zip(blocks) {
                let pixels = closed.iter().zip(levels);
                *depth = pixels.fold(*depth, |depth, (gel, level)| depth.max(gel.saturating_sub(*level)));
            }
        }
        self.limits.clear();
        self.limits.extend((block * cols..(block + 1) * cols).map(|block| {
            let around = || neighbours(block, cols, blocks.means().len());
            let deepest = around().map(|block| self.depths[block - first_block * cols]).fold(0, u8::max);
            let is_near = around().any(|block| is_bright(&blocks.means()[block]));
            is_near.then(|| (SHARE * f64::from(deepest)).max(floor) as u8)
        }));
        true
    }

    /// Replaces the limits of a row, around which the image was closed, where gel beside reflections is
    /// brighter than its block's background. Pixels below them belong to markers.
    pub fn limit(&self, y: usize, width: usize, blocks: &Blocks, below: &mut [u8]) {
        let cols = blocks.cols();
        let backgrounds = &blocks.background()[y / BLOCK_PX * cols..][..cols];
        let limits = self.limits.iter().zip(backgrounds);
        for (column, (min, background)) in limits.enumerate() {
            let Some(min) = *min else { continue };
            let pixels = column * BLOCK_PX..((column + 1) * BLOCK_PX).min(width);
            let gel = &self.closed[(y - self.first) * width..][pixels.clone()];
            let is_brighter = |gel: u8| u16::from(gel) << FRACTION_BITS > *background;
            for (below, &gel) in below[pixels].iter_mut().zip(gel).filter(|&(_, &gel)| is_brighter(gel)) {
                *below = gel.saturating_sub(min);
            }
        }
    }
}

fn is_bright(mean: &u16) -> bool {
    *mean >= BRIGHTEST_GEL << FRACTION_BITS
}

/// A block and those around it.
fn neighbours(block: usize, cols: usize, count: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (block % cols, block / cols);
    let rows = y.saturating_sub(1)..(y + 2).min(count / cols);
    rows.flat_map(move |y| (x.saturating_sub(1)..(x + 2).min(cols)).map(move |x| y * cols + x))
}

/// Closing by a square, in place. Squares that leave the image are left out; an image that holds none stays.
/// `row` is scratch, as long as a row.
fn close(levels: &mut [u8], row: &mut [u8], side_px: usize) {
    if side_px > row.len().min(levels.len() / row.len()) {
        return;
    }
    // The brightest level of the square that begins at a pixel, then the least of all squares with it.
    ahead(levels, row, side_px, u8::max);
    levels.reverse();
    ahead(levels, row, side_px, u8::min);
    levels.reverse();
}

/// Replaces each level by the extreme of the square that begins there; levels beyond the end count as 255.
/// Lines are doubled until they are as long. Their two halves never share memory, so that whole vectors are
/// compared at once.
fn ahead(levels: &mut [u8], row: &mut [u8], side_px: usize, extreme: impl Fn(u8, u8) -> u8 + Copy) {
    let width = row.len();
    let mut reached = 1;
    while reached < side_px {
        let more = reached.min(side_px - reached);
        for levels in levels.chunks_exact_mut(width) {
            row.copy_from_slice(levels);
            join(levels, &row[more.min(width)..], extreme);
        }
        let height = levels.len() / width;
        for y in 0..height {
            let (levels, below) = levels[y * width..].split_at_mut(width);
            join(
                levels,
                below.get((more - 1) * width..).map_or(&[], |rows| &rows[..rows.len().min(width)]),
                extreme,
            );
        }
        reached += more;
    }
}

/// Extreme of each level and its other one, 255 where there is none.
fn join(levels: &mut [u8], others: &[u8], extreme: impl Fn(u8, u8) -> u8) {
    let (with, without) = levels.split_at_mut(others.len());
    with.iter_mut().zip(others).for_each(|(level, &other)| *level = extreme(*level, other));
    without.iter_mut().for_each(|level| *level = extreme(*level, u8::MAX));
}

#[cfg(test)]
mod tests {
    use super::super::blocks::BoxSums;
    use super::*;
    use proptest::prelude::*;

    /// By its definition: the least, over all squares with a pixel, of their brightest levels.
    fn closing(levels: &[u8], width: usize, side: usize) -> Vec<u8> {
        let height = levels.len() / width;
        let brightest = |x: usize, y: usize| {
            (y..y + side).flat_map(|y| &levels[y * width + x..][..side]).copied().max().unwrap()
        };
        let least = |x: usize, y: usize| {
            let rows = y.saturating_sub(side - 1)..=y.min(height - side);
            let columns = || x.saturating_sub(side - 1)..=x.min(width - side);
            rows.flat_map(|row| columns().map(move |column| (column, row)))
                .map(|(column, row)| brightest(column, row))
                .min()
                .unwrap()
        };
        (0..levels.len()).map(|at| least(at % width, at / width)).collect()
    }

    proptest! {
        #[test]
        fn the_closing_is_that_of_its_definition(
            side in 1_usize..8,
            width in 8_usize..20,
            levels in proptest::collection::vec(any::<u8>(), 160..400),
        ) {
            let levels = &levels[..levels.len() / width * width];
            let mut closed = levels.to_vec();
            close(&mut closed, &mut alloc::vec![0; width], side);
            prop_assert_eq!(closed, closing(levels, width, side));
        }
    }

    /// A marker in a reflection that is brighter than the gel outside it.
    #[test]
    fn a_marker_in_a_reflection_has_its_own_limit() {
        let (width, height) = (96, 96);
        let mut levels = alloc::vec![150_u8; width * height];
        levels.chunks_exact_mut(width).for_each(|row| row[32..64].fill(255));
        levels.chunks_exact_mut(width).skip(44).take(6).for_each(|row| row[44..50].fill(190));
        let mut blocks = Blocks::default();
        blocks.start(width, height);
        levels.chunks_exact(BLOCK_PX * width).for_each(|rows| blocks.push(rows));
        blocks.finish(3, &mut BoxSums::default());
        let mut reflections = Reflections::new(51);
        reflections.start(width);
        let mut marked = |y: usize| {
            assert!(reflections.close_around(y / BLOCK_PX * BLOCK_PX, &levels, width, &blocks, 10.0));
            let mut below = alloc::vec![0_u8; width];
            reflections.limit(y, width, &blocks, &mut below);
            let row = levels[y * width..][..width].iter().zip(below);
            row.enumerate().filter(|(_, (level, below))| **level < *below).map(|(x, _)| x).collect::<Vec<_>>()
        };
        assert_eq!(marked(46), (44..50).collect::<Vec<_>>());
        assert!(marked(60).is_empty());
    }
}
