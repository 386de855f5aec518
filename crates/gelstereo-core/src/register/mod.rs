//! Registration of a contact patch to a part's template (Eq. 5 to 7).
//!
//! The source is the patch of salient points, the target the template at the guess; what is returned maps the
//! object's frame to the sensor's, so it is Eq. 7's inverse already.

mod alternatives;
mod assess;
mod blocks;
mod codec;
mod copies;
mod error;
mod facet;
mod filterreg;
mod free;
mod fusion;
mod held;
mod icp;
mod limits;
mod localizer;
mod observe;
mod one_sided;
mod ransac;
mod rigid;
mod sample;
mod soft;
mod surface;
mod surfels;
mod symmetry;
mod symmetry_axes;
mod template;
mod verdict;

pub use crate::params::GuessSigma;
pub use alternatives::{Alternative, Alternatives};
pub use codec::TemplateBytesError;
pub use error::{RegisterError, TemplateError};
pub use free::{FreeDirection, FreeDirections, Motion};
pub use fusion::{FusedPose, FusionError, PlaneContact, PoseEstimate, fuse_plane, fuse_poses};
pub use localizer::{Localizer, Located, Standing};
pub use observe::Observability;
pub use rigid::{RigidFit, RigidFitError, rigid_fit};
pub use soft::{SoftMatch, soft_match};
pub use surface::{Contact, GelDecay, Misfit, check_among, unpressed, unpressed_for};
pub use symmetry::Symmetry;
pub use template::Template;
pub use verdict::Verdict;

use crate::digest::Digest;
use crate::math::linalg::Symmetric;
use crate::math::{DVec3, Pose, sqrt};
use crate::params::{RegisterMethod, RegisterParams};
use crate::stop::{NEVER, Stop, ask_often};
use alloc::vec::Vec;
use error::LEAST_PATCH;

/// What registration found, with its evidence.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Registration {
    /// Maps object coordinates to sensor coordinates.
    pub t_sensor_object: Pose,
    /// Information matrix of a left perturbation (ω, v) of `t_sensor_object` in the sensor frame:
    /// T_true = exp(ω, v) T; order ωx ωy ωz (rad) vx vy vz (mm). It is singular along [`Self::free`] directions:
    /// ask [`Self::covariance`] or [`Self::determined_covariance`] instead of inverting it.
    pub information: Symmetric<6>,
    /// The same information about the patch's centroid, by eigenvectors.
    pub observability: Observability,
    /// How well the pose was known before: `register.start_sigma_deg` and `register.start_sigma_mm`.
    pub guess_sigma: GuessSigma,
    /// Whether the steps fell below `register.step_tolerance` before the iterations, or the budget, ran out. Where they did
    /// not, the covariance adds the step that was not taken, in every direction.
    pub converged: bool,
    /// Iterations done by the last stage.
    pub iterations: u32,
    /// Points within `register.max_distance_mm` of the template.
    pub inliers: usize,
    /// Points given.
    pub points: usize,
    /// Root mean square distance of the inliers; for point-to-plane rungs along the normal, each by its probability of
    /// being in contact.
    pub rmse_mm: f64,
    /// Directions that the contact leaves free; empty when all six are determined.
    pub free: FreeDirections,
    /// Natural logarithm of the pose's likelihood over that of a perfect fit, known to
    /// the rungs on the surface alone. It compares poses of one contact, and no more.
    pub log_likelihood: Option<f64>,
    /// Natural logarithm of the odds that the part is here over something else, both as likely beforehand; known to
    /// the rungs on the surface alone. At 0 or below the pose does not explain the contact: the part is elsewhere, or
    /// another. [`Self::verdict`] asks for more than that.
    ///
    /// Where the gel's model was used, markers that touch or are lifted tell whatever the law of the gel. The markers beside
    /// the part count where they agree with the model. Elsewhere distances from the part, and the gel's shoulder, as far
    /// beside the part as twice the contact's decay length, say little of either. A search takes the pose that fits best of
    /// all within `register.start_sigma_deg` and `register.start_sigma_mm`, and its odds are charged for that: noise seldom
    /// has odds above 0. Those of the rungs from one start are not: of noise they have odds above 0
    /// once in 25 times (`surface_close`) or in 100 (`surface_track`; simulated).
    pub log_odds: Option<f64>,
    /// Whether the pose explains the contact.
    pub verdict: Verdict,
    /// The gel's decay length that explains the contact best; `None` where the gel was not asked, which `surface_search`
    /// alone does, and it only where markers show what the gel does.
    pub gel_decay: Option<GelDecay>,
    /// The other poses that explain the contact about as well, the likelier one first; `surface_search` alone looks for
    /// them. What starts from one guess returns none, whatever there is.
    pub alternatives: Alternatives,
}

