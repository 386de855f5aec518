//! The surface of a part for registration.

use super::blocks::{self, Block};
use super::error::TemplateError;
use super::limits::{MAX_POINTS, MIN_POINTS, MIN_SPACING, REACH_MM};
use super::sample;
use super::surface::Relief;
use super::surfels::surfels;
use super::symmetry::Symmetry;
use super::symmetry_axes::symmetries;
use crate::digest::Digest;
use crate::math::{DVec3, Pose, sqrt};
use crate::spatial::KdTree;
use crate::stop::{NEVER, Stop, Stopped, ask_often};
use crate::surface::{Field, Solid, TriangleMesh};
use alloc::vec::Vec;

/// A contact stays equally likely under a rotation that keeps all surface points within this distance of
/// the surface, which is less than the noise of points.
const ALIKE_MM: f64 = 0.02;

/// A part's surface: evenly sampled points with outward unit normals in the object frame, their tree and,
/// if a mesh is given, the exact surface. Immutable after construction.
#[derive(Clone, Debug)]
pub struct Template {
    points_mm: Vec<DVec3>,
    normals: Vec<DVec3>,
    curvatures_per_mm: Vec<f64>,
    spacing_mm: f64,
    tree: KdTree,
    blocks: Vec<Block>,
    pub(super) solid: Option<Solid>,
    pub(super) field: Option<Field>,
    pub(super) symmetries: Vec<Symmetry>,
    /// Rotational symmetries of the exact surface, declared or not.
    pub(super) alike: Vec<Symmetry>,
    pub(super) relief: Option<Relief>,
    /// Whether the surface comes from a mesh, not from surfels.
    is_exact: bool,
}

impl Template {
    /// From points, outward normals (normalised here) and the typical distance of neighbouring points.
    /// The surface rungs of registration need [`Self::with_surfels`].
    ///
    /// # Errors
    /// [`TemplateError`].
    pub fn new(points_mm: &[DVec3], normals: &[DVec3], spacing_mm: f64) -> Result<Self, TemplateError> {
        Self::new_unless(points_mm, normals, spacing_mm, NEVER)
    }

    /// As [`Self::new`], unless it is stopped.
    ///
    /// # Errors
    /// [`TemplateError`].
    pub fn new_unless(
        points_mm: &[DVec3],
        normals: &[DVec3],
        spacing_mm: f64,
        stop: Stop<'_>,
    ) -> Result<Self, TemplateError> {
        check(points_mm, normals, spacing_mm)?;
        Ok(Self::build(points_mm.to_vec(), unit(normals)?, spacing_mm, stop)?)
    }

    /// As [`Self::new`], for unit normals, which keep their bits.
    pub(super) fn with_unit_normals(
        points_mm: Vec<DVec3>,
        normals: Vec<DVec3>,
        spacing_mm: f64,
        stop: Stop<'_>,
    ) -> Result<Self, TemplateError> {
        check(&points_mm, &normals, spacing_mm)?;
        match normals.iter().position(|n| (n.length_squared() - 1.0).abs() > 1e-9) {
            Some(index) => Err(TemplateError::ZeroNormal { index }),
            None => Ok(Self::build(points_mm, normals, spacing_mm, stop)?),
        }
    }

    fn build(
        points_mm: Vec<DVec3>,
        normals: Vec<DVec3>,
        spacing_mm: f64,
        stop: Stop<'_>,
    ) -> Result<Self, Stopped> {
        let tree = KdTree::new_unless(&points_mm, stop)?;
        let curvatures_per_mm = curvatures(&points_mm, &normals, &tree, spacing_mm, stop)?;
        let blocks = blocks::blocks(&points_mm, &normals, &tree);
        Ok(Self {
            points_mm,
            normals,
            curvatures_per_mm,
            spacing_mm,
            tree,
            blocks,
            solid: None,
            relief: None,
            field: None,
            symmetries: Vec::new(),
            alike: Vec::new(),
            is_exact: false,
        })
    }

    /// Replaces every point by a small square in its tangent plane, so that the surface rungs of
    /// registration work on a scan. No effect with an exact surface, or if the points give no surface.
    #[must_use]
    pub fn with_surfels(mut self) -> Self {
        // It is never stopped.
        let _ = self.add_surfels(NEVER);
        self
    }

