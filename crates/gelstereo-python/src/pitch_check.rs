//! Check of the pitch of the print at rest.

use gelstereo_core::pipeline as core;
use pyo3::prelude::*;

/// The print's pitch, triangulated at rest, beside ``lattice.pitch_mm``. ``str()`` explains a difference.
#[pyclass(frozen, module = "gelstereo")]
pub struct PitchCheck {
    pub inner: core::PitchCheck,
}

#[pymethods]
impl PitchCheck {
    /// Median distances of neighbouring markers at rest, mm: along rows, and along columns.
    #[getter]
    fn measured_mm(&self) -> (f64, f64) {
        self.inner.measured_mm.into()
    }

    /// Standard deviations of `measured_mm` from the scatter of the distances, mm.
    #[getter]
    fn sigma_mm(&self) -> (f64, f64) {
        self.inner.sigma_mm.into()
    }

    /// ``lattice.pitch_mm`` along rows and along columns.
    #[getter]
    fn expected_mm(&self) -> (f64, f64) {
        self.inner.expected.axes_mm().into()
    }

    /// Whether one of them differs by more than five standard deviations and one per cent, which a print may
    /// be off.
    #[getter]
    fn is_off(&self) -> bool {
        self.inner.is_off()
    }

    fn __str__(&self) -> String {
        self.inner.to_string()
    }

    fn __repr__(&self) -> String {
        let core::PitchCheck { measured_mm: [x, y], sigma_mm: [x_sigma, y_sigma], expected } = self.inner;
        let state = if self.inner.is_off() { "off" } else { "as expected" };
        format!(
            "<PitchCheck: {x:.4} ± {x_sigma:.4} mm along rows, {y:.4} ± {y_sigma:.4} mm along columns, \
             expected {expected} mm: {state}>"
        )
    }
}
