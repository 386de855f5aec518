//! What the heights of the gel tell of the pose that was found.
//!
//! Of the markers that touch, along their normals: Σ w J Jᵀ (Fisher), and where edges run ([`super::edges`]). The gel beside
//! the part serves to find the pose, and tells more of it than is counted here: between the markers a real gel does what
//! none of them shows.
//!
//! That sum is right as long as every marker touches the face that it is said to touch. Noise is not what it fails by:
//! another pose puts a row of markers on the face beyond an edge, or lets it hang, and explains the heights about as
//! well. What a marker may be wrong by for that is added to the variance of its height.
//!
//! - A marker whose neighbour touches a face beyond a crease may be on that face. Where the crease runs between the two
//!   follows from the planes that they touch; it runs elsewhere by as much as the pose and the marker's own place are
//!   uncertain along the way from one to the other. The marker is wrong by as much of that as takes the crease beyond it,
//!   times the difference of the slopes; but no more than if the crease ran anywhere between the two, 1 / √12 of the way.
//! - A marker may hang. It is lifted over where the gel would stand if nothing touched it there, and its neighbours did as
//!   they do. It is wrong by as much as the face under it goes further back than that, of what the pose is uncertain by;
//!   but no more than if the face were anywhere down to where the gel is at rest, 1 / √3 of its height.
//!
//! How uncertain the pose is, is told at first by the markers with creases anywhere, of which those count that are lifted
//! for sure or lie amid a face. Then it is told once more: that brings in those whose face the first have fixed. After
//! that a row of markers would vouch for itself.

use super::edges::{Bounded, MIN_KNOWN};
use super::fit::{BETWEEN, GelFit, LONGEST_MM};
use super::lattice::Node;
use super::prediction::{GelFitScratch, Row};
use crate::math::linalg::Symmetric;
use crate::math::{erfc, exp, sqrt};
use crate::register::observe::Vector6;
use crate::register::surface::candidate::Candidate;
use crate::register::surface::distances::Foot;
use crate::register::surface::smooth_normals::CREASE_COS;
use core::f64::consts::{FRAC_1_SQRT_2, TAU};

/// Times that is told what the markers count for; the first knows nothing of the pose.
const PASSES: usize = 3;
/// Neighbours on the same face of a marker amid it.
const ALL_SIDES: usize = 4;
/// Standard deviations by which a marker is lifted for sure: 95 %.
const SURE: f64 = 2.0;

