//! Templates and registration.

use crate::arrays::{self, Array1, Count, Matrix, Numbers};
use crate::errors::{MeshError, RegisterError, raise};
use crate::params::Params;
use gelstereo_core::math::DVec3;
use gelstereo_core::register as core;
use gelstereo_core::surface::TriangleMesh;
use pyo3::prelude::*;
use pyo3::types::{PyTuple, PyType};

/// A part's surface: points with outward unit normals in the object frame, sampled evenly.
///
/// Made by `from_mesh`, `from_triangles` or `from_points`.
#[pyclass(frozen, module = "gelstereo")]
pub struct Template {
    inner: core::Template,
}

#[pymethods]
impl Template {
    /// Sample a mesh file or a ``trimesh.Trimesh``.
    ///
    /// Parameters
    /// ----------
    /// mesh : path or trimesh.Trimesh
    /// units : {"mm", "cm", "m", "inch"}
    ///     Unit of the mesh; mesh files do not say.
    /// spacing_mm : float
    ///     Distance of neighbouring points.
    /// seed : int
    ///     Of the random stream that samples; the same seed gives the same points.
    ///
    /// Raises
    /// ------
    /// MeshError
    ///     If the units are unknown, or absurd for a part in a hand (with a guess), or the triangles are no surface.
    /// TemplateError
    ///     If it cannot be sampled at this spacing.
    #[classmethod]
    #[pyo3(signature = (mesh, *, units, spacing_mm=core::Template::DEFAULT_SPACING_MM, seed=Count(1)), text_signature = "($cls, mesh, *, units, spacing_mm=0.25, seed=1)")]
    fn from_mesh(
        cls: &Bound<'_, PyType>,
        mesh: &Bound<'_, PyAny>,
        units: &Bound<'_, PyAny>,
        spacing_mm: f64,
        seed: Count,
    ) -> PyResult<Self> {
        let (vertices_mm, triangles) = load_mesh(mesh, units)?;
        Self::from_triangles(cls, &vertices_mm, &triangles, spacing_mm, seed)
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
    ///     Of the random stream that samples.
    ///
    /// Raises
    /// ------
    /// MeshError, TemplateError
    ///     If they are no surface, or cannot be sampled at this spacing.
    #[classmethod]
    #[pyo3(signature = (vertices_mm, triangles, *, spacing_mm=core::Template::DEFAULT_SPACING_MM, seed=Count(1)), text_signature = "($cls, vertices_mm, triangles, *, spacing_mm=0.25, seed=1)")]
    fn from_triangles(
        cls: &Bound<'_, PyType>,
        vertices_mm: &Bound<'_, PyAny>,
        triangles: &Bound<'_, PyAny>,
        spacing_mm: f64,
        seed: Count,
    ) -> PyResult<Self> {
        let mesh = triangle_mesh(vertices_mm, triangles)?;
        let seed = seed.0 as u64;
        let build = || {
            let template = core::Template::from_mesh(&mesh, spacing_mm, seed)?;
            Ok(template.with_field(core::Template::DEFAULT_CELL_MM, core::Template::DEFAULT_REACH_MM))
        };
        let inner = cls.py().detach(build).map_err(raise::<core::TemplateError>)?;
        Ok(Self { inner })
    }

    /// From points that were sampled elsewhere.
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
    ///     If the points are no template.
    #[classmethod]
    fn from_points(
        cls: &Bound<'_, PyType>,
        points_mm: &Bound<'_, PyAny>,
        normals: &Bound<'_, PyAny>,
        spacing_mm: f64,
    ) -> PyResult<Self> {
        let (points, normals) = (Numbers::new(points_mm, "points_mm")?, Numbers::new(normals, "normals")?);
        let (points, normals) = (points.rows::<DVec3, 3>()?, normals.rows::<DVec3, 3>()?);
        let inner = cls.py().detach(|| core::Template::new(points, normals, spacing_mm)).map_err(raise)?;
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

    /// Typical distance of neighbouring points.
    #[getter]
    fn spacing_mm(&self) -> f64 {
        self.inner.spacing_mm()
    }

    /// Digest of points and normals, bit for bit.
    #[getter]
    fn digest(&self) -> u64 {
        self.inner.digest()
    }

    fn __len__(&self) -> usize {
        self.inner.points_mm().len()
    }

    fn __repr__(&self) -> String {
        format!("<Template: {} points, {} mm apart>", self.inner.points_mm().len(), self.inner.spacing_mm())
    }
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
    // Indices come through float64, which is exact far beyond u32.
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

/// A direction of motion that the contact does not determine, in the object's frame; ``str()`` says it in words.
#[pyclass(frozen, module = "gelstereo")]
pub struct FreeDirection {
    inner: core::FreeDirection,
}

#[pymethods]
impl FreeDirection {
    /// (3,) rotation part of the twist about `centre_mm`.
    #[getter]
    fn omega(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.omega.to_array().to_vec())
    }

    /// (3,) translation part, mm.
    #[getter]
    fn v(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.v.to_array().to_vec())
    }

    /// (3,) the point that the rotation turns about, mm.
    #[getter]
    fn centre_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.centre_mm.to_array().to_vec())
    }

    fn __str__(&self) -> String {
        self.inner.to_string()
    }

    fn __repr__(&self) -> String {
        format!("<FreeDirection: {}>", self.inner)
    }
}

