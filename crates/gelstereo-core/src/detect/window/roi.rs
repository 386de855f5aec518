//! Parts of an image that are searched for one marker.

use crate::math::DVec2;

/// Most columns and rows of a window.
pub const MAX_ROI_PX: usize = 64;

/// Part of an image around an expected position: columns and rows from the first to one past the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// First column and row.
    pub first: (usize, usize),
    /// One past the last column and row.
    pub end: (usize, usize),
}

impl Window {
    /// The pixels up to `reach_px` away from a position in each axis, as far as they lie within an image of this size; `None`
    /// if none do.
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
