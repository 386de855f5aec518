//! Points of the dots' centres, corrected for the bias of their images' centres.

use crate::lattice::Topology;
use crate::math::{DVec2, DVec3, median, sqrt};
use crate::rig::{Disc, View};
use crate::triangulate::{Centre, Centres, Ready};
use alloc::vec::Vec;

/// Removes from each point the bias that its dot's tilt and stretch cause in the centres of its images
/// ([`Disc`]).
///
/// The dots are printed on the gel and deform with it, so a dot's half diameters are a fixed share of the
/// steps to its neighbours: no surface model is needed.
#[derive(Clone, Debug, Default)]
pub(super) struct Discs {
    topology: Topology,
    /// Radius in pitches, at rest; `None` while nothing is corrected.
    share: Option<f64>,
    /// Markers whose points were triangulated from this frame's centres.
    pub fresh: Vec<usize>,
}

impl Discs {
    /// Starts from the lattice at rest. The dots have this radius or, without one, this median area in
    /// the left view.
    pub fn start(
        &mut self,
        topology: Topology,
        radius_pitches: Option<f64>,
        area_px2: f64,
        ready: &Ready<'_>,
        points_mm: &[DVec3],
    ) {
        (self.topology, self.share) = (topology, None);
        self.fresh.clear();
        self.fresh.extend(0..points_mm.len());
        self.share = radius_pitches.or_else(|| {
            let mut cells: Vec<f64> = (0..points_mm.len())
                .filter_map(|i| {
                    let steps = self.steps_mm(points_mm, i);
                    let seen = ready.view(View::Left).project_with_jacobian(points_mm[i], 0.0).ok()?;
                    let [a, b] = steps.map(|s| DVec2::new(seen.jacobian[0].dot(s), seen.jacobian[1].dot(s)));
                    Some(a.perp_dot(b).abs())
                })
                .collect();
            median(&mut cells).map(|cell_px2| sqrt(area_px2 / (core::f64::consts::PI * cell_px2)))
        });
    }

    /// Starts from a lattice with a known dot radius ([`Self::radius_pitches`]).
    pub const fn resume(&mut self, topology: Topology, radius_pitches: Option<f64>) {
        (self.topology, self.share) = (topology, radius_pitches);
    }

    /// Radius of the dots in pitches, at rest; `None` while nothing is corrected.
    pub const fn radius_pitches(&self) -> Option<f64> {
        self.share
    }

    /// Corrects the fresh points; points without a solution are left unchanged.
    pub fn correct(&self, ready: &Ready<'_>, left: Centres<'_>, right: Centres<'_>, points_mm: &mut [DVec3]) {
        let Some(share) = self.share else { return };
        for &i in &self.fresh {
            // Using a mix of corrected and uncorrected neighbours changes the step by a thousandth.
            let half_mm = self.steps_mm(points_mm, i).map(|step| step * share);
            let disc = Disc { centre_mm: points_mm[i], half_mm };
            let moved = |view, centre: Centre| {
                let bias_px = ready.view(view).disc_bias_px(&disc).ok()?;
                Some(Centre { at_px: centre.at_px - bias_px, ..centre })
            };
            let pair = moved(View::Left, left.at(i)).zip(moved(View::Right, right.at(i)));
            if let Some(found) = pair.and_then(|(left, right)| ready.point(i, &left, &right).ok()) {
                points_mm[i] = found.point_mm;
            }
        }
    }

    /// Vectors of one pitch along the row and across it at a marker.
    fn steps_mm(&self, points_mm: &[DVec3], i: usize) -> [DVec3; 2] {
        let place = (i / self.topology.cols(), i % self.topology.cols());
        let step = |axis| {
            let to = |count| self.topology.step_from(place, axis, count);
            let (before, after) = (to(-1), to(1));
            let steps = if before.is_some() && after.is_some() { 0.5 } else { 1.0 };
            (points_mm[after.unwrap_or(i)] - points_mm[before.unwrap_or(i)]) * steps
        };
        if self.topology.is_hexagonal() {
            // The steps down to the right and down to the left are 60 degrees apart.
            [step(0), (step(1) + step(2)) / sqrt(3.0)]
        } else {
            [step(0), step(1)]
        }
    }
}
