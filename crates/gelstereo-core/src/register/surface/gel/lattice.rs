//! The markers as a lattice, linked from neighbour to neighbour, and relaxation sweeps over it.
//!
//! Cells are stored in two halves, like the squares of a chessboard (red-black ordering, Young 1954). All
//! neighbours of a cell are in the other half, so that no update waits for the previous one. The number
//! of columns is odd, with one of them empty. Then every second cell belongs to the same half across
//! rows, and all cells have the same offsets to their neighbours in the other half.

use crate::math::{DVec2, abs, sqrt};
use crate::register::surface::point::Sample;
use alloc::vec::Vec;
use core::ops::Range;

/// A marker as a node of the gel.
#[derive(Clone, Copy, Debug)]
pub(in crate::register::surface) struct Node {
    pub sample: Sample,
    /// Position across the press, relative to the patch's centroid.
    pub across_mm: DVec2,
    /// Position along the press.
    pub along_mm: f64,
    /// Index among the given markers.
    pub index: usize,
}

/// Largest distance of a neighbour, in pitches, and its smallest cosine to an axis, which excludes diagonals.
const FARTHEST: f64 = 1.5;
const ALONG: f64 = 0.9;
/// Offsets to the neighbours: along the axis, against it, and the same across it.
const WAYS: [[i32; 2]; 4] = [[1, 0], [-1, 0], [0, 1], [0, -1]];
const NONE: u32 = u32::MAX;
/// Largest number of cells per marker of a lattice.
const SPARSE: usize = 12;

/// Settings of relaxation sweeps.
#[derive(Clone, Copy, Debug)]
pub(in crate::register::surface) struct Relaxation<T> {
    /// (l / pitch)².
    pub stiffness: f64,
    pub max_sweeps: u32,
    /// Largest change at which the sweeps end.
    pub tolerance: T,
}

/// The cells of the markers.
#[derive(Clone, Debug, Default)]
pub(in crate::register::surface) struct Lattice {
    /// Cell of every marker, and its number of neighbours.
    places: Vec<(u32, u8)>,
    /// Number of columns; the last one is empty, and so are the first two rows and the last.
    width: usize,
    /// Number of cells of each half.
    half: usize,
    starts: Vec<u32>,
    links: Vec<Links>,
    patches: Vec<Patch>,
    open: Vec<u32>,
    is_marker: Vec<bool>,
}

/// Neighbourhood of a marker: the local lattice axis, and its neighbours in the four directions.
#[derive(Clone, Copy, Debug)]
struct Links {
    axis: DVec2,
    near: [u32; WAYS.len()],
    /// Column and row in its patch.
    at: [i32; 2],
    patch: u32,
}

/// A connected component of markers.
#[derive(Clone, Copy, Debug)]
struct Patch {
    low: [i32; 2],
    high: [i32; 2],
    /// Offset to columns and rows of the lattice.
    offset: [i32; 2],
}

/// Working arrays of the sweeps, by cell.
#[derive(Clone, Debug, Default)]
pub(in crate::register::surface) struct Sweeps {
    heights_mm: Vec<f64>,
    obstacle_mm: Vec<f64>,
    /// Factor of the sum over neighbours, or of the source; 0 without a marker.
    shares: Vec<f64>,
    /// Over-relaxation factor; 0 where the height is fixed.
    over: Vec<f64>,
    moved: Vec<f64>,
}

impl Lattice {
    /// Builds the lattice from markers sorted row by row. Returns whether they form one.
    pub fn find(&mut self, nodes: &[Node], pitch_mm: f64) -> bool {
        if !self.link(nodes, pitch_mm) {
            return false;
        }
        self.join();
        self.place()
    }

