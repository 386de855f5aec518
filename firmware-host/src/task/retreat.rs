//! Leave the hole: without the part when it is inserted, with the part when it is not.

use super::cell::Cell;
use super::error::Halt;
use super::log::figure;
use super::watch::Guard;
use crate::report::{Outcome, Stage};
use gelstereo_core::math::Pose;

/// Backs off along the axis of insertion, and returns when the robot stands.
///
/// An inserted part is let go first, and the open fingers then move past it by `task.lift_mm`. A part that is not
/// inserted stays in the hand and goes back to `above` at the speed of the insertion, since it may be wedged.
pub(super) fn retreat(cell: &mut Cell, above: &Pose, outcome: &Outcome) -> Result<(), Halt> {
    cell.log.begin(Stage::Retreat);
    let task = &cell.config.task;
    let from = cell.devices.robot.status()?.t_base_gripper;
    if matches!(outcome, Outcome::Inserted { .. }) {
        cell.move_gripper(task.open_width_mm, task.opening_speed_mm_s, Guard::Free)?;
        while cell.devices.gripper.status()?.moving {
            cell.frame()?;
        }
        let outwards = task.goal_pose.pose().transform_vector(-cell.config.insertion_axis());
        let clear = Pose::from_translation_mm(outwards * task.lift_mm) * from;
        cell.go(&clear, task.move_speed_mm_s)?;
    } else {
        cell.go(above, task.insertion_speed_mm_s)?;
    }
    let way_mm = (cell.devices.robot.status()?.t_base_gripper.translation_mm - from.translation_mm).length();
    let width_mm = cell.devices.gripper.status()?.width_mm;
    cell.log.end(vec![figure("way_mm", way_mm), figure("width_mm", width_mm)]);
    Ok(())
}
