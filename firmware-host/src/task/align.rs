//! Moves the part to its pose above the hole.

use super::cell::Cell;
use super::error::Halt;
use super::localize::Held;
use super::log::figure;
use crate::report::Stage;
use gelstereo_core::frames::adjusted_gripper;
use gelstereo_core::math::{DVec3, Pose};

/// Lifts the part and moves it above the hole; returns the gripper's pose there.
pub(super) fn align(cell: &mut Cell, held: &Held) -> Result<Pose, Halt> {
    cell.log.begin(Stage::Align);
    let task = &cell.config.task;
    let lift = Pose::from_translation_mm(DVec3::Z * task.lift_mm);
    let from = cell.devices.robot.status()?.t_base_gripper;
    cell.go(&(lift * from), task.move_speed_mm_s)?;
    let back_mm = task.insertion_depth_mm + task.approach_mm;
    let above = cell.goal * Pose::from_translation_mm(-cell.config.insertion_axis() * back_mm);
    let t_base_gripper = adjusted_gripper(&above, &held.t_gripper_object);
    cell.go(&t_base_gripper, task.move_speed_mm_s)?;
    // The paper's adjustment: the difference between the localized and the expected part pose in the hand.
    let expected = adjusted_gripper(&above, &cell.config.expected_t_gripper_object());
    let (turn, shift_mm) = (expected.inverse() * t_base_gripper).log();
    cell.log.end(vec![figure("turn_rad", turn.length()), figure("shift_mm", shift_mm.length())]);
    Ok(t_base_gripper)
}
