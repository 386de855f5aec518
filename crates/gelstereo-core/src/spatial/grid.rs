//! Nearest neighbours of points in the plane, by square buckets.

use crate::math::{DVec2, sqrt};
use alloc::vec::Vec;

/// Largest number of buckets per side; wider spreads get larger buckets.
const MAX_BUCKETS: usize = 256;

/// Bucket side in mean point distances, for evenly spread points.
const EVEN_SIDE: f64 = 2.2;

/// Points in square buckets. Rebuilding reuses the memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Grid {
    origin: DVec2,
    /// Buckets per unit of the points' coordinates: pixels, or millimetres in [`Self::build_evenly`].
    per_unit: f64,
    columns: usize,
    rows: usize,
    /// Start of each bucket in `items`, and the end of the last one.
    starts: Vec<u32>,
    /// Indices of points, ascending within a bucket.
    items: Vec<u32>,
}

impl Grid {
    /// Reserves memory for `points` points spread over `spread_px`, in buckets of at least `side_px`.
    pub fn reserve(&mut self, points: usize, spread_px: (usize, usize), side_px: f64) {
        // Points may lie a bucket or two outside.
        let buckets = |extent: usize| ((extent as f64 / side_px) as usize + 4).min(MAX_BUCKETS + 1);
        self.starts.clear();
        self.starts.reserve(buckets(spread_px.0) * buckets(spread_px.1) + 1);
        self.items.clear();
        self.items.reserve(points);
    }

    /// Sorts `points` into buckets of at least `side_px`. Non-finite points are left out.
    pub fn build(&mut self, points: &[DVec2], side_px: f64) {
        self.build_from(points.iter().copied(), side_px);
    }

    /// As [`Self::build`].
    fn build_from<I>(&mut self, points: I, side_px: f64)
    where
        I: ExactSizeIterator<Item = DVec2> + DoubleEndedIterator + Clone,
    {
        let finite = || points.clone().filter(|p| p.is_finite());
        let (low, high) =
            finite().fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        self.starts.clear();
        self.items.clear();
        (self.columns, self.rows) = (0, 0);
        if low.x > high.x {
            return;
        }
        let spread = high - low;
        let side = side_px.max(spread.max_element() / MAX_BUCKETS as f64);
        self.origin = low;
        self.per_unit = if side > 0.0 && side.is_finite() { 1.0 / side } else { 0.0 };
        let buckets = |extent: f64| ((extent * self.per_unit) as usize).min(MAX_BUCKETS) + 1;
        (self.columns, self.rows) = (buckets(spread.x), buckets(spread.y));
        self.starts.resize(self.columns * self.rows + 1, 0);
        for point in finite() {
            let bucket = self.bucket(point);
            self.starts[bucket] += 1;
        }
        let mut end = 0;
        for start in &mut self.starts {
            end += *start;
            *start = end;
        }
        // Backwards, so that the counts become starts and indices ascend within a bucket.
        self.items.resize(end as usize, 0);
        for (index, point) in points.enumerate().rev().filter(|(_, p)| p.is_finite()) {
            let bucket = self.bucket(point);
            self.starts[bucket] -= 1;
            self.items[self.starts[bucket] as usize] = index as u32;
        }
    }

    /// The nearest accepted point to `target` closer than `radius_px`; the lowest index among equals,
    /// whatever the visiting order. `points` must be those of the last build.
    pub fn nearest(
        &self,
        points: &[DVec2],
        target: DVec2,
        radius_px: f64,
        accept: impl Fn(usize) -> bool,
    ) -> Option<usize> {
        let mut best = (radius_px * radius_px, None);
        self.visit(target, radius_px, |index| {
            let distance2 = points[index].distance_squared(target);
            let closer = distance2 < best.0 || (distance2 == best.0 && best.1.is_some_and(|b| index < b));
            if closer && accept(index) {
                best = (distance2, Some(index));
            }
        });
        best.1
    }

    /// Calls `see` for every point within the square of half side `radius_px`, and for some outside it.
    pub fn visit(&self, target: DVec2, radius_px: f64, mut see: impl FnMut(usize)) {
        if self.columns == 0 || !target.is_finite() {
            return;
        }
        let low = (target - self.origin - radius_px) * self.per_unit;
        let high = (target - self.origin + radius_px) * self.per_unit;
        if high.min_element() < 0.0 || low.x >= self.columns as f64 || low.y >= self.rows as f64 {
            return;
        }
        let (x0, x1) = (bucket_of(low.x), bucket_of(high.x).min(self.columns - 1));
        let (y0, y1) = (bucket_of(low.y), bucket_of(high.y).min(self.rows - 1));
        for y in y0..=y1 {
            let (from, to) = (self.starts[y * self.columns + x0], self.starts[y * self.columns + x1 + 1]);
            for &index in &self.items[from as usize..to as usize] {
                see(index as usize);
            }
        }
    }

    /// Reserves memory for [`Self::build_evenly`] of so many points.
    pub fn reserve_evenly(&mut self, points: usize) {
        // Along each axis one bucket for 2.2 points and the last one; in the plane one for 2.2² and those.
        self.starts.clear();
        self.starts.reserve(points.saturating_mul(2) + 4);
        self.items.clear();
        self.items.reserve(points);
    }

