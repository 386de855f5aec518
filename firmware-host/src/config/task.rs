//! The robot task: poses, speeds and limits.

use super::range::{
    CLEARANCE_MM, FAR_MM, FULL_TURN_RAD, LENGTH_MM, PERIODS, SIGMA_MM, SIGMA_RAD, SIGMAS, SPEED_MM_S,
    STAGE_S, TIME_S, check,
};
use super::{ConfigError, EdgeConfig};
use gelstereo_core::frames::FingerKinematics;
use gelstereo_core::math::{DVec3, Pose, so3};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A pose in a file: position and rotation vector.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseConfig {
    /// Origin of the inner frame in the outer one, x y z. Valid: -10000 to 10000 mm. Change it to your
    /// cell's.
    pub position_mm: [f64; 3],
    /// Rotation vector: axis times angle. Valid: -6.3 to 6.3 rad. Default: none. Change it to your
    /// cell's.
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
            let (ok, valid) = (found.abs() <= FAR_MM, "-10000 to 10000 mm");
            check(ok, name, found, valid).map_err(|error| error.within("position_mm"))?;
        }
        for found in self.rotation_rad {
            let (ok, valid) = (found.abs() <= FULL_TURN_RAD, "-6.3 to 6.3 rad");
            check(ok, name, found, valid).map_err(|error| error.within("rotation_rad"))?;
        }
        Ok(())
    }
}

