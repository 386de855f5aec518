//! Cameras.

use crate::arrays;
use crate::camera_info::{CameraControl, CameraInfo};
use crate::errors::{CameraError, ImageError, raise};
use crate::tree;
use gelstereo_host::camera as host;
use gelstereo_host::source::{
    self, CameraSource, FrameSource, Gray, Next, SourceError, SourceEvent, StereoPair,
};
use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::sync::MutexExt;
use pyo3::types::{PyBytes, PyDict, PyMapping};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

type GrayArray = Py<PyArray2<u8>>;

/// Interval at which a waiting call checks for Ctrl-C and releases the camera to other threads.
const SLICE: Duration = Duration::from_millis(50);

/// A stereo pair of a camera, or a notice that there is no new one.
#[pyclass(frozen, module = "gelstereo.cameras")]
pub struct CameraFrame {
    left: GrayArray,
    right: GrayArray,
    capture: source::Capture,
    /// Whether the images are those of an earlier frame, because no newer ones arrived. They are black
    /// before the first pair.
    #[pyo3(get)]
    stale: bool,
    event: Option<SourceEvent>,
    encoded: Arc<source::Encoded>,
}

#[pymethods]
impl CameraFrame {
    /// (H, W) uint8 left image, read-only.
    #[getter]
    fn left(&self, py: Python<'_>) -> GrayArray {
        self.left.clone_ref(py)
    }

    /// (H, W) uint8 right image, read-only.
    #[getter]
    fn right(&self, py: Python<'_>) -> GrayArray {
        self.right.clone_ref(py)
    }

    /// Frame number of the driver; with two devices, that of the left one.
    #[getter]
    fn sequence(&self) -> u64 {
        self.capture.sequence
    }

    /// Time when the driver had the later of both images, nanoseconds of ``time.monotonic_ns()``; None
    /// before the first pair.
    #[getter]
    fn driver_ns(&self) -> Option<u64> {
        self.capture.driver_ns
    }

    /// Time when both images were decoded, nanoseconds of ``time.monotonic_ns()``; None before the first
    /// pair.
    #[getter]
    fn received_ns(&self) -> Option<u64> {
        self.capture.received_ns
    }

    /// Pairs lost or skipped since the previous pair.
    #[getter]
    fn dropped(&self) -> u64 {
        self.capture.dropped
    }

    /// Time of the right image minus that of the left one, nanoseconds; 0 for one stereo device.
    #[getter]
    fn skew_ns(&self) -> i64 {
        self.capture.skew_ns
    }

    /// Event in place of a new pair: a dictionary with ``"event"`` (``"connected"``, ``"disconnected"``,
    /// ``"stalled"``, ``"corrupt"``, ``"sequence"``, ``"timestamp"``, ``"skewed"``), details and
    /// ``"text"``. None for a pair, and when nothing happened.
    #[getter]
    fn event<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let Some(event) = &self.event else { return Ok(None) };
        let dict = tree::to_dict(py, event)?;
        dict.set_item("text", event.to_string())?;
        Ok(Some(dict))
    }

    /// The JPEG files of the images as sent by the camera: one with both views, or the left and the right
    /// one. Empty if the camera sends plain pixels or ``keep_encoded`` is off.
    #[getter]
    fn encoded<'py>(&self, py: Python<'py>) -> Vec<Bound<'py, PyBytes>> {
        match &*self.encoded {
            source::Encoded::None => Vec::new(),
            source::Encoded::Joint { jpeg, .. } => vec![PyBytes::new(py, jpeg)],
            source::Encoded::Separate { left_jpeg, right_jpeg } => {
                vec![PyBytes::new(py, left_jpeg), PyBytes::new(py, right_jpeg)]
            }
        }
    }

    fn __repr__(&self) -> String {
        match (&self.event, self.stale) {
            (Some(event), _) => format!("CameraFrame(event: {event})"),
            (None, true) => "CameraFrame(stale)".to_owned(),
            (None, false) => {
                let source::Capture { sequence, dropped, .. } = self.capture;
                format!("CameraFrame(sequence={sequence}, dropped={dropped})")
            }
        }
    }
}

/// The last pair's images and capture data, returned in stale frames.
struct Last {
    left: GrayArray,
    right: GrayArray,
    encoded: Arc<source::Encoded>,
    capture: source::Capture,
}

/// A streaming stereo camera, created by `gelstereo.cameras.open`.
///
/// Iteration yields a `CameraFrame` for each pair, each event, and each timeout of ``timeout_s``, so the
/// loop never hangs. A device that is unplugged, reset or silent is reopened automatically. As a context
/// manager it is closed at the end.
#[pyclass(frozen, module = "gelstereo.cameras")]
pub struct Camera {
    source: Mutex<Option<CameraSource>>,
    last: Mutex<Last>,
    timeout: Duration,
    devices: Vec<host::CameraInfo>,
}

