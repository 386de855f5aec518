//! Results of one stereo frame.

use crate::arrays::{self, Array1, Matrix};
use crate::force::Wrench;
use crate::notebook;
use crate::pickle;
use crate::slip::Slip;
use gelstereo_core::params::Centre;
use gelstereo_core::pipeline as core;
use numpy::PyArray3;
use pyo3::prelude::*;
use pyo3::types::PyType;

/// Contribution of one view to a frame.
#[pyclass(frozen, module = "gelstereo")]
pub struct ViewEvidence {
    inner: core::ViewEvidence,
}

#[pymethods]
impl ViewEvidence {
    /// Number of markers detected.
    #[getter]
    const fn detected(&self) -> usize {
        self.inner.detected
    }

    /// Source of rows and columns: ``"rest"``, ``"foresight"`` (the sort of this frame), ``"tracks"``
    /// (the sort of ``label.method = "foresight"`` failed for this frame), ``"lattice"`` (verified
    /// tracks) or ``"held"`` (no labels were certain).
    #[getter]
    const fn labels(&self) -> &'static str {
        match self.inner.labels {
            core::LabelSource::Rest => "rest",
            core::LabelSource::Foresight => "foresight",
            core::LabelSource::Tracks => "tracks",
            core::LabelSource::Lattice => "lattice",
            core::LabelSource::Held => "held",
        }
    }

    /// Markers whose label by the sort differs from the label by their track.
    #[getter]
    const fn relabelled(&self) -> usize {
        self.inner.relabelled
    }

    /// Search area for markers: ``"whole"`` (the whole image) or ``"windows"`` (around predicted positions).
    #[getter]
    const fn searched(&self) -> &'static str {
        match self.inner.searched {
            core::Searched::Whole => "whole",
            core::Searched::Windows => "windows",
        }
    }

    /// Method of the centres: ``"binary"``, ``"grey"``, ``"soft_threshold"`` or ``"fit"``.
    #[getter]
    const fn centre(&self) -> &'static str {
        match self.inner.centre {
            Centre::Binary => "binary",
            Centre::Grey => "grey",
            Centre::SoftThreshold => "soft_threshold",
            Centre::Fit => "fit",
        }
    }

    /// Whether that method is cheaper than ``detect.centre``, because the frame had a limit.
    #[getter]
    const fn is_degraded(&self) -> bool {
        self.inner.is_degraded
    }

    fn __repr__(&self) -> String {
        format!(
            "ViewEvidence(detected={}, labels=\"{}\", relabelled={}, searched=\"{}\")",
            self.inner.detected,
            self.labels(),
            self.inner.relabelled,
            self.searched()
        )
    }
}

/// All results of one stereo frame; marker ``row * cols + col`` has that index in every array.
#[pyclass(frozen, module = "gelstereo")]
pub struct Frame {
    /// Frames since the last reset, from 0 (the rest frame).
    #[pyo3(get)]
    index: u64,
    /// Number of markers from top to bottom, as found in the rest frame.
    #[pyo3(get)]
    rows: usize,
    /// Number of markers from left to right, as found in the rest frame.
    #[pyo3(get)]
    cols: usize,
    /// (N, 2) positions in the left image.
    #[pyo3(get)]
    left_px: Matrix,
    /// (N, 2) positions in the right image.
    #[pyo3(get)]
    right_px: Matrix,
    /// (N, 3) positions in the sensor frame; for a marker that is not seen, its last good position.
    #[pyo3(get)]
    points_mm: Matrix,
    /// (N, 3, 3) covariances of the points, mm²; for a marker that is not seen, those of its last good
    /// position.
    #[pyo3(get)]
    covariance_mm2: Py<PyArray3<f64>>,
    /// (N,) height above the rest surface, towards the camera.
    #[pyo3(get)]
    indentation_mm: Array1<f64>,
    /// (N,) uint8 values of `MarkerState`.
    #[pyo3(get)]
    state: Array1<u8>,
    /// (N,) bool, whether the marker is in contact (Eq. 4).
    #[pyo3(get)]
    salient: Array1<bool>,
    /// (N,) bool, whether the marker is in the contact patch, the input of `localize`.
    #[pyo3(get)]
    patch: Array1<bool>,
    /// (M, 3) the points of the contact patch, in the order of the markers.
    #[pyo3(get)]
    patch_points_mm: Matrix,
    /// (N, 3) tractions that the part exerts on the gel around each marker, along the sensor's axes; (0, 3)
    /// without ``force.method``.
    #[pyo3(get)]
    traction_kpa: Matrix,
    /// Their force and torque, a `Wrench`; `None` without contact, or without ``force.method``.
    #[pyo3(get)]
    wrench: Option<Py<Wrench>>,
    /// (N,) uint8 values of `Stick`: whether the gel around each marker moves with the part; (0,) without
    /// ``slip.method``.
    #[pyo3(get)]
    stick: Array1<u8>,
    /// Slip of the contact, a `Slip`; `None` without contact, or without ``slip.method``.
    #[pyo3(get)]
    slip: Option<Py<Slip>>,
    /// Markers whose two views do not match, judged by rows, disparity, or depth relative to their
    /// neighbours.
    #[pyo3(get)]
    mismatched: usize,
    /// Mean motion of the seen markers of the left view since the reference.
    #[pyo3(get)]
    motion_px: f64,
    /// Standard deviation of an error along the gel's normal that all points share:
    /// ``lattice.depth_sigma_mm``. `covariance_mm2` leaves it out, and the covariance of a pose includes it.
    #[pyo3(get)]
    offset_sigma_mm: f64,
    /// Digest of all results, bit for bit.
    #[pyo3(get)]
    digest: u64,
    /// Predicted work, in units of 1000 instructions of a baseline x86-64 processor.
    #[pyo3(get)]
    work: u64,
    /// Limit to which the work was fitted; `None` without a deadline.
    #[pyo3(get)]
    work_limit: Option<u64>,
    /// The left view's `ViewEvidence`.
    #[pyo3(get)]
    left: Py<ViewEvidence>,
    /// The right view's `ViewEvidence`.
    #[pyo3(get)]
    right: Py<ViewEvidence>,
    /// The core's frame, for pickling.
    core: core::Frame,
}

