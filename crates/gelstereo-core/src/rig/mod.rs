//! The calibrated stereo pair used by triangulation.

mod disc;
mod view;

pub use disc::Disc;
pub use view::{Projection, RigView, View};

use crate::camera::{Camera, CameraError, Layers, LayersError};
use crate::math::{DMat3, DVec2, DVec3, Pose, so3};

/// A calibrated stereo pair.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct Rig {
    /// The left camera; its frame is the sensor frame.
    pub left: Camera,
    /// The right camera.
    pub right: Camera,
    /// Maps left camera coordinates to right camera coordinates, as OpenCV's `T`: for a right camera at
    /// +x its translation has a negative x.
    pub t_right_left: Pose,
    /// Flat layers before the markers; `None` when cameras and markers share one medium.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub layers: Option<Layers>,
}

/// Why two cameras are not a valid rig.
#[derive(Clone, Debug, PartialEq)]
pub enum RigError {
    /// The left camera is invalid.
    Left(CameraError),
    /// The right camera is invalid.
    Right(CameraError),
    /// The layers before the markers are invalid.
    Layers(LayersError),
    /// The right camera is behind the first interface of the layers.
    RightCameraInLayers {
        /// Its distance to the interface along the normal.
        gap_mm: f64,
    },
    /// The cameras coincide, so that depth is unobservable, or are a kilometre apart.
    NoBaseline {
        /// Distance found.
        baseline_mm: f64,
    },
    /// The right camera is left of, or mostly above or in front of, the left one.
    NotSideBySide {
        /// Position of the right camera in the left camera's frame.
        right_camera_mm: DVec3,
    },
}

impl core::fmt::Display for RigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Left(error) => write!(f, "left camera: {error}"),
            Self::Right(error) => write!(f, "right camera: {error}"),
            Self::Layers(error) => error.fmt(f),
            Self::RightCameraInLayers { gap_mm } => write!(
                f,
                "the right camera is {gap_mm} mm before the first interface; valid is 0 or more: check \
                 layers.normal and layers.gap_mm, which is the left camera's distance"
            ),
            Self::NoBaseline { baseline_mm } => write!(
                f,
                "the cameras are {baseline_mm:e} mm apart; valid is {MIN_BASELINE_MM:e} to \
                 {MAX_BASELINE_MM:e} mm (is t_right_left in millimetres?)"
            ),
            Self::NotSideBySide { right_camera_mm: c } => write!(
                f,
                "the right camera stands at ({:.3}, {:.3}, {:.3}) mm in the left camera's frame; it must \
                 stand mainly towards +x (are the views swapped?)",
                c.x, c.y, c.z
            ),
        }
    }
}

impl core::error::Error for RigError {}

/// Row-aligned virtual cameras of a rig (Fusiello, Trucco and Verri 2000, with OpenCV's equal split of
/// the rotation), and Q of Eq. 3.
#[derive(Clone, Debug, PartialEq)]
pub struct Rectification {
    /// Rotates left camera coordinates to rectified ones.
    pub r_left: DMat3,
    /// Rotates right camera coordinates to rectified ones.
    pub r_right: DMat3,
    /// Focal length of both virtual cameras, pixels.
    pub f_px: f64,
    /// Principal point of both virtual cameras, pixels.
    pub c_px: DVec2,
    /// Baseline, millimetres.
    pub baseline_mm: f64,
}

/// Shortest valid baseline: below a micrometre the calibration has failed.
pub const MIN_BASELINE_MM: f64 = 1e-3;

/// Longest valid baseline.
pub const MAX_BASELINE_MM: f64 = 1e6;

impl Rig {
    /// Two equal, parallel cameras without distortion, the right one `baseline_mm` towards +x.
    #[must_use]
    pub fn parallel(camera: Camera, baseline_mm: f64) -> Self {
        let t_right_left = Pose::from_translation_mm(DVec3::new(-baseline_mm, 0.0, 0.0));
        Self { left: camera.clone(), right: camera, t_right_left, layers: None }
    }

    /// Distance between the cameras.
    #[must_use]
    pub fn baseline_mm(&self) -> f64 {
        self.t_right_left.translation_mm.length()
    }

