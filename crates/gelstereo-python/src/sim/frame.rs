//! One moment of a scene.

use super::Simulator;
use crate::arrays::{self, Array1, Matrix};
use crate::errors::raise;
use crate::notebook;
use gelstereo_core::math::DVec2;
use gelstereo_sim as sim;
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use std::sync::OnceLock;

type Image = Py<PyArray2<u8>>;

/// One moment of a scene: both images and their ground truth.
///
/// The camera views and the images are computed on first access, so reading points alone costs only these.
#[pyclass(frozen, module = "gelstereo")]
pub struct SimulatedFrame {
    /// Index of the frame in the trajectory; it seeds the noise, and has gaps where frames were dropped.
    #[pyo3(get)]
    index: u64,
    /// Exposure time, seconds on the keyframes' clock.
    #[pyo3(get)]
    time_s: f64,
    /// (N, 3) true marker positions, sensor frame.
    #[pyo3(get)]
    points_mm: Matrix,
    /// (N,) true height above the rest surface.
    #[pyo3(get)]
    indentation_mm: Array1<f64>,
    /// (N,) bool, whether a part touches the gel at the marker.
    #[pyo3(get)]
    in_contact: Array1<bool>,
    /// (N,) number of the part that touches the gel at the marker: 0 is the indenter, n the n-th of the
    /// scene's ``others``; -1 where none does.
    #[pyo3(get)]
    touched_by: Array1<i64>,
    /// (4, 4) true pose of the indenter, or None without one.
    #[pyo3(get)]
    t_sensor_object: Option<Matrix>,
    /// (4, 4) true pose of each part by its number, or None of one that is not there.
    #[pyo3(get)]
    t_sensor_objects: Vec<Option<Matrix>>,
    simulator: Py<Simulator>,
    /// At least the markers in space.
    truth: sim::Truth,
    seen: OnceLock<sim::Truth>,
    views: OnceLock<Views>,
    images: OnceLock<[Image; 2]>,
}

/// The camera views as arrays.
struct Views {
    pixels: [Matrix; 2],
    normals: Matrix,
    dots: [Py<SimulatedDots>; 2],
}

impl SimulatedFrame {
    /// From a field or a moment.
    pub(super) fn new(simulator: &Bound<'_, Simulator>, index: u64, truth: sim::Truth) -> PyResult<Self> {
        let (py, stage) = (simulator.py(), simulator.get());
        let pose = |contact: &Option<sim::ContactState>| {
            contact.map(|contact| arrays::pose_matrix(py, &contact.t_sensor_object)).transpose()
        };
        let t_sensor_objects = truth.contacts.iter().map(pose).collect::<PyResult<Vec<_>>>()?;
        let touched_by = truth.touched_by.iter().map(|part| part.map_or(-1, i64::from));
        Ok(Self {
            index,
            time_s: py.detach(|| stage.lock().time_s(index)),
            points_mm: arrays::rows::<_, 3>(py, truth.points_mm.clone())?,
            indentation_mm: arrays::list(py, truth.indentation_mm.clone()),
            in_contact: arrays::list(py, truth.in_contact.clone()),
            touched_by: arrays::list(py, touched_by.collect()),
            t_sensor_object: t_sensor_objects.first().and_then(|pose| pose.as_ref()).map(|m| m.clone_ref(py)),
            t_sensor_objects,
            simulator: simulator.clone().unbind(),
            truth,
            seen: OnceLock::new(),
            views: OnceLock::new(),
            images: OnceLock::new(),
        })
    }

    /// The complete ground truth. Two concurrent calls both compute it, with the same result.
    fn seen(&self, py: Python<'_>) -> PyResult<&sim::Truth> {
        if self.truth.left_px.len() == self.truth.points_mm.len() {
            return Ok(&self.truth);
        }
        if let Some(seen) = self.seen.get() {
            return Ok(seen);
        }
        let (simulator, index, mut truth) = (self.simulator.get(), self.index, self.truth.clone());
        let seen = py.detach(|| {
            simulator.lock().look(index, &mut truth)?;
            Ok::<_, sim::SceneError>(truth)
        });
        let seen = seen.map_err(raise)?;
        Ok(self.seen.get_or_init(|| seen))
    }

