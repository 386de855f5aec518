//! From two views of a marker to a point in millimetres (Eq. 3), with its covariance.

use crate::camera::{Camera, CameraError};
use crate::math::linalg::Symmetric;
use crate::math::{DMat3, DQuat, DVec2, DVec3};
use crate::params::TriangulateParams;
use crate::rig::{Rectification, Rig, RigError};
use alloc::vec::Vec;

/// Why a pair of pixels is no point. `index` counts from 0 in the order given.
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
    /// A pixel has no ray.
    Ray {
        /// Which marker.
        index: usize,
        /// `"left"` or `"right"`.
        view: &'static str,
        /// Why.
        error: CameraError,
    },
    /// Disparity x_left - x_right is not above the smallest that has a meaning: the rays are parallel or diverge.
    Disparity {
        /// Which marker.
        index: usize,
        /// Signed disparity found, px.
        disparity_px: f64,
        /// Smallest valid one, px.
        min_px: f64,
        /// How many of the markers have the same fault; all of them means that the views are swapped.
        affected: usize,
        /// Markers in all.
        of: usize,
    },
}

impl core::fmt::Display for TriangulateError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Rig(error) => error.fmt(f),
            Self::LengthMismatch { left, right } => {
                write!(f, "{left} markers in the left view but {right} in the right; each pair is one marker")
            }
            Self::Ray { index, view, error } => write!(f, "marker {index}, {view} view: {error}"),
            Self::Disparity { index, disparity_px, min_px, affected, of } => {
                write!(
                    f,
                    "marker {index} has a disparity (x_left - x_right) of {disparity_px:.3e} px; valid is at least \
                     {min_px} px; {affected} of {of} markers have this fault"
                )?;
                if affected == of && *disparity_px < 0.0 {
                    write!(f, ": the left and right views are swapped")?;
                }
                Ok(())
            }
        }
    }
}

impl core::error::Error for TriangulateError {}

/// A point of the sensor frame and how well its rows agreed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoPoint {
    /// Position in the sensor (left camera) frame, millimetres.
    pub point_mm: DVec3,
    /// Rectified row in the left view minus that in the right, pixels; noise alone makes it a few tenths.
    pub epipolar_px: f64,
}

/// Triangulation with a rig's rectification worked out once.
#[derive(Clone, Debug)]
pub struct Triangulator {
    rig: Rig,
    rectification: Rectification,
    to_sensor: DQuat,
    params: TriangulateParams,
}

impl Triangulator {
    /// For this rig.
    ///
    /// # Errors
    /// [`TriangulateError::Rig`].
    pub fn new(rig: &Rig, params: &TriangulateParams) -> Result<Self, TriangulateError> {
        let rectification = rig.rectification().map_err(TriangulateError::Rig)?;
        let to_sensor = DQuat::from_mat3(&rectification.r_left).conjugate().normalize();
        Ok(Self { rig: rig.clone(), rectification, to_sensor, params: params.clone() })
    }

    /// The rig it was made for.
    #[must_use]
    pub const fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Points of corresponding pixels, in order; `out` is cleared first.
    ///
    /// # Errors
    /// [`TriangulateError`] for the first marker at fault; `out` then holds the points before it.
    pub fn run(
        &self,
        left_px: &[DVec2],
        right_px: &[DVec2],
        out: &mut Vec<StereoPoint>,
    ) -> Result<(), TriangulateError> {
        out.clear();
        if left_px.len() != right_px.len() {
            return Err(TriangulateError::LengthMismatch { left: left_px.len(), right: right_px.len() });
        }
        for (index, (&left, &right)) in left_px.iter().zip(right_px).enumerate() {
            match self.point(index, left, right) {
                Ok(point) => out.push(point),
                Err(TriangulateError::Disparity { disparity_px, min_px, .. }) => {
                    let affected = self.count_bad_disparities(left_px, right_px);
                    let of = left_px.len();
                    return Err(TriangulateError::Disparity { index, disparity_px, min_px, affected, of });
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// The point of one pair of pixels; `index` is only named in errors.
    ///
    /// # Errors
    /// [`TriangulateError::Ray`] or [`TriangulateError::Disparity`].
    pub fn point(
        &self,
        index: usize,
        left_px: DVec2,
        right_px: DVec2,
    ) -> Result<StereoPoint, TriangulateError> {
        let (l, r) = self.rectify(index, left_px, right_px)?;
        let disparity_px = l.x - r.x;
        let min_px = self.params.min_disparity_px;
        if !(disparity_px >= min_px) {
            return Err(TriangulateError::Disparity { index, disparity_px, min_px, affected: 1, of: 1 });
        }
        Ok(StereoPoint { point_mm: self.to_sensor * self.reproject(l, disparity_px), epipolar_px: l.y - r.y })
    }

    /// Covariance of a point of the sensor frame, mm², from those of its two centres, px², which are independent (first
    /// order; Eq. 3 takes the row of the left view alone; axes of image and rectified image are taken to be parallel).
    #[must_use]
    pub fn covariance_mm2(
        &self,
        point_mm: DVec3,
        left_px2: &Symmetric<2>,
        right_px2: &Symmetric<2>,
    ) -> Symmetric<3> {
        let r = &self.rectification;
        let p = self.to_sensor.conjugate() * point_mm;
        let s = p.z / r.f_px; // mm per pixel at this depth
        // d(X, Y, Z) / d(x_left, y_left, x_right) of Eq. 3, with Z = f B / d.
        let dz = p.z / r.baseline_mm * s; // mm of depth per pixel of disparity
        let along = p / p.z;
        let columns = [DVec3::X * s - along * dz, DVec3::Y * s, along * dz].map(|c| self.to_sensor * c);
        let [u, v, w] = columns;
        let ([[uu, uv], [_, vv]], ww) = (*left_px2, right_px2[0][0]);
        core::array::from_fn(|i| {
            core::array::from_fn(|j| {
                uu * u[i] * u[j] + uv * (u[i] * v[j] + v[i] * u[j]) + vv * v[i] * v[j] + ww * w[i] * w[j]
            })
        })
    }

    /// Q (x, y, d, 1), in the rectified left frame.
    fn reproject(&self, left: DVec2, disparity_px: f64) -> DVec3 {
        let r = &self.rectification;
        let scale = r.baseline_mm / disparity_px;
        DVec3::new((left.x - r.c_px.x) * scale, (left.y - r.c_px.y) * scale, r.f_px * scale)
    }

    fn rectify(&self, index: usize, left: DVec2, right: DVec2) -> Result<(DVec2, DVec2), TriangulateError> {
        let one = |view, camera: &Camera, r: &DMat3, pixel: DVec2| {
            let fail = |error| TriangulateError::Ray { index, view, error };
            let normalised = camera.undistort(pixel).map_err(fail)?;
            self.rectification
                .rectify(r, normalised)
                .ok_or(fail(CameraError::BeyondDistortion { pixel_px: pixel }))
        };
        Ok((
            one("left", &self.rig.left, &self.rectification.r_left, left)?,
            one("right", &self.rig.right, &self.rectification.r_right, right)?,
        ))
    }

    fn count_bad_disparities(&self, left_px: &[DVec2], right_px: &[DVec2]) -> usize {
        let bad = |&(&left, &right): &(&DVec2, &DVec2)| {
            matches!(self.point(0, left, right), Err(TriangulateError::Disparity { .. }))
        };
        left_px.iter().zip(right_px).filter(bad).count()
    }
}
