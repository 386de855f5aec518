//! Scenes of the simulated sensor.

use crate::errors::{SceneError, raise};
use crate::rig::Rig;
use crate::tree;
use gelstereo_sim as sim;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyTuple, PyType};
use std::path::PathBuf;

/// The objects and effects of a simulation; immutable.
///
/// ``Scene()`` is the default sensor without contact; `to_dict` shows all settings.
#[pyclass(frozen, module = "gelstereo")]
pub struct Scene {
    pub(super) inner: sim::Scene,
    /// Where a mesh file's relative path starts.
    pub(super) folder: PathBuf,
}

impl Scene {
    fn checked(inner: sim::Scene, folder: PathBuf) -> PyResult<Self> {
        inner.validate().map_err(raise)?;
        Ok(Self { inner, folder })
    }
}

#[pymethods]
impl Scene {
    #[new]
    fn new() -> Self {
        Self { inner: sim::Scene::default(), folder: PathBuf::new() }
    }

    /// A sensor preset without effects and without contact, named by image size and markers along each side.
    /// All have about 22 mm of gel in view at 28.7 mm. "640x480-25" is the default scene;
    /// "640x480-25-refraction" looks through air, acrylic and gel at a lattice of 15.6 mm.
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     If there is no preset with that name; the valid ones are listed.
    #[classmethod]
    fn preset(_cls: &Bound<'_, PyType>, name: &str) -> PyResult<Self> {
        let inner = sim::Scene::preset(name).ok_or_else(|| {
            let valid = sim::Scene::PRESETS.join("\", \"");
            SceneError::new_err(format!("there is no preset \"{name}\"; valid is \"{valid}\""))
        })?;
        Ok(Self { inner, folder: PathBuf::new() })
    }

    /// Valid names for `preset`.
    #[classmethod]
    fn presets<'py>(cls: &Bound<'py, PyType>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(cls.py(), sim::Scene::PRESETS)
    }

    /// A scene from TOML text; omitted settings keep their defaults.
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     If a name is unknown or a value is not valid; the message names the line.
    #[classmethod]
    fn from_toml(cls: &Bound<'_, PyType>, text: &str) -> PyResult<Self> {
        Self::_from_file(cls, text, PathBuf::new())
    }

    /// The scene as TOML text.
    fn to_toml(&self) -> PyResult<String> {
        tree::to_toml(&self.inner).map_err(SceneError::new_err)
    }

    /// A scene from a TOML file; mesh paths in it are relative to the file.
    #[classmethod]
    fn load(cls: &Bound<'_, PyType>, path: PathBuf) -> PyResult<Self> {
        let folder = path.parent().map(PathBuf::from).unwrap_or_default();
        let text = tree::read(cls.py(), path.clone())?;
        Self::_from_file(cls, &text, folder).map_err(|error| tree::in_file(cls.py(), &error, &path))
    }

    /// Write the scene to a TOML file.
    fn save(slf: &Bound<'_, Self>, path: PathBuf) -> PyResult<()> {
        tree::save(slf, path)
    }

    /// The scene as nested dictionaries.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        tree::to_dict(py, &self.inner)
    }

    /// A copy with some settings replaced, as `Params.replace` does.
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     If a name is unknown (the valid ones are listed) or a value is not valid.
    #[pyo3(signature = (changes=None, /, **settings))]
    pub(super) fn replace(
        &self,
        changes: Option<&Bound<'_, PyMapping>>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let mut inner = self.inner.clone();
        for mapping in [changes, settings.map(|s| s.as_mapping())].into_iter().flatten() {
            inner = tree::replace(&inner, mapping).map_err(SceneError::new_err)?;
        }
        Self::checked(inner, self.folder.clone())
    }

    /// The simulated rig.
    #[getter]
    fn rig(&self) -> Rig {
        Rig { inner: self.inner.rig.clone() }
    }

    fn __repr__(&self) -> PyResult<String> {
        Ok(format!("Scene.from_toml(\"\"\"\n{}\"\"\")", self.to_toml()?))
    }

    /// From the text and the folder of a file; mesh paths are relative to the folder.
    #[classmethod]
    fn _from_file(_cls: &Bound<'_, PyType>, text: &str, folder: PathBuf) -> PyResult<Self> {
        Self::checked(tree::from_toml(text).map_err(SceneError::new_err)?, folder)
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (String, PathBuf))> {
        let restore = slf.as_any().get_type().getattr("_from_file")?;
        Ok((restore, (slf.get().to_toml()?, slf.get().folder.clone())))
    }
}
