//! Signed distances on a grid around the surface, for screening many poses.

use super::Solid;
use crate::digest::Digest;
use crate::math::{DVec3, ceil, round};
use crate::stop::{NEVER, Stop, Stopped, ask};
use alloc::vec::Vec;

/// Cells along a block's side.
const CELLS: usize = 8;
/// Nodes along a block's side. Adjacent blocks both store their shared nodes, so that a query reads one
/// block.
const NODES: usize = CELLS + 1;
const BLOCK: usize = NODES * NODES * NODES;
/// Index span from the first to the last of a cell's eight nodes.
const SPAN: usize = NODES * NODES + NODES + 2;
/// No block: the surface is out of reach.
const NONE: u32 = u32::MAX;
/// Node out of reach, or beside a hole, where the sign changes away from the surface.
const UNKNOWN: i16 = i16::MIN;
/// Largest number of blocks in the box around the part.
const MAX_PLACES: f64 = 131_072.0;
/// Largest number of nodes; building that many takes about a second.
const MAX_NODES: usize = 2_000_000;
/// Factor by which cells are enlarged when there are too many.
const WIDER: f64 = 1.125;

/// Signed distances at grid nodes within reach of a surface, with trilinear interpolation. A query takes
/// 37 ns; [`Solid::closest_from`] takes 300 ns or more (example `nearest`).
///
/// A distance field has slope at most 1, so the interpolation error is at most √3/2 = 0.87 of
/// [`Self::cell_mm`]. That occurs only at sharp edges. Over a face the value is exact up to rounding to
/// 16 bits; around a surface of radius R the error is h² / 4R. Where signs jump, as between sheets that
/// are not closed, the value can be too close to zero by up to 2.24 cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    low_mm: DVec3,
    cell_mm: f64,
    reach_mm: f64,
    /// Millimetres per unit of a value.
    step_mm: f64,
    /// Gradient of one unit of difference across a cell.
    slope: f64,
    /// 1 / the width of a cell.
    per_cell: f64,
    /// Blocks along x, y and z.
    sides: [usize; 3],
    /// Cells along x, y and z.
    cells: DVec3,
    /// First value of each block, in blocks, or [`NONE`]; x runs fastest.
    block_at: Vec<u32>,
    values: Vec<i16>,
}

impl Field {
    /// The field of a surface, with cells of `cell_mm`, enlarged if needed for at most two million nodes.
    /// The reach is at least two such cells.
    ///
    /// `None` unless width and reach are positive, and the reach is 2 to 1000 cells.
    #[must_use]
    pub fn new(solid: &Solid, cell_mm: f64, reach_mm: f64) -> Option<Self> {
        Self::new_unless(solid, cell_mm, reach_mm, NEVER).ok().flatten()
    }

