//! The surface of a part as registration sees it.

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

/// After a turn that leaves every point of the surface within this of it, less than the noise of points, a contact is as
/// likely as before.
const ALIKE_MM: f64 = 0.02;

/// A part's surface: points with outward unit normals in the object frame, sampled evenly, and their tree; and if a
/// mesh is known, the exact surface.
///
/// It never changes after construction.
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
    /// Turns after which the exact surface looks the same, declared or not.
    pub(super) alike: Vec<Symmetry>,
    pub(super) relief: Option<Relief>,
    /// Whether the surface is a mesh's, and not made of the points.
    is_exact: bool,
}

impl Template {
    /// From points and outward normals (normalised here), and the typical distance of neighbouring points.
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

    /// As [`Self::new`], of normals that were normalised before and keep their bits.
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

    /// With every point taken for a small square in its tangent plane, so that the surface rungs of registration work on a
    /// scan; unchanged with an exact surface, or if the points give none.
    #[must_use]
    pub fn with_surfels(self) -> Self {
        if self.is_exact {
            return self;
        }
        match self.surfels(NEVER) {
            Ok(Some((solid, relief))) => {
                let bare = Self { solid: Some(solid), relief: Some(relief), ..self };
                bare.with_field(Self::DEFAULT_CELL_MM, Self::DEFAULT_REACH_MM)
            }
            _ => self,
        }
    }

