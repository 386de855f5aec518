//! The simulated sensor.

mod plan;
mod scene;

pub use plan::{Plan, PlannedEffect};
pub use scene::Scene;

use crate::arrays::{self, Array1, Count, Matrix};
use crate::errors::{SceneError, raise};
use crate::template::{load_mesh, triangle_mesh};
use crate::tree;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_sim as sim;
use numpy::{PyArray2, PyArray3};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::PyMapping;
use std::sync::{Mutex, MutexGuard, PoisonError};

const NO_INDENTER: &str =
    "the scene has no indenter; give it one, for example indenter = { kind = \"sphere\", radius_mm = 4 }";

/// One moment of a scene: both images and the truth behind them.
#[pyclass(frozen, get_all, module = "gelstereo")]
pub struct SimulatedFrame {
    /// Which frame of the trajectory; it keys the noise, and jumps where frames were dropped.
    index: u64,
    /// When it was taken, seconds on the keyframes' clock.
    time_s: f64,
    /// (H, W) uint8 left image.
    left: Py<PyArray2<u8>>,
    /// (H, W) uint8 right image.
    right: Py<PyArray2<u8>>,
    /// (N, 2) true centres in the left image.
    left_px: Matrix,
    /// (N, 2) true centres in the right image.
    right_px: Matrix,
    /// (N, 3) true marker positions, sensor frame.
    points_mm: Matrix,
    /// (N, 3) true unit normals of the surface at the markers, towards the cameras.
    normals: Matrix,
    /// How the markers look in the left image.
    left_dots: Py<SimulatedDots>,
    /// How the markers look in the right image.
    right_dots: Py<SimulatedDots>,
    /// (N,) true height above the rest surface.
    indentation_mm: Array1<f64>,
    /// (N,) bool, whether the indenter touches the gel at this marker.
    in_contact: Array1<bool>,
    /// (4, 4) true pose of the indenter, or None when there is none.
    t_sensor_object: Option<Matrix>,
}

/// How the markers' dots look in one image, N markers and S specks.
#[pyclass(frozen, get_all, module = "gelstereo")]
pub struct SimulatedDots {
    /// (N, 2) centroids of the dots' images, which are not the images of the dots' centres.
    centres_px: Matrix,
    /// (N, 2, 2) two conjugate half diameters of each dot's elliptical image.
    half_px: Py<PyArray3<f64>>,
    /// (N,) radius of the circle of the same area.
    radii_px: Array1<f64>,
    /// (N,) difference between dot and gel there, before the lens blurs it, grey levels.
    contrast_levels: Array1<f64>,
    /// (N,) uint8, what there is to see of each dot, see `Sight`.
    sight: Array1<u8>,
    /// (S, 2) centroids of specks, which are no markers.
    specks_px: Matrix,
    /// (N, 2) how far each dot's image moves while the shutter is open; 0 where the scene has no motion blur.
    motion_px: Matrix,
}

impl SimulatedDots {
    fn new(
        py: Python<'_>,
        dots: &[sim::DotImage],
        specks: &[sim::Ellipse],
        mut motion_px: Vec<DVec2>,
    ) -> PyResult<Py<Self>> {
        // Those of the specks follow; none are known when nothing is known to move.
        motion_px.resize(dots.len(), DVec2::ZERO);
        let half_px = dots.iter().flat_map(|dot| dot.outline.half_px).flat_map(|half| half.to_array());
        let dots_px = Self {
            centres_px: arrays::rows::<_, 2>(py, dots.iter().map(|dot| dot.outline.centre_px).collect())?,
            half_px: arrays::shaped(py, half_px.collect(), (dots.len(), 2, 2))?,
            radii_px: arrays::list(py, dots.iter().map(|dot| dot.outline.radius_px()).collect()),
            contrast_levels: arrays::list(py, dots.iter().map(|dot| dot.contrast_levels).collect()),
            sight: arrays::list(py, dots.iter().map(|dot| dot.sight as u8).collect()),
            specks_px: arrays::rows::<_, 2>(py, specks.iter().map(|speck| speck.centre_px).collect())?,
            motion_px: arrays::rows::<_, 2>(py, motion_px)?,
        };
        Py::new(py, dots_px)
    }
}

