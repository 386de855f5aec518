//! The simulated sensor.

mod frame;
mod plan;
mod scene;

pub use frame::{SimulatedDots, SimulatedFrame, SimulatedLoads};
pub use plan::{Plan, PlannedEffect};
pub use scene::Scene;

use crate::arrays::{self, Count, Matrix};
use crate::errors::{SceneError, raise};
use crate::template::{load_mesh, triangle_mesh};
use crate::tree;
use gelstereo_core::math::DVec3;
use gelstereo_core::rig::Rig;
use gelstereo_core::surface::TriangleMesh;
use gelstereo_sim as sim;
use numpy::PyArray2;
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyRange};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

const NO_INDENTER: &str =
    "the scene has no indenter; give it one, for example indenter = { kind = \"sphere\", radius_mm = 4 }";

/// Names and values of the simulator's sights, repeated in `gelstereo.Sight` for typing.
#[pyfunction]
pub fn sights() -> std::collections::BTreeMap<&'static str, u8> {
    sim::Sight::ALL.map(|(name, sight)| (name, sight as u8)).into()
}

/// A scene ready to run: a sequence of the `SimulatedFrame` s that arrive, each simulated on access.
///
/// Parameters
/// ----------
/// scene : Scene
///
/// Raises
/// ------
/// SceneError, MeshError
///     If the scene is not valid or its mesh cannot be read.
#[pyclass(frozen, module = "gelstereo", sequence)]
pub struct Simulator {
    stage: Mutex<sim::Simulator>,
    scene: Py<Scene>,
    /// The parts that are mesh files, each in its place among all parts.
    meshes: Vec<Option<Arc<TriangleMesh>>>,
}

#[pymethods]
impl Simulator {
    #[new]
    fn new(py: Python<'_>, scene: Py<Scene>) -> PyResult<Self> {
        let meshes = meshes_of(py, scene.get(), None)?;
        let files = meshes.iter().filter_map(|mesh| mesh.as_deref());
        let stage = py.detach(|| sim::Simulator::new(&scene.get().inner, files)).map_err(raise)?;
        Ok(Self { stage: Mutex::new(stage), scene, meshes })
    }

    /// A simulator of the scene with some settings replaced, as `Scene.replace` does.
    ///
    /// It simulates the same bits as ``Simulator(simulator.scene.replace(...))``, but is built faster: it
    /// shares with this one all that the changes do not affect, such as the tables of an elastic layer, the
    /// grain, and a mesh file that was read. Neither simulator affects the other.
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     If a name is unknown (the valid ones are listed) or a value is not valid.
    #[pyo3(signature = (changes=None, /, **settings))]
    fn replace(
        &self,
        py: Python<'_>,
        changes: Option<&Bound<'_, PyMapping>>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let scene = self.scene.get().replace(changes, settings)?;
        let meshes = meshes_of(py, &scene, Some(self))?;
        let files = meshes.iter().filter_map(|mesh| mesh.as_deref());
        let stage = py.detach(|| self.lock().replaced(&scene.inner, files)).map_err(raise)?;
        Ok(Self { stage: Mutex::new(stage), scene: Py::new(py, scene)?, meshes })
    }

