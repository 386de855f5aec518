//! A surface for templates without one: a small square in the tangent plane of every sample.
//!
//! Scans are points with normals. Their squares (surfels; Pfister et al. 2000) overlap for even sampling
//! and provide what mesh triangles do: distances, sides, and which can be touched. At a sharp edge of the
//! part they overhang by up to half their diagonal.

use super::surface::Relief;
use crate::math::DVec3;
use crate::stop::{Stop, Stopped};
use crate::surface::{Solid, SolidError, TriangleMesh};
use alloc::vec::Vec;

/// Half a square's side over the spacing. Discs of this radius leave few gaps between samples 0.81 to 1.2
/// spacings apart.
const HALF_SIDE: f64 = 0.6;

/// Squares, two triangles each; `None` for points without a valid surface, such as too distant ones.
pub(super) fn surfels(
    points_mm: &[DVec3],
    normals: &[DVec3],
    curvatures_per_mm: &[f64],
    spacing_mm: f64,
    stop: Stop<'_>,
) -> Result<Option<(Solid, Relief)>, Stopped> {
    let mut corners = Vec::with_capacity(4 * points_mm.len());
    let mut triangles = Vec::with_capacity(2 * points_mm.len());
    for (&point, normal) in points_mm.iter().zip(normals) {
        let (a, b) = normal.any_orthonormal_pair();
        let (a, b) = (a * (HALF_SIDE * spacing_mm), b * (HALF_SIDE * spacing_mm));
        let first = corners.len() as u32;
        // Counter-clockwise about the normal a × b.
        corners.extend([point - a - b, point + a - b, point + a + b, point - a + b]);
        triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    let Ok(mesh) = TriangleMesh::new(corners, triangles) else { return Ok(None) };
    match Solid::new_unless(&mesh, stop) {
        Ok(solid) => Ok(Some((solid, Relief::of_samples(normals, curvatures_per_mm)))),
        Err(SolidError::Stopped) => Err(Stopped),
        Err(_) => Ok(None),
    }
}
