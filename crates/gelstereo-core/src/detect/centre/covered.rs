//! Centre uncertainty of partly covered markers.

use crate::detect::markers::Markers;
use crate::detect::mask::blob_filter::AREA_SPREAD;
use crate::detect::mask::usual_area::usual_area_px2;
use crate::image::{GrayView, reaches};
use crate::math::{DVec2, abs, ceil, sqrt};
use crate::spatial::Grid;
use alloc::vec::Vec;
use core::f64::consts::FRAC_1_PI;
use core::ops::Range;

/// Least grey level of a light's reflection, which saturates the sensor; gel does not.
pub(in crate::detect) const GLARE_LEVEL: u8 = 250;
/// Number of pixels that may be that bright by chance.
const FEW: usize = 2;
/// Width around a marker's outline that its centre depends on, pixels.
const AROUND_PX: f64 = 3.0;
/// Least share of a marker hidden by a reflection beside it, given where the reflection spreads. Without a
/// fit, the normalised squared error of points under glints is 1.32, 1.05 and 0.95 with 0, 0.05 and 0.1
/// (preset `fast`, path-traced working images).
const MIN_HIDDEN: f64 = 0.05;
/// Width of the ring around a marker's outline that a reflection saturates where it cuts the marker, pixels:
/// where the edge ends and where the gel's level is read.
const RING_PX: (f64, f64) = (0.3, 2.5);
/// Standard deviation of a coordinate, as a share of the radius, over the saturated share of that ring and
/// the share by which blur lengthens it. There the edge is displaced by up to the radius. Drawn discs under
/// smears (other seeds than those evaluated) give 0.8 to 0.3 by share, and the path-traced working images 0.4
/// to 0.8.
const PER_SATURATED: f64 = 0.5;
const BY_BLUR: f64 = 0.02;
/// Neighbours whose areas a marker is compared with: those around it on a square lattice.
const NEIGHBOURS: usize = 8;
/// Side of the cells in which reflections are recorded: about that of a marker's square.
const CELL_PX: usize = 16;

/// Columns and rows of the square that the centre of a marker of this radius depends on.
fn square(image: GrayView<'_>, centre_px: DVec2, radius_px: f64) -> (Range<usize>, Range<usize>) {
    let reach = ceil(radius_px + AROUND_PX);
    let range = |at: f64, size: usize| {
        let (first, end) =
            ((at - reach).max(0.0) as usize, (at + reach + 1.0).clamp(0.0, size as f64) as usize);
        first.min(end)..end
    };
    (range(centre_px.x, image.width()), range(centre_px.y, image.height()))
}

/// Whether a light's reflection is in the square around a marker of this radius.
pub(in crate::detect) fn is_under_glare(image: GrayView<'_>, centre_px: DVec2, radius_px: f64) -> bool {
    let (columns, rows) = square(image, centre_px, radius_px);
    let bright =
        |y: usize| image.row(y)[columns.clone()].iter().filter(|&&level| level >= GLARE_LEVEL).count();
    rows.map(bright).sum::<usize>() > FEW
}

/// Standard deviation of a coordinate of a marker of this radius that a reflection cuts, as a share of its
/// radius; 0 if none does. It grows with the reflection's pixels on the marker and in the ring around it.
fn cut_share(image: GrayView<'_>, centre_px: DVec2, radius_px: f64) -> f64 {
    let (columns, rows) = square(image, centre_px, radius_px);
    let [inner_px2, outer_px2] = [RING_PX.0, RING_PX.1].map(|px| (radius_px + px) * (radius_px + px));
    let (mut bright, mut ring) = (0_u32, 0_u32);
    for y in rows {
        for (x, &level) in columns.clone().zip(&image.row(y)[columns.clone()]) {
            let far_px2 = DVec2::new(x as f64, y as f64).distance_squared(centre_px);
            bright += u32::from(level >= GLARE_LEVEL && far_px2 <= outer_px2);
            ring += u32::from((inner_px2..=outer_px2).contains(&far_px2));
        }
    }
    let share = (f64::from(bright) / f64::from(ring.max(1))).min(1.0);
    if bright > 0 { PER_SATURATED * (share + BY_BLUR) } else { 0.0 }
}

