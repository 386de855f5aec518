//! Fusion of two estimates of one pose, each with its information (Barfoot and Furgale 2014), and of an
//! estimate with a plane contact of a point of the part.
//!
//! In an estimate, the true pose is exp(e) T with e normal, of zero mean and information Λ. The fused
//! pose minimises e₁ᵀ Λ₁ e₁ + e₂ᵀ Λ₂ e₂, by Gauss-Newton on SE(3). Either information may be singular:
//! along free directions of one contact only the other estimate counts.

use crate::math::linalg::{Symmetric, eigen};
use crate::math::{DVec3, Pose, so3, sqrt};

/// A pose with its information matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseEstimate {
    /// Maps coordinates of frame b to frame a.
    pub pose: Pose,
    /// Information of a left perturbation (ω, v), rad and mm, in frame a: the true pose is exp(ω, v) `pose`.
    pub information: Symmetric<6>,
}

/// A plane that a point of the part touches: normal · (T point) = offset, with a standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneContact {
    /// The point, frame b, mm.
    pub point_mm: DVec3,
    /// Unit normal of the plane, frame a.
    pub normal: DVec3,
    /// Distance of the plane from the origin of frame a along the normal, mm.
    pub offset_mm: f64,
    /// Standard deviation of the point's distance from the plane, mm.
    pub sigma_mm: f64,
}

/// The pose fused from two sources.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusedPose {
    /// The fused pose, with its information. Along directions unknown to both it is the first one's.
    pub estimate: PoseEstimate,
    /// Minimum of the sum of eᵀ Λ e: the disagreement of the sources. For two correct estimates that
    /// determine all six directions it is chi-squared with six degrees of freedom. For a plane contact it
    /// has one degree of freedom, if the estimate determines the constrained direction.
    pub squared_distance: f64,
}

/// Why two estimates cannot be fused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FusionError {
    /// A component is NaN or infinite.
    NotFinite {
        /// Which estimate, 0 or 1.
        index: usize,
    },
    /// An information matrix is not symmetric, or is negative along a direction.
    Information {
        /// Which estimate, 0 or 1.
        index: usize,
    },
    /// A number of a plane contact is invalid.
    Plane {
        /// Which number.
        name: &'static str,
        /// Its value.
        found: f64,
        /// What is valid, in words.
        valid: &'static str,
    },
    /// The poses differ by more than two estimates of one part can.
    Apart {
        /// Angle between them, rad.
        turn_rad: f64,
    },
    /// The iterations did not converge: the estimates contradict each other.
    NotConverged {
        /// Rotation of the last step, rad.
        step_rad: f64,
        /// Translation of the last step, mm.
        step_mm: f64,
    },
}

/// Largest angle between fused estimates; the series of the Jacobian is truncated for angles up to this.
const MAX_TURN_RAD: f64 = 0.5;
/// Gauss-Newton converges in a few steps; contradictory estimates take more.
const MAX_STEPS: usize = 60;
/// Longest last step of a converged solution: a thousandth of the best accuracy of a contact, 1e-3 mm
/// and, over 10 mm, 1e-4 rad.
const MAX_REST_RAD: f64 = 1e-7;
/// As [`MAX_REST_RAD`], for translation.
const MAX_REST_MM: f64 = 1e-6;
/// Directions with less scaled information than this are free. Information about a part of size l,
/// transformed to a frame at distance L, has a round-off of 1e-16 (L / l)²: 1e-12 for a robot's base.
/// Heights are accurate to 1e-3 mm at best, so directions known to worse than 100 mm are ignored.
const FREE: f64 = 1e-10;

impl core::fmt::Display for FusionError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotFinite { index } => {
                write!(f, "estimate {index} has a component that is NaN or infinite; valid is finite")
            }
            Self::Information { index } => write!(
                f,
                "the information of estimate {index} is not symmetric and positive semidefinite; give the \
                 inverse of a covariance, or a registration's information"
            ),
            Self::Plane { name, found, valid } => {
                write!(f, "{name} of the plane contact is {found}; valid is {valid}")
            }
            Self::Apart { turn_rad } => write!(
                f,
                "the poses differ by {turn_rad:.3} rad; valid is up to {MAX_TURN_RAD} rad: are they of one \
                 part, and of the same one of its symmetric copies?"
            ),
            Self::NotConverged { step_rad, step_mm } => write!(
                f,
                "fusion did not come to rest in {MAX_STEPS} steps (the last one: {step_rad:.1e} rad, \
                 {step_mm:.1e} mm); the estimates contradict each other: are they of one part?"
            ),
        }
    }
}

