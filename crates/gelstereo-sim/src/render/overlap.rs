//! Groups of overlapping regions.

use super::shape::Shape;
use alloc::vec::Vec;

/// Connected components of regions that may overlap.
#[derive(Clone, Debug, Default)]
pub(crate) struct Overlaps {
    /// Regions from the top of the image downwards.
    order: Vec<usize>,
    /// A region of the same group with a lower index; itself for the group's first region.
    towards_first: Vec<usize>,
    /// Size of the group whose first region this is; 0 for other regions.
    members: Vec<usize>,
    /// Regions, group by group.
    grouped: Vec<usize>,
    /// End of each group in `grouped`.
    ends: Vec<usize>,
}

impl Overlaps {
    /// Reserves memory for this many regions.
    pub(crate) fn reserve(&mut self, regions: usize) {
        let Self { order, towards_first, members, grouped, ends } = self;
        for list in [order, towards_first, members, grouped, ends] {
            list.reserve(regions.saturating_sub(list.len()));
        }
    }

    pub(crate) fn find(&mut self, shapes: &[Shape]) {
        let Self { order, towards_first, members, grouped, ends } = self;
        order.clear();
        order.extend(0..shapes.len());
        order.sort_unstable_by(|&a, &b| shapes[a].low.y.total_cmp(&shapes[b].low.y).then(a.cmp(&b)));
        towards_first.clear();
        towards_first.extend(0..shapes.len());
        for (k, &i) in order.iter().enumerate() {
            let upper = &shapes[i];
            let below = order[k + 1..].iter().take_while(|&&j| shapes[j].low.y < upper.high.y);
            for &j in below {
                if upper.may_overlap(&shapes[j]) {
                    let (a, b) = (first(towards_first, i), first(towards_first, j));
                    towards_first[a.max(b)] = a.min(b);
                }
            }
        }
        members.clear();
        members.resize(shapes.len(), 0);
        for i in 0..shapes.len() {
            towards_first[i] = first(towards_first, i);
            members[towards_first[i]] += 1;
        }
        grouped.clear();
        ends.clear();
        for i in (0..shapes.len()).filter(|&i| members[i] > 0) {
            match members[i] {
                1 => grouped.push(i),
                _ => grouped.extend((i..shapes.len()).filter(|&j| towards_first[j] == i)),
            }
            ends.push(grouped.len());
        }
    }

    /// The groups in the order of their first regions, each sorted.
    pub(crate) fn groups(&self) -> impl Iterator<Item = &[usize]> {
        let starts = core::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.grouped[start..end])
    }
}

fn first(towards_first: &[usize], mut region: usize) -> usize {
    while towards_first[region] != region {
        region = towards_first[region];
    }
    region
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::Ellipse;
    use gelstereo_core::math::DVec2;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        /// Against the transitive closure of the overlapping pairs.
        #[test]
        fn groups_are_the_connected_components(
            places in prop::collection::vec((0.0..60.0, 0.0..60.0, 1.0..8.0, 1.0..8.0), 1..30),
        ) {
            let shape = |&(x, y, a, b): &(f64, f64, f64, f64)| {
                let half_px = [DVec2::new(a, 0.0), DVec2::new(0.0, b)];
                Shape::ellipse(&Ellipse { centre_px: DVec2::new(x, y), half_px })
            };
            let shapes: Vec<Shape> = places.iter().filter_map(shape).collect();
            let n = shapes.len();
            let mut joined: Vec<Vec<bool>> =
                shapes.iter().map(|a| shapes.iter().map(|b| a.may_overlap(b)).collect()).collect();
            for k in 0..n {
                for i in 0..n {
                    for j in 0..n {
                        joined[i][j] |= joined[i][k] && joined[k][j];
                    }
                }
            }
            let mut overlaps = Overlaps::default();
            overlaps.find(&shapes);
            let component = |row: &Vec<bool>| (0..n).filter(|&j| row[j]).collect::<Vec<_>>();
            let all = joined.iter().map(component).enumerate();
            let expected = all.filter(|(i, component)| component[0] == *i).map(|(_, component)| component);
            prop_assert!(overlaps.groups().eq(expected));
        }
    }
}
