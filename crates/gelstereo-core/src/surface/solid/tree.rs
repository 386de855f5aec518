//! A tree of boxes over triangles, four children to a node.

use crate::math::DVec3;
use alloc::vec::Vec;
use core::ops::Range;

/// Children of a node: their boxes are measured side by side.
const WAYS: usize = 4;
/// A child of this few triangles is a leaf.
const LEAF: usize = 2;
/// Levels for 2³² triangles: each divides them by four.
const MOST_LEVELS: usize = 16;
/// Open children at any time, at most.
const MOST_OPEN: usize = (WAYS - 1) * MOST_LEVELS + 1;

#[derive(Clone, Debug)]
struct Node {
    /// Lower corners of the children's boxes: x, y, z of all four.
    low: [[f64; WAYS]; 3],
    high: [[f64; WAYS]; 3],
    /// The node, or the first place of a leaf.
    child: [u32; WAYS],
    /// Triangles in a leaf; 0 for a node.
    count: [u32; WAYS],
}

/// Places of triangles, in boxes; ranges are split at their median in the total order (centre, index), so that coplanar and
/// equal triangles split as evenly as any others.
#[derive(Clone, Debug)]
pub(super) struct Boxes {
    nodes: Vec<Node>,
}

/// A box and what is in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item {
    pub low: DVec3,
    pub high: DVec3,
    pub triangle: u32,
}

impl Boxes {
    /// Orders the items, of which there is at least one, as the tree's places.
    pub fn new(items: &mut [Item]) -> Self {
        let mut nodes = Vec::with_capacity(items.len() / 2 + 1);
        grow(&mut nodes, items, 0);
        Self { nodes }
    }

    /// Calls `visit` for places, nearest boxes first, whose box is within the squared distance `limit_mm2`, which is finite and
    /// which `visit` may lower and returns.
    #[inline]
    pub fn near(&self, p_mm: DVec3, mut limit_mm2: f64, mut visit: impl FnMut(u32, f64) -> f64) {
        let mut open = [(0.0_f64, 0_u32, 0_u32); MOST_OPEN];
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let (squared, child, triangles) = open[count];
            if squared > limit_mm2 {
                continue;
            }
            if triangles > 0 {
                for place in child..child + triangles {
                    limit_mm2 = visit(place, limit_mm2);
                }
                continue;
            }
            let node = &self.nodes[child as usize];
            let squared = node.squared(p_mm);
            let begin = count;
            for k in 0..WAYS {
                // What is not a number is not within.
                if !(squared[k] <= limit_mm2) {
                    continue;
                }
                // The nearest on top.
                let mut at = count;
                while at > begin && open[at - 1].0 < squared[k] {
                    open[at] = open[at - 1];
                    at -= 1;
                }
                open[at] = (squared[k], node.child[k], node.count[k]);
                count += 1;
            }
        }
    }
}

impl Node {
    /// Squared distances to the children's boxes.
    #[inline]
    fn squared(&self, p_mm: DVec3) -> [f64; WAYS] {
        let mut sum = [0.0; WAYS];
        for (axis, p) in p_mm.to_array().into_iter().enumerate() {
            for k in 0..WAYS {
                let outside = larger(0.0, larger(self.low[axis][k] - p, p - self.high[axis][k]));
                sum[k] += outside * outside;
            }
        }
        sum
    }
}

/// The larger one, or `b` if one is not a number; a single instruction, unlike `f64::max`.
#[inline]
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// Adds the node over these items, which stand from `first` on; its name.
fn grow(nodes: &mut Vec<Node>, items: &mut [Item], first: usize) -> u32 {
    let name = nodes.len();
    nodes.push(Node {
        // A box that is not there is infinitely far from everywhere.
        low: [[f64::INFINITY; WAYS]; 3],
        high: [[f64::NEG_INFINITY; WAYS]; 3],
        child: [0; WAYS],
        count: [0; WAYS],
    });
    for (k, range) in quarters(items).into_iter().enumerate() {
        if range.is_empty() {
            continue;
        }
        let inside = &mut items[range.clone()];
        let (low, high) = bounds(inside);
        let at = first + range.start;
        let (child, count) = if inside.len() <= LEAF {
            (at as u32, inside.len() as u32)
        } else {
            (grow(nodes, inside, at), 0)
        };
        let node = &mut nodes[name];
        for axis in 0..3 {
            node.low[axis][k] = low[axis];
            node.high[axis][k] = high[axis];
        }
        node.child[k] = child;
        node.count[k] = count;
    }
    name as u32
}

/// Splits at the median, and both halves again.
fn quarters(items: &mut [Item]) -> [Range<usize>; WAYS] {
    let (middle, end) = (items.len() / 2, items.len());
    split(items, middle);
    let (below, above) = items.split_at_mut(middle);
    let (first, third) = (below.len() / 2, above.len() / 2);
    split(below, first);
    split(above, third);
    [0..first, first..middle, middle..middle + third, middle + third..end]
}

fn split(items: &mut [Item], middle: usize) {
    if items.len() < 2 {
        return;
    }
    let centre = |item: &Item| item.low + item.high;
    let start = centre(&items[0]);
    let (low, high) = items
        .iter()
        .fold((start, start), |(low, high), item| (low.min(centre(item)), high.max(centre(item))));
    let extent = (high - low).to_array();
    let axis = (1..3).fold(0, |most, axis| if extent[axis] > extent[most] { axis } else { most });
    items.select_nth_unstable_by(middle, |a, b| {
        centre(a)[axis].total_cmp(&centre(b)[axis]).then(a.triangle.cmp(&b.triangle))
    });
}

fn bounds(items: &[Item]) -> (DVec3, DVec3) {
    let start = (items[0].low, items[0].high);
    items.iter().fold(start, |(low, high), item| (low.min(item.low), high.max(item.high)))
}