/// Where the part sits, with the evidence.
#[pyclass(frozen, get_all, module = "gelstereo")]
pub struct Localization {
    /// (4, 4) maps object coordinates to sensor coordinates.
    t_sensor_object: Matrix,
    /// (6, 6) information of a left perturbation (ωx ωy ωz vx vy vz) in the sensor frame; singular along `free`.
    information: Matrix,
    /// (6, 6) covariance of the same perturbation, over the determined directions; zero along `free`, where the
    /// variance has no bound.
    covariance: Matrix,
    /// Whether the steps fell below ``register.step_tolerance`` before the iterations ran out.
    converged: bool,
    /// Iterations of the last stage.
    iterations: u32,
    /// Points within ``register.max_distance_mm`` of the template.
    inliers: usize,
    /// Points given.
    points: usize,
    /// Root mean square distance of the inliers; for point-to-plane methods along the normals, each point by its
    /// probability of being in contact.
    rmse_mm: f64,
    /// The `FreeDirection` s that the contact leaves undetermined; empty when all six are known.
    free: Py<PyTuple>,
    /// Logarithm of the pose's likelihood, to compare poses of one contact; None but for the surface methods.
    log_likelihood: Option<f64>,
    /// Other poses that explain the contact about as well, likeliest first: pairs of a (4, 4) pose and its logarithm of
    /// the likelihood.
    alternatives: Py<PyTuple>,
    /// Digest of all results, bit for bit.
    digest: u64,
}

impl Localization {
    fn new(py: Python<'_>, found: core::Registration) -> PyResult<Self> {
        let (digest, covariance) = (found.digest(), found.covariance());
        let free = found.free.iter().map(|&inner| Py::new(py, FreeDirection { inner }));
        let other =
            |a: &core::Alternative| Ok((arrays::pose_matrix(py, &a.t_sensor_object)?, a.log_likelihood));
        let alternatives = found.alternatives.iter().map(other).collect::<PyResult<Vec<_>>>()?;
        Ok(Self {
            log_likelihood: found.log_likelihood,
            alternatives: PyTuple::new(py, alternatives)?.unbind(),
            t_sensor_object: arrays::pose_matrix(py, &found.t_sensor_object)?,
            information: arrays::matrix(py, found.information)?,
            covariance: arrays::matrix(py, covariance)?,
            converged: found.converged,
            iterations: found.iterations,
            inliers: found.inliers,
            points: found.points,
            rmse_mm: found.rmse_mm,
            free: PyTuple::new(py, free.collect::<PyResult<Vec<_>>>()?)?.unbind(),
            digest,
        })
    }
}

#[pymethods]
impl Localization {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let end = if self.converged { "converged" } else { "not converged" };
        let free = self.free.bind(py).len();
        Ok(format!(
            "<Localization: {end} after {} iterations, {} of {} points within reach, rmse {:.4} mm, {free} free \
             directions>",
            self.iterations, self.inliers, self.points, self.rmse_mm
        ))
    }
}

/// Points that are registered in seconds. The call cannot be interrupted, and more than the template's own density
/// tells nothing new.
const MOST_POINTS: usize = 20_000;

/// Find where a part sits: register a contact patch to its template.
///
/// Parameters
/// ----------
/// points_mm : (N, 3) array_like
///     Points on the part's surface, sensor frame: `Frame.patch_points_mm`. At most 20000.
/// template : Template
/// t_sensor_object : (4, 4) array_like
///     A guess: maps object coordinates to sensor coordinates.
/// all_points_mm : (M, 3) array_like, optional
///     All markers' points, those of `points_mm` among them. The methods on the part's surface
///     (``register.method`` "surface_track", "surface_close", "surface_search") use that the part is nowhere between the
///     others and the camera; other methods do not look at them.
/// covariance_mm2 : (N, 3, 3) or (N, 9) array_like, optional
///     Covariance of each of `points_mm`, for the same methods; without it ``register.point_sigma_mm`` holds for all.
/// params : Params, optional
///     Its ``register`` part is used.
///
/// Returns
/// -------
/// Localization
///
/// Raises
/// ------
/// RegisterError
///     If the patch cannot be registered, for example with too few points.
#[pyfunction]
#[pyo3(signature = (points_mm, template, *, t_sensor_object, all_points_mm=None, covariance_mm2=None, params=None))]
pub fn localize(
    py: Python<'_>,
    points_mm: &Bound<'_, PyAny>,
    template: &Bound<'_, Template>,
    t_sensor_object: &Bound<'_, PyAny>,
    all_points_mm: Option<&Bound<'_, PyAny>>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    params: Option<&Bound<'_, Params>>,
) -> PyResult<Localization> {
    let points = Numbers::new(points_mm, "points_mm")?;
    let points = points.rows::<DVec3, 3>()?;
    if points.len() > MOST_POINTS {
        return Err(RegisterError::new_err(format!(
            "there are {} points; valid is up to {MOST_POINTS}: hand over the contact patch alone, thinned to about \
             the spacing of the template",
            points.len()
        )));
    }
    let guess = arrays::pose(t_sensor_object, "t_sensor_object")?;
    let template = &template.get().inner;
    let all = all_points_mm.map(|all| Numbers::new(all, "all_points_mm")).transpose()?;
    let all = all.as_ref().map_or(Ok(&[][..]), Numbers::rows::<DVec3, 3>)?;
    let covariances = covariance_mm2.map(|c| Numbers::new(c, "covariance_mm2")).transpose()?;
    let covariances = covariances.as_ref().map(Numbers::matrices).transpose()?;
    let mut stage = core::Registrar::new(&Params::or_default(params).register);
    let register = || {
        let unpressed_mm = core::unpressed(all, points);
        let contact = core::Contact {
            covariance_mm2: covariances,
            unpressed_mm: &unpressed_mm,
            ..core::Contact::new(points)
        };
        stage.register(&contact, template, &guess)
    };
    let found = py.detach(register).map_err(raise)?;
    Localization::new(py, found)
}
