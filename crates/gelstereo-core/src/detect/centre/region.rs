//! Image region of the marker lattice.

use crate::math::{DVec2, ceil, floor};
use alloc::vec::Vec;
use core::ops::Range;

/// Least number of markers for a region; fewer may lie anywhere.
const MIN_MARKERS: usize = 16;
/// Share of the markers beyond each side. It excludes dirt beside the gel, which is also detected as
/// markers, and the outermost rows of 17 markers or more, where the light falls off at the gel's edge. On
/// path-traced images 0.01 leaves spurious grain of 0.8 to 1.3 levels², and 0.06 leaves 0.1 to 0.4.
const BEYOND: f64 = 0.06;

/// Octagon: x, y, x + y and x - y each between two limits, pixels. Lattices of any orientation fill most
/// of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Region {
    low: [f64; 4],
    high: [f64; 4],
}

impl Region {
    /// Octagon around all markers but 6 % beyond each side; `None` for fewer than 16. Does not allocate
    /// if `scratch` has room for all of them.
    #[must_use]
    pub fn around(centres_px: &[DVec2], scratch: &mut Vec<f64>) -> Option<Self> {
        if centres_px.len() < MIN_MARKERS {
            return None;
        }
        let beyond = (BEYOND * centres_px.len() as f64) as usize;
        let mut region = Self::default();
        for (side, along) in ALONG.iter().enumerate() {
            scratch.clear();
            scratch.extend(centres_px.iter().map(|&at| along.dot(at)));
            let (_, high, _) = scratch.select_nth_unstable_by(centres_px.len() - 1 - beyond, f64::total_cmp);
            region.high[side] = *high;
            region.low[side] = *scratch.select_nth_unstable_by(beyond, f64::total_cmp).1;
        }
        Some(region)
    }

    /// Columns of a row inside the region, for an image of this width.
    #[must_use]
    pub fn columns(&self, row: usize, width: usize) -> Range<usize> {
        let y = row as f64;
        let Self { low, high } = self;
        if y < low[1] || y > high[1] {
            return 0..0;
        }
        let first = ceil(low[0].max(low[2] - y).max(low[3] + y)).clamp(0.0, width as f64) as usize;
        let end = (floor(high[0].min(high[2] - y).min(high[3] + y)) + 1.0).clamp(0.0, width as f64) as usize;
        first..end.max(first)
    }
}

/// Directions of the limits.
const ALONG: [DVec2; 4] =
    [DVec2::new(1.0, 0.0), DVec2::new(0.0, 1.0), DVec2::new(1.0, 1.0), DVec2::new(1.0, -1.0)];

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Markers `pitch_px` apart, rotated about (160, 120).
    fn lattice(side: usize, pitch_px: f64, turn_rad: f64) -> Vec<DVec2> {
        let turn = DVec2::new(libm::cos(turn_rad), libm::sin(turn_rad));
        let middle = 0.5 * (side - 1) as f64;
        let at = |n: usize| DVec2::new((n % side) as f64 - middle, (n / side) as f64 - middle);
        (0..side * side).map(|n| at(n).rotate(turn) * pitch_px + DVec2::new(160.0, 120.0)).collect()
    }

    proptest! {
        /// For any orientation, dirt beyond the lattice is excluded and nearly all markers are included.
        #[test]
        fn a_region_holds_the_lattice_and_not_what_lies_beside_it(
            side in 15..40_usize, turn_rad in 0.0..1.6_f64, dirt in 0..2_usize,
        ) {
            let mut centres_px = lattice(side, 160.0 / side as f64, turn_rad);
            let clean = centres_px.len();
            centres_px.extend([DVec2::new(3.0, 4.0), DVec2::new(317.0, 236.0)].iter().take(dirt));
            let region = Region::around(&centres_px, &mut Vec::new()).unwrap();
            let is_in = |at: &DVec2| {
                let row = at.y as usize;
                region.columns(row, 320).contains(&(at.x as usize))
            };
            let inside = centres_px[..clean].iter().filter(|at| is_in(at)).count();
            // At most 6 % beyond each of four sides, the corners beyond the four others, and those on a side.
            prop_assert!(inside as f64 >= 0.55 * clean as f64, "{} of {}", inside, clean);
            prop_assert!(centres_px[clean..].iter().all(|at| !is_in(at)));
        }
    }

    #[test]
    fn a_region_of_few_markers_is_not_known() {
        assert_eq!(Region::around(&lattice(3, 10.0, 0.0), &mut Vec::new()), None);
    }

    #[test]
    fn columns_lie_within_the_image() {
        let region = Region { low: [-5.0, 2.0, 0.0, -100.0], high: [400.0, 90.0, 500.0, 400.0] };
        assert_eq!(region.columns(1, 320), 0..0);
        assert_eq!(region.columns(2, 320), 0..320);
        assert_eq!(region.columns(90, 320), 0..320);
        assert_eq!(region.columns(91, 320), 0..0);
    }
}