    /// The nearest marker defines one axis. Along both axes the nearest marker in each direction is a
    /// neighbour.
    fn link(&mut self, nodes: &[Node], pitch_mm: f64) -> bool {
        let Self { starts, links, .. } = self;
        let low_mm = nodes.iter().map(|node| node.across_mm.y).fold(f64::INFINITY, f64::min);
        let row = |node: &Node| ((node.across_mm.y - low_mm) / pitch_mm) as usize;
        let rows = nodes.last().map_or(0, row) + 1;
        // A distant marker must not create empty rows without limit.
        if rows > nodes.len() {
            return false;
        }
        starts.clear();
        starts.resize(rows + 1, 0);
        nodes.iter().for_each(|node| starts[row(node) + 1] += 1);
        for r in 0..rows {
            starts[r + 1] += starts[r];
        }
        links.clear();
        let farthest = FARTHEST * FARTHEST * pitch_mm * pitch_mm;
        for (k, node) in nodes.iter().enumerate() {
            let first = starts[row(node).saturating_sub(2)] as usize;
            let last = starts[(row(node) + 3).min(rows)] as usize;
            let around = || {
                let near = (first..last).filter(|&j| j != k);
                let offsets = near.map(|j| (nodes[j].across_mm - node.across_mm, j as u32));
                offsets.filter(|(offset, _)| (0.0..=farthest).contains(&offset.length_squared()))
            };
            let nearest = around().fold((f64::INFINITY, DVec2::X), |best, (offset, _)| {
                let squared = offset.length_squared();
                if squared < best.0 && squared > 0.0 { (squared, offset) } else { best }
            });
            let axis = nearest.1 / sqrt(nearest.1.length_squared());
            let mut best = [(farthest, NONE); WAYS.len()];
            for (offset, j) in around() {
                let squared = offset.length_squared();
                let (x, y) = (offset.dot(axis), offset.dot(axis.perp()));
                let way = if abs(x) > abs(y) { usize::from(x < 0.0) } else { 2 + usize::from(y < 0.0) };
                let along = abs(x).max(abs(y));
                if squared < best[way].0 && along * along > ALONG * ALONG * squared {
                    best[way] = (squared, j);
                }
            }
            links.push(Links { axis, near: best.map(|(_, j)| j), at: [0; 2], patch: NONE });
        }
        true
    }

    /// Assigns columns and rows by depth-first search over the links.
    fn join(&mut self) {
        let Self { links, patches, open, .. } = self;
        patches.clear();
        for first in 0..links.len() {
            if links[first].patch != NONE {
                continue;
            }
            links[first].patch = patches.len() as u32;
            let mut patch = Patch::ONE;
            open.clear();
            open.push(first as u32);
            while let Some(k) = open.pop() {
                let from = links[k as usize];
                for (j, step) in from.near.into_iter().zip(WAYS) {
                    let Some(to) = links.get_mut(j as usize) else { continue };
                    // Links must be mutual: beside a hole a marker may take a diagonal for an axis.
                    if to.patch != NONE || !to.near.contains(&k) {
                        continue;
                    }
                    to.patch = from.patch;
                    to.at = [from.at[0] + step[0], from.at[1] + step[1]];
                    to.turn_along(from.axis);
                    patch.take(to.at);
                    open.push(j);
                }
            }
            patches.push(patch);
        }
    }

    /// Places the patches beside and below one another, separated by an empty row or column. Returns whether
    /// the result is a lattice. Isolated markers, and those whose cell is already taken, get cell 0.
    fn place(&mut self) -> bool {
        let Self { places, links, patches, is_marker, .. } = self;
        let columns = patches.iter().map(|patch| patch.size(0)).max().unwrap_or(0);
        let (mut x, mut y, mut below) = (0, 0, 0);
        for patch in patches.iter_mut().filter(|patch| !patch.is_one()) {
            if x + patch.size(0) > columns {
                (x, y) = (0, below);
            }
            // Below two empty rows.
            patch.offset = [x - patch.low[0], y + 2 - patch.low[1]];
            x += patch.size(0) + 1;
            below = below.max(y + patch.size(1) + 1);
        }
        self.width = columns as usize + 1 + columns as usize % 2;
        // `below` includes the empty row after the last patch.
        self.half = (self.width * (below as usize + 2)).div_ceil(2);
        if 2 * self.half > SPARSE * links.len() {
            return false;
        }
        is_marker.clear();
        is_marker.resize(2 * self.half, false);
        places.clear();
        for to in links.iter() {
            let patch = &patches[to.patch as usize];
            let [x, y] = [0, 1].map(|axis| (to.at[axis] + patch.offset[axis]) as usize);
            let at = y * self.width + x;
            let cell = at % 2 * self.half + at / 2;
            let is_free = !patch.is_one() && !core::mem::replace(&mut is_marker[cell], true);
            places.push((if is_free { cell as u32 } else { 0 }, 0));
        }
        for k in 0..self.places.len() {
            let cell = self.places[k].0 as usize;
            if cell > 0 {
                let (own, at) = (cell / self.half, cell % self.half);
                let other = &self.is_marker[(1 - own) * self.half..];
                self.places[k].1 =
                    self.near(own).iter().map(|near| u8::from(other[near.start + at - self.first()])).sum();
            }
        }
        true
    }

    /// Neighbours of a marker with mutual links.
    pub fn near_marker(&self, marker: usize) -> impl Iterator<Item = usize> {
        let near = self.links[marker].near.into_iter().filter(|&j| j != NONE).map(|j| j as usize);
        near.filter(move |&j| self.links[j].near.contains(&(marker as u32)))
    }

    /// Prepares sweeps over the lattice; cells without a marker stay zero.
    pub fn lay_out(&self, sweeps: &mut Sweeps) {
        sweeps.clear(2 * self.half, self.inner().len());
    }

