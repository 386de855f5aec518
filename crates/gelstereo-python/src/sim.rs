//! The simulated sensor.

use crate::arrays::{self, Array1, Count, Matrix};
use crate::errors::{SceneError, raise};
use crate::rig::Rig;
use crate::template::{load_mesh, triangle_mesh};
use crate::tree;
use gelstereo_core::math::DVec3;
use gelstereo_sim as sim;
use numpy::{PyArray2, PyArray3};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyTuple, PyType};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

const NO_INDENTER: &str =
    "the scene has no indenter; give it one, for example indenter = { kind = \"sphere\", radius_mm = 4 }";

/// What there is to see, and which effects act; a value that never changes.
///
/// ``Scene()`` is the default sensor with nothing that touches it; `to_dict` shows what can be set.
#[pyclass(frozen, module = "gelstereo")]
pub struct Scene {
    inner: sim::Scene,
    /// Where a mesh file's relative path starts.
    folder: PathBuf,
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

    /// A sensor by its name, without effects and with nothing that touches it: image size and markers along each
    /// side. All see about 22 mm of gel at 28.7 mm; "640x480-25" is the default scene, "640x480-25-refraction" looks
    /// through air, acrylic and gel at 15.6 mm of lattice.
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     If there is no preset of that name; the valid ones are listed.
    #[classmethod]
    fn preset(_cls: &Bound<'_, PyType>, name: &str) -> PyResult<Self> {
        let inner = sim::Scene::preset(name).ok_or_else(|| {
            let valid = sim::Scene::PRESETS.join("\", \"");
            SceneError::new_err(format!("there is no preset \"{name}\"; valid is \"{valid}\""))
        })?;
        Ok(Self { inner, folder: PathBuf::new() })
    }

    /// Names that `preset` knows.
    #[classmethod]
    fn presets<'py>(cls: &Bound<'py, PyType>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(cls.py(), sim::Scene::PRESETS)
    }

    /// A scene from TOML text; what is left out keeps its default.
    ///
    /// Raises
    /// ------
    /// SceneError
    ///     Naming the line, if a name is unknown or a value makes no sense.
    #[classmethod]
    fn from_toml(_cls: &Bound<'_, PyType>, text: &str) -> PyResult<Self> {
        Self::checked(tree::from_toml(text).map_err(SceneError::new_err)?, PathBuf::new())
    }

    /// The scene as TOML text.
    fn to_toml(&self) -> PyResult<String> {
        tree::to_toml(&self.inner).map_err(SceneError::new_err)
    }

    /// A scene from a TOML file; paths of meshes in it are relative to the file.
    #[classmethod]
    fn load(cls: &Bound<'_, PyType>, path: PathBuf) -> PyResult<Self> {
        let folder = path.parent().map(PathBuf::from).unwrap_or_default();
        let text = tree::read(cls.py(), path.clone())?;
        let scene = Self::from_toml(cls, &text).map_err(|error| tree::in_file(cls.py(), &error, &path))?;
        Ok(Self { folder, ..scene })
    }

    /// Write the scene to a TOML file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        tree::write(py, path, &self.to_toml()?)
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
    ///     If a name is unknown (the valid ones are listed) or a value makes no sense.
    #[pyo3(signature = (changes=None, /, **settings))]
    fn replace(
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
}

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
}

impl SimulatedDots {
    fn new(py: Python<'_>, dots: &[sim::DotImage], specks: &[sim::Ellipse]) -> PyResult<Py<Self>> {
        let half_px = dots.iter().flat_map(|dot| dot.outline.half_px).flat_map(|half| half.to_array());
        let dots_px = Self {
            centres_px: arrays::rows::<_, 2>(py, dots.iter().map(|dot| dot.outline.centre_px).collect())?,
            half_px: arrays::shaped(py, half_px.collect(), (dots.len(), 2, 2))?,
            radii_px: arrays::list(py, dots.iter().map(|dot| dot.outline.radius_px()).collect()),
            contrast_levels: arrays::list(py, dots.iter().map(|dot| dot.contrast_levels).collect()),
            sight: arrays::list(py, dots.iter().map(|dot| dot.sight as u8).collect()),
            specks_px: arrays::rows::<_, 2>(py, specks.iter().map(|speck| speck.centre_px).collect())?,
        };
        Py::new(py, dots_px)
    }
}

/// Names and values of the simulator's sights, which `gelstereo.Sight` repeats for the sake of its types.
#[pyfunction]
pub fn sights() -> std::collections::BTreeMap<&'static str, u8> {
    sim::Sight::ALL.map(|(name, sight)| (name, sight as u8)).into()
}

/// Which effects of a scene are computed, and why; its text is a table of them.
///
/// Every effect gives an upper bound of what it would change. Those on auto are off, from the smallest bound on, as long
/// as the bounds of all that are off together stay within the tolerance of what the scene asks; the simulator is then
/// that of a scene which never had them.
#[pyclass(frozen, module = "gelstereo")]
pub struct Plan {
    inner: sim::Plan,
    /// Every effect that the scene has, as a tuple of `PlannedEffect` s.
    #[pyo3(get)]
    effects: Py<PyTuple>,
    /// The scene without what is off: what is simulated.
    #[pyo3(get)]
    scene: Py<Scene>,
}

#[pymethods]
impl Plan {
    /// What the effects that are off on auto may change together, at most, in the unit of what is asked.
    #[getter]
    fn left_out(&self) -> f64 {
        self.inner.left_out()
    }

    /// Estimated time of the effects that are on, nanoseconds per stereo frame.
    #[getter]
    fn cost_ns(&self) -> f64 {
        self.inner.cost_ns()
    }

    fn __str__(&self) -> String {
        self.inner.to_string()
    }
}

/// One effect of a `Plan`.
#[pyclass(frozen, get_all, module = "gelstereo")]
pub struct PlannedEffect {
    /// Its name in a scene; "refraction", "lens_distortion" and "ellipse_bias" are the rig's own.
    name: &'static str,
    /// Whether it is computed.
    on: bool,
    /// The most that it changes a dot's position within an image.
    bound_px: f64,
    /// The most that it changes a marker's position in space.
    bound_um: f64,
    /// The most that it changes a pixel before it is rounded, grey levels.
    bound_levels: f64,
    /// Estimated time per stereo frame while it is on, nanoseconds.
    cost_ns: f64,
    /// Why it is on or off.
    why: String,
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
        let folder = self.scene.get().folder.clone();
        let effect = |entry: &sim::plan::Entry| {
            let planned = PlannedEffect {
                name: entry.effect,
                on: entry.on,
                bound_px: entry.bound.px,
                bound_um: entry.bound.um,
                bound_levels: entry.bound.levels,
                cost_ns: entry.cost_ns,
                why: entry.why.to_string(),
            };
            Py::new(py, planned)
        };
        let effects = plan.entries.iter().map(effect).collect::<PyResult<Vec<_>>>()?;
        Ok(Plan {
            effects: PyTuple::new(py, effects)?.unbind(),
            scene: Py::new(py, Scene { inner: plan.scene.clone(), folder })?,
            inner: plan,
        })
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
            left_dots: SimulatedDots::new(py, &truth.left_dots, &truth.left_specks)?,
            right_dots: SimulatedDots::new(py, &truth.right_dots, &truth.right_specks)?,
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