/// Map of the light reflections in an image, in square cells.
#[derive(Clone, Debug, Default)]
pub(in crate::detect) struct Glares {
    has_any: Vec<bool>,
    columns: usize,
}

impl Glares {
    /// Reserves memory for images of this size.
    pub fn reserve(&mut self, (width, height): (usize, usize)) {
        self.columns = width.div_ceil(CELL_PX);
        self.has_any.clear();
        self.has_any.resize(self.columns * height.div_ceil(CELL_PX), false);
    }

    /// Finds the reflections; returns whether there are any. Does not allocate if an earlier image was as
    /// large.
    fn find(&mut self, image: GrayView<'_>) -> bool {
        self.reserve((image.width(), image.height()));
        let is_bright = |pixels: &[u8]| reaches(pixels, GLARE_LEVEL);
        let mut found = false;
        for y in (0..image.height()).filter(|&y| is_bright(image.row(y))) {
            found = true;
            let cells = &mut self.has_any[y / CELL_PX * self.columns..];
            for (cell, pixels) in cells.iter_mut().zip(image.row(y).chunks(CELL_PX)) {
                *cell |= is_bright(pixels);
            }
        }
        found
    }

    /// Whether some reflection may be in this square.
    fn may_reach(&self, (columns, rows): &(Range<usize>, Range<usize>)) -> bool {
        let cells = |range: &Range<usize>| range.start / CELL_PX..range.end.div_ceil(CELL_PX);
        cells(rows).any(|row| self.has_any[row * self.columns..][cells(columns)].contains(&true))
    }

    /// Raises the variance of markers that a light's reflection may hide in part; `areas_px2` is scratch.
    /// Neither a fitted disc nor the pixels' contrast shows that a part is missing at the rim. With
    /// `by_area`, the area shows how much is missing.
    pub fn doubt(
        &mut self,
        image: GrayView<'_>,
        by_area: bool,
        areas_px2: &mut Vec<u32>,
        markers: &mut Markers,
    ) {
        if !self.find(image) {
            return;
        }
        areas_px2.clear();
        areas_px2.extend_from_slice(&markers.area_px2);
        let usual_px2 = usual_area_px2(areas_px2);
        let radius_px = sqrt(usual_px2 * FRAC_1_PI);
        let places = markers.centres_px.iter().zip(&markers.area_px2);
        for ((&centre_px, &area_px2), [[xx, _], [_, yy]]) in places.zip(&mut markers.covariance_px2) {
            let is_near = usual_px2 > 0.0 && self.may_reach(&square(image, centre_px, radius_px));
            if is_near && is_under_glare(image, centre_px, radius_px) {
                let area_px2 = f64::from(area_px2);
                let min = if by_area {
                    variance_px2(image, centre_px, area_px2, usual_px2)
                } else {
                    let cut_px = radius_px * cut_share(image, centre_px, sqrt(area_px2 * FRAC_1_PI));
                    cut_px * cut_px
                };
                (*xx, *yy) = (xx.max(min), yy.max(min));
            }
        }
    }
}

/// Variance of a coordinate, px², of a marker without a model fit. A covered part shifts the centroid of
/// the rest by the radius times the hidden share, which follows from its area relative to the usual one.
pub(in crate::detect) fn variance_px2(
    image: GrayView<'_>,
    centre_px: DVec2,
    area_px2: f64,
    usual_px2: f64,
) -> f64 {
    if !(usual_px2 > 0.0) {
        return 0.0;
    }
    let radius_px = sqrt(usual_px2 * FRAC_1_PI);
    let differs = abs(1.0 - area_px2 / usual_px2);
    let hidden = if is_under_glare(image, centre_px, radius_px) {
        differs.max(MIN_HIDDEN).max(cut_share(image, centre_px, sqrt(area_px2 * FRAC_1_PI)))
    } else {
        (differs - AREA_SPREAD).max(0.0)
    };
    (radius_px * hidden) * (radius_px * hidden)
}

