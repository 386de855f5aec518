//! One camera of a rig with the layers before it.

use crate::camera::{Camera, CameraError, Layers, Ray, Refraction};
use crate::math::{DVec2, DVec3, Pose};

/// Which camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// The left one.
    Left,
    /// The right one.
    Right,
}

impl core::fmt::Display for View {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Left => "left",
            Self::Right => "right",
        })
    }
}

/// One camera of a rig with the layers before it: from points of the sensor frame to pixels and back to rays.
/// [`super::Rig::view`] makes it; it borrows the rig and costs next to nothing.
#[derive(Clone, Copy, Debug)]
pub struct RigView<'a> {
    camera: &'a Camera,
    t_camera_sensor: Pose,
    t_sensor_camera: Pose,
    refraction: Option<Refraction<'a>>,
}

/// A pixel with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// The pixel, px.
    pub pixel_px: DVec2,
    /// Rows of d pixel / d point, px/mm: gradients of column and row in the sensor frame.
    pub jacobian: [DVec3; 2],
    /// Slope of the light in air against the layers' normal (0 without layers); a start for a point nearby.
    pub slope: f64,
}

impl<'a> RigView<'a> {
    pub(super) fn new(camera: &'a Camera, t_camera_sensor: Pose, layers: Option<&'a Layers>) -> Self {
        let t_sensor_camera = t_camera_sensor.inverse();
        let refraction = layers.map(|layers| Refraction {
            layers,
            normal: t_camera_sensor.transform_vector(layers.normal),
            gap_mm: layers.gap_mm - layers.normal.dot(t_sensor_camera.translation_mm),
        });
        Self { camera, t_camera_sensor, t_sensor_camera, refraction }
    }

    /// The camera itself.
    #[must_use]
    pub const fn camera(&self) -> &'a Camera {
        self.camera
    }

    /// Pixel of a point of the sensor frame. A point before the first interface is seen in air, one within a plate
    /// through the media before it.
    ///
    /// # Errors
    /// [`CameraError::NotInFront`]; [`CameraError::TotalReflection`], only when the camera touches the layers.
    pub fn project(&self, point_mm: DVec3) -> Result<DVec2, CameraError> {
        let apparent = match &self.refraction {
            None => self.t_camera_sensor.transform_point(point_mm),
            Some(refraction) => {
                self.name_point(point_mm, refraction.apparent(self.local(point_mm)?, 0.0))?.point
            }
        };
        self.pixel(point_mm, apparent)
    }

    /// As [`Self::project`], with the derivatives. `start` is the slope of a point nearby, to begin the search of the
    /// light's path with; 0 always does.
    ///
    /// # Errors
    /// As [`Self::project`].
    pub fn project_with_jacobian(&self, point_mm: DVec3, start: f64) -> Result<Projection, CameraError> {
        let local = self.local(point_mm)?;
        let (apparent, slope) = match &self.refraction {
            None => (local, 0.0),
            Some(refraction) => {
                let found = self.name_point(point_mm, refraction.apparent(local, start))?;
                (found.point, found.slope)
            }
        };
        let pixel_px = self.pixel(point_mm, apparent)?;
        let jacobian = self.camera.projection_jacobian(apparent).map(|row| {
            let row = self.refraction.as_ref().map_or(row, |r| r.jacobian(local, slope).transpose() * row);
            self.t_sensor_camera.transform_vector(row)
        });
        Ok(Projection { pixel_px, jacobian, slope })
    }

    /// The ray on which the points lie that this pixel shows (sensor frame): in the gel from the last interface on, or
    /// from the camera when there are no layers.
    ///
    /// # Errors
    /// [`CameraError::BeyondDistortion`], [`CameraError::PixelNotFinite`] or [`CameraError::MissesLayers`].
    pub fn ray(&self, pixel_px: DVec2) -> Result<Ray, CameraError> {
        let direction = self.camera.undistort(pixel_px)?.extend(1.0);
        let ray = match &self.refraction {
            None => Ray { origin_mm: DVec3::ZERO, direction: direction.normalize() },
            Some(refraction) => refraction.ray(direction).ok_or(CameraError::MissesLayers { pixel_px })?,
        };
        Ok(Ray {
            origin_mm: self.t_sensor_camera.transform_point(ray.origin_mm),
            direction: self.t_sensor_camera.transform_vector(ray.direction),
        })
    }

    /// The point in the camera's frame.
    fn local(&self, point_mm: DVec3) -> Result<DVec3, CameraError> {
        let local = self.t_camera_sensor.transform_point(point_mm);
        if local.is_finite() { Ok(local) } else { Err(CameraError::NotInFront { point_mm }) }
    }

    fn pixel(&self, point_mm: DVec3, apparent: DVec3) -> Result<DVec2, CameraError> {
        let pixel = self.camera.project(apparent).filter(|pixel| pixel.is_finite());
        pixel.ok_or(CameraError::NotInFront { point_mm })
    }

    /// Errors of the light's path name the point in the sensor frame.
    fn name_point<T>(&self, point_mm: DVec3, found: Result<T, CameraError>) -> Result<T, CameraError> {
        found.map_err(|error| match error {
            CameraError::TotalReflection { .. } => CameraError::TotalReflection { point_mm },
            other => other,
        })
    }
}