    /// Checks that the numbers describe a valid rig.
    ///
    /// # Errors
    /// [`RigError`] with the reason.
    pub fn validate(&self) -> Result<(), RigError> {
        self.left.validate().map_err(RigError::Left)?;
        self.right.validate().map_err(RigError::Right)?;
        let baseline_mm = self.baseline_mm();
        if !(MIN_BASELINE_MM..=MAX_BASELINE_MM).contains(&baseline_mm) {
            return Err(RigError::NoBaseline { baseline_mm });
        }
        let right_camera_mm = self.t_right_left.inverse().translation_mm;
        if right_camera_mm.x < 0.5 * baseline_mm {
            return Err(RigError::NotSideBySide { right_camera_mm });
        }
        let Some(layers) = &self.layers else { return Ok(()) };
        layers.validate().map_err(RigError::Layers)?;
        let gap_mm = layers.gap_mm - layers.normal.dot(right_camera_mm);
        if !(gap_mm >= 0.0) {
            return Err(RigError::RightCameraInLayers { gap_mm });
        }
        Ok(())
    }

    /// The row-aligned virtual cameras.
    ///
    /// # Errors
    /// As [`Self::validate`].
    pub fn rectification(&self) -> Result<Rectification, RigError> {
        self.validate()?;
        // Each camera turns half the way, so that both views are distorted alike (OpenCV's
        // stereoRectify).
        let half = so3::log(self.t_right_left.rotation) * 0.5;
        let to_right = DMat3::from_quat(so3::exp(half));
        let to_left = DMat3::from_quat(so3::exp(-half));
        let t = to_left * self.t_right_left.translation_mm; // along the baseline, in the half-way frame
        let x_axis = -t / t.length();
        // Rotates about the axis perpendicular to the baseline and the half-way x axis: the smallest
        // rotation.
        let axis = x_axis.cross(DVec3::X);
        let sine = axis.length();
        let angle = crate::math::atan2(sine, x_axis.x);
        let omega = if sine > 0.0 { axis * (angle / sine) } else { DVec3::ZERO };
        let align = DMat3::from_quat(so3::exp(omega));
        Ok(Rectification {
            r_left: align * to_right,
            r_right: align * to_left,
            f_px: 0.5 * (self.left.fy_px + self.right.fy_px),
            c_px: DVec2::new(
                0.5 * (self.left.cx_px + self.right.cx_px),
                0.5 * (self.left.cy_px + self.right.cy_px),
            ),
            baseline_mm: t.length(),
        })
    }

    /// One camera with the layers before it.
    #[must_use]
    pub fn view(&self, view: View) -> RigView<'_> {
        let (camera, t_camera_sensor) = match view {
            View::Left => (&self.left, Pose::IDENTITY),
            View::Right => (&self.right, self.t_right_left),
        };
        RigView::new(camera, t_camera_sensor, self.layers.as_ref())
    }

    /// Pixels of a point of the sensor frame in both views, through any layers.
    ///
    /// # Errors
    /// As [`RigView::project`].
    pub fn project(&self, point_mm: DVec3) -> Result<(DVec2, DVec2), CameraError> {
        Ok((self.view(View::Left).project(point_mm)?, self.view(View::Right).project(point_mm)?))
    }
}

impl Rectification {
    /// Q of Eq. 3, rows: (X, Y, Z, W) = Q (x, y, d, 1) with the signed disparity d = x_left - x_right.
    #[must_use]
    pub fn q(&self) -> [[f64; 4]; 4] {
        [
            [1.0, 0.0, 0.0, -self.c_px.x],
            [0.0, 1.0, 0.0, -self.c_px.y],
            [0.0, 0.0, 0.0, self.f_px],
            [0.0, 0.0, 1.0 / self.baseline_mm, 0.0],
        ]
    }

    /// Rectified pixel of normalised coordinates in the camera rotated by `r`; `None` when the ray does
    /// not meet the virtual image.
    #[must_use]
    pub fn rectify(&self, r: &DMat3, normalised: DVec2) -> Option<DVec2> {
        let ray = *r * DVec3::new(normalised.x, normalised.y, 1.0);
        (ray.z > 0.0).then(|| DVec2::new(ray.x, ray.y) * (self.f_px / ray.z) + self.c_px)
    }
}
