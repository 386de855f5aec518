//! Lowers the part until the insertion trigger.

use super::cell::{Cell, Trigger};
use super::devices::Stops;
use super::error::Halt;
use super::localize::Held;
use super::log::figure;
use super::watch::Guard;
use crate::report::{Outcome, Stage};
use crate::sensing::Action;
use gelstereo_core::math::Pose;

/// Inserts from `above`, the gripper's pose with the part above the hole.
pub(super) fn insert(cell: &mut Cell, above: &Pose, held: &Held) -> Result<Outcome, Halt> {
    cell.log.begin(Stage::Insert);
    cell.act(&Action::MarkReference)?;
    let task = &cell.config.task;
    let motion_px = cell.triggers.insertion_px;
    let trigger = Trigger { motion_px, stops: Stops::Robot, cause: "insertion" };
    let inwards = (*above * held.t_gripper_object).transform_vector(cell.config.insertion_axis());
    let way_mm = task.approach_mm + task.insertion_depth_mm + task.overtravel_mm;
    let last = Pose::from_translation_mm(inwards * way_mm) * *above;
    cell.move_robot(&last, task.insertion_speed_mm_s, Guard::Triggered)?;
    let felt = loop {
        let felt = cell.guarded_frame(&trigger)?;
        if felt.triggered || !cell.devices.robot.status()?.moving {
            break felt;
        }
    };
    let now = cell.devices.robot.status()?.t_base_gripper;
    let depth_mm = (now.translation_mm - above.translation_mm).dot(inwards) - task.approach_mm;
    // The depth is known no better than the part's position along the axis: three sigma.
    let within_mm = 3.0 * held.localized.axial_sigma_mm;
    let enough = depth_mm >= task.insertion_depth_mm - within_mm;
    cell.log.end(vec![figure("motion_px", felt.motion_px), figure("depth_mm", depth_mm)]);
    Ok(match (felt.triggered, enough) {
        (true, true) => Outcome::Inserted { depth_mm, within_mm },
        (true, false) => Outcome::Jammed { depth_mm, within_mm },
        (false, _) => Outcome::NothingFelt { depth_mm },
    })
}
