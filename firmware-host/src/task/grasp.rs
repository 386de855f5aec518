//! Closes the fingers until the grasp trigger.

use super::cell::{Cell, Trigger};
use super::devices::Stops;
use super::error::Halt;
use super::log::figure;
use super::watch::Guard;
use crate::report::{Outcome, Stage};

/// The frame after the triggering one may be exposed before the fingers stand still; the next one is not.
/// Both are skipped. A pose from a frame with moving fingers was off by 0.25 mm at 20 mm/s and 30 Hz
/// (simulated).
const STALE_FRAMES: u32 = 2;

/// Closes the fingers until the mean marker motion reaches the grasp trigger.
///
/// The gripper's status is newer than the frame. Fingers that stand still without a trigger are therefore
/// judged by a frame that was exposed after they stopped.
pub(super) fn grasp(cell: &mut Cell) -> Result<(), Halt> {
    cell.log.begin(Stage::Close);
    let task = &cell.config.task;
    let motion_px = cell.triggers.grasp_px;
    let trigger = Trigger { motion_px, stops: Stops::Gripper, cause: "grasp" };
    let (min_mm, _) = cell.config.mount.kinematics.width_range_mm();
    cell.move_gripper(min_mm, task.closing_speed_mm_s, Guard::Triggered)?;
    let mut still_frames = 0;
    let motion_px = loop {
        let felt = cell.guarded_frame(&trigger)?;
        if felt.triggered {
            break felt.motion_px;
        }
        let status = cell.devices.gripper.status()?;
        still_frames = if status.moving { 0 } else { still_frames + 1 };
        if still_frames > STALE_FRAMES {
            let (motion_px, width_mm) = (felt.motion_px, status.width_mm);
            return Err(Halt::Outcome(Outcome::NotGrasped { motion_px, width_mm }));
        }
    };
    while cell.devices.gripper.status()?.moving {
        cell.frame()?;
    }
    for _ in 0..STALE_FRAMES {
        cell.frame()?;
    }
    let width_mm = cell.devices.gripper.status()?.width_mm;
    let frame = cell.sensing.frame();
    let salient = frame.salient.iter().filter(|&&salient| salient).count();
    let pressed_mm = frame.indentation_mm.iter().copied().fold(0.0, f64::max);
    cell.log.end(vec![
        figure("motion_px", motion_px),
        figure("width_mm", width_mm),
        figure("salient", salient as f64),
        figure("pressed_mm", pressed_mm),
    ]);
    Ok(())
}
