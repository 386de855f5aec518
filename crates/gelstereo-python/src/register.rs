//! Registration.

use crate::arrays::{self, Array1, Matrix, Numbers};
use crate::errors::{RegisterError, raise};
use crate::interrupt::stoppable;
use crate::params::Params;
use crate::pickle;
use crate::template::Template;
use gelstereo_core::math::{DVec3, sqrt};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register as core;
use gelstereo_core::stop::Stop;
use pyo3::prelude::*;
use pyo3::types::{PyTuple, PyType};
use std::cell::RefCell;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A free direction: a motion that the contact does not determine, in the object's frame. ``str()``
/// describes it in words.
#[pyclass(frozen, module = "gelstereo")]
pub struct FreeDirection {
    inner: core::FreeDirection,
}

#[pymethods]
impl FreeDirection {
    /// (3,) rotation part of the twist about `centre_mm`.
    #[getter]
    fn omega(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.omega.to_array().to_vec())
    }

    /// (3,) translation part, mm.
    #[getter]
    fn v(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.v.to_array().to_vec())
    }

    /// (3,) centre of the rotation, mm.
    #[getter]
    fn centre_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.centre_mm.to_array().to_vec())
    }

    /// Whether it is a turn about one of `Template.symmetries`, which no contact can determine.
    #[getter]
    const fn is_own(&self) -> bool {
        self.inner.is_own
    }

    fn __str__(&self) -> String {
        self.inner.to_string()
    }

    fn __repr__(&self) -> String {
        format!("<FreeDirection: {}>", self.inner)
    }
}

/// The localized pose of the part, with figures on its quality.
// Arrays are created on access: creating all of them takes a tenth of the time of the fastest method.
#[pyclass(frozen, module = "gelstereo")]
pub struct Localization {
    found: core::Registration,
    tracking: Option<core::TrackingStatus>,
    misfit: Option<f64>,
}

#[pymethods]
impl Localization {
    /// (4, 4) maps object coordinates to sensor coordinates.
    #[getter]
    fn t_sensor_object(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::pose_matrix(py, &self.found.t_sensor_object)
    }

