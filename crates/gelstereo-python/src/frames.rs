//! From the sensor to the gripper and the robot's base.

use crate::arrays::{self, Array1, Matrix, Numbers};
use crate::errors::{FrameError, raise};
use crate::tree;
use gelstereo_core::frames as core;
use gelstereo_core::math::DVec3;
use pyo3::prelude::*;
use pyo3::types::PyType;

/// How a finger's pad moves with the opening width.
#[pyclass(frozen, module = "gelstereo", eq)]
#[derive(PartialEq)]
pub struct FingerKinematics {
    inner: core::FingerKinematics,
}

#[pymethods]
impl FingerKinematics {
    #[classmethod]
    #[pyo3(signature = (*, reach_mm, max_width_mm))]
    fn parallel(_cls: &Bound<'_, PyType>, reach_mm: f64, max_width_mm: f64) -> Self {
        Self { inner: core::FingerKinematics::Parallel { reach_mm, max_width_mm } }
    }

    #[classmethod]
    #[pyo3(signature = (*, a_mm, b_mm, offset_mm, reach_mm, max_theta_rad))]
    fn parallelogram(
        _cls: &Bound<'_, PyType>,
        a_mm: f64,
        b_mm: f64,
        offset_mm: f64,
        reach_mm: f64,
        max_theta_rad: f64,
    ) -> Self {
        Self {
            inner: core::FingerKinematics::Parallelogram { a_mm, b_mm, offset_mm, reach_mm, max_theta_rad },
        }
    }

    #[classmethod]
    fn robotiq_2f85(_cls: &Bound<'_, PyType>) -> Self {
        Self { inner: core::FingerKinematics::robotiq_2f85() }
    }

    #[getter]
    fn width_range_mm(&self) -> (f64, f64) {
        self.inner.width_range_mm()
    }

    fn pad_mm(&self, py: Python<'_>, width_mm: f64) -> PyResult<Array1<f64>> {
        Ok(arrays::list(py, self.inner.pad_mm(width_mm).map_err(raise)?.to_array().to_vec()))
    }

    fn __repr__(&self) -> String {
        format!("<{:?}>", self.inner)
    }
}

/// Where the sensor stands in the gripper.
#[pyclass(frozen, module = "gelstereo", eq)]
#[derive(PartialEq)]
pub struct SensorMount {
    inner: core::SensorMount,
}

#[pymethods]
impl SensorMount {
    #[new]
    fn new(kinematics: &Bound<'_, FingerKinematics>, t_pad_sensor: &Bound<'_, PyAny>) -> PyResult<Self> {
        let kinematics = kinematics.get().inner;
        Ok(Self {
            inner: core::SensorMount {
                kinematics,
                t_pad_sensor: arrays::pose(t_pad_sensor, "t_pad_sensor")?,
            },
        })
    }

    #[classmethod]
    fn facing(
        _cls: &Bound<'_, PyType>,
        kinematics: &Bound<'_, FingerKinematics>,
        gel_centre_mm: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let centre = DVec3::from_array(Numbers::new(gel_centre_mm, "gel_centre_mm")?.vector::<3>()?);
        Ok(Self { inner: core::SensorMount::facing(kinematics.get().inner, centre) })
    }

    #[classmethod]
    fn from_toml(_cls: &Bound<'_, PyType>, text: &str) -> PyResult<Self> {
        Ok(Self { inner: tree::from_toml(text).map_err(FrameError::new_err)? })
    }

    fn to_toml(&self) -> PyResult<String> {
        tree::to_toml(&self.inner).map_err(FrameError::new_err)
    }

    #[getter]
    const fn kinematics(&self) -> FingerKinematics {
        FingerKinematics { inner: self.inner.kinematics }
    }

    #[getter]
    fn t_pad_sensor(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::pose_matrix(py, &self.inner.t_pad_sensor)
    }

    fn t_gripper_sensor(&self, py: Python<'_>, width_mm: f64) -> PyResult<Matrix> {
        arrays::pose_matrix(py, &self.inner.t_gripper_sensor(width_mm).map_err(raise)?)
    }
}

#[pyfunction]
pub fn adjusted_gripper(
    py: Python<'_>,
    t_base_goal: &Bound<'_, PyAny>,
    t_gripper_object: &Bound<'_, PyAny>,
) -> PyResult<Matrix> {
    let goal = arrays::pose(t_base_goal, "t_base_goal")?;
    let held = arrays::pose(t_gripper_object, "t_gripper_object")?;
    arrays::pose_matrix(py, &core::adjusted_gripper(&goal, &held))
}
