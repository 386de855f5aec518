//! Whether a lattice, and a compliance matrix, are of use for forces.

use super::compliance::Compliance;
use super::error::ForceError;
use super::grid::Grid;
use crate::layer::Layer;
use crate::math::{DVec3, abs};
use crate::params::{ForceMethod, ForceParams, ParamsError};

/// Largest relative difference of the pitches of a square lattice. With 0, 2 and 4.9 %, the rms error of the
/// pressing force is 6.9, 6.9 and 7.0 % on the development half of the FEM contacts of bench/outside.
pub(super) const SQUARE: f64 = 0.05;

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

/// Axes of a square lattice and its pitch.
pub(super) fn square_lattice(
    rest_mm: &[DVec3],
    normal: DVec3,
    cols: usize,
) -> Result<([DVec3; 3], f64), ForceError> {
    let [x, y] = mean_steps(rest_mm, normal, cols)?;
    let found_mm = [x.length(), y.length()];
    let pitch_mm = 0.5 * (found_mm[0] + found_mm[1]);
    if !(abs(found_mm[0] - found_mm[1]) < SQUARE * pitch_mm) {
        return Err(ForceError::Pitch { found_mm });
    }
    let right = x / found_mm[0];
    let y = y - right * y.dot(right);
    Ok(([normal, right, y / y.length()], pitch_mm))
}

/// Mean steps in the plane, along rows and from row to row.
pub(super) fn mean_steps(rest_mm: &[DVec3], normal: DVec3, cols: usize) -> Result<[DVec3; 2], ForceError> {
    let markers = rest_mm.len();
    if cols < 2 || markers < 2 * cols || !markers.is_multiple_of(cols) {
        return Err(ForceError::Lattice { markers, cols });
    }
    let rows = markers / cols;
    let in_plane = |v: DVec3| v - normal * v.dot(normal);
    // The mean of the steps between neighbours is that between the ends.
    let along: DVec3 = (0..rows).map(|row| rest_mm[row * cols + cols - 1] - rest_mm[row * cols]).sum();
    let down: DVec3 = (0..cols).map(|col| rest_mm[markers - cols + col] - rest_mm[col]).sum();
    Ok([in_plane(along) / (rows * (cols - 1)) as f64, in_plane(down) / (cols * (rows - 1)) as f64])
}