impl Registration {
    /// Covariance of the perturbation that [`Self::information`] speaks of: the contact's information joined with
    /// [`Self::guess_sigma`]. It is finite and positive definite, and along [`Self::free`] directions it has the variance of
    /// the guess. To join it with another source, take [`Self::information`] instead: the guess would count twice.
    ///
    /// It takes for given that the points touch the faces that the pose puts them on. `surface_search` asks the gel, and
    /// counts no marker that may as well hang. `surface_close` and `surface_track` add what is not known of which salient
    /// points touch, and cannot know of a row of the gel's shoulder that passes for a face: there, and beside a wrong
    /// thread or edge, errors are larger than it says. The rungs on samples add what their residuals exceed the noise by.
    /// How large errors are is measured in `docs/localization.md`.
    #[must_use]
    pub fn covariance(&self) -> Symmetric<6> {
        self.observability.covariance(&self.guess_sigma)
    }

    /// Covariance over the determined directions alone, the pseudo-inverse of [`Self::information`]: zero along
    /// [`Self::free`] directions, where the contact sets no bound.
    #[must_use]
    pub fn determined_covariance(&self) -> Symmetric<6> {
        self.observability.determined_covariance()
    }

    /// Digest of all results.
    #[must_use]
    pub fn digest(&self) -> u64 {
        let (pose, seen) = (&self.t_sensor_object, &self.observability);
        let free = self.free.iter().flat_map(|d| [d.omega, d.v, d.centre_mm]);
        let others = self.alternatives.iter().flat_map(|a| {
            let (q, t) = (a.t_sensor_object.rotation.to_array(), a.t_sensor_object.translation_mm.to_array());
            q.into_iter().chain(t).chain([a.log_likelihood])
        });
        Digest::new()
            .f64s(pose.rotation.to_array())
            .f64s(pose.translation_mm.to_array())
            .f64s(self.information.into_iter().flatten())
            .f64s(seen.centre_mm.to_array())
            .f64s([seen.radius_mm])
            .f64s(seen.values)
            .f64s(seen.directions.into_iter().flatten())
            .u64(u64::from(self.converged))
            .u64(u64::from(self.iterations))
            .u64(self.inliers as u64)
            .u64(self.points as u64)
            .f64s([self.rmse_mm])
            .u64(self.free.len() as u64)
            .f64s(free.flat_map(|v| v.to_array()))
            .f64s(self.log_likelihood)
            .f64s(self.log_odds)
            .u64(self.verdict as u64)
            .f64s(self.gel_decay.map(|gel| gel.length_mm))
            .f64s(others)
            .u64(u64::from(self.alternatives.is_cut()))
            .value()
    }
}

/// Where a stage ended.
#[derive(Clone, Copy, Debug)]
struct Outcome {
    t_sensor_object: Pose,
    converged: bool,
    iterations: u32,
}

/// One patch and one template, with the settings; what every stage looks at.
#[derive(Clone, Copy)]
struct Problem<'a> {
    params: &'a RegisterParams,
    points_mm: &'a [DVec3],
    template: &'a Template,
    stop: Stop<'a>,
}

/// Vectors that the stages share and reuse.
#[derive(Clone, Debug, Default)]
struct Scratch {
    /// The patch in the object's frame, at the current pose.
    placed: Vec<DVec3>,
    /// Sources and targets of a rigid fit, and their weights.
    sources: Vec<DVec3>,
    targets: Vec<DVec3>,
    weights: Vec<f64>,
    soft: Vec<SoftMatch>,
}

impl Scratch {
    /// Places the patch in the object's frame. The translation is taken off first, so that an offset of both costs
    /// nothing.
    fn place(&mut self, points_mm: &[DVec3], t_sensor_object: &Pose) {
        let back = t_sensor_object.rotation.conjugate();
        self.placed.clear();
        self.placed.extend(points_mm.iter().map(|&p| back * (p - t_sensor_object.translation_mm)));
    }

    fn clear_pairs(&mut self) {
        self.sources.clear();
        self.targets.clear();
        self.weights.clear();
        self.soft.clear();
    }

    /// How far a motion in the object's frame moves the point of the patch that it moves most; NaN if it is no motion,
    /// which the larger of two numbers would hide and call a short step.
    fn largest_move_mm(&self, motion: &Pose) -> f64 {
        let squared = |p: &DVec3| motion.transform_point(*p).distance_squared(*p);
        sqrt(self.placed.iter().map(squared).fold(0.0, |most, d| if d <= most { most } else { d }))
    }
}

/// The pose after the patch has been moved by `motion` in the object's frame: T D⁻¹.
fn compose(t_sensor_object: &Pose, motion: &Pose) -> Pose {
    let product = *t_sensor_object * motion.inverse();
    product.normalized().unwrap_or(*t_sensor_object)
}

/// The registration stage and its scratch.
#[derive(Clone, Debug)]
pub struct Registrar {
    params: RegisterParams,
    scratch: Scratch,
    surface: surface::SurfaceScratch,
}

impl Registrar {
    /// With these settings.
    #[must_use]
    pub fn new(params: &RegisterParams) -> Self {
        Self {
            params: params.clone(),
            scratch: Scratch::default(),
            surface: surface::SurfaceScratch::default(),
        }
    }

