//! Nearest neighbours of points in the plane, by square buckets.

use crate::math::DVec2;
use alloc::vec::Vec;

/// Most buckets along one side; wider spreads get larger buckets.
const MOST_BUCKETS: usize = 256;

/// Points in square buckets. Rebuilding it reuses its memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Grid {
    origin: DVec2,
    per_px: f64,
    columns: usize,
    rows: usize,
    /// Where each bucket starts in `items`, and the end of the last one.
    starts: Vec<u32>,
    /// Indices of points, ascending within a bucket.
    items: Vec<u32>,
}

impl Grid {
    /// Makes room for so many points, spread over so many pixels, in buckets of at least `side_px`.
    pub fn reserve(&mut self, points: usize, spread_px: (usize, usize), side_px: f64) {
        // Points may lie a bucket or two outside.
        let buckets = |extent: usize| ((extent as f64 / side_px) as usize + 4).min(MOST_BUCKETS + 1);
        self.starts.clear();
        self.starts.reserve(buckets(spread_px.0) * buckets(spread_px.1) + 1);
        self.items.clear();
        self.items.reserve(points);
    }

    /// Sorts `points` into buckets of at least `side_px`. Points that are not finite are left out.
    pub fn build(&mut self, points: &[DVec2], side_px: f64) {
        let finite = || points.iter().filter(|p| p.is_finite());
        let (low, high) = finite()
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
        self.starts.clear();
        self.items.clear();
        (self.columns, self.rows) = (0, 0);
        if low.x > high.x {
            return;
        }
        let spread = high - low;
        let side = side_px.max(spread.max_element() / MOST_BUCKETS as f64);
        self.origin = low;
        self.per_px = if side > 0.0 && side.is_finite() { 1.0 / side } else { 0.0 };
        let buckets = |extent: f64| ((extent * self.per_px) as usize).min(MOST_BUCKETS) + 1;
        (self.columns, self.rows) = (buckets(spread.x), buckets(spread.y));
        self.starts.resize(self.columns * self.rows + 1, 0);
        for &point in finite() {
            let bucket = self.bucket(point);
            self.starts[bucket] += 1;
        }
        let mut end = 0;
        for start in &mut self.starts {
            end += *start;
            *start = end;
        }
        // From the last point down, so that the counts become the starts and indices ascend.
        self.items.resize(end as usize, 0);
        for (index, &point) in points.iter().enumerate().rev().filter(|(_, p)| p.is_finite()) {
            let bucket = self.bucket(point);
            self.starts[bucket] -= 1;
            self.items[self.starts[bucket] as usize] = index as u32;
        }
    }

    /// The accepted point that is nearest to `target` and closer than `radius_px`; of equal ones the first. The order of the
    /// visits never decides. `points` are those that the grid was built from.
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

    /// Calls `see` for every point within the square of half side `radius_px`, and for some beyond.
    pub fn visit(&self, target: DVec2, radius_px: f64, mut see: impl FnMut(usize)) {
        if self.columns == 0 || !target.is_finite() {
            return;
        }
        let low = (target - self.origin - radius_px) * self.per_px;
        let high = (target - self.origin + radius_px) * self.per_px;
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

    fn bucket(&self, point: DVec2) -> usize {
        let at = (point - self.origin) * self.per_px;
        bucket_of(at.y).min(self.rows - 1) * self.columns + bucket_of(at.x).min(self.columns - 1)
    }
}

/// Row or column of buckets; 0 before the first. There is an instruction for 32 bits.
const fn bucket_of(at: f64) -> usize {
    at as u32 as usize
}
