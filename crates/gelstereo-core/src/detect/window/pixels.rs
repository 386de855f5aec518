//! Pixels of a window, its gel plane and the pixel weights.

use super::lanes::{Weights, darkest, products, step_up, sum_columns, weigh};
use super::size::MarkerSize;
use crate::math::DVec2;
use crate::params::Polarity;

/// Contrast range that is weighted, as shares of the darkest pixel's contrast. Gel noise lies below,
/// paint grain above.
pub(super) const BAND: (f64, f64) = (0.2, 0.7);

/// Fractional bits of levels.
pub(super) const BITS: u32 = 3;

/// Largest gel slope, 1 / 256 level per pixel.
const MAX_SLOPE: i32 = 256;

/// XOR mask that makes markers dark.
pub(in crate::detect) const fn flip(polarity: Polarity) -> u8 {
    match polarity {
        Polarity::Dark => 0,
        Polarity::Bright => u8::MAX,
    }
}

/// Gel of a window as a plane, and its darkest pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gel {
    /// Level in the middle, with [`BITS`].
    pub level: i32,
    /// Slopes along a row and down a column, 1 / 256 level per pixel.
    pub along: i32,
    pub down: i32,
    /// Range of the corner levels, darkest to brightest, with [`BITS`].
    pub uneven: i32,
    /// Contrast of the darkest pixel, with [`BITS`].
    pub depth: i32,
}

impl Gel {
    /// Contrast at which weights begin, with [`BITS`], and range over which they grow, grey levels.
    pub(super) fn band(&self) -> (i32, u8) {
        let share = |share: f64| (share * f64::from(self.depth)) as i32;
        (share(BAND.0), (share(BAND.1 - BAND.0) >> BITS).clamp(1, 255) as u8)
    }
}

/// Position of a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place<const L: usize> {
    /// First column and row.
    pub first: (usize, usize),
    /// Column of lane 0. The window's first column is lane 0, or a later one near the image's right border.
    pub begin: usize,
    pub side: usize,
}

impl<const L: usize> Place<L> {
    /// Window whose middle is nearest to a position, as far as the image allows.
    pub(super) fn around(at_px: DVec2, side: usize, (width, height): (usize, usize)) -> Option<Self> {
        // Via 32 bits, for which there is a conversion instruction.
        let float = |size: usize| f64::from(size as u32);
        let inside = |at: f64, size: usize| at >= 0.0 && at <= float(size) - 1.0;
        if width < L || height < side || side > L || !inside(at_px.x, width) || !inside(at_px.y, height) {
            return None;
        }
        let half = 0.5 * (float(side) - 2.0);
        let first = |at: f64, size: usize| (at - half).clamp(0.0, float(size - side)) as u32 as usize;
        let first = (first(at_px.x, width), first(at_px.y, height));
        Some(Self { first, begin: first.0.min(width - L), side })
    }

    pub(super) const fn lane(&self) -> usize {
        self.first.0 - self.begin
    }

    pub(super) fn middle_px(&self) -> DVec2 {
        DVec2::new(self.first.0 as f64, self.first.1 as f64) + 0.5 * (self.side as f64 - 1.0)
    }
}

/// Masks of the lanes in a window and in its corners.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lanes<const L: usize> {
    /// All ones inside, 0 outside.
    inside: [u8; L],
    /// 1 inside, 0 outside.
    left: [i16; L],
    right: [i16; L],
}

impl<const L: usize> Lanes<L> {
    /// Masks for windows whose first column is this lane.
    pub(super) fn of(lane: usize, size: &MarkerSize) -> Self {
        let within = |first: usize, end: usize| -> [u8; L] {
            let (rise, fall) = (step_up::<L>(lane + first), step_up::<L>(lane + end));
            core::array::from_fn(|x| rise[x] & !fall[x])
        };
        let (side, corner) = (size.side_px, size.corner_px());
        let ones = |first: usize| within(first, first + corner).map(|on| i16::from(on & 1));
        Self { inside: within(0, side), left: ones(0), right: ones(side - corner) }
    }
}

/// Integer division by a constant, truncated like `/`, as a much faster multiplication by the reciprocal.
/// The reciprocal is rounded up; the quotient is exact while number times divisor is below 2 to the power
/// of [`Self::BITS`].
#[derive(Clone, Copy, Debug)]
struct Divisor {
    reciprocal: i64,
}

impl Divisor {
    const BITS: u32 = 38;

