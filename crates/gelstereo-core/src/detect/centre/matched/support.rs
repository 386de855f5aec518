//! Pixels around a centre that are used.

use crate::math::DVec2;

/// Square of pixels around the one nearest to the centre; those within a circle are used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Support {
    pub side: usize,
    pub radius_px: f64,
}

impl Support {
    /// Pixels up to `radius_px` from the centre, for any position in the middle pixel.
    pub fn new(radius_px: f64) -> Self {
        Self { side: 2 * (radius_px as usize) + 1, radius_px }
    }

    pub const fn half(self) -> usize {
        self.side / 2
    }

    /// Positions of all pixels, row by row, relative to the middle one.
    pub fn places(self) -> impl Iterator<Item = DVec2> {
        let half = self.half() as f64;
        (0..self.side * self.side)
            .map(move |n| DVec2::new((n % self.side) as f64 - half, (n / self.side) as f64 - half))
    }

    pub fn has(self, place: DVec2) -> bool {
        place.length_squared() <= self.radius_px * self.radius_px
    }

    /// As [`Self::has`], for an offset of columns and rows from the middle.
    pub fn has_at(self, columns: usize, rows: usize) -> bool {
        self.has(DVec2::new(columns as f64, rows as f64))
    }
}
