//! Pickling of results, as used by `multiprocessing` and joblib to pass them between processes.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Arguments for unpickling: a class method and the bytes that it reads.
pub type Reduced<'py> = (Bound<'py, PyAny>, (Bound<'py, PyBytes>,));

/// Unpickling calls `cls.method(data)`.
pub fn reduce<'py, T>(value: &Bound<'py, T>, method: &str, data: &[u8]) -> PyResult<Reduced<'py>> {
    let restore = value.as_any().get_type().getattr(method)?;
    Ok((restore, (PyBytes::new(value.py(), data),)))
}

/// MessagePack with named fields: numbers are exact, and errors name a missing field.
pub fn to_bytes(value: &impl Serialize) -> PyResult<Vec<u8>> {
    rmp_serde::to_vec_named(value).map_err(|error| PyValueError::new_err(error.to_string()))
}

/// Restores the output of [`to_bytes`].
pub fn from_bytes<T: DeserializeOwned>(data: &[u8], what: &str) -> PyResult<T> {
    rmp_serde::from_slice(data).map_err(|error| {
        let version = env!("CARGO_PKG_VERSION");
        PyValueError::new_err(format!(
            "no pickled {what} of gelstereo {version}: {error}; pickle and unpickle with the same version"
        ))
    })
}
