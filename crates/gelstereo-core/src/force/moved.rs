//! What forces, slip and motion are found from.

use crate::math::DVec3;
use crate::math::linalg::Symmetric;
use crate::track::MarkerState;

/// Markers of one frame. All lists are in the order of the rest markers.
#[derive(Clone, Copy, Debug)]
pub struct MovedMarkers<'a> {
    /// Positions, sensor frame, millimetres.
    pub points_mm: &'a [DVec3],
    /// Their covariances, mm²; those of the rest positions are added. A marker is not used if the sum is not
    /// positive definite.
    pub covariance_mm2: &'a [Symmetric<3>],
    /// Only markers that are seen are used.
    pub state: &'a [MarkerState],
    /// Whether the part touches the gel here.
    pub patch: &'a [bool],
}
