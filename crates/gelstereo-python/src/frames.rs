//! Transforms from the sensor to the gripper and the robot's base.

use crate::arrays::{self, Array1, Matrix, Numbers};
use crate::errors::{FrameError, raise};
use crate::tree;
use gelstereo_core::frames as core;
use gelstereo_core::math::DVec3;
use pyo3::prelude::*;
use pyo3::types::PyType;

/// Motion of a finger's pad as a function of the opening width.
#[pyclass(frozen, module = "gelstereo", eq)]
#[derive(PartialEq)]
pub struct FingerKinematics {
    inner: core::FingerKinematics,
}

impl FingerKinematics {
    /// Rejects dimensions that are impossible for a gripper.
    fn checked(inner: core::FingerKinematics) -> PyResult<Self> {
        let (min_mm, max_mm) = inner.width_range_mm();
        let reach = inner.pad_mm(max_mm).is_ok_and(|pad_mm| pad_mm.is_finite());
        if reach && min_mm.is_finite() && max_mm > min_mm.max(0.0) && max_mm.is_finite() {
            inner.validate().map_err(raise)?;
            return Ok(Self { inner });
        }
        Err(FrameError::new_err(format!(
            "{inner:?} opens from {min_mm} to {max_mm} mm; valid is finite dimensions with which it opens \
             from one width to a larger one above 0"
        )))
    }
}

#[pymethods]
impl FingerKinematics {
    /// Sliding fingers: the pad moves along x, at x = width / 2 and z = `reach_mm`.
    #[classmethod]
    #[pyo3(signature = (*, reach_mm, max_width_mm))]
    fn parallel(_cls: &Bound<'_, PyType>, reach_mm: f64, max_width_mm: f64) -> PyResult<Self> {
        Self::checked(core::FingerKinematics::Parallel { reach_mm, max_width_mm })
    }

    /// Four-bar fingers: the pads stay parallel but advance along z while they close.
    ///
    /// With the crank at θ from 0 (open) to `max_theta_rad`:
    /// width = 2 (offset + a cos θ - b sin θ), z = reach + a sin θ + b cos θ.
    #[classmethod]
    #[pyo3(signature = (*, a_mm, b_mm, offset_mm, reach_mm, max_theta_rad))]
    fn parallelogram(
        _cls: &Bound<'_, PyType>,
        a_mm: f64,
        b_mm: f64,
        offset_mm: f64,
        reach_mm: f64,
        max_theta_rad: f64,
    ) -> PyResult<Self> {
        Self::checked(core::FingerKinematics::Parallelogram {
            a_mm,
            b_mm,
            offset_mm,
            reach_mm,
            max_theta_rad,
        })
    }

    /// The ideal parallelogram of a Robotiq 2F-85; a real gripper needs measured values.
    #[classmethod]
    fn robotiq_2f85(_cls: &Bound<'_, PyType>) -> Self {
        Self { inner: core::FingerKinematics::robotiq_2f85() }
    }

    /// The ideal parallelogram of a Robotiq 2F-140; a real gripper needs measured values.
    #[classmethod]
    fn robotiq_2f140(_cls: &Bound<'_, PyType>) -> Self {
        Self { inner: core::FingerKinematics::robotiq_2f140() }
    }

    /// The ideal parallelogram of an OnRobot RG2 without fingertips; a real gripper needs measured values.
    #[classmethod]
    fn on_robot_rg2(_cls: &Bound<'_, PyType>) -> Self {
        Self { inner: core::FingerKinematics::on_robot_rg2() }
    }

    /// The ideal parallelogram of an OnRobot RG6 without fingertips; a real gripper needs measured values.
    #[classmethod]
    fn on_robot_rg6(_cls: &Bound<'_, PyType>) -> Self {
        Self { inner: core::FingerKinematics::on_robot_rg6() }
    }

    /// Smallest and largest opening width.
    #[getter]
    fn width_range_mm(&self) -> (f64, f64) {
        self.inner.width_range_mm()
    }

    /// (3,) centre of the sensing pad in the gripper frame.
    ///
    /// Raises
    /// ------
    /// FrameError
    ///     If the gripper cannot have this width.
    fn pad_mm(&self, py: Python<'_>, width_mm: f64) -> PyResult<Array1<f64>> {
        Ok(arrays::list(py, self.inner.pad_mm(width_mm).map_err(raise)?.to_array().to_vec()))
    }