    /// (6, 6) information matrix of a left perturbation (ωx ωy ωz vx vy vz) in the sensor frame; singular
    /// along `free`.
    #[getter]
    fn information(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.found.information)
    }

    /// (6, 6) covariance of the same perturbation (rad², rad mm, mm²), positive definite: `information`
    /// combined with the prior of the guess. The prior has ``register.start_sigma_deg`` and
    /// ``register.start_sigma_mm``, for a turn about the patch's centroid and a shift of it. Along `free`
    /// the covariance has the guess's variance. To fuse with another source use `information`; otherwise
    /// the guess would count twice.
    #[getter]
    fn covariance(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.found.covariance())
    }

    /// (6, 6) covariance over the determined directions only, the pseudo-inverse of `information`: zero
    /// along `free`, where the contact sets no bound.
    #[getter]
    fn determined_covariance(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.found.determined_covariance())
    }

    /// Whether the steps fell below ``register.advanced.step_tolerance`` before the iterations ran out.
    #[getter]
    const fn converged(&self) -> bool {
        self.found.converged
    }

    /// Number of iterations of the last stage.
    #[getter]
    const fn iterations(&self) -> u32 {
        self.found.iterations
    }

    /// Points within ``register.advanced.max_distance_mm`` of the template.
    #[getter]
    const fn inliers(&self) -> usize {
        self.found.inliers
    }

    /// Number of points given.
    #[getter]
    const fn points(&self) -> usize {
        self.found.points
    }

    /// Root mean square distance of the inliers. For point-to-plane methods it is measured along the
    /// normals, and each point is weighted by its contact probability.
    #[getter]
    const fn rmse_mm(&self) -> f64 {
        self.found.rmse_mm
    }

    /// The `FreeDirection` s of the contact; empty if all six directions are determined.
    #[getter]
    fn free<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let free = self.found.free.iter().map(|&inner| Py::new(py, FreeDirection { inner }));
        PyTuple::new(py, free.collect::<PyResult<Vec<_>>>()?)
    }

    /// Log likelihood of the pose, for comparing poses of one contact; None except for the surface methods.
    #[getter]
    const fn log_likelihood(&self) -> Option<f64> {
        self.found.log_likelihood
    }

    /// Whether the pose explains the contact.
    ///
    /// ``"fits"``: ``log_odds`` is above 0, the distances of the markers in contact from the part are
    /// within their noise (chi-squared test at 1 %), and the method converged. ``"unsure"``: the odds are
    /// above 0, but one of the other two conditions fails; always the result of methods on samples.
    /// ``"does_not_fit"``: the part is elsewhere, or it is another part.
    #[getter]
    const fn verdict(&self) -> &'static str {
        self.found.verdict.name()
    }

    /// Log evidence ratio of the part at this pose against anything else, with equal priors; None except
    /// for the surface methods. At 0 or below, the pose does not explain the contact: the part is
    /// elsewhere, or it is another part. For ``surface_search`` it includes a penalty for choosing the
    /// best of all poses that the guess allows; for other methods it does not.
    #[getter]
    const fn log_odds(&self) -> Option<f64> {
        self.found.log_odds
    }

    /// The gel's decay length that explains the contact best, mm. Estimated only by ``surface_search``,
    /// and only where markers show the gel's response; otherwise None.
    #[getter]
    fn gel_decay_mm(&self) -> Option<f64> {
        self.found.gel_decay.map(|gel| gel.length_mm)
    }

    /// Whether `gel_decay_mm` is at an end of its search range, 0.22 to 2.1 times ``contact.decay_mm``.
    /// The gel then differs from its settings, and the pose is less reliable. None where it was not
    /// estimated.
    #[getter]
    fn gel_decay_at_limit(&self) -> Option<bool> {
        self.found.gel_decay.map(|gel| gel.is_at_limit)
    }

    /// How a `Localizer` found the pose: ``"tracking"`` from the previous frame, ``"relocalized"`` by a
    /// search, or ``"lost"``: the search found no pose that explains the contact, and this is its best.
    /// None from `localize`.
    #[getter]
    fn tracking(&self) -> Option<&'static str> {
        self.tracking.map(|tracking| match tracking {
            core::TrackingStatus::Tracking => "tracking",
            core::TrackingStatus::Relocalized => "relocalized",
            core::TrackingStatus::Lost => "lost",
        })
    }

    /// Criterion of a `Localizer` where the gel model applies: mean over the lifted markers of their
    /// squared deviations from the predicted gel height, in variances, each capped at 16. About 1 at a
    /// correct pose; None where it is not evaluated.
    #[getter]
    const fn misfit(&self) -> Option<f64> {
        self.misfit
    }

    /// Alternative poses that explain the contact about as well, likeliest first, at most 8: pairs of a
    /// (4, 4) pose and its log likelihood. Each is at least 1 % as likely as the best, and agrees with it
    /// along `free` directions. Only ``surface_search`` looks for them; empty from other methods.
    #[getter]
    fn alternatives<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let other =
            |a: &core::Alternative| Ok((arrays::pose_matrix(py, &a.t_sensor_object)?, a.log_likelihood));
        PyTuple::new(py, self.found.alternatives.iter().map(other).collect::<PyResult<Vec<_>>>()?)
    }

    /// Whether there may be more `alternatives` than are given: there was no room for all, or
    /// ``register.surface_search.budget`` was spent before all were examined.
    #[getter]
    fn alternatives_cut(&self) -> bool {
        self.found.alternatives.is_cut()
    }

    /// Digest of all results, bit for bit.
    #[getter]
    fn digest(&self) -> u64 {
        self.found.digest()
    }

    #[classmethod]
    fn _from_bytes(_cls: &Bound<'_, PyType>, data: &[u8]) -> PyResult<Self> {
        let (found, tracking, misfit) = pickle::from_bytes(data, "Localization")?;
        Ok(Self { found, tracking, misfit })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<pickle::Reduced<'py>> {
        let Self { found, tracking, misfit } = slf.get();
        pickle::reduce(slf, "_from_bytes", &pickle::to_bytes(&(found, tracking, misfit))?)
    }

    fn __repr__(&self) -> String {
        let end = if self.found.converged { "converged" } else { "not converged" };
        format!(
            "<Localization: {end} after {} iterations, {} of {} points within reach, rmse {:.4} mm, {} free \
             directions>",
            self.found.iterations,
            self.found.inliers,
            self.found.points,
            self.found.rmse_mm,
            self.found.free.len()
        )
    }
}