impl core::error::Error for FusionError {}

impl PoseEstimate {
    /// The same estimate in another outer frame c, given `t_c_a`.
    #[must_use]
    pub fn in_frame(&self, t_c_a: &Pose) -> Self {
        let back = adjoint(&t_c_a.inverse());
        Self { pose: *t_c_a * self.pose, information: sandwiched(&self.information, &back) }
    }

    /// The same estimate after a random disturbance of the pose about a point of frame a: independent
    /// normal rotations about and translations along the axes of frame a, with these standard deviations.
    #[must_use]
    pub fn disturbed(&self, point_mm: DVec3, sigma_rad: DVec3, sigma_mm: DVec3) -> Self {
        let there = Pose::from_translation_mm(point_mm);
        let about = self.in_frame(&there.inverse());
        // (Λ⁻¹ + S²)⁻¹ = Λ - Λ S (I + S Λ S)⁻¹ S Λ, which needs no inverse of Λ.
        let sigma = |i: usize| if i < 3 { sigma_rad[i] } else { sigma_mm[i - 3] };
        let scaled: Symmetric<6> = matrix(|i, j| sigma(i) * about.information[i][j] * sigma(j));
        let parts = eigen(&scaled);
        let half: [[f64; 6]; 6] = matrix(|k, j| {
            let along: f64 = (0..6).map(|i| parts.vectors[k][i] * sigma(i) * about.information[i][j]).sum();
            along / sqrt(1.0 + parts.values[k].max(0.0))
        });
        let information =
            matrix(|i, j| about.information[i][j] - (0..6).map(|k| half[k][i] * half[k][j]).sum::<f64>());
        Self { pose: about.pose, information }.in_frame(&there)
    }
}

/// Fuses two estimates of one pose, in the same frames.
///
/// # Errors
/// [`FusionError`].
pub fn fuse_poses(first: &PoseEstimate, second: &PoseEstimate) -> Result<FusedPose, FusionError> {
    let estimates = [first, second];
    for (index, estimate) in estimates.into_iter().enumerate() {
        check(index, estimate)?;
    }
    let turn_rad = (second.pose * first.pose.inverse()).log().0.length();
    if !(turn_rad <= MAX_TURN_RAD) {
        return Err(FusionError::Apart { turn_rad });
    }
    settled(first.pose, |pose| Normal::at(pose, &estimates))
}

/// Fuses an estimate with a plane that a point of the part touches.
///
/// # Errors
/// [`FusionError`].
pub fn fuse_plane(estimate: &PoseEstimate, contact: &PlaneContact) -> Result<FusedPose, FusionError> {
    check(0, estimate)?;
    contact.check()?;
    settled(estimate.pose, |pose| {
        let mut normal = Normal::at(pose, &[estimate]);
        normal.add_plane(pose, contact);
        normal
    })
}

/// Gauss-Newton from a pose until the steps vanish.
fn settled(first: Pose, normal_at: impl Fn(&Pose) -> Normal) -> Result<FusedPose, FusionError> {
    let mut pose = first;
    let (mut step_rad, mut step_mm) = (0.0, 0.0);
    for _ in 0..MAX_STEPS {
        let normal = normal_at(&pose);
        let step = normal.step();
        let (omega, v) = (DVec3::new(step[0], step[1], step[2]), DVec3::new(step[3], step[4], step[5]));
        pose = Pose::exp(omega, v) * pose;
        pose.rotation = pose.rotation.normalize();
        (step_rad, step_mm) = (omega.length(), v.length());
        if step_rad < 1e-15 && step_mm < 1e-13 * (1.0 + pose.translation_mm.length()) {
            break;
        }
    }
    // The negated form also rejects NaN.
    if !(step_rad <= MAX_REST_RAD && step_mm <= MAX_REST_MM) {
        return Err(FusionError::NotConverged { step_rad, step_mm });
    }
    let normal = normal_at(&pose);
    Ok(FusedPose {
        estimate: PoseEstimate { pose, information: normal.information },
        squared_distance: normal.squared_distance,
    })
}

