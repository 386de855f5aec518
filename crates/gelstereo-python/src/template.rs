//! Templates: a part's surface.

use crate::arrays::{self, Array1, Count, Matrix, Numbers};
use crate::closest::{self, Closest, Surface, Symmetry};
use crate::errors::{MeshError, ShapeError, TemplateError, raise};
use crate::interrupt::{stoppable, stoppable_each};
use crate::pickle;
use crate::tree;
use gelstereo_core::math::{DVec3, sqrt};
use gelstereo_core::register as core;
use gelstereo_core::stop::Stop;
use gelstereo_core::surface::{Solid, TriangleMesh};
use pyo3::prelude::*;
use pyo3::types::{PyTuple, PyType};
use std::path::PathBuf;

/// A part's surface: evenly sampled points with outward unit normals in the object frame.
///
/// Created by `from_mesh`, `from_triangles` or `from_points`; a template of a mesh also keeps the exact
/// surface.
#[pyclass(frozen, module = "gelstereo")]
pub struct Template {
    inner: core::Template,
}

impl Template {
    pub const fn inner(&self) -> &core::Template {
        &self.inner
    }
}

#[pymethods]
impl Template {
    /// Sample a mesh file or a ``trimesh.Trimesh``. The points of a scan, a PLY file without triangles
    /// whose points have outward normals, are used as they are.
    ///
    /// Parameters
    /// ----------
    /// mesh : path, trimesh.Trimesh or trimesh.PointCloud
    /// units : {"mm", "cm", "m", "inch"} or None
    ///     Unit of the mesh, because mesh files do not state it. None for a STEP file, which does.
    /// spacing_mm : float
    ///     Distance of neighbouring points.
    /// seed : int
    ///     Seed of the random sampling; the same seed gives the same points.
    ///
    /// Raises
    /// ------
    /// MeshError
    ///     If the units are unknown or implausible for a hand-held part (with a guess), or the triangles are
    ///     not a surface.
    /// TemplateError
    ///     If it cannot be sampled at this spacing.
    #[classmethod]
    #[pyo3(
        signature = (mesh, *, units, spacing_mm=core::Template::DEFAULT_SPACING_MM, seed=Count(1)),
        text_signature = "($cls, mesh, *, units, spacing_mm=0.25, seed=1)"
    )]
    fn from_mesh(
        cls: &Bound<'_, PyType>,
        mesh: &Bound<'_, PyAny>,
        units: &Bound<'_, PyAny>,
        spacing_mm: f64,
        seed: Count,
    ) -> PyResult<Self> {
        let (places_mm, rest, scanned_mm) = load_part(mesh, units, spacing_mm)?;
        match scanned_mm {
            None => Self::from_triangles(cls, &places_mm, &rest, spacing_mm, seed),
            Some(spacing_mm) => Self::from_points(cls, &places_mm, &rest, spacing_mm),
        }
    }

    /// Sample triangles.
    ///
    /// Parameters
    /// ----------
    /// vertices_mm : (V, 3) array_like
    ///     Object frame.
    /// triangles : (F, 3) array_like
    ///     Indices of the corners, counter-clockwise seen from outside.
    /// spacing_mm : float
    ///     Distance of neighbouring points.
    /// seed : int
    ///     Seed of the random sampling.
    ///
    /// Raises
    /// ------
    /// MeshError, TemplateError
    ///     If the triangles are not a surface, or cannot be sampled at this spacing.
    #[classmethod]
    #[pyo3(
        signature = (vertices_mm, triangles, *, spacing_mm=core::Template::DEFAULT_SPACING_MM, seed=Count(1)),
        text_signature = "($cls, vertices_mm, triangles, *, spacing_mm=0.25, seed=1)"
    )]
    fn from_triangles(
        cls: &Bound<'_, PyType>,
        vertices_mm: &Bound<'_, PyAny>,
        triangles: &Bound<'_, PyAny>,
        spacing_mm: f64,
        seed: Count,
    ) -> PyResult<Self> {
        let mesh = triangle_mesh(vertices_mm, triangles)?;
        let seed = seed.0 as u64;
        let made =
            stoppable(cls.py(), |stop| core::Template::from_mesh_unless(&mesh, spacing_mm, seed, stop))?;
        let inner = made.map_err(raise)?;
        Ok(Self { inner })
    }

    /// From points sampled elsewhere, such as a scan. The methods on the part's surface treat each as a
    /// small square in its tangent plane.
    ///
    /// Parameters
    /// ----------
    /// points_mm, normals : (N, 3) array_like
    ///     Object frame; the normals point outward and are normalised here.
    /// spacing_mm : float
    ///     Typical distance of neighbouring points.
    ///
    /// Raises
    /// ------
    /// TemplateError
    ///     If the points are not a valid template.
    #[classmethod]
    fn from_points(
        cls: &Bound<'_, PyType>,
        points_mm: &Bound<'_, PyAny>,
        normals: &Bound<'_, PyAny>,
        spacing_mm: f64,
    ) -> PyResult<Self> {
        let (points, normals) = (Numbers::new(points_mm, "points_mm")?, Numbers::new(normals, "normals")?);
        let (points, normals) = (points.rows::<DVec3, 3>()?, normals.rows::<DVec3, 3>()?);
        let made = |stop: Stop<'_>| {
            Ok(core::Template::new_unless(points, normals, spacing_mm, stop)?.with_surfels_unless(stop)?)
        };
        let inner = stoppable(cls.py(), made)?.map_err(raise::<core::TemplateError>)?;
        Ok(Self { inner })
    }

    /// (N, 3) points, object frame.
    #[getter]
    fn points_mm(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::rows::<_, 3>(py, self.inner.points_mm().to_vec())
    }

    /// (N, 3) outward unit normals, object frame.
    #[getter]
    fn normals(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::rows::<_, 3>(py, self.inner.normals().to_vec())
    }

    /// Typical distance between neighbouring points.
    #[getter]
    fn spacing_mm(&self) -> f64 {
        self.inner.spacing_mm()
    }

    /// Digest of points, normals, the mesh, the grid and the symmetries, bit for bit.
    #[getter]
    fn digest(&self) -> u64 {
        self.inner.digest()
    }

    /// Properties of the mesh as the boundary of a body; ``None`` for a template of points.
    #[getter]
    fn surface(&self) -> Option<Surface> {
        self.inner.solid().map(|solid| Surface { inner: *solid.report() })
    }

    /// The nearest of the template's own points; the first on ties.
    ///
    /// Works for every template, with a prebuilt search tree; `closest` uses the exact surface instead.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     Object frame.
    ///
    /// Returns
    /// -------
    /// indices : (N,) int64
    ///     Rows of the template's `points_mm` and `normals`.
    /// distances_mm : (N,) float64
    ///
    /// Raises
    /// ------
    /// TemplateError
    ///     If a number is not finite.
    fn nearest(&self, py: Python<'_>, points_mm: &Bound<'_, PyAny>) -> PyResult<(Array1<i64>, Array1<f64>)> {
        let points = Numbers::new(points_mm, "points_mm")?;
        let points = finite(points.rows::<DVec3, 3>()?, "point")?;
        let tree = self.inner.tree();
        let found = stoppable_each(py, points, |&p| tree.nearest(p))?;
        let (indices, distances): (Vec<i64>, Vec<f64>) =
            found.into_iter().flatten().map(|(k, d)| (k as i64, sqrt(d))).unzip();
        Ok((arrays::list(py, indices), arrays::list(py, distances)))
    }

    /// The nearest points on the exact surface.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     Object frame.
    /// facing : (N, 3) or (3,) array_like, optional
    ///     Only faces whose outward normal has a positive dot product with this direction are searched, for
    ///     example the touched side of a thin plate.
    /// reach_mm : float, optional
    ///     Maximum distance of the search.
    /// near : (N,) array_like, optional
    ///     Initial guess: triangles of an earlier result for nearby points. It speeds up the search and does
    ///     not change the result. Default: the previous point's triangle.
    ///
    /// Returns
    /// -------
    /// Closest
    ///
    /// Raises
    /// ------
    /// TemplateError
    ///     If the template was created from points and has no exact surface, or a number is not finite.
    #[pyo3(signature = (points_mm, *, facing=None, reach_mm=None, near=None))]
    fn closest(
        &self,
        py: Python<'_>,
        points_mm: &Bound<'_, PyAny>,
        facing: Option<&Bound<'_, PyAny>>,
        reach_mm: Option<f64>,
        near: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Closest> {
        let (solid, reach_mm) = (self.solid()?, reach_mm.unwrap_or(f64::INFINITY));
        if !(reach_mm >= 0.0) {
            return Err(TemplateError::new_err(format!("reach_mm is {reach_mm}; valid is 0 or more")));
        }
        let points = Numbers::new(points_mm, "points_mm")?;
        let points = finite(points.rows::<DVec3, 3>()?, "point")?;
        let facing = facing.map(|facing| directions(facing, points.len())).transpose()?;
        let near = near.map(|near| Numbers::new(near, "near")).transpose()?;
        let near = near.as_ref().map(Numbers::list).transpose()?;
        if let Some(near) = near.filter(|near| near.len() != points.len()) {
            let (found, points) = (near.len(), points.len());
            return Err(ShapeError::new_err(format!(
                "there are {found} triangles for {points} points; valid is one for each"
            )));
        }
        let found = closest::search(py, solid, points, (facing.as_deref(), near), reach_mm)?;
        Closest::new(py, found)
    }

    /// A copy with another grid of signed distances around the exact surface. A template of a mesh has
    /// one with 0.4 mm cells and 4 mm reach, which registration uses to screen many poses.
    ///
    /// Parameters
    /// ----------
    /// cell_mm : float
    ///     Width of a cell; it is increased for a part that would need more than two million nodes.
    /// reach_mm : float
    ///     Extent of the grid from the surface: 2 to 1000 cells.
    ///
    /// Raises
    /// ------
    /// TemplateError
    ///     If the template has no exact surface, or the numbers are not valid for a grid.
    #[pyo3(
        signature = (*, cell_mm=core::Template::DEFAULT_CELL_MM, reach_mm=core::Template::DEFAULT_REACH_MM),
        text_signature = "($self, *, cell_mm=0.4, reach_mm=4.0)"
    )]
    fn with_grid(&self, py: Python<'_>, cell_mm: f64, reach_mm: f64) -> PyResult<Self> {
        self.solid()?;
        let bare = self.inner.clone().without_field();
        let made = stoppable(py, |stop| bare.with_field_unless(cell_mm, reach_mm, stop))?;
        let inner = made.map_err(raise)?;
        if inner.field().is_none() {
            return Err(TemplateError::new_err(format!(
                "a grid with cells of {cell_mm} mm and a reach of {reach_mm} mm; valid is a positive width, \
                 and a reach of 2 to 1000 cells"
            )));
        }
        Ok(Self { inner })
    }

    /// Signed distances from the grid, positive outside, and their gradients.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     Object frame.
    ///
    /// Returns
    /// -------
    /// distances_mm : (N,) float64
    ///     NaN where the surface is beyond the grid's reach, or beside a hole.
    /// gradients : (N, 3) float64
    ///
    /// Raises
    /// ------
    /// TemplateError
    ///     If there is no grid, because the template was created from points.
    fn grid_distance(&self, py: Python<'_>, points_mm: &Bound<'_, PyAny>) -> PyResult<(Array1<f64>, Matrix)> {
        let no_grid = || {
            TemplateError::new_err(
                "the template was made of points and has no grid; make it from a mesh or from triangles",
            )
        };
        let field = self.inner.field().ok_or_else(no_grid)?;
        let points = Numbers::new(points_mm, "points_mm")?;
        let points = finite(points.rows::<DVec3, 3>()?, "point")?;
        let unknown = (f64::NAN, DVec3::NAN);
        let found = stoppable_each(py, points, |&p| field.distance(p).unwrap_or(unknown))?;
        let (distances, gradients): (Vec<f64>, Vec<DVec3>) = found.into_iter().unzip();
        Ok((arrays::list(py, distances), arrays::rows::<_, 3>(py, gradients)?))
    }

    /// The declared or detected `Symmetry` s.
    #[getter]
    fn symmetries<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let all = self.inner.symmetries().iter().map(|&inner| Py::new(py, Symmetry::from(inner)));
        PyTuple::new(py, all.collect::<PyResult<Vec<_>>>()?)
    }

    /// A copy with symmetries that are declared, or detected in the exact surface. `localize` then
    /// returns the symmetric copy of the pose that is nearest to the guess, and reports the part's own
    /// turns among the free directions.
    ///
    /// Parameters
    /// ----------
    /// symmetries : sequence of Symmetry, optional
    ///     Declared symmetries. By default they are detected: axes through the area's centre for which, after
    ///     a rotation, every point of the template is within the tolerance of the surface.
    /// tolerance_mm : float
    ///     Tolerance of the detection; a round part is detected if its facets are finer than this.
    #[pyo3(signature = (symmetries=None, *, tolerance_mm=0.02))]
    fn with_symmetries(
        &self,
        py: Python<'_>,
        symmetries: Option<Vec<PyRef<'_, Symmetry>>>,
        tolerance_mm: f64,
    ) -> PyResult<Self> {
        if !(tolerance_mm > 0.0 && tolerance_mm.is_finite()) {
            return Err(TemplateError::new_err(format!("tolerance_mm is {tolerance_mm}; valid is above 0")));
        }
        let declared = symmetries.map(|all| all.iter().map(|s| s.inner()).collect::<Vec<_>>());
        if declared.is_none() {
            self.solid()?;
        }
        let all = match declared {
            Some(declared) => declared,
            None => {
                stoppable(py, |stop| self.inner.find_symmetries_unless(tolerance_mm, stop))?.map_err(raise)?
            }
        };
        let inner = py.detach(|| self.inner.clone().with_symmetries(all));
        Ok(Self { inner })
    }

    /// The symmetric copy of a pose that is nearest to another pose by turning angle, using `symmetries`.
    ///
    /// Parameters
    /// ----------
    /// t_sensor_object, other : (4, 4) array_like
    ///
    /// Returns
    /// -------
    /// (4, 4) float64
    fn nearest_copy(
        &self,
        py: Python<'_>,
        t_sensor_object: &Bound<'_, PyAny>,
        other: &Bound<'_, PyAny>,
    ) -> PyResult<Matrix> {
        let pose = arrays::pose(t_sensor_object, "t_sensor_object")?;
        let other = arrays::pose(other, "other")?;
        arrays::pose_matrix(py, &self.inner.nearest_copy(&pose, &other))
    }

    /// Write the complete template to a file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        tree::write(py, path, self.inner.to_bytes())
    }

    /// A template from a file written by `save`.
    ///
    /// Raises
    /// ------
    /// TemplateError
    ///     If the file is not a template, has another version, or is damaged.
    #[classmethod]
    fn load(cls: &Bound<'_, PyType>, path: PathBuf) -> PyResult<Self> {
        let py = cls.py();
        let bytes = tree::read_bytes(py, path.clone())?;
        let read = stoppable(py, |stop| core::Template::from_bytes_unless(&bytes, stop))?.map_err(raise);
        let inner = read.map_err(|error| tree::in_file(py, &error, &path))?;
        Ok(Self { inner })
    }

    #[classmethod]
    fn _from_bytes(cls: &Bound<'_, PyType>, data: &[u8]) -> PyResult<Self> {
        let read = stoppable(cls.py(), |stop| core::Template::from_bytes_unless(data, stop))?;
        Ok(Self { inner: read.map_err(raise)? })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<pickle::Reduced<'py>> {
        pickle::reduce(slf, "_from_bytes", &slf.get().inner.to_bytes())
    }

    fn __len__(&self) -> usize {
        self.inner.points_mm().len()
    }

    fn __repr__(&self) -> String {
        format!("<Template: {} points, {} mm apart>", self.inner.points_mm().len(), self.inner.spacing_mm())
    }
}

