//! Belief about the part's pose: all poses consistent with the contacts, with their odds.
//!
//! The poses are the means of a Gaussian mixture. Two looks are fused pair by pair; a pair's odds are the
//! product of both odds and of the agreement between its poses.

use gelstereo_core::math::{Pose, exp};
use gelstereo_core::register::{
    Alternatives, FusedPose, FusionError, PlaneContact, PoseEstimate, Registration, fuse_plane, fuse_poses,
};

/// Number of poses kept: the likeliest and as many alternatives as a registration has.
const MAX_POSES: usize = 1 + Alternatives::MAX_COUNT;

/// Gaussian mixture of poses.
#[derive(Clone, Debug)]
pub(super) struct Belief {
    likeliest: PoseEstimate,
    others: Vec<Other>,
}

/// An alternative, less likely pose.
#[derive(Clone, Copy, Debug)]
struct Other {
    estimate: PoseEstimate,
    /// Natural logarithm of its odds relative to the likeliest pose.
    log_odds: f64,
}

/// A pose and its probability.
#[derive(Clone, Copy, Debug)]
pub(super) struct Share {
    pub(super) estimate: PoseEstimate,
    /// 0 to 1; all shares of a belief sum to 1.
    pub(super) probability: f64,
}

/// Belief after fusing two sources.
pub(super) struct FusedBelief {
    pub(super) belief: Belief,
    /// Squared Mahalanobis distance between the sources at the likeliest pose; see [`FusedPose`].
    pub(super) squared_distance: f64,
}

impl Belief {
    /// Belief of a registration, sensor frame. Alternatives get the information of the pose itself, in
    /// the part's frame.
    pub(super) fn of(found: &Registration) -> Self {
        let likeliest = PoseEstimate { pose: found.t_sensor_object, information: found.information };
        let best = found.log_likelihood.unwrap_or(0.0);
        let others = found.alternatives.iter().map(|other| {
            let t_other_best = other.t_sensor_object * found.t_sensor_object.inverse();
            Other { estimate: likeliest.in_frame(&t_other_best), log_odds: other.log_likelihood - best }
        });
        Self { likeliest, others: others.collect() }
    }

    /// A single pose without alternatives.
    pub(super) const fn alone(estimate: PoseEstimate) -> Self {
        Self { likeliest: estimate, others: Vec::new() }
    }

    /// Two poses, the second with these log odds.
    #[cfg(test)]
    pub(super) fn of_two(likeliest: PoseEstimate, second: PoseEstimate, log_odds: f64) -> Self {
        Self { likeliest, others: vec![Other { estimate: second, log_odds }] }
    }

    /// The likeliest pose, used for motions.
    pub(super) const fn likeliest(&self) -> &PoseEstimate {
        &self.likeliest
    }

    /// All poses, the likeliest first.
    pub(super) fn shares(&self) -> Vec<Share> {
        let sum = 1.0 + self.others.iter().map(|other| exp(other.log_odds)).sum::<f64>();
        let first = Share { estimate: self.likeliest, probability: 1.0 / sum };
        let others = self
            .others
            .iter()
            .map(|other| Share { estimate: other.estimate, probability: exp(other.log_odds) / sum });
        core::iter::once(first).chain(others).collect()
    }

    /// The same belief in another outer frame c, given `t_c_a`.
    pub(super) fn in_frame(&self, t_c_a: &Pose) -> Self {
        self.map(|estimate| estimate.in_frame(t_c_a))
    }

    /// Applies the same change to each pose.
    pub(super) fn map(&self, change: impl Fn(&PoseEstimate) -> PoseEstimate) -> Self {
        let others = self.others.iter().map(|other| Other { estimate: change(&other.estimate), ..*other });
        Self { likeliest: change(&self.likeliest), others: others.collect() }
    }

    /// Fuses another look at the part, in the same frame. Inconsistent pairs of poses are dropped.
    ///
    /// # Errors
    /// [`FusionError`] of the likeliest poses, if all pairs are inconsistent.
    pub(super) fn fused(&self, look: &Self) -> Result<FusedBelief, FusionError> {
        let mut pairs: Vec<Pair> = Vec::new();
        for before in self.with_odds() {
            for now in look.with_odds() {
                let Ok(fused) = fuse_poses(&before.estimate, &now.estimate) else { continue };
                let log_odds = before.log_odds + now.log_odds - 0.5 * fused.squared_distance;
                pairs.push(Pair { fused, log_odds });
            }
        }
        match FusedBelief::of(pairs) {
            Some(fused) => Ok(fused),
            None => fuse_poses(&self.likeliest, &look.likeliest).map(FusedBelief::alone),
        }
    }

