//! Which markers are near one another: markers sorted into squares across the press.

use crate::math::{DVec2, DVec3, sqrt};
use alloc::vec::Vec;

/// Side of a square, in the distance of markers that are spread evenly: a square and the eight around it hold some forty.
const SIDE: f64 = 2.2;

/// Points by the square of the plane of x and y that each is in.
#[derive(Clone, Debug, Default)]
pub(super) struct Buckets {
    low_mm: DVec2,
    side_mm: f64,
    /// Squares along both axes.
    sides: [usize; 2],
    /// Where each square's members begin; behind them where the last one's end.
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Buckets {
    /// Sorts finite points into squares.
    pub fn fill(&mut self, places_mm: &[DVec3]) {
        let bounds = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let flat = places_mm.iter().map(|p| p.truncate());
        let (low, high) = flat.clone().fold(bounds, |(low, high), p| (low.min(p), high.max(p)));
        let (extent, count) = ((high - low).max(DVec2::ZERO), places_mm.len().max(1) as f64);
        // No more squares along an axis than points, in a row as well; all at one place are in one square.
        let side_mm = SIDE * sqrt(extent.x * extent.y / count).max(extent.max_element() / count);
        self.low_mm = low;
        self.side_mm = if side_mm > 0.0 { side_mm } else { 1.0 };
        self.sides = extent.to_array().map(|x| (x / self.side_mm) as usize + 1);
        self.starts.clear();
        self.starts.resize(self.sides[0] * self.sides[1] + 1, 0);
        for p in flat.clone() {
            let square = self.square(p);
            self.starts[square] += 1;
        }
        let mut end = 0;
        for start in &mut self.starts {
            end += *start;
            *start = end;
        }
        self.members.clear();
        self.members.resize(places_mm.len(), 0);
        for (k, p) in flat.enumerate() {
            let square = self.square(p);
            self.starts[square] -= 1;
            self.members[self.starts[square] as usize] = k as u32;
        }
    }

    fn column(&self, along_mm: f64, axis: usize) -> usize {
        // What is not positive is cast to 0.
        ((along_mm / self.side_mm) as usize).min(self.sides[axis] - 1)
    }

    fn square(&self, p_mm: DVec2) -> usize {
        let from = p_mm - self.low_mm;
        self.column(from.x, 0) + self.sides[0] * self.column(from.y, 1)
    }

    /// The `K` points that are nearest to one of those sorted, itself left out, the nearest first and of those as near the
    /// first one; ∞ and the point itself where there are fewer. `squared_mm2` of a point is no less than that across the plane.
    pub fn nearest<const K: usize>(
        &self,
        own: usize,
        place_mm: DVec3,
        squared_mm2: impl Fn(usize) -> f64,
    ) -> [(f64, u32); K] {
        let mut best = [(f64::INFINITY, own as u32); K];
        let from = place_mm.truncate() - self.low_mm;
        let [x, y] = [self.column(from.x, 0), self.column(from.y, 1)];
        let (first, last) = (x.saturating_sub(1), (x + 1).min(self.sides[0] - 1));
        for row in y.saturating_sub(1)..(y + 2).min(self.sides[1]) {
            let [start, end] = [first, last + 1].map(|x| self.starts[x + self.sides[0] * row] as usize);
            for &j in self.members[start..end].iter().filter(|&&j| j as usize != own) {
                insert(&mut best, squared_mm2(j as usize), j);
            }
        }
        // What is in none of these squares is farther off than a square's side, but for rounding.
        if best[K - 1].0 > 0.999 * self.side_mm * self.side_mm {
            best = [(f64::INFINITY, own as u32); K];
            for j in (0..self.members.len()).filter(|&j| j != own) {
                insert(&mut best, squared_mm2(j), j as u32);
            }
        }
        best
    }
}

/// Puts a point where it belongs among the nearest ones, if it does.
#[inline]
fn insert<const K: usize>(best: &mut [(f64, u32); K], squared_mm2: f64, index: u32) {
    let comes_before = |(other, i): (f64, u32)| squared_mm2 < other || (squared_mm2 == other && index < i);
    if !comes_before(best[K - 1]) {
        return;
    }
    let mut at = K - 1;
    while at > 0 && comes_before(best[at - 1]) {
        best[at] = best[at - 1];
        at -= 1;
    }
    best[at] = (squared_mm2, index);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::random::Stream;

    #[test]
    fn the_nearest_are_those_of_a_search_through_all() {
        let mut random = Stream::new(1, "buckets");
        for case in 0..60 {
            // Spread evenly, in a row, at few places, with some far off, and few of them.
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
            let mut buckets = Buckets::default();
            buckets.fill(&places);
            for (k, &at) in places.iter().enumerate() {
                let squared = |j: usize| places[j].distance_squared(at);
                let found = buckets.nearest::<6>(k, at, squared);
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
