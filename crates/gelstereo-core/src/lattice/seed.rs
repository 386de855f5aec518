//! Seed of a lattice: a marker with regular surroundings.

use crate::math::{DVec2, median};
use crate::spatial::Grid;
use alloc::vec::Vec;

/// Most neighbours considered per marker.
const AROUND: usize = 16;

/// Upper bound of the shorter step, in distances to the nearest neighbour. It is below the diagonal of a
/// square, which excludes the lattice of every second marker.
const LONGEST: f64 = 1.3;

/// A marker and the steps to the next marker of its row and of its column.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seed {
    pub centre: usize,
    pub row_step: DVec2,
    pub col_step: DVec2,
    /// 0 for a square lattice without noise.
    pub irregularity: f64,
}

/// Median distance to the nearest neighbour, over at most `sample` of the points.
pub(super) fn neighbour_distance(
    points: &[DVec2],
    grid: &Grid,
    spacing_px: f64,
    sample: usize,
    scratch: &mut Vec<f64>,
) -> Option<f64> {
    scratch.clear();
    for n in (0..points.len()).step_by(points.len().div_ceil(sample).max(1)) {
        // Rarely farther than in a uniform distribution.
        let within = |radius_px: f64| grid.nearest(points, points[n], radius_px, |m| m != n);
        let nearest = within(1.5 * spacing_px).or_else(|| within(3.0 * spacing_px));
        scratch.extend(nearest.map(|m| points[n].distance(points[m])));
    }
    median(scratch).filter(|&d| d > 0.0 && d.is_finite())
}

/// Which neighbours of a seed must be present.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Around {
    /// All eight neighbours.
    All,
    /// Those of two adjacent cells: two opposite neighbours, one across, and the corners between them.
    /// For small lattices with gaps.
    Half,
}

/// Local lattice around a point, if its surroundings are regular. The two steps are the shortest ones
/// with markers both forwards and backwards whose sums also lead to markers. With `Half`, the second step
/// and its sums are only checked forwards.
///
/// The midpoint of two merged dots and the lattice of every second marker fail the sum check, or have a
/// marker inside a cell.
pub(super) fn seed_at(
    points: &[DVec2],
    grid: &Grid,
    centre: usize,
    near_px: f64,
    needed: Around,
) -> Option<Seed> {
    let here = points[centre];
    let mut around = [DVec2::ZERO; AROUND];
    let mut count = 0;
    grid.visit(here, 2.1 * near_px, |m| {
        let step = points[m] - here;
        if m != centre && count < AROUND && step.length_squared() < 4.4 * near_px * near_px {
            around[count] = step;
            count += 1;
        }
    });
    let around = &around[..count];
    let first = shortest_both_ways(around, |_| true)?;
    let size2 = first.length_squared();
    if size2 > LONGEST * LONGEST * near_px * near_px {
        return None;
    }
    let across = |s: DVec2| first.perp_dot(s).abs() > 0.5 * first.dot(s).abs();
    let second = match needed {
        Around::All => shortest_both_ways(around, across)?,
        Around::Half => shortest(around.iter().copied().filter(|&s| across(s)))?,
    };
    let length_ratio2 = second.length_squared() / size2;
    if !(0.25..=4.0).contains(&length_ratio2) {
        return None;
    }
    let slant = first.dot(second) / (size2 * crate::math::sqrt(length_ratio2));
    let mut irregularity = slant * slant + 0.1 * (length_ratio2 - 1.0).abs();
    let steps = [first, -first, second, second + first, second - first];
    let behind = [-second, first - second, -second - first];
    for step in steps.into_iter().chain(behind.into_iter().filter(|_| needed == Around::All)) {
        let off2 = around.iter().map(|s| s.distance_squared(step)).fold(f64::INFINITY, f64::min);
        if off2 > 0.04 * size2 {
            return None;
        }
        irregularity += off2 / size2;
    }
    let (row_step, col_step) = rows_to_the_right(first, second);
    (irregularity < 0.5 && cells_are_empty(around, row_step, col_step)).then_some(Seed {
        centre,
        row_step,
        col_step,
        irregularity,
    })
}

fn shortest(steps: impl Iterator<Item = DVec2>) -> Option<DVec2> {
    steps.min_by(|a, b| a.length_squared().total_cmp(&b.length_squared()))
}

/// Half the difference of two opposite steps: the shortest one that `wanted` accepts.
fn shortest_both_ways(around: &[DVec2], wanted: impl Fn(DVec2) -> bool) -> Option<DVec2> {
    let mut best: Option<DVec2> = None;
    for (n, &step) in around.iter().enumerate().filter(|&(_, &step)| wanted(step)) {
        for &other in &around[n + 1..] {
            let mean = (step - other) * 0.5;
            let opposite = (step + other).length_squared() < 0.09 * mean.length_squared();
            if opposite && best.is_none_or(|b| mean.length_squared() < b.length_squared()) {
                best = Some(mean);
            }
        }
    }
    best
}

/// Of the eight ways to name two axes, returns the one whose columns are a clockwise turn (y down) from
/// the rows and whose rows run most nearly to the right.
pub(super) fn rows_to_the_right(first: DVec2, second: DVec2) -> (DVec2, DVec2) {
    let (mut row, mut col) = if first.perp_dot(second) > 0.0 { (first, second) } else { (first, -second) };
    for _ in 0..3 {
        // Accepts a mean angle of the two axes within 45 degrees of upright.
        let (a, b) = (row.normalize_or_zero(), col.normalize_or_zero());
        if a.x + b.y >= (a.y - b.x).abs() && a.x + b.y > 0.0 {
            break;
        }
        (row, col) = (col, -row);
    }
    (row, col)
}

/// Whether no neighbour lies well inside one of the four cells or near the midpoint of an edge.
fn cells_are_empty(around: &[DVec2], row_step: DVec2, col_step: DVec2) -> bool {
    let area = row_step.perp_dot(col_step);
    around.iter().all(|s| {
        let (u, v) = (s.perp_dot(col_step) / area, row_step.perp_dot(*s) / area);
        let off = |x: f64| (x - crate::math::round(x)).abs();
        u.abs() > 1.3 || v.abs() > 1.3 || (off(u) < 0.3 && off(v) < 0.3)
    })
}
