//! The simulated sensor.

use crate::arrays::{self, Array1, Matrix};
use crate::errors::{SceneError, raise};
use crate::register::{load_mesh, triangle_mesh};
use crate::rig::Rig;
use crate::tree;
use gelstereo_sim as sim;
use numpy::PyArray2;
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyType};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// What there is to see, and which effects act.
#[pyclass(frozen, module = "gelstereo")]
pub struct Scene {
    inner: sim::Scene,
    /// Where a mesh file's relative path starts.
    folder: PathBuf,
}

#[pymethods]
impl Scene {
    #[classmethod]
    fn from_toml(_cls: &Bound<'_, PyType>, text: &str) -> PyResult<Self> {
        Ok(Self { inner: tree::from_toml(text).map_err(SceneError::new_err)?, folder: PathBuf::new() })
    }

    fn to_toml(&self) -> PyResult<String> {
        tree::to_toml(&self.inner).map_err(SceneError::new_err)
    }

    #[classmethod]
    fn load(cls: &Bound<'_, PyType>, path: PathBuf) -> PyResult<Self> {
        let folder = path.parent().map(PathBuf::from).unwrap_or_default();
        let scene = Self::from_toml(cls, &tree::read(cls.py(), path)?)?;
        Ok(Self { folder, ..scene })
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
            inner = tree::replace(&inner, tree::table(mapping)?).map_err(SceneError::new_err)?;
        }
        Ok(Self { inner, folder: self.folder.clone() })
    }

    #[getter]
    fn rig(&self) -> Rig {
        Rig { inner: self.inner.rig.clone() }
    }
}

/// One moment of a scene: both images and the truth behind them.
#[pyclass(frozen, get_all, module = "gelstereo")]
pub struct SimulatedFrame {
    index: u64,
    left: Py<PyArray2<u8>>,
    right: Py<PyArray2<u8>>,
    left_px: Matrix,
    right_px: Matrix,
    points_mm: Matrix,
    indentation_mm: Array1<f64>,
    in_contact: Array1<bool>,
    t_sensor_object: Option<Matrix>,
}

/// A scene made ready to run.
#[pyclass(frozen, module = "gelstereo", sequence)]
pub struct Simulator {
    stage: Mutex<sim::Simulator>,
    scene: Py<Scene>,
}

#[pymethods]
impl Simulator {
    #[new]
    fn new(py: Python<'_>, scene: Py<Scene>) -> PyResult<Self> {
        let Scene { inner, folder } = scene.get();
        let mesh = match &inner.indenter {
            Some(sim::Shape::Mesh { path, units }) => {
                let path = folder.join(path).into_pyobject(py)?.into_any();
                let (vertices_mm, triangles) = load_mesh(&path, &units.into_pyobject(py)?.into_any())?;
                Some(triangle_mesh(&vertices_mm, &triangles)?)
            }
            _ => None,
        };
        let stage = py.detach(|| sim::Simulator::new(inner, mesh.as_ref())).map_err(raise)?;
        Ok(Self { stage: Mutex::new(stage), scene })
    }

    #[getter]
    fn scene(&self, py: Python<'_>) -> Py<Scene> {
        self.scene.clone_ref(py)
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        py.detach(|| self.stage.lock().unwrap_or_else(PoisonError::into_inner).frames())
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<SimulatedFrame> {
        let frames = self.__len__(py);
        let counted = if index < 0 { index + frames as isize } else { index };
        let frame = usize::try_from(counted).ok().filter(|&i| i < frames).ok_or_else(|| {
            PyIndexError::new_err(format!("there is no frame {index}; the scene has {frames}"))
        })?;
        let contact = py.detach(|| self.stage.lock().unwrap_or_else(PoisonError::into_inner).contact(frame));
        self.moment(py, contact.as_ref(), frame as u64)
    }

    #[pyo3(signature = (t_sensor_object=None, *, shear_mm=None, twist_rad=0.0, frame=0))]
    fn press(
        &self,
        py: Python<'_>,
        t_sensor_object: Option<&Bound<'_, PyAny>>,
        shear_mm: Option<(f64, f64)>,
        twist_rad: f64,
        frame: u64,
    ) -> PyResult<SimulatedFrame> {
        let pose = t_sensor_object.map(|pose| arrays::pose(pose, "t_sensor_object")).transpose()?;
        let contact = pose.map(|t_sensor_object| sim::ContactState {
            t_sensor_object,
            shear_mm: shear_mm.unwrap_or_default().into(),
            twist_rad,
        });
        self.moment(py, contact.as_ref(), frame)
    }
}

impl Simulator {
    fn moment(
        &self,
        py: Python<'_>,
        contact: Option<&sim::ContactState>,
        frame: u64,
    ) -> PyResult<SimulatedFrame> {
        let (mut truth, mut left, mut right) = (sim::Truth::default(), Vec::new(), Vec::new());
        py.detach(|| {
            let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
            stage.truth(contact, &mut truth);
            stage.render(&truth, frame, &mut left, &mut right);
        });
        let rig = &self.scene.get().inner.rig;
        Ok(SimulatedFrame {
            index: frame,
            left: arrays::shaped(py, left, (rig.left.height_px, rig.left.width_px))?,
            right: arrays::shaped(py, right, (rig.right.height_px, rig.right.width_px))?,
            left_px: arrays::rows::<_, 2>(py, truth.left_px)?,
            right_px: arrays::rows::<_, 2>(py, truth.right_px)?,
            points_mm: arrays::rows::<_, 3>(py, truth.points_mm)?,
            indentation_mm: arrays::list(py, truth.indentation_mm),
            in_contact: arrays::list(py, truth.in_contact),
            t_sensor_object: contact.map(|c| arrays::pose_matrix(py, &c.t_sensor_object)).transpose()?,
        })
    }
}
