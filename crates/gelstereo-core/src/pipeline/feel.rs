//! The last stages of a frame: forces, slip, and the margin that is left.

use super::{Frame, Pipeline, PipelineError};
use crate::contact::RestSurface;
use crate::force::{Compliance, ForceEstimator, MovedMarkers};
use crate::math::DVec3;
use crate::params::{ForceMethod, SlipMethod};
use crate::slip::{LoadedContact, Margin, SlipTracker};

impl Pipeline {
    /// With the gel's compliance matrix in place of the layer of `force`, from the next rest frame on.
    ///
    /// # Errors
    /// [`PipelineError::Force`] if it is of another lattice or gel; what the settings do not show, the rest
    /// frame does.
    pub fn with_compliance(self, compliance: Option<Compliance>) -> Result<Self, PipelineError> {
        let checked = compliance.as_ref().map(|compliance| compliance.check_settings(&self.params));
        checked.transpose().map_err(PipelineError::Force)?;
        Ok(Self { compliance, ..self })
    }

    /// Begins with forces and slip, if the settings ask for them, on this surface at rest.
    pub(super) fn feel_on(&mut self, surface: &RestSurface) -> Result<(), PipelineError> {
        let (force, slip) = (&self.params.force, &self.params.slip);
        let (covariance_mm2, compliance) = (&self.covariance_mm2, self.compliance.clone());
        let force = (force.method != ForceMethod::None)
            .then(|| ForceEstimator::on(force, surface, self.topology, covariance_mm2, compliance));
        let slip = (slip.method != SlipMethod::None).then(|| SlipTracker::on(slip, surface, self.topology));
        let force = force.transpose().map_err(PipelineError::Force)?;
        let slip = slip.transpose().map_err(PipelineError::Slip)?;
        (self.force, self.slip) = (force, slip);
        self.touching.reserve(surface.points_mm().len());
        Ok(())
    }

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
