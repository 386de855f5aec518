//! Rotations: exponential, logarithm and the left Jacobian of SO(3), stable at 0 and at π.
//!
//! Formulas: T. Barfoot, *State Estimation for Robotics* (2017), chapter 7. Coefficients are evaluated
//! without cancellation: as a product of sines if possible, otherwise as an alternating series.

use super::{DMat3, DQuat, DVec3, atan2, cos, sin, sqrt};

/// Why four numbers are not a rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RotationError {
    /// A component is NaN or infinite.
    NotFinite,
    /// The quaternion's norm is too small to define a direction.
    ZeroNorm {
        /// The norm found.
        norm: f64,
    },
    /// The 3x3 matrix is not orthonormal with determinant +1.
    NotOrthonormal {
        /// Largest entry of |R Rᵀ - I|.
        deviation: f64,
        /// Determinant found; +1 is valid, -1 is a reflection.
        determinant: f64,
    },
}

impl core::fmt::Display for RotationError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotFinite => write!(f, "the rotation has a component that is NaN or infinite"),
            Self::ZeroNorm { norm } => {
                write!(f, "the quaternion's norm is {norm:e}; a rotation needs a norm near 1 (x, y, z, w)")
            }
            Self::NotOrthonormal { deviation, determinant } => write!(
                f,
                "the 3x3 part is no rotation: R Rᵀ is {deviation:.3e} off the identity and the determinant \
                 is {determinant:.6}; valid is a deviation below {ORTHONORMAL_TOLERANCE:e} and determinant +1"
            ),
        }
    }
}

impl core::error::Error for RotationError {}

/// Tolerance for R Rᵀ - I: single-precision files (6e-8) pass, a scaled or sheared matrix does not.
pub const ORTHONORMAL_TOLERANCE: f64 = 1e-6;

/// Unit quaternion with w >= 0 from any quaternion that has a direction.
///
/// # Errors
/// [`RotationError::NotFinite`], or [`RotationError::ZeroNorm`] below a norm of 1e-150 (its square
/// underflows).
pub fn canonical(q: DQuat) -> Result<DQuat, RotationError> {
    if !q.is_finite() {
        return Err(RotationError::NotFinite);
    }
    let scale = q.x.abs().max(q.y.abs()).max(q.z.abs()).max(q.w.abs());
    if scale < 1e-150 {
        return Err(RotationError::ZeroNorm { norm: scale });
    }
    let (x, y, z, w) = (q.x / scale, q.y / scale, q.z / scale, q.w / scale);
    let norm = sqrt(x * x + y * y + z * z + w * w);
    // q and -q are the same rotation. At exactly π (w = 0) the first non-zero component decides.
    let negative = w < 0.0 || (w == 0.0 && (x < 0.0 || (x == 0.0 && (y < 0.0 || (y == 0.0 && z < 0.0)))));
    let signed = if negative { -norm } else { norm };
    Ok(DQuat::from_xyzw(x / signed, y / signed, z / signed, w / signed))
}

/// Rotation by |ω| radians about ω.
#[must_use]
pub fn exp(omega: DVec3) -> DQuat {
    let half = 0.5 * norm(omega);
    let v = omega * (0.5 * sinc(half));
    DQuat::from_xyzw(v.x, v.y, v.z, cos(half))
}

/// Rotation vector of a unit quaternion, of length at most π. Inverse of [`exp`] on |ω| <= π.
#[must_use]
pub fn log(q: DQuat) -> DVec3 {
    let q = if q.w < 0.0 { -q } else { q };
    let v = DVec3::new(q.x, q.y, q.z);
    let n = norm(v);
    if n == 0.0 {
        return DVec3::ZERO;
    }
    // atan2 keeps full relative accuracy at both ends: n / w near 0; near π the angle's error is that of w.
    v * (2.0 * atan2(n, q.w) / n)
}

