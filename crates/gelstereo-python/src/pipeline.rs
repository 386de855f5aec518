//! The sensing pipeline.

use crate::arrays::{self, Array1, Image, Matrix};
use crate::contact::RestSurface;
use crate::errors::raise;
use crate::params::Params;
use crate::rig::Rig;
use gelstereo_core::pipeline as core;
use pyo3::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What one view contributed to a frame.
#[pyclass(frozen, module = "gelstereo")]
pub struct ViewEvidence {
    inner: core::ViewEvidence,
}

#[pymethods]
impl ViewEvidence {
    #[getter]
    const fn detected(&self) -> usize {
        self.inner.detected
    }

    #[getter]
    const fn labels(&self) -> &'static str {
        match self.inner.labels {
            core::LabelSource::Rest => "rest",
            core::LabelSource::Foresight => "foresight",
            core::LabelSource::Tracks => "tracks",
        }
    }

    #[getter]
    const fn relabelled(&self) -> usize {
        self.inner.relabelled
    }

    fn __repr__(&self) -> String {
        format!(
            "ViewEvidence(detected={}, labels=\"{}\", relabelled={})",
            self.inner.detected,
            self.labels(),
            self.inner.relabelled
        )
    }
}

/// Everything that one stereo frame gave.
#[pyclass(frozen, get_all, module = "gelstereo")]
pub struct Frame {
    index: u64,
    left_px: Matrix,
    right_px: Matrix,
    points_mm: Matrix,
    indentation_mm: Array1<f64>,
    state: Array1<u8>,
    salient: Array1<bool>,
    salient_points_mm: Matrix,
    /// Markers whose two views disagreed.
    mismatched: usize,
    motion_px: f64,
    digest: u64,
    left: Py<ViewEvidence>,
    right: Py<ViewEvidence>,
}

impl Frame {
    fn new(py: Python<'_>, frame: core::Frame) -> PyResult<Self> {
        let digest = frame.digest();
        let mut salient_points = Vec::new();
        frame.salient_points_mm(&mut salient_points);
        Ok(Self {
            index: frame.index,
            left_px: arrays::rows::<_, 2>(py, frame.left_px)?,
            right_px: arrays::rows::<_, 2>(py, frame.right_px)?,
            points_mm: arrays::rows::<_, 3>(py, frame.points_mm)?,
            indentation_mm: arrays::list(py, frame.indentation_mm),
            state: arrays::list(py, frame.state.into_iter().map(|s| s as u8).collect()),
            salient: arrays::list(py, frame.salient),
            salient_points_mm: arrays::rows::<_, 3>(py, salient_points)?,
            mismatched: frame.mismatched,
            motion_px: frame.motion_px,
            digest,
            left: Py::new(py, ViewEvidence { inner: frame.left })?,
            right: Py::new(py, ViewEvidence { inner: frame.right })?,
        })
    }
}

#[pymethods]
impl Frame {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let markers = self.state.bind(py).len()?;
        let salient = self.salient_points_mm.bind(py).len()?;
        Ok(format!(
            "<Frame {}: {markers} markers, {salient} salient, motion {:.2} px>",
            self.index, self.motion_px
        ))
    }
}

/// Sensing: stereo frames in, tactile point clouds out.
#[pyclass(frozen, module = "gelstereo")]
pub struct Pipeline {
    stages: Mutex<core::Pipeline>,
    rig: Py<Rig>,
    params: Py<Params>,
}

impl Pipeline {
    fn lock(&self) -> MutexGuard<'_, core::Pipeline> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Pipeline {
    #[new]
    #[pyo3(signature = (rig, params=None))]
    fn new(py: Python<'_>, rig: Py<Rig>, params: Option<&Bound<'_, Params>>) -> PyResult<Self> {
        let params = Params::or_default(params);
        let stages = core::Pipeline::new(&rig.get().inner, &params).map_err(raise)?;
        Ok(Self { stages: Mutex::new(stages), rig, params: Py::new(py, Params { inner: params })? })
    }

    #[getter]
    fn rig(&self, py: Python<'_>) -> Py<Rig> {
        self.rig.clone_ref(py)
    }

    #[getter]
    fn params(&self, py: Python<'_>) -> Py<Params> {
        self.params.clone_ref(py)
    }

    #[getter]
    fn rest(&self, py: Python<'_>) -> Option<RestSurface> {
        py.detach(|| self.lock().rest().cloned()).map(RestSurface::from_core)
    }

    fn reset(&self, py: Python<'_>) {
        py.detach(|| self.lock().reset());
    }

    fn mark_reference(&self, py: Python<'_>) {
        py.detach(|| self.lock().mark_reference());
    }

    fn process(&self, py: Python<'_>, left: &Bound<'_, PyAny>, right: &Bound<'_, PyAny>) -> PyResult<Frame> {
        let (left, right) = (Image::new(left, "left")?, Image::new(right, "right")?);
        let (left, right) = (left.view()?, right.view()?);
        // The frame is made anew because its lists become the arrays that Python keeps.
        let frame = py.detach(|| {
            let mut out = core::Frame::default();
            self.lock().process(left, right, &mut out).map(|()| out)
        });
        Frame::new(py, frame.map_err(raise)?)
    }
}