    /// A simulator of a random variation of the scene: domain randomization.
    ///
    /// Parameters
    /// ----------
    /// distribution : Distribution or mapping or path
    ///     What varies, and how: `gelstereo.randomization.Distribution`, its plain data, or a TOML file.
    /// seed : int
    ///     0 to 2^63 - 1. The same seed gives the same scene on every machine.
    ///
    /// Returns
    /// -------
    /// Simulator
    ///     It shares with this one all that does not vary, as in `replace`; `scene` shows what was drawn.
    ///
    /// Raises
    /// ------
    /// DistributionError
    ///     If the distribution is not valid, or draws a scene that is not.
    fn randomize<'py>(
        slf: &Bound<'py, Self>,
        distribution: &Bound<'py, PyAny>,
        seed: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let module = slf.py().import("gelstereo.randomization")?;
        module.call_method1("randomized", (slf, distribution, seed))
    }

    /// The scene of the simulator.
    #[getter]
    fn scene(&self, py: Python<'_>) -> Py<Scene> {
        self.scene.clone_ref(py)
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("<Simulator of {} frames>", self.__len__(py))
    }

    /// Pickles the scene: the copy simulates the same frames.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyAny>, (Py<Scene>,)) {
        (slf.as_any().get_type().into_any(), (slf.get().scene.clone_ref(slf.py()),))
    }

    /// Which effects are computed, with reasons.
    #[getter]
    fn plan(&self, py: Python<'_>) -> PyResult<Plan> {
        let plan = py.detach(|| self.lock().plan().clone());
        Plan::new(py, plan, self.scene.get().folder.clone())
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        py.detach(|| self.lock().delivered())
    }

    fn __getitem__(slf: &Bound<'_, Self>, index: isize) -> PyResult<SimulatedFrame> {
        let (py, this) = (slf.py(), slf.get());
        let frames = this.__len__(py);
        let counted = if index < 0 { index + frames as isize } else { index };
        let arrived = usize::try_from(counted).ok();
        let frame = arrived.and_then(|arrived| py.detach(|| this.lock().frame_of(arrived)));
        let frame = frame.ok_or_else(|| {
            PyIndexError::new_err(format!("there is no frame {index}; the scene has {frames}"))
        })?;
        let contacts = py.detach(|| this.lock().planned(frame));
        Self::moment(slf, &contacts, frame as u64)
    }

    /// Iterates over the frames that arrive. Type checkers do not accept `__getitem__` alone.
    fn __iter__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let py = slf.py();
        let indices = PyRange::new(py, 0, slf.get().__len__(py) as isize)?;
        py.import("builtins")?.call_method1("map", (slf.getattr("__getitem__")?, indices))
    }

    /// (4, 4) the pose moved along the sensor's z axis until a part reaches `press_mm` into the gel.
    ///
    /// Parameters
    /// ----------
    /// t_sensor_object : (4, 4) array_like
    /// press_mm : float
    /// part : int
    ///     0 is the indenter, n the n-th of the scene's ``others``.
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     If the scene has no such part, or the part would be far beyond the sensor.
    #[pyo3(
        signature = (t_sensor_object, press_mm, part=Count(0)),
        text_signature = "($self, t_sensor_object, press_mm, part=0)"
    )]
    fn pressed(
        &self,
        py: Python<'_>,
        t_sensor_object: &Bound<'_, PyAny>,
        press_mm: f64,
        part: Count,
    ) -> PyResult<Matrix> {
        let pose = arrays::pose(t_sensor_object, "t_sensor_object")?;
        let pose = py.detach(|| self.lock().pressed_of(part.0, pose, press_mm));
        let pose = pose.ok_or_else(|| self.no_part(py, part.0))?;
        let contact = sim::ContactState { t_sensor_object: pose, shear_mm: [0.0; 2], twist_rad: 0.0 };
        contact.validate().map_err(raise)?;
        arrays::pose_matrix(py, &pose)
    }

    /// Simulate a moment that is not on the trajectory.
    ///
    /// Parameters
    /// ----------
    /// t_sensor_object : (4, 4) array_like, optional
    ///     The indenter's pose. Default: no contact.
    /// shear_mm : (float, float), optional
    ///     Displacement of the surface by the contact, sensor x and y.
    /// twist_rad : float
    ///     Rotation of the surface by the contact.
    /// others : sequence of (4, 4) array_like or None, optional
    ///     Pose of each of the scene's ``others``; None of one that does not touch. Default: their
    ///     trajectories at the frame.
    /// frame : int
    ///     Frame index, which seeds the noise and determines the time of the gel's motion and smears.
    #[pyo3(
        signature = (t_sensor_object=None, *, shear_mm=None, twist_rad=0.0, others=None, frame=Count(0)),
        text_signature =
            "($self, t_sensor_object=None, *, shear_mm=None, twist_rad=0.0, others=None, frame=0)"
    )]
    fn press(
        slf: &Bound<'_, Self>,
        t_sensor_object: Option<&Bound<'_, PyAny>>,
        shear_mm: Option<(f64, f64)>,
        twist_rad: f64,
        others: Option<Vec<Option<Bound<'_, PyAny>>>>,
        frame: Count,
    ) -> PyResult<SimulatedFrame> {
        let pose = t_sensor_object.map(|pose| arrays::pose(pose, "t_sensor_object")).transpose()?;
        let contact = pose.map(|t_sensor_object| sim::ContactState {
            t_sensor_object,
            shear_mm: shear_mm.unwrap_or_default().into(),
            twist_rad,
        });
        let contacts = slf.get().posed(slf.py(), contact, others, frame.0)?;
        Self::moment(slf, &contacts, frame.0 as u64)
    }

    /// Move the part on from its last pose: the gel is dragged along, sticks and slips.
    ///
    /// The result depends on all calls since the part was last taken away. A part moves along the shortest
    /// path, in steps of at most 0.05 mm (or 256 steps). The first pose is pressed in without sideways
    /// motion. Images are not blurred by motion.
    ///
    /// Parameters
    /// ----------
    /// t_sensor_object : (4, 4) array_like, optional
    ///     New pose of the indenter. None takes it away.
    /// others : sequence of (4, 4) array_like or None, optional
    ///     New pose of each of the scene's ``others``; None takes one away. Default: their trajectories at
    ///     the frame.
    /// frame : int
    ///     Frame index, which seeds the noise and determines the time of smears and gel motion.
    ///
    /// Returns
    /// -------
    /// SimulatedFrame
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     If the scene has no ``effects.elastic_layer``, has ``relaxation``, or has no indenter.
    #[pyo3(
        signature = (t_sensor_object=None, *, others=None, frame=Count(0)),
        text_signature = "($self, t_sensor_object=None, *, others=None, frame=0)"
    )]
    fn advance(
        slf: &Bound<'_, Self>,
        t_sensor_object: Option<&Bound<'_, PyAny>>,
        others: Option<Vec<Option<Bound<'_, PyAny>>>>,
        frame: Count,
    ) -> PyResult<SimulatedFrame> {
        let pose = t_sensor_object.map(|pose| arrays::pose(pose, "t_sensor_object")).transpose()?;
        let this = slf.get();
        let contacts = this.posed(slf.py(), pose.map(sim::ContactState::pressed), others, frame.0)?;
        let truth = slf.py().detach(|| {
            let poses: Vec<_> = contacts.iter().map(|c| c.map(|c| c.t_sensor_object)).collect();
            let mut truth = sim::Truth::default();
            this.lock().advance_of(&poses, frame.0 as u64, &mut truth)?;
            Ok::<_, sim::SceneError>(truth)
        });
        SimulatedFrame::new(slf, frame.0 as u64, truth.map_err(raise)?)
    }

    /// Move a pose along z until the indenter alone presses with a force.
    ///
    /// Parameters
    /// ----------
    /// t_sensor_object : (4, 4) array_like
    /// force_n : float
    ///     Pressing force.
    ///
    /// Returns
    /// -------
    /// (4, 4) float64
    ///     For `press` and `advance`.
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     If the scene has no ``effects.elastic_layer`` or no indenter, or the force would need more than
    ///     0.8 of the gel's thickness.
    fn pressed_with(
        slf: &Bound<'_, Self>,
        t_sensor_object: &Bound<'_, PyAny>,
        force_n: f64,
    ) -> PyResult<Matrix> {
        let pose = arrays::pose(t_sensor_object, "t_sensor_object")?;
        let this = slf.get();
        let found = slf.py().detach(|| this.lock().pressed_with(pose, force_n)).map_err(raise)?;
        let found = found.ok_or_else(|| {
            SceneError::new_err("a pressing force needs an indenter and effects.elastic_layer; add them")
        })?;
        arrays::pose_matrix(slf.py(), &found)
    }

    /// Render markers at given positions, for example from another sensor's recording.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     Sensor frame, marker ``row * cols + col`` of the scene's gel at that index.
    /// frame : int
    ///     Frame index, which seeds the noise and determines the time of the smears.
    ///
    /// Returns
    /// -------
    /// SimulatedFrame
    ///     Its indentation is relative to the scene's surface at rest; `in_contact` is false throughout,
    ///     because contact is unknown.
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     If the number of points differs from the gel's number of markers, or a point is farther than 10 m.
    #[pyo3(signature = (points_mm, *, frame=Count(0)), text_signature = "($self, points_mm, *, frame=0)")]
    fn render_points(
        slf: &Bound<'_, Self>,
        points_mm: &Bound<'_, PyAny>,
        frame: Count,
    ) -> PyResult<SimulatedFrame> {
        let points_mm = arrays::Numbers::new(points_mm, "points_mm")?;
        let points_mm: &[DVec3] = points_mm.rows::<_, 3>()?;
        let this = slf.get();
        let truth = slf.py().detach(|| {
            let mut truth = sim::Truth::default();
            this.lock().placed(points_mm, frame.0 as u64, &mut truth)?;
            Ok::<_, sim::SceneError>(truth)
        });
        SimulatedFrame::new(slf, frame.0 as u64, truth.map_err(raise)?)
    }
}