    /// As [`Self::with_surfels`], unless it is stopped.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn with_surfels_unless(self, stop: Stop<'_>) -> Result<Self, Stopped> {
        if self.is_exact {
            return Ok(self);
        }
        let Some((solid, relief)) = self.surfels(stop)? else {
            return Ok(self);
        };
        let bare = Self { solid: Some(solid), relief: Some(relief), ..self };
        bare.with_field_unless(Self::DEFAULT_CELL_MM, Self::DEFAULT_REACH_MM, stop)
    }

    fn surfels(&self, stop: Stop<'_>) -> Result<Option<(Solid, Relief)>, Stopped> {
        surfels((&self.points_mm, &self.normals), self.curvatures_per_mm(), self.spacing_mm, stop)
    }

    /// Whether [`Self::with_surfels`] has made a surface.
    pub(super) const fn has_surfels(&self) -> bool {
        self.solid.is_some() && !self.is_exact
    }

    /// With the exact surface, and none that was made of the points.
    pub(super) fn with_solid(self, solid: Solid, stop: Stop<'_>) -> Result<Self, Stopped> {
        let relief = Some(Relief::new(&solid, stop)?);
        let mut exact = Self { solid: Some(solid), relief, field: None, is_exact: true, ..self };
        exact.alike = exact.find_symmetries_unless(ALIKE_MM, stop)?;
        Ok(exact)
    }

    /// Spacing for a part that a hand holds: a quarter of the lattice's pitch, rounded. Default of all who sample one.
    pub const DEFAULT_SPACING_MM: f64 = 0.25;

    /// Cells of a field for the surface rungs of registration ([`Self::with_field`]): under half a lattice's pitch.
    pub const DEFAULT_CELL_MM: f64 = 0.4;
    /// How far such a field reaches: deeper than a gel is pressed, and a guess is off.
    pub const DEFAULT_REACH_MM: f64 = 4.0;

    /// Samples a mesh evenly: on average one point for every `spacing_mm`² of its area, no two points of faces that
    /// look the same way (within 60 degrees) closer than 0.81 of the spacing. The same seed gives the same points.
    /// With the exact surface, and the field of distances that the surface rungs of registration need.
    ///
    /// # Errors
    /// [`TemplateError::TooFew`] or [`TemplateError::TooMany`] when the spacing does not suit the mesh's area,
    /// [`TemplateError::Spacing`] when it is not positive, [`TemplateError::Solid`] when the triangles are no surface.
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

    /// The exact surface, for a template that was made from a mesh.
    #[must_use]
    pub fn solid(&self) -> Option<&Solid> {
        self.solid.as_ref().filter(|_| self.is_exact)
    }

    /// With distances on another grid around the exact surface ([`Field::new`]) than [`Self::from_mesh`] makes; unchanged
    /// without a surface, or if the numbers make no grid.
    #[must_use]
    pub fn with_field(mut self, cell_mm: f64, reach_mm: f64) -> Self {
        self.field =
            self.solid.as_ref().and_then(|solid| Field::new(solid, cell_mm, reach_mm)).or(self.field);
        self
    }

    /// As [`Self::with_field`], unless it is stopped.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn with_field_unless(mut self, cell_mm: f64, reach_mm: f64, stop: Stop<'_>) -> Result<Self, Stopped> {
        if let Some(solid) = &self.solid {
            self.field = Field::new_unless(solid, cell_mm, reach_mm, stop)?.or(self.field);
        }
        Ok(self)
    }

    /// Without the grid.
    #[must_use]
    pub fn without_field(self) -> Self {
        Self { field: None, ..self }
    }

    /// Distances on a grid; of points, and after [`Self::without_field`], none.
    #[must_use]
    pub fn field(&self) -> Option<&Field> {
        self.field.as_ref().filter(|_| self.is_exact)
    }

    /// The surface that can be touched, its field of distances and its smooth normals: the mesh's, or what the points
    /// stand for.
    pub(super) fn touchable(&self) -> Option<(&Solid, &Field, &Relief)> {
        Some((self.solid.as_ref()?, self.field.as_ref()?, self.relief.as_ref()?))
    }

    /// The axes of a template's exact surface: after a turn, every point of the template lies within `tolerance_mm`
    /// of it.
    ///
    /// An axis goes through the area's centre along an eigenvector of its second moment; where that leaves a choice,
    /// normals of the largest faces and sums of two and three of them are tried. Of the axes across a continuous one,
    /// which are all alike, one is given; of a ball, three. Facets count: a round part is continuous if they are
    /// finer than the tolerance. None without an exact surface.
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

    /// With these symmetries instead of those it has: declared ones, or [`Self::find_symmetries`]. Registration then answers
    /// with the copy that is nearest to the guess.
    #[must_use]
    pub fn with_symmetries(mut self, symmetries: Vec<Symmetry>) -> Self {
        self.symmetries = symmetries;
        self
    }

    /// Turns after which the part looks the same, as far as [`Self::with_symmetries`] has said.
    #[must_use]
    pub fn symmetries(&self) -> &[Symmetry] {
        &self.symmetries
    }

    /// Of the poses that show the part alike, by its symmetries, the one nearest to another: the least turn away.
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

    /// How fast the normal turns around each point: the largest difference of normals per distance among its
    /// neighbours, rad/mm. 1/R on a sphere or cylinder of radius R; an edge has about twice its angle over the
    /// spacing.
    #[must_use]
    pub fn curvatures_per_mm(&self) -> &[f64] {
        &self.curvatures_per_mm
    }

    /// τ² of the normal of point `k`, read `offset_mm` away from a point that is known to `sigma_mm`: it turns by κ
    /// per millimetre, so κ² (σ² + t²/2) per axis, t the distance along the surface.
    ///
    /// Where the surface bends within a spacing, κ s > 1, that line through a step means nothing, and the variance is
    /// given as 0: a patch that overhangs an edge has to be able to slide back.
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

    /// Points and normals in the order of the tree.
    pub(super) fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// Digest of the points, normals and spacing, of the exact surface and the grid if there are any, and of the symmetries
    /// as they were said.
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
                // No order is 0: that is any turn, as in a file.
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
        return Err(TemplateError::TooFew { found: points_mm.len(), least: MIN_POINTS });
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
    // Squares of the spacing must be ordinary numbers.
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
        // The quotient of a denormal by itself is good, but its neighbours may have overflowed or lost all digits.
        if !scaled.is_finite() {
            return Err(TemplateError::ZeroNormal { index });
        }
        out.push(scaled / sqrt(scaled.length_squared()));
    }
    Ok(out)
}

/// Largest difference of normals per distance in the neighbourhood of two spacings, about a dozen points.
fn curvatures(
    points_mm: &[DVec3],
    normals: &[DVec3],
    tree: &KdTree,
    spacing_mm: f64,
    stop: Stop<'_>,
) -> Result<Vec<f64>, Stopped> {
    let radius = 2.0 * spacing_mm;
    // Samples closer than half a spacing do not place an edge any better than the sampling does.
    let least = 0.25 * spacing_mm * spacing_mm;
    let mut out = Vec::with_capacity(points_mm.len());
    for (step, (&point, &normal)) in points_mm.iter().zip(normals).enumerate() {
        ask_often(stop, step)?;
        let mut largest = 0.0_f64;
        tree.within(point, radius * radius, &mut |k, distance_squared| {
            // The far side of a thin plate is no neighbour along the surface; a right angle is.
            if normals[k].dot(normal) > -0.5 {
                largest = largest.max(normals[k].distance_squared(normal) / distance_squared.max(least));
            }
        });
        out.push(sqrt(largest));
    }
    Ok(out)
}
