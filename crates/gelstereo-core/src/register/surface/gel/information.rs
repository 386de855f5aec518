//! Information matrix of the found pose from the gel heights.
//!
//! It is the sum Σ w J Jᵀ (Fisher) over the markers in contact, along their normals, plus the information
//! from edges ([`super::edges`]). The gel beside the part helps to find the pose, but its information is
//! not counted: between the markers a real gel deviates from the model unseen.
//!
//! The sum is correct only if every marker is in contact with its assigned face. Another pose may put a
//! row of markers on the face beyond an edge, or leave it free, and explain the heights about as well.
//! The resulting height error of each marker is added to its variance.
//!
//! - A marker whose neighbour is in contact beyond a crease may be on that face. The position of the
//!   crease between the two follows from their tangent planes. Its uncertainty is that of the pose and of
//!   the marker's own position, along the line between the two. The error is the part of it that moves
//!   the crease beyond the marker, times the difference of the slopes. It is at most that of a crease
//!   anywhere between the two, 1 / √12 of the distance.
//! - Gel hangs from an edge instead of following a steep face beyond it. Such a face may lie anywhere below
//!   the marker, so a marker there has no weight ([`GelFit::may_bridge`]).
//! - A marker may be out of contact. Contact lifts it over the height of free gel with the same
//!   neighbours. The error is the part of the pose uncertainty that moves the face below that height. It
//!   is at most that of a face anywhere down to the rest height, 1 / √3 of the marker's height.
//!
//! The pose uncertainty is computed in passes. The first assumes creases anywhere, and counts only
//! markers that are surely lifted or surrounded by their own face. The next includes markers whose face
//! the first ones determine. With further passes a row of markers would confirm itself.

use super::edges::Bounded;
use super::fit::{BETWEEN, GelFit, LONGEST_MM};
use super::lattice::Node;
use super::prediction::{GelFitScratch, Prediction, Row};
use crate::math::linalg::Symmetric;
use crate::math::{erfc, exp, sqrt};
use crate::register::observe::Vector6;
use crate::register::surface::candidate::Candidate;
use crate::register::surface::distances::Foot;
use crate::register::surface::smooth_normals::CREASE_COS;
use core::f64::consts::{FRAC_1_SQRT_2, TAU};

/// Passes over the weights of the markers; the first has no estimate of the pose uncertainty.
const PASSES: usize = 3;
/// Same-face neighbours of a marker in the interior of a face.
const ALL_SIDES: usize = 4;
/// Standard deviations from which a marker is surely lifted: 95 %.
const SURE: f64 = 2.0;

