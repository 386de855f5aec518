//! Parts and indenters by their dimensions.

use alloc::vec::Vec;
use gelstereo_core::surface::TriangleMesh;

/// A solid by its dimensions, in its own frame; lengths in millimetres.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)
)]
pub enum Shape {
    /// A ball about the origin.
    Sphere { radius_mm: f64 },
    /// About the z axis, centred.
    Cylinder { radius_mm: f64, length_mm: f64 },
    /// Centred, edges along the axes.
    Box { size_mm: [f64; 3] },
    /// A plate whose top face is z = 0 with a centred block of `protrusion_mm` on it (the paper's boards, Fig. 9 b).
    Board { size_mm: [f64; 2], block_mm: [f64; 2], protrusion_mm: f64 },
    /// A mesh file, read by whoever loads the scene and handed over as triangles.
    Mesh { path: alloc::string::String, units: alloc::string::String },
}

impl Shape {
    /// Triangles with outward normals; `None` for a mesh file.
    #[must_use]
    pub fn mesh(&self, tolerance_mm: f64) -> Option<TriangleMesh> {
        let _: (f64, Vec<u32>) = (tolerance_mm, Vec::new());
        unimplemented!()
    }
}
