//! The robot task: poses, speeds and limits.

use super::ConfigError;
use super::range::{ANGLE_RAD, FAR_MM, FULL_TURN_RAD, LENGTH_MM, SPEED_MM_S, TIME_S, check};
use gelstereo_core::frames::FingerKinematics;
use gelstereo_core::math::{DVec3, Pose, so3};
use serde::{Deserialize, Serialize};

/// A pose in a file: position and rotation vector.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseConfig {
    /// Origin of the inner frame in the outer one.
    pub position_mm: [f64; 3],
    /// Rotation vector: axis times angle. Default: none.
    #[serde(default)]
    pub rotation_rad: [f64; 3],
}

impl PoseConfig {
    /// As a rigid motion.
    #[must_use]
    pub fn pose(&self) -> Pose {
        Pose {
            rotation: so3::exp(DVec3::from_array(self.rotation_rad)),
            translation_mm: DVec3::from_array(self.position_mm),
        }
    }

    pub(super) fn validate(&self, name: &'static str) -> Result<(), ConfigError> {
        for found in self.position_mm {
            check(found.abs() <= FAR_MM, name, found, "positions up to 10000 mm")?;
        }
        for found in self.rotation_rad {
            check(
                found.abs() <= FULL_TURN_RAD,
                name,
                found,
                "rotation vectors up to a full turn, 6.2832 rad",
            )?;
        }
        Ok(())
    }
}

/// The job: grasp the part, find it in the hand, align it, insert it. The base frame has z upwards.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TaskConfig {
    /// Where the part is expected before it is grasped (`t_base_object`).
    pub part_pose: PoseConfig,
    /// How far it may be from there, one standard deviation per axis. What the contact does not determine stays at
    /// the expectation with this uncertainty. Default: `0.6` mm.
    pub part_sigma_mm: f64,
    /// The same for its rotation. Default: `0.03` rad.
    pub part_sigma_rad: f64,
    /// Where the gripper closes (`t_base_gripper`).
    pub grasp_pose: PoseConfig,
    /// Where the part is when it is inserted (`t_base_object`): the template pose of the hole.
    pub goal_pose: PoseConfig,
    /// Direction of insertion in the part's frame. Default: `[0, 0, -1]`.
    pub insertion_axis: [f64; 3],
    /// Length of the way from the rim of the hole to the goal. Default: `10` mm.
    pub insertion_depth_mm: f64,
    /// The part is aligned this far above the rim. Default: `3` mm.
    pub approach_mm: f64,
    /// The robot gives up this far beyond the goal when nothing stops it. Default: `4` mm.
    pub overtravel_mm: f64,
    /// How far the part is lifted out of its holder. Default: `45` mm.
    pub lift_mm: f64,
    /// Opening before the gripper closes. Default: `14` mm.
    pub open_width_mm: f64,
    /// Default: `150` mm/s, the fastest of a Robotiq 2F-85.
    pub opening_speed_mm_s: f64,
    /// Default: `20` mm/s, the slowest of a Robotiq 2F-85.
    pub closing_speed_mm_s: f64,
    /// Share of the gripper's range, 0 to 1. Default: `0.2`.
    pub closing_force: f64,
    /// Speed of free moves. Default: `400` mm/s.
    pub move_speed_mm_s: f64,
    /// Default: `10` mm/s.
    pub insertion_speed_mm_s: f64,
    /// How long to wait for a stereo pair. Default: `2` s.
    pub frame_timeout_s: f64,
    /// The job breaks off when one stage takes longer, on the frame source's clock. Default: `120` s.
    pub stage_timeout_s: f64,
    /// So many stereo pairs in a row may show no markers (black, covered, blurred) before the job breaks off. While they
    /// last nothing is felt: at 30 Hz and 10 mm/s the part moves 0.33 mm with each. Default: `2`.
    pub max_bad_frames: u32,
}

impl Default for TaskConfig {
    fn default() -> Self {
        let at = |position_mm| PoseConfig { position_mm, rotation_rad: [0.0; 3] };
        Self {
            part_pose: at([400.0, -60.0, 20.0]),
            part_sigma_mm: 0.6,
            part_sigma_rad: 0.03,
            // Fingers down, the pads of a 2F-85 that is 8 mm open 5 mm above the middle of the peg.
            grasp_pose: PoseConfig {
                position_mm: [400.0, -60.0, 169.4],
                rotation_rad: [core::f64::consts::PI, 0.0, 0.0],
            },
            goal_pose: at([400.0, 60.0, 10.0]),
            insertion_axis: [0.0, 0.0, -1.0],
            insertion_depth_mm: 10.0,
            approach_mm: 3.0,
            overtravel_mm: 4.0,
            lift_mm: 45.0,
            open_width_mm: 14.0,
            opening_speed_mm_s: 150.0,
            closing_speed_mm_s: 20.0,
            closing_force: 0.2,
            move_speed_mm_s: 400.0,
            insertion_speed_mm_s: 10.0,
            frame_timeout_s: 2.0,
            stage_timeout_s: 120.0,
            max_bad_frames: 2,
        }
    }
}

impl TaskConfig {
    pub(super) fn validate(&self, kinematics: &FingerKinematics) -> Result<(), ConfigError> {
        let t = self;
        let poses = [
            ("task.part_pose", t.part_pose),
            ("task.grasp_pose", t.grasp_pose),
            ("task.goal_pose", t.goal_pose),
        ];
        for (name, pose) in poses {
            pose.validate(name)?;
        }
        let within = [
            ("task.part_sigma_mm", t.part_sigma_mm, LENGTH_MM),
            ("task.part_sigma_rad", t.part_sigma_rad, ANGLE_RAD),
            ("task.insertion_depth_mm", t.insertion_depth_mm, LENGTH_MM),
            ("task.approach_mm", t.approach_mm, LENGTH_MM),
            ("task.overtravel_mm", t.overtravel_mm, LENGTH_MM),
            ("task.lift_mm", t.lift_mm, LENGTH_MM),
            ("task.opening_speed_mm_s", t.opening_speed_mm_s, SPEED_MM_S),
            ("task.closing_speed_mm_s", t.closing_speed_mm_s, SPEED_MM_S),
            ("task.move_speed_mm_s", t.move_speed_mm_s, SPEED_MM_S),
            ("task.insertion_speed_mm_s", t.insertion_speed_mm_s, SPEED_MM_S),
            ("task.frame_timeout_s", t.frame_timeout_s, TIME_S),
            ("task.stage_timeout_s", t.stage_timeout_s, TIME_S),
        ];
        for (name, found, range) in within {
            range.check(name, found)?;
        }
        check((0.0..=1.0).contains(&t.closing_force), "task.closing_force", t.closing_force, "0 to 1")?;
        let length = DVec3::from_array(t.insertion_axis).length();
        check(length > 1e-6 && length.is_finite(), "task.insertion_axis", length, "a direction, not zero")?;
        let (min_mm, max_mm) = kinematics.width_range_mm();
        let opens = t.open_width_mm > min_mm && t.open_width_mm <= max_mm;
        check(opens, "task.open_width_mm", t.open_width_mm, "a width that mount.kinematics can have")
    }
}
