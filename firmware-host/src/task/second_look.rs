//! Look again at a part that one grasp does not tell well enough, while it stands in its holder.
//!
//! The hand opens, rises, turns about the part's axis and closes again. Poses are fused in the base frame by
//! their information, each with the other poses that explain its contact. The turn is chosen by what is unknown:
//! the one after which the chance of insertion is the highest, if the next contact tells as much as the last one.

use super::belief::{Belief, FusedBelief};
use super::cell::Cell;
use super::chance::Flank;
use super::error::Halt;
use super::grasp::grasp;
use super::localize::{Held, Localization, localize};
use super::log::figure;
use super::prepare::rest;
use super::watch::Guard;
use crate::report::{Forecast, Stage};
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::register::PoseEstimate;

/// 99.9 % of chi-squared with six degrees of freedom: two looks at a part that stood still seldom differ by
/// more.
const MAX_SQUARED_DISTANCE: f64 = 22.458;

/// Looks until the chance of insertion is high enough, `task.max_looks` times at most. Without
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
        if looks >= task.max_looks {
            return Ok(Localization::TooUncertain { localized: Box::new(held.localized), forecast });
        }
        let t_base_gripper = cell.devices.robot.status()?.t_base_gripper;
        let known = held.belief.in_frame(&t_base_gripper);
        let likeliest = *known.likeliest();
        let turn_rad = best_turn(cell, &flank, &likeliest, &held.contact);
        regrasp(cell, &likeliest.pose, turn_rad)?;
        held = match fused_look(cell, &known)? {
            Localization::Go(held) => *held,
            other => return Ok(other),
        };
        looks += 1;
    }
}

/// The turn of the hand about the part's axis after which the chance is the highest; the least one of those
/// alike. `known` is in the base frame, the last `contact` in the gripper's. Other poses are left out: which of them the
/// next contact tells apart is not known.
fn best_turn(cell: &Cell, flank: &Flank, known: &PoseEstimate, contact: &PoseEstimate) -> f64 {
    let task = &cell.config.task;
    let expected = |turn_rad: f64| -> Forecast {
        let t_base_gripper = hand_around(cell, &known.pose, turn_rad);
        let before = disturbed(cell, known, &t_base_gripper);
        // The next contact tells in the turned hand what the last one told in that one.
        let turned = contact.in_frame(&t_base_gripper);
        let information = core::array::from_fn(|i| {
            core::array::from_fn(|j| before.information[i][j] + turned.information[i][j])
        });
        let together = PoseEstimate { pose: known.pose, information };
        flank.forecast(&Belief::alone(together), task.part_sigma_rad, task.part_sigma_mm)
    };
    let mut best = (0.0, expected(0.0).chance);
    for turn_rad in [task.look_turn_rad, -task.look_turn_rad] {
        let chance = expected(turn_rad).chance;
        if chance > best.1 {
            best = (turn_rad, chance);
        }
    }
    best.0
}

/// Pose of the gripper, `t_base_gripper`, that holds the part as is expected, but turned about the part's
/// axis.
fn hand_around(cell: &Cell, t_base_object: &Pose, turn_rad: f64) -> Pose {
    let turn = Pose::exp(cell.config.insertion_axis() * turn_rad, DVec3::ZERO);
    *t_base_object * turn * cell.config.expected_t_gripper_object().inverse()
}

/// What is known of a part once the fingers have closed on it again, base frame: they push it along the
/// gripper's x.
fn disturbed(cell: &Cell, known: &PoseEstimate, t_base_gripper: &Pose) -> PoseEstimate {
    let task = &cell.config.task;
    let held = known.in_frame(&t_base_gripper.inverse());
    let shifts_mm =
        DVec3::new(task.part_sigma_mm.max(task.look_sigma_mm), task.look_sigma_mm, task.look_sigma_mm);
    let turns_rad = DVec3::splat(task.look_sigma_rad);
    held.disturbed(held.pose.translation_mm, turns_rad, shifts_mm).in_frame(t_base_gripper)
}

/// Lets go of the standing part, and takes it again with the hand turned about its axis.
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

/// Lets frames go until nothing moves.
fn wait(cell: &mut Cell) -> Result<(), Halt> {
    while cell.moves()? {
        cell.skip_pair()?;
    }
    Ok(())
}

/// Joins an estimate with what is known of the part without sensing. Two contacts that leave the slide along
/// an axis free, and see this axis 1e-4 rad apart, would otherwise settle their difference across it by a
/// slide of centimetres.
fn expected_anyway(cell: &Cell, estimate: &PoseEstimate) -> PoseEstimate {
    let task = &cell.config.task;
    let mut joined = estimate.in_frame(&estimate.pose.inverse());
    for (i, row) in joined.information.iter_mut().enumerate() {
        let sigma = if i < 3 { task.part_sigma_rad } else { task.part_sigma_mm };
        row[i] += 1.0 / (sigma * sigma);
    }
    joined.in_frame(&estimate.pose)
}

/// Localizes the part in the hand, and fuses that with what was known of it in the base frame.
fn fused_look(cell: &mut Cell, known: &Belief) -> Result<Localization, Halt> {
    let t_base_gripper = cell.devices.robot.status()?.t_base_gripper;
    let guess = t_base_gripper.inverse() * known.likeliest().pose;
    let mut held = match localize(cell, &guess)? {
        Localization::Go(held) => held,
        other => return Ok(other),
    };
    let before = known.map(|one| {
        let held = disturbed(cell, one, &t_base_gripper).in_frame(&t_base_gripper.inverse());
        expected_anyway(cell, &held)
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
