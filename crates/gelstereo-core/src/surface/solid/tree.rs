//! Bounding-box tree over triangles, eight children per node.
//!
//! Boxes only guide the search. They are stored in single precision, relative to the middle of the
//! surface, and slightly enlarged. Testing eight takes as many instructions as four in double precision.

use crate::math::DVec3;
use crate::stop::{Stop, Stopped, ask};
use alloc::vec::Vec;
use core::ops::Range;

/// Children per node; their boxes are tested side by side.
const WAYS: usize = 8;
/// Largest number of triangles in a leaf.
const LEAF: usize = 2;
/// Bits of a child's name that hold its node index, or the first triangle of a leaf.
const NAME_BITS: u32 = 28;
/// Levels for 2²⁸ triangles and more: each divides them by eight.
const MAX_LEVELS: usize = 10;
/// Largest number of open children, with room for one that is written but not kept.
const MAX_OPEN: usize = (WAYS - 1) * MAX_LEVELS + 2;
/// Enlargement of boxes, as a share of the largest coordinate of box and point: four times the error of
/// rounding either to single precision.
const MARGIN: f64 = 1.0 / (1 << 22) as f64;
/// A squared distance to a box is a sum of three terms, each with two roundings of 2⁻²⁴.
const ROUNDING: f64 = 1e-6;
/// Squared sums of larger coordinates overflow single precision.
const FAR_MM: f64 = 1e18;
/// Squares below this, of a distance of 1e-18 mm, are too small for single precision.
const MIN_MM2: f64 = 1e-36;

#[derive(Clone, Debug)]
struct Node {
    /// Lower corners of the children's boxes: x, y, z of all.
    low: [[f32; WAYS]; 3],
    high: [[f32; WAYS]; 3],
    /// The child node; or for a leaf its first position, with its number of triangles above
    /// [`NAME_BITS`].
    child: [u32; WAYS],
}

/// A tree of boxes over triangle positions. Ranges are split at the median in the total order (centre,
/// index), so that coplanar and duplicate triangles split evenly too.
#[derive(Clone, Debug)]
pub(super) struct Boxes {
    nodes: Vec<Node>,
    /// Origin of the boxes' coordinates.
    middle_mm: DVec3,
    /// Largest coordinate relative to that origin.
    reach_mm: f64,
}

/// A triangle with its box.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item {
    pub low: DVec3,
    pub high: DVec3,
    pub triangle: u32,
}

impl Boxes {
    /// Sorts the items (at least one, fewer than 2²⁸) into tree order.
    pub fn new(items: &mut [Item], stop: Stop<'_>) -> Result<Self, Stopped> {
        let (low, high) = bounds(items);
        let middle_mm = low + (high - low) * 0.5;
        let reach_mm = (high - middle_mm).max(middle_mm - low).max_element();
        let mut boxes = Self { nodes: Vec::with_capacity(items.len() / 4 + 1), middle_mm, reach_mm };
        boxes.grow(items, 0, stop)?;
        Ok(boxes)
    }

