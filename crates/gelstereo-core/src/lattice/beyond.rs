//! Outer rows and columns separated from the rest by a wholly undetected row or column.

use super::found::{Place, Sites};
use crate::math::DVec2;
use alloc::vec::Vec;

/// Smallest number of markers of a line.
const LEAST: usize = 3;

/// Adds outer rows and columns that lie beyond an empty one.
///
/// Near false detections, or where a marker has lost its place, the finder keeps only the connected part
/// of the lattice: elsewhere, part of a sheared lattice may have slipped by one place. A complete line
/// two steps beyond the outer one cannot have slipped. It is accepted if at least half of its markers lie
/// within `most_px` of the position extrapolated from the two lines before it, which false detections do
/// not. The line between is then printed too, but undetected.
pub(super) fn with_lines_beyond(mut sites: Sites, points: &[DVec2], most_px: f64) -> Sites {
    let mut is_free = alloc::vec![true; points.len()];
    for m in sites.places().filter_map(|place| sites.at(place)) {
        is_free[m] = false;
    }
    if !is_free.contains(&true) {
        return sites;
    }
    for side in 0..4 {
        let line = beyond(&sites, points, side, |at| {
            let near = |m: &usize| is_free[*m] && points[*m].distance(at) <= most_px;
            (0..points.len()).find(near)
        });
        let seen = line.iter().flatten().count();
        if seen >= LEAST && 2 * seen >= line.len() {
            line.iter().flatten().for_each(|&m| is_free[m] = false);
            sites = grown(&sites, side, &line);
        }
    }
    sites
}

/// Detections two steps beyond a side, place by place along it.
fn beyond(
    sites: &Sites,
    points: &[DVec2],
    side: usize,
    near: impl Fn(DVec2) -> Option<usize>,
) -> Vec<Option<usize>> {
    let at = |k: i32, inward: i32| sites.at(place(sites, side, k, inward)).map(|m| points[m]);
    // Extrapolated from the outer two detected markers.
    let step = |k: i32, inward: i32| {
        let outer = at(k, inward)?;
        Some(outer + (outer - at(k, inward + 1)?) * f64::from(2 + inward))
    };
    let one = |k: i32| (0..2).find_map(|inward| step(k, inward)).and_then(&near);
    (0..length(sites, side) as i32).map(one).collect()
}

/// The sites with an empty line and this line added at a side.
fn grown(sites: &Sites, side: usize, line: &[Option<usize>]) -> Sites {
    let (rows, cols) = if side.is_multiple_of(2) { (2, 0) } else { (0, 2) };
    let mut out = Sites::empty(sites.rows + rows, sites.cols + cols);
    let shift = match side {
        0 => (2, 0),
        3 => (0, 2),
        _ => (0, 0),
    };
    for from in sites.places() {
        out.set(from.step(shift), sites.at(from));
    }
    for (k, &m) in (0..).zip(line) {
        out.set(place(&out, side, k, 0), m);
    }
    out
}

/// Place `along` steps along the upper, right, lower or left side, and `inward` steps inside it.
const fn place(sites: &Sites, side: usize, along: i32, inward: i32) -> Place {
    let (last_row, last_col) = (sites.rows as i32 - 1, sites.cols as i32 - 1);
    match side {
        0 => Place::new(inward, along),
        1 => Place::new(along, last_col - inward),
        2 => Place::new(last_row - inward, along),
        _ => Place::new(along, inward),
    }
}

const fn length(sites: &Sites, side: usize) -> usize {
    if side.is_multiple_of(2) { sites.cols } else { sites.rows }
}
