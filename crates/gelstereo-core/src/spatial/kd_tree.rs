//! A static nearest-neighbour tree (Friedman, Bentley and Finkel 1977).

use crate::math::DVec3;
use crate::stop::{NEVER, Stop, Stopped};
use alloc::vec::Vec;
use core::array;
use core::ops::Range;

/// Points per leaf, processed together.
pub(crate) const LEAF: usize = 8;
/// Upper bound of the depth for fewer than 2³² points.
const DEPTH: usize = 32;
/// Index of the root; the children of a node are 2 node and 2 node + 1.
const ROOT: usize = 1;

/// Nearest point and points within a radius, with exactly the results of a brute-force search.
///
/// Ranges are split in the total order (coordinate, index) with a full left half. Duplicate and coplanar
/// points therefore split evenly too, and all leaves have equal depth. Queries do not allocate.
///
/// A branch is pruned by its splitting plane, which takes one product, and then by its bounding box. For
/// a query off the surface the planes prune little, because many cells are about as far away as their
/// plane. The boxes fit the surface.
#[derive(Clone, Debug, Default)]
pub struct KdTree {
    /// Points in tree order; the last leaf may have unused lanes.
    leaves: Vec<Leaf>,
    /// Splitting planes of the inner nodes.
    cuts: Vec<Cut>,
    /// Boxes of all nodes; empty for missing leaves.
    boxes: Vec<Bounds>,
    len: usize,
}

/// Points by coordinate, and their original indices. An unused lane is infinitely far away.
#[derive(Clone, Copy, Debug)]
struct Leaf {
    points: [[f64; LEAF]; 3],
    indices: [u32; LEAF],
}

/// No point on the left lies above the plane, none on the right below it.
#[derive(Clone, Copy, Debug)]
struct Cut {
    value: f64,
    axis: u32,
}

#[derive(Clone, Copy, Debug)]
struct Bounds {
    low: DVec3,
    high: DVec3,
}

/// Best candidate: least squared distance, then lowest index.
#[derive(Clone, Copy)]
struct Best {
    distance_squared: f64,
    index: u32,
}

// Pruning is exact. Rounding is monotone, so in f64 a point beyond a plane or in a box is never closer
// than the plane or box itself, if the squares are added in the same order.
impl KdTree {
    /// From these points, which must be finite and fewer than 2³².
    #[must_use]
    pub fn new(points: &[DVec3]) -> Self {
        Self::new_unless(points, NEVER).unwrap_or_default()
    }

    /// As [`Self::new`], unless it is stopped.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn new_unless(points: &[DVec3], stop: Stop<'_>) -> Result<Self, Stopped> {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let first_leaf = points.len().div_ceil(LEAF).next_power_of_two();
        let mut cuts = alloc::vec![Cut { value: 0.0, axis: 0 }; first_leaf];
        split(points, &mut order, (ROOT, &mut cuts), stop)?;
        let mut boxes = alloc::vec![Bounds::EMPTY; 2 * first_leaf];
        for (bounds, indices) in boxes[first_leaf..].iter_mut().zip(order.chunks(LEAF)) {
            *bounds = Bounds::of(points, indices);
        }
        for node in (ROOT..first_leaf).rev() {
            boxes[node] = boxes[2 * node].with(&boxes[2 * node + 1]);
        }
        let leaves = order.chunks(LEAF).map(|indices| Leaf::new(points, indices)).collect();
        Ok(Self { leaves, cuts, boxes, len: points.len() })
    }

    /// Index of the nearest point and its squared distance; `None` for a tree without points.
    ///
    /// Among equal squared distances in f64, the lowest index is nearest.
    #[must_use]
    pub fn nearest(&self, query: DVec3) -> Option<(usize, f64)> {
        let mut best = Best { distance_squared: f64::INFINITY, index: u32::MAX };
        // Branches left out on the way down, one per level, with the squared distance of their plane.
        let mut passed = [(0, 0.0); DEPTH];
        let mut count = 0;
        let mut node = ROOT;
        loop {
            while let Some(cut) = self.cuts.get(node) {
                let offset = query[cut.axis as usize] - cut.value;
                let near = 2 * node + usize::from(offset >= 0.0);
                passed[count] = (near ^ 1, offset * offset);
                count += 1;
                node = near;
            }
            if let Some(leaf) = self.leaves.get(node - self.cuts.len()) {
                leaf.search(query, &mut best);
            }
            let reach = best.distance_squared;
            node = loop {
                if count == 0 {
                    return (best.index != u32::MAX).then_some((best.index as usize, best.distance_squared));
                }
                count -= 1;
                let (next, plane) = passed[count];
                if plane <= reach && self.boxes[next].distance_squared(query) <= reach {
                    break next;
                }
            };
        }
    }

    /// Calls `visit(index, squared distance)` for every point with squared distance at most
    /// `radius_squared`, in tree order.
    pub fn within(&self, query: DVec3, radius_squared: f64, visit: &mut impl FnMut(usize, f64)) {
        self.reached(query, radius_squared, ROOT, &mut |k| {
            let leaf = &self.leaves[k];
            for (distance_squared, &index) in leaf.distances_squared(query).into_iter().zip(&leaf.indices) {
                if distance_squared <= radius_squared && index != u32::MAX {
                    visit(index as usize, distance_squared);
                }
            }
        });
    }

    /// Indices of the points, in tree order.
    pub(crate) fn indices(&self) -> impl Iterator<Item = u32> {
        self.leaves.iter().flat_map(|leaf| leaf.indices).take(self.len)
    }

    /// Calls `visit` with ascending ranges of positions in tree order. They cover every point with squared
    /// distance at most `radius_squared`, and possibly others. Each range starts at a multiple of [`LEAF`].
    pub(crate) fn ranges(&self, query: DVec3, radius_squared: f64, visit: &mut impl FnMut(Range<usize>)) {
        self.reached(query, radius_squared, ROOT, &mut |k| visit(LEAF * k..self.len.min(LEAF * (k + 1))));
    }

    /// Calls `visit` with the leaves whose boxes are within this distance, ascending.
    fn reached(&self, query: DVec3, radius_squared: f64, node: usize, visit: &mut impl FnMut(usize)) {
        if self.boxes[node].distance_squared(query) > radius_squared {
            return;
        }
        match node.checked_sub(self.cuts.len()) {
            Some(leaf) if leaf < self.leaves.len() => visit(leaf),
            Some(_) => {}
            None => {
                self.reached(query, radius_squared, 2 * node, visit);
                self.reached(query, radius_squared, 2 * node + 1, visit);
            }
        }
    }
}

