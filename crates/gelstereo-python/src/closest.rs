//! Queries on a template's exact surface: nearest points, mesh defects, and symmetries.

use crate::arrays::{self, Array1, Matrix, Numbers};
use crate::errors::{TemplateError, raise};
use crate::interrupt::{stoppable, stoppable_each};
use crate::template::triangle_mesh;
use gelstereo_core::math::DVec3;
use gelstereo_core::register as core;
use gelstereo_core::surface::{self, Facing, Feature, Solid, SolidReport};
use numpy::PyArray2;
use pyo3::prelude::*;

/// The nearest points of a surface, one row per query point. Where nothing is within reach, the distance
/// is infinite, the triangle -1, and points and normals are NaN.
#[pyclass(frozen, get_all, module = "gelstereo")]
pub struct Closest {
    /// (N, 3) points of the surface, object frame.
    points_mm: Matrix,
    /// (N, 3) outward unit normals at the points; at an edge or vertex the angle-weighted mean of the
    /// faces' normals.
    normals: Matrix,
    /// (N,) distances, positive on the side of the normal: outside, if the surface is closed.
    distances_mm: Array1<f64>,
    /// (N,) triangles of the mesh; the first of several at the same distance.
    triangles: Array1<i64>,
    /// (N,) features that contain the points: 0 a face, 1 an edge, 2 a vertex.
    features: Array1<u8>,
}

/// Searches for every point. The initial guess is `near`, or the triangle of the previous point.
pub fn search(
    py: Python<'_>,
    solid: &Solid,
    points_mm: &[DVec3],
    (facing, near): (Option<&[DVec3]>, Option<&[f64]>),
    reach_mm: f64,
) -> PyResult<Vec<Option<surface::Closest>>> {
    let (mut last, mut next) = (None, 0..);
    let one = |&p: &DVec3| {
        let k = next.next().unwrap_or_default();
        // Saturating cast: an invalid triangle index acts as no guess.
        last = near.map(|near| near[k] as u32).or(last);
        let found = match facing {
            Some(directions) => {
                // Requires a positive product, whatever the direction's length.
                let facing = Facing { direction: directions[k], least_cosine: f64::MIN_POSITIVE };
                solid.closest_facing(p, &facing, reach_mm, last)
            }
            None => solid.closest_within(p, reach_mm, last),
        };
        last = found.map(|c| c.triangle).or(last);
        found
    };
    stoppable_each(py, points_mm, one)
}

impl Closest {
    pub fn new(py: Python<'_>, found: Vec<Option<surface::Closest>>) -> PyResult<Self> {
        let of = |read: fn(&surface::Closest) -> DVec3| -> Vec<DVec3> {
            found.iter().map(|c| c.as_ref().map_or(DVec3::NAN, read)).collect()
        };
        let (points_mm, normals) = (of(|c| c.point_mm), of(|c| c.normal));
        let distances = found.iter().map(|c| c.map_or(f64::INFINITY, |c| c.distance_mm)).collect();
        let triangles = found.iter().map(|c| c.map_or(-1, |c| i64::from(c.triangle))).collect();
        let feature = |c: surface::Closest| match c.feature {
            Feature::Face => 0,
            Feature::Edge => 1,
            Feature::Vertex => 2,
        };
        let features = found.iter().map(|c| c.map_or(0, feature)).collect();
        Ok(Self {
            points_mm: arrays::rows::<_, 3>(py, points_mm)?,
            normals: arrays::rows::<_, 3>(py, normals)?,
            distances_mm: arrays::list(py, distances),
            triangles: arrays::list(py, triangles),
            features: arrays::list(py, features),
        })
    }
}

#[pymethods]
impl Closest {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("<Closest: {} points>", self.distances_mm.bind(py).len()?))
    }
}

/// Properties of a mesh as the boundary of a body. Distances are exact despite any of these defects.
#[pyclass(frozen, module = "gelstereo")]
pub struct Surface {
    pub inner: SolidReport,
}

#[pymethods]
impl Surface {
    /// Triangles of the mesh.
    #[getter]
    const fn triangles(&self) -> usize {
        self.inner.triangles
    }

    /// Triangles whose area is zero within the rounding of their coordinates.
    #[getter]
    const fn degenerate(&self) -> usize {
        self.inner.degenerate
    }

    /// Triangles that repeat an earlier one.
    #[getter]
    const fn duplicates(&self) -> usize {
        self.inner.duplicates
    }

    /// Edges with a triangle on one side only: the rims of holes.
    #[getter]
    const fn boundary_edges(&self) -> usize {
        self.inner.boundary_edges
    }

    /// Edges along which two triangles have the same orientation, so that one of them is inside out.
    #[getter]
    const fn clashing_edges(&self) -> usize {
        self.inner.clashing_edges
    }

    /// Edges shared by more than two triangles.
    #[getter]
    const fn crowded_edges(&self) -> usize {
        self.inner.crowded_edges
    }

