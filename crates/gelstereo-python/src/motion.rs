//! Motion of a part without a model.

use crate::arrays::{self, Array1, Count, Matrix, Numbers};
use crate::contact::RestSurface;
use crate::errors::raise;
use crate::frame::Frame;
use crate::moved::GivenMarkers;
use crate::names::name;
use crate::params::Params;
use crate::slip::Slip;
use gelstereo_core::force::MovedMarkers;
use gelstereo_core::lattice::Topology;
use gelstereo_core::math::DVec3;
use gelstereo_core::motion as core;
use numpy::PyArray3;
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

type Cube = Py<PyArray3<f64>>;

/// Names and values of how well a motion is known, repeated in `gelstereo.MotionStatus` for typing.
#[pyfunction]
pub fn motion_statuses() -> BTreeMap<&'static str, u8> {
    core::MotionStatus::ALL.map(|(name, status)| (name, status as u8)).into()
}

/// Names and values of what a motion is found from, repeated in `gelstereo.MotionSource` for typing.
#[pyfunction]
pub fn motion_sources() -> BTreeMap<&'static str, u8> {
    core::MotionSource::ALL.map(|(name, source)| (name, source as u8)).into()
}

/// Names and values of how a part moves, repeated in `gelstereo.MotionKind` for typing.
#[pyfunction]
pub fn motion_kinds() -> BTreeMap<&'static str, u8> {
    core::MotionKind::ALL.map(|(name, kind)| (name, kind as u8)).into()
}

/// Motion of a part in one frame of a contact. The part's frame is the sensor frame at first touch.
#[pyclass(frozen, module = "gelstereo")]
pub struct PartMotion {
    inner: core::PartMotion,
}

#[pymethods]
impl PartMotion {
    /// How well the motion is known: value of `MotionStatus`.
    #[getter]
    const fn status(&self) -> u8 {
        self.inner.status as u8
    }

    /// What it is found from: value of `MotionSource`.
    #[getter]
    const fn source(&self) -> u8 {
        self.inner.source as u8
    }

    /// How the part moves along the gel: value of `MotionKind`.
    #[getter]
    const fn kind(&self) -> u8 {
        self.inner.kind as u8
    }

