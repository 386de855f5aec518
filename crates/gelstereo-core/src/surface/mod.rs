//! Triangle meshes: parts, and the gel surface between the markers.

#[cfg(feature = "delaunay")]
mod dense;
#[cfg(feature = "delaunay")]
mod markers;
mod solid;

#[cfg(feature = "delaunay")]
pub use dense::{DenseFrame, DenseSurface, DenseSurfaceError};
#[cfg(feature = "delaunay")]
pub use markers::{MarkerMesh, MarkerMeshError};
pub use solid::{Closest, Facing, Feature, Field, Solid, SolidError, SolidReport, Turned};

use crate::math::DVec3;
use alloc::vec::Vec;

/// A triangle mesh, counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    vertices_mm: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

/// Why vertices and triangles are not a valid mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MeshError {
    /// No triangle has an area.
    Empty,
    /// A vertex is NaN or infinite.
    NotFinite {
        /// Which vertex.
        vertex: usize,
    },
    /// A triangle refers to a vertex that does not exist.
    NoSuchVertex {
        /// Which triangle.
        triangle: usize,
        /// The vertex it refers to.
        vertex: u32,
        /// How many vertices there are.
        vertices: usize,
    },
}

impl core::fmt::Display for MeshError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Empty => write!(f, "the mesh has no triangle with an area; a surface needs at least one"),
            Self::NotFinite { vertex } => {
                write!(f, "vertex {vertex} has a coordinate that is NaN or infinite")
            }
            Self::NoSuchVertex { triangle, vertex, vertices } => {
                write!(
                    f,
                    "triangle {triangle} names vertex {vertex}, but there are {vertices} (counted from 0)"
                )
            }
        }
    }
}

impl core::error::Error for MeshError {}

impl TriangleMesh {
    /// From vertices and index triples. Triangles without area are kept but never sampled.
    ///
    /// # Errors
    /// [`MeshError`].
    pub fn new(vertices_mm: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        if let Some(vertex) = vertices_mm.iter().position(|v| !v.is_finite()) {
            return Err(MeshError::NotFinite { vertex });
        }
        let vertices = vertices_mm.len();
        for (triangle, corners) in triangles.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|&&c| c as usize >= vertices) {
                return Err(MeshError::NoSuchVertex { triangle, vertex, vertices });
            }
        }
        let mesh = Self { vertices_mm, triangles };
        if mesh.corners().all(|c| !(area_vector(&c).length_squared() > 0.0)) {
            return Err(MeshError::Empty);
        }
        Ok(mesh)
    }

    /// Vertices, object frame.
    #[must_use]
    pub fn vertices_mm(&self) -> &[DVec3] {
        &self.vertices_mm
    }

    /// Triples of vertex indices.
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The three corners of every triangle.
    pub fn corners(&self) -> impl Iterator<Item = [DVec3; 3]> + '_ {
        self.triangles.iter().map(|t| t.map(|i| self.vertices_mm[i as usize]))
    }

    /// Smallest and largest coordinates.
    #[must_use]
    pub fn bounds_mm(&self) -> (DVec3, DVec3) {
        let first = self.vertices_mm[0];
        self.vertices_mm.iter().fold((first, first), |(low, high), &v| (low.min(v), high.max(v)))
    }
}

/// Outward normal with the triangle's area as its length.
#[must_use]
pub fn area_vector([a, b, c]: &[DVec3; 3]) -> DVec3 {
    (*b - *a).cross(*c - *a) * 0.5
}
