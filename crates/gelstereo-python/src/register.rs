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

/// A direction of motion that the contact does not determine, in the object's frame; ``str()`` says it in words.
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

    /// (3,) the point that the rotation turns about, mm.
    #[getter]
    fn centre_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.centre_mm.to_array().to_vec())
    }

    /// Whether it turns the part about an axis of its own, one of `Template.symmetries`: no contact determines it.
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

/// Where the part sits, with the evidence.
// Arrays are made when they are asked for: making all of them takes a tenth as long as the quickest method.
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

    /// (6, 6) information of a left perturbation (ωx ωy ωz vx vy vz) in the sensor frame; singular along `free`.
    #[getter]
    fn information(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.found.information)
    }

    /// (6, 6) covariance of the same perturbation (rad², rad mm, mm²), positive definite: `information` joined with how
    /// well the guess was known, ``register.start_sigma_deg`` and ``register.start_sigma_mm``, a turn about the patch's
    /// centroid and a shift of it. Along `free` it has the guess's variance. To join it with another source take
    /// `information`: the guess would count twice.
    #[getter]
    fn covariance(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.found.covariance())
    }

    /// (6, 6) covariance over the determined directions alone, the pseudo-inverse of `information`: zero along `free`,
    /// where the contact sets no bound.
    #[getter]
    fn determined_covariance(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.found.determined_covariance())
    }

    /// Whether the steps fell below ``register.step_tolerance`` before the iterations ran out.
    #[getter]
    const fn converged(&self) -> bool {
        self.found.converged
    }

    /// Iterations of the last stage.
    #[getter]
    const fn iterations(&self) -> u32 {
        self.found.iterations
    }

    /// Points within ``register.max_distance_mm`` of the template.
    #[getter]
    const fn inliers(&self) -> usize {
        self.found.inliers
    }

    /// Points given.
    #[getter]
    const fn points(&self) -> usize {
        self.found.points
    }

    /// Root mean square distance of the inliers; for point-to-plane methods along the normals, each point by its
    /// probability of being in contact.
    #[getter]
    const fn rmse_mm(&self) -> f64 {
        self.found.rmse_mm
    }

    /// The `FreeDirection` s that the contact leaves undetermined; empty when all six are known.
    #[getter]
    fn free<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let free = self.found.free.iter().map(|&inner| Py::new(py, FreeDirection { inner }));
        PyTuple::new(py, free.collect::<PyResult<Vec<_>>>()?)
    }

    /// Logarithm of the pose's likelihood, to compare poses of one contact; None but for the surface methods.
    #[getter]
    const fn log_likelihood(&self) -> Option<f64> {
        self.found.log_likelihood
    }

    /// Whether the pose explains the contact.
    ///
    /// ``"fits"``: ``log_odds`` are above 0, the markers that touch the part miss it by no more than their noise explains
    /// (chi-squared test at 1 %), and the method came to rest. ``"unsure"``: the odds are above 0, but one of the other two
    /// does not hold; methods on samples always say so. ``"does_not_fit"``: the part is elsewhere, or another.
    #[getter]
    const fn verdict(&self) -> &'static str {
        self.found.verdict.name()
    }

    /// Logarithm of the odds that the part is here over something else, both as likely beforehand; None but for the
    /// surface methods. At 0 or below the pose does not explain the contact: the part is elsewhere, or another. Those of
    /// ``surface_search`` are charged for taking the best pose of all that the guess allows; the others' are not.
    #[getter]
    const fn log_odds(&self) -> Option<f64> {
        self.found.log_odds
    }

    /// The gel's decay length that explains the contact best, mm; None where the gel was not asked: ``surface_search``
    /// alone does, and it only where markers show what the gel does.
    #[getter]
    fn gel_decay_mm(&self) -> Option<f64> {
        self.found.gel_decay.map(|gel| gel.length_mm)
    }

    /// Whether that stands at an end of where it is looked for, 0.22 and 2.1 times ``contact.decay_mm``: the gel is another
    /// than it is said to be, and the pose is to be believed the less. None where the gel was not asked.
    #[getter]
    fn gel_decay_at_limit(&self) -> Option<bool> {
        self.found.gel_decay.map(|gel| gel.is_at_limit)
    }

    /// How a `Localizer` came to the pose: ``"tracking"`` from the frame before, ``"relocalized"`` by a search, or ``"lost"``: the
    /// search found nothing that explains the contact, and this is its best. None from `localize`.
    #[getter]
    fn tracking(&self) -> Option<&'static str> {
        self.tracking.map(|tracking| match tracking {
            core::TrackingStatus::Tracking => "tracking",
            core::TrackingStatus::Relocalized => "relocalized",
            core::TrackingStatus::Lost => "lost",
        })
    }

    /// What a `Localizer` judges by where the gel is known: mean over the lifted markers of their squared distances
    /// from what the gel would do, in standard deviations, each square up to 16. About 1 at a right pose; None where
    /// it is not asked.
    #[getter]
    const fn misfit(&self) -> Option<f64> {
        self.misfit
    }

    /// The other poses that explain the contact about as well, likeliest first, at most 8: pairs of a (4, 4) pose and its
    /// logarithm of the likelihood. Each is at least 1 % as likely as the best, and stands where that one does along
    /// `free` directions. ``surface_search`` alone looks for them: empty from other methods.
    #[getter]
    fn alternatives<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let other =
            |a: &core::Alternative| Ok((arrays::pose_matrix(py, &a.t_sensor_object)?, a.log_likelihood));
        PyTuple::new(py, self.found.alternatives.iter().map(other).collect::<PyResult<Vec<_>>>()?)
    }

    /// Whether there may be more `alternatives` than are given: there was no room for all, or ``register.budget`` was spent
    /// before all were looked at.
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

