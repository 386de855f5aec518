//! Python bindings: thin conversions, no logic.
use pyo3::prelude::*;

/// gelstereo._native
#[pymodule]
fn _native(_module: &Bound<'_, PyModule>) -> PyResult<()> {
    Ok(())
}