impl PlaneContact {
    /// The point's distance from the plane at a pose, mm.
    fn distance_mm(&self, pose: &Pose) -> f64 {
        self.normal.dot(pose.transform_point(self.point_mm)) - self.offset_mm
    }

    fn check(&self) -> Result<(), FusionError> {
        let refuse = |name, found, valid| Err(FusionError::Plane { name, found, valid });
        let length = self.normal.length();
        // The negated forms also reject NaN.
        if !((length - 1.0).abs() <= 1e-6) {
            return refuse("the length of normal", length, "1");
        }
        if !(self.sigma_mm > 0.0 && self.sigma_mm.is_finite()) {
            return refuse("sigma_mm", self.sigma_mm, "above 0 and finite");
        }
        if !self.offset_mm.is_finite() {
            return refuse("offset_mm", self.offset_mm, "finite");
        }
        match self.point_mm.to_array().into_iter().find(|x| !x.is_finite()) {
            Some(found) => refuse("a component of point_mm", found, "finite"),
            None => Ok(()),
        }
    }
}

fn check(index: usize, estimate: &PoseEstimate) -> Result<(), FusionError> {
    let information = &estimate.information;
    let finite = estimate.pose.translation_mm.is_finite()
        && estimate.pose.rotation.is_finite()
        && information.as_flattened().iter().all(|x| x.is_finite());
    if !finite {
        return Err(FusionError::NotFinite { index });
    }
    // Tolerance for round-off of a sum over some thousand points, transformed between frames.
    let scaled = scaled(information).matrix;
    let symmetric = (0..6).all(|i| (0..6).all(|j| (scaled[i][j] - scaled[j][i]).abs() <= 1e-9));
    if symmetric && eigen(&scaled).values[0] >= -1e-9 {
        Ok(())
    } else {
        Err(FusionError::Information { index })
    }
}

/// The Gauss-Newton normal equations at a pose.
struct Normal {
    information: Symmetric<6>,
    gradient: [f64; 6],
    squared_distance: f64,
}

impl Normal {
    fn at(pose: &Pose, estimates: &[&PoseEstimate]) -> Self {
        let mut normal = Self { information: [[0.0; 6]; 6], gradient: [0.0; 6], squared_distance: 0.0 };
        for estimate in estimates {
            let (omega, v) = (*pose * estimate.pose.inverse()).log();
            let error = [omega.x, omega.y, omega.z, v.x, v.y, v.z];
            let jacobian = left_jacobian_inverse(omega, v);
            let weighed: [f64; 6] =
                core::array::from_fn(|i| (0..6).map(|j| estimate.information[i][j] * error[j]).sum());
            let part = sandwiched(&estimate.information, &jacobian);
            for i in 0..6 {
                normal.gradient[i] += (0..6).map(|k| jacobian[k][i] * weighed[k]).sum::<f64>();
                (0..6).for_each(|j| normal.information[i][j] += part[i][j]);
                normal.squared_distance += error[i] * weighed[i];
            }
        }
        normal
    }

    /// A left perturbation (ω, v) moves the point q = T p by ω x q + v, and its distance by
    /// (q x n) · ω + n · v.
    fn add_plane(&mut self, pose: &Pose, contact: &PlaneContact) {
        let turn = pose.transform_point(contact.point_mm).cross(contact.normal);
        let n = contact.normal;
        let row = [turn.x, turn.y, turn.z, n.x, n.y, n.z].map(|x| x / contact.sigma_mm);
        let error = contact.distance_mm(pose) / contact.sigma_mm;
        for i in 0..6 {
            self.gradient[i] += row[i] * error;
            (0..6).for_each(|j| self.information[i][j] += row[i] * row[j]);
        }
        self.squared_distance += error * error;
    }

    /// The minimum-norm step to the minimum of the quadratic, by eigenvectors of the scaled information.
    fn step(&self) -> [f64; 6] {
        let Scaled { matrix, scale } = scaled(&self.information);
        let parts = eigen(&matrix);
        let mut step = [0.0; 6];
        for (value, vector) in parts.values.into_iter().zip(parts.vectors) {
            if value > FREE {
                let along: f64 = (0..6).map(|i| vector[i] * self.gradient[i] / scale[i]).sum();
                (0..6).for_each(|i| step[i] -= vector[i] * along / (value * scale[i]));
            }
        }
        step
    }
}

