//! A static nearest-neighbour tree (Friedman, Bentley and Finkel 1977).

use crate::math::DVec3;
use alloc::vec::Vec;
use core::ops::Range;

/// A range this short is searched point by point.
const LEAF: usize = 8;

/// Nearest point and points within a radius, exactly as a search through all of them would say.
///
/// Ranges are split at their median in the total order (coordinate, index), so that thousands of duplicate or
/// coplanar points split as evenly as any others and the depth stays below log2 N. Queries allocate nothing.
#[derive(Clone, Debug)]
pub struct Tree {
    /// The points in the order of the tree: every range's median stands in its middle.
    points: Vec<DVec3>,
    /// Their indices in the order they came.
    indices: Vec<u32>,
    /// Axis that the range around this middle is split along.
    axes: Vec<u8>,
}

/// The best point so far: least squared distance, then least index.
#[derive(Clone, Copy)]
struct Best {
    distance_squared: f64,
    index: u32,
}

impl Tree {
    /// Over these points, which must be finite and fewer than 2³².
    #[must_use]
    pub fn new(points: &[DVec3]) -> Self {
        let mut indices: Vec<u32> = (0..points.len() as u32).collect();
        let mut axes = alloc::vec![0; points.len()];
        split(points, &mut indices, &mut axes);
        let points = indices.iter().map(|&i| points[i as usize]).collect();
        Self { points, indices, axes }
    }

    /// Index of the nearest point and its squared distance; `None` for a tree without points.
    ///
    /// Of points at the same squared distance in f64 the one with the lowest index is nearest.
    #[must_use]
    pub fn nearest(&self, query: DVec3) -> Option<(usize, f64)> {
        let mut best = Best { distance_squared: f64::INFINITY, index: u32::MAX };
        self.search(query, 0, self.points.len(), &mut best);
        (!self.points.is_empty()).then_some((best.index as usize, best.distance_squared))
    }

    /// Calls `visit(index, squared distance)` for every point with squared distance at most `radius_squared`, in the
    /// order of the tree.
    pub fn within(&self, query: DVec3, radius_squared: f64, visit: &mut impl FnMut(usize, f64)) {
        self.collect(query, radius_squared, 0, self.points.len(), visit);
    }

    /// Indices of the points, in the order of the tree.
    pub(super) fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// Calls `visit` with short ranges of places in the order of the tree, ascending, that together hold every point
    /// with squared distance at most `radius_squared`, and others beside them.
    pub(super) fn ranges(&self, query: DVec3, radius_squared: f64, visit: &mut impl FnMut(Range<usize>)) {
        self.cover(query, radius_squared, 0..self.points.len(), visit);
    }

    // All descents may prune exactly: rounding is monotone, so a point beyond the plane is never closer in f64 than
    // the plane itself.
    fn search(&self, query: DVec3, low: usize, high: usize, best: &mut Best) {
        if high - low <= LEAF {
            (low..high).for_each(|k| self.consider(query, k, best));
            return;
        }
        let middle = low.midpoint(high);
        self.consider(query, middle, best);
        let axis = usize::from(self.axes[middle]);
        let offset = query[axis] - self.points[middle][axis];
        let (near, far) = if offset < 0.0 {
            ((low, middle), (middle + 1, high))
        } else {
            ((middle + 1, high), (low, middle))
        };
        self.search(query, near.0, near.1, best);
        if offset * offset <= best.distance_squared {
            self.search(query, far.0, far.1, best);
        }
    }

    fn consider(&self, query: DVec3, k: usize, best: &mut Best) {
        let distance_squared = query.distance_squared(self.points[k]);
        let index = self.indices[k];
        if distance_squared < best.distance_squared
            || (distance_squared == best.distance_squared && index < best.index)
        {
            *best = Best { distance_squared, index };
        }
    }

    fn cover(
        &self,
        query: DVec3,
        radius_squared: f64,
        range: Range<usize>,
        visit: &mut impl FnMut(Range<usize>),
    ) {
        if range.len() <= LEAF {
            visit(range);
            return;
        }
        let middle = range.start.midpoint(range.end);
        let axis = usize::from(self.axes[middle]);
        let offset = query[axis] - self.points[middle][axis];
        let across = offset * offset <= radius_squared;
        if offset <= 0.0 || across {
            self.cover(query, radius_squared, range.start..middle, visit);
        }
        if across {
            visit(middle..middle + 1);
        }
        if offset >= 0.0 || across {
            self.cover(query, radius_squared, middle + 1..range.end, visit);
        }
    }

    fn collect(
        &self,
        query: DVec3,
        radius_squared: f64,
        low: usize,
        high: usize,
        visit: &mut impl FnMut(usize, f64),
    ) {
        let mut look = |k: usize| {
            let distance_squared = query.distance_squared(self.points[k]);
            if distance_squared <= radius_squared {
                visit(self.indices[k] as usize, distance_squared);
            }
        };
        if high - low <= LEAF {
            (low..high).for_each(look);
            return;
        }
        let middle = low.midpoint(high);
        look(middle);
        let axis = usize::from(self.axes[middle]);
        let offset = query[axis] - self.points[middle][axis];
        let across = offset * offset <= radius_squared;
        if offset <= 0.0 || across {
            self.collect(query, radius_squared, low, middle, visit);
        }
        if offset >= 0.0 || across {
            self.collect(query, radius_squared, middle + 1, high, visit);
        }
    }
}

/// Orders `indices` as a tree and notes the axes.
fn split(points: &[DVec3], indices: &mut [u32], axes: &mut [u8]) {
    if indices.len() <= LEAF {
        return;
    }
    let axis = widest_axis(points, indices);
    let middle = indices.len() / 2;
    indices.select_nth_unstable_by(middle, |&a, &b| {
        points[a as usize][axis].total_cmp(&points[b as usize][axis]).then(a.cmp(&b))
    });
    axes[middle] = axis as u8;
    let (below, above) = indices.split_at_mut(middle);
    let (axes_below, axes_above) = axes.split_at_mut(middle);
    split(points, below, axes_below);
    split(points, &mut above[1..], &mut axes_above[1..]);
}

fn widest_axis(points: &[DVec3], indices: &[u32]) -> usize {
    let first = points[indices[0] as usize];
    let (low, high) = indices
        .iter()
        .fold((first, first), |(low, high), &i| (low.min(points[i as usize]), high.max(points[i as usize])));
    let extent = high - low;
    if extent.x >= extent.y && extent.x >= extent.z {
        0
    } else if extent.y >= extent.z {
        1
    } else {
        2
    }
}