impl GelFit<'_> {
    /// Information about (ρ ω, v) about the centroid, at the state whose prediction is in the scratch.
    /// Leaves the weight of every marker there.
    pub fn information(&self, state: &Candidate, scratch: &mut GelFitScratch) -> Symmetric<6> {
        self.find_walls(state, scratch);
        let sigma = self.problem.params.guess_sigma();
        let (turn_mm, shift_mm) = (sigma.turn_rad * self.problem.samples.radius_mm, sigma.shift_mm);
        let guess = core::array::from_fn(|i| if i < 3 { turn_mm } else { shift_mm }).map(|x| 1.0 / (x * x));
        let mut told = None;
        for pass in 1..=PASSES {
            self.count(state, told.as_ref(), pass == PASSES, scratch);
            told = Some(Bounded::new(&self.sum(state, scratch), &guess, &mut scratch.walls));
        }
        told.map_or([[0.0; 6]; 6], |told| told.information(&scratch.walls))
    }

    /// Σ w J Jᵀ with the weight of every marker.
    fn sum(&self, state: &Candidate, scratch: &GelFitScratch) -> Symmetric<6> {
        let nodes = self.gel().nodes.iter().zip(&scratch.here.sights).zip(&scratch.counts_per_mm2);
        let rows = nodes.filter(|(_, count)| **count > 0.0).filter_map(|((node, sight), count)| {
            Some((self.touching_row(state, node, sight.foot.as_ref()?), *count))
        });
        let mut known = [[0.0; 6]; 6];
        for (row, weight) in rows {
            for i in 0..6 {
                (0..6).for_each(|k| known[i][k] += weight * row[i] * row[k]);
            }
        }
        known
    }

    /// Length of the next step of a state, over the patch.
    pub fn left_mm(&self, state: &Candidate, scratch: &mut GelFitScratch) -> f64 {
        self.next(state, scratch).map_or(self.problem.params.scaled(LONGEST_MM), |step| {
            sqrt(step[..6].iter().map(|x| x * x).sum())
        })
    }

    /// Weight of every marker's height, per mm², for the pose uncertainty `known`.
    fn count(&self, state: &Candidate, known: Option<&Bounded>, is_last: bool, scratch: &mut GelFitScratch) {
        let GelFitScratch { here, counts_per_mm2, .. } = scratch;
        let gel = self.gel();
        counts_per_mm2.clear();
        counts_per_mm2.resize(gel.nodes.len(), 0.0);
        let touched = |k: usize| here.sights[k].foot.as_ref().filter(|_| here.sights[k].touches);
        let stiffness = gel.stiffness(state.rest.log_decay);
        for (k, sight) in here.sights.iter().enumerate() {
            let Some(foot) = touched(k) else { continue };
            // Derivative of its height minus that of the free gel.
            let mut row = pose_row(&self.touching_row(state, &gel.nodes[k], foot));
            let (mut crosses_mm2, mut alike) = (0.0_f64, 0);
            let share = gel.share(k, stiffness);
            for (j, other) in gel.near(k).filter_map(|j| Some((j, touched(j)?))) {
                if other.normal.dot(foot.normal) < CREASE_COS {
                    let pair = [(&gel.nodes[k], foot), (&gel.nodes[j], other)];
                    crosses_mm2 = crosses_mm2.max(self.crosses_mm2(state, known, pair));
                } else {
                    alike += 1;
                }
                let beside = self.touching_row(state, &gel.nodes[j], other);
                row.iter_mut().zip(beside).for_each(|(row, beside)| *row -= share * beside);
            }
            let height_mm = here.heights_mm[k];
            let lift_mm = height_mm - gel.free_mm(k, stiffness, &here.heights_mm);
            let max_mm2 = if is_last { height_mm * height_mm / 3.0 } else { f64::INFINITY };
            let hangs_mm2 = match known {
                _ if self.may_bridge(state, here, k, lift_mm) => f64::INFINITY,
                Some(known) => square_beyond(lift_mm, sqrt(known.variance(&row))).min(max_mm2),
                None if alike == ALL_SIDES || lift_mm > SURE * sqrt(sight.variance_mm2) => 0.0,
                None => max_mm2,
            };
            counts_per_mm2[k] = sight.weight / (sight.variance_mm2 + crosses_mm2 + hangs_mm2);
        }
    }

    /// Whether free gel could pass over the face at a marker in contact. Beyond a crease from a neighbour in
    /// contact this face falls, within a pitch, farther below the neighbour's face than the gel does if it is
    /// free, which is by `lift_mm`.
    pub(super) fn may_bridge(&self, state: &Candidate, here: &Prediction, k: usize, lift_mm: f64) -> bool {
        let gel = self.gel();
        let press = state.placement.object_direction(self.problem.press_direction);
        let touched = |k: usize| here.sights[k].foot.as_ref().filter(|_| here.sights[k].touches);
        let slope = |foot: &Foot| {
            let cosine = foot.normal.dot(press);
            sqrt((1.0 - cosine * cosine).max(0.0)) / cosine
        };
        touched(k).is_some_and(|foot| {
            gel.near(k).filter_map(|j| Some((j, touched(j)?))).any(|(j, other)| {
                let pitch_mm = gel.nodes[j].across_mm.distance(gel.nodes[k].across_mm);
                other.normal.dot(foot.normal) < CREASE_COS
                    && pitch_mm * (slope(foot) - slope(other)) > lift_mm.max(0.0)
            })
        })
    }

    /// Mean squared height error of the first of two nodes due to the crease between them.
    fn crosses_mm2(
        &self,
        state: &Candidate,
        known: Option<&Bounded>,
        [(node, foot), (next, other)]: [(&Node, &Foot); 2],
    ) -> f64 {
        let placement = &state.placement;
        let press = placement.object_direction(self.problem.press_direction);
        let slopes = [foot, other].map(|foot| foot.normal / foot.normal.dot(press));
        let way = next.sample.p_mm - node.sample.p_mm;
        let way = way - self.problem.press_direction * way.dot(self.problem.press_direction);
        let (way_squared, in_object) = (way.length_squared(), placement.object_direction(way));
        if way_squared == 0.0 {
            return 0.0;
        }
        let anywhere = BETWEEN * BETWEEN;
        let share = known.map_or(anywhere, |known| {
            // Both planes have the same height at the crease.
            let [rise, next_rise] = slopes.map(|slope| -slope.dot(in_object));
            let whole_mm = (next.along_mm - other.over_mm) - (node.along_mm - foot.over_mm);
            let crosses = ((whole_mm - next_rise) / (rise - next_rise)).clamp(0.0, 1.0);
            // A crease parallel to the line between the nodes is equally near to both.
            let crosses = if rise == next_rise { 0.0 } else { crosses };
            let u = way / sqrt(way_squared);
            let turn = node.sample.p_mm.cross(u) / self.problem.samples.radius_mm;
            let row = [turn.x, turn.y, turn.z, u.x, u.y, u.z];
            let variances_mm2 = [known.variance(&row), node.sample.variance(u)];
            crossing(crosses, variances_mm2, way_squared).min(anywhere)
        });
        slopes[0].distance_squared(slopes[1]) * way_squared * share
    }
}

