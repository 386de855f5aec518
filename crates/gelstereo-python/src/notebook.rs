//! What objects look like in a notebook; drawn in Python.

use pyo3::prelude::*;

/// HTML by a function of `gelstereo.view.notebook`.
pub fn html(object: &Bound<'_, PyAny>, function: &str) -> PyResult<String> {
    let module = object.py().import("gelstereo.view.notebook")?;
    module.call_method1(function, (object,))?.extract()
}

/// A PNG file by a function of `gelstereo.view.notebook`.
pub fn png<'py>(object: &Bound<'py, PyAny>, function: &str) -> PyResult<Bound<'py, PyAny>> {
    object.py().import("gelstereo.view.notebook")?.call_method1(function, (object,))
}
