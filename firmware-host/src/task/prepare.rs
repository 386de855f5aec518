//! Open the gripper at the part; take the rest frame.

use super::cell::Cell;
use super::error::Halt;
use super::log::figure;
use super::watch::Guard;
use crate::report::Stage;
use crate::sensing::Action;
use gelstereo_core::track::MarkerState;

/// Makes the gripper ready, opens it and brings it to the part.
pub(super) fn open(cell: &mut Cell) -> Result<(), Halt> {
    cell.log.begin(Stage::Open);
    let task = &cell.config.task;
    cell.devices.gripper.activate()?;
    cell.move_gripper(task.open_width_mm, task.opening_speed_mm_s, Guard::Free)?;
    cell.move_robot(&task.grasp_pose.pose(), task.move_speed_mm_s, Guard::Free)?;
    // Frames on the way show neither rest nor contact: they are let go.
    while cell.moves()? {
        cell.take_pair()?;
    }
    let width_mm = cell.devices.gripper.status()?.width_mm;
    cell.log.end(vec![figure("width_mm", width_mm)]);
    Ok(())
}

/// Takes the frame without contact that motion counts from.
pub(super) fn rest(cell: &mut Cell) -> Result<(), Halt> {
    cell.log.begin(Stage::Rest);
    cell.act(&Action::Reset)?;
    cell.frame()?;
    if let Some(record) = cell.sensing.rest_record() {
        cell.log.rest(&record);
    }
    let frame = cell.sensing.frame();
    let seen = frame.state.iter().filter(|&&state| state == MarkerState::Seen).count();
    let figures = vec![figure("markers", frame.state.len() as f64), figure("seen", seen as f64)];
    cell.log.end(figures);
    Ok(())
}
