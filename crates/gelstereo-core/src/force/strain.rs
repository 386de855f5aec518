//! Uncertainty of loads because the gel is no linear layer and cells are not small.

use super::moved::MovedMarkers;
use crate::contact::RestSurface;
use crate::math::{DVec3, sqrt};
use crate::params::ForceParams;
use crate::track::MarkerState;

// The layer is no exact model of a gel. `force.strain_sigma` and the share below were chosen on the
// development half of the FEM contacts of bench/outside (294 cases, neo-Hookean gels of finite width). With
// 0.2 and 0.1, and 0.006 for shears, the mean normalised squared error of the force is 2.0 to 2.9 of 3 for
// groups of contacts by strain. With 0.35, 0.2 and 0.01 it is 0.8 to 1.1, with 0.25, 0.12 and 0.008 it is 1.5
// to 2.0.

/// The rise of loads for each unit of strain with which the rms error of the pressing force is least on those
/// gels, given their sides: 5.4 % with 0.26, 5.5 % with 0.2 and 0.3, and 7.2 % with 0. Without the sides, the
/// layer is too stiff by about as much.
const STIFFENING: f64 = 0.26;
/// The same for a contact of a single marker, and less with more markers: cells show no smaller contact.
const OF_CELLS: f64 = 0.1;

/// Of the gel under a contact.
#[derive(Clone, Copy, Debug)]
pub(super) struct Strain {
    /// Deepest indentation over the thickness.
    pub largest: f64,
    /// Seen markers of the patch.
    count: u32,
}

impl Strain {
    /// By the heights along this normal of the seen markers of the patch.
    pub fn of(moved: &MovedMarkers<'_>, rest: &RestSurface, (normal, thickness_mm): (DVec3, f64)) -> Self {
        let heights =
            moved.patch.iter().zip(moved.state).enumerate().filter_map(|(n, (&in_patch, &state))| {
                let is_known = in_patch && state == MarkerState::Seen;
                is_known.then(|| (moved.points_mm[n] - rest.points_mm()[n]).dot(normal))
            });
        let (count, deepest_mm) =
            heights.fold((0, 0.0_f64), |(count, deepest), height| (count + 1, deepest.max(height)));
        Self { largest: deepest_mm / thickness_mm, count }
    }

    /// Relative standard deviation of the loads.
    pub fn share(&self, params: &ForceParams, has_sides: bool) -> f64 {
        let missing = if has_sides { STIFFENING - params.stiffening } else { 0.0 };
        let strain = self.largest;
        let (linear, few) = (params.strain_sigma * strain, OF_CELLS / f64::from(self.count.max(1)));
        sqrt(linear * linear + missing * missing * strain * strain + few * few)
    }
}