impl Frame {
    pub const fn core(&self) -> &core::Frame {
        &self.core
    }

    pub fn new(py: Python<'_>, frame: core::Frame) -> PyResult<Self> {
        let digest = frame.digest();
        let mut patch_points = Vec::new();
        frame.patch_points_mm(&mut patch_points);
        let core = frame.clone();
        Ok(Self {
            core,
            index: frame.index,
            rows: frame.rows,
            cols: frame.cols,
            left_px: arrays::rows::<_, 2>(py, frame.left_px)?,
            right_px: arrays::rows::<_, 2>(py, frame.right_px)?,
            covariance_mm2: arrays::shaped(
                py,
                frame.covariance_mm2.iter().flatten().flatten().copied().collect(),
                (frame.points_mm.len(), 3, 3),
            )?,
            points_mm: arrays::rows::<_, 3>(py, frame.points_mm)?,
            indentation_mm: arrays::list(py, frame.indentation_mm),
            state: arrays::list(py, frame.state.into_iter().map(|s| s as u8).collect()),
            salient: arrays::list(py, frame.salient),
            patch: arrays::list(py, frame.patch),
            patch_points_mm: arrays::rows::<_, 3>(py, patch_points)?,
            traction_kpa: arrays::rows::<_, 3>(py, frame.traction_kpa)?,
            wrench: frame.wrench.map(|wrench| Py::new(py, Wrench::from_core(wrench))).transpose()?,
            stick: arrays::list(py, frame.stick.into_iter().map(|s| s as u8).collect()),
            slip: frame.slip.map(|slip| Py::new(py, Slip::from_core(slip))).transpose()?,
            mismatched: frame.mismatched,
            motion_px: frame.motion_px,
            offset_sigma_mm: frame.offset_sigma_mm,
            work: frame.work,
            work_limit: frame.work_limit,
            digest,
            left: Py::new(py, ViewEvidence { inner: frame.left })?,
            right: Py::new(py, ViewEvidence { inner: frame.right })?,
        })
    }
}

#[pymethods]
impl Frame {
    /// HTML for notebooks.
    fn _repr_html_(slf: &Bound<'_, Self>) -> PyResult<String> {
        notebook::html(slf.as_any(), "frame_html")
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let markers = self.state.bind(py).len()?;
        let patch = self.patch_points_mm.bind(py).len()?;
        Ok(format!(
            "<Frame {}: {markers} markers, {patch} in contact, motion {:.2} px>",
            self.index, self.motion_px
        ))
    }

    #[classmethod]
    fn _from_bytes(cls: &Bound<'_, PyType>, data: &[u8]) -> PyResult<Self> {
        Self::new(cls.py(), pickle::from_bytes(data, "Frame")?)
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<pickle::Reduced<'py>> {
        pickle::reduce(slf, "_from_bytes", &pickle::to_bytes(&slf.get().core)?)
    }
}