impl GelFit<'_> {
    /// Information about (ρ ω, v) about the centroid, of the state whose prediction is in the scratch. Leaves there what
    /// every marker counts for.
    pub fn information(&self, state: &Candidate, scratch: &mut GelFitScratch) -> Symmetric<6> {
        self.find_walls(state, scratch);
        let least = MIN_KNOWN / (self.params.gel_scale * self.params.gel_scale);
        let mut told = None;
        for pass in 1..=PASSES {
            self.count(state, (told.as_ref(), pass == PASSES), scratch);
            told = Some(Bounded::new(&self.sum(state, scratch), least, &mut scratch.walls));
        }
        told.map_or([[0.0; 6]; 6], |told| told.information(&scratch.walls))
    }

    /// Σ w J Jᵀ with what every marker counts for.
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

    /// How far the step is that a state would take next, over the patch.
    pub fn left_mm(&self, state: &Candidate, scratch: &mut GelFitScratch) -> f64 {
        self.next(state, scratch)
            .map_or(self.params.scaled(LONGEST_MM), |step| sqrt(step[..6].iter().map(|x| x * x).sum()))
    }

    /// What the height of every marker counts for, per mm², where so much is known of the pose.
    fn count(
        &self,
        state: &Candidate,
        (known, is_last): (Option<&Bounded>, bool),
        scratch: &mut GelFitScratch,
    ) {
        let GelFitScratch { here, counts_per_mm2, .. } = scratch;
        let gel = self.gel();
        counts_per_mm2.clear();
        counts_per_mm2.resize(gel.nodes.len(), 0.0);
        let touched = |k: usize| here.sights[k].foot.as_ref().filter(|_| here.sights[k].touches);
        let stiffness = gel.stiffness(state.rest.log_decay);
        for (k, sight) in here.sights.iter().enumerate() {
            let Some(foot) = touched(k) else { continue };
            // Of its height, over that of the free gel.
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
            let most_mm2 = if is_last { height_mm * height_mm / 3.0 } else { f64::INFINITY };
            let hangs_mm2 = match known {
                Some(known) => square_beyond(lift_mm, sqrt(known.variance(&row))).min(most_mm2),
                None if alike == ALL_SIDES || lift_mm > SURE * sqrt(sight.variance_mm2) => 0.0,
                None => most_mm2,
            };
            counts_per_mm2[k] = sight.weight / (sight.variance_mm2 + crosses_mm2 + hangs_mm2);
        }
    }

    /// Mean square of what the height of the first of two nodes is wrong by, for the crease between them.
    fn crosses_mm2(
        &self,
        state: &Candidate,
        known: Option<&Bounded>,
        [(node, foot), (next, other)]: [(&Node, &Foot); 2],
    ) -> f64 {
        let placement = &state.placement;
        let press = placement.object_direction(self.press_direction);
        let slopes = [foot, other].map(|foot| foot.normal / foot.normal.dot(press));
        let way = next.sample.p_mm - node.sample.p_mm;
        let way = way - self.press_direction * way.dot(self.press_direction);
        let (way_squared, in_object) = (way.length_squared(), placement.object_direction(way));
        if way_squared == 0.0 {
            return 0.0;
        }
        let anywhere = BETWEEN * BETWEEN;
        let share = known.map_or(anywhere, |known| {
            // Both planes are as high where they cross.
            let [rise, next_rise] = slopes.map(|slope| -slope.dot(in_object));
            let whole_mm = (next.along_mm - other.over_mm) - (node.along_mm - foot.over_mm);
            let crosses = ((whole_mm - next_rise) / (rise - next_rise)).clamp(0.0, 1.0);
            // A crease along the way is as near to one end as to the other.
            let crosses = if rise == next_rise { 0.0 } else { crosses };
            let u = way / sqrt(way_squared);
            let turn = node.sample.p_mm.cross(u) / self.samples.radius_mm;
            let row = [turn.x, turn.y, turn.z, u.x, u.y, u.z];
            let variance_mm2 = known.variance(&row) + node.sample.variance(u);
            square_beyond(crosses, sqrt(variance_mm2 / way_squared)).min(anywhere)
        });
        slopes[0].distance_squared(slopes[1]) * way_squared * share
    }
}

/// Of the pose alone.
fn pose_row(row: &Row) -> Vector6 {
    core::array::from_fn(|i| row[i])
}

/// Mean square of what a normal variable is greater by than `s`, 0 where it is less.
fn square_beyond(s: f64, sigma: f64) -> f64 {
    let z = s / sigma;
    let above = 0.5 * erfc(z * FRAC_1_SQRT_2);
    let density = exp(-0.5 * z * z) / sqrt(TAU);
    // Where hardly any is, the difference is rounding.
    ((sigma * sigma + s * s) * above - s * sigma * density).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_square_beyond_is_its_integral() {
        for (s, sigma) in [(0.0, 0.3), (0.2, 0.3), (0.5, 0.1), (1.0, 0.2), (1.0, 5.0)] {
            // Midpoints over twelve standard deviations beyond it.
            let (steps, width) = (20_000, 12.0 * sigma / 20_000.0);
            let at = |k: i32| {
                let over = width * (f64::from(k) + 0.5);
                let z = (s + over) / sigma;
                over * over * exp(-0.5 * z * z) / (sigma * sqrt(TAU)) * width
            };
            let sum: f64 = (0..steps).map(at).sum();
            // The rule's error is width² / 24 times the slope at its ends, which is none at the first.
            assert!((square_beyond(s, sigma) - sum).abs() < 1e-9 * sigma * sigma, "{s} {sigma}");
        }
    }

    #[test]
    fn what_is_surely_not_beyond_counts_nothing() {
        assert!(square_beyond(1.0, 0.01) < 1e-300);
        assert!(square_beyond(0.0, 1e-9) <= 1e-18);
    }
}