/// The surfaces of the parts that are mesh files, each in its place; those that a simulator of a scene in the
/// same folder has are not read again.
fn meshes_of(
    py: Python<'_>,
    scene: &Scene,
    before: Option<&Simulator>,
) -> PyResult<Vec<Option<Arc<TriangleMesh>>>> {
    let known = |shape: &sim::Shape| {
        let before = before?;
        let mut parts = before.scene.get().inner.parts().zip(&before.meshes);
        parts.find(|((other, _), _)| *other == shape).and_then(|(_, mesh)| mesh.clone())
    };
    let read = |shape: &sim::Shape| {
        let sim::Shape::Mesh { path, units } = shape else { return Ok(None) };
        if let Some(mesh) = known(shape) {
            return Ok(Some(mesh));
        }
        let path = scene.folder.join(path).into_pyobject(py)?.into_any();
        let (vertices_mm, triangles) = load_mesh(&path, &units.into_pyobject(py)?.into_any())?;
        Ok(Some(Arc::new(triangle_mesh(&vertices_mm, &triangles)?)))
    };
    scene.inner.parts().map(|(shape, _)| read(shape)).collect()
}

impl Simulator {
    fn lock(&self) -> MutexGuard<'_, sim::Simulator> {
        self.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn rig(&self) -> &Rig {
        &self.scene.get().inner.rig
    }

