//! Why a pair of pixels gives no point.

use crate::camera::CameraError;
use crate::rig::{RigError, View};

/// Why a pair of pixels gives no point. `index` counts from 0 in the order given.
#[derive(Clone, Debug, PartialEq)]
pub enum TriangulateError {
    /// The rig cannot be used.
    Rig(RigError),
    /// The two views have different numbers of markers.
    LengthMismatch {
        /// Markers in the left view.
        left: usize,
        /// Markers in the right view.
        right: usize,
    },
    /// The numbers of markers and covariances of a view differ.
    CovarianceCount {
        /// Which view.
        view: View,
        /// Markers in it.
        markers: usize,
        /// Covariances in it.
        covariances: usize,
    },
    /// The covariance of a centre is not positive definite.
    Covariance {
        /// Which marker.
        index: usize,
        /// Which view.
        view: View,
    },
    /// A pixel has no ray, or the point does not project into the view.
    Ray {
        /// Which marker.
        index: usize,
        /// Which view.
        view: View,
        /// Why.
        error: CameraError,
    },
    /// Disparity x_left - x_right is below the smallest meaningful one: the rays are parallel or diverge.
    Disparity {
        /// Which marker.
        index: usize,
        /// Signed disparity found, px.
        disparity_px: f64,
        /// Smallest valid one, px.
        min_px: f64,
        /// Number of markers with this fault; if all have it, the views are swapped.
        affected: usize,
        /// Number of markers.
        of: usize,
    },
    /// Some direction of the point is determined no better than rounding errors: it has no covariance.
    Unknown {
        /// Which marker.
        index: usize,
    },
    /// The two rays are so far apart that there is no most likely point.
    NoPoint {
        /// Which marker.
        index: usize,
    },
}

impl core::fmt::Display for TriangulateError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Rig(error) => error.fmt(f),
            Self::LengthMismatch { left, right } => {
                write!(f, "{left} markers in the left view but {right} in the right; each pair is one marker")
            }
            Self::CovarianceCount { view, markers, covariances } => {
                write!(
                    f,
                    "{markers} markers but {covariances} covariances in the {view} view; each marker has one"
                )
            }
            Self::Covariance { index, view } => write!(
                f,
                "marker {index}, {view} view: the centre's covariance is not positive definite; valid are \
                 finite variances above 0 and a correlation between -1 and 1"
            ),
            Self::Ray { index, view, error } => write!(f, "marker {index}, {view} view: {error}"),
            Self::Disparity { index, disparity_px, min_px, affected, of } => {
                write!(
                    f,
                    "marker {index} has a disparity (x_left - x_right) of {disparity_px:.3e} px; valid is at \
                     least {min_px} px; {affected} of {of} markers have this fault"
                )?;
                if affected == of && *disparity_px < 0.0 {
                    write!(f, ": the left and right views are swapped")?;
                }
                Ok(())
            }
            Self::Unknown { index } => write!(
                f,
                "marker {index}: the rig tells the point in some direction no better than round-off; its \
                 baseline, a focal length, a layer or a centre's covariance is beyond any sensor's"
            ),
            Self::NoPoint { index } => write!(
                f,
                "marker {index}: the rays of its two pixels are too far apart to be one marker; check that \
                 both centres belong to it, and the rig to these cameras"
            ),
        }
    }
}

impl core::error::Error for TriangulateError {}
