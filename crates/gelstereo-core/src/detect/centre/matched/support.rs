//! Which pixels around a centre count.

use crate::math::DVec2;

/// A square of pixels around the one nearest to the centre; those within a circle count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Support {
    pub side: usize,
    pub radius_px: f64,
}

impl Support {
    /// Pixels up to `radius_px` from the centre, wherever in the middle pixel that lies.
    pub fn new(radius_px: f64) -> Self {
        Self { side: 2 * (radius_px as usize) + 1, radius_px }
    }

    pub const fn half(self) -> usize {
        self.side / 2
    }

    /// Places of all pixels, row by row, relative to the middle one.
    pub fn places(self) -> impl Iterator<Item = DVec2> {
        let half = self.half() as f64;
        (0..self.side * self.side)
            .map(move |n| DVec2::new((n % self.side) as f64 - half, (n / self.side) as f64 - half))
    }

    pub fn has(self, place: DVec2) -> bool {
        place.length_squared() <= self.radius_px * self.radius_px
    }

    /// As [`Self::has`], so many columns and rows from the middle.
    pub fn has_at(self, columns: usize, rows: usize) -> bool {
        self.has(DVec2::new(columns as f64, rows as f64))
    }
}
