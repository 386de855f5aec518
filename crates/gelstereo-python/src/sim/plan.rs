//! Which effects a scene needs.

use super::Scene;
use gelstereo_sim as sim;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use std::path::PathBuf;

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

impl Plan {
    /// Of the simulator of a scene whose mesh lies in that folder.
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

#[pymethods]
impl PlannedEffect {
    fn __repr__(&self) -> String {
        let Self { name, on, bound_px, bound_um, cost_ns, .. } = self;
        let on = if *on { "on" } else { "off" };
        format!(
            "<PlannedEffect {name}: {on}, up to {bound_px:.3} px and {bound_um:.2} um, {cost_ns:.0} ns a frame>"
        )
    }
}
