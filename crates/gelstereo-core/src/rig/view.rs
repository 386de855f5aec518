//! One camera of a rig with the layers before it.

use crate::camera::{Camera, CameraError, Layers, Ray, Refraction};
use crate::math::{DMat3, DVec2, DVec3, Pose};

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

/// One camera of a rig with the layers before it: maps points of the sensor frame to pixels and pixels to
/// rays. Made by [`super::Rig::view`]; it borrows the rig and is cheap.
#[derive(Clone, Copy, Debug)]
pub struct RigView<'a> {
    camera: &'a Camera,
    /// Rotation from the sensor frame to this camera's, as a matrix, because it is applied to many vectors.
    to_camera: DMat3,
    to_sensor: DMat3,
    /// Origin of the sensor frame in this camera's frame, and this camera in the sensor frame.
    sensor_mm: DVec3,
    camera_mm: DVec3,
    refraction: Option<Refraction<'a>>,
}

/// A pixel with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// The pixel, px.
    pub pixel_px: DVec2,
    /// Rows of d pixel / d point, px/mm: gradients of column and row in the sensor frame.
    pub jacobian: [DVec3; 2],
    /// Slope of the light in air against the layers' normal (0 without layers); a start for nearby points.
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
        let to_camera = DMat3::from_quat(t_camera_sensor.rotation);
        Self {
            camera,
            to_camera,
            to_sensor: to_camera.transpose(),
            sensor_mm: t_camera_sensor.translation_mm,
            camera_mm: t_sensor_camera.translation_mm,
            refraction,
        }
    }

    /// The camera itself.
    #[must_use]
    pub const fn camera(&self) -> &'a Camera {
        self.camera
    }

    /// Pixel of a point of the sensor frame. A point before the first interface is seen in air, one
    /// within a plate through the media before it.
    ///
    /// # Errors
    /// [`CameraError::NotInFront`]; [`CameraError::TotalReflection`] only when the camera touches the layers.
    pub fn project(&self, point_mm: DVec3) -> Result<DVec2, CameraError> {
        let (local, slope) = self.local(point_mm, 0.0)?;
        self.pixel(point_mm, self.apparent(local, slope))
    }

    /// As [`Self::project`], with the derivatives. `start` is the initial slope of the search, such as
    /// that of a nearby point; 0 always works.
    ///
    /// # Errors
    /// As [`Self::project`].
    pub fn project_with_jacobian(&self, point_mm: DVec3, start: f64) -> Result<Projection, CameraError> {
        let (local, slope) = self.local(point_mm, start)?;
        let apparent = self.apparent(local, slope);
        let pixel_px = self.pixel(point_mm, apparent)?;
        Ok(Projection { pixel_px, jacobian: self.jacobian(local, apparent, slope), slope })
    }

    /// The ray of all points imaged at this pixel (sensor frame): in the gel from the last interface on,
    /// or from the camera without layers.
    ///
    /// # Errors
    /// [`CameraError::BeyondDistortion`], [`CameraError::PixelNotFinite`] or [`CameraError::MissesLayers`].
    pub fn ray(&self, pixel_px: DVec2) -> Result<Ray, CameraError> {
        let ahead = self.camera.undistort(pixel_px)?;
        Ok(self.ray_along(ahead).ok_or(CameraError::MissesLayers { pixel_px })?.0)
    }

    /// The ray of normalised coordinates and its slope in air; `None` if it does not meet the layers.
    pub(crate) fn ray_along(&self, normalised: DVec2) -> Option<(Ray, f64)> {
        let direction = normalised.extend(1.0);
        let (ray, slope) = match &self.refraction {
            None => return Some((self.ray_in_air(normalised), 0.0)),
            Some(refraction) => refraction.ray(direction)?,
        };
        let origin_mm = self.to_sensor * ray.origin_mm + self.camera_mm;
        Some((Ray { origin_mm, direction: self.to_sensor * ray.direction }, slope))
    }

    /// The ray of normalised coordinates, without layers.
    pub(crate) fn ray_in_air(&self, normalised: DVec2) -> Ray {
        Ray { origin_mm: self.camera_mm, direction: self.to_sensor * normalised.extend(1.0).normalize() }
    }

    /// Rotates a direction from the sensor frame to this camera's.
    pub(crate) fn turned(&self, direction: DVec3) -> DVec3 {
        self.to_camera * direction
    }

    /// Whether a point (sensor frame) lies behind the last interface; true without layers.
    pub(crate) fn is_in_gel(&self, point_mm: DVec3) -> bool {
        let local = self.to_camera * point_mm + self.sensor_mm;
        self.refraction.as_ref().is_none_or(|refraction| refraction.is_in_gel(local))
    }

    /// Rows of d pixel / d point at a point on a ray of this slope (sensor frame).
    pub(crate) fn jacobian_on_ray(&self, point_mm: DVec3, slope: f64) -> [DVec3; 2] {
        let local = self.to_camera * point_mm + self.sensor_mm;
        self.jacobian(local, self.apparent(local, slope), slope)
    }

    fn jacobian(&self, local: DVec3, apparent: DVec3, slope: f64) -> [DVec3; 2] {
        let rows = self.camera.projection_jacobian(apparent);
        let rows = match &self.refraction {
            None => rows,
            Some(refraction) => {
                let gradient = refraction.lift_gradient(local, slope);
                rows.map(|row| row + gradient * refraction.normal.dot(row))
            }
        };
        rows.map(|row| self.to_sensor * row)
    }

    /// Local imaging geometry at a point of the sensor frame.
    pub(super) fn seen(&self, point_mm: DVec3) -> Result<Seen<'_>, CameraError> {
        let (local, slope) = self.local(point_mm, 0.0)?;
        let apparent = self.apparent(local, slope);
        self.pixel(point_mm, apparent)?;
        let lift = self
            .refraction
            .as_ref()
            .map(|refraction| (refraction.normal, self.to_sensor * refraction.lift_gradient(local, slope)));
        let ahead = self.to_sensor * DVec3::Z;
        let depth_gradient = lift.map_or(ahead, |(normal, lift)| ahead + lift * normal.z);
        Ok(Seen {
            view: self,
            apparent,
            lift,
            depth_gradient,
            jacobian: self.jacobian(local, apparent, slope),
        })
    }

    /// The point in the camera's frame, and the slope of the light that reaches it.
    fn local(&self, point_mm: DVec3, start: f64) -> Result<(DVec3, f64), CameraError> {
        let local = self.to_camera * point_mm + self.sensor_mm;
        if !local.is_finite() {
            return Err(CameraError::NotInFront { point_mm });
        }
        let Some(refraction) = &self.refraction else { return Ok((local, 0.0)) };
        let slope = refraction.slope(local, start);
        Ok((local, slope.ok_or(CameraError::TotalReflection { point_mm })?))
    }

    fn apparent(&self, local: DVec3, slope: f64) -> DVec3 {
        self.refraction.as_ref().map_or(local, |refraction| refraction.apparent(local, slope))
    }

    fn pixel(&self, point_mm: DVec3, apparent: DVec3) -> Result<DVec2, CameraError> {
        let pixel = self.camera.project(apparent).filter(|pixel| pixel.is_finite());
        pixel.ok_or(CameraError::NotInFront { point_mm })
    }
}

/// Local imaging geometry at a point.
pub(super) struct Seen<'a> {
    view: &'a RigView<'a>,
    /// Apparent point, where it would be seen without layers (camera frame).
    pub apparent: DVec3,
    /// The layers' normal (camera frame), along which layers lift the point, and the gradient of that
    /// lift (sensor frame).
    lift: Option<(DVec3, DVec3)>,
    /// Gradient of the apparent depth (sensor frame).
    pub depth_gradient: DVec3,
    /// Rows of d pixel / d point.
    pub jacobian: [DVec3; 2],
}

impl Seen<'_> {
    /// Maps a small vector (sensor frame) to normalised coordinates, without distortion.
    pub fn normalised(&self, small_mm: DVec3) -> DVec2 {
        let lifted = self.lift.map_or(DVec3::ZERO, |(normal, lift)| normal * lift.dot(small_mm));
        let v = self.view.to_camera * small_mm + lifted;
        let p = self.apparent;
        DVec2::new(v.x - p.x / p.z * v.z, v.y - p.y / p.z * v.z) / p.z
    }
}
