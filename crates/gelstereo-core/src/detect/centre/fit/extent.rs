//! Pixels of a window around a marker.

use crate::math::sqrt;

/// Pixels within a circle around a pixel, clipped to the image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Extent {
    /// Squared radius, px².
    radius2: i64,
    /// First and last column and row relative to the middle, limited by the image and the radius.
    pub columns: (i64, i64),
    pub rows: (i64, i64),
}

impl Extent {
    /// Extent in an unbounded image.
    pub fn whole(radius_px: f64) -> Self {
        let extent = Self { radius2: (radius_px * radius_px) as i64, ..Self::default() };
        let reach = extent.reach();
        Self { columns: (-reach, reach), rows: (-reach, reach), ..extent }
    }

    pub fn reach(&self) -> i64 {
        sqrt(self.radius2 as f64) as i64
    }

    /// First column and number of columns of each row.
    pub fn spans(&self) -> impl Iterator<Item = (i64, i64, usize)> {
        let Self { radius2, columns, rows } = *self;
        (rows.0..=rows.1).map(move |y| {
            let half = sqrt((radius2 - y * y).max(0) as f64) as i64;
            let (first, last) = (columns.0.max(-half), columns.1.min(half));
            (y, first, (last + 1 - first).max(0) as usize)
        })
    }
}