/// As [`variance_px2`], for a listed marker without a model fit, relative to the markers around it, which
/// `grid` has sorted. Perspective and a curved gel make areas of uncovered markers vary over the image.
pub(in crate::detect) fn unfitted_px2(
    image: GrayView<'_>,
    markers: &Markers,
    grid: &Grid,
    index: usize,
) -> f64 {
    let (centre_px, area_px2) = (markers.centres_px[index], markers.area_px2[index]);
    let (min, max) = areas_around_px2(markers, grid, index);
    let usual_px2 = area_px2.clamp(min, max);
    variance_px2(image, centre_px, f64::from(area_px2), f64::from(usual_px2))
}

/// Whether a part of a listed marker whose model was fitted may be hidden: its area differs from the usual
/// one, which no reflection explains. [`unfitted_px2`] is its variance then.
pub(in crate::detect) fn may_be_hidden(
    image: GrayView<'_>,
    markers: &Markers,
    index: usize,
    usual_px2: f64,
) -> bool {
    let is_usual = abs(1.0 - f64::from(markers.area_px2[index]) / usual_px2) <= AREA_SPREAD;
    !is_usual && !is_under_glare(image, markers.centres_px[index], sqrt(usual_px2 * FRAC_1_PI))
}

/// Range of the areas of the markers nearest to a listed one, without the smallest and largest, since one
/// may be covered too. Unlimited with too few markers.
fn areas_around_px2(markers: &Markers, grid: &Grid, index: usize) -> (u32, u32) {
    let (centres_px, own_px) = (&markers.centres_px, markers.centres_px[index]);
    let squared = |other: usize| centres_px[other].distance_squared(own_px);
    let nearest = grid.nearest_others::<NEIGHBOURS>(index, own_px, squared);
    if !nearest[NEIGHBOURS - 1].0.is_finite() {
        return (0, u32::MAX);
    }
    let mut areas_px2 = nearest.map(|(_, other)| markers.area_px2[other as usize]);
    areas_px2.sort_unstable();
    (areas_px2[1], areas_px2[NEIGHBOURS - 2])
}

/// As [`variance_px2`], for a marker without a band because something touches it; 0 for others.
pub(in crate::detect) fn without_band_px2(
    band: u8,
    image: GrayView<'_>,
    centre_px: DVec2,
    area_px2: u32,
    usual_px2: f64,
) -> f64 {
    if band == 0 { variance_px2(image, centre_px, f64::from(area_px2), usual_px2) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::random::Stream;
    use proptest::prelude::*;

    proptest! {
        /// The eight nearest markers of all, whichever bucket they are in; too few limit nothing.
        #[test]
        fn areas_around_are_those_of_a_search_through_all(
            count in 1_usize..120, side_px in 0.5..30.0_f64, seed in any::<u64>(),
        ) {
            let mut random = Stream::new(seed, "areas");
            let mut markers = Markers::default();
            for _ in 0..count {
                let at = DVec2::new(random.uniform() * 640.0, random.uniform() * 480.0);
                markers.centres_px.push(at);
                markers.area_px2.push(1 + random.below(90) as u32);
            }
            let mut grid = Grid::default();
            grid.build_evenly(markers.centres_px.iter().copied(), side_px);
            for (own, own_px) in markers.centres_px.iter().enumerate() {
                let mut others: Vec<usize> = (0..count).filter(|&other| other != own).collect();
                let squared = |other: usize| markers.centres_px[other].distance_squared(*own_px);
                others.sort_by(|&a, &b| squared(a).total_cmp(&squared(b)));
                let expected = others.get(..NEIGHBOURS).map_or((0, u32::MAX), |nearest| {
                    let mut areas: Vec<u32> = nearest.iter().map(|&other| markers.area_px2[other]).collect();
                    areas.sort_unstable();
                    (areas[1], areas[NEIGHBOURS - 2])
                });
                prop_assert_eq!(areas_around_px2(&markers, &grid, own), expected);
            }
        }
    }
}
