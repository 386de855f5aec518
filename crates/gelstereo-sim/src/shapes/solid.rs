//! The parts of a scene with their surfaces.

use super::Shape;
use crate::scene::{Scene, SceneError};
use alloc::vec::Vec;
use gelstereo_core::math::DVec3;
use gelstereo_core::surface::TriangleMesh;

/// A part by its dimensions, or by the triangles of its mesh file.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Solid<'a> {
    Shape(&'a Shape),
    Mesh(&'a TriangleMesh),
}

impl<'a> Solid<'a> {
    /// All parts of a scene; `meshes` are the surfaces of those that are mesh files, in their order.
    pub(crate) fn of(
        scene: &'a Scene,
        meshes: impl IntoIterator<Item = &'a TriangleMesh>,
    ) -> Result<Vec<Self>, SceneError> {
        let mut meshes = meshes.into_iter();
        let mut solid = |(shape, _): (&'a Shape, _)| match shape {
            Shape::Mesh { path, .. } => {
                let mesh = meshes.next().ok_or_else(|| SceneError::MeshNeeded { path: path.clone() })?;
                Ok(Self::Mesh(mesh))
            }
            shape => Ok(Self::Shape(shape)),
        };
        let solids = scene.parts().map(&mut solid).collect::<Result<_, _>>()?;
        if meshes.next().is_some() { Err(SceneError::MeshNotNeeded) } else { Ok(solids) }
    }

    /// Support function in the object's frame, as [`Shape::support_mm`].
    pub(crate) fn support_mm(&self, direction: DVec3) -> f64 {
        match self {
            Self::Shape(shape) => shape.support_mm(direction).unwrap_or(f64::INFINITY),
            Self::Mesh(mesh) => {
                mesh.vertices_mm().iter().map(|v| v.dot(direction)).fold(f64::NEG_INFINITY, f64::max)
            }
        }
    }
}