/// Largest number of points, registered in seconds. A density above the template's adds no information.
const MAX_POINTS: usize = 20_000;

/// Register a contact patch to a part's template, to find the part's pose.
///
/// Parameters
/// ----------
/// points_mm : (N, 3) array_like
///     Points on the part's surface, sensor frame: `Frame.patch_points_mm`. At most 20000.
/// template : Template
/// t_sensor_object : (4, 4) array_like
///     A guess: maps object coordinates to sensor coordinates.
/// all_points_mm : (M, 3) array_like, optional
///     All markers' points, those of `points_mm` among them, bit for bit. The methods on the part's surface
///     (``register.method`` "surface_close", "surface_search"; they need a template of a mesh) use that the
///     part is nowhere between the others and the camera; other methods do not look at them.
/// covariance_mm2 : (N, 3, 3) or (N, 9) array_like, optional
///     Covariance of each of `points_mm`, for the same methods; without it ``register.point_sigma_mm``
///     holds for all.
/// params : Params, optional
///     Its ``register`` part is used, and ``contact.decay_mm``.
/// press_direction : (3,) array_like, optional
///     The way from the part into the gel, sensor frame, of any length; toward the camera, (0, 0, -1), if
///     left out. Only faces that look this way can be touched. The methods on the part's surface use it.
///
/// Returns
/// -------
/// Localization
///
/// Raises
/// ------
/// RegisterError
///     If the patch cannot be registered, for example with too few points, if it is not among all
///     markers, or if it lies across the press direction.
#[pyfunction]
#[pyo3(signature = (
    points_mm, template, *, t_sensor_object, all_points_mm=None, covariance_mm2=None, params=None, press_direction=None
))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn localize(
    py: Python<'_>,
    points_mm: &Bound<'_, PyAny>,
    template: &Bound<'_, Template>,
    t_sensor_object: &Bound<'_, PyAny>,
    all_points_mm: Option<&Bound<'_, PyAny>>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    params: Option<&Bound<'_, Params>>,
    press_direction: Option<&Bound<'_, PyAny>>,
) -> PyResult<Localization> {
    let guess = arrays::pose(t_sensor_object, "t_sensor_object")?;
    let template = template.get().inner();
    let params = Params::or_default(params);
    let register = |contact: &core::Contact<'_>, stop: Stop<'_>| {
        REGISTRAR.with_borrow_mut(|stage| {
            stage.set_params(&params.register);
            stage.register_unless(contact, template, &guess, stop)
        })
    };
    let gel = Gel::new(&params, press_direction)?;
    let method = params.register.method;
    let markers = (points_mm, all_points_mm, covariance_mm2);
    let found = with_contact(py, markers, method, gel, register)?;
    Ok(Localization { found, tracking: None, misfit: None })
}

thread_local! {
    /// This thread's registrar, kept for its memory: allocating it again takes a tenth of the work.
    static REGISTRAR: RefCell<core::Registrar> = RefCell::new(core::Registrar::new(&RegisterParams::default()));
}

/// Salient points, all points and covariances, as passed from Python.
type Markers<'a, 'py> = (&'a Bound<'py, PyAny>, Option<&'a Bound<'py, PyAny>>, Option<&'a Bound<'py, PyAny>>);

/// Properties of the gel.
#[derive(Clone, Copy)]
struct Gel {
    decay_mm: f64,
    /// Unit vector from the part into the gel, sensor frame.
    press_direction: DVec3,
}

impl Gel {
    fn new(
        params: &gelstereo_core::params::Params,
        press_direction: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let press_direction = match press_direction {
            None => DVec3::NEG_Z,
            Some(given) => {
                let given = DVec3::from_array(Numbers::new(given, "press_direction")?.vector::<3>()?);
                // A vector of length 0 is rejected later because it is not a unit vector.
                let scaled = given / given.abs().max_element();
                scaled / sqrt(scaled.length_squared())
            }
        };
        Ok(Self { decay_mm: params.contact.decay_mm, press_direction })
    }
}

