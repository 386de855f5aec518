//! The sensing pipeline.

use crate::arrays::{self, Image};
use crate::compliance::Compliance;
use crate::contact::{RestSurface, RuleName, rule_name};
use crate::detect::fixed_channel;
use crate::errors::{PitchWarning, raise};
use crate::frame::Frame;
use crate::params::Params;
use crate::pitch_check::PitchCheck;
use crate::rest_record::RestRecord;
use crate::rig::Rig;
use gelstereo_core::params::Channel;
use gelstereo_core::pipeline as core;
use gelstereo_core::track::MarkerState;
use numpy::PyArray3;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Covariances of centres as an array.
fn of_centres(py: Python<'_>, covariance_px2: &[[[f64; 2]; 2]]) -> PyResult<Py<PyArray3<f64>>> {
    let entries = covariance_px2.iter().flatten().flatten().copied().collect();
    arrays::shaped(py, entries, (covariance_px2.len(), 2, 2))
}

/// Sensing pipeline: stereo frames in, tactile point clouds out. The first frame is the rest frame.
///
/// Calls from several threads are serialised; the interpreter's lock is released while a frame is processed.
///
/// Parameters
/// ----------
/// rig : Rig
/// params : Params, optional
/// compliance : Compliance, optional
///     Of the gel, for `force.method` ``"ridge"`` or ``"bounded"``. The rest frame raises a `ContactError`
///     if it is of another lattice or gel.
///
/// Raises
/// ------
/// ParamsError, RigError
///     If rig or settings are not valid.
#[pyclass(frozen, module = "gelstereo")]
pub struct Pipeline {
    /// Boxed because its SIMD columns are aligned to 32 bytes, and Python aligns its objects to 16.
    stages: Box<Mutex<core::Pipeline>>,
    /// This computer's, of frames with deadlines.
    pace: Mutex<core::Pace>,
    /// Channel of colour images; absent until a frame determines it.
    channel: Mutex<Option<Channel>>,
    rig: Py<Rig>,
    params: Py<Params>,
}

impl Pipeline {
    /// Warns if the rest frame's pitch is off.
    fn warn_of_pitch(&self, py: Python<'_>) -> PyResult<()> {
        let Some(check) = py.detach(|| self.lock().pitch_check()).filter(core::PitchCheck::is_off) else {
            return Ok(());
        };
        let message = std::ffi::CString::new(check.to_string())?;
        PyErr::warn(py, &py.get_type::<PitchWarning>(), &message, 1)
    }

    fn locked_channel(&self) -> MutexGuard<'_, Option<Channel>> {
        self.channel.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn locked_pace(&self) -> MutexGuard<'_, core::Pace> {
        self.pace.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Work that fits until the deadline. Without a known pace there is no limit yet, but the cheaper rungs
    /// are prepared.
    fn limit(&self, begun: Instant, deadline_ms: f64) -> u64 {
        let left_ns = deadline_ms * 1e6 - begun.elapsed().as_nanos() as f64;
        self.locked_pace().limit(left_ns as u64).unwrap_or(u64::MAX)
    }

    fn lock(&self) -> MutexGuard<'_, core::Pipeline> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Pipeline {
    #[new]
    #[pyo3(signature = (rig, params=None, *, compliance=None))]
    fn new(
        py: Python<'_>,
        rig: Py<Rig>,
        params: Option<&Bound<'_, Params>>,
        compliance: Option<&Compliance>,
    ) -> PyResult<Self> {
        let params = Params::or_default(params);
        let stages = core::Pipeline::new(&rig.get().inner, &params).map_err(raise)?;
        let stages = stages.with_compliance(compliance.map(|compliance| compliance.core().clone()));
        let stages = stages.map_err(raise)?;
        let channel = fixed_channel(&params.detect);
        Ok(Self {
            stages: Box::new(Mutex::new(stages)),
            pace: Mutex::new(core::Pace::default()),
            channel: Mutex::new(channel),
            rig,
            params: Py::new(py, Params { inner: params })?,
        })
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let (left, at_rest) = (&self.rig.get().inner.left, py.detach(|| self.lock().rest().is_some()));
        let (width_px, height_px) = (left.width_px, left.height_px);
        let next = if at_rest { "at work" } else { "the next frame is the rest frame" };
        format!("<Pipeline: images of {width_px} x {height_px} px, {next}>")
    }