/// Names and values of the simulator's sights, which `gelstereo.Sight` repeats for the sake of its types.
#[pyfunction]
pub fn sights() -> std::collections::BTreeMap<&'static str, u8> {
    sim::Sight::ALL.map(|(name, sight)| (name, sight as u8)).into()
}

/// A scene made ready to run: a sequence of the `SimulatedFrame` s that arrive, each rendered when it is asked for.
///
/// Parameters
/// ----------
/// scene : Scene
///
/// Raises
/// ------
/// SceneError, MeshError
///     If the scene makes no sense or its mesh cannot be read.
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

    /// The scene it was made of.
    #[getter]
    fn scene(&self, py: Python<'_>) -> Py<Scene> {
        self.scene.clone_ref(py)
    }

    /// Which effects are computed and why.
    #[getter]
    fn plan(&self, py: Python<'_>) -> PyResult<Plan> {
        let plan = py.detach(|| self.lock().plan().clone());
        Plan::new(py, plan, self.scene.get().folder.clone())
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        py.detach(|| self.lock().delivered())
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<SimulatedFrame> {
        let frames = self.__len__(py);
        let counted = if index < 0 { index + frames as isize } else { index };
        let arrived = usize::try_from(counted).ok();
        let frame = arrived.and_then(|arrived| py.detach(|| self.lock().frame_of(arrived)));
        let frame = frame.ok_or_else(|| {
            PyIndexError::new_err(format!("there is no frame {index}; the scene has {frames}"))
        })?;
        let contact = py.detach(|| self.lock().contact(frame));
        self.moment(py, contact.as_ref(), frame as u64)
    }

    /// (4, 4) the pose moved along the sensor's z until the part reaches `press_mm` into the gel.
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     If the scene has no indenter, or the part would be far beyond the sensor.
    fn pressed(&self, py: Python<'_>, t_sensor_object: &Bound<'_, PyAny>, press_mm: f64) -> PyResult<Matrix> {
        let pose = arrays::pose(t_sensor_object, "t_sensor_object")?;
        let pose = py.detach(|| self.lock().pressed(pose, press_mm));
        let pose = pose.ok_or_else(|| SceneError::new_err(NO_INDENTER))?;
        let contact = sim::ContactState { t_sensor_object: pose, shear_mm: [0.0; 2], twist_rad: 0.0 };
        contact.validate().map_err(raise)?;
        arrays::pose_matrix(py, &pose)
    }

    /// Render a moment that is not on the trajectory.
    ///
    /// Parameters
    /// ----------
    /// t_sensor_object : (4, 4) array_like, optional
    ///     The indenter's pose; nothing touches the gel if it is left out.
    /// shear_mm : (float, float), optional
    ///     How far the contact has dragged the surface along, sensor x and y.
    /// twist_rad : float
    ///     How far it has turned the surface.
    /// frame : int
    ///     Keys the noise, and times the gel's motion and smears.
    #[pyo3(signature = (t_sensor_object=None, *, shear_mm=None, twist_rad=0.0, frame=Count(0)), text_signature = "($self, t_sensor_object=None, *, shear_mm=None, twist_rad=0.0, frame=0)")]
    fn press(
        &self,
        py: Python<'_>,
        t_sensor_object: Option<&Bound<'_, PyAny>>,
        shear_mm: Option<(f64, f64)>,
        twist_rad: f64,
        frame: Count,
    ) -> PyResult<SimulatedFrame> {
        let pose = t_sensor_object.map(|pose| arrays::pose(pose, "t_sensor_object")).transpose()?;
        let contact = pose.map(|t_sensor_object| sim::ContactState {
            t_sensor_object,
            shear_mm: shear_mm.unwrap_or_default().into(),
            twist_rad,
        });
        if let Some(contact) = &contact {
            contact.validate().map_err(raise)?;
            if self.scene.get().inner.indenter.is_none() {
                return Err(SceneError::new_err(NO_INDENTER));
            }
        }
        self.moment(py, contact.as_ref(), frame.0 as u64)
    }

    /// Render markers that someone else has placed: those of another sensor's recording, say.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     Sensor frame, marker ``row * cols + col`` of the scene's gel at that index.
    /// frame : int
    ///     Keys the noise, and times the smears.
    ///
    /// Returns
    /// -------
    /// SimulatedFrame
    ///     Its indentation counts from the scene's flat surface; `in_contact` is false throughout, since nobody knows.
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     If there are more or fewer points than the gel has markers, or one is beyond 10 m.
    #[pyo3(signature = (points_mm, *, frame=Count(0)), text_signature = "($self, points_mm, *, frame=0)")]
    fn render_points(
        &self,
        py: Python<'_>,
        points_mm: &Bound<'_, PyAny>,
        frame: Count,
    ) -> PyResult<SimulatedFrame> {
        let points_mm = arrays::Numbers::new(points_mm, "points_mm")?;
        let points_mm: &[DVec3] = points_mm.rows::<_, 3>()?;
        self.render(py, None, frame.0 as u64, |stage, truth| stage.placed(points_mm, frame.0 as u64, truth))
    }
}

