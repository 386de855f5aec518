//! From two views to millimetres.

use super::{ParamsError, positive};

/// From two views to millimetres.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct TriangulateParams {
    /// Smallest disparity that has a meaning; it bounds the depth at f B / min. Default: `1` px.
    pub min_disparity_px: f64,
    /// Largest distance between the rectified rows of one marker. Default: `3` px, five times the paper's 0.64.
    pub max_epipolar_px: f64,
}

impl Default for TriangulateParams {
    fn default() -> Self {
        Self { min_disparity_px: 1.0, max_epipolar_px: 3.0 }
    }
}

impl TriangulateParams {
    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        positive("triangulate.min_disparity_px", self.min_disparity_px)?;
        positive("triangulate.max_epipolar_px", self.max_epipolar_px)
    }
}
