//! Rigid motions.

use super::so3::{self, RotationError};
use super::{DMat3, DQuat, DVec3};
use core::ops::Mul;

/// A rigid motion x ↦ R x + t; as `t_a_b` it maps coordinates of frame b to frame a.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Unit quaternion of R.
    pub rotation: DQuat,
    /// t, in millimetres.
    pub translation_mm: DVec3,
}

/// Why a 4x4 matrix is not a rigid motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PoseError {
    /// The upper left 3x3 is not a rotation.
    Rotation(RotationError),
    /// The translation has a NaN or infinite component.
    TranslationNotFinite,
    /// An entry of the matrix is NaN or infinite.
    NotFinite {
        /// Row of the first one.
        row: usize,
        /// Its column.
        column: usize,
        /// What it is.
        value: f64,
        /// How many of the 16 are not finite.
        count: usize,
    },
    /// A file's quaternion is far from unit length, so it is probably another quantity.
    QuaternionLength {
        /// Its length.
        length: f64,
    },
    /// The last row is not (0, 0, 0, 1).
    LastRow([f64; 4]),
}

impl core::fmt::Display for PoseError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Rotation(error) => error.fmt(f),
            Self::TranslationNotFinite => {
                write!(f, "the translation has a component that is NaN or infinite")
            }
            Self::NotFinite { row, column, value, count } => write!(
                f,
                "{count} of 16 entries are NaN or infinite, the first of them in row {row}, column {column}: \
                 {value}; valid is a rotation and a translation in finite numbers: does it come from a fit \
                 that failed?"
            ),
            Self::QuaternionLength { length } => write!(
                f,
                "the rotation rotation_xyzw has length {length}; valid is a unit quaternion, or one of \
                 length 0.5 to 2, which is brought to 1"
            ),
            Self::LastRow(row) => write!(
                f,
                "the last row is {row:?}; a pose is a 4x4 matrix with rows, whose last row is [0, 0, 0, 1] \
                 (is it transposed?)"
            ),
        }
    }
}

impl core::error::Error for PoseError {}

impl From<RotationError> for PoseError {
    fn from(error: RotationError) -> Self {
        Self::Rotation(error)
    }
}

impl Pose {
    /// The identity motion.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation_mm: DVec3::ZERO };

    /// A pure translation.
    #[must_use]
    pub const fn from_translation_mm(translation_mm: DVec3) -> Self {
        Self { rotation: DQuat::IDENTITY, translation_mm }
    }

    /// From the rows of a homogeneous 4x4 matrix.
    ///
    /// # Errors
    /// [`PoseError`] when the matrix is not a rigid motion: scaled, sheared, reflected, transposed or not
    /// finite.
    pub fn from_rows(rows: &[[f64; 4]; 4]) -> Result<Self, PoseError> {
        let bad = || rows.as_flattened().iter().enumerate().filter(|(_, x)| !x.is_finite());
        if let Some((first, &value)) = bad().next() {
            return Err(PoseError::NotFinite {
                row: first / 4,
                column: first % 4,
                value,
                count: bad().count(),
            });
        }
        if rows[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(PoseError::LastRow(rows[3]));
        }
        let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]);
        let rotation = so3::from_matrix(&DMat3::from_cols(column(0), column(1), column(2)))?;
        Ok(Self { rotation, translation_mm: column(3) })
    }

    /// Rows of the homogeneous 4x4 matrix.
    #[must_use]
    pub fn to_rows(&self) -> [[f64; 4]; 4] {
        let r = self.matrix();
        let t = self.translation_mm;
        let row = |i: usize| [r.x_axis[i], r.y_axis[i], r.z_axis[i], t[i]];
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }

    /// R as a matrix.
    #[must_use]
    pub fn matrix(&self) -> DMat3 {
        DMat3::from_quat(self.rotation)
    }

    /// The inverse motion.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self { rotation, translation_mm: -(rotation * self.translation_mm) }
    }

    /// R x + t.
    #[must_use]
    pub fn transform_point(&self, point_mm: DVec3) -> DVec3 {
        self.rotation * point_mm + self.translation_mm
    }

    /// R v, for directions and differences.
    #[must_use]
    pub fn transform_vector(&self, vector: DVec3) -> DVec3 {
        self.rotation * vector
    }

    /// The same motion with a unit quaternion and w >= 0; use it after long chains of products.
    ///
    /// # Errors
    /// [`PoseError`] when the quaternion has no direction or a component is not finite.
    pub fn normalized(&self) -> Result<Self, PoseError> {
        if !self.translation_mm.is_finite() {
            return Err(PoseError::TranslationNotFinite);
        }
        Ok(Self { rotation: so3::canonical(self.rotation)?, translation_mm: self.translation_mm })
    }

    /// Exponential of the twist (ω, v): rotation by ω (radians), translation V(ω) v (millimetres).
    #[must_use]
    pub fn exp(omega: DVec3, v_mm: DVec3) -> Self {
        Self { rotation: so3::exp(omega), translation_mm: so3::left_jacobian(omega) * v_mm }
    }

    /// Twist (ω, v) with `Pose::exp(ω, v) == self` and |ω| <= π.
    #[must_use]
    pub fn log(&self) -> (DVec3, DVec3) {
        let omega = so3::log(self.rotation);
        (omega, so3::left_jacobian_inverse(omega) * self.translation_mm)
    }
}