impl Simulator {
    fn lock(&self) -> MutexGuard<'_, sim::Simulator> {
        self.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn moment(
        &self,
        py: Python<'_>,
        contact: Option<&sim::ContactState>,
        frame: u64,
    ) -> PyResult<SimulatedFrame> {
        self.render(py, contact, frame, |stage, truth| {
            stage.moment(contact, frame, truth);
            Ok(())
        })
    }

    /// Renders what `describe` has found to be true.
    fn render(
        &self,
        py: Python<'_>,
        contact: Option<&sim::ContactState>,
        frame: u64,
        describe: impl FnOnce(&mut sim::Simulator, &mut sim::Truth) -> Result<(), sim::SceneError> + Send,
    ) -> PyResult<SimulatedFrame> {
        let (mut truth, mut left, mut right) = (sim::Truth::default(), Vec::new(), Vec::new());
        let time_s = py.detach(|| {
            let mut stage = self.lock();
            describe(&mut stage, &mut truth)?;
            stage.render(&truth, frame, &mut left, &mut right);
            Ok::<_, sim::SceneError>(stage.time_s(frame))
        });
        let time_s = time_s.map_err(raise)?;
        let rig = &self.scene.get().inner.rig;
        Ok(SimulatedFrame {
            index: frame,
            time_s,
            left: arrays::shaped(py, left, (rig.left.height_px, rig.left.width_px))?,
            right: arrays::shaped(py, right, (rig.right.height_px, rig.right.width_px))?,
            left_px: arrays::rows::<_, 2>(py, truth.left_px)?,
            right_px: arrays::rows::<_, 2>(py, truth.right_px)?,
            points_mm: arrays::rows::<_, 3>(py, truth.points_mm)?,
            normals: arrays::rows::<_, 3>(py, truth.normals)?,
            left_dots: SimulatedDots::new(py, &truth.left_dots, &truth.left_specks, truth.left_motion_px)?,
            right_dots: SimulatedDots::new(
                py,
                &truth.right_dots,
                &truth.right_specks,
                truth.right_motion_px,
            )?,
            indentation_mm: arrays::list(py, truth.indentation_mm),
            in_contact: arrays::list(py, truth.in_contact),
            t_sensor_object: contact.map(|c| arrays::pose_matrix(py, &c.t_sensor_object)).transpose()?,
        })
    }
}

/// Triangles of a shape by its dimensions.
///
/// Parameters
/// ----------
/// shape : mapping
///     As a scene's ``indenter``, for example ``{"kind": "sphere", "radius_mm": 4.0}``.
/// tolerance_mm : float
///     How far the flat triangles may be from a curved surface.
///
/// Returns
/// -------
/// vertices_mm : (V, 3) float64
/// triangles : (F, 3) int64
///
/// Raises
/// ------
/// SceneError
///     If it is no shape, or a mesh file, which `templates.load_mesh` reads.
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