    /// Fuses a plane that the part touches; `contact` gives the touching point of each pose. Poses that
    /// cannot touch the plane are dropped.
    ///
    /// # Errors
    /// [`FusionError`] of the likeliest pose, if no pose can touch the plane.
    pub(super) fn touching(
        &self,
        contact: impl Fn(&PoseEstimate) -> PlaneContact,
    ) -> Result<FusedBelief, FusionError> {
        let pairs = self.with_odds().filter_map(|one| {
            let fused = fuse_plane(&one.estimate, &contact(&one.estimate)).ok()?;
            Some(Pair { fused, log_odds: one.log_odds - 0.5 * fused.squared_distance })
        });
        match FusedBelief::of(pairs.collect()) {
            Some(fused) => Ok(fused),
            None => fuse_plane(&self.likeliest, &contact(&self.likeliest)).map(FusedBelief::alone),
        }
    }

    fn with_odds(&self) -> impl Iterator<Item = Other> {
        let first = Other { estimate: self.likeliest, log_odds: 0.0 };
        core::iter::once(first).chain(self.others.iter().copied())
    }
}

impl FusedBelief {
    /// Collects the fused pairs, likeliest first; `None` without pairs.
    fn of(mut pairs: Vec<Pair>) -> Option<Self> {
        pairs.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
        let best = pairs.first()?;
        let others = pairs
            .iter()
            .skip(1)
            .take(MAX_POSES - 1)
            .map(|pair| Other { estimate: pair.fused.estimate, log_odds: pair.log_odds - best.log_odds });
        let belief = Belief { likeliest: best.fused.estimate, others: others.collect() };
        Some(Self { belief, squared_distance: best.fused.squared_distance })
    }

    const fn alone(fused: FusedPose) -> Self {
        Self { belief: Belief::alone(fused.estimate), squared_distance: fused.squared_distance }
    }
}

/// Fuses an estimate with the prior for the part, which needs no sensing. Without it, two contacts that
/// leave the slide along an axis free and disagree on that axis by 1e-4 rad would resolve their lateral
/// difference by a slide of centimetres.
pub(super) fn expected_anyway(estimate: &PoseEstimate, sigma_rad: f64, sigma_mm: f64) -> PoseEstimate {
    let mut joined = estimate.in_frame(&estimate.pose.inverse());
    for (i, row) in joined.information.iter_mut().enumerate() {
        let sigma = if i < 3 { sigma_rad } else { sigma_mm };
        row[i] += 1.0 / (sigma * sigma);
    }
    joined.in_frame(&estimate.pose)
}

/// A fused pair of poses from two sources.
#[derive(Clone, Copy)]
struct Pair {
    fused: FusedPose,
    log_odds: f64,
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use gelstereo_core::math::DVec3;

    /// Standard deviation `sigma_mm` along every axis, and 0.01 rad.
    fn at(x_mm: f64, sigma_mm: f64) -> PoseEstimate {
        let information = core::array::from_fn(|i| {
            core::array::from_fn(|j| match (i == j, i < 3) {
                (false, _) => 0.0,
                (true, true) => 1e4,
                (true, false) => 1.0 / (sigma_mm * sigma_mm),
            })
        });
        PoseEstimate { pose: Pose::from_translation_mm(DVec3::X * x_mm), information }
    }

    fn two(x_mm: [f64; 2], odds: f64, sigma_mm: f64) -> Belief {
        let [first, second] = x_mm.map(|x_mm| at(x_mm, sigma_mm));
        Belief::of_two(first, second, odds.ln())
    }

    #[test]
    fn shares_are_the_odds_and_sum_to_one() {
        let shares = two([0.0, 1.5], 0.25, 0.1).shares();
        assert!((shares[0].probability - 0.8).abs() < 1e-12 && (shares[1].probability - 0.2).abs() < 1e-12);
        assert_eq!(Belief::alone(at(0.0, 0.1)).shares()[0].probability, 1.0);
    }

    /// Reference: the product of two Gaussian mixtures on a line.
    #[test]
    fn a_second_look_tells_poses_apart_that_the_first_cannot() {
        let (first, second) = (two([0.0, 1.5], 0.5, 0.1), two([1.55, 3.05], 0.9, 0.1));
        let fused = first.fused(&second).unwrap();
        // Only 1.5 and 1.55 mm agree: 0.05 mm apart, with a combined standard deviation of 0.14 mm.
        let likeliest = fused.belief.likeliest();
        assert!((likeliest.pose.translation_mm.x - 1.525).abs() < 1e-9);
        assert!((fused.squared_distance - 0.125).abs() < 1e-9);
        assert!(fused.belief.shares()[0].probability > 0.999);
        // If both looks leave both poses possible, their odds multiply.
        let again = first.fused(&two([0.0, 1.5], 0.5, 0.1)).unwrap().belief.shares();
        assert!((again[1].probability / again[0].probability - 0.25).abs() < 1e-9);
    }

    #[test]
    fn the_likeliest_poses_are_kept() {
        let others: Vec<Other> = (1..9)
            .map(|k| Other { estimate: at(f64::from(k), 1.0), log_odds: -0.1 * f64::from(k) })
            .collect();
        let belief = Belief { likeliest: at(0.0, 1.0), others };
        let shares = belief.fused(&belief).unwrap().belief.shares();
        assert_eq!(shares.len(), MAX_POSES);
        assert!(shares.windows(2).all(|pair| pair[0].probability >= pair[1].probability));
    }
}
