//! Pairs the markers of two views of a print of any layout.

use super::EQUAL_MARKERS;
use super::hypothesis::{Hypothesis, NONE, Scene};
use super::neighbours::Neighbours;
use crate::math::{DVec2, abs};
use alloc::vec::Vec;

/// Largest difference of the rows of a marker in both views, in spacings. Refraction and calibration move
/// rows by a pixel or two, and markers are some 20 px apart.
const ROWS: f64 = 0.25;
/// Votes are counted in steps of this many spacings; two steps are one displacement.
const STEP: f64 = 0.25;
/// Largest number of disparities that are tried.
const PEAKS: usize = 24;
/// Largest number of steps: wider ranges belong to no pair of views.
const MAX_STEPS: usize = 4096;

/// Pairs markers by their rectified positions in both views: index in the left view and in the right one, in
/// the order of the left view.
///
/// Each disparity that many pairs share is tried. Matches must agree with those of their neighbours, as in
/// [`super::ScatteredTracker`], so that disparities may vary smoothly. The result is `None` if two
/// disparities explain about as many markers, or none explains half of them.
#[must_use]
pub fn pair_views(left_px: &[DVec2], right_px: &[DVec2]) -> Option<Vec<(u32, u32)>> {
    if left_px.len().min(right_px.len()) < super::MIN_MARKERS {
        return None;
    }
    let neighbours = Neighbours::new(left_px);
    let spacing_px = neighbours.spacing_px();
    if spacing_px <= 0.0 || !spacing_px.is_finite() {
        return None;
    }
    let scene = Scene {
        detected_px: right_px,
        expected_px: left_px,
        neighbours: &neighbours,
        spacing_px,
        gate_px: 0.5 * spacing_px,
    };
    let (mut best, mut other, mut is_unique) = (Hypothesis::default(), Hypothesis::default(), false);
    for disparity_px in disparities(left_px, right_px, spacing_px) {
        other.run(&scene, DVec2::new(-disparity_px, 0.0));
        if other.count() > best.count() + EQUAL_MARKERS {
            core::mem::swap(&mut best, &mut other);
            is_unique = true;
        } else if other.count() + EQUAL_MARKERS >= best.count() && !other.is_like(&best) {
            is_unique = false;
        }
    }
    let matched = best.detection().iter().enumerate().filter(|&(_, &m)| m != NONE);
    let is_near = |n: usize, m: u32| abs(left_px[n].y - right_px[m as usize].y) <= ROWS * spacing_px;
    let pairs: Vec<(u32, u32)> =
        matched.filter(|&(n, &m)| is_near(n, m)).map(|(n, &m)| (n as u32, m)).collect();
    (is_unique && 2 * pairs.len() >= left_px.len().min(right_px.len())).then_some(pairs)
}

/// Positive disparities that many pairs share, most votes first.
fn disparities(left_px: &[DVec2], right_px: &[DVec2], spacing_px: f64) -> Vec<f64> {
    let step_px = STEP * spacing_px;
    let mut votes: Vec<(u32, f64)> = Vec::new();
    for left in left_px {
        for right in right_px.iter().filter(|right| abs(left.y - right.y) <= ROWS * spacing_px) {
            let disparity_px = left.x - right.x;
            let step = (disparity_px / step_px) as usize;
            if disparity_px > 0.0 && step < MAX_STEPS {
                if votes.len() <= step {
                    votes.resize(step + 1, (0, 0.0));
                }
                votes[step].0 += 1;
                votes[step].1 += disparity_px;
            }
        }
    }
    let mut pairs: Vec<(u32, usize, f64)> = (0..votes.len())
        .map(|n| {
            let (count, sum) =
                votes.get(n + 1).map_or(votes[n], |next| (votes[n].0 + next.0, votes[n].1 + next.1));
            (count, n, sum)
        })
        .filter(|pair| pair.0 > 0)
        .collect();
    pairs.sort_unstable_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut kept: Vec<(u32, usize, f64)> = Vec::new();
    for pair in pairs {
        if kept.len() < PEAKS && kept.iter().all(|other| other.1.abs_diff(pair.1) > 1) {
            kept.push(pair);
        }
    }
    kept.into_iter().map(|(count, _, sum)| sum / f64::from(count)).collect()
}
