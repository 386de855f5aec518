//! Rows of a hexagonal lattice, of which every second one is shifted by half a pitch.
//!
//! The finder knows rows and columns only, so a hexagonal lattice has places along two of its three steps.
//! Three directions can be rows: the print's own are those that fill a rectangle.

use super::found::{FoundLattice, Place, Sites};
use crate::math::{DVec2, abs};
use alloc::vec::Vec;
use core::ops::Range;

/// Share of its places that a print's own rows and columns fill, up to missing markers. Rows along another
/// direction fill 0.54 of a square print, and less of a longer one. Of a print that is wider than the view,
/// none may be this full: then the rows that are most nearly level are taken.
const FULL: f64 = 0.85;

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
pub(super) struct HexagonalSites {
    pub sites: Sites,
    /// Mean step along a row, pixels.
    pub row_step_px: DVec2,
    /// Mean step down to the right, pixels.
    pub next_row_px: DVec2,
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
        let mut best: Option<((bool, f64), Self)> = None;
        for k in (0..6).filter(is_wanted) {
            let row_step_px = in_image(steps[k]);
            let sites = along_rows(found, steps[k], steps[(k + 1) % 6]);
            let [forward, backward] = [true, false].map(|forward| fullness(&offset(&sites, forward)));
            let (full, odd_rows_forward) = (forward.max(backward), forward >= backward);
            let level = abs(row_step_px.normalize_or_zero().x);
            let key = (full >= FULL, if full >= FULL { full } else { level });
            if best.as_ref().is_none_or(|(most, _)| key > *most) {
                let next_row_px = in_image(steps[(k + 1) % 6]);
                best = Some((key, Self { sites, row_step_px, next_row_px, odd_rows_forward }));
            }
        }
        best.map(|(_, named)| named)
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
pub(super) fn offset(sites: &Sites, odd_rows_forward: bool) -> Sites {
    let half = |row: i32| if odd_rows_forward { row / 2 } else { (row + 1) / 2 };
    let col = |place: Place| place.col + half(place.row);
    let seen = || sites.places().filter_map(|place| Some((place, sites.at(place)?)));
    let first = seen().map(|(place, _)| col(place)).min().unwrap_or(0);
    let last = seen().map(|(place, _)| col(place)).max().unwrap_or(-1);
    let mut shown = Sites::empty(sites.rows, (last - first + 1).max(0) as usize);
    for (place, m) in seen() {
        shown.set(Place::new(place.row, col(place) - first), Some(m));
    }
    shown.is_offset = true;
    shown
}

/// Share of the places that are seen, without outer rows and columns of strays.
fn fullness(sites: &Sites) -> f64 {
    let (rows, cols) = without_strays(sites);
    seen_share(sites, rows, cols)
}

/// Rows and columns without outer ones of strays.
pub(super) fn without_strays(sites: &Sites) -> (Range<i32>, Range<i32>) {
    let (mut rows, mut cols) = (0..sites.rows as i32, 0..sites.cols as i32);
    let is_stray = |rows: Range<i32>, cols: Range<i32>| seen_share(sites, rows, cols) < STRAYS;
    while !rows.is_empty() && !cols.is_empty() {
        if is_stray(rows.start..rows.start + 1, cols.clone()) {
            rows.start += 1;
        } else if is_stray(rows.end - 1..rows.end, cols.clone()) {
            rows.end -= 1;
        } else if is_stray(rows.clone(), cols.start..cols.start + 1) {
            cols.start += 1;
        } else if is_stray(rows.clone(), cols.end - 1..cols.end) {
            cols.end -= 1;
        } else {
            return (rows, cols);
        }
    }
    (0..0, 0..0)
}

fn seen_share(sites: &Sites, rows: Range<i32>, cols: Range<i32>) -> f64 {
    let (mut seen, mut count) = (0.0, 0.0);
    for place in rows.flat_map(|row| cols.clone().map(move |col| Place::new(row, col))) {
        seen += if sites.at(place).is_some() { 1.0 } else { 0.0 };
        count += 1.0;
    }
    if count > 0.0 { seen / count } else { 0.0 }
}