/// Points that are registered in seconds. More than the template's own density tells nothing new.
const MAX_POINTS: usize = 20_000;

/// Find where a part sits: register a contact patch to its template.
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
///     (``register.method`` "surface_track", "surface_close", "surface_search"; they need a template of a mesh) use that the
///     part is nowhere between the others and the camera; other methods do not look at them.
/// covariance_mm2 : (N, 3, 3) or (N, 9) array_like, optional
///     Covariance of each of `points_mm`, for the same methods; without it ``register.point_sigma_mm`` holds for all.
/// params : Params, optional
///     Its ``register`` part is used, and ``contact.decay_mm``.
/// press_direction : (3,) array_like, optional
///     The way from the part into the gel, sensor frame, of any length; toward the camera, (0, 0, -1), if left out. Only
///     faces that look this way can be touched. The methods on the part's surface use it.
///
/// Returns
/// -------
/// Localization
///
/// Raises
/// ------
/// RegisterError
///     If the patch cannot be registered, for example with too few points, if it is not among all markers, or if it lies
///     across the press direction.
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
    /// This thread's stage, for the memory it has: asking for it anew takes as long as a tenth of the work.
    static REGISTRAR: RefCell<core::Registrar> = RefCell::new(core::Registrar::new(&RegisterParams::default()));
}

/// Salient points, all points and covariances, as they are handed over.
type Markers<'a, 'py> = (&'a Bound<'py, PyAny>, Option<&'a Bound<'py, PyAny>>, Option<&'a Bound<'py, PyAny>>);

/// What is said of the gel.
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
                // What has no length is refused as no unit vector.
                let scaled = given / given.abs().max_element();
                scaled / sqrt(scaled.length_squared())
            }
        };
        Ok(Self { decay_mm: params.contact.decay_mm, press_direction })
    }
}

/// Runs what needs a contact for a method, with the interpreter released, until a signal stops it.
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

/// Localizes one part frame by frame: follows it, notices that it is lost, and finds it again.
///
/// A pose is followed from the frame before by the part's exact surface; with the ``register.method`` "surface_search"
/// by what the gel does, too, and with "surface_track" by its grid of distances first. From frame to frame the part is
/// said to move by a tenth of ``register.start_sigma_deg`` and ``register.start_sigma_mm``. Where the gel explained the
/// contact in which the part was found, a pose is believed while its `misfit` is as usual; elsewhere (not all markers
/// given, a gel that comes back to rest within a pitch) while its ``log_odds`` are above 0. Otherwise the part is searched
/// for, around the last pose that was believed and around where it is expected. What the contact leaves free stays as it
/// was.
///
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

    /// The part that is followed.
    #[getter]
    fn template(&self, py: Python<'_>) -> Py<Template> {
        self.template.clone_ref(py)
    }

    /// (4, 4) the last pose that was believed, or None.
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

    /// The part is expected elsewhere from now on: the gripper has let go, or grasped it anew.
    ///
    /// Parameters
    /// ----------
    /// t_sensor_object : (4, 4) array_like
    fn expect(&self, py: Python<'_>, t_sensor_object: &Bound<'_, PyAny>) -> PyResult<()> {
        let expected = arrays::pose(t_sensor_object, "t_sensor_object")?;
        py.detach(|| self.lock().expect(&expected));
        Ok(())
    }

    /// Localize the part in the next frame; parameters as `localize` takes them.
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
        // What is lost is searched for.
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