    /// As [`Self::new`], unless it is stopped.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn new_unless(
        solid: &Solid,
        cell_mm: f64,
        reach_mm: f64,
        stop: Stop<'_>,
    ) -> Result<Option<Self>, Stopped> {
        let sound = cell_mm > 0.0 && reach_mm >= 2.0 * cell_mm && reach_mm <= 1000.0 * cell_mm;
        if !(sound && reach_mm.is_finite()) {
            return Ok(None);
        }
        let (mut cell_mm, mut reach_mm) = (cell_mm, reach_mm);
        loop {
            if let Some((mut field, count)) = Self::laid_out(solid, cell_mm, reach_mm, stop)? {
                field.fill(solid, count, stop)?;
                field.forget_jumps();
                return Ok(Some(field));
            }
            cell_mm *= WIDER;
            // So that the field can be rebuilt from its own cell width and reach.
            reach_mm = reach_mm.max(2.0 * cell_mm);
        }
    }

    /// Width of a cell, at least the requested one.
    #[must_use]
    pub const fn cell_mm(&self) -> f64 {
        self.cell_mm
    }

    /// Largest distance stored, at least the requested one.
    #[must_use]
    pub const fn reach_mm(&self) -> f64 {
        self.reach_mm
    }

    /// Memory of the grid, bytes.
    #[must_use]
    pub const fn bytes(&self) -> usize {
        self.values.len() * size_of::<i16>() + self.block_at.len() * size_of::<u32>()
    }

    /// Digest of the grid and its values.
    #[must_use]
    pub fn digest(&self) -> u64 {
        let grid = Digest::new().f64s(self.low_mm.to_array()).f64s([self.cell_mm, self.reach_mm]);
        self.values.iter().fold(grid, |digest, value| digest.bytes(&value.to_le_bytes())).value()
    }

    /// Distance, positive outside, and its gradient; `None` where the surface is out of reach, or beside
    /// a hole.
    #[must_use]
    #[inline(always)]
    pub fn distance(&self, p_mm: DVec3) -> Option<(f64, DVec3)> {
        let at = (p_mm - self.low_mm) * self.per_cell;
        // NaN fails these comparisons.
        let is_within = |axis: usize| at[axis] >= 0.0 && at[axis] < self.cells[axis];
        if !(is_within(0) && is_within(1) && is_within(2)) {
            return None;
        }
        let [x, y, z] = at.to_array().map(|along| along as u32 as usize);
        let place = x / CELLS + self.sides[0] * (y / CELLS + self.sides[1] * (z / CELLS));
        let block = self.block_at[place];
        if block == NONE {
            return None;
        }
        let first = block as usize * BLOCK + x % CELLS + NODES * (y % CELLS + NODES * (z % CELLS));
        let nodes = self.values.get(first..)?.first_chunk()?;
        let (distance, gradient) = interpolate(nodes, at - DVec3::new(x as f64, y as f64, z as f64))?;
        let distance_mm = distance * self.step_mm;
        (distance_mm.abs() <= self.reach_mm).then_some((distance_mm, gradient * self.slope))
    }

    /// The grid without values, and the number of its blocks; `None` if it is too large.
    fn laid_out(
        solid: &Solid,
        cell_mm: f64,
        reach_mm: f64,
        stop: Stop<'_>,
    ) -> Result<Option<(Self, usize)>, Stopped> {
        let (low_mm, high_mm) = solid.bounds_mm();
        let (low_mm, high_mm) = (low_mm - reach_mm, high_mm + reach_mm);
        let side_mm = CELLS as f64 * cell_mm;
        let sides = ((high_mm - low_mm) / side_mm).to_array().map(|n| ceil(n).max(1.0));
        if sides.iter().product::<f64>() > MAX_PLACES {
            return Ok(None);
        }
        let sides = sides.map(|n| n as usize);
        let half_diagonal_mm = 0.5 * DVec3::splat(side_mm).length();
        let mut block_at = alloc::vec![NONE; sides.iter().product()];
        let (mut count, mut near) = (0, None);
        for (place, block) in block_at.iter_mut().enumerate() {
            ask(stop, place)?;
            let middle = corner(place, sides) * side_mm + low_mm + 0.5 * side_mm;
            // If any point of the block is within reach, its middle is within this distance.
            if let Some(found) = solid.closest_within(middle, reach_mm + half_diagonal_mm, near) {
                near = Some(found.triangle);
                *block = count as u32;
                count += 1;
                if count * BLOCK > MAX_NODES {
                    return Ok(None);
                }
            }
        }
        let step_mm = largest_mm(cell_mm, reach_mm) / f64::from(i16::MAX);
        let cells = DVec3::from_array(sides.map(|n| (n * CELLS) as f64));
        let (slope, per_cell) = (step_mm / cell_mm, 1.0 / cell_mm);
        let values = Vec::new();
        let field =
            Self { low_mm, cell_mm, reach_mm, step_mm, slope, per_cell, sides, cells, block_at, values };
        Ok(Some((field, count)))
    }

    fn fill(&mut self, solid: &Solid, count: usize, stop: Stop<'_>) -> Result<(), Stopped> {
        self.values = Vec::with_capacity(count * BLOCK);
        let mut near = None;
        for (place, _) in self.block_at.iter().enumerate().filter(|&(_, &block)| block != NONE) {
            let corner = corner(place, self.sides) * CELLS as f64;
            for k in 0..BLOCK {
                ask(stop, self.values.len())?;
                let node = [k % NODES, k / NODES % NODES, k / (NODES * NODES)];
                let value = self.known(place, node).unwrap_or_else(|| {
                    let p_mm =
                        (corner + DVec3::from_array(node.map(|n| n as f64))) * self.cell_mm + self.low_mm;
                    let found = solid.closest_within(p_mm, largest_mm(self.cell_mm, self.reach_mm), near);
                    near = found.map(|found| found.triangle).or(near);
                    found.map_or(UNKNOWN, |found| round(found.distance_mm / self.step_mm) as i16)
                });
                self.values.push(value);
            }
        }
        Ok(())
    }

    /// The value of a node shared with an earlier block.
    fn known(&self, place: usize, node: [usize; 3]) -> Option<i16> {
        let (mut stride, mut step) = (1, 1);
        let here = node[0] + NODES * (node[1] + NODES * node[2]);
        for axis in 0..3 {
            // A node on the lower face is stored as the upper face of the block below.
            let is_first = (place / stride).is_multiple_of(self.sides[axis]);
            if node[axis] == 0 && !is_first && self.block_at[place - stride] != NONE {
                return Some(
                    self.values[self.block_at[place - stride] as usize * BLOCK + here + CELLS * step],
                );
            }
            stride *= self.sides[axis];
            step *= NODES;
        }
        None
    }

    /// Marks nodes as unknown where the difference to the next one exceeds a distance field's slope.
    /// Signs jump there: on open or self-intersecting surfaces the nearest point switches from one sheet
    /// to another.
    fn forget_jumps(&mut self) {
        let most = (self.cell_mm / self.step_mm) as i32 + 2;
        for block in self.values.chunks_exact_mut(BLOCK) {
            for k in 0..BLOCK {
                let node = [k % NODES, k / NODES % NODES, k / (NODES * NODES)];
                for (n, stride) in node.into_iter().zip([1, NODES, NODES * NODES]) {
                    let known = n < CELLS && block[k].min(block[k + stride]) != UNKNOWN;
                    if known && (i32::from(block[k]) - i32::from(block[k + stride])).abs() > most {
                        block[k] = UNKNOWN;
                    }
                }
            }
        }
    }
}