    fn views(&self, py: Python<'_>) -> PyResult<&Views> {
        if let Some(views) = self.views.get() {
            return Ok(views);
        }
        let truth = self.seen(py)?;
        let pixels = |px: &[DVec2]| arrays::rows::<_, 2>(py, px.to_vec());
        let views = Views {
            pixels: [pixels(&truth.left_px)?, pixels(&truth.right_px)?],
            normals: arrays::rows::<_, 3>(py, truth.normals.clone())?,
            dots: [
                SimulatedDots::new(py, &truth.left_dots, &truth.left_specks, &truth.left_motion_px)?,
                SimulatedDots::new(py, &truth.right_dots, &truth.right_specks, &truth.right_motion_px)?,
            ],
        };
        Ok(self.views.get_or_init(|| views))
    }

    fn images(&self, py: Python<'_>) -> PyResult<&[Image; 2]> {
        if let Some(images) = self.images.get() {
            return Ok(images);
        }
        let (truth, simulator, index) = (self.seen(py)?, self.simulator.get(), self.index);
        let [left, right] = py.detach(|| {
            let (mut left, mut right) = (Vec::new(), Vec::new());
            simulator.lock().render(truth, index, &mut left, &mut right);
            [left, right]
        });
        let rig = simulator.rig();
        let images = [
            arrays::shaped(py, left, (rig.left.height_px, rig.left.width_px))?,
            arrays::shaped(py, right, (rig.right.height_px, rig.right.width_px))?,
        ];
        Ok(self.images.get_or_init(|| images))
    }
}

#[pymethods]
impl SimulatedFrame {
    /// Both images side by side, for notebooks.
    fn _repr_png_<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        notebook::png(slf.as_any(), "pair_png")
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let touching = self.truth.in_contact.iter().filter(|touches| **touches).count();
        let (index, time_s, markers) = (self.index, self.time_s, self.points_mm.bind(py).len()?);
        Ok(format!("<SimulatedFrame {index} at {time_s:.3} s: {markers} markers, {touching} in contact>"))
    }

    /// (H, W) uint8 left image.
    #[getter]
    fn left(&self, py: Python<'_>) -> PyResult<Image> {
        Ok(self.images(py)?[0].clone_ref(py))
    }

    /// (H, W) uint8 right image.
    #[getter]
    fn right(&self, py: Python<'_>) -> PyResult<Image> {
        Ok(self.images(py)?[1].clone_ref(py))
    }

    /// Loads that the parts exert on the gel, `SimulatedLoads`; None without ``effects.elastic_layer``.
    #[getter]
    fn loads(&self, py: Python<'_>) -> PyResult<Option<SimulatedLoads>> {
        let Some(loads) = &self.truth.loads else { return Ok(None) };
        let vector = |v: gelstereo_core::math::DVec3| arrays::list(py, v.to_array().to_vec());
        Ok(Some(SimulatedLoads {
            force_n: vector(loads.force_n),
            torque_nmm: vector(loads.torque_nmm),
            about_mm: vector(loads.about_mm),
            part_force_n: arrays::rows::<_, 3>(py, loads.parts.iter().map(|part| part.force_n).collect())?,
            part_torque_nmm: arrays::rows::<_, 3>(
                py,
                loads.parts.iter().map(|part| part.torque_nmm).collect(),
            )?,
            traction_kpa: arrays::rows::<_, 3>(py, loads.traction_kpa.clone())?,
            stick: arrays::list(py, loads.stick.iter().map(|&stick| stick as u8).collect()),
        }))
    }

    /// (N, 2) true centres in the left image.
    #[getter]
    fn left_px(&self, py: Python<'_>) -> PyResult<Matrix> {
        Ok(self.views(py)?.pixels[0].clone_ref(py))
    }

    /// (N, 2) true centres in the right image.
    #[getter]
    fn right_px(&self, py: Python<'_>) -> PyResult<Matrix> {
        Ok(self.views(py)?.pixels[1].clone_ref(py))
    }

    /// (N, 3) true unit normals of the surface at the markers, towards the cameras.
    #[getter]
    fn normals(&self, py: Python<'_>) -> PyResult<Matrix> {
        Ok(self.views(py)?.normals.clone_ref(py))
    }

    /// Appearance of the markers in the left image.
    #[getter]
    fn left_dots(&self, py: Python<'_>) -> PyResult<Py<SimulatedDots>> {
        Ok(self.views(py)?.dots[0].clone_ref(py))
    }

    /// Appearance of the markers in the right image.
    #[getter]
    fn right_dots(&self, py: Python<'_>) -> PyResult<Py<SimulatedDots>> {
        Ok(self.views(py)?.dots[1].clone_ref(py))
    }
}

