//! The rest surface and contact detection.

use crate::arrays::{self, Array1, Count, Matrix, Numbers};
use crate::errors::raise;
use gelstereo_core::contact as core;
use gelstereo_core::lattice::Topology;
use gelstereo_core::math::DVec3;
use gelstereo_core::params::PrintLayout;
use gelstereo_core::pipeline::{Skin, SkinDepth};
use gelstereo_core::track::MarkerState;
use numpy::PyArray3;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The markers without contact, and the plane fitted through them.
///
/// Parameters
/// ----------
/// points_mm : (N, 3) array_like
///     Sensor frame.
///
/// Raises
/// ------
/// ContactError
///     If the points span no plane.
#[pyclass(frozen, module = "gelstereo")]
pub struct RestSurface {
    inner: core::RestSurface,
}

impl RestSurface {
    pub const fn from_core(inner: core::RestSurface) -> Self {
        Self { inner }
    }

    pub const fn core(&self) -> &core::RestSurface {
        &self.inner
    }
}

#[pymethods]
impl RestSurface {
    #[new]
    fn new(points_mm: &Bound<'_, PyAny>) -> PyResult<Self> {
        let points = Numbers::new(points_mm, "points_mm")?;
        Ok(Self { inner: core::RestSurface::new(points.rows::<DVec3, 3>()?).map_err(raise)? })
    }

    /// (N, 3) positions of the markers at rest, sensor frame.
    #[getter]
    fn points_mm(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::rows::<_, 3>(py, self.inner.points_mm().to_vec())
    }

    fn __repr__(&self) -> String {
        let (points, [x, y, z]) = (self.inner.points_mm().len(), self.inner.centre_mm().to_array());
        format!("<RestSurface: {points} markers about ({x:.2}, {y:.2}, {z:.2}) mm>")
    }

    /// (3,) unit normal of the rest plane, towards the camera.
    #[getter]
    fn normal(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.normal().to_array().to_vec())
    }

    /// (3,) centroid of the rest markers, sensor frame.
    #[getter]
    fn centre_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.centre_mm().to_array().to_vec())
    }

    /// Height of every marker above its rest height; positive towards the camera.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     The same markers now, sensor frame.
    ///
    /// Returns
    /// -------
    /// (N,) float64
    ///
    /// Raises
    /// ------
    /// ContactError
    ///     If the number of markers differs or a coordinate is not finite.
    fn indentation_mm(&self, py: Python<'_>, points_mm: &Bound<'_, PyAny>) -> PyResult<Array1<f64>> {
        let points = Numbers::new(points_mm, "points_mm")?;
        let mut out = Vec::new();
        self.inner.indentation_mm(points.rows::<DVec3, 3>()?, &mut out).map_err(raise)?;
        Ok(arrays::list(py, out))
    }

    fn __len__(&self) -> usize {
        self.inner.points_mm().len()
    }
}

/// Find the markers in contact from the gel's pressure (`contact.saliency = "pressure"`).
///
/// Parameters
/// ----------
/// rest : RestSurface
///     Of rows * cols markers, row by row.
/// indentation_mm : (rows * cols,) array_like
///     NaN for a marker that was not measured.
/// variance_mm2 : (rows * cols,) array_like
///     Variances of the indentations.
/// rows, cols : int
/// decay_mm : float
///     Length over which the surface comes back to rest beside a contact.
/// layout : {"square", "hexagonal"}
///     As ``lattice.layout``: which markers are neighbours.
///
/// Returns
/// -------
/// salient : (rows * cols,) bool
/// pressure_mm : (rows * cols,) float64
///     Pressure per stiffness by each marker's own differences; its noise is many times that of the
///     indentation. 0 where one of these was not measured.
///
/// Raises
/// ------
/// ContactError
///     If a list has not rows * cols entries, or a variance is negative or not finite.
/// ValueError
///     If the layout has another name.
#[pyfunction]
#[pyo3(signature = (rest, indentation_mm, variance_mm2, *, rows, cols, decay_mm, layout="square"))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn pressure_saliency(
    py: Python<'_>,
    rest: &RestSurface,
    indentation_mm: &Bound<'_, PyAny>,
    variance_mm2: &Bound<'_, PyAny>,
    rows: Count,
    cols: Count,
    decay_mm: f64,
    layout: &str,
) -> PyResult<(Array1<bool>, Array1<f64>)> {
    let heights = Numbers::new(indentation_mm, "indentation_mm")?;
    let variances = Numbers::new(variance_mm2, "variance_mm2")?;
    let heights = heights.list()?;
    let state = measured(heights);
    let topology = topology(layout, rows.0, cols.0, &rest.inner)?;
    let mut pressure = core::Pressure::on(&rest.inner, topology, decay_mm).map_err(raise)?;
    let mut salient = Vec::new();
    pressure.run(heights, variances.list()?.iter().copied(), &state, &mut salient).map_err(raise)?;
    Ok((arrays::list(py, salient), arrays::list(py, pressure.pressure_mm().to_vec())))
}

