//! Registration of a contact patch to a part's template (Eq. 5 to 7).

use crate::math::{DVec3, Pose, linalg::Symmetric};
use crate::params::RegisterParams;
use alloc::vec::Vec;

/// A part's surface: points with outward unit normals in the object frame, sampled evenly, and their tree.
#[derive(Clone, Debug)]
pub struct Template {
    points_mm: Vec<DVec3>,
    normals: Vec<DVec3>,
    spacing_mm: f64,
}

/// Why points are no template.
#[derive(Clone, Debug, PartialEq)]
pub enum TemplateError {
    /// Too few.
    TooFew { found: usize, least: usize },
    // room owner: extend as needed
}

/// Why a registration has no answer.
#[derive(Clone, Debug, PartialEq)]
pub enum RegisterError {
    /// Too few salient points.
    TooFewPoints { found: usize, least: usize },
    // room owner: extend as needed
}

impl core::fmt::Display for TemplateError {
    fn fmt(&self, _f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        unimplemented!()
    }
}
impl core::error::Error for TemplateError {}
impl core::fmt::Display for RegisterError {
    fn fmt(&self, _f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        unimplemented!()
    }
}
impl core::error::Error for RegisterError {}

impl Template {
    /// From points and outward normals (normalised here).
    ///
    /// # Errors
    /// [`TemplateError`].
    pub fn new(points_mm: &[DVec3], normals: &[DVec3], spacing_mm: f64) -> Result<Self, TemplateError> {
        Ok(Self { points_mm: points_mm.to_vec(), normals: normals.to_vec(), spacing_mm })
    }
    /// From a surface.
    ///
    /// # Errors
    /// [`TemplateError`].
    pub fn from_mesh(
        mesh: &crate::surface::TriangleMesh,
        spacing_mm: f64,
        seed: u64,
    ) -> Result<Self, TemplateError> {
        let _ = (mesh, spacing_mm, seed);
        unimplemented!()
    }
    /// Points, object frame.
    #[must_use]
    pub fn points_mm(&self) -> &[DVec3] {
        &self.points_mm
    }
    /// Outward unit normals, object frame.
    #[must_use]
    pub fn normals(&self) -> &[DVec3] {
        &self.normals
    }
    /// Typical distance of neighbouring points.
    #[must_use]
    pub const fn spacing_mm(&self) -> f64 {
        self.spacing_mm
    }
    /// Digest of the points and normals.
    #[must_use]
    pub fn digest(&self) -> u64 {
        unimplemented!()
    }
}

/// A direction of motion that the contact does not determine, in the object's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeDirection {
    /// Rotation part of the unit twist (rad), about [`Self::centre_mm`].
    pub omega: DVec3,
    /// Translation part (mm).
    pub v: DVec3,
    /// The point that the rotation turns about (object frame): the patch's centroid.
    pub centre_mm: DVec3,
}

/// What registration found, with its evidence.
#[derive(Clone, Debug, PartialEq)]
pub struct Registration {
    /// Maps object coordinates to sensor coordinates.
    pub t_sensor_object: Pose,
    /// Information matrix of a left perturbation (ω, v) of `t_sensor_object` in the sensor frame:
    /// T_true = exp(ω, v) T; order ωx ωy ωz (rad) vx vy vz (mm).
    pub information: Symmetric<6>,
    /// Whether the steps fell below `register.step_tolerance` before the iterations ran out.
    pub converged: bool,
    /// Iterations done by the last stage.
    pub iterations: u32,
    /// Points within `register.max_distance_mm` of the template.
    pub inliers: usize,
    /// Points given.
    pub points: usize,
    /// Root mean square distance of the inliers (along the normal for point-to-plane rungs).
    pub rmse_mm: f64,
    /// Directions that the contact leaves free; empty when all six are determined.
    pub free: Vec<FreeDirection>,
}

impl Registration {
    /// Digest of all results.
    #[must_use]
    pub fn digest(&self) -> u64 {
        unimplemented!()
    }
}

/// The registration stage and its scratch.
#[derive(Clone, Debug)]
pub struct Registrar {
    params: RegisterParams,
}

impl Registrar {
    /// With these settings.
    #[must_use]
    pub fn new(params: &RegisterParams) -> Self {
        Self { params: params.clone() }
    }

    /// Registers a patch of salient points (sensor frame) to the template, from a guess.
    ///
    /// # Errors
    /// [`RegisterError`].
    pub fn run(
        &mut self,
        points_mm: &[DVec3],
        template: &Template,
        guess: &Pose,
    ) -> Result<Registration, RegisterError> {
        let _ = (&self.params, points_mm, template, guess);
        unimplemented!()
    }
}