    /// Heights over an obstacle, from the initial `heights_mm`. Returns the number of sweeps.
    pub fn settle(
        &self,
        &Relaxation { stiffness, max_sweeps, tolerance }: &Relaxation<f64>,
        obstacle_mm: &[f64],
        heights_mm: &mut [f64],
        sweeps: &mut Sweeps,
    ) -> u32 {
        let over = over_relaxation(stiffness);
        let shares = shares(stiffness).map(|share| share * stiffness);
        for ((&(cell, count), &obstacle_mm), height_mm) in
            self.places.iter().zip(obstacle_mm).zip(&*heights_mm)
        {
            let cell = cell as usize;
            sweeps.heights_mm[cell] = *height_mm;
            sweeps.obstacle_mm[cell] = obstacle_mm;
            sweeps.shares[cell] = shares[count as usize];
        }
        sweeps.forget_first();
        let mut taken = max_sweeps;
        for sweep in 1..=max_sweeps {
            for own in 0..2 {
                self.settle_half(own, over, sweeps);
            }
            if sweeps.moved.iter().all(|&moved_mm| moved_mm < tolerance) {
                taken = sweep;
                break;
            }
        }
        for ((&(cell, _), &obstacle_mm), height_mm) in self.places.iter().zip(obstacle_mm).zip(heights_mm) {
            *height_mm = if cell > 0 { sweeps.heights_mm[cell as usize] } else { larger(obstacle_mm, 0.0) };
        }
        taken
    }

    fn settle_half(&self, own: usize, over: f64, sweeps: &mut Sweeps) {
        let Sweeps { heights_mm, obstacle_mm, shares, moved, .. } = sweeps;
        let (here, other) = halves(heights_mm, own, self.half);
        let at = self.inner();
        let [shares, obstacle_mm] = [&*shares, &*obstacle_mm].map(|all| &all[own * self.half..][at.clone()]);
        let near = self.near(own).map(|near| &other[near]);
        relax(over, own == 1, &mut here[at], near, shares, obstacle_mm, moved);
    }

    /// Derivatives of the heights where the gel is free, from those where it is in contact. The last of
    /// the `N` columns is for the logarithm of l²; its source is the heights: (I - l² Δ) ∂h = h. Returns
    /// the number of sweeps.
    pub fn follow<const N: usize>(
        &self,
        &Relaxation { stiffness, max_sweeps, tolerance }: &Relaxation<[f64; N]>,
        touches: impl Fn(usize) -> bool,
        heights_mm: &[f64],
        changes: &mut [[f64; N]],
        sweeps: &mut Sweeps,
        cells: &mut Vec<[f64; N]>,
    ) -> u32 {
        let over = over_relaxation(stiffness);
        cells.clear();
        cells.resize(2 * self.half, [0.0; N]);
        let shares = shares(stiffness);
        for (k, &(cell, count)) in self.places.iter().enumerate() {
            let cell = cell as usize;
            cells[cell] = changes[k];
            sweeps.heights_mm[cell] = heights_mm[k];
            sweeps.shares[cell] = shares[count as usize];
            sweeps.over[cell] = if touches(k) { 0.0 } else { over };
        }
        sweeps.forget_first();
        cells[0] = [0.0; N];
        let mut taken = max_sweeps;
        for sweep in 1..=max_sweeps {
            let mut largest = [0.0; N];
            for own in 0..2 {
                self.follow_half(own, stiffness, sweeps, cells, &mut largest);
            }
            if largest.iter().zip(&tolerance).all(|(step, tolerance)| step < tolerance) {
                taken = sweep;
                break;
            }
        }
        for (k, &(cell, _)) in self.places.iter().enumerate() {
            if cell > 0 {
                changes[k] = cells[cell as usize];
            } else if !touches(k) {
                changes[k] = [0.0; N];
            }
        }
        taken
    }

    fn follow_half<const N: usize>(
        &self,
        own: usize,
        stiffness: f64,
        sweeps: &Sweeps,
        cells: &mut [[f64; N]],
        largest: &mut [f64; N],
    ) {
        let at = self.inner();
        let (here, other) = halves(cells, own, self.half);
        let (here, near) = (&mut here[at.clone()], self.near(own).map(|near| &other[near]));
        let [heights_mm, shares, over] =
            [&sweeps.heights_mm, &sweeps.shares, &sweeps.over].map(|all| &all[own * self.half..][at.clone()]);
        for j in 0..here.len() {
            if over[j] == 0.0 {
                continue;
            }
            let [a, b, c, d] = near.map(|near| &near[j]);
            let (through, here) = (shares[j] * stiffness, &mut here[j]);
            let mut free: [f64; N] = core::array::from_fn(|i| through * (a[i] + b[i] + c[i] + d[i]));
            free[N - 1] += shares[j] * heights_mm[j];
            for i in 0..N {
                let step = over[j] * (free[i] - here[i]);
                largest[i] = larger(step.abs(), largest[i]);
                here[i] += step;
            }
        }
    }

