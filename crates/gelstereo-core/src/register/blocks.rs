//! A template's points and normals in tree order, in small blocks for vectorised sums.

use crate::math::DVec3;
use crate::spatial::{KdTree, LEAF};
use alloc::vec::Vec;

/// Points processed together.
pub(super) const LANES: usize = 4;

// Each leaf's points start a new block.
const _: () = assert!(LEAF.is_multiple_of(LANES));

/// One number per point of a block.
pub(super) type Lanes = [f64; LANES];

/// Coordinate of an unused lane: farther than any point, and its square is finite.
const NOWHERE_MM: f64 = 1e100;

/// Neighbouring points and their normals, by coordinate.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    pub points_mm: [Lanes; 3],
    pub normals: [Lanes; 3],
}

/// Blocks of these points, in tree order; unused lanes of the last block are at [`NOWHERE_MM`].
pub(super) fn blocks(points_mm: &[DVec3], normals: &[DVec3], tree: &KdTree) -> Vec<Block> {
    let mut out = Vec::with_capacity(points_mm.len().div_ceil(LANES));
    let order: Vec<u32> = tree.indices().collect();
    for indices in order.chunks(LANES) {
        let mut block = Block { points_mm: [[NOWHERE_MM; LANES]; 3], normals: [[0.0; LANES]; 3] };
        for (lane, &index) in indices.iter().enumerate() {
            let (point, normal) = (points_mm[index as usize], normals[index as usize]);
            for axis in 0..3 {
                block.points_mm[axis][lane] = point[axis];
                block.normals[axis][lane] = normal[axis];
            }
        }
        out.push(block);
    }
    out
}
