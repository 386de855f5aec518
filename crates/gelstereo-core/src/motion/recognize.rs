//! Finds where a contact is on a known surface.

use super::answer::SurfacePoint;
use super::cloud::Element;
use super::fit::{Fitted, Problem};
use crate::math::linalg::Symmetric;
use crate::math::random::Stream;
use crate::math::{DMat3, DVec3, Factor, Pose, sqrt};
use crate::slip::RigidMotion;
use alloc::vec::Vec;

/// Starts drawn about the guess. Of 36 simulated contacts that came back, 31, 32 and 33 were found with 8, 64
/// and 256 starts, in 0.4, 3 and 13 ms; of 32 contacts of another part, none.
const STARTS: usize = 64;
/// Starts are far from the optimum.
const MATCHING_ROUNDS: u32 = 15;
/// Cost of a point without a counterpart: that of one at three standard deviations.
const UNMATCHED: f64 = 9.0;
/// Difference of costs of two optima of which one is a hundred times likelier: 2 ln 100.
const CLEAR: f64 = 9.21;
/// Squared distance of two poses of one optimum: 99.99 % of six components.
const SAME: f64 = 27.9;
/// Normal deviate of 1 %.
const ONE_IN_A_HUNDRED: f64 = 2.326;
/// Variance of a normal along each tangent, over that of a point per squared spacing: between 0.5 inside and
/// 6.5 at the border of a contact.
const NORMAL_SHARE: f64 = 3.0;
/// Share of the points with a counterpart below which the surfaces hardly overlap.
const MIN_SHARE: f64 = 0.5;
/// Two more than a rigid motion has components, so that residuals tell something. With six, one contact of
/// another part was found among the 32 above.
const MIN_MATCHED: u32 = 8;

/// Whether a contact is recognized.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum RecognitionStatus {
    /// The pose is the only likely one, and noise explains the residuals.
    Found = 0,
    /// Another pose is as likely.
    Ambiguous = 1,
    /// Noise does not explain the residuals.
    Misfit = 2,
    /// Less than half of the points have a counterpart, or fewer than eight.
    TooLittle = 3,
}

impl RecognitionStatus {
    /// All values with their names.
    pub const ALL: [(&'static str, Self); 4] = [
        ("FOUND", Self::Found),
        ("AMBIGUOUS", Self::Ambiguous),
        ("MISFIT", Self::Misfit),
        ("TOO_LITTLE", Self::TooLittle),
    ];
}

/// Where a contact is on a known surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recognition {
    /// Whether it is recognized.
    pub status: RecognitionStatus,
    /// Moves the known surface onto the contact, with the covariance about the contact's centroid.
    pub t_contact_part: RigidMotion,
    /// The second most likely pose; `None` if all starts led to one.
    pub other: Option<Pose>,
    /// Directions, of six, that the surface determines better than the guess.
    pub determined: u8,
    /// Points of the contact with a counterpart.
    pub matched: u32,
    /// Mean of their squared residuals over their variances.
    pub mean_square: f64,
}

/// What a contact is compared with.
#[derive(Clone, Copy, Debug)]
pub struct KnownSurface<'a> {
    /// Points of the surface.
    pub points: &'a [SurfacePoint],
    /// Distance of neighbours in the contact, mm.
    pub spacing_mm: f64,
    /// Standard deviation of the distance of both surfaces, in addition to the noise of their points, mm.
    pub surface_sigma_mm: f64,
}

