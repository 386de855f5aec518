//! Marker pixels beside reflections, which the mean background does not show.
//!
//! A reflection adds light to gel and markers. Where it ends, the mean of its surroundings is the level of
//! neither, and a marker inside may be brighter than that mean. The gel's level is therefore taken from the
//! closing of the image there: the least brightness that some square without a marker has (Serra 1982).

use super::blocks::{BLOCK_PX, Blocks};
use super::blur::FRACTION_BITS;
use super::walls::BRIGHTEST_GEL;
use alloc::vec::Vec;

/// Side of the closing's square as a share of the background's kernel: wider than a marker and narrower
/// than a reflection. The kernel spans about three pitches.
const SQUARE: usize = 3;

/// Threshold as a share of the deepest contrast in the blocks around.
const SHARE: f64 = 0.45;

/// Levels below which pixels beside a reflection belong to a marker.
#[derive(Clone, Debug)]
pub(super) struct Reflections {
    side_px: usize,
    /// Whether a reflection is in this block or beside it.
    beside: Vec<bool>,
    /// Closing of the image, in the rows around the reflections.
    closed: Vec<u8>,
    /// First row of these.
    first: usize,
    /// Deepest contrast of each block beside a reflection.
    depths: Vec<u8>,
    cols: usize,
}

impl Reflections {
    /// For a background's kernel of this side.
    pub const fn new(kernel_px: usize) -> Self {
        Self {
            side_px: (kernel_px / SQUARE) | 1,
            beside: Vec::new(),
            closed: Vec::new(),
            first: 0,
            depths: Vec::new(),
            cols: 0,
        }
    }

    /// Finds the reflections in an image that was smoothed to these levels. Does not allocate if an earlier
    /// image was as large.
    pub fn look(&mut self, smoothed: &[u8], width: usize, blocks: &Blocks) {
        let means = blocks.means();
        self.cols = blocks.cols();
        self.beside.clear();
        self.beside.resize(means.len(), false);
        self.depths.clear();
        self.depths.resize(means.len(), 0);
        self.closed.clear();
        self.closed.reserve(smoothed.len());
        let is_bright = |block: &usize| means[*block] >= BRIGHTEST_GEL << FRACTION_BITS;
        for block in (0..means.len()).filter(is_bright) {
            neighbours(block, self.cols, means.len()).for_each(|other| self.beside[other] = true);
        }
        let is_beside = |&is: &bool| is;
        let (Some(top), Some(bottom)) =
            (self.beside.iter().position(is_beside), self.beside.iter().rposition(is_beside))
        else {
            return;
        };
        // Squares that contain a pixel of these blocks.
        let height = smoothed.len() / width;
        self.first = (top / self.cols * BLOCK_PX).saturating_sub(self.side_px);
        let end = ((bottom / self.cols + 1) * BLOCK_PX + self.side_px).min(height);
        let levels = &smoothed[self.first * width..end * width];
        self.closed.extend_from_slice(levels);
        close(&mut self.closed, width, self.side_px);
        self.find_depths(levels, width);
    }

    /// Deepest contrasts of the blocks in the rows of the closing, whose levels are these.
    fn find_depths(&mut self, levels: &[u8], width: usize) {
        let rows = self.closed.chunks_exact(width).zip(levels.chunks_exact(width));
        for (y, (closed, levels)) in (self.first..).zip(rows) {
            let depths = &mut self.depths[y / BLOCK_PX * self.cols..][..self.cols];
            let blocks = closed.chunks(BLOCK_PX).zip(levels.chunks(BLOCK_PX));
            for (depth, (closed, levels)) in depths.iter_mut().zip(blocks) {
                let pixels = closed.iter().zip(levels);
                *depth = pixels.fold(*depth, |depth, (gel, level)| depth.max(gel.saturating_sub(*level)));
            }
        }
    }

    /// Whether a reflection is near a row of pixels.
    pub fn are_in_row(&self, y: usize) -> bool {
        let row = y / BLOCK_PX * self.cols;
        self.beside.get(row..row + self.cols).is_some_and(|blocks| blocks.contains(&true))
    }

    /// Replaces the limits of a row where gel beside reflections is brighter than its block's background.
    /// Pixels below them belong to markers. The least difference is `floor`, grey levels.
    pub fn limit(&self, y: usize, width: usize, background: &[u16], floor: f64, below: &mut [u8]) {
        let row = y / BLOCK_PX * self.cols;
        for block in (row..row + self.cols).filter(|&block| self.beside[block]) {
            let deepest = neighbours(block, self.cols, self.beside.len()).map(|one| self.depths[one]).max();
            let min = (SHARE * f64::from(deepest.unwrap_or(0))).max(floor) as u8;
            let columns = (block - row) * BLOCK_PX..((block - row + 1) * BLOCK_PX).min(width);
            let gel = &self.closed[(y - self.first) * width..][columns.clone()];
            let brighter = |gel: u8| u16::from(gel) << FRACTION_BITS > background[block - row];
            for (below, &gel) in below[columns].iter_mut().zip(gel).filter(|&(_, &gel)| brighter(gel)) {
                *below = gel.saturating_sub(min);
            }
        }
    }
}

/// A block and those around it.
fn neighbours(block: usize, cols: usize, count: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (block % cols, block / cols);
    let rows = y.saturating_sub(1)..(y + 2).min(count / cols);
    rows.flat_map(move |y| (x.saturating_sub(1)..(x + 2).min(cols)).map(move |x| y * cols + x))
}

/// Closing by a square, in place. Squares that leave the image are left out; an image that holds none stays.
fn close(levels: &mut [u8], width: usize, side_px: usize) {
    if side_px > width.min(levels.len() / width) {
        return;
    }
    // The brightest level of the square that begins at a pixel, then the least of all squares with it.
    ahead(levels, width, side_px, u8::max);
    levels.reverse();
    ahead(levels, width, side_px, u8::min);
    levels.reverse();
}

/// Replaces each level by the extreme of the square that begins there; levels beyond the end count as 255.
fn ahead(levels: &mut [u8], width: usize, side_px: usize, extreme: impl Fn(u8, u8) -> u8 + Copy) {
    levels.chunks_exact_mut(width).for_each(|row| along(row, 1, side_px, extreme));
    along(levels, width, side_px, extreme);
}

/// The same for a line of `count` levels, `step` apart. Lines are doubled until they are as long.
fn along(levels: &mut [u8], step: usize, count: usize, extreme: impl Fn(u8, u8) -> u8) {
    let mut reached = 1;
    while reached < count {
        let more = reached.min(count - reached);
        let end = levels.len() - (more * step).min(levels.len());
        for at in 0..end {
            levels[at] = extreme(levels[at], levels[at + more * step]);
        }
        levels[end..].iter_mut().for_each(|level| *level = extreme(*level, u8::MAX));
        reached += more;
    }
}

#[cfg(test)]
mod tests {
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
            close(&mut closed, width, side);
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
        blocks.finish(3);
        let mut reflections = Reflections::new(51);
        reflections.look(&levels, width, &blocks);
        let marked = |y: usize| {
            let mut below = alloc::vec![0_u8; width];
            let background = &blocks.background()[y / BLOCK_PX * blocks.cols()..][..blocks.cols()];
            reflections.limit(y, width, background, 10.0, &mut below);
            let row = levels[y * width..][..width].iter().zip(below);
            row.enumerate().filter(|(_, (level, below))| **level < *below).map(|(x, _)| x).collect::<Vec<_>>()
        };
        assert!(reflections.are_in_row(46) && marked(46) == (44..50).collect::<Vec<_>>());
        assert!(marked(60).is_empty());
    }
}