/// The pose part of a row.
fn pose_row(row: &Row) -> Vector6 {
    core::array::from_fn(|i| row[i])
}

/// Mean square of how far the crease lies beyond a marker, as a share of the way to the next one. It is
/// expected at the share `crosses` of that way. The variances along the way are those of the pose and of the
/// marker's own position.
fn crossing(crosses: f64, [pose_mm2, own_mm2]: [f64; 2], way_squared: f64) -> f64 {
    square_beyond(crosses, sqrt((pose_mm2 + own_mm2) / way_squared))
}

/// Mean square of the excess of a normal variable over `s`, 0 where it is less.
fn square_beyond(s: f64, sigma: f64) -> f64 {
    let z = s / sigma;
    let above = 0.5 * erfc(z * FRAC_1_SQRT_2);
    let density = exp(-0.5 * z * z) / sqrt(TAU);
    // Far in the tail the difference is only rounding.
    ((sigma * sigma + s * s) * above - s * sigma * density).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::random::Stream;

    #[test]
    fn the_square_beyond_is_its_integral() {
        for (s, sigma) in [(0.0, 0.3), (0.2, 0.3), (0.5, 0.1), (1.0, 0.2), (1.0, 5.0)] {
            // Midpoint rule over twelve standard deviations beyond `s`.
            let (steps, width) = (20_000, 12.0 * sigma / 20_000.0);
            let at = |k: i32| {
                let over = width * (f64::from(k) + 0.5);
                let z = (s + over) / sigma;
                over * over * exp(-0.5 * z * z) / (sigma * sqrt(TAU)) * width
            };
            let sum: f64 = (0..steps).map(at).sum();
            // The rule's error is width² / 24 times the slope at its ends, which is zero at the first.
            assert!((square_beyond(s, sigma) - sum).abs() < 1e-9 * sigma * sigma, "{s} {sigma}");
        }
    }

    /// Drawn: the pose moves the crease, and the marker is not where it was measured. Of 100 000 draws the
    /// mean square is known to 2 %, four times over.
    #[test]
    fn a_crease_crosses_by_the_pose_and_by_the_marker() {
        let mut stream = Stream::new(2, "creases");
        let way_mm = 0.9;
        for (crosses, pose_mm, own_mm) in
            [(0.0, 0.1, 0.0), (0.1, 0.1, 0.2), (0.2, 0.02, 0.3), (0.1, 0.2, 0.05)]
        {
            let mut squares = 0.0;
            for _ in 0..100_000 {
                let moved_mm = pose_mm * stream.normal() - own_mm * stream.normal();
                let beyond = (moved_mm / way_mm - crosses).max(0.0);
                squares += beyond * beyond / 1e5;
            }
            let found = crossing(crosses, [pose_mm * pose_mm, own_mm * own_mm], way_mm * way_mm);
            assert!((found / squares - 1.0).abs() < 0.08, "{found} {squares}");
        }
    }

    #[test]
    fn what_is_surely_not_beyond_counts_nothing() {
        assert!(square_beyond(1.0, 0.01) < 1e-300);
        assert!(square_beyond(0.0, 1e-9) <= 1e-18);
    }
}
