//! Settings.

use crate::errors::{ParamsError, raise};
use crate::tree;
use gelstereo_core::params as core;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyTuple, PyType};
use std::path::PathBuf;

/// All settings of the pipeline and of registration; immutable.
///
/// ``Params()`` is the paper's configuration. `to_dict` returns every setting, `replace` creates a
/// variant. The defaults are declared once, in the Rust core; ``gelstereo-host`` reads the same TOML.
///
/// Examples
/// --------
/// >>> params = Params.preset("balanced").replace(contact={"saliency_mm": 0.2})
/// >>> params.to_dict()["contact"]["saliency_mm"]
/// 0.2
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

    /// The preset with this name.
    ///
    /// Parameters
    /// ----------
    /// name : str
    ///     One of `presets`: ``"paper"``, the paper's pipeline to the letter, or ``"balanced"``, its
    ///     cheaper and more accurate variant.
    ///
    /// Raises
    /// ------
    /// ParamsError
    ///     If there is no such preset.
    #[classmethod]
    fn preset(_cls: &Bound<'_, PyType>, name: &str) -> PyResult<Self> {
        let inner = core::Params::preset(name).ok_or_else(|| {
            let valid = core::Params::PRESETS.join("\", \"");
            ParamsError::new_err(format!("there is no preset \"{name}\"; valid is \"{valid}\""))
        })?;
        Ok(Self { inner })
    }

    /// Valid names for `preset`.
    #[classmethod]
    fn presets<'py>(cls: &Bound<'py, PyType>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(cls.py(), core::Params::PRESETS)
    }

    /// Settings from TOML text; omitted ones keep their defaults.
    ///
    /// Raises
    /// ------
    /// ParamsError
    ///     If a name is unknown or a value is not valid; the message names the line.
    #[classmethod]
    fn from_toml(_cls: &Bound<'_, PyType>, text: &str) -> PyResult<Self> {
        Self::checked(tree::from_toml(text).map_err(refused)?)
    }

    /// All settings as TOML text; `from_toml` restores an equal value.
    fn to_toml(&self) -> PyResult<String> {
        tree::to_toml(&self.inner).map_err(ParamsError::new_err)
    }

    /// Settings from a TOML file; see `from_toml`.
    #[classmethod]
    fn load<'py>(cls: &Bound<'py, PyType>, path: PathBuf) -> PyResult<Bound<'py, PyAny>> {
        tree::load(cls, path)
    }

    /// Write all settings to a TOML file.
    fn save(slf: &Bound<'_, Self>, path: PathBuf) -> PyResult<()> {
        tree::save(slf, path)
    }

    /// All settings as nested dictionaries.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        tree::to_dict(py, &self.inner)
    }

    /// A copy with some settings replaced.
    ///
    /// Parameters
    /// ----------
    /// changes : mapping, optional
    ///     Nested (``{"detect": {"threshold_levels": 20}}``) or with dotted names
    ///     (``{"detect.threshold_levels": 20}``). None resets a setting to its default.
    /// **settings
    ///     The same as keywords: ``detect={"threshold_levels": 20}``.
    ///
    /// Raises
    /// ------
    /// ParamsError
    ///     If a name is unknown (the valid ones are listed) or a value is not valid.
    #[pyo3(signature = (changes=None, /, **settings))]
    fn replace(
        &self,
        changes: Option<&Bound<'_, PyMapping>>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let mut inner = self.inner.clone();
        for mapping in [changes, settings.map(|s| s.as_mapping())].into_iter().flatten() {
            inner = tree::replace(&inner, mapping).map_err(refused)?;
        }
        Self::checked(inner)
    }

    fn __repr__(&self) -> PyResult<String> {
        Ok(format!("Params.from_toml(\"\"\"\n{}\"\"\")", self.to_toml()?))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<tree::Reduced<'py>> {
        tree::reduce(slf)
    }
}

/// The parser's message; for a former name, with the present name.
fn refused(message: String) -> PyErr {
    let unknown = ["unknown field `", "unknown variant `"].into_iter();
    let name = unknown.filter_map(|words| message.split_once(words)?.1.split('`').next()).next();
    ParamsError::new_err(match name.and_then(core::former) {
        Some((former, present)) => format!("{message}; {former} is now {present}"),
        None => message,
    })
}
