//! Transforms from the sensor to the robot's base (Eq. 8).
//!
//! ```text
//! base --t_base_gripper--> gripper --t_gripper_sensor(width)--> sensor --t_sensor_object--> object
//! ```
//! The gripper frame has its origin at the mount, z along the fingers towards their tips and x along the
//! closing direction, towards the finger that carries the sensor. The pad frame is parallel to it, with
//! its origin in the middle of that finger's pad.

use crate::math::{DMat3, DQuat, DVec3, Pose, acos, atan2, cos, hypot, sin};

/// How a finger's pad moves with the opening width.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)
)]
pub enum FingerKinematics {
    /// Fingers that slide along x: the pad is at x = width / 2 and z = `reach_mm`.
    Parallel {
        /// Distance of the pad's middle from the mount. Valid: -1000 to 1000 mm. Change it to your gripper's
        /// own.
        reach_mm: f64,
        /// Largest opening. Valid: 0.1 to 1000 mm. Change it to your gripper's own.
        max_width_mm: f64,
    },
    /// Four-bar fingers: the pads stay parallel, but advance along z while they close.
    ///
    /// With the crank at θ from open (0) to `max_theta_rad`:
    /// width = 2 (offset + a cos θ - b sin θ), z = reach + a sin θ + b cos θ.
    Parallelogram {
        /// Crank's share along x when open. Valid: 0 to 1000 mm. Change it to your gripper's own.
        a_mm: f64,
        /// Crank's share along z when open. Valid: 0 to 1000 mm. Change it to your gripper's own.
        b_mm: f64,
        /// Constant part of half the width. Valid: -1000 to 1000 mm. Change it to your gripper's own.
        offset_mm: f64,
        /// Constant part of the pad's z. Valid: -1000 to 1000 mm. Change it to your gripper's own.
        reach_mm: f64,
        /// Crank angle when closed. Valid: 0.001 to 1.57 rad. Change it to your gripper's own.
        max_theta_rad: f64,
    },
}

impl FingerKinematics {
    /// The ideal parallelogram of a Robotiq 2F-85: 85.4 mm open, 0.9 mm closed, 13.9 mm of advance. The
    /// link lengths are those shared by simulation models of it. A real gripper needs its own values.
    #[must_use]
    pub const fn robotiq_2f85() -> Self {
        Self::Parallelogram {
            a_mm: 37.6,
            b_mm: 43.0,
            offset_mm: 5.0808,
            reach_mm: 87.324,
            max_theta_rad: 0.8,
        }
    }

    /// Robotiq 2F-140: cranks of 100 mm as in published models of it, over the manufacturer's stroke.
    #[must_use]
    pub const fn robotiq_2f140() -> Self {
        Self::Parallelogram {
            a_mm: 70.369,
            b_mm: 71.051,
            offset_mm: -0.369,
            reach_mm: 100.66,
            max_theta_rad: 0.7768,
        }
    }

    /// OnRobot RG2 without fingertips: cranks of 55 mm as in the manufacturer's model, over its stroke.
    #[must_use]
    pub const fn on_robot_rg2() -> Self {
        Self::Parallelogram {
            a_mm: 52.5,
            b_mm: 16.394,
            offset_mm: 2.5,
            reach_mm: 159.84,
            max_theta_rad: 1.3135,
        }
    }

    /// OnRobot RG6 without fingertips: cranks of 80 mm as in the manufacturer's model, over its stroke.
    #[must_use]
    pub const fn on_robot_rg6() -> Self {
        Self::Parallelogram {
            a_mm: 75.8,
            b_mm: 25.58,
            offset_mm: 4.2,
            reach_mm: 183.2,
            max_theta_rad: 1.2977,
        }
    }

    /// Checks that the numbers describe valid fingers.
    ///
    /// # Errors
    /// [`MountError`] naming the field.
    pub fn validate(&self) -> Result<(), MountError> {
        let check = MountError::check;
        let place = |field, mm: f64| check(mm.abs() <= FAR_MM, field, mm, "-1000 to 1000 mm");
        let link = |field, mm: f64| check((0.0..=FAR_MM).contains(&mm), field, mm, "0 to 1000 mm");
        match *self {
            Self::Parallel { reach_mm, max_width_mm } => {
                place("kinematics.reach_mm", reach_mm)?;
                let ok = (0.1..=FAR_MM).contains(&max_width_mm);
                check(ok, "kinematics.max_width_mm", max_width_mm, "0.1 to 1000 mm")
            }
            Self::Parallelogram { a_mm, b_mm, offset_mm, reach_mm, max_theta_rad } => {
                link("kinematics.a_mm", a_mm)?;
                link("kinematics.b_mm", b_mm)?;
                place("kinematics.offset_mm", offset_mm)?;
                place("kinematics.reach_mm", reach_mm)?;
                let (turn, valid) = (max_theta_rad, "0.001 to 1.57 rad");
                check((1e-3..=MAX_THETA_RAD).contains(&turn), "kinematics.max_theta_rad", turn, valid)?;
                let (min_mm, max_mm) = self.width_range_mm();
                let valid = "such that the fingers open, by a_mm and offset_mm";
                check(max_mm > min_mm.max(0.1), "kinematics.offset_mm", offset_mm, valid)
            }
        }
    }

