//! Registration.

use crate::arrays::{self, Array1, Matrix, Numbers};
use crate::given::{Given, Model};
use crate::notebook;
use crate::params::Params;
use crate::pickle;
use crate::pipeline::check_deadline;
use crate::template::Template;
use gelstereo_core::math::{DVec3, sqrt};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::pipeline::Pace;
use gelstereo_core::register as core;
use gelstereo_core::stop::Stop;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyTuple, PyType};
use std::cell::RefCell;
use std::time::Instant;

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
    pub found: core::Registration,
    pub model: Model,
    pub tracking: Option<core::TrackingStatus>,
    pub misfit: Option<f64>,
    pub budget: Option<u32>,
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
    /// ``"fits"``: the odds are above 100 to 1 (``log_odds`` 4.6), the distances of the markers in contact
    /// from the part are within their noise (chi-squared test at 1 %), and the method converged.
    /// ``"does_not_fit"``: the odds are at most 1 to 100 (-4.6); the part is elsewhere, or it is another
    /// part. ``"unsure"``: neither; always the result of methods on samples.
    #[getter]
    const fn verdict(&self) -> &'static str {
        self.found.verdict.name()
    }

    /// What the registration could use. ``"samples"``: the template's samples, as the paper's methods do.
    /// ``"surface"``: the part's exact surface. ``"gel"``: the part's surface and all markers, with the model
    /// of the gel beside the part where that explains the markers better; only ``surface_search`` does so,
    /// with a frame or `all_points_mm`.
    #[getter]
    const fn model(&self) -> &'static str {
        self.model.name()
    }

    /// Standard deviations of the pose at a point of the part.
    ///
    /// The diagonal of `covariance` is about the camera: a small turn moves a part that is 30 mm away. This
    /// is the uncertainty of where the point is.
    ///
    /// Parameters
    /// ----------
    /// point_mm : (3,) array_like, optional
    ///     In the object's frame; its origin if left out.
    ///
    /// Returns
    /// -------
    /// (6,) float64
    ///     Of the part's turn about the sensor's x, y and z axes (rad), and of the point's position along
    ///     them (mm).
    ///
    /// Raises
    /// ------
    /// ShapeError
    ///     If `point_mm` is no vector of three numbers.
    #[pyo3(signature = (point_mm=None))]
    fn sigma_at(&self, py: Python<'_>, point_mm: Option<&Bound<'_, PyAny>>) -> PyResult<Array1<f64>> {
        let point_mm = match point_mm {
            None => DVec3::ZERO,
            Some(given) => DVec3::from_array(Numbers::new(given, "point_mm")?.vector::<3>()?),
        };
        Ok(arrays::list(py, self.found.sigma_at(point_mm).to_vec()))
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

    /// Whether `gel_decay_mm` is at an end of its search range, 0.08 to 2.1 times ``contact.decay_mm``.
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

    /// Work of the registration, in the units of ``register.surface_search.budget``; 0 for methods without a
    /// budget.
    #[getter]
    const fn work(&self) -> u64 {
        self.found.work
    }

    /// Budget of the registration: ``register.surface_search.budget``, or less with a deadline. `None` for a
    /// pose of `Localizer`.
    #[getter]
    const fn budget(&self) -> Option<u32> {
        self.budget
    }

    /// Digest of all results, bit for bit.
    #[getter]
    fn digest(&self) -> u64 {
        self.found.digest()
    }

    #[classmethod]
    fn _from_bytes(_cls: &Bound<'_, PyType>, data: &[u8]) -> PyResult<Self> {
        let (found, model, tracking, misfit, budget) = pickle::from_bytes(data, "Localization")?;
        Ok(Self { found, model, tracking, misfit, budget })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<pickle::Reduced<'py>> {
        let Self { found, model, tracking, misfit, budget } = slf.get();
        pickle::reduce(slf, "_from_bytes", &pickle::to_bytes(&(found, model, tracking, misfit, budget))?)
    }

    /// HTML for notebooks.
    fn _repr_html_(slf: &Bound<'_, Self>) -> PyResult<String> {
        notebook::html(slf.as_any(), "localization_html")
    }

    fn __repr__(&self) -> String {
        let fit = match self.found.verdict {
            core::Verdict::Fits => "fits",
            core::Verdict::Unsure => "unsure",
            core::Verdict::DoesNotFit => "does not fit",
        };
        let end = if self.found.converged { "converged" } else { "not converged" };
        format!(
            "<Localization: {fit}, {end} after {} iterations, {} of {} points within reach, rmse {:.4} mm, \
             {} free directions>",
            self.found.iterations,
            self.found.inliers,
            self.found.points,
            self.found.rmse_mm,
            self.found.free.len()
        )
    }
}