    /// (4, 4) motion since first touch: moves points of the part from where they were to where they are,
    /// sensor frame.
    #[getter]
    fn pose(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.inner.since_touch.pose.to_rows())
    }

    /// (6, 6) covariance of a small rotation about `about_mm` and a small translation after `pose`: rad²,
    /// rad mm and mm².
    #[getter]
    fn covariance(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.inner.since_touch.covariance)
    }

    /// (3,) centroid of the contact, sensor frame.
    #[getter]
    fn about_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.since_touch.about_mm.to_array().to_vec())
    }

    /// (4, 4) motion since the last frame.
    #[getter]
    fn step(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.inner.step.pose.to_rows())
    }

    /// (6, 6) covariance of `step`, as `covariance`.
    #[getter]
    fn step_covariance(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.inner.step.covariance)
    }

    /// (4, 4) pose of the keyframe that this frame is compared with: the motion from first touch to there.
    #[getter]
    fn keyframe_pose(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.inner.keyframe_pose.to_rows())
    }

    /// Directions, of six, that markers and surface determine better than the settings
    /// ``motion.free_turn_rad`` and ``motion.free_shift_mm`` do for one frame.
    #[getter]
    const fn determined(&self) -> u8 {
        self.inner.determined
    }

    /// Contacts before this one.
    #[getter]
    const fn contact(&self) -> u32 {
        self.inner.contact
    }

    /// Keyframes of this contact before the one that this frame is compared with.
    #[getter]
    const fn keyframe(&self) -> u32 {
        self.inner.keyframe
    }

    /// Loops closed in this contact up to this frame. The pose jumps in the frame that closes one; earlier
    /// poses are corrected by `MotionTracker.keyframes`.
    #[getter]
    const fn loops(&self) -> u32 {
        self.inner.loops
    }

    /// Markers that have stuck since the keyframe.
    #[getter]
    const fn stuck(&self) -> u32 {
        self.inner.stuck
    }

    /// Markers compared with the keyframe's surface.
    #[getter]
    const fn surface(&self) -> u32 {
        self.inner.surface
    }

    /// Frames over which `over_part_mm`, `over_gel_mm` and `slid_mm` are measured.
    #[getter]
    const fn travel_frames(&self) -> u32 {
        self.inner.travel.frames
    }

    /// (3,) how far the contact's centroid has moved over the part, along the gel.
    #[getter]
    fn over_part_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.travel.over_part_mm.to_array().to_vec())
    }

    /// Standard deviation of `over_part_mm` in that direction.
    #[getter]
    const fn over_part_sigma_mm(&self) -> f64 {
        self.inner.travel.over_part_sigma_mm
    }

    /// (3,) how far the contact's centroid has moved over the gel.
    #[getter]
    fn over_gel_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.travel.over_gel_mm.to_array().to_vec())
    }

    /// Standard deviation of `over_gel_mm` in that direction.
    #[getter]
    const fn over_gel_sigma_mm(&self) -> f64 {
        self.inner.travel.over_gel_sigma_mm
    }

    /// (3,) how far the part has moved along the markers, in the mean over the contact.
    #[getter]
    fn slid_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.travel.slid_mm.to_array().to_vec())
    }

    /// Standard deviation of `slid_mm` in that direction.
    #[getter]
    const fn slid_sigma_mm(&self) -> f64 {
        self.inner.travel.slid_sigma_mm
    }

    /// Slip of the contact.
    #[getter]
    const fn slip(&self) -> Slip {
        Slip::from_core(self.inner.slip)
    }

    fn __repr__(&self) -> String {
        format!(
            "<PartMotion: {}, {}, keyframe {}, {} markers stick>",
            name(&core::MotionStatus::ALL, self.inner.status),
            name(&core::MotionKind::ALL, self.inner.kind),
            self.inner.keyframe,
            self.inner.stuck
        )
    }
}

/// Where a contact is on a known surface.
#[pyclass(frozen, module = "gelstereo")]
pub struct Recognition {
    inner: core::Recognition,
}

#[pymethods]
impl Recognition {
    /// Whether the contact is recognized: value of `gelstereo.part_surface.RecognitionStatus`.
    #[getter]
    const fn status(&self) -> u8 {
        self.inner.status as u8
    }

    /// (4, 4) pose that moves the known surface onto the contact.
    #[getter]
    fn t_contact_part(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.inner.t_contact_part.pose.to_rows())
    }

    /// (6, 6) covariance of a small rotation about `about_mm` and a small translation after it: rad²,
    /// rad mm and mm².
    #[getter]
    fn covariance(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.inner.t_contact_part.covariance)
    }

    /// (3,) centroid of the contact.
    #[getter]
    fn about_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.t_contact_part.about_mm.to_array().to_vec())
    }

    /// (4, 4) second most likely pose; `None` if all starts led to one.
    #[getter]
    fn other(&self, py: Python<'_>) -> PyResult<Option<Matrix>> {
        self.inner.other.map(|pose| arrays::matrix(py, pose.to_rows())).transpose()
    }

    /// Directions, of six, that the surface determines better than the guess.
    #[getter]
    const fn determined(&self) -> u8 {
        self.inner.determined
    }

    /// Points of the contact with a counterpart.
    #[getter]
    const fn matched(&self) -> u32 {
        self.inner.matched
    }

    /// Mean of their squared residuals over their variances.
    #[getter]
    const fn mean_square(&self) -> f64 {
        self.inner.mean_square
    }

    fn __repr__(&self) -> String {
        let name = name(&core::RecognitionStatus::ALL, self.inner.status);
        let (matched, square) = (self.inner.matched, self.inner.mean_square);
        format!("<Recognition: {name}, {matched} points match, mean square {square:.2}>")
    }
}