    /// Contacts of all parts: of the indenter as given, of the others by their poses or their trajectories.
    fn posed(
        &self,
        py: Python<'_>,
        first: Option<sim::ContactState>,
        others: Option<Vec<Option<Bound<'_, PyAny>>>>,
        frame: usize,
    ) -> PyResult<Vec<Option<sim::ContactState>>> {
        let mut contacts = py.detach(|| self.lock().planned(frame));
        match contacts.first_mut() {
            Some(contact) => *contact = first,
            None if first.is_some() => return Err(SceneError::new_err(NO_INDENTER)),
            None => {}
        }
        if let Some(poses) = others {
            let (found, parts) = (poses.len(), contacts.len().saturating_sub(1));
            if found != parts {
                return Err(SceneError::new_err(format!(
                    "others has {found} poses, but the scene has {parts} others; give each a pose, or None"
                )));
            }
            for (contact, pose) in contacts.iter_mut().skip(1).zip(poses) {
                let pose = pose.map(|pose| arrays::pose(&pose, "others")).transpose()?;
                *contact = pose.map(sim::ContactState::pressed);
            }
        }
        contacts.iter().flatten().try_for_each(sim::ContactState::validate).map_err(raise)?;
        Ok(contacts)
    }

    /// Why a part's number is not valid.
    fn no_part(&self, py: Python<'_>, part: usize) -> PyErr {
        match py.detach(|| self.lock().parts()) {
            0 => SceneError::new_err(NO_INDENTER),
            parts => SceneError::new_err(format!("there is no part {part}; the scene has {parts}, from 0")),
        }
    }

    /// Simulates the markers in space; the camera views are computed on access.
    fn moment(
        slf: &Bound<'_, Self>,
        contacts: &[Option<sim::ContactState>],
        frame: u64,
    ) -> PyResult<SimulatedFrame> {
        let this = slf.get();
        let truth = slf.py().detach(|| {
            let (mut stage, mut truth) = (this.lock(), sim::Truth::default());
            // Motion within an exposure is not stored, so dots with motion blur are computed now.
            match stage.plan().scene.effects.motion_blur {
                Some(_) => stage.moment_of(contacts, frame, &mut truth),
                None => stage.field_of(contacts, frame, &mut truth),
            }
            truth
        });
        SimulatedFrame::new(slf, frame, truth)
    }
}

/// Triangles of a shape given by its dimensions.
///
/// Parameters
/// ----------
/// shape : mapping
///     In the form of a scene's ``indenter``, for example ``{"kind": "sphere", "radius_mm": 4.0}``.
/// tolerance_mm : float
///     Maximum distance of the triangles from a curved surface.
///
/// Returns
/// -------
/// vertices_mm : (V, 3) float64
/// triangles : (F, 3) int64
///
/// Raises
/// ------
/// SceneError
///     If it is not a shape, or is a mesh file; `templates.load_mesh` reads these.
#[pyfunction]
#[pyo3(signature = (shape, tolerance_mm=0.01))]
pub fn shape_mesh(
    py: Python<'_>,
    shape: &Bound<'_, PyMapping>,
    tolerance_mm: f64,
) -> PyResult<(Matrix, Py<PyArray2<i64>>)> {
    let shape: sim::Shape = tree::from_mapping(shape).map_err(SceneError::new_err)?;
    shape.validate().map_err(raise)?;
    if !(tolerance_mm > 0.0 && tolerance_mm.is_finite()) {
        return Err(SceneError::new_err(format!(
            "tolerance_mm is {tolerance_mm}; valid is a finite length above 0"
        )));
    }
    let mesh = shape.mesh(tolerance_mm).ok_or_else(|| {
        SceneError::new_err("the shape is a mesh file; gelstereo.templates.load_mesh reads those")
    })?;
    let triangles: Vec<i64> = mesh.triangles().iter().flatten().map(|&i| i64::from(i)).collect();
    let shape = (mesh.triangles().len(), 3);
    Ok((arrays::rows::<_, 3>(py, mesh.vertices_mm().to_vec())?, arrays::shaped(py, triangles, shape)?))
}