/// Block coordinates of a block index.
fn corner(place: usize, sides: [usize; 3]) -> DVec3 {
    let [x, y, z] = [place % sides[0], place / sides[0] % sides[1], place / sides[0] / sides[1]];
    DVec3::new(x as f64, y as f64, z as f64)
}

/// Larger distances occur at no node of a cell that has a point within reach.
fn largest_mm(cell_mm: f64, reach_mm: f64) -> f64 {
    reach_mm + DVec3::splat(cell_mm).length()
}

/// Value and gradient, in stored units, between the eight nodes of a cell.
#[inline(always)]
fn interpolate(nodes: &[i16; SPAN], share: DVec3) -> Option<(f64, DVec3)> {
    const ROW: usize = NODES;
    const LAYER: usize = NODES * NODES;
    let four = |first: usize| [first, first + ROW, first + LAYER, first + LAYER + ROW];
    // Along x first, then y, then z.
    let (low, high) = (four(0).map(|k| f64::from(nodes[k])), four(1).map(|k| f64::from(nodes[k])));
    let least: [f64; 4] = core::array::from_fn(|k| smaller(low[k], high[k]));
    if smaller(smaller(least[0], least[1]), smaller(least[2], least[3])) == f64::from(UNKNOWN) {
        return None;
    }
    let [x, y, z] = share.to_array();
    let dx: [f64; 4] = core::array::from_fn(|k| high[k] - low[k]);
    let at_x: [f64; 4] = core::array::from_fn(|k| low[k] + dx[k] * x);
    let dy = [at_x[1] - at_x[0], at_x[3] - at_x[2]];
    let at_y = [at_x[0] + dy[0] * y, at_x[2] + dy[1] * y];
    let dz = at_y[1] - at_y[0];
    let (near, far) = (dx[0] + (dx[1] - dx[0]) * y, dx[2] + (dx[3] - dx[2]) * y);
    let gradient = DVec3::new(near + (far - near) * z, dy[0] + (dy[1] - dy[0]) * z, dz);
    Some((at_y[0] + dz * z, gradient))
}

/// The smaller value; a single instruction, unlike `f64::min`.
#[inline]
fn smaller(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}
