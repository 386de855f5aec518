//! What objects look like in a notebook; drawn in Python.

use pyo3::prelude::*;

/// HTML by a function of `gelstereo.view.notebook`.
pub fn html(object: &Bound<'_, PyAny>, function: &str) -> PyResult<String> {
    let module = object.py().import("gelstereo.view.notebook")?;
    module.call_method1(function, (object,))?.extract()
}