/// Find the markers in contact for a gel with unknown properties.
///
/// Several rules propose a contact: pressure for five decay lengths from 0.2 to 1 times the given one,
/// and thresholds at shares of the deepest indentation from 0.05 to 0.6. The gel is concave under a part
/// and convex beside it. The candidate is chosen whose border best separates the two.
///
/// Parameters
/// ----------
/// rest : RestSurface
///     Of rows * cols markers, row by row.
/// indentation_mm : (rows * cols,) array_like
///     NaN for a marker that was not measured.
/// variance_mm2 : (rows * cols,) array_like
///     Variances of the indentations.
/// rows, cols : int
/// max_decay_mm : float
///     Longest length tried over which the surface comes back to rest beside a contact.
/// layout : {"square", "hexagonal"}
///     As ``lattice.layout``: which markers are neighbours.
///
/// Returns
/// -------
/// salient : (rows * cols,) bool
/// rule : tuple of str and float, or None
///     ("pressure", decay_mm) or ("share", share of the deepest indentation); None when nothing touches
///     the gel.
///
/// Raises
/// ------
/// ContactError
///     If a list has not rows * cols entries, or a variance is negative or not finite.
/// ValueError
///     If the layout has another name.
#[pyfunction]
#[pyo3(signature = (rest, indentation_mm, variance_mm2, *, rows, cols, max_decay_mm, layout="square"))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn adaptive_saliency(
    py: Python<'_>,
    rest: &RestSurface,
    indentation_mm: &Bound<'_, PyAny>,
    variance_mm2: &Bound<'_, PyAny>,
    rows: Count,
    cols: Count,
    max_decay_mm: f64,
    layout: &str,
) -> PyResult<(Array1<bool>, Option<RuleName>)> {
    let heights = Numbers::new(indentation_mm, "indentation_mm")?;
    let variances = Numbers::new(variance_mm2, "variance_mm2")?;
    let heights = heights.list()?;
    let state = measured(heights);
    let topology = topology(layout, rows.0, cols.0, &rest.inner)?;
    let mut adaptive = core::AdaptiveSaliency::on(&rest.inner, topology, max_decay_mm).map_err(raise)?;
    let mut salient = Vec::new();
    let found =
        adaptive.run(heights, variances.list()?.iter().copied(), &state, &mut salient).map_err(raise)?;
    Ok((arrays::list(py, salient), found.map(rule_name)))
}

