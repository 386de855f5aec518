//! Contact detection: rest surface, saliency (Eq. 4, or by pressure), mean marker motion and the stop
//! triggers.

mod adaptive;
mod covariances;
mod decay;
mod detector;
mod pressure;
mod rule;
mod sharing;
mod smooth;
mod stencils;
mod stereo_mismatch;

pub use adaptive::{AdaptiveSaliency, ContactRule};
pub use decay::{Decay, DecayFit};
pub use detector::{ContactDetector, MarkerHeights};
pub use pressure::Pressure;
pub use stereo_mismatch::StereoMismatch;

use crate::math::linalg::{Symmetric, eigen};
use crate::math::{DVec2, DVec3, centroid, median};
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Why a cloud cannot be used as, or with, a rest surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ContactError {
    /// Fewer than three points, or all on one line.
    NoPlane {
        /// Points found.
        points: usize,
    },
    /// A cloud whose number of markers differs from the rest surface's.
    LengthMismatch {
        /// Markers of the rest surface.
        rest: usize,
        /// Markers found.
        found: usize,
    },
    /// A point is NaN or infinite.
    NotFinite {
        /// Which marker.
        index: usize,
    },
    /// An invalid decay length.
    Decay {
        /// The length found.
        found_mm: f64,
    },
}

impl core::fmt::Display for ContactError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NoPlane { points } => {
                write!(
                    f,
                    "{points} rest points span no plane; at least three that are not on one line are needed"
                )
            }
            Self::LengthMismatch { rest, found } => write!(
                f,
                "the cloud has {found} markers but the rest surface {rest}; both must come from the same \
                tracks"
            ),
            Self::NotFinite { index } => {
                write!(f, "marker {index} has a coordinate that is NaN or infinite, or a variance below 0")
            }
            Self::Decay { found_mm } => {
                write!(f, "the decay length is {found_mm} mm; valid is 0.001 to 1000 mm")
            }
        }
    }
}

impl core::error::Error for ContactError {}

/// Marker positions without contact, and the plane through them.
#[derive(Clone, Debug, PartialEq)]
pub struct RestSurface {
    points_mm: Vec<DVec3>,
    centre_mm: DVec3,
    normal: DVec3,
}

impl RestSurface {
    /// From a cloud without contact: least-squares plane (smallest eigenvector of the scatter) with its
    /// normal towards the camera.
    ///
    /// # Errors
    /// [`ContactError::NotFinite`], or [`ContactError::NoPlane`] when the points span none.
    pub fn new(points_mm: &[DVec3]) -> Result<Self, ContactError> {
        check_finite(points_mm)?;
        let centre_mm = centroid(points_mm);
        let scatter: Symmetric<3> = core::array::from_fn(|i| {
            core::array::from_fn(|j| points_mm.iter().map(|&p| (p - centre_mm)[i] * (p - centre_mm)[j]).sum())
        });
        // Squares of coordinates beyond 1e150 overflow.
        if scatter.iter().flatten().any(|entry| !entry.is_finite()) {
            return Err(ContactError::NoPlane { points: points_mm.len() });
        }
        let eigen = eigen(&scatter);
        // On a line, the two smallest eigenvalues are both rounding errors of the largest.
        if points_mm.len() < 3 || eigen.values[1] <= 1e-12 * eigen.values[2] {
            return Err(ContactError::NoPlane { points: points_mm.len() });
        }
        let up = DVec3::from_array(eigen.vectors[0]);
        let normal = if up.z > 0.0 { -up } else { up };
        Ok(Self { points_mm: points_mm.to_vec(), centre_mm, normal })
    }

    /// Unit normal of the rest plane, towards the camera (sensor frame).
    #[must_use]
    pub const fn normal(&self) -> DVec3 {
        self.normal
    }

    /// Centroid of the rest markers (sensor frame).
    #[must_use]
    pub const fn centre_mm(&self) -> DVec3 {
        self.centre_mm
    }

    /// The rest markers (sensor frame).
    #[must_use]
    pub fn points_mm(&self) -> &[DVec3] {
        &self.points_mm
    }