/// The job: grasp the part, find it in the hand, align it, insert it. The base frame has z upwards.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TaskConfig {
    /// Expected pose of the part before it is grasped (`t_base_object`). Change it to your cell's.
    pub part_pose: PoseConfig,
    /// Standard deviation of the part's position from there, per axis. Directions that the contact does not
    /// determine keep the expected value with this uncertainty. Valid: 0.0001 to 100 mm. Default: `0.6` mm.
    /// Change it to the uncertainty of the part's position.
    pub part_sigma_mm: f64,
    /// Standard deviation of the part's rotation, per axis. Valid: 0.0001 to 3.2 rad. Default: `0.03` rad.
    /// Change it to the uncertainty of the part's rotation.
    pub part_sigma_rad: f64,
    /// Pose at which the gripper closes (`t_base_gripper`). Change it to your cell's.
    pub grasp_pose: PoseConfig,
    /// Pose of the inserted part (`t_base_object`): the template pose of the hole. Change it to your cell's.
    pub goal_pose: PoseConfig,
    /// File with the taught goal, in place of `goal_pose`; `gelstereo-host teach` writes it. A relative
    /// path starts at the configuration's folder. Default: none. Set it where the pose of the hole, or the
    /// sensor's mount, is less accurate than a tenth of a millimetre.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taught: Option<PathBuf>,
    /// Grasp trigger in standard deviations of the mean marker motion at rest above its median, in place of
    /// `params.contact.grasp_trigger_px`. The rest stage then takes 34 more frames. Each frame of the move is
    /// one test, as the markers are averaged: at 30 Hz and normal noise, 7.3, 8, 10 and 12 give 0.2, 0.06,
    /// 0.003 and 0.0001 false alarms per hour of closing, including the error of the measured deviation.
    /// Valid: 7.3 to 1000000. Default: none. Set it where sensors with different noise need the same
    /// sensitivity, or a part is touched more gently than by 10 px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grasp_trigger_sigmas: Option<f64>,
    /// The same for the insertion trigger. Valid: 7.3 to 1000000. Default: none. Set it where sensors with
    /// different noise need the same sensitivity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub insertion_trigger_sigmas: Option<f64>,
    /// Direction of insertion in the part's frame, of any length. Valid: -1000000 to 1000000. Default: `[0,
    /// 0, -1]`. Change it to the part's.
    pub insertion_axis: [f64; 3],
    /// Distance from the rim of the hole to the goal. Valid: 0.001 to 1000 mm. Default: `10` mm. Change it to
    /// the hole's.
    pub insertion_depth_mm: f64,
    /// Height above the rim at which the part is aligned. Valid: 0.001 to 1000 mm. Default: `3` mm. Raise it
    /// where the part may touch the rim while it is aligned.
    pub approach_mm: f64,
    /// Distance beyond the goal at which the robot gives up if nothing stops it. Valid: 0.001 to 1000 mm.
    /// Default: `4` mm. Lower it where the robot would hit something below the hole.
    pub overtravel_mm: f64,
    /// Height by which the part is lifted out of its holder. Valid: 0.001 to 1000 mm. Default: `45` mm.
    /// Change it to clear the holder and its surroundings.
    pub lift_mm: f64,
    /// Opening before the gripper closes, within the range of `mount.kinematics`. Valid: 0.001 to 1000 mm.
    /// Default: `14` mm. Change it to the part's width plus a margin.
    pub open_width_mm: f64,
    /// Speed at which the gripper opens. Valid: 0.01 to 10000 mm/s. Default: `150` mm/s, the fastest of a
    /// Robotiq 2F-85. Change it to your gripper's.
    pub opening_speed_mm_s: f64,
    /// Speed at which the gripper closes. Valid: 0.01 to 10000 mm/s. Default: `20` mm/s, the slowest of a
    /// Robotiq 2F-85. Lower it for fragile parts, because the fingers continue to move between two frames.
    pub closing_speed_mm_s: f64,
    /// Gripping force as a fraction of the gripper's range. Valid: 0 to 1. Default: `0.2`. Raise it for heavy
    /// parts.
    pub closing_force: f64,
    /// Speed of free moves. Valid: 0.01 to 10000 mm/s. Default: `400` mm/s. Lower it while you set up a cell.
    pub move_speed_mm_s: f64,
    /// Speed of the insertion. Valid: 0.01 to 10000 mm/s. Default: `10` mm/s. Lower it for tight fits,
    /// because the part moves for one more frame after it reaches the hole's bottom.
    pub insertion_speed_mm_s: f64,
    /// Time limit for a stereo pair while nothing moves. Valid: 0.001 to 3600 s. Default: `2` s. Raise it for
    /// a slow camera.
    pub frame_timeout_s: f64,
    /// Largest travel without a stereo pair during a move that ends by a trigger; the move is then stopped.
    /// At 20 mm/s the default is 150 ms. Valid: 0.001 to 1000 mm, and two periods of the camera at the speeds
    /// of closing and insertion. Default: `3` mm. Lower it for stiff gels and hard parts.
    pub max_blind_travel_mm: f64,
    /// The same for moves along free paths: opening, lifting, aligning. At 400 mm/s the default is 300 ms.
    /// Valid: 0.001 to 1000 mm, and two periods of the camera at the speeds of opening and moving. Default:
    /// `120` mm. Lower it where the path may be blocked.
    pub max_blind_free_travel_mm: f64,
    /// Largest delay of a result after its image while something moves, in periods of a live source;
    /// everything is then stopped. Valid: 1 to 1000. Default: `3`. Raise it on a slow computer, together with
    /// slower moves.
    pub max_late_periods: f64,
    /// Time limit of gripper and robot for a status request; everything is then stopped. Valid: 0.001 to 3600
    /// s. Default: `0.5` s. Raise it for a slow controller.
    pub device_timeout_s: f64,
    /// Time limit of each stage on the frame source's clock, after which the job stops. No stage may be
    /// planned to take longer. Valid: 0.1 to 3600 s. Default: `120` s. Raise it for long or slow moves;
    /// recordings may become larger.
    pub stage_timeout_s: f64,
    /// Number of consecutive stereo pairs without markers (black, covered, blurred) that the job tolerates.
    /// Contact is not sensed meanwhile: at 30 Hz and 10 mm/s the part moves 0.33 mm with each. Valid: 0 to
    /// 1000 pairs. Default: `2`. Raise it only for slow moves.
    pub max_bad_frames: u32,
    /// Width of the hole minus width of the part. If set, the job inserts only if success is likely, and
    /// otherwise looks again. Valid: 0.001 to 10 mm. Default: none; every localized part is inserted. Change
    /// it to your hole's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clearance_mm: Option<f64>,
    /// Minimum probability of success for an insertion. Valid: 0 to 1. Default: `0.99`. Lower it where a
    /// jammed part does no harm.
    pub min_chance: f64,
    /// Maximum number of looks at a part, including the first. Between two looks the hand releases the part
    /// in its holder, and grasps it again. Valid: 1 to 10. Default: `3`. Change it to 1 if the part does not
    /// stand by itself.
    pub max_looks: u32,
    /// Angle by which the hand may turn about the part's axis between two looks, in both directions. Valid:
    /// -3.2 to 3.2 rad. Default: `1.5707963267948966` rad, a quarter turn. Change it to the angle between two
    /// faces of your part.
    pub look_turn_rad: f64,
    /// Standard deviation per axis of the part's motion in its holder between two looks, including the
    /// robot's repeatability. Along the closing direction the fingers push the part, and `part_sigma_mm`
    /// applies. Valid: 0.0001 to 100 mm. Default: `0.03` mm. Raise it for a loose holder.
    pub look_sigma_mm: f64,
    /// The same for the part's rotation. Valid: 0.0001 to 3.2 rad. Default: `0.001` rad. Raise it for a loose
    /// holder.
    pub look_sigma_rad: f64,
    /// Maximum number of insertion attempts if the part jams. Between attempts it is lifted, shifted on rings
    /// around the hole and lowered again. Needs `clearance_mm`. Valid: 1 to 100. Default: `1`, no search.
    /// Raise it where a part that touches the rim does no harm.
    pub max_tries: u32,
    /// Faces of the cell that the part in the hand may touch, one `[[task.edges]]` each; needs
    /// `clearance_mm`. Default: none. Set them where a look does not determine a direction that matters for
    /// the hole, such as along a flat face.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub edges: Vec<EdgeConfig>,
}

