//! Whether a compliance matrix is of use for a lattice.

use super::compliance::Compliance;
use super::error::ForceError;
use super::grid::Grid;
use crate::layer::Layer;
use crate::params::{ForceMethod, ForceParams, Params, ParamsError, PrintLayout};

impl Compliance {
    /// Whether the matrix can be of the sensor with these settings. Pitch and number of markers are known in
    /// the rest frame only, unless the settings state the number. `force.method = none` takes any matrix.
    ///
    /// # Errors
    /// [`ForceError::Compliance`] if the matrix is of another lattice or gel, and [`ForceError::Params`] for
    /// `force.method = resultant` and hexagonal prints, which do not use it.
    pub fn check_settings(&self, params: &Params) -> Result<(), ForceError> {
        let (force, lattice, own) = (&params.force, &params.lattice, self.gel());
        if force.method == ForceMethod::None {
            return Ok(());
        }
        check_use(force, lattice.layout == PrintLayout::Hexagonal)?;
        let counts = [lattice.cols.unwrap_or(own.cols), lattice.rows.unwrap_or(own.rows)];
        let thickness_mm = force.thickness_mm.unwrap_or(own.layer.thickness_mm);
        let layer = Layer { thickness_mm, poisson_ratio: force.poisson_ratio };
        self.check_fit(counts, own.pitch_mm, &layer, force.rim_mm).map_err(ForceError::Compliance)
    }
}

/// Checks that a matrix is of use, and of this gel.
pub(super) fn check_compliance(
    params: &ForceParams,
    compliance: Option<&Compliance>,
    grid: &Grid,
    layer: &Layer,
) -> Result<(), ForceError> {
    let Some(compliance) = compliance else { return Ok(()) };
    check_use(params, grid.topology.is_hexagonal())?;
    compliance.check_fit(grid.counts(), grid.pitch_mm, layer, params.rim_mm).map_err(ForceError::Compliance)
}

/// Refuses settings that do not use a matrix.
fn check_use(params: &ForceParams, is_hexagonal: bool) -> Result<(), ForceError> {
    let required = match params.method {
        ForceMethod::Resultant => "force.method = \"ridge\" or force.method = \"bounded\"",
        _ if is_hexagonal => "lattice.layout = \"square\"",
        _ => return Ok(()),
    };
    Err(ForceError::Params(ParamsError::Requires { setting: "a compliance matrix", required }))
}
