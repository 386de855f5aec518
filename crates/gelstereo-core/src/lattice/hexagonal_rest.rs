//! Checks and fills in a labelled hexagonal lattice.

use super::fill::mean;
use super::{LabelError, Topology};
use crate::math::DVec2;
use alloc::vec::Vec;

/// Axis and sign of the six steps, clockwise from the next place of the row.
const STEPS: [(usize, isize); 6] = [(0, 1), (1, 1), (2, 1), (0, -1), (1, -1), (2, -1)];

/// Checks that a labelling is a lattice: no triangle folds over, and every marker lies within `max_px` of the
/// midpoint of its neighbours along each axis. Unknown positions are not checked.
pub(super) fn check(topology: Topology, at: &[Option<DVec2>], max_px: f64) -> Result<(), LabelError> {
    let near = |i: usize, (axis, count): (usize, isize)| at[topology.step(i, axis, count)?];
    let irregular = |i: usize, off_px: f64| {
        let (row, col) = (i / topology.cols(), i % topology.cols());
        Err(LabelError::Irregular { row, col, off_px, most_px: max_px })
    };
    for i in 0..at.len() {
        let Some(here) = at[i] else { continue };
        for axis in 0..3 {
            if let (Some(before), Some(after)) = (near(i, (axis, -1)), near(i, (axis, 1))) {
                let off_px = here.distance((before + after) * 0.5);
                if !(off_px <= max_px) {
                    return irregular(i, off_px);
                }
            }
        }
        for k in 0..2 {
            if let (Some(one), Some(next)) = (near(i, STEPS[k]), near(i, STEPS[k + 1]))
                && (one - here).perp_dot(next - here) <= 0.0
            {
                return irregular(i, f64::INFINITY);
            }
        }
    }
    Ok(())
}

/// Fills every gap, starting with those that have known neighbours; `None` when too little is known.
pub(super) fn filled(topology: Topology, mut at: Vec<Option<DVec2>>) -> Option<Vec<DVec2>> {
    while at.iter().any(Option::is_none) {
        // Each round uses only positions known before it, so that the result does not depend on the order.
        let round: Vec<(usize, DVec2)> = (0..at.len())
            .filter(|&i| at[i].is_none())
            .filter_map(|i| Some((i, predict(topology, &at, i)?)))
            .collect();
        if round.is_empty() {
            return None;
        }
        round.into_iter().for_each(|(i, position)| at[i] = Some(position));
    }
    at.into_iter().collect()
}

/// Midpoint of opposite neighbours where there are any, otherwise extrapolation along axes and across cells.
fn predict(topology: Topology, at: &[Option<DVec2>], i: usize) -> Option<DVec2> {
    let steps = |i: usize, (axis, count): (usize, isize)| topology.step(i, axis, count);
    let near = |k: usize, count: isize| at[steps(i, (STEPS[k].0, STEPS[k].1 * count))?];
    let between = (0..3).filter_map(|k| Some((near(k, 1)? + near(k, -1)?) * 0.5));
    let beyond = (0..6).filter_map(|k| Some(near(k, 1)? * 2.0 - near(k, 2)?));
    let across = (0..6).filter_map(|k| {
        let next = (k + 1) % 6;
        let corner = at[steps(steps(i, STEPS[k])?, STEPS[next])?]?;
        Some(near(k, 1)? + near(next, 1)? - corner)
    });
    mean(between).or_else(|| mean(beyond.chain(across)))
}
