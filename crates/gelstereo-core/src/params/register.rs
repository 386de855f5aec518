//! Registration of a contact patch to a template.

use super::{ParamsError, check, length, share};

/// How a contact patch is registered to a template.
///
/// The figures are the starts, 5 degrees and 1 mm off, that end within 0.15 mm on a cylinder, two balls and a
/// ridge with the markers in contact by pressure, and the median time (simulated, noise 2 grey levels;
/// `gelstereo frontier`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum RegisterMethod {
    /// FilterReg, point to point (the paper): 100 / 100 / 56 %, 11 ms.
    #[default]
    FilterregPoint,
    /// RANSAC, then point-to-point ICP (the paper's comparison): 100 / 81 / 19 %, 47 ms. It draws points by
    /// their number, so that another order of points is another seed; for the other rungs it is rounding, or
    /// nothing.
    RansacIcp,
    /// The exact surface of the part, from one close guess: 95 / 88 / 88 / 57 %, 1.3 times the bound, 0.5 ms.
    /// It looks for no alternatives: where several poses explain a contact it follows the one that it starts
    /// from.
    ///
    /// The surface methods need a template of a mesh with a field of distances. Their figures are contacts
    /// found to 2 degrees and 0.3 mm over the directions that the contact determines, on six parts with
    /// shoulder, 0.03 mm along z, from guesses up to 5 degrees 1 mm / 10 degrees 2 mm / the same with twice
    /// the noise and a tenth of outliers / 30 degrees 5 mm off, and the median error over the Cramér-Rao
    /// bound (simulated; the example `starts`).
    ///
    /// They know lengths of a usual gel: how far its shoulder reaches, how far steps may go. Of a sensor that
    /// is larger or smaller as a whole [`AdvancedRegisterParams::gel_scale`] says by how much; then answers
    /// scale with all that is sensed.
    SurfaceClose,
    /// The exact surface from many starts around the guess, with the markers that nothing presses: 97 / 97 /
    /// 97 / 98 %, 1.2 times the bound, 9 ms; of the bolt alone 85 %, on whose threads a gel finer than the
    /// markers hangs as they do not show. A row of shoulder beside an edge may pass for the face beyond it;
    /// then the error is some 0.1 mm, and the covariance does not know. Where several poses explain the
    /// contact about as well all are returned, with their likelihoods.
    SurfaceSearch,
}

/// Registration of a contact patch to a template.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct RegisterParams {
    /// How a contact patch is registered to the template. Default: `filterreg_point`. Change it to
    /// `surface_search` for a mesh, or to `surface_close` to save time where the guess is good.
    pub method: RegisterMethod,
    /// Standard deviation of a salient point along the surface's normal; it scales the information matrix.
    /// Valid: 0.000001 to 10000 mm. Default: `0.03` mm. Change it to the noise of heights of a gel at rest.
    pub point_sigma_mm: f64,
    /// Standard deviation of the guess's rotation, per axis: starts lie within 2.4 of it, and what the
    /// contact leaves free is held by it. Valid: 0.000001 to 180 degrees. Default: `12` degrees. Change it to
    /// how well the part's rotation is known.
    pub start_sigma_deg: f64,
    /// The same of the guess's place. Valid: 0.000001 to 10000 mm. Default: `2` mm. Change it to how well the
    /// part's place is known.
    pub start_sigma_mm: f64,
    /// FilterReg: `filterreg_point`.
    pub filterreg: FilterregParams,
    /// RANSAC with ICP.
    pub ransac_icp: RansacIcpParams,
    /// The search on the part's surface.
    pub surface_search: SurfaceSearchParams,
    /// What seldom needs a change.
    pub advanced: AdvancedRegisterParams,
}

/// FilterReg: `filterreg_point`.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct FilterregParams {
    /// Width of the first Gaussian of FilterReg. Valid: 0.000001 to 10000 mm. Not below `min_sigma_mm`.
    /// Default: `0.7` mm. Raise it for worse guesses; faces closer than this are confused.
    pub max_sigma_mm: f64,
    /// Width below which the Gaussian does not shrink. Valid: 0.000001 to 10000 mm. Default: `0.1` mm. Change
    /// it with the noise of points, three times that.
    pub min_sigma_mm: f64,
}

