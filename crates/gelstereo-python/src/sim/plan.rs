//! Selection of the effects that a scene needs.

use super::Scene;
use gelstereo_sim as sim;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use std::path::PathBuf;

/// Which effects of a scene are computed, with reasons; its text is a table of them.
///
/// Every effect has an upper bound on the change that it causes. Effects on auto are switched off in
/// order of increasing bound, as long as the sum of their bounds stays within the tolerance of the
/// requested result. The simulator then equals that of a scene without these effects.
#[pyclass(frozen, module = "gelstereo")]
pub struct Plan {
    inner: sim::Plan,
    /// Every effect of the scene, as a tuple of `PlannedEffect` s.
    #[pyo3(get)]
    effects: Py<PyTuple>,
    /// The simulated scene, without the effects that are off.
    #[pyo3(get)]
    scene: Py<Scene>,
}

impl Plan {
    /// Plan of a simulator whose scene's mesh is in this folder.
    pub(super) fn new(py: Python<'_>, plan: sim::Plan, folder: PathBuf) -> PyResult<Self> {
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
}

#[pymethods]
impl Plan {
    /// Upper bound of the total change by the effects that are off on auto, in the unit of the requested
    /// result.
    #[getter]
    fn left_out(&self) -> f64 {
        self.inner.left_out()
    }

    /// Estimated time of the effects that are on, nanoseconds per stereo frame.
    #[getter]
    fn cost_ns(&self) -> f64 {
        self.inner.cost_ns()
    }

    fn __repr__(&self) -> String {
        let (on, all) =
            (self.inner.entries.iter().filter(|entry| entry.on).count(), self.inner.entries.len());
        format!("<Plan: {on} of {all} effects on, {:.0} us a frame>", 1e-3 * self.inner.cost_ns())
    }

    fn __str__(&self) -> String {
        self.inner.to_string()
    }
}

/// One effect of a `Plan`.
#[pyclass(frozen, get_all, module = "gelstereo")]
pub struct PlannedEffect {
    /// Name in a scene; "refraction", "lens_distortion" and "ellipse_bias" belong to the rig.
    name: &'static str,
    /// Whether it is computed.
    on: bool,
    /// Upper bound of the change in a dot's position in an image.
    bound_px: f64,
    /// Upper bound of the change in a marker's position in space.
    bound_um: f64,
    /// Upper bound of the change in a pixel before rounding, grey levels.
    bound_levels: f64,
    /// Estimated time per stereo frame while it is on, nanoseconds.
    cost_ns: f64,
    /// Reason why it is on or off.
    why: String,
}

#[pymethods]
impl PlannedEffect {
    fn __repr__(&self) -> String {
        let Self { name, on, bound_px, bound_um, cost_ns, .. } = self;
        let on = if *on { "on" } else { "off" };
        format!(
            "<PlannedEffect {name}: {on}, up to {bound_px:.3} px and {bound_um:.2} um, {cost_ns:.0} ns a \
            frame>"
        )
    }
}
