//! A single camera: pinhole, lens distortion and its inverse, refraction through flat layers.

mod layers;
mod refraction;

pub use layers::{Layer, Layers, LayersError};
pub use refraction::Ray;
pub(crate) use refraction::Refraction;

use crate::math::{DVec2, DVec3, abs, sqrt};

/// A pinhole camera with the Brown-Conrady distortion of OpenCV (k1, k2, p1, p2, k3).
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct Camera {
    /// Image width, pixels.
    pub width_px: usize,
    /// Image height, pixels.
    pub height_px: usize,
    /// Horizontal focal length, pixels.
    pub fx_px: f64,
    /// Vertical focal length, pixels.
    pub fy_px: f64,
    /// Principal point's column, pixels; the first pixel's centre is at 0.
    pub cx_px: f64,
    /// Principal point's row, pixels.
    pub cy_px: f64,
    /// k1, k2, p1, p2, k3.
    #[cfg_attr(feature = "serde", serde(default))]
    pub distortion: [f64; 5],
}

/// Why a camera is invalid, a pixel has no ray or a point no pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CameraError {
    /// A size or focal length is not positive, or a number is not finite or larger than for any camera.
    Invalid {
        /// Which field.
        field: &'static str,
        /// What was found.
        found: f64,
    },
    /// The pixel lies where the distortion model folds over: it has no ray or several.
    BeyondDistortion {
        /// The pixel, px.
        pixel_px: DVec2,
    },
    /// The pixel is NaN or infinite.
    PixelNotFinite,
    /// The pixel's ray is parallel to the layers or points away from them.
    MissesLayers {
        /// The pixel, px.
        pixel_px: DVec2,
    },
    /// The point is not in front of the camera, or is NaN or infinite.
    NotInFront {
        /// The point in the sensor frame, mm.
        point_mm: DVec3,
    },
    /// Light from the point towards a camera touching the first interface is totally reflected there.
    TotalReflection {
        /// The point in the sensor frame, mm.
        point_mm: DVec3,
    },
}

impl core::fmt::Display for CameraError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Invalid { field, found } => write!(
                f,
                "the camera's {field} is {found}; sizes and focal lengths must be above 0, and no number \
                beyond {MAX_PX:e}"
            ),
            Self::BeyondDistortion { pixel_px } => write!(
                f,
                "pixel ({:.2}, {:.2}) lies beyond the range in which the distortion model can be inverted; \
                 calibrate with corners that reach this part of the image",
                pixel_px.x, pixel_px.y
            ),
            Self::PixelNotFinite => write!(f, "the pixel has a coordinate that is NaN or infinite"),
            Self::MissesLayers { pixel_px } => write!(
                f,
                "the ray of pixel ({:.2}, {:.2}) never meets the layers before the markers; is layers.normal \
                 in the sensor frame, and away from the cameras?",
                pixel_px.x, pixel_px.y
            ),
            Self::NotInFront { point_mm: p } => write!(
                f,
                "the point ({}, {}, {}) mm is not in front of the camera; valid is a positive distance along \
                 its axis, all finite",
                p.x, p.y, p.z
            ),
            Self::TotalReflection { point_mm: p } => write!(
                f,
                "light from the point ({}, {}, {}) mm is totally reflected before it reaches the camera; \
                 valid is a point within the critical angle, or a camera that does not touch the layers \
                 (layers.gap_mm > 0)",
                p.x, p.y, p.z
            ),
        }
    }
}

impl core::error::Error for CameraError {}

/// Upper bound of sizes, focal lengths, principal points and coefficients: a thousand times those of real
/// cameras. No square of a derived quantity overflows.
const MAX_PX: f64 = 1e8;

/// Upper bound of the length of distorted normalised coordinates: half a degree from the image plane,
/// beyond any calibration of this model.
const MAX_SLOPE: f64 = 100.0;

impl Camera {
    /// Checks that the numbers describe a valid camera.
    ///
    /// # Errors
    /// [`CameraError::Invalid`] naming the field.
    pub fn validate(&self) -> Result<(), CameraError> {
        let sizes = [("width_px", self.width_px as f64), ("height_px", self.height_px as f64)];
        let focals = [("fx_px", self.fx_px), ("fy_px", self.fy_px)];
        for (field, found) in sizes.into_iter().chain(focals) {
            if !(found > 0.0 && found <= MAX_PX) {
                return Err(CameraError::Invalid { field, found });
            }
        }
        let rest = [("cx_px", self.cx_px), ("cy_px", self.cy_px)];
        for (field, found) in rest.into_iter().chain(self.distortion.map(|k| ("distortion", k))) {
            if !(found.abs() <= MAX_PX) {
                return Err(CameraError::Invalid { field, found });
            }
        }
        Ok(())
    }

    /// Pixel of a point in this camera's frame (mm or any unit). `None` behind the camera, or where the
    /// distortion overflows.
    #[must_use]
    pub fn project(&self, point: DVec3) -> Option<DVec2> {
        if !(point.z > 0.0) {
            return None;
        }
        let d = self.distort(DVec2::new(point.x / point.z, point.y / point.z));
        let pixel = DVec2::new(self.fx_px * d.x + self.cx_px, self.fy_px * d.y + self.cy_px);
        pixel.is_finite().then_some(pixel)
    }

