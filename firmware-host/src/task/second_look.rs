//! Further looks at a part whose pose one grasp does not determine well enough.
//!
//! Candidates are a second grasp of the standing part, with or without a turn of the hand, and touches of
//! known faces with the held part. The look with the highest expected chance of insertion is chosen.

use super::belief::Belief;
use super::cell::Cell;
use super::chance::Flank;
use super::error::Halt;
use super::localize::{Held, Localization};
use super::regrasp::{RegraspPlan, best_regrasp, look_again};
use super::touch::touch;
use super::touch_plan::{TouchPlan, touch_plans};
use gelstereo_core::math::Pose;

/// The next look.
enum NextLook {
    Regrasp(Box<RegraspPlan>),
    Touch(Box<TouchPlan>),
}

/// Looks until the chance of insertion is high enough, at most `task.max_looks` times. Without
/// `task.clearance_mm` one look is enough.
pub(super) fn look_until_known(cell: &mut Cell, first: Held) -> Result<Localization, Halt> {
    let task = &cell.config.task;
    let Some(clearance_mm) = task.clearance_mm else {
        return Ok(Localization::Go(Box::new(first)));
    };
    let (axis, depth_mm) = (cell.config.insertion_axis(), task.insertion_depth_mm);
    let flank = Flank::of(cell.sensing.template(), axis, depth_mm, clearance_mm);
    let (mut held, mut looks) = (first, 1);
    loop {
        let forecast = flank.forecast(&held.belief, task.part_sigma_rad, task.part_sigma_mm);
        cell.log.note(&serde_json::json!({ "look": looks, "forecast": &forecast }));
        held.localized.looks = looks;
        held.localized.forecast = Some(forecast.clone());
        if forecast.chance >= task.min_chance {
            return Ok(Localization::Go(Box::new(held)));
        }
        let t_base_gripper = cell.devices.robot.status()?.t_base_gripper;
        let left = task.max_looks.saturating_sub(looks);
        let next = choose(cell, &flank, &held, &t_base_gripper, left);
        let found = match next {
            None => {
                let localized = Box::new(held.localized);
                return Ok(Localization::TooUncertain { localized, forecast });
            }
            Some(NextLook::Regrasp(plan)) => look_again(cell, &held, &plan)?,
            Some(NextLook::Touch(plan)) => touch(cell, held, &plan)?,
        };
        held = match found {
            Localization::Go(held) => *held,
            other => return Ok(other),
        };
        looks += 1;
    }
}

/// Chooses the possible look with the highest expected chance.
///
/// A part that left its holder cannot be grasped again. If a touch of a standing part suffices, its own
/// chance counts. Otherwise each look is valued by the best touch that may follow it.
fn choose(cell: &Cell, flank: &Flank, held: &Held, t_base_gripper: &Pose, left: u32) -> Option<NextLook> {
    if left == 0 {
        return None;
    }
    let touch = best_touch(cell, flank, held, t_base_gripper);
    if !held.touched.is_empty() {
        return touch.map(|touch| NextLook::Touch(Box::new(touch)));
    }
    let regrasp = best_regrasp(cell, flank, held, t_base_gripper);
    let Some(touch) = touch else { return Some(NextLook::Regrasp(Box::new(regrasp))) };
    let is_enough = touch.chance >= cell.config.task.min_chance;
    let touches = if is_enough || left == 1 {
        touch.chance > regrasp.chance
    } else {
        let held_again = held.expecting(Belief::alone(regrasp.expected), None);
        let after_regrasp = best_touch(cell, flank, &held_again, &regrasp.t_base_gripper);
        let held_before_face = held.expecting(touch.expected.clone(), Some(touch.touched));
        let after_touch = best_touch(cell, flank, &held_before_face, &touch.start);
        let value =
            |chance: f64, next: Option<TouchPlan>| next.map_or(chance, |next| chance.max(next.chance));
        value(touch.chance, after_touch) > value(regrasp.chance, after_regrasp)
    };
    Some(if touches { NextLook::Touch(Box::new(touch)) } else { NextLook::Regrasp(Box::new(regrasp)) })
}

fn best_touch(cell: &Cell, flank: &Flank, held: &Held, t_base_gripper: &Pose) -> Option<TouchPlan> {
    let plans = touch_plans(cell, flank, held, t_base_gripper).into_iter();
    plans.reduce(|best, plan| if plan.chance > best.chance { plan } else { best })
}
