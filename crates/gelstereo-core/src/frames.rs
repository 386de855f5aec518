//! From the sensor to the robot's base (Eq. 8).

use crate::math::{DVec3, Pose};

/// How the sensor moves with the gripper's opening width.
///
/// The gripper frame has its origin at the mount, z along the fingers towards the tips, x along the closing direction
/// from the sensing finger's opposite finger to the sensing finger.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)
)]
pub enum FingerKinematics {
    /// Fingers that slide along x: the sensor stands at +width / 2.
    Parallel {},
    /// Four-bar fingers as the Robotiq 2F-85's: the pads stay parallel but advance along z while they close.
    Parallelogram {
        /// Lever arms of gap(θ) = 2 (offset_mm + a cos θ - b sin θ), z(θ) = a sin θ + b cos θ + z0, millimetres.
        a_mm: f64,
        /// Second lever arm.
        b_mm: f64,
        /// Half gap's constant part.
        offset_mm: f64,
        /// Constant part of the advance.
        z0_mm: f64,
    },
}

/// Where the sensor stands in the gripper.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct SensorMount {
    /// Motion of the finger pad.
    pub kinematics: FingerKinematics,
    /// Sensor frame in the pad's frame (the pad's frame is parallel to the gripper's).
    pub t_pad_sensor: Pose,
}

/// A width that the gripper cannot have.
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
        write!(f, "the opening width is {} mm; valid is {} to {} mm", self.width_mm, self.min_mm, self.max_mm)
    }
}

impl core::error::Error for WidthError {}

impl SensorMount {
    /// gTgs of Eq. 8: maps sensor coordinates to gripper coordinates at this opening width.
    ///
    /// # Errors
    /// [`WidthError`].
    pub fn t_gripper_sensor(&self, width_mm: f64) -> Result<Pose, WidthError> {
        let _ = (width_mm, DVec3::ZERO);
        unimplemented!()
    }
}

/// Gripper pose that brings the held object to `t_base_goal`: the adjustment between the in-hand pose and the
/// template pose (section V-A), with the object rigid in the hand.
#[must_use]
pub fn adjusted_gripper(t_base_goal: &Pose, t_gripper_object: &Pose) -> Pose {
    *t_base_goal * t_gripper_object.inverse()
}