/// Unit quaternion of a rotation matrix (Shepperd's choice of the largest component, exact at π).
///
/// # Errors
/// [`RotationError::NotFinite`] or [`RotationError::NotOrthonormal`].
pub fn from_matrix(r: &DMat3) -> Result<DQuat, RotationError> {
    if !r.is_finite() {
        return Err(RotationError::NotFinite);
    }
    let gram = *r * r.transpose();
    let deviation =
        (gram - DMat3::IDENTITY).to_cols_array().iter().fold(0.0_f64, |worst, e| worst.max(e.abs()));
    let determinant = r.determinant();
    if !(deviation < ORTHONORMAL_TOLERANCE && determinant > 0.0) {
        return Err(RotationError::NotOrthonormal { deviation, determinant });
    }
    let m = |row: usize, col: usize| r.col(col)[row];
    let trace = m(0, 0) + m(1, 1) + m(2, 2);
    let q = if trace > m(0, 0).max(m(1, 1)).max(m(2, 2)) {
        DQuat::from_xyzw(m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1), 1.0 + trace)
    } else {
        let i = if m(0, 0) >= m(1, 1) && m(0, 0) >= m(2, 2) {
            0
        } else if m(1, 1) >= m(2, 2) {
            1
        } else {
            2
        };
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let mut xyz = [0.0; 3];
        xyz[i] = 1.0 + m(i, i) - m(j, j) - m(k, k);
        xyz[j] = m(j, i) + m(i, j);
        xyz[k] = m(k, i) + m(i, k);
        DQuat::from_xyzw(xyz[0], xyz[1], xyz[2], m(k, j) - m(j, k))
    };
    canonical(q)
}

/// The matrix of the cross product: `hat(ω) v = ω × v`.
#[must_use]
pub fn hat(omega: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(0.0, omega.z, -omega.y),
        DVec3::new(-omega.z, 0.0, omega.x),
        DVec3::new(omega.y, -omega.x, 0.0),
    )
}

/// Left Jacobian V of SO(3): exp((ω + δ)) ≈ exp(V δ) exp(ω), and the translation of an SE(3) exponential
/// is V v.
#[must_use]
pub fn left_jacobian(omega: DVec3) -> DMat3 {
    let theta = norm(omega);
    let half_sinc = sinc(0.5 * theta);
    let b = 0.5 * half_sinc * half_sinc; // (1 - cos θ) / θ²
    let k = hat(omega);
    DMat3::IDENTITY + k * b + k * k * third_coefficient(theta)
}

/// Inverse of [`left_jacobian`], for |ω| < 2π.
#[must_use]
pub fn left_jacobian_inverse(omega: DVec3) -> DMat3 {
    let h = 0.5 * norm(omega);
    // (1 - h cot h) / θ² = S(h²) / (4 sinc h), with S = (sin h - h cos h) / h³ as a series: no cancellation.
    let d = if h < 2.0 {
        sine_minus_cosine_series(h * h) / (4.0 * sinc(h))
    } else {
        (1.0 - h * cos(h) / sin(h)) / (4.0 * h * h)
    };
    let k = hat(omega);
    DMat3::IDENTITY - k * 0.5 + k * k * d
}

/// sin x / x, 1 at 0. Correct to an ulp everywhere: the quotient does not cancel.
fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-9 { 1.0 } else { sin(x) / x }
}

/// (θ - sin θ) / θ³. Below 1.5 the difference loses digits, so the series 1/3! - θ²/5! + ... is used
/// instead (its first omitted term is 3e-17 there); above, the difference loses less than two bits.
fn third_coefficient(theta: f64) -> f64 {
    if theta > 1.5 {
        return (theta - sin(theta)) / (theta * theta * theta);
    }
    let t2 = theta * theta;
    let mut sum = 0.0;
    for k in (0..10).rev() {
        let (a, b) = ((2 * k + 4) as f64, (2 * k + 5) as f64);
        sum = 1.0 - t2 / (a * b) * sum;
    }
    sum / 6.0
}

/// (sin h - h cos h) / h³ = 1/3 - h²/30 + h⁴/840 - ..., from h². The error of 14 terms is 1e-19 at h = 2.
fn sine_minus_cosine_series(h2: f64) -> f64 {
    // term k (from 1) is 2k / (2k+1)! h^(2k-2); the ratio of term k+1 to term k is -h² / (2k (2k+3)).
    let mut sum = 0.0;
    for k in (1..15).rev() {
        let k = f64::from(k);
        sum = 1.0 - h2 / (2.0 * k * (2.0 * k + 3.0)) * sum;
    }
    sum / 3.0
}

/// Length, safe against underflow and overflow of the squares.
fn norm(v: DVec3) -> f64 {
    let scale = v.abs().max_element();
    if scale == 0.0 || (scale > 1e-140 && scale < 1e140) {
        return sqrt(v.length_squared());
    }
    scale * sqrt((v / scale).length_squared())
}