    /// Goes on with other settings, in the memory that it has: the answers are those of a new one.
    pub fn set_params(&mut self, params: &RegisterParams) {
        self.params.clone_from(params);
    }

    /// Registers a patch of salient points (sensor frame) to the template, from a guess.
    ///
    /// Allocates nothing once a patch as large has been seen. The same input gives the same bits.
    ///
    /// # Errors
    /// [`RegisterError`].
    pub fn run(
        &mut self,
        points_mm: &[DVec3],
        template: &Template,
        guess: &Pose,
    ) -> Result<Registration, RegisterError> {
        self.register(&Contact::new(points_mm), template, guess)
    }

    /// As [`Self::run`], with all that was sensed of the contact.
    ///
    /// # Errors
    /// [`RegisterError`].
    pub fn register(
        &mut self,
        contact: &Contact<'_>,
        template: &Template,
        guess: &Pose,
    ) -> Result<Registration, RegisterError> {
        self.register_unless(contact, template, guess, NEVER)
    }

    /// As [`Self::register`], unless it is stopped.
    ///
    /// # Errors
    /// [`RegisterError`]; [`RegisterError::Stopped`] leaves nothing behind.
    pub fn register_unless(
        &mut self,
        contact: &Contact<'_>,
        template: &Template,
        guess: &Pose,
        stop: Stop<'_>,
    ) -> Result<Registration, RegisterError> {
        self.params.validate()?;
        let points_mm = contact.points_mm;
        let guess = check(points_mm, guess)?;
        use RegisterMethod::{
            FilterregPlane, FilterregPoint, RansacIcp, SurfaceClose, SurfaceSearch, SurfaceTrack,
        };
        let Self { params, scratch, surface } = self;
        let problem = &Problem { params, points_mm, template, stop };
        let outcome = match params.method {
            FilterregPoint => filterreg::run(problem, scratch, &guess, filterreg::Metric::Point)?,
            FilterregPlane => filterreg::run(problem, scratch, &guess, filterreg::Metric::Plane)?,
            RansacIcp => {
                let start = ransac::search(problem, scratch, &guess)?;
                icp::run(problem, scratch, &start)?
            }
            SurfaceTrack | SurfaceClose | SurfaceSearch => {
                let mut found = surface::run(params, (contact, template), &guess, surface, stop)?;
                copies::honour(&mut found, template.symmetries(), &guess, params.point_sigma_mm);
                return Ok(found);
            }
        };
        let mut found = assess::registration(problem, scratch, &outcome)?;
        // Normals are read at samples, and so at most half a spacing off.
        let resolution_mm = params.point_sigma_mm.max(0.5 * template.spacing_mm());
        copies::honour(&mut found, template.symmetries(), &guess, resolution_mm);
        Ok(found)
    }

    /// How far markers are from what the gel does at a pose of a contact that has been registered, after as few steps
    /// as make it usual, or else after all. `None` where it is not known: not all markers are given, the part has holes,
    /// or the gel comes back to rest within a pitch.
    fn misfit(
        &mut self,
        of: (&Contact<'_>, &Template),
        t_sensor_object: &Pose,
        usual: Option<&surface::Usual>,
    ) -> Option<Misfit> {
        surface::misfit(&self.params, of, t_sensor_object, usual, &mut self.surface)
    }
}

/// Refuses what has no answer; returns the guess at unit length.
fn check(points_mm: &[DVec3], guess: &Pose) -> Result<Pose, RegisterError> {
    let far = |v: &DVec3| !v.is_finite() || v.abs().max_element() > limits::REACH_MM;
    if let Some(index) = points_mm.iter().position(far) {
        return Err(RegisterError::PointNotFinite { index });
    }
    if points_mm.len() < LEAST_PATCH {
        return Err(RegisterError::TooFewPoints { found: points_mm.len(), least: LEAST_PATCH });
    }
    if far(&guess.translation_mm) {
        return Err(RegisterError::BadGuess);
    }
    guess.normalized().map_err(|_| RegisterError::BadGuess)
}

/// Refuses a placed patch of which fewer points than needed lie within `reach_mm` of the template.
fn check_reach(problem: &Problem<'_>, placed: &[DVec3], reach_mm: f64) -> Result<(), RegisterError> {
    let (mut within, mut nearest) = (0, f64::INFINITY);
    for (step, &point) in placed.iter().enumerate() {
        ask_often(problem.stop, step)?;
        if let Some((_, distance_squared)) = problem.template.tree().nearest(point) {
            within += usize::from(distance_squared <= reach_mm * reach_mm);
            nearest = nearest.min(distance_squared);
        }
    }
    if within >= LEAST_PATCH {
        return Ok(());
    }
    Err(RegisterError::OutOfReach { within, least: LEAST_PATCH, nearest_mm: sqrt(nearest), reach_mm })
}
