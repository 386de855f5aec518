//! Whether a compliance matrix is of use for a lattice.

use super::compliance::Compliance;
use super::error::ForceError;
use super::grid::Grid;
use crate::layer::Layer;
use crate::params::{ForceMethod, ForceParams, ParamsError};

/// Checks that a matrix is of use, and of this gel.
pub(super) fn check_compliance(
    params: &ForceParams,
    compliance: Option<&Compliance>,
    grid: &Grid,
    layer: &Layer,
) -> Result<(), ForceError> {
    let Some(compliance) = compliance else { return Ok(()) };
    if params.method == ForceMethod::Resultant {
        let (setting, required) =
            ("a compliance matrix", "force.method = \"ridge\" or force.method = \"bounded\"");
        return Err(ForceError::Params(ParamsError::Requires { setting, required }));
    }
    if grid.topology.is_hexagonal() {
        let (setting, required) = ("a compliance matrix", "lattice.layout = \"square\"");
        return Err(ForceError::Params(ParamsError::Requires { setting, required }));
    }
    compliance.check_fit(grid.counts(), grid.pitch_mm, layer, params.rim_mm).map_err(ForceError::Compliance)
}