impl KnownSurface<'_> {
    /// Finds where a contact is, near a guess with these standard deviations in radians and millimetres.
    /// `None` if a number is not finite or not positive, or a list is empty.
    #[must_use]
    pub fn recognize(&self, contact: &[SurfacePoint], guess: &Pose, sigma: [f64; 2]) -> Option<Recognition> {
        let is_valid = |x: f64| x > 0.0 && x.is_finite();
        if contact.is_empty() || !sigma.iter().chain([&self.spacing_mm]).all(|&x| is_valid(x)) {
            return None;
        }
        let now: Vec<Element> = contact.iter().map(|p| self.element(p)).collect::<Option<_>>()?;
        let before: Vec<Element> = self.points.iter().map(|p| self.element(p)).collect::<Option<_>>()?;
        let about_mm = now.iter().map(|e| e.point_mm).sum::<DVec3>() / now.len() as f64;
        let problem = Problem {
            pairs: &[],
            now: &now,
            before: &before,
            about_mm,
            pitch_mm: self.spacing_mm,
            surface_sigma_mm: self.surface_sigma_mm,
            free: sigma,
            frames: 1.0,
            matching_rounds: MATCHING_ROUNDS,
        };
        let (mut found, mut matches) = (Vec::with_capacity(STARTS), Vec::new());
        optima(&problem, guess, STARTS, &mut matches, &mut found);
        let status = judge(&found, now.len())?;
        let (best, other) = (found.first()?.fitted, second(&found).map(|optimum| optimum.fitted));
        let mean_square = best.mean_square();
        Some(Recognition {
            status,
            t_contact_part: best.motion,
            other: other.map(|fitted| fitted.motion.pose),
            determined: best.determined,
            matched: best.matched,
            mean_square,
        })
    }

    fn element(&self, point: &SurfacePoint) -> Option<Element> {
        let SurfacePoint { point_mm, normal, variance_mm2 } = *point;
        let is_valid = point_mm.is_finite() && variance_mm2 > 0.0 && variance_mm2.is_finite();
        let normal = normal.try_normalize().filter(|_| is_valid)?;
        Some(Element {
            is_used: true,
            is_checked: true,
            sharpness: 0.0,
            point_mm,
            covariance_mm2: DMat3::from_diagonal(DVec3::splat(variance_mm2)),
            normal,
            normal_variance: NORMAL_SHARE * variance_mm2 / (self.spacing_mm * self.spacing_mm),
        })
    }
}

/// An optimum with its cost.
#[derive(Clone, Copy, Debug)]
pub(super) struct Optimum {
    cost: f64,
    start: usize,
    pub fitted: Fitted,
}

/// Optima from this many starts about the guess, the best first.
pub(super) fn optima(
    problem: &Problem<'_>,
    guess: &Pose,
    starts: usize,
    matches: &mut Vec<Option<usize>>,
    found: &mut Vec<Optimum>,
) {
    let mut random = Stream::new(1, "recognize");
    found.clear();
    for start in 0..starts {
        let mut offset = [0.0; 6];
        if start > 0 {
            offset = offset.map(|_| random.normal());
        }
        if let Some(fitted) = problem.fit_from(guess, offset, matches) {
            let missing = problem.now.len() as f64 - f64::from(fitted.matched);
            let cost = fitted.chi2 + UNMATCHED * missing + fitted.prior_cost;
            found.push(Optimum { cost, start, fitted });
        }
    }
    // An unstable sort allocates nothing.
    found.sort_unstable_by(|a, b| a.cost.total_cmp(&b.cost).then(a.start.cmp(&b.start)));
}

/// The best optimum that is another pose than the first.
fn second(found: &[Optimum]) -> Option<&Optimum> {
    let (first, others) = found.split_first()?;
    others.iter().find(|other| !is_same(&first.fitted.motion, &other.fitted.motion.pose))
}

/// Whether the best optimum recognizes a contact of this many points; `None` without any.
pub(super) fn judge(found: &[Optimum], points: usize) -> Option<RecognitionStatus> {
    let best = found.first()?;
    let count = f64::from(best.fitted.matched);
    let largest = 1.0 + ONE_IN_A_HUNDRED * sqrt(2.0 / count.max(1.0));
    Some(if best.fitted.matched < MIN_MATCHED || count < MIN_SHARE * points as f64 {
        RecognitionStatus::TooLittle
    } else if !(best.fitted.mean_square() <= largest) {
        RecognitionStatus::Misfit
    } else if second(found).is_some_and(|other| other.cost - best.cost < CLEAR) {
        RecognitionStatus::Ambiguous
    } else {
        RecognitionStatus::Found
    })
}

/// Whether a pose is within the errors of a motion.
fn is_same(motion: &RigidMotion, pose: &Pose) -> bool {
    let to = Pose::from_translation_mm(-motion.about_mm);
    let (omega, v) = (to * *pose * motion.pose.inverse() * to.inverse()).log();
    let off = [omega.x, omega.y, omega.z, v.x, v.y, v.z];
    let squared = |covariance: &Symmetric<6>| {
        let solved = Factor::new(covariance)?.solve(&off);
        Some((0..6).map(|i| off[i] * solved[i]).sum::<f64>())
    };
    squared(&motion.covariance).is_some_and(|squared| squared < SAME)
}