/// Loads that the simulated parts exert on the gel, P parts and N markers.
#[pyclass(frozen, get_all, module = "gelstereo")]
pub struct SimulatedLoads {
    /// (3,) force, newtons along the sensor's axes.
    force_n: Array1<f64>,
    /// (3,) torque about `about_mm`, newton millimetres.
    torque_nmm: Array1<f64>,
    /// (3,) centroid of the markers at rest, sensor frame.
    about_mm: Array1<f64>,
    /// (P, 3) force of each part by its number.
    part_force_n: Matrix,
    /// (P, 3) torque of each part about `about_mm`.
    part_torque_nmm: Matrix,
    /// (N, 3) mean traction over the rectangle of a pitch around each marker, along the sensor's axes.
    traction_kpa: Matrix,
    /// (N,) uint8 whether the gel sticks to a part at each marker, see `Stick`.
    stick: Array1<u8>,
}

#[pymethods]
impl SimulatedLoads {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let [x, y, z] = self.force_n.bind(py).extract::<[f64; 3]>()?;
        Ok(format!("<SimulatedLoads: force ({x:.3}, {y:.3}, {z:.3}) N>"))
    }
}

/// Appearance of the markers' dots in one image, N markers and S specks.
#[pyclass(frozen, get_all, module = "gelstereo")]
pub struct SimulatedDots {
    /// (N, 2) centroids of the dots' images, which differ from the images of the dots' centres.
    centres_px: Matrix,
    /// (N, 2, 2) two conjugate half diameters of each dot's elliptical image.
    half_px: Py<PyArray3<f64>>,
    /// (N,) radius of the circle of the same area.
    radii_px: Array1<f64>,
    /// (N,) contrast between dot and gel before the lens blur, grey levels.
    contrast_levels: Array1<f64>,
    /// (N,) uint8 visibility of each dot, see `Sight`.
    sight: Array1<u8>,
    /// (S, 2) centroids of specks, which are not markers.
    specks_px: Matrix,
    /// (N, 2) motion of each dot's image during the exposure; 0 where the scene has no motion blur.
    motion_px: Matrix,
}

#[pymethods]
impl SimulatedDots {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let (dots, specks) = (self.centres_px.bind(py).len()?, self.specks_px.bind(py).len()?);
        Ok(format!("<SimulatedDots: {dots} dots, {specks} specks>"))
    }
}

impl SimulatedDots {
    fn new(
        py: Python<'_>,
        dots: &[sim::DotImage],
        specks: &[sim::Ellipse],
        motion_px: &[DVec2],
    ) -> PyResult<Py<Self>> {
        // The specks follow the markers; their motion is 0.
        let mut motion_px = motion_px.to_vec();
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
