//! Grasps a part standing in its holder again, with the hand turned about the part's axis.
//!
//! The hand opens, rises, turns and closes again. Poses are fused in the base frame by their information,
//! including the alternative poses of each contact.

use super::belief::{Belief, FusedBelief, expected_anyway};
use super::cell::Cell;
use super::chance::Flank;
use super::error::Halt;
use super::grasp::grasp;
use super::localize::{Held, Localization, localize};
use super::log::figure;
use super::prepare::rest;
use super::watch::Guard;
use crate::report::Stage;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::register::PoseEstimate;

/// 99.9 % quantile of chi-squared with six degrees of freedom: two looks at a part that stood still
/// seldom differ by more.
const MAX_SQUARED_DISTANCE: f64 = 22.458;

/// A second grasp, and the chance of insertion expected after it.
pub(super) struct RegraspPlan {
    pub(super) turn_rad: f64,
    pub(super) chance: f64,
    /// Pose of the hand at that grasp.
    pub(super) t_base_gripper: Pose,
    /// Expected estimate of the part afterwards, gripper frame.
    pub(super) expected: PoseEstimate,
}

/// Finds the turn of the hand about the part's axis with the highest expected chance; on ties, no turn.
/// It assumes that the next contact is as informative as the last one. Alternative poses are ignored,
/// because it is unknown which of them the next contact rules out.
pub(super) fn best_regrasp(cell: &Cell, flank: &Flank, held: &Held, t_base_gripper: &Pose) -> RegraspPlan {
    let task = &cell.config.task;
    let known = held.belief.likeliest().in_frame(t_base_gripper);
    let plan = |turn_rad: f64| {
        let t_base_gripper = hand_around(cell, &known.pose, turn_rad);
        let before = disturbed(cell, &known, &t_base_gripper);
        // Assumes the last contact's information, rotated with the hand.
        let turned = held.contact.in_frame(&t_base_gripper);
        let information = core::array::from_fn(|i| {
            core::array::from_fn(|j| before.information[i][j] + turned.information[i][j])
        });
        let together = PoseEstimate { pose: known.pose, information };
        let forecast = flank.forecast(&Belief::alone(together), task.part_sigma_rad, task.part_sigma_mm);
        let expected = together.in_frame(&t_base_gripper.inverse());
        RegraspPlan { turn_rad, chance: forecast.chance, t_base_gripper, expected }
    };
    let turns = [task.look_turn_rad, -task.look_turn_rad];
    let fitting = turns.into_iter().filter(|turn_rad| fits_between_fingers(cell, *turn_rad)).map(plan);
    fitting.fold(plan(0.0), |best, plan| if plan.chance > best.chance { plan } else { best })
}

/// Whether the open fingers fit around the part after a turn.
fn fits_between_fingers(cell: &Cell, turn_rad: f64) -> bool {
    let t_object_gripper = hand_around(cell, &Pose::IDENTITY, turn_rad);
    let closing = t_object_gripper.transform_vector(DVec3::X);
    let along = || cell.sensing.template().points_mm().iter().map(|point| point.dot(closing));
    let width_mm = along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min);
    width_mm < cell.config.task.open_width_mm
}

/// Grasps the part again by the plan and localizes it.
pub(super) fn look_again(cell: &mut Cell, held: &Held, plan: &RegraspPlan) -> Result<Localization, Halt> {
    let t_base_gripper = cell.devices.robot.status()?.t_base_gripper;
    let known = held.belief.in_frame(&t_base_gripper);
    regrasp(cell, &known.likeliest().pose, plan.turn_rad)?;
    fused_look(cell, &known)
}

/// Gripper pose `t_base_gripper` that holds the part as expected, but turned about the part's axis.
fn hand_around(cell: &Cell, t_base_object: &Pose, turn_rad: f64) -> Pose {
    let turn = Pose::exp(cell.config.insertion_axis() * turn_rad, DVec3::ZERO);
    *t_base_object * turn * cell.config.expected_t_gripper_object().inverse()
}

/// Estimate of a part after the fingers have closed on it again, base frame: they push it along the
/// gripper's x.
fn disturbed(cell: &Cell, known: &PoseEstimate, t_base_gripper: &Pose) -> PoseEstimate {
    let task = &cell.config.task;
    let held = known.in_frame(&t_base_gripper.inverse());
    let shifts_mm =
        DVec3::new(task.part_sigma_mm.max(task.look_sigma_mm), task.look_sigma_mm, task.look_sigma_mm);
    let turns_rad = DVec3::splat(task.look_sigma_rad);
    held.disturbed(held.pose.translation_mm, turns_rad, shifts_mm).in_frame(t_base_gripper)
}

/// Releases the standing part, and grasps it again with the hand turned about its axis.
fn regrasp(cell: &mut Cell, t_base_object: &Pose, turn_rad: f64) -> Result<(), Halt> {
    cell.log.begin(Stage::Open);
    let task = &cell.config.task;
    cell.move_gripper(task.open_width_mm, task.opening_speed_mm_s, Guard::Free)?;
    wait(cell)?;
    let lift = Pose::from_translation_mm(DVec3::Z * task.lift_mm);
    let from = cell.devices.robot.status()?.t_base_gripper;
    let to = hand_around(cell, t_base_object, turn_rad);
    for waypoint in [lift * from, lift * to, to] {
        cell.move_robot(&waypoint, task.move_speed_mm_s, Guard::Free)?;
        wait(cell)?;
    }
    let width_mm = cell.devices.gripper.status()?.width_mm;
    cell.log.end(vec![figure("width_mm", width_mm), figure("turn_rad", turn_rad)]);
    rest(cell)?;
    grasp(cell)
}

/// Skips frames until nothing moves.
fn wait(cell: &mut Cell) -> Result<(), Halt> {
    while cell.moves()? {
        cell.skip_pair()?;
    }
    Ok(())
}

/// Localizes the part in the hand, and fuses the result with the previous belief in the base frame.
fn fused_look(cell: &mut Cell, known: &Belief) -> Result<Localization, Halt> {
    let t_base_gripper = cell.devices.robot.status()?.t_base_gripper;
    let guess = t_base_gripper.inverse() * known.likeliest().pose;
    let mut held = match localize(cell, &guess)? {
        Localization::Go(held) => held,
        other => return Ok(other),
    };
    let before = known.map(|one| {
        let held = disturbed(cell, one, &t_base_gripper).in_frame(&t_base_gripper.inverse());
        expected_anyway(&held, cell.config.task.part_sigma_rad, cell.config.task.part_sigma_mm)
    });
    match before.fused(&held.belief) {
        Ok(FusedBelief { squared_distance, .. }) if squared_distance > MAX_SQUARED_DISTANCE => {
            let reason = format!(
                "two looks at the part contradict each other: a squared distance of {squared_distance:.1}, \
                 of which {MAX_SQUARED_DISTANCE} is the limit; did the part move in its holder?"
            );
            Ok(Localization::Declined { reason })
        }
        Ok(FusedBelief { belief, .. }) => {
            held.t_gripper_object = belief.likeliest().pose;
            held.localized.t_gripper_object = held.t_gripper_object.to_rows();
            held.belief = belief;
            Ok(Localization::Go(held))
        }
        Err(error) => Ok(Localization::Declined { reason: error.to_string() }),
    }
}
