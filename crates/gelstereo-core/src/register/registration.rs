//! What registration found.

use super::alternatives::Alternatives;
use super::free::FreeDirections;
use super::observe::Observability;
use super::surface::GelDecay;
use super::verdict::Verdict;
use crate::digest::Digest;
use crate::math::Pose;
use crate::math::linalg::Symmetric;
use crate::params::GuessSigma;

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