impl Default for FilterregParams {
    fn default() -> Self {
        Self { max_sigma_mm: 0.7, min_sigma_mm: 0.1 }
    }
}

/// RANSAC with ICP.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct RansacIcpParams {
    /// Hypotheses of RANSAC. Valid: 1 to 1000000. Default: `2000`. Raise it for worse guesses; time grows
    /// with it.
    pub hypotheses: u32,
    /// Seed of RANSAC's random stream. Valid: 0 to 9223372036854775807. Default: `1`. Change it to repeat an
    /// experiment with other draws.
    pub seed: u64,
}

impl Default for RansacIcpParams {
    fn default() -> Self {
        Self { hypotheses: 2000, seed: 1 }
    }
}

/// The search on the part's surface.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct SurfaceSearchParams {
    /// Starts of `surface_search`, the guess among them. Valid: 1 to 4096. Default: `128`. Raise it for worse
    /// guesses; time grows with it.
    pub starts: u32,
    /// Work after which the surface rungs stop with the best pose so far, in lookups of the field of
    /// distances, 24 ns each by itself (example `nearest`) and several times that with what is done with it;
    /// one on the exact surface counts as 16. A search has its first pose after some 120000; the rest goes
    /// into better and into equal ones. Work grows with markers: the default is for contacts of up to some
    /// 300. Valid: 1 to 100000000. Default: `370000`. Lower it to bound the time; raise it for contacts of
    /// more markers.
    pub budget: u32,
    /// Largest work for each of six half turns of the part, about the axes of its bounding box through its
    /// centre and through the contact, in the unit of `budget` and beyond it. A pose that fits is `unsure` if
    /// the turned part explains the contact a hundred times better, or if it does when it is turned back. A
    /// turned part that explains it about as well is among the alternatives. Valid: 0 to 100000000; 0 does
    /// not check. Default: `0`. Set it to 120000 where the guess may be on a wrong face: a half to two thirds
    /// of the wrong poses that fit are then unsure, and so are 1 to 7 % of the correct ones. A search takes
    /// three times as long.
    pub half_turn_budget: u32,
}

impl Default for SurfaceSearchParams {
    fn default() -> Self {
        Self { starts: 128, budget: 370_000, half_turn_budget: 0 }
    }
}

/// Registration: what seldom needs a change.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct AdvancedRegisterParams {
    /// How large gel, markers and presses are, over those that the surface rungs' own lengths are for:
    /// markers every 0.9 mm, presses of 0.4 to 1.5 mm. Valid: 0.001 to 1000. Default: `1`. Change it for a
    /// sensor that is larger or smaller as a whole.
    pub gel_scale: f64,
    /// What the mesh may be wrong by, added to every point's noise. Valid: 0.000000001 to 10000 mm. Default:
    /// `0.003` mm. Raise it to the tolerance of the part's manufacture.
    pub surface_sigma_mm: f64,
    /// Share of points that lie on no surface (w of FilterReg). Valid: 0 to 0.999. Default: `0.1`. Raise it
    /// where salient markers are often wrong.
    pub outlier_share: f64,
    /// Pairs farther apart are no correspondences (ICP, RANSAC), and inliers are counted within it. Valid:
    /// 0.000001 to 10000 mm. Default: `1` mm. Raise it for worse guesses.
    pub max_distance_mm: f64,
    /// Farthest a RANSAC hypothesis may move the patch's centroid from the guess, and farthest that FilterReg
    /// accepts the patch from the template at the guess. Valid: 0.000001 to 10000 mm. Default: `3` mm: at 5
    /// mm, the faces of a small box are taken for each other. Change it with the uncertainty of the guess.
    pub search_radius_mm: f64,
    /// Most iterations of the last stage. Valid: 1 to 100000. Default: `100`. Raise it when results say that
    /// they did not converge.
    pub max_iterations: u32,
    /// Converged when a step moves no point of the patch by more than this share of the template's spacing.
    /// Only the directions that the contact determines count; point-to-point rungs creep along flat faces and
    /// may run out of iterations there. Valid: 1e-12 to 1. Default: `1e-3`, 0.3 µm at 0.3 mm: a hundredth of
    /// a point's noise. Raise it to save time.
    pub step_tolerance: f64,
}

