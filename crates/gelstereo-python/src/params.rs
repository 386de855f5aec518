//! Settings.

use crate::errors::{ParamsError, raise};
use crate::tree;
use gelstereo_core::params as core;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyTuple, PyType};
use std::path::PathBuf;

/// All settings of the pipeline and of registration.
#[pyclass(frozen, module = "gelstereo", eq, from_py_object)]
#[derive(Clone, PartialEq)]
pub struct Params {
    pub inner: core::Params,
}

impl Params {
    fn checked(inner: core::Params) -> PyResult<Self> {
        inner.validate().map_err(raise)?;
        Ok(Self { inner })
    }

    /// The given settings, or the default ones.
    pub fn or_default(params: Option<&Bound<'_, Self>>) -> core::Params {
        params.map_or_else(core::Params::default, |p| p.get().inner.clone())
    }
}

#[pymethods]
impl Params {
    #[new]
    fn new() -> Self {
        Self { inner: core::Params::default() }
    }

    #[classmethod]
    fn preset(_cls: &Bound<'_, PyType>, name: &str) -> PyResult<Self> {
        let inner = core::Params::preset(name).ok_or_else(|| {
            let valid = core::Params::PRESETS.join("\", \"");
            ParamsError::new_err(format!("there is no preset \"{name}\"; valid is \"{valid}\""))
        })?;
        Ok(Self { inner })
    }

    #[classmethod]
    fn presets<'py>(cls: &Bound<'py, PyType>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(cls.py(), core::Params::PRESETS)
    }

    #[classmethod]
    fn from_toml(_cls: &Bound<'_, PyType>, text: &str) -> PyResult<Self> {
        Self::checked(tree::from_toml(text).map_err(ParamsError::new_err)?)
    }

    fn to_toml(&self) -> PyResult<String> {
        tree::to_toml(&self.inner).map_err(ParamsError::new_err)
    }

    #[classmethod]
    fn load(cls: &Bound<'_, PyType>, path: PathBuf) -> PyResult<Self> {
        Self::from_toml(cls, &tree::read(cls.py(), path)?)
    }

    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        tree::write(py, path, &self.to_toml()?)
    }

    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        tree::to_dict(py, &self.inner)
    }

    #[pyo3(signature = (changes=None, /, **settings))]
    fn replace(
        &self,
        changes: Option<&Bound<'_, PyMapping>>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let mut inner = self.inner.clone();
        for mapping in [changes, settings.map(|s| s.as_mapping())].into_iter().flatten() {
            inner = tree::replace(&inner, tree::table(mapping)?).map_err(ParamsError::new_err)?;
        }
        Self::checked(inner)
    }

    fn __repr__(&self) -> PyResult<String> {
        Ok(format!("Params.from_toml(\"\"\"\n{}\"\"\")", self.to_toml()?))
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        Ok((py.get_type::<Self>().getattr("from_toml")?, (self.to_toml()?,)))
    }
}
