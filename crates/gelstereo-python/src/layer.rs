//! Contact with an elastic layer.

use crate::arrays::{self, Matrix, Numbers};
use crate::errors::{ShapeError, raise};
use crate::interrupt::stoppable;
use gelstereo_sim::layer::{Convergence, Grid, Layer, LayerContact as Contact, Part, Start};
use numpy::{PyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// A rigid part on a layer of gel: linear elasticity, bonded to a plate below, free at the sides.
///
/// Tractions are in units of Young's modulus: the surface under a part held in place does not depend on
/// the modulus.
///
/// Parameters
/// ----------
/// thickness_mm : float
/// poisson_ratio : float
///     0 to 0.5; exactly 0.5 is an incompressible gel.
/// rows, cols : int
///     Cells along y and x, at most 256 each.
/// cell_mm : float
///     Side of a cell, at most the layer's thickness.
/// friction : float
///     Coulomb's coefficient.
///
/// Raises
/// ------
/// LayerError
///     If a number is out of range.
#[pyclass(frozen, module = "gelstereo")]
pub struct LayerContact {
    inner: Mutex<Contact>,
}

/// A solved contact with R rows and C columns of cells.
#[pyclass(frozen, get_all, module = "gelstereo")]
pub struct LayerSolution {
    /// (R, C) pressures, in units of Young's modulus.
    pressure: Matrix,
    /// (R, C, 2) tractions along x and y, in units of Young's modulus.
    traction: Py<PyArray3<f64>>,
    /// (R, C, 3) displacement of the surface along x, along y and into the layer.
    motion_mm: Py<PyArray3<f64>>,
    /// Whether every cell is within the tolerance.
    converged: bool,
    /// Number of products with the compliance.
    products: usize,
    /// Remaining error.
    residual_mm: f64,
}

#[pymethods]
impl LayerSolution {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let (shape, end) = (self.pressure.bind(py).shape().to_vec(), self.converged);
        let end = if end { "converged" } else { "not converged" };
        let (products, residual_mm) = (self.products, self.residual_mm);
        Ok(format!(
            "<LayerSolution: {} x {} cells, {end} after {products} products, {residual_mm:.1e} mm left>",
            shape[0], shape[1]
        ))
    }
}

#[pymethods]
impl LayerContact {
    fn __repr__(&self) -> String {
        let contact = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let (Layer { thickness_mm, poisson_ratio }, grid) = (contact.layer(), contact.grid());
        let Grid { rows, cols, cell_mm: [cell_mm, _] } = grid;
        format!(
            "<LayerContact: {rows} x {cols} cells of {cell_mm} mm on a layer {thickness_mm} mm thick, \
             Poisson's ratio {poisson_ratio}>"
        )
    }

    #[new]
    #[pyo3(signature = (*, thickness_mm, poisson_ratio, rows, cols, cell_mm, friction=0.0))]
    fn new(
        thickness_mm: f64,
        poisson_ratio: f64,
        rows: usize,
        cols: usize,
        cell_mm: f64,
        friction: f64,
    ) -> PyResult<Self> {
        let (layer, grid) =
            (Layer { thickness_mm, poisson_ratio }, Grid { rows, cols, cell_mm: [cell_mm; 2] });
        let inner = Contact::new(layer, grid, friction).map_err(raise)?;
        Ok(Self { inner: Mutex::new(inner) })
    }

    /// Press a part into the layer.
    ///
    /// Parameters
    /// ----------
    /// heights_mm : (R, C) array_like
    ///     Indentation of the part below the undeformed surface, positive into the layer; -inf where there is
    ///     no part.
    /// carried_mm : (R, C, 2) array_like, optional
    ///     Displacement of every cell along x and y if it stuck to the part.
    /// tolerance_mm : float
    ///     Convergence tolerance: distance to the part of a cell in contact.
    /// warm : bool
    ///     Whether to start from the last solution.
    #[pyo3(signature = (heights_mm, carried_mm=None, *, tolerance_mm=1e-6, warm=false))]
    fn press(
        &self,
        py: Python<'_>,
        heights_mm: &Bound<'_, PyAny>,
        carried_mm: Option<&Bound<'_, PyAny>>,
        tolerance_mm: f64,
        warm: bool,
    ) -> PyResult<LayerSolution> {
        let heights = Numbers::new(heights_mm, "heights_mm")?;
        let heights_mm = heights.flat()?;
        let carried = carried_mm.map(|carried| components(carried, "carried_mm")).transpose()?;
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let carried_mm = carried.as_ref().map(|[x, y]| [&x[..], &y[..]]);
        let start = if warm { Start::Last } else { Start::Afresh };
        let contact = &mut *inner;
        let part = Part { heights_mm, carried_mm };
        let found = stoppable(py, |stop| contact.press_unless(part, tolerance_mm, start, stop))?;
        solution(py, &mut inner, found.map_err(raise)?)
    }

    /// Apply given loads to the surface.
    ///
    /// Parameters
    /// ----------
    /// pressure : (R, C) array_like
    ///     In units of Young's modulus.
    /// traction : (R, C, 2) array_like, optional
    ///     Along x and y.
    #[pyo3(signature = (pressure, traction=None))]
    fn load(
        &self,
        py: Python<'_>,
        pressure: &Bound<'_, PyAny>,
        traction: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<LayerSolution> {
        let pressure = Numbers::new(pressure, "pressure")?;
        let pressure = pressure.flat()?;
        let none = || vec![0.0; pressure.len()];
        let [x, y] = traction.map_or_else(|| Ok([none(), none()]), |given| components(given, "traction"))?;
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        inner.load(pressure, [&x, &y]).map_err(raise)?;
        solution(py, &mut inner, Convergence { converged: true, ..Convergence::default() })
    }
}

/// The two components of an (R, C, 2) array.
fn components(object: &Bound<'_, PyAny>, name: &'static str) -> PyResult<[Vec<f64>; 2]> {
    let numbers = Numbers::new(object, name)?;
    let (pairs, rest) = numbers.flat()?.as_chunks::<2>();
    if !rest.is_empty() {
        return Err(ShapeError::new_err(format!("{name} has an odd number of numbers; valid is (R, C, 2)")));
    }
    Ok([0, 1].map(|axis| pairs.iter().map(|pair| pair[axis]).collect()))
}

fn solution(py: Python<'_>, inner: &mut Contact, found: Convergence) -> PyResult<LayerSolution> {
    let Grid { rows, cols, .. } = inner.grid();
    let (mut into, mut aside) = (Vec::new(), [Vec::new(), Vec::new()]);
    inner.surface_mm(&mut into, &mut aside);
    let motion = into.iter().enumerate().flat_map(|(i, &w)| [aside[0][i], aside[1][i], w]).collect();
    let [x, y] = inner.traction();
    let traction = x.iter().zip(y).flat_map(|(&x, &y)| [x, y]).collect();
    Ok(LayerSolution {
        pressure: arrays::shaped(py, inner.pressure().to_vec(), (rows, cols))?,
        traction: arrays::shaped(py, traction, (rows, cols, 2))?,
        motion_mm: arrays::shaped(py, motion, (rows, cols, 3))?,
        converged: found.converged,
        products: found.products,
        residual_mm: found.residual_mm,
    })
}
