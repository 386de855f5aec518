//! A tree of boxes over triangles, eight children to a node.
//!
//! Boxes only say where to look, so they are kept in single precision, from the middle of the surface, and taken a
//! little larger than they are: eight of them are measured by as many instructions as four in double precision.

use crate::math::DVec3;
use crate::stop::{Stop, Stopped, ask};
use alloc::vec::Vec;
use core::ops::Range;

/// Children of a node: their boxes are measured side by side.
const WAYS: usize = 8;
/// A child of this few triangles is a leaf.
const LEAF: usize = 2;
/// Bits of a child's name that say which node it is, or which triangle is the first of a leaf.
const NAME_BITS: u32 = 28;
/// Levels for 2²⁸ triangles and more: each divides them by eight.
const MAX_LEVELS: usize = 10;
/// Open children at any time, at most, and room to write one that is not kept.
const MAX_OPEN: usize = (WAYS - 1) * MAX_LEVELS + 2;
/// How much larger boxes are taken than they are, as a share of the largest coordinate of box and point: four times
/// what rounding either of them to single precision may be wrong by.
const MARGIN: f64 = 1.0 / (1 << 22) as f64;
/// A square of a distance to a box is a sum of three, each of two roundings of 2⁻²⁴.
const ROUNDING: f64 = 1e-6;
/// Of larger coordinates single precision has no sum of squares.
const FAR_MM: f64 = 1e18;
/// Squares below this, of a distance of 1e-18 mm, are too small for single precision.
const MIN_MM2: f64 = 1e-36;

#[derive(Clone, Debug)]
struct Node {
    /// Lower corners of the children's boxes: x, y, z of all.
    low: [[f32; WAYS]; 3],
    high: [[f32; WAYS]; 3],
    /// The node, or the first place of a leaf with the number of its triangles above [`NAME_BITS`].
    child: [u32; WAYS],
}

/// Places of triangles, in boxes; ranges are split at their median in the total order (centre, index), so that
/// coplanar and equal triangles split as evenly as any others.
#[derive(Clone, Debug)]
pub(super) struct Boxes {
    nodes: Vec<Node>,
    /// Where boxes are measured from.
    middle_mm: DVec3,
    /// Largest coordinate from there.
    reach_mm: f64,
}

/// A box and what is in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item {
    pub low: DVec3,
    pub high: DVec3,
    pub triangle: u32,
}

impl Boxes {
    /// Orders the items, of which there is at least one and fewer than 2²⁸, as the tree's places.
    pub fn new(items: &mut [Item], stop: Stop<'_>) -> Result<Self, Stopped> {
        let (low, high) = bounds(items);
        let middle_mm = low + (high - low) * 0.5;
        let reach_mm = (high - middle_mm).max(middle_mm - low).max_element();
        let mut boxes = Self { nodes: Vec::with_capacity(items.len() / 4 + 1), middle_mm, reach_mm };
        boxes.grow(items, 0, stop)?;
        Ok(boxes)
    }

    /// Calls `visit` for places, of near boxes first, whose box is within the squared distance `limit_mm2`, which is
    /// finite and which `visit` may lower and returns. Some boxes that are a little farther are visited, too.
    #[inline]
    pub fn near(&self, p_mm: DVec3, mut limit_mm2: f64, mut visit: impl FnMut(u32, f64) -> f64) {
        let q_mm = p_mm - self.middle_mm;
        let margin_mm = MARGIN * (q_mm.abs().max_element() + self.reach_mm);
        // From everywhere beyond FAR_MM all boxes are as near, for their squares to have a value.
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

    /// Adds the node over these items, which stand from `first` on; its name.
    fn grow(&mut self, items: &mut [Item], first: usize, stop: Stop<'_>) -> Result<u32, Stopped> {
        let name = self.nodes.len();
        ask(stop, name)?;
        self.nodes.push(Node {
            // A box that is not there is infinitely far from everywhere.
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
    /// Puts the children within reach on top of `open`, the nearest last; how many there are then.
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
        // Written first and counted then: which children are near cannot be foretold, and a branch would be wrong
        // half of the time. What is not a number is not within.
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

/// The larger one, or `b` if one is not a number; a single instruction, unlike `f32::max`.
#[inline]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller one, or `b` if one is not a number.
#[inline]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline]
fn single(v: DVec3) -> [f32; 3] {
    v.to_array().map(|x| x as f32)
}

/// The square that a box within this squared distance does not exceed in single precision.
#[inline]
fn single_limit(squared_mm2: f64) -> f32 {
    ((squared_mm2 * (1.0 + ROUNDING) + MIN_MM2) as f32).min(f32::MAX)
}

/// Splits at the median, and the halves and quarters again.
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