impl Leaf {
    fn new(points: &[DVec3], indices: &[u32]) -> Self {
        let mut leaf = Self { points: [[f64::INFINITY; LEAF]; 3], indices: [u32::MAX; LEAF] };
        for (lane, &index) in indices.iter().enumerate() {
            leaf.indices[lane] = index;
            for (axis, coordinates) in leaf.points.iter_mut().enumerate() {
                coordinates[lane] = points[index as usize][axis];
            }
        }
        leaf
    }

    /// Same operations as glam's, per lane.
    #[inline(always)]
    fn distances_squared(&self, query: DVec3) -> [f64; LEAF] {
        let [x, y, z] = &self.points;
        array::from_fn(|k| {
            let (dx, dy, dz) = (query.x - x[k], query.y - y[k], query.z - z[k]);
            dx * dx + dy * dy + dz * dz
        })
    }

    #[inline(always)]
    fn search(&self, query: DVec3, best: &mut Best) {
        let distances_squared = self.distances_squared(query);
        let least = distances_squared.iter().fold(f64::INFINITY, |a, &b| if b < a { b } else { a });
        if least > best.distance_squared {
            return;
        }
        for (distance_squared, &index) in distances_squared.into_iter().zip(&self.indices) {
            if distance_squared < best.distance_squared
                || (distance_squared == best.distance_squared && index < best.index)
            {
                *best = Best { distance_squared, index };
            }
        }
    }
}

impl Bounds {
    const EMPTY: Self = Self { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };

    fn of(points: &[DVec3], indices: &[u32]) -> Self {
        indices
            .iter()
            .map(|&i| points[i as usize])
            .fold(Self::EMPTY, |bounds, p| Self { low: bounds.low.min(p), high: bounds.high.max(p) })
    }

    fn with(&self, other: &Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// Squared distance of a point to the box; 0 inside.
    #[inline(always)]
    fn distance_squared(&self, query: DVec3) -> f64 {
        let off = |low: f64, high: f64, q: f64| {
            let (below, above) = (low - q, q - high);
            let most = if below > above { below } else { above };
            if most > 0.0 { most } else { 0.0 }
        };
        let x = off(self.low.x, self.high.x, query.x);
        let y = off(self.low.y, self.high.y, query.y);
        let z = off(self.low.z, self.high.z, query.z);
        x * x + y * y + z * z
    }

    fn widest_axis(&self) -> usize {
        let extent = self.high - self.low;
        if extent.x >= extent.y && extent.x >= extent.z {
            0
        } else if extent.y >= extent.z {
            1
        } else {
            2
        }
    }
}

/// Below this number of points a node takes little time, so the stop closure is not called.
const MANY: usize = 4096;

/// Orders the indices below a node as a tree and records the splitting planes.
fn split(
    points: &[DVec3],
    order: &mut [u32],
    (node, cuts): (usize, &mut [Cut]),
    stop: Stop<'_>,
) -> Result<(), Stopped> {
    if order.is_empty() || node >= cuts.len() {
        return Ok(());
    }
    if order.len() > MANY && stop() {
        return Err(Stopped);
    }
    // A node at depth d holds the leaves of a full subtree.
    let leaves = cuts.len() >> node.ilog2();
    let middle = leaves / 2 * LEAF;
    if order.len() <= middle {
        // All points are on the left.
        cuts[node].value = f64::INFINITY;
        return split(points, order, (2 * node, cuts), stop);
    }
    let axis = Bounds::of(points, order).widest_axis();
    let (_, &mut first, _) = order.select_nth_unstable_by(middle, |&a, &b| {
        points[a as usize][axis].total_cmp(&points[b as usize][axis]).then(a.cmp(&b))
    });
    cuts[node] = Cut { value: points[first as usize][axis], axis: axis as u32 };
    let (left, right) = order.split_at_mut(middle);
    split(points, left, (2 * node, cuts), stop)?;
    split(points, right, (2 * node + 1, cuts), stop)
}
