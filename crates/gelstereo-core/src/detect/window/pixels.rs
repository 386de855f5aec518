//! A window's pixels, its light, and their weights.

use super::lanes::{Weights, darkest, products, step_up, sum_columns, weigh};
use super::size::MarkerSize;
use crate::math::DVec2;
use crate::params::Polarity;

/// Contrasts that count, as shares of that of the window's darkest pixel: noise of the gel lies below, grain
/// of the paint above.
pub(super) const BAND: (f64, f64) = (0.2, 0.7);

/// Fractional bits of levels.
pub(super) const BITS: u32 = 3;

/// Steepest gel, 1 / 256 level per pixel.
const MAX_SLOPE: i32 = 256;

/// What is added to levels without carry so that markers are dark.
pub(in crate::detect) const fn flip(polarity: Polarity) -> u8 {
    match polarity {
        Polarity::Dark => 0,
        Polarity::Bright => u8::MAX,
    }
}

/// The gel of a window as a plane, and its darkest pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gel {
    /// In the middle, with [`BITS`].
    pub level: i32,
    /// Slopes along a row and down, 1 / 256 level per pixel.
    pub along: i32,
    pub down: i32,
    /// Of the corners, from the darkest to the brightest, with [`BITS`].
    pub uneven: i32,
    /// Contrast of the darkest pixel, with [`BITS`].
    pub depth: i32,
}

impl Gel {
    /// Contrast from which weights begin, with [`BITS`], and over which they grow, grey levels.
    pub(super) fn band(&self) -> (i32, u8) {
        let share = |share: f64| (share * f64::from(self.depth)) as i32;
        (share(BAND.0), (share(BAND.1 - BAND.0) >> BITS).clamp(1, 255) as u8)
    }
}

/// Where a window lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place<const L: usize> {
    /// First column and row.
    pub first: (usize, usize),
    /// Column of the first lane; the window's own begin with it, or later where the image ends.
    pub begin: usize,
    pub side: usize,
}

impl<const L: usize> Place<L> {
    /// The window whose middle is nearest to a position, or nearest within the image.
    pub(super) fn around(at_px: DVec2, side: usize, (width, height): (usize, usize)) -> Option<Self> {
        // From 32 bits: there is an instruction.
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

/// Which lanes belong to a window, and to its corners.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lanes<const L: usize> {
    /// All ones, or nothing.
    inside: [u8; L],
    /// One, or nothing.
    left: [i16; L],
    right: [i16; L],
}

impl<const L: usize> Lanes<L> {
    /// Of windows that begin with this lane.
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

/// Division of whole numbers by a fixed one, truncated as `/` is, by its reciprocal, which takes a fraction of the time. It is
/// rounded up to so many bits that the quotient is exact while number times divisor is below 2 to the power of [`Self::BITS`].
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

/// The squares in a window's corners where the gel's level is taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corners {
    side_px: usize,
    area: Divisor,
    /// Twice the area by how far they are apart.
    twice_apart: Divisor,
}

impl Corners {
    /// In windows of markers of a size.
    pub(super) fn of(size: &MarkerSize) -> Self {
        let (side, corner) = (size.side_px as i32, size.corner_px() as i32);
        let area = corner * corner;
        let twice_apart = Divisor::of(2 * area * (side - corner));
        Self { side_px: size.corner_px(), area: Divisor::of(area), twice_apart }
    }
}

/// A window's pixels, dark markers on a bright gel.
pub(super) struct Window<'a, const L: usize> {
    pub place: Place<L>,
    pub lanes: &'a Lanes<L>,
    pub rows: &'a mut [[u8; L]],
}

/// Where a window's pixels are kept.
pub(super) struct Room<const L: usize> {
    pub rows: [[u8; L]; L],
    /// Unless they are the usual ones.
    pub lanes: Option<Lanes<L>>,
}

impl<const L: usize> Room<L> {
    pub(super) const fn new() -> Self {
        Self { rows: [[0; L]; L], lanes: None }
    }
}

impl<const L: usize> Window<'_, L> {
    /// The gel by the window's corners.
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

    /// Weights of the window's pixels: how much darker than the gel, less `low`, at most `band`.
    pub(super) fn weigh(&mut self, gel: &Gel, (low, band): (i32, u8)) -> Weights<L> {
        let (lane, side) = (self.place.lane() as i32, self.place.side as i32);
        // Of the brightest row; the others are less by a whole number of levels. All these numbers fit 16 bits.
        let brightest = (gel.level - low + ((side * gel.down.abs()) >> (9 - BITS))) as i16;
        let (along, before) = (gel.along as i16, (gel.along * (2 * lane + side - 1)) as i16);
        let limit: [u8; L] = core::array::from_fn(|x| {
            let along = (2 * x as i16 * along - before) >> (9 - BITS);
            ((brightest + along) >> BITS).clamp(0, 255) as u8 & self.lanes.inside[x]
        });
        let added = side * gel.down.abs() + (side - 1) * gel.down;
        weigh(self.rows, &limit, (added, 2 * gel.down), band);
        Weights::of(self.rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::window::size::MAX_WINDOW_PX;

    /// Of every sum that a window's corners may have, with its fractional bits, and so of every slope.
    #[test]
    fn a_divisor_divides_as_the_operator_does() {
        let largest = (MAX_WINDOW_PX / 5) as i32;
        for corner in 2..=largest {
            let area = corner * corner;
            let most = 255 * area;
            for sum in 0..=8 * most {
                assert_eq!(Divisor::of(area).divide(sum), sum / area);
            }
            for far in 1..MAX_WINDOW_PX as i32 {
                let divisor = 2 * area * far;
                for difference in -2 * most..=2 * most {
                    assert_eq!(Divisor::of(divisor).divide(difference << 8), (difference << 8) / divisor);
                }
            }
        }
    }
}
