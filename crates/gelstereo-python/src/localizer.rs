//! Localization of one part over many frames.

use crate::arrays::{self, Matrix};
use crate::given::Given;
use crate::params::Params;
use crate::register::{Gel, Localization};
use crate::template::Template;
use gelstereo_core::params::RegisterMethod;
use gelstereo_core::register as core;
use gelstereo_core::stop::Stop;
use pyo3::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Localizes one part frame by frame: tracks it, detects that it is lost, and finds it again.
///
/// The pose is tracked from the previous frame on the part's exact surface. The ``register.method``
/// "surface_search" also uses the gel model. Between frames the part is assumed to move by a tenth of
/// ``register.start_sigma_deg`` and ``register.start_sigma_mm``.
///
/// If the gel model explained the contact in which the part was found, a pose is accepted while its
/// `misfit` is as usual. Otherwise (not all markers given, or a gel that returns to rest within a pitch)
/// it is accepted while its ``log_odds`` is above 0. If a pose is rejected, the part is searched for
/// around the last accepted pose and around the expected one. Free directions keep their values.
///
/// Calls from several threads are serialised; the interpreter's lock is released meanwhile.
///
/// Parameters
/// ----------
/// template : Template
///     Of a mesh.
/// guess : (4, 4) array_like
///     Expected pose of the part; maps object coordinates to sensor coordinates.
/// params : Params, optional
///     Its ``register`` part is used, and ``contact.decay_mm``.
/// press_direction : (3,) array_like, optional
///     As in `localize`.
///
/// Examples
/// --------
/// ::
///
///     localizer = Localizer(template, guess=guess)
///     for left, right in camera:
///         found = localizer.process(pipeline.process(left, right))
///         if found.tracking == "lost":
///             ...
#[pyclass(frozen, module = "gelstereo")]
pub struct Localizer {
    stage: Mutex<core::Localizer>,
    gel: Gel,
    template: Py<Template>,
}

impl Localizer {
    fn lock(&self) -> MutexGuard<'_, core::Localizer> {
        self.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Localizer {
    #[new]
    #[pyo3(signature = (template, *, guess, params=None, press_direction=None))]
    fn new(
        template: Py<Template>,
        guess: &Bound<'_, PyAny>,
        params: Option<&Bound<'_, Params>>,
        press_direction: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let expected = arrays::pose(guess, "guess")?;
        let params = Params::or_default(params);
        let stage = core::Localizer::new(&params.register, &expected);
        Ok(Self { stage: Mutex::new(stage), gel: Gel::new(&params, press_direction)?, template })
    }

    /// Template of the tracked part.
    #[getter]
    fn template(&self, py: Python<'_>) -> Py<Template> {
        self.template.clone_ref(py)
    }

    /// (4, 4) the last accepted pose, or None.
    #[getter]
    fn t_sensor_object(&self, py: Python<'_>) -> PyResult<Option<Matrix>> {
        let last = py.detach(|| self.lock().last().copied());
        last.map(|pose| arrays::pose_matrix(py, &pose)).transpose()
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let (held, points) = (py.detach(|| self.lock().last().is_some()), self.template.get().inner());
        let points = points.points_mm().len();
        format!("<Localizer: a part of {points} points, {}>", if held { "tracking" } else { "not found yet" })
    }

    /// Set a new expected pose: the gripper has released the part or grasped it again.
    ///
    /// Parameters
    /// ----------
    /// guess : (4, 4) array_like
    fn expect(&self, py: Python<'_>, guess: &Bound<'_, PyAny>) -> PyResult<()> {
        let expected = arrays::pose(guess, "guess")?;
        py.detach(|| self.lock().expect(&expected));
        Ok(())
    }

    /// Localize the part in the next frame; parameters as for `localize`.
    ///
    /// Parameters
    /// ----------
    /// contact : Frame or (N, 3) array_like
    /// all_points_mm : (M, 3) array_like, optional
    /// covariance_mm2 : (N, 3, 3) or (N, 9) array_like, optional
    ///
    /// Returns
    /// -------
    /// Localization
    ///     Its ``tracking`` states how the pose was found.
    ///
    /// Raises
    /// ------
    /// RegisterError
    ///     If nothing can be registered, for example without contact. The last pose is kept.
    #[pyo3(signature = (contact, *, all_points_mm=None, covariance_mm2=None))]
    fn process(
        &self,
        py: Python<'_>,
        contact: &Bound<'_, PyAny>,
        all_points_mm: Option<&Bound<'_, PyAny>>,
        covariance_mm2: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Localization> {
        let template = self.template.get().inner();
        let run =
            |contact: &core::Contact<'_>, stop: Stop<'_>| self.lock().run_unless(contact, template, stop);
        // A lost part is searched for.
        let method = RegisterMethod::SurfaceSearch;
        let given = Given { contact, all_points_mm, covariance_mm2 };
        let (located, model) = given.register(py, method, self.gel, run)?;
        Ok(Localization {
            found: located.registration,
            model,
            tracking: Some(located.tracking),
            misfit: located.misfit.map(|misfit| misfit.mean),
            budget: None,
        })
    }
}