/// Names and values of whether a contact is recognized, repeated in
/// `gelstereo.part_surface.RecognitionStatus` for typing.
#[pyfunction]
pub fn recognition_statuses() -> BTreeMap<&'static str, u8> {
    core::RecognitionStatus::ALL.map(|(name, status)| (name, status as u8)).into()
}

/// Finds where a contact is on a known surface. `gelstereo.part_surface.PartSurface.recognize` checks what it
/// is given; `None` for numbers that are not valid.
#[pyfunction]
#[pyo3(signature = (known, contact, guess, sigma, *, spacing_mm, surface_sigma_mm))]
pub fn recognize_surface(
    py: Python<'_>,
    known: &Bound<'_, PyAny>,
    contact: &Bound<'_, PyAny>,
    guess: &Bound<'_, PyAny>,
    sigma: (f64, f64),
    spacing_mm: f64,
    surface_sigma_mm: f64,
) -> PyResult<Option<Recognition>> {
    let surface_points = |object, name| -> PyResult<Vec<core::SurfacePoint>> {
        let numbers = Numbers::new(object, name)?;
        let point = |row: &[f64; 7]| {
            let [x, y, z, a, b, c, sigma] = *row;
            let (point_mm, normal) = (DVec3::new(x, y, z), DVec3::new(a, b, c));
            core::SurfacePoint { point_mm, normal, variance_mm2: sigma * sigma }
        };
        Ok(numbers.rows::<[f64; 7], 7>()?.iter().map(point).collect())
    };
    let (points, contact) = (surface_points(known, "known")?, surface_points(contact, "contact")?);
    let guess = arrays::pose(guess, "guess")?;
    let found = py.detach(|| {
        let known = core::KnownSurface { points: &points, spacing_mm, surface_sigma_mm };
        known.recognize(&contact, &guess, [sigma.0, sigma.1])
    });
    Ok(found.map(|inner| Recognition { inner }))
}

/// Follows a part without a model, from markers that stick and the surface of the contact.
///
/// Parameters
/// ----------
/// rest : RestSurface
///     Row by row.
/// params : Params
///     Its tables ``motion`` and ``slip`` and ``lattice.layout`` are used. ``slip.method`` may be ``"none"``.
/// cols : int
///     Markers in a row.
///
/// Raises
/// ------
/// ParamsError
///     If a setting is not valid.
/// ContactError
///     If the markers do not fill whole rows.
#[pyclass(frozen, module = "gelstereo")]
pub struct MotionTracker {
    inner: Mutex<core::MotionTracker>,
}

impl MotionTracker {
    fn inner(&self) -> std::sync::MutexGuard<'_, core::MotionTracker> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn moved(&self, moved: &MovedMarkers<'_>) -> PyResult<Option<PartMotion>> {
        let motion = self.inner().run(moved).map_err(raise)?;
        Ok(motion.map(|inner| PartMotion { inner }))
    }
}

#[pymethods]
impl MotionTracker {
    #[new]
    #[pyo3(signature = (rest, params, *, cols))]
    fn new(rest: &RestSurface, params: &Params, cols: Count) -> PyResult<Self> {
        let (slip, motion) = (&params.inner.slip, &params.inner.motion);
        let topology = Topology::of(params.inner.lattice.layout, cols.0, rest.core().points_mm());
        let made = core::MotionTracker::on(slip, motion, rest.core(), topology);
        Ok(Self { inner: Mutex::new(made.map_err(raise)?) })
    }

    fn __repr__(&self) -> String {
        format!("<MotionTracker: {} markers>", self.inner().markers())
    }

    /// Forget the contact: the next frame is the first touch.
    fn restart(&self) {
        self.inner().restart();
    }