    /// First cell of a half with all four neighbours.
    fn first(&self) -> usize {
        self.width.div_ceil(2)
    }

    /// Cells of a half with all four neighbours; no other cells hold markers.
    fn inner(&self) -> Range<usize> {
        self.first()..self.half - self.first()
    }

    /// Neighbours of these cells in the other half: above, below, before and after.
    fn near(&self, own: usize) -> [Range<usize>; WAYS.len()] {
        let (Range { start, end }, before) = (self.inner(), self.width / 2);
        let [up, down] = if own == 0 { [before + 1, before] } else { [before, before + 1] };
        [
            start - up..end - up,
            start + down..end + down,
            start + own - 1..end + own - 1,
            start + own..end + own,
        ]
    }
}

impl Links {
    /// Rotates the axis by a multiple of 90 degrees to be nearest to another one.
    fn turn_along(&mut self, axis: DVec2) {
        let (along, across) = (self.axis.dot(axis), self.axis.perp_dot(axis));
        let [a, b, c, d] = self.near;
        (self.axis, self.near) = match (abs(along) >= abs(across), along >= 0.0, across >= 0.0) {
            (true, true, _) => return,
            (true, false, _) => (-self.axis, [b, a, d, c]),
            (false, _, true) => (self.axis.perp(), [c, d, b, a]),
            (false, _, false) => (-self.axis.perp(), [d, c, a, b]),
        };
    }
}

impl Patch {
    const ONE: Self = Self { low: [0; 2], high: [0; 2], offset: [0; 2] };

    fn take(&mut self, at: [i32; 2]) {
        self.low = core::array::from_fn(|axis| self.low[axis].min(at[axis]));
        self.high = core::array::from_fn(|axis| self.high[axis].max(at[axis]));
    }

    fn size(&self, axis: usize) -> i32 {
        self.high[axis] - self.low[axis] + 1
    }

    fn is_one(&self) -> bool {
        self.low == self.high
    }
}

impl Sweeps {
    fn clear(&mut self, cells: usize, inner: usize) {
        for of_cells in [&mut self.heights_mm, &mut self.obstacle_mm, &mut self.shares, &mut self.over] {
            of_cells.clear();
            of_cells.resize(cells, 0.0);
        }
        self.moved.clear();
        self.moved.resize(inner, 0.0);
    }

    /// Clears cell 0, where markers without a cell have been written.
    fn forget_first(&mut self) {
        for of_cells in [&mut self.heights_mm, &mut self.obstacle_mm, &mut self.shares, &mut self.over] {
            of_cells[0] = 0.0;
        }
    }
}

/// Half a sweep of projected over-relaxation: moves every cell beyond the value given by its neighbours,
/// but not below the obstacle.
fn relax(
    over: f64,
    is_second: bool,
    here: &mut [f64],
    near: [&[f64]; WAYS.len()],
    shares: &[f64],
    obstacle_mm: &[f64],
    moved: &mut [f64],
) {
    let count = here.len();
    let [a, b, c, d] = near.map(|near| &near[..count]);
    let (shares, obstacle_mm, moved) = (&shares[..count], &obstacle_mm[..count], &mut moved[..count]);
    // `moved` holds the larger change of the two cells of an index, one in each half.
    let was_moved = if is_second { 1.0 } else { 0.0 };
    for j in 0..count {
        let free = shares[j] * (a[j] + b[j] + c[j] + d[j]);
        let next = larger(here[j] + over * (free - here[j]), obstacle_mm[j]);
        moved[j] = larger((next - here[j]).abs(), was_moved * moved[j]);
        here[j] = next;
    }
}

/// One half, and the other.
fn halves<T>(cells: &mut [T], own: usize, half: usize) -> (&mut [T], &[T]) {
    let (first, second) = cells.split_at_mut(half);
    if own == 0 { (first, second) } else { (second, first) }
}

/// Factor with the fastest convergence of successive over-relaxation (Young 1954), from the largest
/// possible eigenvalue of the Jacobi iteration.
fn over_relaxation(stiffness: f64) -> f64 {
    let jacobi = 4.0 * stiffness / (1.0 + 4.0 * stiffness);
    2.0 / (1.0 + sqrt(1.0 - jacobi * jacobi))
}

/// 1 / (1 + n l²) for cells with n neighbours.
fn shares(stiffness: f64) -> [f64; WAYS.len() + 1] {
    [0.0, 1.0, 2.0, 3.0, 4.0].map(|count| 1.0 / (1.0 + stiffness * count))
}

/// The larger value, as a single instruction unlike `f64::max`.
#[inline]
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

#[cfg(test)]
mod tests;
