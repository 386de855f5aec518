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
    /// Median distance of neighbouring markers in a row at rest, mm.
    #[getter]
    const fn measured_mm(&self) -> f64 {
        self.inner.measured_mm
    }

    /// Standard deviation of `measured_mm` from the scatter of the distances, mm.
    #[getter]
    const fn sigma_mm(&self) -> f64 {
        self.inner.sigma_mm
    }

    /// ``lattice.pitch_mm``.
    #[getter]
    const fn expected_mm(&self) -> f64 {
        self.inner.expected_mm
    }

    /// Whether both differ by more than five standard deviations and one per cent, which a print may be off.
    #[getter]
    fn is_off(&self) -> bool {
        self.inner.is_off()
    }

    fn __str__(&self) -> String {
        self.inner.to_string()
    }

    fn __repr__(&self) -> String {
        let core::PitchCheck { measured_mm, sigma_mm, expected_mm } = self.inner;
        let state = if self.inner.is_off() { "off" } else { "as expected" };
        format!("<PitchCheck: {measured_mm:.4} ± {sigma_mm:.4} mm, expected {expected_mm} mm: {state}>")
    }
}
