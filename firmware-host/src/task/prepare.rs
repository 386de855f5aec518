//! Opens the gripper at the part; takes the rest frame.

use super::cell::Cell;
use super::error::Halt;
use super::log::figure;
use super::noise;
use super::watch::Guard;
use crate::report::Stage;
use crate::sensing::Action;
use gelstereo_core::math::Pose;
use gelstereo_core::track::MarkerState;

/// Activates and opens the gripper; moves it to a pose, or leaves it in place.
pub(super) fn open(cell: &mut Cell, t_base_gripper: Option<&Pose>) -> Result<(), Halt> {
    cell.log.begin(Stage::Open);
    cell.activate_gripper()?;
    let task = &cell.config.task;
    cell.move_gripper(task.open_width_mm, task.opening_speed_mm_s, Guard::Free)?;
    if let Some(t_base_gripper) = t_base_gripper {
        cell.move_robot(t_base_gripper, task.move_speed_mm_s, Guard::Free)?;
    }
    // Frames on the way show neither rest nor contact and are skipped.
    while cell.moves()? {
        cell.skip_pair()?;
    }
    let width_mm = cell.devices.gripper.status()?.width_mm;
    cell.log.end(vec![figure("width_mm", width_mm)]);
    Ok(())
}

/// Takes the reference frame without contact, from which motion is measured.
pub(super) fn rest(cell: &mut Cell) -> Result<(), Halt> {
    cell.log.begin(Stage::Rest);
    cell.act(&Action::Reset)?;
    cell.frame()?;
    if let Some(record) = cell.sensing.rest_record() {
        cell.log.rest(&record);
    }
    let noise = noise::measure(cell)?;
    let frame = cell.sensing.frame();
    let seen = frame.state.iter().filter(|&&state| state == MarkerState::Seen).count();
    let mut figures = vec![figure("markers", frame.state.len() as f64), figure("seen", seen as f64)];
    if let Some(pitch) = cell.sensing.pitch_check() {
        let [x_mm, y_mm] = pitch.measured_mm;
        figures.extend([figure("pitch_x_mm", x_mm), figure("pitch_y_mm", y_mm)]);
        if pitch.is_off() {
            cell.log.warn(pitch.to_string());
        }
    }
    if let Some(noise) = noise {
        figures.extend([
            figure("noise_level_px", noise.level_px),
            figure("noise_sigma_px", noise.sigma_px),
            figure("grasp_trigger_px", cell.triggers.grasp_px),
            figure("insertion_trigger_px", cell.triggers.insertion_px),
        ]);
    }
    cell.log.end(figures);
    Ok(())
}