    fn of(divisor: i32) -> Self {
        Self { reciprocal: (1 << Self::BITS) / i64::from(divisor) + 1 }
    }

    fn divide(self, number: i32) -> i32 {
        ((i64::from(number) * self.reciprocal) >> Self::BITS) as i32 + i32::from(number < 0)
    }
}

/// Squares in a window's corners where the gel's level is measured.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corners {
    side_px: usize,
    area: Divisor,
    /// Twice their area times the distance between them.
    twice_apart: Divisor,
}

impl Corners {
    /// Corners of windows for markers of this size.
    pub(super) fn of(size: &MarkerSize) -> Self {
        let (side, corner) = (size.side_px as i32, size.corner_px() as i32);
        let area = corner * corner;
        let twice_apart = Divisor::of(2 * area * (side - corner));
        Self { side_px: size.corner_px(), area: Divisor::of(area), twice_apart }
    }
}

/// Pixels of a window, dark markers on a bright gel.
pub(super) struct Window<'a, const L: usize> {
    pub place: Place<L>,
    pub lanes: &'a Lanes<L>,
    pub rows: &'a mut [[u8; L]],
}

/// Buffer for a window's pixels.
pub(super) struct Room<const L: usize> {
    pub rows: [[u8; L]; L],
    /// Lane masks that differ from the usual ones.
    pub lanes: Option<Lanes<L>>,
}

impl<const L: usize> Room<L> {
    pub(super) const fn new() -> Self {
        Self { rows: [[0; L]; L], lanes: None }
    }
}

impl<const L: usize> Window<'_, L> {
    /// Fits the gel plane to the window's corners.
    #[inline(always)]
    pub(super) fn gel(&self, corners: &Corners) -> Gel {
        let (corner, far) = (corners.side_px, self.place.side - corners.side_px);
        let darkest = darkest(self.rows, &self.lanes.inside);
        let sums = |first: usize| {
            let columns = sum_columns(&self.rows[first..first + corner]);
            (products(&columns, &self.lanes.left), products(&columns, &self.lanes.right))
        };
        let ((a, b), (c, d)) = (sums(0), sums(far));
        let per_px =
            |difference: i32| corners.twice_apart.divide(difference << 8).clamp(-MAX_SLOPE, MAX_SLOPE);
        let level = corners.area.divide((a + b + c + d) << (BITS - 2));
        let uneven = corners.area.divide((a.max(b).max(c).max(d) - a.min(b).min(c).min(d)) << BITS);
        let depth = (level - (i32::from(darkest) << BITS)).max(0);
        Gel { level, along: per_px(b + d - a - c), down: per_px(c + d - a - b), uneven, depth }
    }

    /// Weights of the window's pixels: contrast to the gel minus `low`, from 0 to `band`.
    pub(super) fn weigh(&mut self, gel: &Gel, low: i32, band: u8) -> Weights<L> {
        let (lane, side) = (self.place.lane() as i32, self.place.side as i32);
        // Limit of the brightest row; other rows are lower by whole levels. All values fit 16 bits.
        let brightest = (gel.level - low + ((side * gel.down.abs()) >> (9 - BITS))) as i16;
        let (along, before) = (gel.along as i16, (gel.along * (2 * lane + side - 1)) as i16);
        let limit: [u8; L] = core::array::from_fn(|x| {
            let along = (2 * x as i16 * along - before) >> (9 - BITS);
            ((brightest + along) >> BITS).clamp(0, 255) as u8 & self.lanes.inside[x]
        });
        let added = side * gel.down.abs() + (side - 1) * gel.down;
        weigh(self.rows, &limit, added, 2 * gel.down, band);
        Weights::of(self.rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::window::size::MAX_WINDOW_PX;

    /// Tests every sum possible in a window's corners, with fractional bits, and so every slope.
    #[test]
    fn a_divisor_divides_as_the_operator_does() {
        let largest = (MAX_WINDOW_PX / 5) as i32;
        for corner in 2..=largest {
            let area = corner * corner;
            let max = 255 * area;
            for sum in 0..=8 * max {
                assert_eq!(Divisor::of(area).divide(sum), sum / area);
            }
            for far in 1..MAX_WINDOW_PX as i32 {
                let divisor = 2 * area * far;
                for difference in -2 * max..=2 * max {
                    assert_eq!(Divisor::of(divisor).divide(difference << 8), (difference << 8) / divisor);
                }
            }
        }
    }
}