impl Default for TaskConfig {
    fn default() -> Self {
        let at = |position_mm| PoseConfig { position_mm, rotation_rad: [0.0; 3] };
        Self {
            part_pose: at([400.0, -60.0, 20.0]),
            part_sigma_mm: 0.6,
            part_sigma_rad: 0.03,
            // Fingers down, with the pads of a 2F-85 at 8 mm opening 5 mm above the middle of the peg.
            grasp_pose: PoseConfig {
                position_mm: [400.0, -60.0, 169.4],
                rotation_rad: [core::f64::consts::PI, 0.0, 0.0],
            },
            goal_pose: at([400.0, 60.0, 10.0]),
            taught: None,
            grasp_trigger_sigmas: None,
            insertion_trigger_sigmas: None,
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
            max_blind_travel_mm: 3.0,
            max_blind_free_travel_mm: 120.0,
            max_late_periods: 3.0,
            device_timeout_s: 0.5,
            stage_timeout_s: 120.0,
            max_bad_frames: 2,
            clearance_mm: None,
            min_chance: 0.99,
            max_looks: 3,
            look_turn_rad: core::f64::consts::FRAC_PI_2,
            look_sigma_mm: 0.03,
            look_sigma_rad: 0.001,
            max_tries: 1,
            edges: Vec::new(),
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
            ("task.part_sigma_mm", t.part_sigma_mm, SIGMA_MM),
            ("task.part_sigma_rad", t.part_sigma_rad, SIGMA_RAD),
            ("task.insertion_depth_mm", t.insertion_depth_mm, LENGTH_MM),
            ("task.approach_mm", t.approach_mm, LENGTH_MM),
            ("task.overtravel_mm", t.overtravel_mm, LENGTH_MM),
            ("task.lift_mm", t.lift_mm, LENGTH_MM),
            ("task.opening_speed_mm_s", t.opening_speed_mm_s, SPEED_MM_S),
            ("task.closing_speed_mm_s", t.closing_speed_mm_s, SPEED_MM_S),
            ("task.move_speed_mm_s", t.move_speed_mm_s, SPEED_MM_S),
            ("task.insertion_speed_mm_s", t.insertion_speed_mm_s, SPEED_MM_S),
            ("task.frame_timeout_s", t.frame_timeout_s, TIME_S),
            ("task.max_blind_travel_mm", t.max_blind_travel_mm, LENGTH_MM),
            ("task.max_blind_free_travel_mm", t.max_blind_free_travel_mm, LENGTH_MM),
            ("task.max_late_periods", t.max_late_periods, PERIODS),
            ("task.device_timeout_s", t.device_timeout_s, TIME_S),
            ("task.stage_timeout_s", t.stage_timeout_s, STAGE_S),
        ];
        for (name, found, range) in within {
            range.check(name, found)?;
        }
        let sigmas = [
            ("task.grasp_trigger_sigmas", t.grasp_trigger_sigmas),
            ("task.insertion_trigger_sigmas", t.insertion_trigger_sigmas),
        ];
        for (name, found) in sigmas {
            found.map_or(Ok(()), |found| SIGMAS.check(name, found))?;
        }
        check((0.0..=1.0).contains(&t.closing_force), "task.closing_force", t.closing_force, "0 to 1")?;
        for found in t.insertion_axis {
            check(found.abs() <= 1e6, "task.insertion_axis", found, "-1000000 to 1000000")?;
        }
        let length = DVec3::from_array(t.insertion_axis).length();
        check(length > 1e-6, "task.insertion_axis", length, "a direction, not zero")?;
        let bad = t.max_bad_frames;
        check(bad <= 1000, "task.max_bad_frames", f64::from(bad), "0 to 1000 pairs")?;
        self.check_looks()?;
        self.check_times()?;
        let (min_mm, max_mm) = kinematics.width_range_mm();
        let opens = t.open_width_mm > min_mm && t.open_width_mm <= max_mm;
        check(opens, "task.open_width_mm", t.open_width_mm, "a width that mount.kinematics can have")
    }