    fn __repr__(&self) -> String {
        format!("<{:?}>", self.inner)
    }
}

/// Pose of the sensor in the gripper.
///
/// Parameters
/// ----------
/// kinematics : FingerKinematics
/// t_pad_sensor : (4, 4) array_like
///     Maps sensor coordinates to the pad's, which is parallel to the gripper's frame.
///
/// Examples
/// --------
/// >>> mount = SensorMount.facing(FingerKinematics.robotiq_2f85(), gel_centre_mm=[4.0, 0.0, 28.7])
/// >>> print(mount.t_gripper_sensor(40.0).shape)
/// (4, 4)
#[pyclass(frozen, module = "gelstereo", eq)]
#[derive(PartialEq)]
pub struct SensorMount {
    inner: core::SensorMount,
}

impl SensorMount {
    fn checked(inner: core::SensorMount) -> PyResult<Self> {
        inner.validate().map_err(raise)?;
        Ok(Self { inner })
    }
}

#[pymethods]
impl SensorMount {
    #[new]
    fn new(kinematics: &Bound<'_, FingerKinematics>, t_pad_sensor: &Bound<'_, PyAny>) -> PyResult<Self> {
        let kinematics = kinematics.get().inner;
        let t_pad_sensor = arrays::pose(t_pad_sensor, "t_pad_sensor")?;
        Self::checked(core::SensorMount { kinematics, t_pad_sensor })
    }

    /// A sensor with its gel at the centre of the pad, facing the other finger across the gap.
    ///
    /// Parameters
    /// ----------
    /// kinematics : FingerKinematics
    /// gel_centre_mm : (3,) array_like
    ///     Middle of the undeformed gel surface, sensor frame.
    #[classmethod]
    fn facing(
        _cls: &Bound<'_, PyType>,
        kinematics: &Bound<'_, FingerKinematics>,
        gel_centre_mm: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let centre = DVec3::from_array(Numbers::new(gel_centre_mm, "gel_centre_mm")?.vector::<3>()?);
        if !centre.is_finite() {
            return Err(FrameError::new_err(format!(
                "gel_centre_mm is {centre}; valid is three finite lengths"
            )));
        }
        Self::checked(core::SensorMount::facing(kinematics.get().inner, centre))
    }

    /// A mount from TOML text.
    #[classmethod]
    fn from_toml(_cls: &Bound<'_, PyType>, text: &str) -> PyResult<Self> {
        let inner: core::SensorMount = tree::from_toml(text).map_err(FrameError::new_err)?;
        FingerKinematics::checked(inner.kinematics)?;
        Self::checked(inner)
    }

    /// The mount as TOML text.
    fn to_toml(&self) -> PyResult<String> {
        tree::to_toml(&self.inner).map_err(FrameError::new_err)
    }

    /// Kinematics of the pad that carries the sensor.
    #[getter]
    const fn kinematics(&self) -> FingerKinematics {
        FingerKinematics { inner: self.inner.kinematics }
    }

    /// (4, 4) maps sensor coordinates to the pad's.
    #[getter]
    fn t_pad_sensor(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::pose_matrix(py, &self.inner.t_pad_sensor)
    }

    /// (4, 4) gTgs of Eq. 8: maps sensor coordinates to gripper coordinates at this opening width.
    ///
    /// Raises
    /// ------
    /// FrameError
    ///     If the gripper cannot have this width.
    fn t_gripper_sensor(&self, py: Python<'_>, width_mm: f64) -> PyResult<Matrix> {
        arrays::pose_matrix(py, &self.inner.t_gripper_sensor(width_mm).map_err(raise)?)
    }

    fn __repr__(&self) -> PyResult<String> {
        Ok(format!("SensorMount.from_toml(\"\"\"\n{}\"\"\")", self.to_toml()?))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<tree::Reduced<'py>> {
        tree::reduce(slf)
    }
}

/// Gripper pose that brings the held object to its goal; the object is rigid in the hand.
///
/// Parameters
/// ----------
/// t_base_goal : (4, 4) array_like
///     Goal pose of the object.
/// t_gripper_object : (4, 4) array_like
///     Pose of the object in the hand.
///
/// Returns
/// -------
/// (4, 4) float64
///     The gripper's pose in the base's frame.
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