    /// Smallest and largest opening width.
    #[must_use]
    pub fn width_range_mm(&self) -> (f64, f64) {
        match *self {
            Self::Parallel { max_width_mm, .. } => (0.0, max_width_mm),
            Self::Parallelogram { a_mm, b_mm, offset_mm, max_theta_rad, .. } => {
                let width = |theta: f64| 2.0 * (offset_mm + a_mm * cos(theta) - b_mm * sin(theta));
                (width(max_theta_rad), width(0.0))
            }
        }
    }

    /// Middle of the sensing pad in the gripper frame.
    ///
    /// # Errors
    /// [`WidthError`] for a width that the fingers cannot reach.
    pub fn pad_mm(&self, width_mm: f64) -> Result<DVec3, WidthError> {
        let (min_mm, max_mm) = self.width_range_mm();
        if !(width_mm >= min_mm && width_mm <= max_mm) {
            return Err(WidthError { width_mm, min_mm, max_mm });
        }
        let z = match *self {
            Self::Parallel { reach_mm, .. } => reach_mm,
            Self::Parallelogram { a_mm, b_mm, offset_mm, reach_mm, .. } => {
                // a cos θ - b sin θ = R cos(θ + φ) with R = |(a, b)|, φ = atan2(b, a).
                let cosine = (0.5 * width_mm - offset_mm) / hypot(a_mm, b_mm);
                let theta = acos(cosine.clamp(-1.0, 1.0)) - atan2(b_mm, a_mm);
                reach_mm + a_mm * sin(theta) + b_mm * cos(theta)
            }
        };
        Ok(DVec3::new(0.5 * width_mm, 0.0, z))
    }
}

/// Pose of the sensor in the gripper.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct SensorMount {
    /// Motion of the pad that carries the sensor. Default: a Robotiq 2F-85. Change it to your gripper's.
    pub kinematics: FingerKinematics,
    /// Maps sensor coordinates to pad coordinates: rotation as a unit quaternion and translation in
    /// millimetres, or four rows of a matrix. Change it to where your sensor is mounted.
    pub t_pad_sensor: Pose,
}

/// An invalid number in a mount.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountError {
    /// Which field, for example `kinematics.reach_mm`.
    pub field: &'static str,
    /// What was found.
    pub found: f64,
    /// What would be valid.
    pub valid: &'static str,
}

impl core::fmt::Display for MountError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} is {}; valid is {}", self.field, self.found, self.valid)
    }
}

impl core::error::Error for MountError {}

impl MountError {
    fn check(ok: bool, field: &'static str, found: f64, valid: &'static str) -> Result<(), Self> {
        if ok { Ok(()) } else { Err(Self { field, found, valid }) }
    }
}

/// Longer than any gripper's finger: one metre.
const FAR_MM: f64 = 1e3;

/// Largest crank angle, just below a right angle; beyond it the fingers would open again.
const MAX_THETA_RAD: f64 = 1.57;

/// A width that the gripper cannot reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WidthError {
    /// Width found.
    pub width_mm: f64,
    /// Smallest valid.
    pub min_mm: f64,
    /// Largest valid.
    pub max_mm: f64,
}

impl core::fmt::Display for WidthError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { width_mm, min_mm, max_mm } = self;
        write!(
            f,
            "the opening width is {width_mm:.3} mm; this gripper can have {min_mm:.3} to {max_mm:.3} mm"
        )
    }
}

impl core::error::Error for WidthError {}

impl SensorMount {
    /// A sensor with its gel surface at the pad's middle, facing the other finger across the gap. Its z
    /// axis is the gripper's -x; its y axis (down in the image) is the gripper's z.
    ///
    /// `gel_centre_mm` is the middle of the undeformed gel surface in the sensor frame.
    #[must_use]
    pub fn facing(kinematics: FingerKinematics, gel_centre_mm: DVec3) -> Self {
        let rotation = DQuat::from_mat3(&DMat3::from_cols(-DVec3::Y, DVec3::Z, -DVec3::X));
        Self { kinematics, t_pad_sensor: Pose { rotation, translation_mm: -(rotation * gel_centre_mm) } }
    }

    /// Checks that the numbers describe a valid mount.
    ///
    /// # Errors
    /// [`MountError`] naming the field.
    pub fn validate(&self) -> Result<(), MountError> {
        self.kinematics.validate()?;
        for found in self.t_pad_sensor.translation_mm.to_array() {
            let ok = found.abs() <= FAR_MM;
            MountError::check(ok, "t_pad_sensor.translation_mm", found, "-1000 to 1000 mm")?;
        }
        let length = self.t_pad_sensor.rotation.length();
        let unit = (length - 1.0).abs() < 1e-9;
        MountError::check(unit, "t_pad_sensor.rotation_xyzw", length, "a quaternion of length 1")
    }

    /// gTgs of Eq. 8: maps sensor coordinates to gripper coordinates at this opening width.
    ///
    /// # Errors
    /// [`WidthError`] for a width that the gripper cannot reach.
    pub fn t_gripper_sensor(&self, width_mm: f64) -> Result<Pose, WidthError> {
        Ok(Pose::from_translation_mm(self.kinematics.pad_mm(width_mm)?) * self.t_pad_sensor)
    }
}

/// Gripper pose that brings the held object to `t_base_goal`: the adjustment between the in-hand pose and the
/// template pose (section V-A), for an object that is rigid in the hand.
#[must_use]
pub fn adjusted_gripper(t_base_goal: &Pose, t_gripper_object: &Pose) -> Pose {
    *t_base_goal * t_gripper_object.inverse()
}