impl Template {
    fn solid(&self) -> PyResult<&Solid> {
        self.inner.solid().ok_or_else(|| {
            TemplateError::new_err(
                "the template was made of points and has no exact surface; make it from a mesh or from \
                triangles",
            )
        })
    }
}

/// Checks that all rows are finite.
fn finite<'a>(rows: &'a [DVec3], what: &str) -> PyResult<&'a [DVec3]> {
    match rows.iter().position(|row| !row.is_finite()) {
        Some(index) => {
            let found = rows[index];
            Err(TemplateError::new_err(format!("{what} {index} is {found}; valid is three finite numbers")))
        }
        None => Ok(rows),
    }
}

/// One direction for all points, or one per point.
fn directions(facing: &Bound<'_, PyAny>, count: usize) -> PyResult<Vec<DVec3>> {
    let facing = Numbers::new(facing, "facing")?;
    match facing.vector::<3>() {
        Ok(one) => Ok(vec![finite(&[DVec3::from_array(one)], "direction")?[0]; count]),
        Err(_) => {
            let rows = finite(facing.rows::<DVec3, 3>()?, "direction")?;
            if rows.len() == count {
                return Ok(rows.to_vec());
            }
            Err(ShapeError::new_err(format!(
                "there are {} directions for {count} points; valid is one for each, or one for all",
                rows.len()
            )))
        }
    }
}