impl Default for AdvancedRegisterParams {
    fn default() -> Self {
        Self {
            gel_scale: 1.0,
            surface_sigma_mm: 0.003,
            outlier_share: 0.1,
            max_distance_mm: 1.0,
            search_radius_mm: 3.0,
            max_iterations: 100,
            step_tolerance: 1e-3,
        }
    }
}

/// Most work of a search, some seconds.
const MAX_BUDGET: u32 = 100_000_000;

/// Most starts: more take longer than anything that waits for them.
const MAX_STARTS: u32 = 4096;

/// How well a pose was known before a contact: standard deviations, about and along every axis, of a turn
/// about the patch's centroid and of a shift of it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GuessSigma {
    /// Of the turn, rad.
    pub turn_rad: f64,
    /// Of the shift, mm.
    pub shift_mm: f64,
}

impl Default for RegisterParams {
    fn default() -> Self {
        Self {
            method: RegisterMethod::FilterregPoint,
            point_sigma_mm: 0.03,
            start_sigma_deg: 12.0,
            start_sigma_mm: 2.0,
            filterreg: FilterregParams::default(),
            ransac_icp: RansacIcpParams::default(),
            surface_search: SurfaceSearchParams::default(),
            advanced: AdvancedRegisterParams::default(),
        }
    }
}

impl RegisterParams {
    /// A length of the usual gel, of one of this scale.
    pub(crate) fn scaled(&self, mm: f64) -> f64 {
        mm * self.advanced.gel_scale
    }

    /// Distance between the markers of the usual gel, of one of this scale: what `gel_scale` is relative to.
    pub(crate) fn usual_pitch_mm(&self) -> f64 {
        self.scaled(0.9)
    }

    /// How well the guess is known, as it is set.
    pub(crate) const fn guess_sigma(&self) -> GuessSigma {
        GuessSigma { turn_rad: self.start_sigma_deg.to_radians(), shift_mm: self.start_sigma_mm }
    }

    /// Checks every setting of registration against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let r = self;
        let count = |name, n: u32, max: u32, valid| check((1..=max).contains(&n), name, f64::from(n), valid);
        count("register.advanced.max_iterations", r.advanced.max_iterations, 100_000, "1 to 100000")?;
        let step = r.advanced.step_tolerance;
        check((1e-12..=1.0).contains(&step), "register.advanced.step_tolerance", step, "1e-12 to 1")?;
        length("register.filterreg.min_sigma_mm", r.filterreg.min_sigma_mm)?;
        length("register.filterreg.max_sigma_mm", r.filterreg.max_sigma_mm)?;
        let (start, valid) = (r.filterreg.max_sigma_mm, "register.filterreg.min_sigma_mm to 10000 mm");
        check(start >= r.filterreg.min_sigma_mm, "register.filterreg.max_sigma_mm", start, valid)?;
        share("register.advanced.outlier_share", r.advanced.outlier_share)?;
        length("register.advanced.max_distance_mm", r.advanced.max_distance_mm)?;
        length("register.point_sigma_mm", r.point_sigma_mm)?;
        count("register.ransac_icp.hypotheses", r.ransac_icp.hypotheses, 1_000_000, "1 to 1000000")?;
        length("register.advanced.search_radius_mm", r.advanced.search_radius_mm)?;
        let scale_ok = (1e-3..=1e3).contains(&r.advanced.gel_scale);
        check(scale_ok, "register.advanced.gel_scale", r.advanced.gel_scale, "from 0.001 to 1000")?;
        count("register.surface_search.starts", r.surface_search.starts, MAX_STARTS, "from 1 to 4096")?;
        let turn = r.start_sigma_deg;
        check((1e-6..=180.0).contains(&turn), "register.start_sigma_deg", turn, "0.000001 to 180 degrees")?;
        length("register.start_sigma_mm", r.start_sigma_mm)?;
        // Far below any noise: a mesh without an error of its own.
        let (sigma_mm, valid) = (r.advanced.surface_sigma_mm, "0.000000001 to 10000 mm");
        check((1e-9..=1e4).contains(&sigma_mm), "register.advanced.surface_sigma_mm", sigma_mm, valid)?;
        count("register.surface_search.budget", r.surface_search.budget, MAX_BUDGET, "1 to 100000000")?;
        let turned = r.surface_search.half_turn_budget;
        let name = "register.surface_search.half_turn_budget";
        check(turned <= MAX_BUDGET, name, f64::from(turned), "0 to 100000000")
    }
}