    /// As [`Self::with_surfels`], unless it is stopped.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn with_surfels_unless(mut self, stop: Stop<'_>) -> Result<Self, Stopped> {
        self.add_surfels(stop)?;
        Ok(self)
    }

    fn add_surfels(&mut self, stop: Stop<'_>) -> Result<(), Stopped> {
        if self.is_exact {
            return Ok(());
        }
        let Self { points_mm, normals, curvatures_per_mm, spacing_mm, .. } = self;
        if let Some((solid, relief)) = surfels(points_mm, normals, curvatures_per_mm, *spacing_mm, stop)? {
            (self.solid, self.relief) = (Some(solid), Some(relief));
            self.add_field(Self::DEFAULT_CELL_MM, Self::DEFAULT_REACH_MM, stop)?;
        }
        Ok(())
    }

    /// Whether [`Self::with_surfels`] has built a surface.
    pub(super) const fn has_surfels(&self) -> bool {
        self.solid.is_some() && !self.is_exact
    }

    /// With this exact surface, replacing any surfels.
    pub(super) fn with_solid(self, solid: Solid, stop: Stop<'_>) -> Result<Self, Stopped> {
        let relief = Some(Relief::new(&solid, stop)?);
        let mut exact = Self { solid: Some(solid), relief, field: None, is_exact: true, ..self };
        exact.alike = exact.find_symmetries_unless(ALIKE_MM, stop)?;
        Ok(exact)
    }

    /// Spacing for a hand-held part: a quarter of the lattice's pitch, rounded. The default wherever
    /// parts are sampled.
    pub const DEFAULT_SPACING_MM: f64 = 0.25;

    /// Cell width of a field for the surface rungs ([`Self::with_field`]): below half a lattice pitch.
    pub const DEFAULT_CELL_MM: f64 = 0.4;
    /// Reach of such a field: more than the press depth and the error of a guess.
    pub const DEFAULT_REACH_MM: f64 = 4.0;

    /// Samples a mesh evenly: on average one point per `spacing_mm`² of area. Points on faces of similar
    /// orientation (within 60 degrees) are at least 0.81 of the spacing apart. The same seed gives the
    /// same points. Includes the exact surface, and the distance field that the surface rungs of
    /// registration need.
    ///
    /// # Errors
    /// [`TemplateError::TooFew`] or [`TemplateError::TooMany`] when the spacing does not suit the mesh's
    /// area, [`TemplateError::Spacing`] when it is not positive, [`TemplateError::Solid`] when the
    /// triangles are not a valid surface.
    pub fn from_mesh(mesh: &TriangleMesh, spacing_mm: f64, seed: u64) -> Result<Self, TemplateError> {
        Self::from_mesh_unless(mesh, spacing_mm, seed, NEVER)
    }

    /// As [`Self::from_mesh`], unless it is stopped.
    ///
    /// # Errors
    /// As [`Self::from_mesh`], and [`TemplateError::Stopped`].
    pub fn from_mesh_unless(
        mesh: &TriangleMesh,
        spacing_mm: f64,
        seed: u64,
        stop: Stop<'_>,
    ) -> Result<Self, TemplateError> {
        let (points_mm, normals) = sample::evenly(mesh, spacing_mm, seed, stop)?;
        let solid = Solid::new_unless(mesh, stop)?;
        check(&points_mm, &normals, spacing_mm)?;
        let bare = Self::build(points_mm, unit(&normals)?, spacing_mm, stop)?.with_solid(solid, stop)?;
        Ok(bare.with_field_unless(Self::DEFAULT_CELL_MM, Self::DEFAULT_REACH_MM, stop)?)
    }

    /// The exact surface, for a template made from a mesh.
    #[must_use]
    pub fn solid(&self) -> Option<&Solid> {
        self.solid.as_ref().filter(|_| self.is_exact)
    }

    /// Replaces the distance grid of [`Self::from_mesh`] around the exact surface ([`Field::new`]). No
    /// effect without a surface, or if the numbers give no grid.
    #[must_use]
    pub fn with_field(mut self, cell_mm: f64, reach_mm: f64) -> Self {
        // It is never stopped.
        let _ = self.add_field(cell_mm, reach_mm, NEVER);
        self
    }

    /// As [`Self::with_field`], unless it is stopped.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn with_field_unless(mut self, cell_mm: f64, reach_mm: f64, stop: Stop<'_>) -> Result<Self, Stopped> {
        self.add_field(cell_mm, reach_mm, stop)?;
        Ok(self)
    }

    fn add_field(&mut self, cell_mm: f64, reach_mm: f64, stop: Stop<'_>) -> Result<(), Stopped> {
        let Some(solid) = &self.solid else { return Ok(()) };
        if let Some(field) = Field::new_unless(solid, cell_mm, reach_mm, stop)? {
            self.field = Some(field);
        }
        Ok(())
    }

    /// Without the distance grid.
    #[must_use]
    pub fn without_field(self) -> Self {
        Self { field: None, ..self }
    }

    /// The distance grid; `None` for a template of points, and after [`Self::without_field`].
    #[must_use]
    pub fn field(&self) -> Option<&Field> {
        self.field.as_ref().filter(|_| self.is_exact)
    }

    /// The touchable surface, its distance field and its smooth normals: from the mesh or the surfels.
    pub(super) fn touchable(&self) -> Option<(&Solid, &Field, &Relief)> {
        Some((self.solid.as_ref()?, self.field.as_ref()?, self.relief.as_ref()?))
    }

    /// The symmetry axes of a template's exact surface: after a rotation, every point of the template
    /// lies within `tolerance_mm` of it.
    ///
    /// An axis passes through the area's centroid along an eigenvector of its second moment. For degenerate
    /// moments, normals of the largest faces and sums of two and three of them are tried. Axes perpendicular
    /// to a continuous one are equivalent, and one is returned; for a ball, three. Facets count: a round part
    /// is continuous if they are finer than the tolerance. Empty without an exact surface.
    #[must_use]
    pub fn find_symmetries(&self, tolerance_mm: f64) -> Vec<Symmetry> {
        self.find_symmetries_unless(tolerance_mm, NEVER).unwrap_or_default()
    }

    /// As [`Self::find_symmetries`], unless it is stopped.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn find_symmetries_unless(
        &self,
        tolerance_mm: f64,
        stop: Stop<'_>,
    ) -> Result<Vec<Symmetry>, Stopped> {
        let Some(solid) = self.solid() else { return Ok(Vec::new()) };
        symmetries(solid, &self.points_mm, tolerance_mm, stop)
    }

    /// Replaces the symmetries by these: declared ones, or [`Self::find_symmetries`]. Registration then
    /// returns the copy nearest to the guess.
    #[must_use]
    pub fn with_symmetries(mut self, symmetries: Vec<Symmetry>) -> Self {
        self.symmetries = symmetries;
        self
    }

    /// Rotational symmetries given to [`Self::with_symmetries`].
    #[must_use]
    pub fn symmetries(&self) -> &[Symmetry] {
        &self.symmetries
    }

    /// The symmetric copy of a pose that is nearest to another pose, by rotation angle.
    #[must_use]
    pub fn nearest_copy(&self, t_sensor_object: &Pose, other: &Pose) -> Pose {
        Symmetry::nearest_copy(&self.symmetries, t_sensor_object, other)
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

    /// Curvature around each point: the largest difference of normals per distance among its neighbours,
    /// rad/mm. 1/R on a sphere or cylinder of radius R; about twice the angle over the spacing at an edge.
    #[must_use]
    pub fn curvatures_per_mm(&self) -> &[f64] {
        &self.curvatures_per_mm
    }

    /// τ² of the normal of point `k`, read `offset_mm` away from a point that is known to `sigma_mm`. The
    /// normal rotates by κ per millimetre, so κ² (σ² + t²/2) per axis, t the distance along the surface.
    ///
    /// Where the surface bends within a spacing, κ s > 1, this linear model is invalid and the variance
    /// is 0, so that a patch overhanging an edge can slide back.
    pub(super) fn step_variance(&self, k: usize, offset_mm: DVec3, sigma_mm: f64) -> f64 {
        let curvature = self.curvatures_per_mm[k];
        if curvature * self.spacing_mm > 1.0 {
            return 0.0;
        }
        let tangential_squared = offset_mm.reject_from_normalized(self.normals[k]).length_squared();
        curvature * curvature * (sigma_mm * sigma_mm + 0.5 * tangential_squared)
    }

    /// Typical distance of neighbouring points.
    #[must_use]
    pub const fn spacing_mm(&self) -> f64 {
        self.spacing_mm
    }

    /// The nearest-neighbour tree of the points.
    #[must_use]
    pub const fn tree(&self) -> &KdTree {
        &self.tree
    }

    /// Points and normals in tree order.
    pub(super) fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// Digest of the points, normals and spacing, of any exact surface and grid, and of the symmetries as
    /// declared.
    #[must_use]
    pub fn digest(&self) -> u64 {
        let numbers = |v: &DVec3| v.to_array();
        let points = Digest::new()
            .f64s(self.points_mm.iter().flat_map(numbers))
            .f64s(self.normals.iter().flat_map(numbers))
            .f64s([self.spacing_mm]);
        let solid = self.solid().map_or(points, |solid| points.u64(solid.digest()));
        let field = self.field().map_or(solid, |field| solid.u64(field.digest()));
        self.symmetries
            .iter()
            .fold(field, |sum, Symmetry { axis, centre_mm, order }| {
                // `None` is written as 0, as in files.
                sum.f64s([*axis, *centre_mm].iter().flat_map(numbers)).u64(order.unwrap_or(0).into())
            })
            .value()
    }
}

