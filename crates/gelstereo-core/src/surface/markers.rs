//! The gel surface between the markers.

use super::area_vector;
use crate::math::{DVec2, DVec3};
use alloc::vec::Vec;
use spade::{DelaunayTriangulation, InsertionError, Point2, Triangulation};

/// Triangles between markers, computed once on the rest lattice. They stay valid for later frames because
/// markers keep their index.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MarkerMesh {
    markers: usize,
    triangles: Vec<[u32; 3]>,
}

/// Why there is no mesh between markers, or no normal at one of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MarkerMeshError {
    /// Fewer than three markers, or all on one line.
    Collinear {
        /// Markers found.
        markers: usize,
    },
    /// A coordinate is NaN, infinite, or outside the range of the exact predicates (magnitudes of 1e-43
    /// to 1e60).
    NotFinite {
        /// Which marker.
        marker: usize,
    },
    /// Two markers have the same position.
    Duplicate {
        /// The first one.
        first: usize,
        /// The second one.
        second: usize,
    },
    /// The numbers of points in the cloud and of markers in the mesh differ.
    LengthMismatch {
        /// Points found.
        points: usize,
        /// Markers of the mesh.
        markers: usize,
    },
    /// The triangles around a marker have no area, or face opposite ways: its normal is undefined.
    NoNormal {
        /// Which marker.
        marker: usize,
    },
}

impl core::fmt::Display for MarkerMeshError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Collinear { markers } => {
                write!(f, "the {markers} markers lie on one line; a mesh needs three that do not")
            }
            Self::NotFinite { marker } => {
                write!(
                    f,
                    "marker {marker} has a coordinate that is NaN, infinite or outside of 1e-43 to 1e60"
                )
            }
            Self::Duplicate { first, second } => {
                write!(f, "markers {first} and {second} stand at the same place; each must have its own")
            }
            Self::LengthMismatch { points, markers } => {
                write!(f, "the cloud has {points} points, but the mesh has {markers} markers")
            }
            Self::NoNormal { marker } => write!(
                f,
                "the triangles around marker {marker} have no area or face opposite ways; it has no normal"
            ),
        }
    }
}

impl core::error::Error for MarkerMeshError {}

impl MarkerMesh {
    /// Delaunay triangles of the rest positions, in pixels or millimetres, x right, y down. Marker `i` is
    /// vertex `i`.
    ///
    /// # Errors
    /// [`MarkerMeshError`] for input that has no triangulation.
    pub fn new(rest: &[DVec2]) -> Result<Self, MarkerMeshError> {
        let mut delaunay = DelaunayTriangulation::<Point2<f64>>::new();
        for (marker, p) in rest.iter().enumerate() {
            let vertex = delaunay.insert(Point2::new(p.x, p.y)).map_err(|error| match error {
                InsertionError::TooSmall | InsertionError::TooLarge | InsertionError::NAN => {
                    MarkerMeshError::NotFinite { marker }
                }
            })?;
            if vertex.index() != marker {
                return Err(MarkerMeshError::Duplicate { first: vertex.index(), second: marker });
            }
        }
        if delaunay.num_inner_faces() == 0 {
            return Err(MarkerMeshError::Collinear { markers: rest.len() });
        }
        // With y down, the triangulation's positive orientation is clockwise seen from the camera.
        // Reverse it, so that normals point towards the camera.
        let corners = |face: spade::handles::FaceHandle<'_, spade::handles::InnerTag, _, _, _, _>| {
            let [a, b, c] = face.vertices().map(|v| v.fix().index() as u32);
            [a, c, b]
        };
        Ok(Self { markers: rest.len(), triangles: delaunay.inner_faces().map(corners).collect() })
    }

    /// Number of markers of the mesh.
    #[must_use]
    pub const fn markers(&self) -> usize {
        self.markers
    }

    /// Triples of marker indices, counter-clockwise seen from the camera.
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Unit normals of a cloud at its markers, towards the camera: the area-weighted mean of the
    /// triangles around each marker. Clears `out` first; does not allocate once it has held this many.
    ///
    /// # Errors
    /// [`MarkerMeshError::LengthMismatch`], or [`MarkerMeshError::NoNormal`] at the first marker without
    /// a normal; `out` is then empty.
    pub fn normals(&self, points_mm: &[DVec3], out: &mut Vec<DVec3>) -> Result<(), MarkerMeshError> {
        out.clear();
        if points_mm.len() != self.markers {
            return Err(MarkerMeshError::LengthMismatch { points: points_mm.len(), markers: self.markers });
        }
        out.resize(self.markers, DVec3::ZERO);
        for triangle in &self.triangles {
            let area = area_vector(&triangle.map(|i| points_mm[i as usize]));
            for &i in triangle {
                out[i as usize] += area;
            }
        }
        for marker in 0..self.markers {
            let Some(normal) = out[marker].try_normalize() else {
                out.clear();
                return Err(MarkerMeshError::NoNormal { marker });
            };
            out[marker] = normal;
        }
        Ok(())
    }
}