    /// Sorts finite points for [`Self::nearest_others`], in buckets of at least `min_side`. A bucket and its
    /// eight neighbours hold about forty points, or more.
    pub fn build_evenly<I>(&mut self, points: I, min_side: f64)
    where
        I: ExactSizeIterator<Item = DVec2> + DoubleEndedIterator + Clone,
    {
        let (low, high) = points
            .clone()
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        let (extent, count) = ((high - low).max(DVec2::ZERO), points.len().max(1) as f64);
        // At most as many buckets per axis as points, even for collinear ones; coincident points share
        // one bucket.
        let even = EVEN_SIDE * sqrt(extent.x * extent.y / count).max(extent.max_element() / count);
        let side = even.max(min_side);
        self.build_from(points, if side > 0.0 { side } else { 1.0 });
    }

    /// The `K` nearest other points of a point of [`Self::build_evenly`], nearest first, then by index.
    /// Missing ones are (infinity, the point itself). `squared(i)` must be at least the squared distance
    /// in the plane.
    pub fn nearest_others<const K: usize>(
        &self,
        own: usize,
        place: DVec2,
        squared: impl Fn(usize) -> f64,
    ) -> [(f64, u32); K] {
        let nothing = [(f64::INFINITY, own as u32); K];
        let (mut best, side) = (nothing, 1.0 / self.per_unit);
        let see = |best: &mut [(f64, u32); K], index: usize| {
            if index != own {
                insert(best, squared(index), index as u32);
            }
        };
        self.visit(place, side, |index| see(&mut best, index));
        // Points not visited are farther away than a bucket's side, up to rounding.
        if best[K - 1].0 > 0.999 * side * side {
            best = nothing;
            self.items.iter().for_each(|&index| see(&mut best, index as usize));
        }
        best
    }

    fn bucket(&self, point: DVec2) -> usize {
        let at = (point - self.origin) * self.per_unit;
        bucket_of(at.y).min(self.rows - 1) * self.columns + bucket_of(at.x).min(self.columns - 1)
    }
}

/// Row or column of a bucket; 0 before the first. The 32-bit conversion is a single instruction.
const fn bucket_of(at: f64) -> usize {
    at as u32 as usize
}

/// Inserts a point into the sorted list if it is among the nearest.
#[inline]
fn insert<const K: usize>(best: &mut [(f64, u32); K], squared: f64, index: u32) {
    let comes_before = |(other, i): (f64, u32)| squared < other || (squared == other && index < i);
    if !comes_before(best[K - 1]) {
        return;
    }
    let mut at = K - 1;
    while at > 0 && comes_before(best[at - 1]) {
        best[at] = best[at - 1];
        at -= 1;
    }
    best[at] = (squared, index);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{DVec3, random::Stream};
    use proptest::prelude::*;

    proptest! {
        /// Of points as near as each other the first one, whichever bucket it is in.
        #[test]
        fn the_nearest_is_that_of_a_search_through_all(
            places in prop::collection::vec((0..7_i32, 0..7_i32, any::<bool>()), 1..60),
            at in (-2..16_i32, -2..16_i32), side in 0.3..5.0_f64, radius in 0.2..6.0_f64,
        ) {
            let points: Vec<DVec2> =
                places.iter().map(|&(x, y, _)| DVec2::new(f64::from(x), f64::from(y))).collect();
            // Half way between the points as well.
            let target = DVec2::new(f64::from(at.0), f64::from(at.1)) * 0.5;
            let mut grid = Grid::default();
            grid.build(&points, side);
            let squared = |n: usize| points[n].distance_squared(target);
            let reached = (0..points.len()).filter(|&n| places[n].2 && squared(n) < radius * radius);
            let expected = reached.min_by(|&a, &b| squared(a).total_cmp(&squared(b)).then(a.cmp(&b)));
            prop_assert_eq!(grid.nearest(&points, target, radius, |n| places[n].2), expected);
        }
    }

    #[test]
    fn the_nearest_are_those_of_a_search_through_all() {
        let mut random = Stream::new(1, "grid");
        for case in 0..60 {
            // Spread evenly, collinear, at few positions, with a distant outlier, and few points.
            let scale = [(9.0, 9.0), (9.0, 0.0), (9.0, 1e-3), (0.0, 0.0)][case % 4];
            let count = [1, 3, 40, 300][case / 4 % 4];
            let coarse = |x: f64| if case % 3 == 0 { crate::math::round(x) } else { x };
            let mut places: Vec<DVec3> = (0..count)
                .map(|_| {
                    let [x, y, z] = [random.uniform(), random.uniform(), random.uniform()];
                    DVec3::new(coarse(scale.0 * x), coarse(scale.1 * y), z)
                })
                .collect();
            if case % 5 == 0 {
                places[0] = DVec3::new(-300.0, 200.0, 0.0);
            }
            let mut grid = Grid::default();
            grid.build_evenly(places.iter().map(|p| p.truncate()), 0.0);
            for (k, &at) in places.iter().enumerate() {
                let squared = |j: usize| places[j].distance_squared(at);
                let found = grid.nearest_others::<6>(k, at.truncate(), squared);
                let mut all: Vec<(f64, u32)> =
                    (0..count).filter(|&j| j != k).map(|j| (squared(j), j as u32)).collect();
                all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                all.resize(6, (f64::INFINITY, k as u32));
                all.truncate(6);
                assert_eq!(found.as_slice(), all, "{case} {k}");
            }
        }
    }
}
