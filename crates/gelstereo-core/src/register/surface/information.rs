//! What the heights of the gel tell of the pose that was found.
//!
//! Of the markers that touch, along their normals: Σ w J Jᵀ (Fisher). What touches tells of the pose, too, and so does the
//! gel beside it, which serves to find the pose; but an edge is known no better than the markers stand apart, whatever
//! a derivative says.
//!
//! That sum is right as long as every marker touches the face that it is said to touch. Noise is not what it fails by:
//! another pose puts a row of markers on the face beyond an edge, or lets it hang, and explains the heights about as
//! well. Two rules keep what a marker is not known to say out of the sum.
//!
//! - A marker whose neighbour touches a face beyond a crease may be on that face: the crease runs anywhere between the two.
//!   It is then wrong by up to the pitch times the difference of the slopes, and by 1 / √12 of that in standard deviations.
//!   This is added to the variance of its height.
//! - A marker over which the gel would stand as high if nothing touched it there is under no pressure, and may as well hang.
//!   It counts for nothing.

use super::relief::CREASE_COS;
use super::search::Candidate;
use super::settled::{BETWEEN, LONGEST_MM, Settled, SettledScratch};
use crate::math::linalg::Symmetric;
use crate::math::sqrt;

/// Standard deviations by which a marker that touches lifts the gel at least.
const LIFTS: f64 = 0.25;

impl Settled<'_> {
    /// Information about (ρ ω, v) about the centroid, of the state whose prediction is in the scratch. Leaves there what
    /// every marker counts for.
    pub fn information(&self, state: &Candidate, scratch: &mut SettledScratch) -> Symmetric<6> {
        self.count(state, scratch);
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
    pub fn left_mm(&self, state: &Candidate, scratch: &mut SettledScratch) -> f64 {
        self.next(state, scratch).map_or(LONGEST_MM, |step| sqrt(step[..6].iter().map(|x| x * x).sum()))
    }

    /// What the height of every marker counts for, per mm².
    fn count(&self, state: &Candidate, scratch: &mut SettledScratch) {
        let SettledScratch { here, counts_per_mm2, .. } = scratch;
        let gel = self.gel();
        let press = state.placement.object_direction(self.press_direction);
        counts_per_mm2.clear();
        counts_per_mm2.resize(gel.nodes.len(), 0.0);
        let touched = |k: usize| here.sights[k].foot.as_ref().filter(|_| here.sights[k].touches);
        let stiffness = gel.stiffness(state.rest.log_decay);
        for (k, sight) in here.sights.iter().enumerate() {
            let Some(foot) = touched(k) else { continue };
            let free_mm = gel.free_mm(k, stiffness, &here.heights_mm);
            if here.heights_mm[k] - free_mm < LIFTS * sqrt(sight.variance_mm2) {
                continue;
            }
            let slope = foot.normal / foot.normal.dot(press);
            let wrong_squared = gel.near(k).fold(0.0, |most: f64, j| {
                let Some(other) = touched(j).filter(|other| other.normal.dot(foot.normal) < CREASE_COS)
                else {
                    return most;
                };
                let apart = slope.distance_squared(other.normal / other.normal.dot(press));
                most.max(apart * gel.nodes[k].across_mm.distance_squared(gel.nodes[j].across_mm))
            });
            counts_per_mm2[k] = sight.weight / (sight.variance_mm2 + BETWEEN * BETWEEN * wrong_squared);
        }
    }
}