/// Result of `templates.load_part`: vertices and triangles, or points, normals and their spacing.
type Loaded<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Option<f64>);

fn load_part<'py>(
    part: &Bound<'py, PyAny>,
    units: &Bound<'py, PyAny>,
    spacing_mm: f64,
) -> PyResult<Loaded<'py>> {
    let module = part.py().import("gelstereo.templates")?;
    module.call_method1("load_part", (part, units, spacing_mm))?.extract()
}

/// Vertices in millimetres and triangles of a mesh file or a trimesh.
pub fn load_mesh<'py>(
    mesh: &Bound<'py, PyAny>,
    units: &Bound<'py, PyAny>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    mesh.py().import("gelstereo.templates")?.call_method1("load_mesh", (mesh, units))?.extract()
}

/// The core's mesh of (V, 3) vertices and (F, 3) indices.
pub fn triangle_mesh(vertices_mm: &Bound<'_, PyAny>, triangles: &Bound<'_, PyAny>) -> PyResult<TriangleMesh> {
    let vertices = Numbers::new(vertices_mm, "vertices_mm")?;
    let triangles = Numbers::new(triangles, "triangles")?;
    let (vertices, triangles) = (vertices.rows::<DVec3, 3>()?, triangles.rows::<[f64; 3], 3>()?);
    // Indices are passed as float64, which is exact far beyond u32.
    let is_index = |x: &f64| *x >= 0.0 && *x < f64::from(u32::MAX) && *x == f64::from(*x as u32);
    for (row, triangle) in triangles.iter().enumerate() {
        if let Some(found) = triangle.iter().find(|x| !is_index(x)) {
            return Err(MeshError::new_err(format!(
                "triangle {row} names vertex {found}; valid is a whole number from 0 to {}",
                vertices.len().saturating_sub(1)
            )));
        }
    }
    let triangles = triangles.iter().map(|t| t.map(|x| x as u32)).collect();
    TriangleMesh::new(vertices.to_vec(), triangles).map_err(raise)
}