    /// Covariances of the last frame's `left_px` and `right_px` about the images of the dots' centres.
    ///
    /// They include what an image alone cannot show: noise measured from both views, and gel that folds
    /// within the dot. Folds move a dot in both images alike: to combine the views, use
    /// `Frame.covariance_mm2`.
    ///
    /// Parameters
    /// ----------
    /// frame : Frame
    ///     The last frame of this pipeline.
    ///
    /// Returns
    /// -------
    /// left_px2, right_px2 : (N, 2, 2) float64
    ///     Empty for another frame than the last one.
    fn centre_covariances_px2(&self, py: Python<'_>, frame: &Frame) -> PyResult<[Py<PyArray3<f64>>; 2]> {
        let (mut left, mut right) = (Vec::new(), Vec::new());
        py.detach(|| self.lock().centre_covariances_px2(frame.core(), [&mut left, &mut right]));
        Ok([of_centres(py, &left)?, of_centres(py, &right)?])
    }

    /// The rig of the pipeline.
    #[getter]
    fn rig(&self, py: Python<'_>) -> Py<Rig> {
        self.rig.clone_ref(py)
    }

    /// The settings of the pipeline.
    #[getter]
    fn params(&self, py: Python<'_>) -> Py<Params> {
        self.params.clone_ref(py)
    }

    /// The rest surface, or None before the rest frame.
    #[getter]
    fn rest(&self, py: Python<'_>) -> Option<RestSurface> {
        py.detach(|| self.lock().rest().cloned()).map(RestSurface::from_core)
    }

    /// The gel's decay length in mm and its standard deviation, estimated from the contacts since the
    /// rest frame. None while they do not determine it, or without `contact.learn_decay`.
    #[getter]
    fn decay_mm(&self, py: Python<'_>) -> Option<(f64, f64)> {
        py.detach(|| self.lock().decay()).map(|decay| (decay.decay_mm, decay.sigma_mm))
    }

    /// The rule that found the last frame's contact with `contact.saliency = "adaptive"`: ("pressure",
    /// decay length in mm) or ("share", share of the deepest indentation). None without that setting, and
    /// without contact.
    #[getter]
    fn contact_rule(&self, py: Python<'_>) -> Option<RuleName> {
        py.detach(|| self.lock().contact_rule()).map(rule_name)
    }

    /// Factor on the variances of the centres: how much noisier they are than stated, estimated from the
    /// epipolar residuals of the rest frame. 1 before the rest frame, and where the difference is not
    /// significant.
    #[getter]
    fn noise_scale(&self, py: Python<'_>) -> f64 {
        py.detach(|| self.lock().noise_scale())
    }

    /// The print's pitch at rest beside ``lattice.pitch_mm``, as a `PitchCheck`; None before the rest frame.
    #[getter]
    fn pitch_check(&self, py: Python<'_>) -> Option<PitchCheck> {
        py.detach(|| self.lock().pitch_check()).map(|inner| PitchCheck { inner })
    }

    /// (above, right, below, left) rows or columns beyond the labelled ones that a view shows at rest: those
    /// that are not whole in both views, and those beyond ``lattice.rows`` and ``lattice.cols``.
    #[getter]
    fn left_out(&self, py: Python<'_>) -> (usize, usize, usize, usize) {
        py.detach(|| self.lock().left_out()).into()
    }