impl Camera {
    /// Runs an operation on the camera with the interpreter's lock released.
    fn with<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut CameraSource) -> T + Send) -> PyResult<T> {
        let done = py.detach(|| lock(&self.source).as_mut().map(work));
        done.ok_or_else(|| {
            CameraError::new_err("the camera is closed; open it again with gelstereo.cameras.open()")
        })
    }

    /// The next pair or event, or `None` after the timeout.
    fn wait(&self, py: Python<'_>, timeout: Duration, pair: &mut StereoPair) -> PyResult<Option<Next>> {
        let begun = Instant::now();
        loop {
            let left = timeout.saturating_sub(begun.elapsed());
            match self.with(py, |source| source.next_pair(left.min(SLICE), pair))? {
                Ok(next) => return Ok(Some(next)),
                Err(SourceError::Timeout { .. }) if left > SLICE => py.check_signals()?,
                Err(SourceError::Timeout { .. }) => return Ok(None),
                Err(error) => return Err(CameraError::new_err(error.to_string())),
            }
        }
    }

    fn frame(&self, py: Python<'_>, timeout: Duration) -> PyResult<CameraFrame> {
        let mut pair = StereoPair::default();
        let next = self.wait(py, timeout, &mut pair)?;
        py.check_signals()?;
        let new = match next {
            Some(Next::Pair) => Some(Last {
                left: array(py, pair.left)?,
                right: array(py, pair.right)?,
                encoded: Arc::new(pair.encoded),
                capture: pair.capture,
            }),
            _ => None,
        };
        let event = match next {
            Some(Next::Event(event)) => Some(event),
            _ => None,
        };
        let stale = new.is_none();
        let mut last = self.last.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner);
        if let Some(new) = new {
            *last = new;
        }
        Ok(CameraFrame {
            left: last.left.clone_ref(py),
            right: last.right.clone_ref(py),
            encoded: Arc::clone(&last.encoded),
            capture: last.capture,
            stale,
            event,
        })
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An image array that takes over the pixels' memory.
fn array(py: Python<'_>, image: Gray) -> PyResult<GrayArray> {
    arrays::shaped(py, image.pixels, (image.height, image.width))
}

fn seconds(name: &str, timeout_s: f64) -> PyResult<Duration> {
    match Duration::try_from_secs_f64(timeout_s) {
        Ok(timeout) if timeout_s <= 3600.0 => Ok(timeout),
        _ => Err(CameraError::new_err(format!("{name} is {timeout_s}; valid is 0 to 3600 s"))),
    }
}

fn settings<T: serde::Serialize + serde::de::DeserializeOwned>(
    mapping: &Bound<'_, PyMapping>,
) -> PyResult<T> {
    tree::from_mapping(mapping).map_err(CameraError::new_err)
}

#[pymethods]
impl Camera {
    #[new]
    fn new(py: Python<'_>, settings: &Bound<'_, PyMapping>, timeout_s: f64) -> PyResult<Self> {
        let config: host::CameraConfig = self::settings(settings)?;
        let timeout = seconds("timeout_s", timeout_s)?;
        let source = py.detach(|| CameraSource::open(&config)).map_err(raise)?;
        let (width, height) = config.view_size_px();
        let black = || array(py, Gray { width, height, pixels: vec![0; width * height] });
        let (encoded, capture) = (Arc::default(), source::Capture::default());
        let last = Last { left: black()?, right: black()?, encoded, capture };
        let devices = source.devices().into_iter().cloned().collect();
        Ok(Self { source: Mutex::new(Some(source)), last: Mutex::new(last), timeout, devices })
    }

    /// The devices as found when they were opened: the stereo device, or the left and the right one.
    #[getter]
    fn devices(&self) -> Vec<CameraInfo> {
        self.devices.iter().map(CameraInfo::new).collect()
    }

    /// Whether the camera was closed.
    #[getter]
    fn closed(&self, py: Python<'_>) -> bool {
        py.detach(|| lock(&self.source).is_none())
    }

