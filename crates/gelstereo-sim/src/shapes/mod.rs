//! Parts and indenters by their dimensions.

mod height;
mod raster;
mod solid;
mod triangles;

pub(crate) use raster::MeshHeight;
pub(crate) use solid::Solid;

use crate::scene::SceneError;
use alloc::string::String;
use gelstereo_core::math::{DVec3, sqrt};

/// Thickness of the plate of [`Shape::Board`], millimetres; the contact does not depend on it.
pub const BOARD_THICKNESS_MM: f64 = 3.0;

/// A solid by its dimensions, in its own frame; lengths in millimetres.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)
)]
pub enum Shape {
    /// A ball about the origin.
    Sphere {
        /// Radius. Valid: 0.001 to 1000 mm. Change it to the part's.
        radius_mm: f64,
    },
    /// About the z axis, centred.
    Cylinder {
        /// Radius. Valid: 0.001 to 1000 mm. Change it to the part's.
        radius_mm: f64,
        /// Length along z. Valid: 0.001 to 1000 mm. Change it to the part's.
        length_mm: f64,
    },
    /// Centred, edges along the axes.
    Box {
        /// Edges along x, y, z. Valid: 0.001 to 1000 mm. Change it to the part's.
        size_mm: [f64; 3],
    },
    /// A plate whose top face is z = 0 with a centred block of `protrusion_mm` on it, towards +z (the paper's
    /// boards, Fig. 9 b). Turn it by π about x to press the block into the gel.
    Board {
        /// The plate's edges along x and y. Valid: 0.001 to 1000 mm. Change it to the part's.
        size_mm: [f64; 2],
        /// The block's edges along x and y, smaller than the plate's. Valid: 0.001 to 1000 mm. Change it to
        /// the part's.
        block_mm: [f64; 2],
        /// The block's height above the plate. Valid: 0.001 to 1000 mm. Change it to the part's.
        protrusion_mm: f64,
    },
    /// A mesh file, read by the caller and passed as triangles in millimetres.
    Mesh {
        /// STL or OBJ file. A relative path starts at the folder of the file that names it. Change it to the
        /// part's.
        path: String,
        /// The mesh file's unit: `mm`, `cm`, `m` or `in`. Change it to what the file was drawn in; neither
        /// format says so.
        units: String,
    },
}

impl Shape {
    /// Checks the dimensions.
    ///
    /// # Errors
    /// [`SceneError::Invalid`] naming the dimension.
    pub fn validate(&self) -> Result<(), SceneError> {
        let length = |name, found: f64| SceneError::check((1e-3..=1e3).contains(&found), name, found, LENGTH);
        match self {
            Self::Sphere { radius_mm } => length("indenter.radius_mm", *radius_mm),
            Self::Cylinder { radius_mm, length_mm } => {
                length("indenter.radius_mm", *radius_mm)?;
                length("indenter.length_mm", *length_mm)
            }
            Self::Box { size_mm } => size_mm.iter().try_for_each(|&s| length("indenter.size_mm", s)),
            Self::Board { size_mm, block_mm, protrusion_mm } => {
                length("indenter.protrusion_mm", *protrusion_mm)?;
                size_mm.iter().zip(block_mm).try_for_each(|(&plate, &block)| {
                    length("indenter.size_mm", plate)?;
                    let fits = block >= 1e-3 && block < plate;
                    SceneError::check(
                        fits,
                        "indenter.block_mm",
                        block,
                        "0.001 mm to below the plate's indenter.size_mm",
                    )
                })
            }
            Self::Mesh { .. } => Ok(()),
        }
    }

    /// Support function: the largest `direction · x` over the solid (object frame, `direction` of unit
    /// length), or `None` for a mesh file.
    #[must_use]
    pub fn support_mm(&self, direction: DVec3) -> Option<f64> {
        let d = direction.abs();
        match self {
            Self::Sphere { radius_mm } => Some(*radius_mm),
            Self::Cylinder { radius_mm, length_mm } => {
                Some(d.z * 0.5 * length_mm + radius_mm * sqrt(d.x * d.x + d.y * d.y))
            }
            Self::Box { size_mm } => Some(0.5 * d.dot(DVec3::from_array(*size_mm))),
            Self::Board { size_mm, block_mm, protrusion_mm } => {
                let plate = 0.5 * (d.x * size_mm[0] + d.y * size_mm[1]);
                let block = 0.5 * (d.x * block_mm[0] + d.y * block_mm[1]);
                let below = (-direction.z).max(0.0) * BOARD_THICKNESS_MM;
                Some((plate + below).max(block + direction.z.max(0.0) * protrusion_mm))
            }
            Self::Mesh { .. } => None,
        }
    }
}

const LENGTH: &str = "0.001 to 1000 mm";
