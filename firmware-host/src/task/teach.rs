//! Teaches the goal: grasps the placed part and localizes it there (section V-A).

use super::cell::Cell;
use super::error::Halt;
use super::grasp::grasp;
use super::localize::{Held, Localization, localize};
use super::prepare::{open, rest};
use super::retreat::let_go;
use super::watch::Guard;
use crate::report::Outcome;
use crate::taught::{Taught, VERSION};
use gelstereo_core::frames::adjusted_gripper;
use gelstereo_core::math::Pose;

/// A part that was localized at its goal.
pub(super) struct Lesson {
    pub(super) taught: Taught,
    pub(super) held: Held,
}

/// Moves down around the part at its goal, or stays in place, and localizes the part.
pub(super) fn teach(cell: &mut Cell, stay: bool) -> Result<Result<Lesson, Outcome>, Halt> {
    let around = adjusted_gripper(&cell.goal, &cell.config.expected_t_gripper_object());
    if stay {
        open(cell, None)?;
    } else {
        let task = &cell.config.task;
        let outwards = cell.goal.transform_vector(-cell.config.insertion_axis());
        open(cell, Some(&(Pose::from_translation_mm(outwards * task.lift_mm) * around)))?;
        cell.move_robot(&around, task.insertion_speed_mm_s, Guard::Free)?;
        while cell.moves()? {
            cell.skip_pair()?;
        }
    }
    rest(cell)?;
    grasp(cell)?;
    let expected = cell.config.expected_t_gripper_object();
    let held = match localize(cell, &expected)? {
        Localization::Go(held) => *held,
        Localization::TooUncertain { localized, forecast } => {
            return Ok(Err(Outcome::declined(&localized, forecast)));
        }
        Localization::Declined { reason } => return Ok(Err(Outcome::NotLocalized { reason })),
    };
    let lesson = lesson(cell, held)?;
    let_go(cell)?;
    Ok(Ok(lesson))
}

fn lesson(cell: &mut Cell, held: Held) -> Result<Lesson, Halt> {
    let Some(rest) = cell.sensing.rest_record() else {
        let reason = "there is no rest record".to_owned();
        return Err(Halt::Outcome(Outcome::NotLocalized { reason }));
    };
    let taught = Taught {
        version: VERSION,
        t_base_gripper: cell.devices.robot.status()?.t_base_gripper,
        t_gripper_object: held.t_gripper_object,
        width_mm: cell.devices.gripper.status()?.width_mm,
        sigma: held.localized.sigma,
        rest,
    };
    Ok(Lesson { taught, held })
}