    /// All settings including defaults, in the form of ``[source]`` of `gelstereo-host`.
    #[getter]
    fn settings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let config = self.with(py, |source| source.config().clone())?;
        tree::to_dict(py, &config)
    }

    /// Wait for the next pair or event.
    ///
    /// Parameters
    /// ----------
    /// timeout_s : float, optional
    ///     Longest time to wait. Default: that of `open`.
    ///
    /// Returns
    /// -------
    /// CameraFrame
    ///     Stale after a timeout, and for an event in place of a new pair.
    ///
    /// Raises
    /// ------
    /// CameraError
    ///     If the camera is closed.
    #[pyo3(signature = (timeout_s=None))]
    fn read(&self, py: Python<'_>, timeout_s: Option<f64>) -> PyResult<CameraFrame> {
        let timeout = timeout_s.map_or(Ok(self.timeout), |timeout_s| seconds("timeout_s", timeout_s))?;
        self.frame(py, timeout)
    }

    /// Counts since the camera was opened: ``pairs``, ``dropped``, ``corrupt``, ``skewed``,
    /// ``sequence_faults``, ``timestamp_faults``, ``stalls``, ``disconnects``, ``connects``,
    /// ``lost_events``. Over the last 1024 pairs: ``rate_hz``, ``camera_rate_hz`` (lost pairs included)
    /// and the time from the driver's timestamp to the decoded pair, ``latency_p50_ms``,
    /// ``latency_p99_ms``, ``latency_max_ms``. Values not yet known are left out.
    #[getter]
    fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let statistics = self.with(py, |source| source.statistics())?;
        tree::to_dict(py, &statistics)
    }

    /// Controls of the stereo device, or of the left device, with their values.
    ///
    /// Raises
    /// ------
    /// CameraError
    ///     If the camera is closed or disconnected, or its driver does not answer.
    #[getter]
    fn controls(&self, py: Python<'_>) -> PyResult<Vec<CameraControl>> {
        let controls = self.with(py, |source| source.controls(host::Side::Left))?.map_err(raise)?;
        Ok(controls.into_iter().map(CameraControl::new).collect())
    }

    /// Set controls of all devices of the camera, now and whenever they are reopened.
    ///
    /// Parameters
    /// ----------
    /// **controls
    ///     ``exposure_us`` (a multiple of 100 µs; turns automatic exposure off), ``auto_exposure``, ``gain``,
    ///     ``white_balance_k`` (turns automatic white balance off), ``auto_white_balance``, or any other
    ///     control by its name in `controls`.
    ///
    /// Raises
    /// ------
    /// CameraError
    ///     If there is no such control, or it cannot have this value; the message states what is valid.
    #[pyo3(signature = (**controls))]
    fn set(&self, py: Python<'_>, controls: Option<&Bound<'_, PyDict>>) -> PyResult<()> {
        let Some(controls) = controls else { return Ok(()) };
        let (known, other) = (PyDict::new(py), PyDict::new(py));
        for (name, value) in controls {
            let named: String = name.extract()?;
            let place = if host::ControlSettings::NAMES.contains(&named.as_str()) { &known } else { &other };
            place.set_item(name, value)?;
        }
        known.set_item("other", other)?;
        let settings: host::ControlSettings = self::settings(known.as_mapping())?;
        self.with(py, |source| source.set_controls(&settings))?.map_err(raise)
    }

    /// Close the devices. The camera cannot be used afterwards; closing it again has no effect.
    fn close(&self, py: Python<'_>) {
        py.detach(|| drop(lock(&self.source).take()));
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: &Bound<'_, pyo3::types::PyTuple>) {
        self.close(py);
    }

    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<CameraFrame>> {
        if self.closed(py) { Ok(None) } else { self.frame(py, self.timeout).map(Some) }
    }

    fn __repr__(&self) -> String {
        let devices: Vec<_> = self.devices.iter().map(ToString::to_string).collect();
        format!("Camera({})", devices.join(" and "))
    }
}

/// The video nodes of this computer, ordered by number; see `gelstereo.cameras.list`.
#[pyfunction]
pub fn list_cameras(py: Python<'_>) -> PyResult<Vec<CameraInfo>> {
    let cameras = py.detach(host::list).map_err(raise)?;
    Ok(cameras.iter().map(CameraInfo::new).collect())
}

/// Decode both views of a frame in a driver's format; see `gelstereo.cameras.decode`.
#[pyfunction]
#[pyo3(signature = (data, format, size_px, layout, stride))]
pub fn decode_camera_frame(
    py: Python<'_>,
    data: &[u8],
    format: &Bound<'_, PyAny>,
    size_px: (arrays::Count, arrays::Count),
    layout: &Bound<'_, PyAny>,
    stride: Option<arrays::Count>,
) -> PyResult<(GrayArray, GrayArray)> {
    let choice = PyDict::new(py);
    choice.set_item("format", format)?;
    choice.set_item("layout", layout)?;
    let host::CameraConfig { format, layout, .. } = settings(choice.as_mapping())?;
    let (width, height) = (size_px.0.0, size_px.1.0);
    if let Some(conflict) = format.conflict(layout, width) {
        return Err(CameraError::new_err(conflict));
    }
    let stride = stride.map_or(format.row_bytes(width).unwrap_or(0), |stride| stride.0);
    let shape = host::FrameShape { format, width, height, stride };
    let (mut left, mut right) = (Gray::default(), Gray::default());
    py.detach(|| host::FrameDecoder::default().stereo(data, shape, layout, &mut left, &mut right))
        .map_err(|fault| ImageError::new_err(fault.to_string()))?;
    Ok((array(py, left)?, array(py, right)?))
}