    /// The part's surface in the last frame, for `gelstereo.part_surface.PartSurface`.
    ///
    /// Returns
    /// -------
    /// points_mm : (M, 3) float64
    ///     Markers in contact with enough neighbours for a normal, in the part's frame: the sensor frame at
    ///     first touch.
    /// normals : (M, 3) float64
    ///     Unit normals out of the part.
    /// sigma_mm : (M,) float64
    ///     Standard deviations along the normals, by the noise of the markers, and by edges that are sharper
    ///     than the markers' distance shows.
    fn surface(&self, py: Python<'_>) -> PyResult<(Matrix, Matrix, Array1<f64>)> {
        let found: Vec<core::SurfacePoint> = self.inner().surface().collect();
        Ok((
            arrays::rows::<_, 3>(py, found.iter().map(|p| p.point_mm).collect())?,
            arrays::rows::<_, 3>(py, found.iter().map(|p| p.normal).collect())?,
            arrays::list(py, found.iter().map(|p| p.variance_mm2.sqrt()).collect()),
        ))
    }

    /// Keyframes of the last contact that are remembered, corrected by all loops that were closed since.
    ///
    /// Returns
    /// -------
    /// numbers : (K,) int64
    ///     As in `PartMotion.keyframe`, ascending.
    /// poses : (K, 4, 4) float64
    ///     Motions from first touch to each keyframe, sensor frame.
    /// covariances : (K, 6, 6) float64
    ///     Of a small rotation about `about_mm` and a small translation after it: rad², rad mm and mm².
    /// about_mm : (K, 3) float64
    ///     Centroids of the contact, sensor frame.
    fn keyframes(&self, py: Python<'_>) -> PyResult<(Array1<i64>, Cube, Cube, Matrix)> {
        let found: Vec<_> = self.inner().keyframes().collect();
        let count = found.len();
        let poses = found.iter().flat_map(|(_, m)| m.pose.to_rows().concat()).collect();
        let covariances = found.iter().flat_map(|(_, m)| m.covariance.concat()).collect();
        Ok((
            arrays::list(py, found.iter().map(|&(number, _)| i64::from(number)).collect()),
            arrays::shaped(py, poses, (count, 4, 4))?,
            arrays::shaped(py, covariances, (count, 6, 6))?,
            arrays::rows::<_, 3>(py, found.iter().map(|(_, m)| m.about_mm).collect())?,
        ))
    }

    /// Find the motion up to the next frame of a pipeline.
    ///
    /// Parameters
    /// ----------
    /// frame : Frame
    ///     As returned by `Pipeline.process`.
    ///
    /// Returns
    /// -------
    /// PartMotion or None
    ///     None without contact.
    ///
    /// Raises
    /// ------
    /// ContactError
    ///     If the frame has another number of markers than the rest surface.
    fn process(&self, frame: &Frame) -> PyResult<Option<PartMotion>> {
        let frame = frame.core();
        let (points_mm, covariance_mm2) = (frame.points_mm.as_slice(), frame.covariance_mm2.as_slice());
        let (state, patch) = (frame.state.as_slice(), frame.patch.as_slice());
        self.moved(&MovedMarkers { points_mm, covariance_mm2, state, patch })
    }

    /// Find the motion up to the next frame, from its markers.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     Sensor frame; NaN for a marker that is not seen.
    /// covariance_mm2 : (N, 3, 3) array_like
    ///     Their covariances.
    /// patch : (N,) array_like of bool
    ///     Whether the part touches the gel at the marker.
    ///
    /// Returns
    /// -------
    /// PartMotion or None
    ///     None without contact.
    ///
    /// Raises
    /// ------
    /// ContactError
    ///     If a list has another length than the rest markers.
    fn run(
        &self,
        points_mm: &Bound<'_, PyAny>,
        covariance_mm2: &Bound<'_, PyAny>,
        patch: Vec<bool>,
    ) -> PyResult<Option<PartMotion>> {
        let markers = GivenMarkers::new(points_mm, covariance_mm2, patch)?;
        self.moved(&markers.moved()?)
    }
}
