//! The last stages of a frame: forces, slip, and the margin that is left.

use super::{Frame, Pipeline, PipelineError};
use crate::force::MovedMarkers;
use crate::math::DVec3;
use crate::slip::{LoadedContact, Margin};

impl Pipeline {
    /// Finds forces and slip of a frame whose points and patch are known, on a gel with this normal at rest.
    pub(super) fn feel(&mut self, normal: DVec3, out: &mut Frame) -> Result<(), PipelineError> {
        out.wrench = None;
        out.traction_kpa.clear();
        if let Some(force) = &mut self.force {
            let Frame { points_mm, covariance_mm2, state, patch, traction_kpa, .. } = out;
            let moved = MovedMarkers { points_mm, covariance_mm2, state, patch };
            out.wrench = force.run(&moved, traction_kpa).map_err(PipelineError::Force)?;
        }
        out.slip = None;
        out.stick.clear();
        if let Some(slip) = &mut self.slip {
            let Frame { points_mm, covariance_mm2, state, patch, stick, traction_kpa, .. } = out;
            let mut patch = &*patch;
            if let Some(force) = &self.force {
                force.touching(traction_kpa, patch, &mut self.touching).map_err(PipelineError::Force)?;
                patch = &self.touching;
            }
            let moved = MovedMarkers { points_mm, covariance_mm2, state, patch };
            out.slip = slip.run(&moved, stick).map_err(PipelineError::Slip)?;
        }
        let Frame { points_mm, traction_kpa, wrench, slip, .. } = out;
        if let (Some(slip), Some(wrench), Some(friction)) = (slip, wrench, self.params.force.friction) {
            let friction_sigma = self.params.force.friction_sigma;
            let loads = LoadedContact { wrench, traction_kpa, points_mm, normal, friction, friction_sigma };
            slip.margin = Margin::of_limit(&loads).or(slip.margin);
        }
        Ok(())
    }
}