    /// Signed volume, mm³: negative for a closed surface that is inside out, meaningless with holes.
    #[getter]
    const fn volume_mm3(&self) -> f64 {
        self.inner.volume_mm3
    }

    /// Whether the surface separates inside from outside, so that the sign of a distance is known everywhere.
    #[getter]
    const fn is_closed(&self) -> bool {
        self.inner.is_closed()
    }

    /// Whether a closed surface has its inside and outside swapped.
    #[getter]
    fn is_inside_out(&self) -> bool {
        self.inner.is_inside_out()
    }

    fn __repr__(&self) -> String {
        let closed = if self.inner.is_closed() { "closed" } else { "open" };
        format!("<Surface: {closed}, {} triangles>", self.inner.triangles)
    }
}

/// Turn triangles so that neighbours have consistent orientation, facing outward.
///
/// Parameters
/// ----------
/// vertices_mm : (V, 3) array_like
/// triangles : (F, 3) array_like
///
/// Returns
/// -------
/// triangles : (F, 3) int64
/// stray : int
///     Number of triangles that faced the other way than most of their connected component.
/// inside_out : bool
///     Whether the complete surface was inside out.
/// surface : Surface
///     Properties after turning.
///
/// Raises
/// ------
/// MeshError
///     If the triangles are not a surface.
#[pyfunction]
pub fn turned_outward(
    py: Python<'_>,
    vertices_mm: &Bound<'_, PyAny>,
    triangles: &Bound<'_, PyAny>,
) -> PyResult<(Py<PyArray2<i64>>, usize, bool, Surface)> {
    let mesh = triangle_mesh(vertices_mm, triangles)?;
    let (mesh, turned) = stoppable(py, |stop| mesh.turned_outward_unless(stop))?.map_err(raise)?;
    let solid = stoppable(py, |stop| Solid::new_unless(&mesh, stop))?.map_err(raise)?;
    let shape = (mesh.triangles().len(), 3);
    let names = mesh.triangles().iter().flatten().map(|&i| i64::from(i)).collect();
    let surface = Surface { inner: *solid.report() };
    Ok((arrays::shaped(py, names, shape)?, turned.stray, turned.inside_out, surface))
}

/// An axis of rotational symmetry of a part.
#[pyclass(frozen, module = "gelstereo")]
pub struct Symmetry {
    inner: core::Symmetry,
}

impl From<core::Symmetry> for Symmetry {
    fn from(inner: core::Symmetry) -> Self {
        Self { inner }
    }
}

impl Symmetry {
    pub const fn inner(&self) -> core::Symmetry {
        self.inner
    }
}

#[pymethods]
impl Symmetry {
    /// Declare an axis.
    ///
    /// Parameters
    /// ----------
    /// axis : (3,) array_like
    ///     Direction of any length, object frame.
    /// centre_mm : (3,) array_like
    ///     A point on the axis, object frame.
    /// order : int, optional
    ///     Number of equal turns in a full turn, 2 or more. Default: any angle is a symmetry.
    ///
    /// Raises
    /// ------
    /// TemplateError
    ///     If the axis has no direction, or the order is below 2.
    #[new]
    #[pyo3(signature = (axis, centre_mm, order=None))]
    fn new(axis: &Bound<'_, PyAny>, centre_mm: &Bound<'_, PyAny>, order: Option<u32>) -> PyResult<Self> {
        let axis = DVec3::from_array(Numbers::new(axis, "axis")?.vector::<3>()?);
        let centre_mm = DVec3::from_array(Numbers::new(centre_mm, "centre_mm")?.vector::<3>()?);
        core::Symmetry::new(axis, centre_mm, order).map(Self::from).ok_or_else(|| {
            TemplateError::new_err(format!(
                "an axis along {axis} through {centre_mm} of order {order:?}; valid is a finite direction \
                 that is not zero, and an order of 2 or more, or None for any turn"
            ))
        })
    }

    /// (3,) unit vector, object frame.
    #[getter]
    fn axis(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.axis.to_array().to_vec())
    }

    /// (3,) a point of the axis, object frame.
    #[getter]
    fn centre_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.centre_mm.to_array().to_vec())
    }

    /// Number of equal turns that make up a full turn; ``None`` if any turn is a symmetry.
    #[getter]
    const fn order(&self) -> Option<u32> {
        self.inner.order
    }

    /// (4, 4) turn by an angle, object frame to object frame.
    fn turned(&self, py: Python<'_>, angle_rad: f64) -> PyResult<Matrix> {
        arrays::pose_matrix(py, &self.inner.turned(angle_rad))
    }

    fn __repr__(&self) -> String {
        let order = self.inner.order.map_or_else(|| "any turn".to_owned(), |n| format!("{n} turns"));
        let [x, y, z] = self.inner.axis.to_array();
        format!("<Symmetry: {order} about ({x:.4}, {y:.4}, {z:.4})>")
    }
}