/// Runs work on a contact with the interpreter's lock released, until a signal stops it.
fn with_contact<T: Send>(
    py: Python<'_>,
    (points_mm, all_points_mm, covariance_mm2): Markers<'_, '_>,
    method: RegisterMethod,
    gel: Gel,
    run: impl FnOnce(&core::Contact<'_>, Stop<'_>) -> Result<T, core::RegisterError> + Send,
) -> PyResult<T> {
    let points = Numbers::new(points_mm, "points_mm")?;
    let points = points.rows::<DVec3, 3>()?;
    if points.len() > MAX_POINTS {
        return Err(RegisterError::new_err(format!(
            "there are {} points; valid is up to {MAX_POINTS}: hand over the contact patch alone, thinned to about \
             the spacing of the template",
            points.len()
        )));
    }
    let all = all_points_mm.map(|all| Numbers::new(all, "all_points_mm")).transpose()?;
    let all = all.as_ref().map(Numbers::rows::<DVec3, 3>).transpose()?;
    let covariances = covariance_mm2.map(|c| Numbers::new(c, "covariance_mm2")).transpose()?;
    let covariances = covariances.as_ref().map(Numbers::matrices).transpose()?;
    stoppable(py, |stop| {
        if let Some(all) = all {
            core::check_among(all, points)?;
        }
        let unpressed_mm = core::unpressed_for(method, all.unwrap_or_default(), points);
        let contact = core::Contact {
            covariance_mm2: covariances,
            unpressed_mm: &unpressed_mm,
            decay_mm: gel.decay_mm,
            press_direction: gel.press_direction,
            ..core::Contact::new(points)
        };
        run(&contact, stop)
    })?
    .map_err(raise)
}

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
/// Calls from several threads take turns; the interpreter is released meanwhile.
///
/// Parameters
/// ----------
/// template : Template
///     Of a mesh.
/// t_sensor_object : (4, 4) array_like
///     Where the part is expected: maps object coordinates to sensor coordinates.
/// params : Params, optional
///     Its ``register`` part is used, and ``contact.decay_mm``.
/// press_direction : (3,) array_like, optional
///     As of `localize`.
///
/// Examples
/// --------
/// ::
///
///     localizer = Localizer(template, t_sensor_object=guess)
///     for left, right in camera:
///         frame = pipeline.process(left, right)
///         found = localizer.process(frame.patch_points_mm, all_points_mm=frame.points_mm)
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
    #[pyo3(signature = (template, *, t_sensor_object, params=None, press_direction=None))]
    fn new(
        template: Py<Template>,
        t_sensor_object: &Bound<'_, PyAny>,
        params: Option<&Bound<'_, Params>>,
        press_direction: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let expected = arrays::pose(t_sensor_object, "t_sensor_object")?;
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
    /// t_sensor_object : (4, 4) array_like
    fn expect(&self, py: Python<'_>, t_sensor_object: &Bound<'_, PyAny>) -> PyResult<()> {
        let expected = arrays::pose(t_sensor_object, "t_sensor_object")?;
        py.detach(|| self.lock().expect(&expected));
        Ok(())
    }

    /// Localize the part in the next frame; parameters as for `localize`.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    /// all_points_mm : (M, 3) array_like, optional
    /// covariance_mm2 : (N, 3, 3) or (N, 9) array_like, optional
    ///
    /// Returns
    /// -------
    /// Localization
    ///     Its ``tracking`` says how the pose was come by.
    ///
    /// Raises
    /// ------
    /// RegisterError
    ///     If nothing can be registered, for one when nothing touches the gel; the last pose is kept.
    #[pyo3(signature = (points_mm, *, all_points_mm=None, covariance_mm2=None))]
    fn process(
        &self,
        py: Python<'_>,
        points_mm: &Bound<'_, PyAny>,
        all_points_mm: Option<&Bound<'_, PyAny>>,
        covariance_mm2: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Localization> {
        let template = self.template.get().inner();
        let run =
            |contact: &core::Contact<'_>, stop: Stop<'_>| self.lock().run_unless(contact, template, stop);
        // A lost part is searched for.
        let method = RegisterMethod::SurfaceSearch;
        let markers = (points_mm, all_points_mm, covariance_mm2);
        let located = with_contact(py, markers, method, self.gel, run)?;
        Ok(Localization {
            found: located.registration,
            tracking: Some(located.tracking),
            misfit: located.misfit.map(|misfit| misfit.mean),
        })
    }
}
