//! Leaves the hole: without the part if it is inserted, otherwise with it.

use super::cell::Cell;
use super::error::Halt;
use super::log::figure;
use super::watch::Guard;
use crate::report::{Outcome, Stage};
use gelstereo_core::math::Pose;

/// Backs off along the insertion axis, and returns when the robot stands still.
///
/// An inserted part is released first. Otherwise the part stays in the hand and returns to `above` at
/// insertion speed, since it may be wedged.
pub(super) fn retreat(cell: &mut Cell, above: &Pose, outcome: &Outcome) -> Result<(), Halt> {
    if matches!(outcome, Outcome::Inserted { .. }) {
        return let_go(cell);
    }
    cell.log.begin(Stage::Retreat);
    let from = cell.devices.robot.status()?.t_base_gripper;
    cell.go(above, cell.config.task.insertion_speed_mm_s)?;
    end(cell, &from)
}

/// Opens the fingers around the part, and moves past it by `task.lift_mm`.
pub(super) fn let_go(cell: &mut Cell) -> Result<(), Halt> {
    cell.log.begin(Stage::Retreat);
    let task = &cell.config.task;
    let from = cell.devices.robot.status()?.t_base_gripper;
    cell.move_gripper(task.open_width_mm, task.opening_speed_mm_s, Guard::Free)?;
    while cell.devices.gripper.status()?.moving {
        cell.frame()?;
    }
    let outwards = cell.goal.transform_vector(-cell.config.insertion_axis());
    let clear = Pose::from_translation_mm(outwards * task.lift_mm) * from;
    cell.go(&clear, task.move_speed_mm_s)?;
    end(cell, &from)
}

fn end(cell: &mut Cell, from: &Pose) -> Result<(), Halt> {
    let now = cell.devices.robot.status()?.t_base_gripper;
    let way_mm = (now.translation_mm - from.translation_mm).length();
    let width_mm = cell.devices.gripper.status()?.width_mm;
    cell.log.end(vec![figure("way_mm", way_mm), figure("width_mm", width_mm)]);
    Ok(())
}
