//! From two views to millimetres.

use super::{ParamsError, length, motion};

/// How two centres become a point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum TriangulateMethod {
    /// The paper's Eq. 3: the matrix Q on rectified pixels. It takes the light to be straight, so that behind
    /// layers ([`crate::camera::Layers`]) depths and heights are wrong by tens of percent, as the paper's
    /// are.
    #[default]
    Q,
    /// Polynomials in column, row and disparity, fitted to [`Self::Rays`] around the rest surface and within
    /// 1 um of it there: a quarter of the time. A marker beyond their reach, and the rest frame itself, get
    /// [`Self::Rays`].
    Polynomial,
    /// The most likely point given both centres and their covariances, with rays traced through the layers,
    /// to a thousandth of its standard deviation.
    Rays,
}

/// What becomes of the distance between the centre of a tilted dot's image and the image of the dot's centre.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum DiscBias {
    /// It stays (the paper): both views see a point that lies aside of the dot's centre, 1.9 um for each unit
    /// of slope on the simulated default rig.
    #[default]
    Ignored,
    /// It is taken off in closed form ([`RigView::disc_bias_px`](crate::rig::RigView::disc_bias_px)), with
    /// the tilt and stretch of the lattice around the marker; 0.2 um for each unit of slope are left with a
    /// radius told from areas, below 0.1 um with a known one. Points are made twice.
    Corrected,
}

/// From two views to millimetres.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct TriangulateParams {
    /// How two centres become a point. Default: the paper's [`TriangulateMethod::Q`]. Change it to `rays` for
    /// the most accurate points, at four times the time.
    pub method: TriangulateMethod,
    /// What becomes of the bias of tilted dots' images. Default: `ignored`. Change it to `corrected` for
    /// steep surfaces.
    pub disc_bias: DiscBias,
    /// Smallest disparity that has a meaning; it bounds the depth at f B / min. Valid: 0.000001 to 10000 px.
    /// Default: `1` px. Raise it to refuse matches far behind the gel.
    pub min_disparity_px: f64,
    /// Largest distance between the rectified rows of one marker. Valid: 0.000001 to 10000 px. Default: `3`
    /// px, five times the paper's 0.64. Lower it for a good calibration; raise it when rows of one marker
    /// differ more.
    pub max_epipolar_px: f64,
    /// How far a marker may move from the rest surface, sideways and towards the cameras, for the polynomial
    /// to hold; away from them it is a quarter. Valid: 0.000001 to 10000 mm. Default: `2.5` mm. Raise it for
    /// a gel that is pressed deeper.
    pub map_reach_mm: f64,
}

impl Default for TriangulateParams {
    fn default() -> Self {
        Self {
            method: TriangulateMethod::Q,
            disc_bias: DiscBias::Ignored,
            min_disparity_px: 1.0,
            max_epipolar_px: 3.0,
            map_reach_mm: 2.5,
        }
    }
}

impl TriangulateParams {
    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        motion("triangulate.min_disparity_px", self.min_disparity_px)?;
        motion("triangulate.max_epipolar_px", self.max_epipolar_px)?;
        length("triangulate.map_reach_mm", self.map_reach_mm)
    }
}
