//! The result of registration.

use super::alternatives::Alternatives;
use super::free::FreeDirections;
use super::observe::Observability;
use super::surface::GelDecay;
use super::verdict::Verdict;
use crate::digest::Digest;
use crate::math::linalg::Symmetric;
use crate::math::{DVec3, Pose, sqrt};
use crate::params::GuessSigma;

/// The result of registration, with its evidence.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Registration {
    /// Maps object coordinates to sensor coordinates.
    pub t_sensor_object: Pose,
    /// Information matrix of a left perturbation (ω, v) of `t_sensor_object` in the sensor frame: T_true
    /// = exp(ω, v) T; order ωx ωy ωz (rad) vx vy vz (mm). It is singular along [`Self::free`] directions:
    /// use [`Self::covariance`] or [`Self::determined_covariance`] instead of inverting it.
    pub information: Symmetric<6>,
    /// The same information about the patch's centroid, by eigenvectors.
    pub observability: Observability,
    /// Prior accuracy of the pose: `register.start_sigma_deg` and `register.start_sigma_mm`.
    pub guess_sigma: GuessSigma,
    /// Whether the steps fell below `register.advanced.step_tolerance` before the iterations, or the budget,
    /// ran out. Otherwise the covariance includes the remaining step, in every direction.
    pub converged: bool,
    /// Iterations of the last stage.
    pub iterations: u32,
    /// Points within `register.advanced.max_distance_mm` of the template.
    pub inliers: usize,
    /// Number of points given.
    pub points: usize,
    /// Root mean square distance of the inliers; for point-to-plane rungs along the normal, weighted by
    /// the probability of contact.
    pub rmse_mm: f64,
    /// Free directions of the contact; empty when all six are determined.
    pub free: FreeDirections,
    /// Log-likelihood of the pose relative to a perfect fit; surface rungs only. It only compares poses
    /// of one contact.
    pub log_likelihood: Option<f64>,
    /// Log evidence ratio: natural logarithm of the odds that the part is here rather than something
    /// else, with equal priors; surface rungs only. At 0 or below the pose does not explain the contact:
    /// the part is elsewhere, or another. [`Self::verdict`] requires more.
    ///
    /// With the gel model, markers in contact or lifted are evidence whatever the gel's law; markers
    /// beside the part count where they agree with the model. Otherwise there is little evidence in
    /// distances from the part, and in the gel's shoulder, up to twice the contact's decay length beside
    /// the part. A search returns the best pose within `register.start_sigma_deg` and
    /// `register.start_sigma_mm`, and its odds are corrected for that selection: noise seldom has odds
    /// above 0. Those of `surface_close` are not corrected: noise has odds above 0 once in 25 times
    /// (simulated).
    pub log_odds: Option<f64>,
    /// Whether the pose explains the contact.
    pub verdict: Verdict,
    /// The gel's decay length that explains the contact best. `None` unless `surface_search` used the gel
    /// model, which requires markers that show the gel's shape.
    pub gel_decay: Option<GelDecay>,
    /// Other poses that explain the contact about as well, most likely first. Only `surface_search` looks
    /// for them.
    pub alternatives: Alternatives,
    /// Work that `register.surface_search.budget` bounds, in lookups of the field of distances; 0 for methods
    /// without a budget. It is no part of the digest.
    #[cfg_attr(feature = "serde", serde(default))]
    pub work: u64,
}

impl Registration {
    /// Covariance of the perturbation of [`Self::information`]: the contact's information combined with
    /// [`Self::guess_sigma`]. It is finite and positive definite; along [`Self::free`] directions it has
    /// the variance of the guess. To fuse with another source use [`Self::information`] instead, or the
    /// guess would count twice.
    ///
    /// It assumes that points touch the faces on which the pose puts them. `surface_search` uses the gel
    /// model and omits markers whose contact is uncertain. `surface_close` adds the uncertainty of which
    /// salient points are in contact, but cannot detect a row of the gel's shoulder mistaken for a face.
    /// There, and at a wrong thread or edge, errors exceed the covariance. The rungs on samples scale it by
    /// the excess of their residuals over the noise. Actual errors are measured in `docs/localization.md`.
    #[must_use]
    pub fn covariance(&self) -> Symmetric<6> {
        self.observability.covariance(&self.guess_sigma)
    }

    /// Covariance of the determined directions only, the pseudo-inverse of [`Self::information`]: zero
    /// along [`Self::free`] directions, which the contact does not bound.
    #[must_use]
    pub fn determined_covariance(&self) -> Symmetric<6> {
        self.observability.determined_covariance()
    }

    /// Standard deviations at a point of the part, in the object's frame: of a turn about the sensor's axes
    /// (rad), then of the point's position along them (mm). The diagonal of [`Self::covariance`] is about
    /// the camera, where a small turn adds much to the position.
    #[must_use]
    pub fn sigma_at(&self, point_mm: DVec3) -> [f64; 6] {
        let covariance = self.covariance();
        let p = self.t_sensor_object.transform_point(point_mm).to_array();
        // The point moves by v + ω × p.
        let moves: [[f64; 6]; 3] = core::array::from_fn(|axis| {
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut row = [0.0; 6];
            (row[next], row[last], row[3 + axis]) = (p[last], -p[next], 1.0);
            row
        });
        core::array::from_fn(|i| {
            if i < 3 {
                return sqrt(covariance[i][i]);
            }
            let row = &moves[i - 3];
            let variance_mm2: f64 =
                (0..6).map(|j| (0..6).map(|k| row[j] * covariance[j][k] * row[k]).sum::<f64>()).sum();
            // Round-off may leave a variance of nothing below zero.
            sqrt(variance_mm2.max(0.0))
        })
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