/// Register a contact to a part's template, to find the part's pose.
///
/// Parameters
/// ----------
/// contact : Frame or (N, 3) array_like
///     A frame of `Pipeline.process`: its contact patch with covariances, and all other markers that are
///     seen. Or points on the part's surface alone, sensor frame, at most 20000; `Localization.model` then
///     tells what could be used.
/// template : Template
/// guess : (4, 4) array_like
///     Approximate pose; maps object coordinates to sensor coordinates. How far it may be off is set by
///     ``register.start_sigma_deg`` and ``register.start_sigma_mm``.
/// all_points_mm : (M, 3) array_like, optional
///     With points: all markers' points, those of `contact` among them, bit for bit. The methods on the
///     part's surface (``register.method`` "surface_close", "surface_search"; they need a template of a mesh)
///     use the fact that the part is not between the other markers and the camera, and "surface_search" the
///     gel's model. Other methods ignore them. Not with a frame, which has them.
/// covariance_mm2 : (N, 3, 3) or (N, 9) array_like, optional
///     With points: covariance of each, for the same methods. Default: ``register.point_sigma_mm`` for all.
///     Not with a frame.
/// params : Params, optional
///     Its ``register`` part is used; with points also ``contact.decay_mm``, which a frame has.
/// press_direction : (3,) array_like, optional
///     Direction from the part into the gel, sensor frame, of any length. Default: towards the camera, (0, 0,
///     -1). Only faces towards this direction can be in contact. Used by the methods on the part's surface.
/// deadline_ms : float, optional
///     Time for this call, with a method on the part's surface: ``register.surface_search.budget`` is lowered
///     to the work that fits, and the best pose found by then is returned. The first pose of "surface_search"
///     takes some 25000 units whatever the budget, so shorter deadlines are exceeded. The time that a unit
///     of work takes is learned from the calls with deadlines of this thread, so the first one is not
///     limited. For the same bits again, set the budget to ``Localization.budget``. Half turns
///     (``half_turn_budget``) are searched only if their whole work fits, too. Default: none.
///
/// Returns
/// -------
/// Localization
///
/// Raises
/// ------
/// RegisterError
///     If the contact cannot be registered, for example with too few points, if it is not among all
///     markers, or if it lies across the press direction.
/// ValueError
///     If the deadline is not a positive time, or the method has no budget.
#[pyfunction]
#[pyo3(signature = (
    contact, template, *, guess, all_points_mm=None, covariance_mm2=None, params=None, press_direction=None,
    deadline_ms=None
))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn localize(
    py: Python<'_>,
    contact: &Bound<'_, PyAny>,
    template: &Bound<'_, Template>,
    guess: &Bound<'_, PyAny>,
    all_points_mm: Option<&Bound<'_, PyAny>>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    params: Option<&Bound<'_, Params>>,
    press_direction: Option<&Bound<'_, PyAny>>,
    deadline_ms: Option<f64>,
) -> PyResult<Localization> {
    let begun = Instant::now();
    let guess = arrays::pose(guess, "guess")?;
    let template = template.get().inner();
    let mut params = Params::or_default(params);
    if let Some(deadline_ms) = deadline_ms {
        check_deadline(deadline_ms)?;
        limit_budget(&mut params.register, deadline_ms)?;
    }
    let register = |contact: &core::Contact<'_>, stop: Stop<'_>| {
        REGISTRAR.with_borrow_mut(|stage| {
            stage.set_params(&params.register);
            stage.register_unless(contact, template, &guess, stop)
        })
    };
    let given = Given { contact, all_points_mm, covariance_mm2 };
    let gel = Gel::new(&params, press_direction)?;
    let (found, model) = given.register(py, params.register.method, gel, register)?;
    if deadline_ms.is_some() {
        PACE.with_borrow_mut(|pace| pace.observe(found.work, begun.elapsed().as_nanos() as u64));
    }
    let budget = Some(params.register.surface_search.budget);
    Ok(Localization { found, model, tracking: None, misfit: None, budget })
}

/// Most searches with `half_turn_budget`.
const HALF_TURNS: u32 = 6;

/// Lowers the budget to the work that fits; not before this thread's pace is known.
fn limit_budget(register: &mut RegisterParams, deadline_ms: f64) -> PyResult<()> {
    if !matches!(register.method, RegisterMethod::SurfaceClose | RegisterMethod::SurfaceSearch) {
        let why = "deadline_ms needs register.method = \"surface_close\" or \"surface_search\"";
        return Err(PyValueError::new_err(why));
    }
    if let Some(limit) = PACE.with_borrow(|pace| pace.limit((1e6 * deadline_ms) as u64)) {
        let limit = u32::try_from(limit).unwrap_or(u32::MAX);
        let search = &mut register.surface_search;
        // The half turns need their whole work, or say nothing.
        if limit < search.budget.saturating_add(HALF_TURNS.saturating_mul(search.half_turn_budget)) {
            search.half_turn_budget = 0;
        }
        search.budget = limit.clamp(1, search.budget);
    }
    Ok(())
}

thread_local! {
    /// This thread's time for a unit of registration's work.
    static PACE: RefCell<Pace> = RefCell::new(Pace::default());

    /// This thread's registrar, kept for its memory: allocating it again takes a tenth of the work.
    static REGISTRAR: RefCell<core::Registrar> =
        RefCell::new(core::Registrar::new(&RegisterParams::default()));
}

/// Properties of the gel.
#[derive(Clone, Copy)]
pub struct Gel {
    pub decay_mm: f64,
    pub offset_sigma_mm: f64,
    /// Unit vector from the part into the gel, sensor frame.
    pub press_direction: DVec3,
}

impl Gel {
    pub fn new(
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
        let (decay_mm, offset_sigma_mm) = (params.contact.decay_mm, params.lattice.depth_sigma_mm);
        Ok(Self { decay_mm, offset_sigma_mm, press_direction })
    }
}
