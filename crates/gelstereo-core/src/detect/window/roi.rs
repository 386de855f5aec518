//! Regions of interest around expected marker positions.

use crate::math::DVec2;

/// Largest number of columns and rows of a window.
pub const MAX_ROI_PX: usize = 64;

/// Region of an image around an expected position, as half-open ranges of columns and rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// First column and row.
    pub first: (usize, usize),
    /// One past the last column and row.
    pub end: (usize, usize),
}

impl Window {
    /// Pixels within `reach_px` of a position in each axis, clipped to an image of this size; `None` if
    /// there are none.
    #[must_use]
    pub fn around(position_px: DVec2, reach_px: f64, size_px: (usize, usize)) -> Option<Self> {
        if !position_px.is_finite() || !(reach_px >= 0.0) {
            return None;
        }
        let reach_px = reach_px.min((MAX_ROI_PX / 2 - 1) as f64);
        let side = |at: f64, size: usize| {
            let first = crate::math::ceil(at - reach_px).max(0.0);
            let end = (crate::math::floor(at + reach_px) + 1.0).min(size as f64);
            (first < end).then_some((first as usize, end as usize))
        };
        let (x, y) = (side(position_px.x, size_px.0)?, side(position_px.y, size_px.1)?);
        Some(Self { first: (x.0, y.0), end: (x.1, y.1) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::abs;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    proptest! {
        /// A window has the pixels within reach along both axes, and no others.
        #[test]
        fn a_window_has_the_pixels_within_reach(
            x in -20.0..40.0_f64, y in -20.0..40.0_f64, reach_px in 0.0..30.0_f64, whole in any::<bool>(),
        ) {
            let size_px = (24, 17);
            let round = |at: f64| if whole { crate::math::round(at) } else { at };
            let (at, reach_px) = (DVec2::new(round(x), round(y)), round(reach_px));
            let near = |at: f64, size: usize| -> Vec<usize> {
                (0..size).filter(|&k| abs(k as f64 - at) <= reach_px).collect()
            };
            let (columns, rows) = (near(at.x, size_px.0), near(at.y, size_px.1));
            match Window::around(at, reach_px, size_px) {
                None => prop_assert!(columns.is_empty() || rows.is_empty()),
                Some(Window { first, end }) => {
                    prop_assert_eq!(columns, (first.0..end.0).collect::<Vec<_>>());
                    prop_assert_eq!(rows, (first.1..end.1).collect::<Vec<_>>());
                }
            }
        }
    }
}