    fn check_looks(&self) -> Result<(), ConfigError> {
        if let Some(clearance_mm) = self.clearance_mm {
            CLEARANCE_MM.check("task.clearance_mm", clearance_mm)?;
        }
        check((0.0..=1.0).contains(&self.min_chance), "task.min_chance", self.min_chance, "0 to 1")?;
        let (looks, tries) = (f64::from(self.max_looks), f64::from(self.max_tries));
        check((1..=10).contains(&self.max_looks), "task.max_looks", looks, "1 to 10")?;
        check((1..=100).contains(&self.max_tries), "task.max_tries", tries, "1 to 100")?;
        let can_search = self.max_tries == 1 || self.clearance_mm.is_some();
        check(can_search, "task.max_tries", tries, "1 without task.clearance_mm")?;
        let turn = self.look_turn_rad;
        check(turn.abs() <= 3.2, "task.look_turn_rad", turn, "-3.2 to 3.2 rad")?;
        self.edges.iter().try_for_each(|edge| edge.validate(self.stage_timeout_s))?;
        SIGMA_MM.check("task.look_sigma_mm", self.look_sigma_mm)?;
        SIGMA_RAD.check("task.look_sigma_rad", self.look_sigma_rad)
    }

    /// Durations of the stages that depend only on the task, by name: lifting and aligning, and inserting.
    pub(crate) fn planned_s(&self) -> [(&'static str, f64); 2] {
        let goal = self.goal_pose.pose();
        let back_mm = self.insertion_depth_mm + self.approach_mm;
        let axis = DVec3::from_array(self.insertion_axis).normalize_or_zero();
        let above_mm = goal.transform_point(axis * -back_mm);
        let lifted_mm = self.part_pose.pose().translation_mm + DVec3::Z * self.lift_mm;
        let align_mm = self.lift_mm + (above_mm - lifted_mm).length();
        let insert_mm = self.approach_mm + self.insertion_depth_mm + self.overtravel_mm;
        [
            ("task.move_speed_mm_s", align_mm / self.move_speed_mm_s),
            ("task.insertion_speed_mm_s", insert_mm / self.insertion_speed_mm_s),
        ]
    }

    /// A stage that cannot end in time would always be stopped, after recording for the whole time.
    fn check_times(&self) -> Result<(), ConfigError> {
        match self.planned_s().into_iter().find(|(_, planned_s)| !(*planned_s <= self.stage_timeout_s)) {
            Some((name, planned_s)) => {
                Err(ConfigError::TooSlow { name, planned_s, limit_s: self.stage_timeout_s })
            }
            None => Ok(()),
        }
    }
}