    /// Height of every marker above its rest height, along the rest plane's normal; positive towards the
    /// camera.
    ///
    /// # Errors
    /// [`ContactError::LengthMismatch`] or [`ContactError::NotFinite`].
    pub fn indentation_mm(&self, points_mm: &[DVec3], out: &mut Vec<f64>) -> Result<(), ContactError> {
        out.clear();
        if points_mm.len() != self.points_mm.len() {
            return Err(ContactError::LengthMismatch { rest: self.points_mm.len(), found: points_mm.len() });
        }
        check_finite(points_mm)?;
        out.extend(points_mm.iter().zip(&self.points_mm).map(|(&p, &rest)| (p - rest).dot(self.normal)));
        Ok(())
    }
}

fn check_finite(points_mm: &[DVec3]) -> Result<(), ContactError> {
    match points_mm.iter().position(|p| !p.is_finite()) {
        Some(index) => Err(ContactError::NotFinite { index }),
        None => Ok(()),
    }
}

/// Variance of a point's coordinate along a unit vector, mm².
#[must_use]
pub fn variance_along(covariance_mm2: &Symmetric<3>, direction: DVec3) -> f64 {
    let along = |row: &[f64; 3]| DVec3::from_array(*row).dot(direction);
    DVec3::new(along(&covariance_mm2[0]), along(&covariance_mm2[1]), along(&covariance_mm2[2])).dot(direction)
}

/// Largest ratio of a variance to the median one for a height that is used. Larger ones come from a
/// marker under a specular reflection, or one whose rest height was never seen. Rules with equal weights
/// would take such errors for a contact. On the path-traced development images, σ of such heights is 20
/// to 1000 times as large, of others up to 5 times.
const MAX_OF_MEDIAN: f64 = 100.0;

/// States for contact detection: a marker counts as not seen where its height's variance is more than 100
/// times the median of the seen ones. `scratch` and `out` are cleared first.
pub fn known_states(
    variance_mm2: &[f64],
    state: &[MarkerState],
    scratch: &mut Vec<f64>,
    out: &mut Vec<MarkerState>,
) {
    let markers = || variance_mm2.iter().copied().zip(state.iter().copied());
    scratch.clear();
    scratch.extend(markers().filter(|&(_, state)| state == MarkerState::Seen).map(|(variance, _)| variance));
    let limit_mm2 = median(scratch).map_or(0.0, |median_mm2| MAX_OF_MEDIAN * median_mm2);
    out.clear();
    out.extend(markers().map(|(variance_mm2, state)| match state {
        MarkerState::Seen if variance_mm2 > limit_mm2 => MarkerState::Held,
        state => state,
    }));
}

/// Eq. 4: a marker is salient if it was seen and its indentation exceeds the threshold.
pub fn saliency(indentation_mm: &[f64], state: &[MarkerState], threshold_mm: f64, out: &mut Vec<bool>) {
    out.clear();
    out.extend(
        indentation_mm.iter().zip(state).map(|(&h, &state)| state == MarkerState::Seen && h > threshold_mm),
    );
}

/// The contact patch: the salient markers indented by at least `share` of the deepest one.
pub fn patch(indentation_mm: &[f64], salient: &[bool], share: f64, out: &mut Vec<bool>) {
    let markers = || indentation_mm.iter().zip(salient);
    let deepest_mm = markers().filter(|&(_, &salient)| salient).map(|(&h, _)| h).fold(0.0, f64::max);
    out.clear();
    out.extend(markers().map(|(&h, &salient)| salient && h >= share * deepest_mm));
}

/// Mean distance of the markers that were seen from their reference positions, in pixels; 0 when none was
/// seen.
#[must_use]
pub fn mean_motion_px(reference_px: &[DVec2], now_px: &[DVec2], state: &[MarkerState]) -> f64 {
    let (mut sum, mut count) = (0.0, 0_usize);
    for ((&reference, &now), &state) in reference_px.iter().zip(now_px).zip(state) {
        if state == MarkerState::Seen {
            sum += (now - reference).length();
            count += 1;
        }
    }
    if count == 0 { 0.0 } else { sum / count as f64 }
}
