//! Rows of a hexagonal lattice, of which every second one is shifted by half a pitch.
//!
//! The finder knows rows and columns only, so a hexagonal lattice has places along two of its three steps.
//! Three directions can be rows: the print's own are those that fill a rectangle.

use super::found::{FoundLattice, Place, Sites};
use crate::math::{DVec2, abs};
use alloc::vec::Vec;

/// Two directions of rows that fill their rectangles alike, to this share, are told by the image's upright.
const EQUALLY_FULL: f64 = 0.05;

/// An outer row or column with fewer than this share of its markers does not count for how full a rectangle
/// is.
const STRAYS: f64 = 0.2;

/// Rows whose directions differ by less than this cosine from the other view's are the same: 30 degrees is
/// half-way between two directions.
const SAME_ROWS: f64 = 0.866;

/// Sine of the angle from upright within which rows run downwards: 5 degrees, so that noise does not decide.
const UPRIGHT: f64 = 0.087;

/// A hexagonal lattice with places along its rows (columns) and down to the right (rows).
#[derive(Clone, Debug)]
pub(crate) struct HexagonalSites {
    pub sites: Sites,
    /// Whether odd rows start half a pitch ahead of even ones.
    pub odd_rows_forward: bool,
}

impl HexagonalSites {
    /// Names rows and columns. With the other view's rows, they are the same ones.
    pub fn of(found: &FoundLattice, points: &[DVec2], other_row_px: Option<DVec2>) -> Option<Self> {
        let [along, down] = mean_steps(found, points)?;
        // Six steps, clockwise, each 60 degrees from the last one.
        let [second, third] = if along.dot(down) > 0.0 { [(0, 1), (-1, 1)] } else { [(1, 1), (0, 1)] };
        let steps = [(1, 0), second, third, (-1, 0), (-second.0, -second.1), (-third.0, -third.1)];
        let in_image = |(col, row): (i32, i32)| along * f64::from(col) + down * f64::from(row);
        let is_wanted = |&k: &usize| {
            let row = in_image(steps[k]).normalize_or_zero();
            match other_row_px {
                Some(other) => row.dot(other.normalize_or_zero()) > SAME_ROWS,
                None => row.x > UPRIGHT || (abs(row.x) <= UPRIGHT && row.y > 0.0),
            }
        };
        let mut best: Option<(f64, f64, Self)> = None;
        for k in (0..6).filter(is_wanted) {
            let upright = abs(in_image(steps[k]).normalize_or_zero().x);
            let sites = along_rows(found, steps[k], steps[(k + 1) % 6]);
            let [forward, backward] = [true, false].map(|forward| fullness(&offset(&sites, forward)));
            let (full, odd_rows_forward) = (forward.max(backward), forward >= backward);
            let is_better = best.as_ref().is_none_or(|&(most, level, _)| {
                full > most + EQUALLY_FULL || (abs(full - most) <= EQUALLY_FULL && upright > level)
            });
            if is_better {
                best = Some((full, upright, Self { sites, odd_rows_forward }));
            }
        }
        best.map(|(_, _, named)| named)
    }
}

/// Mean steps along the finder's rows and columns, in the image of these points.
fn mean_steps(found: &FoundLattice, points: &[DVec2]) -> Option<[DVec2; 2]> {
    let sites = found.sites();
    let mut sums = [(DVec2::ZERO, 0.0); 2];
    for place in sites.places() {
        for (sum, step) in sums.iter_mut().zip([(0, 1), (1, 0)]) {
            if let (Some(here), Some(next)) = (sites.at(place), sites.at(place.step(step))) {
                *sum = (sum.0 + points[next] - points[here], sum.1 + 1.0);
            }
        }
    }
    let steps = sums.map(|(sum, count)| sum / count);
    steps.iter().all(|step| step.is_finite()).then_some(steps)
}

/// The lattice with columns along one step and rows along another one, both in the finder's columns and rows.
fn along_rows(found: &FoundLattice, along: (i32, i32), down: (i32, i32)) -> Sites {
    // The two steps are neighbours among the six, so their determinant is 1.
    let place = |from: Place| {
        Place::new(along.0 * from.row - along.1 * from.col, from.col * down.1 - from.row * down.0)
    };
    sites_of(found.places.iter().enumerate().filter_map(|(m, at)| Some((place((*at)?), m))).collect())
}

/// Places counted from the first row and column.
fn sites_of(placed: Vec<(Place, usize)>) -> Sites {
    let first = |of: fn(&Place) -> i32| placed.iter().map(|(place, _)| of(place)).min().unwrap_or(0);
    let last = |of: fn(&Place) -> i32| placed.iter().map(|(place, _)| of(place)).max().unwrap_or(-1);
    let (top, left) = (first(|p| p.row), first(|p| p.col));
    let (bottom, right) = (last(|p| p.row), last(|p| p.col));
    let mut sites = Sites::empty((bottom - top + 1).max(0) as usize, (right - left + 1).max(0) as usize);
    for (place, m) in placed {
        sites.set(Place::new(place.row - top, place.col - left), Some(m));
    }
    sites
}

/// Rows and columns of a print with shifted rows, from places down to the right. Row numbers stay.
pub(crate) fn offset(sites: &Sites, odd_rows_forward: bool) -> Sites {
    let half = |row: i32| if odd_rows_forward { row / 2 } else { (row + 1) / 2 };
    let places = sites
        .places()
        .filter_map(|place| Some((Place::new(place.row, place.col + half(place.row)), sites.at(place)?)));
    let mut shown = sites_of(places.collect());
    shown.is_offset = true;
    shown
}

/// Share of the places that are seen, without outer rows and columns of strays.
fn fullness(sites: &Sites) -> f64 {
    let (mut low, mut high) = ((0, 0), (sites.rows as i32, sites.cols as i32));
    let seen = |rows: core::ops::Range<i32>, cols: core::ops::Range<i32>| {
        let all = rows.flat_map(|row| cols.clone().map(move |col| Place::new(row, col)));
        let (mut seen, mut count) = (0.0, 0.0);
        for place in all {
            seen += if sites.at(place).is_some() { 1.0 } else { 0.0 };
            count += 1.0;
        }
        if count > 0.0 { seen / count } else { 0.0 }
    };
    while low.0 < high.0 && low.1 < high.1 {
        let (rows, cols) = (low.0..high.0, low.1..high.1);
        if seen(low.0..low.0 + 1, cols.clone()) < STRAYS {
            low.0 += 1;
        } else if seen(high.0 - 1..high.0, cols.clone()) < STRAYS {
            high.0 -= 1;
        } else if seen(rows.clone(), low.1..low.1 + 1) < STRAYS {
            low.1 += 1;
        } else if seen(rows.clone(), high.1 - 1..high.1) < STRAYS {
            high.1 -= 1;
        } else {
            return seen(rows, cols);
        }
    }
    0.0
}