    /// Rows of d pixel / d point at a point in front of the camera (this camera's frame).
    pub(crate) fn projection_jacobian(&self, point: DVec3) -> [DVec3; 2] {
        let p = DVec2::new(point.x / point.z, point.y / point.z);
        let (a, b, c, d) = self.distortion_jacobian(p);
        let row = |f: f64, j: DVec2| (j.extend(-j.dot(p))) * (f / point.z);
        [row(self.fx_px, DVec2::new(a, b)), row(self.fy_px, DVec2::new(c, d))]
    }

    /// Distorted normalised coordinates of undistorted ones.
    #[must_use]
    pub fn distort(&self, p: DVec2) -> DVec2 {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = p.length_squared();
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        DVec2::new(
            p.x * radial + 2.0 * p1 * p.x * p.y + p2 * (r2 + 2.0 * p.x * p.x),
            p.y * radial + p1 * (r2 + 2.0 * p.y * p.y) + 2.0 * p2 * p.x * p.y,
        )
    }

    /// Normalised undistorted coordinates (x / z, y / z) of a pixel.
    ///
    /// Newton's method on the distortion with its exact Jacobian. Steps that leave the region where the model
    /// is one-to-one around the centre are rejected, instead of returning another branch's solution.
    ///
    /// # Errors
    /// [`CameraError::BeyondDistortion`] or [`CameraError::PixelNotFinite`].
    pub fn undistort(&self, pixel_px: DVec2) -> Result<DVec2, CameraError> {
        if !pixel_px.is_finite() {
            return Err(CameraError::PixelNotFinite);
        }
        let target =
            DVec2::new((pixel_px.x - self.cx_px) / self.fx_px, (pixel_px.y - self.cy_px) / self.fy_px);
        if !(target.length_squared() < MAX_SLOPE * MAX_SLOPE) {
            return Err(CameraError::BeyondDistortion { pixel_px });
        }
        if self.distortion == [0.0; 5] {
            return Ok(target);
        }
        self.invert_distortion(target).ok_or(CameraError::BeyondDistortion { pixel_px })
    }

    /// Tries the solution near the target, valid for weak distortion; otherwise follows it from the centre.
    fn invert_distortion(&self, target: DVec2) -> Option<DVec2> {
        match self.newton(target, target) {
            Some(p) if self.is_one_to_one_within(p) => Some(p),
            _ => self.follow_distortion(target),
        }
    }

    /// Whether the distortion is certainly one-to-one on the disc around the centre up to `p`. On a
    /// convex set a symmetric positive definite Jacobian suffices. Its eigenvalues are those of the
    /// radial part, at least 1 + 3 k1 r² + 5 k2 r⁴ + 7 k3 r⁶ without the positive coefficients, minus at
    /// most 6 r (|p1| + |p2|) for the tangential part.
    fn is_one_to_one_within(&self, p: DVec2) -> bool {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = p.length_squared();
        let radial = r2 * ((3.0 * k1).min(0.0) + r2 * ((5.0 * k2).min(0.0) + r2 * (7.0 * k3).min(0.0)));
        1.0 + radial - 6.0 * sqrt(r2) * (abs(p1) + abs(p2)) > 0.1
    }

    /// Follows the solution from the centre outwards (homotopy in the target's length), so that it stays
    /// on the branch of the principal point.
    fn follow_distortion(&self, target: DVec2) -> Option<DVec2> {
        let steps = 1 + (sqrt(target.length_squared()) * 4.0) as usize;
        let mut p = DVec2::ZERO;
        for step in 1..=steps {
            p = self.newton(target * (step as f64 / steps as f64), p)?;
        }
        Some(p)
    }

    fn newton(&self, target: DVec2, start: DVec2) -> Option<DVec2> {
        let scale = 1.0 + target.length_squared();
        let mut p = start;
        for _ in 0..20 {
            let residual = self.distort(p) - target;
            let (a, b, c, d) = self.distortion_jacobian(p);
            let determinant = a * d - b * c;
            if !(determinant > 1e-6) {
                return None;
            }
            let step =
                DVec2::new(d * residual.x - b * residual.y, a * residual.y - c * residual.x) / determinant;
            p -= step;
            // The error after a step is below its square times the model's curvature over its slope:
            // round-off.
            if step.length_squared() <= 1e-18 * scale {
                return Some(p);
            }
        }
        None
    }

    /// Rows of d distort / d p: ((a, b), (c, d)).
    pub(crate) fn distortion_jacobian(&self, p: DVec2) -> (f64, f64, f64, f64) {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = p.length_squared();
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)); // d radial / d r2, times 2
        let cross = slope * p.x * p.y + 2.0 * p1 * p.x + 2.0 * p2 * p.y;
        (
            radial + slope * p.x * p.x + 2.0 * p1 * p.y + 6.0 * p2 * p.x,
            cross,
            cross,
            radial + slope * p.y * p.y + 6.0 * p1 * p.y + 2.0 * p2 * p.x,
        )
    }

    /// Second derivatives of the distorted coordinates: x by xx, xy and yy, and y by yy. All are third
    /// derivatives of one potential, so the others follow.
    pub(crate) fn distortion_bend(&self, p: DVec2) -> [f64; 4] {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = p.length_squared();
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)); // as in the Jacobian
        let curve = 4.0 * (2.0 * k2 + 6.0 * r2 * k3); // d slope / d r2, times 2
        let (x, y) = (p.x, p.y);
        [
            x * (3.0 * slope + curve * x * x) + 6.0 * p2,
            y * (slope + curve * x * x) + 2.0 * p1,
            x * (slope + curve * y * y) + 2.0 * p2,
            y * (3.0 * slope + curve * y * y) + 6.0 * p1,
        ]
    }
}