impl Mul for Pose {
    type Output = Self;

    /// `t_a_b * t_b_c` is `t_a_c`.
    fn mul(self, right: Self) -> Self {
        Self {
            rotation: self.rotation * right.rotation,
            translation_mm: self.rotation * right.translation_mm + self.translation_mm,
        }
    }
}

/// File format of a pose: a quaternion, because a matrix does not round-trip bit for bit.
#[cfg(feature = "serde")]
#[derive(serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseFields {
    /// Rotation as a unit quaternion x y z w. Valid: -2 to 2, and a length of about 1. Change it with the
    /// mounting.
    rotation_xyzw: [f64; 4],
    /// Origin of the inner frame in the outer one. Valid: -1000 to 1000 mm. Change it with the
    /// mounting.
    translation_mm: [f64; 3],
}

/// Accepted in files: the above, or the four rows of a homogeneous matrix.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
#[serde(
    untagged,
    expecting = "a pose is { rotation_xyzw = [x, y, z, w], translation_mm = [x, y, z] } or 4 rows of 4"
)]
enum PoseForms {
    Fields(PoseFields),
    Rows([[f64; 4]; 4]),
}

#[cfg(feature = "serde")]
impl serde::Serialize for Pose {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (rotation_xyzw, translation_mm) = (self.rotation.to_array(), self.translation_mm.to_array());
        PoseFields { rotation_xyzw, translation_mm }.serialize(serializer)
    }
}

#[cfg(feature = "serde")]
impl<'de> serde::Deserialize<'de> for Pose {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let pose = match PoseForms::deserialize(deserializer)? {
            PoseForms::Rows(rows) => Self::from_rows(&rows),
            PoseForms::Fields(fields) => Self::from_fields(&fields),
        };
        pose.map_err(serde::de::Error::custom)
    }
}

#[cfg(feature = "serde")]
impl Pose {
    fn from_fields(fields: &PoseFields) -> Result<Self, PoseError> {
        let rotation = DQuat::from_array(fields.rotation_xyzw);
        let pose = Self { rotation, translation_mm: DVec3::from_array(fields.translation_mm) };
        // Quaternions written by this type are kept bit for bit; others are normalised.
        let written = (rotation.length_squared() - 1.0).abs() <= 4.0 * f64::EPSILON;
        let normalized = pose.normalized()?;
        let length = rotation.length();
        if !(0.5..=2.0).contains(&length) {
            return Err(PoseError::QuaternionLength { length });
        }
        Ok(if written { pose } else { normalized })
    }
}