fn check(points_mm: &[DVec3], normals: &[DVec3], spacing_mm: f64) -> Result<(), TemplateError> {
    if points_mm.len() != normals.len() {
        return Err(TemplateError::Lengths { points: points_mm.len(), normals: normals.len() });
    }
    if points_mm.len() < MIN_POINTS {
        return Err(TemplateError::TooFew { found: points_mm.len(), min_points: MIN_POINTS });
    }
    if points_mm.len() > MAX_POINTS {
        return Err(TemplateError::TooMany { found: points_mm.len() as f64, spacing_mm });
    }
    let bad = |p: &DVec3| !p.is_finite() || p.abs().max_element() > REACH_MM;
    if let Some(index) = points_mm.iter().zip(normals).position(|(p, n)| bad(p) || !n.is_finite()) {
        return Err(TemplateError::NotFinite { index });
    }
    let (low, high) =
        points_mm.iter().fold((points_mm[0], points_mm[0]), |(low, high), &p| (low.min(p), high.max(p)));
    let extent_mm = (high - low).max_element();
    // Squares of the spacing must be normal numbers.
    let fits = spacing_mm.is_finite() && spacing_mm > 1e-100;
    if !(fits && spacing_mm <= extent_mm && spacing_mm >= MIN_SPACING * extent_mm) {
        return Err(TemplateError::Spacing { found_mm: spacing_mm, extent_mm });
    }
    Ok(())
}