    /// Calls `visit` for positions whose box is within the squared distance `limit_mm2`, roughly nearest
    /// first. `limit_mm2` is finite; `visit` returns it and may lower it. Boxes slightly farther away may
    /// be visited too.
    #[inline]
    pub fn near(&self, p_mm: DVec3, mut limit_mm2: f64, mut visit: impl FnMut(u32, f64) -> f64) {
        let q_mm = p_mm - self.middle_mm;
        let margin_mm = MARGIN * (q_mm.abs().max_element() + self.reach_mm);
        // Beyond FAR_MM all boxes count as equally near, so that squares stay finite.
        let from = (q_mm - margin_mm).to_array().map(|x| if x > FAR_MM { FAR_MM } else { x } as f32);
        let to = (q_mm + margin_mm).to_array().map(|x| if x < -FAR_MM { -FAR_MM } else { x } as f32);
        let query = (from, to);
        let mut within = single_limit(limit_mm2);
        let mut open = [(0.0_f32, 0_u32); MAX_OPEN];
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let (squared, child) = open[count];
            if squared > within {
                continue;
            }
            let (name, triangles) = (child & ((1 << NAME_BITS) - 1), child >> NAME_BITS);
            if triangles > 0 {
                for place in name..name + triangles {
                    limit_mm2 = visit(place, limit_mm2);
                }
                within = single_limit(limit_mm2);
                continue;
            }
            count = self.nodes[name as usize].open(query, within, &mut open, count);
        }
    }

    /// Adds the node over these items, which start at position `first`; returns its index.
    fn grow(&mut self, items: &mut [Item], first: usize, stop: Stop<'_>) -> Result<u32, Stopped> {
        let name = self.nodes.len();
        ask(stop, name)?;
        self.nodes.push(Node {
            // A missing child is infinitely far from everything.
            low: [[f32::INFINITY; WAYS]; 3],
            high: [[f32::NEG_INFINITY; WAYS]; 3],
            child: [0; WAYS],
        });
        for (k, range) in eighths(items).into_iter().enumerate() {
            if range.is_empty() {
                continue;
            }
            let inside = &mut items[range.clone()];
            let (low, high) = bounds(inside);
            let at = first + range.start;
            let child = if inside.len() <= LEAF {
                at as u32 | (inside.len() as u32) << NAME_BITS
            } else {
                self.grow(inside, at, stop)?
            };
            let (low, high) = (single(low - self.middle_mm), single(high - self.middle_mm));
            let node = &mut self.nodes[name];
            for axis in 0..3 {
                node.low[axis][k] = low[axis];
                node.high[axis][k] = high[axis];
            }
            node.child[k] = child;
        }
        Ok(name as u32)
    }
}

impl Node {
    /// Pushes the children within reach onto `open`, the nearest last; returns the new count.
    #[inline]
    fn open(
        &self,
        query: ([f32; 3], [f32; 3]),
        within: f32,
        open: &mut [(f32, u32); MAX_OPEN],
        count: usize,
    ) -> usize {
        let squared = self.squared(query);
        let (mut end, mut nearest, mut least) = (count, count, f32::INFINITY);
        // Writes first and counts afterwards: which children are near is unpredictable, so half of all
        // branches would be mispredicted. NaN fails the comparison.
        for k in 0..WAYS {
            open[end] = (squared[k], self.child[k]);
            nearest = if squared[k] < least { end } else { nearest };
            least = smaller(squared[k], least);
            end += usize::from(squared[k] <= within);
        }
        if end > count {
            open.swap(nearest, end - 1);
        }
        end
    }

    /// Squared distances of a small box around the point to the children's boxes.
    #[inline]
    fn squared(&self, (from, to): ([f32; 3], [f32; 3])) -> [f32; WAYS] {
        let mut sum = [0.0; WAYS];
        for axis in 0..3 {
            for k in 0..WAYS {
                let outside =
                    larger(0.0, larger(self.low[axis][k] - to[axis], from[axis] - self.high[axis][k]));
                sum[k] += outside * outside;
            }
        }
        sum
    }
}

/// The larger value, or `b` if either is NaN; a single instruction, unlike `f32::max`.
#[inline]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller value, or `b` if either is NaN.
#[inline]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline]
fn single(v: DVec3) -> [f32; 3] {
    v.to_array().map(|x| x as f32)
}

/// Upper bound, in single precision, of the square of a box within this squared distance.
#[inline]
fn single_limit(squared_mm2: f64) -> f32 {
    ((squared_mm2 * (1.0 + ROUNDING) + MIN_MM2) as f32).min(f32::MAX)
}

/// Splits at the median, then the halves and the quarters.
fn eighths(items: &mut [Item]) -> [Range<usize>; WAYS] {
    let mut ends = [0; WAYS + 1];
    ends[WAYS] = items.len();
    let mut step = WAYS;
    while step > 1 {
        for k in (0..WAYS).step_by(step) {
            let (start, end) = (ends[k], ends[k + step]);
            let middle = start + (end - start) / 2;
            split(&mut items[start..end], middle - start);
            ends[k + step / 2] = middle;
        }
        step /= 2;
    }
    core::array::from_fn(|k| ends[k]..ends[k + 1])
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