    /// Channel of the images in which markers are searched: ``"grey"``, ``"red"``, ``"green"`` or ``"blue"``.
    /// With ``detect.channel = "auto"``, the left image of the first frame determines it until `reset`; None
    /// before.
    #[getter]
    fn channel(&self) -> Option<&'static str> {
        self.locked_channel().map(arrays::channel_name)
    }

    /// Clear tracks, rest surface and reference: the next frame is the rest frame.
    fn reset(&self, py: Python<'_>) {
        *self.locked_channel() = fixed_channel(&self.params.get().inner.detect);
        py.detach(|| self.lock().reset());
    }

    /// State from which `resume` can start without a rest frame, or None before the rest frame.
    fn rest_record(&self, py: Python<'_>) -> Option<RestRecord> {
        py.detach(|| self.lock().rest_record()).map(|inner| RestRecord { inner })
    }

    /// Start from a recorded rest frame: the next frame is number 1 and may show contact.
    ///
    /// Until rows and columns are certain, all markers are held, and ``frame.left.labels`` or
    /// ``frame.right.labels`` is ``"held"``.
    ///
    /// Parameters
    /// ----------
    /// record : RestRecord
    ///     Record of a pipeline with the same rig and the same settings of lattice, detection (except
    ///     ``detect.search``) and triangulation.
    ///
    /// Raises
    /// ------
    /// ContactError
    ///     If rig or settings differ; the message names the difference. The pipeline is then unchanged.
    fn resume(&self, py: Python<'_>, record: &Bound<'_, RestRecord>) -> PyResult<()> {
        let record = &record.get().inner;
        py.detach(|| self.lock().resume(record)).map_err(raise)
    }

    /// Make the present frame the reference of motion (before grasping, before insertion).
    fn mark_reference(&self, py: Python<'_>) {
        py.detach(|| self.lock().mark_reference());
    }

    /// Run all sensing stages on one stereo frame.
    ///
    /// Parameters
    /// ----------
    /// left, right : (H, W) or (H, W, 3) uint8
    ///     Images of the rig's size, grey, or blue, green and red as OpenCV reads them, of which
    ///     ``detect.channel`` is searched. Borrowed when contiguous, copied otherwise.
    /// threads : 1 or 2
    ///     With 2, the markers of the right view are detected on a second thread; the result is
    ///     bit-identical.
    /// deadline_ms : float, optional
    ///     Time for this call. The best methods whose predicted work fits are used: ``frame.left`` and
    ///     ``frame.right`` state them, and the covariances are theirs. The time that a unit of work takes is
    ///     learned from frame to frame, so that about one in a thousand is late. Give it from the rest frame
    ///     on, which itself is not limited. Default: none.
    /// work_limit : int, optional
    ///     The same in units of work, instead of `deadline_ms`. With the ``frame.work_limit`` of earlier
    ///     frames, the same images give the same bits on any computer.
    ///
    /// Returns
    /// -------
    /// Frame
    ///
    /// Raises
    /// ------
    /// ImageError, DetectError, LabelError, TriangulateError, ContactError
    ///     If a stage fails; the message names stage and view. The tracks are then unchanged.
    /// ValueError
    ///     If the number of threads is not 1 or 2, if the deadline is not a positive time, or if both limits
    ///     are given.
    ///
    /// Warns
    /// -----
    /// PitchWarning
    ///     At a rest frame whose `pitch_check` is off.
    #[pyo3(signature = (left, right, *, threads=1, deadline_ms=None, work_limit=None))]
    fn process(
        &self,
        py: Python<'_>,
        left: &Bound<'_, PyAny>,
        right: &Bound<'_, PyAny>,
        threads: usize,
        deadline_ms: Option<f64>,
        work_limit: Option<u64>,
    ) -> PyResult<Frame> {
        let begun = Instant::now();
        check_limits(deadline_ms, work_limit)?;
        if !(1..=2).contains(&threads) {
            return Err(PyValueError::new_err(format!(
                "threads is {threads}; valid is 1 or 2, one per view"
            )));
        }
        let (left, right) = (Image::new(left, "left")?, Image::new(right, "right")?);
        let known = *self.locked_channel();
        let channel = match known {
            Some(channel) => channel,
            None => left.best_channel(&self.params.get().inner.detect)?,
        };
        let (mut left_levels, mut right_levels) = (Vec::new(), Vec::new());
        let (left, right) = (left.view(channel, &mut left_levels)?, right.view(channel, &mut right_levels)?);
        // A new frame each time, because its lists become the arrays that Python keeps.
        let frame = py.detach(|| {
            let mut out = core::Frame::default();
            let mut stages = self.lock();
            let limit = deadline_ms.map_or(work_limit, |deadline_ms| Some(self.limit(begun, deadline_ms)));
            let done = match threads {
                1 => stages.process_within(left, right, limit, &mut out),
                _ => stages.process_with(left, right, limit, &mut out, on_two_threads),
            };
            done.map(|()| out)
        });
        let frame = frame.map_err(raise)?;
        // A rest frame that fails determines nothing.
        *self.locked_channel() = Some(channel);
        if frame.index == 0 {
            self.warn_of_pitch(py)?;
        }
        let (index, work) = (frame.index, frame.work);
        let frame = Frame::new(py, frame)?;
        if deadline_ms.is_some() && index > 0 {
            self.locked_pace().observe(work, begun.elapsed().as_nanos() as u64);
        }
        Ok(frame)
    }
}

fn check_limits(deadline_ms: Option<f64>, work_limit: Option<u64>) -> PyResult<()> {
    let why = match (deadline_ms, work_limit) {
        (Some(_), Some(_)) => "deadline_ms and work_limit are both given; give one",
        (Some(ms), _) => return check_deadline(ms),
        _ => return Ok(()),
    };
    Err(PyValueError::new_err(why))
}

pub fn check_deadline(deadline_ms: f64) -> PyResult<()> {
    if deadline_ms > 0.0 && deadline_ms.is_finite() {
        return Ok(());
    }
    let why = format!("deadline_ms is {deadline_ms}; valid is a positive time in milliseconds");
    Err(PyValueError::new_err(why))
}

/// Runs both to completion, the second on its own thread.
fn on_two_threads(left: &mut (dyn FnMut() + Send), right: &mut (dyn FnMut() + Send)) {
    std::thread::scope(|scope| {
        scope.spawn(right);
        left();
    });
}

/// Names and values of the core's marker states, repeated in `gelstereo.MarkerState` for typing.
#[pyfunction]
pub fn marker_states() -> std::collections::BTreeMap<&'static str, u8> {
    let states = [("SEEN", MarkerState::Seen), ("HELD", MarkerState::Held), ("LOST", MarkerState::Lost)];
    states.map(|(name, state)| (name, state as u8)).into()
}