/// D⁻¹ M D⁻¹ and D's diagonal, so that the largest rotation and translation entries are 1; radians and
/// millimetres are not comparable otherwise. Scaling each entry alone would amplify the round-off of a
/// free one.
struct Scaled {
    matrix: Symmetric<6>,
    scale: [f64; 6],
}

fn scaled(information: &Symmetric<6>) -> Scaled {
    let largest = |from: usize| (from..from + 3).map(|i| information[i][i].abs()).fold(0.0, f64::max);
    let unit = |from: usize| if largest(from) > 0.0 { sqrt(largest(from)) } else { 1.0 };
    let units = [unit(0), unit(3)];
    let scale = core::array::from_fn(|i| units[i / 3]);
    Scaled { matrix: matrix(|i, j| information[i][j] / (scale[i] * scale[j])), scale }
}

/// Jᵀ M J, symmetric.
fn sandwiched(information: &Symmetric<6>, jacobian: &[[f64; 6]; 6]) -> Symmetric<6> {
    let half: [[f64; 6]; 6] = matrix(|i, j| (0..6).map(|k| information[i][k] * jacobian[k][j]).sum());
    let whole: [[f64; 6]; 6] = matrix(|i, j| (0..6).map(|k| jacobian[k][i] * half[k][j]).sum());
    matrix(|i, j| 0.5 * (whole[i][j] + whole[j][i]))
}

/// Maps twists (ω, v) through a pose: T exp(ξ) T⁻¹ = exp(Ad ξ).
fn adjoint(pose: &Pose) -> [[f64; 6]; 6] {
    let rotation = pose.matrix();
    let moved = so3::hat(pose.translation_mm) * rotation;
    matrix(|i, j| match (i < 3, j < 3) {
        (true, true) => rotation.col(j)[i],
        (true, false) => 0.0,
        (false, true) => moved.col(j)[i - 3],
        (false, false) => rotation.col(j - 3)[i - 3],
    })
}

/// Even Bernoulli numbers over factorials, B₂ₙ / (2n)! from n = 1 on. At [`MAX_TURN_RAD`] the next term is
/// below 1e-13.
const BERNOULLI: [f64; 6] = [
    1.0 / 12.0,
    -1.0 / 720.0,
    1.0 / 30_240.0,
    -1.0 / 1_209_600.0,
    1.0 / 47_900_160.0,
    -691.0 / 1_307_674_368_000.0,
];

/// Inverse of the left Jacobian of SE(3): I - ad / 2 + Σ B₂ₙ / (2n)! ad²ⁿ (Barfoot, State Estimation for
/// Robotics, 7.3).
fn left_jacobian_inverse(omega: DVec3, v: DVec3) -> [[f64; 6]; 6] {
    let (turn, shift) = (so3::hat(omega), so3::hat(v));
    let ad: [[f64; 6]; 6] = matrix(|i, j| match (i < 3, j < 3) {
        (true, true) => turn.col(j)[i],
        (true, false) => 0.0,
        (false, true) => shift.col(j)[i - 3],
        (false, false) => turn.col(j - 3)[i - 3],
    });
    let square: [[f64; 6]; 6] = product(&ad, &ad);
    let mut power: [[f64; 6]; 6] = matrix(|i, j| f64::from(u8::from(i == j)));
    let mut sum: [[f64; 6]; 6] = matrix(|i, j| power[i][j] - 0.5 * ad[i][j]);
    for coefficient in BERNOULLI {
        power = product(&power, &square);
        sum = matrix(|i, j| sum[i][j] + coefficient * power[i][j]);
    }
    sum
}

fn product(a: &[[f64; 6]; 6], b: &[[f64; 6]; 6]) -> [[f64; 6]; 6] {
    matrix(|i, j| (0..6).map(|k| a[i][k] * b[k][j]).sum())
}

fn matrix(entry: impl Fn(usize, usize) -> f64) -> [[f64; 6]; 6] {
    core::array::from_fn(|i| core::array::from_fn(|j| entry(i, j)))
}