fn unit(normals: &[DVec3]) -> Result<Vec<DVec3>, TemplateError> {
    let mut out = Vec::with_capacity(normals.len());
    for (index, &normal) in normals.iter().enumerate() {
        let largest = normal.abs().max_element();
        if largest == 0.0 {
            return Err(TemplateError::ZeroNormal { index });
        }
        let scaled = normal / largest;
        // A denormal divided by itself is exact, but the other components may have overflowed or lost all
        // digits.
        if !scaled.is_finite() {
            return Err(TemplateError::ZeroNormal { index });
        }
        out.push(scaled / sqrt(scaled.length_squared()));
    }
    Ok(out)
}

/// Largest difference of normals per distance within two spacings, about a dozen points.
fn curvatures(
    points_mm: &[DVec3],
    normals: &[DVec3],
    tree: &KdTree,
    spacing_mm: f64,
    stop: Stop<'_>,
) -> Result<Vec<f64>, Stopped> {
    let radius = 2.0 * spacing_mm;
    // Samples closer than half a spacing do not locate an edge better than the sampling does.
    let min_squared = 0.25 * spacing_mm * spacing_mm;
    let mut out = Vec::with_capacity(points_mm.len());
    for (step, (&point, &normal)) in points_mm.iter().zip(normals).enumerate() {
        ask_often(stop, step)?;
        let mut largest = 0.0_f64;
        tree.within(point, radius * radius, &mut |k, distance_squared| {
            // The far side of a thin plate is not a neighbour along the surface; a face at a right angle is.
            if normals[k].dot(normal) > -0.5 {
                largest =
                    largest.max(normals[k].distance_squared(normal) / distance_squared.max(min_squared));
            }
        });
        out.push(sqrt(largest));
    }
    Ok(out)
}