/// Find the gel's skin over a print that lies below it (`lattice.depth_mm`).
///
/// The layer between print and skin keeps its volume: the skin lies ``depth_mm`` / area ratio from a marker,
/// along the normal of the print's surface. docs/outside.md has its errors on gels solved by finite elements.
///
/// Parameters
/// ----------
/// rest : RestSurface
///     Of the markers, row by row.
/// points_mm : (N, 3) array_like
///     The same markers now, sensor frame.
/// covariance_mm2 : (N, 3, 3) array_like
/// cols : int
///     Markers in a row.
/// depth_mm : float
///     Depth of the print below the skin.
/// depth_sigma_mm : float
///     Its standard deviation.
/// layout : {"square", "hexagonal"}
///     As ``lattice.layout``: which markers are neighbours.
///
/// Returns
/// -------
/// points_mm : (N, 3) float64
/// covariance_mm2 : (N, 3, 3) float64
///     With the markers' noise, what the law of constant volume leaves open, and what an error of the depth
///     moves a point more than the gel at rest. That all points move by the error of the depth along the
///     normal at rest is left out.
///
/// Raises
/// ------
/// ContactError
///     If the number of markers differs or a coordinate is not finite.
/// ValueError
///     If another argument is not valid.
#[pyfunction]
#[pyo3(signature = (rest, points_mm, covariance_mm2, *, cols, depth_mm, depth_sigma_mm=0.0, layout="square"))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn skin_over(
    py: Python<'_>,
    rest: &RestSurface,
    points_mm: &Bound<'_, PyAny>,
    covariance_mm2: &Bound<'_, PyAny>,
    cols: Count,
    depth_mm: f64,
    depth_sigma_mm: f64,
    layout: &str,
) -> PyResult<(Matrix, Py<PyArray3<f64>>)> {
    let (points, covariances) =
        (Numbers::new(points_mm, "points_mm")?, Numbers::new(covariance_mm2, "covariance_mm2")?);
    let mut points = points.rows::<DVec3, 3>()?.to_vec();
    let mut covariances = covariances.matrices()?.to_vec();
    // It refuses a number of markers that differs, and what is not finite.
    rest.inner.indentation_mm(&points, &mut Vec::new()).map_err(raise)?;
    if covariances.len() != points.len() {
        let (found, expected) = (covariances.len(), points.len());
        return Err(PyValueError::new_err(format!(
            "covariance_mm2 has {found} matrices for {expected} points; valid is one of each"
        )));
    }
    let (depth, lengths) = (SkinDepth { mm: depth_mm, sigma_mm: depth_sigma_mm }, 0.0..=100.0);
    if !lengths.contains(&depth_mm) || !lengths.contains(&depth_sigma_mm) || cols.0 == 0 {
        return Err(PyValueError::new_err(format!(
            "depth_mm is {depth_mm}, depth_sigma_mm {depth_sigma_mm} and cols {}; valid are 0 to 100 mm, and \
             1 or more",
            cols.0
        )));
    }
    let topology = topology(layout, points.len() / cols.0, cols.0, &rest.inner)?;
    let mut skin = Skin::new(&rest.inner, topology, depth).map_err(raise)?;
    skin.lift(&mut points, &mut covariances);
    let (count, flat) = (covariances.len(), covariances.into_iter().flatten().flatten().collect());
    Ok((arrays::rows::<_, 3>(py, points)?, arrays::shaped(py, flat, [count, 3, 3])?))
}

/// Neighbours in a print of this layout.
fn topology(layout: &str, rows: usize, cols: usize, rest: &core::RestSurface) -> PyResult<Topology> {
    let square = Topology::square(rows, cols);
    match layout {
        "square" => Ok(square),
        // A number of rows that is wrong is refused by the core.
        "hexagonal" if rows.checked_mul(cols) != Some(rest.points_mm().len()) => Ok(square),
        "hexagonal" => Ok(Topology::of(PrintLayout::Hexagonal, cols, rest.points_mm())),
        _ => Err(PyValueError::new_err(format!(
            "the layout is \"{layout}\"; valid are \"square\" and \"hexagonal\""
        ))),
    }
}

/// Marker states from heights: NaN marks a marker that was not measured.
fn measured(heights_mm: &[f64]) -> Vec<MarkerState> {
    let state = |h: &f64| if h.is_nan() { MarkerState::Lost } else { MarkerState::Seen };
    heights_mm.iter().map(state).collect()
}

/// Name and setting of a rule.
pub type RuleName = (&'static str, f64);

/// Name and setting of a rule.
pub fn rule_name(rule: core::ContactRule) -> RuleName {
    match rule {
        core::ContactRule::Pressure { decay_mm } => ("pressure", decay_mm),
        core::ContactRule::Share { share } => ("share", share),
    }
}
