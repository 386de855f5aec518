//! Touches a face of the cell with the held part, to measure the part's position.
//!
//! The hand carries the part in front of the face and moves it slowly towards it. The face's resistance
//! drags the gel; the insertion trigger stops the robot, and the part goes back. The position where the
//! motion began gives one linear constraint on the part's pose, which is fused with the belief.

use super::belief::{FusedBelief, expected_anyway};
use super::cell::{Cell, Trigger};
use super::devices::Stops;
use super::error::Halt;
use super::localize::{Held, Localization};
use super::log::figure;
use super::onset::{Onset, Sample, onset};
use super::touch_plan::TouchPlan;
use super::watch::Guard;
use crate::report::{Outcome, Stage};
use crate::sensing::Action;
use gelstereo_core::math::{DVec3, Pose};

/// 99.9 % quantile of chi-squared with one degree of freedom.
const MAX_SQUARED_DISTANCE: f64 = 10.828;

/// Touches the face by the plan, and fuses the result with the belief.
pub(super) fn touch(cell: &mut Cell, mut held: Held, plan: &TouchPlan) -> Result<Localization, Halt> {
    cell.log.begin(Stage::Touch);
    carry(cell, &plan.start)?;
    let found = feel(cell, plan)?;
    let speed_mm_s = cell.config.task.insertion_speed_mm_s;
    cell.go(&plan.start, speed_mm_s)?;
    let Some(found) = found else {
        let reason = format!(
            "the part touched face {} of task.edges before it was moved towards it; is the face where the \
             configuration says, or is task.edges.approach_mm too short?",
            plan.touched.edge
        );
        return Ok(Localization::Declined { reason });
    };
    held.touched.push(plan.touched);
    held.localized.touches += 1;
    fuse(cell, held, plan, &found)
}

/// Lifts the part and carries it to a pose of the hand.
fn carry(cell: &mut Cell, to: &Pose) -> Result<(), Halt> {
    let task = &cell.config.task;
    let lift = Pose::from_translation_mm(DVec3::Z * task.lift_mm);
    let from = cell.devices.robot.status()?.t_base_gripper;
    for waypoint in [lift * from, lift * *to, *to] {
        cell.go(&waypoint, task.move_speed_mm_s)?;
    }
    Ok(())
}

/// Moves the part slowly until the trigger; returns the first touch, if the move started quietly.
fn feel(cell: &mut Cell, plan: &TouchPlan) -> Result<Option<Onset>, Halt> {
    cell.act(&Action::MarkReference)?;
    let edge = plan.touched.edge;
    let speed_mm_s = plan.edge.speed_mm_s;
    let trigger = Trigger { motion_px: cell.triggers.insertion_px, stops: Stops::Robot, cause: "touch" };
    let last = Pose::from_translation_mm(plan.way * plan.max_travel_mm) * plan.start;
    cell.move_robot(&last, speed_mm_s, Guard::Triggered)?;
    let mut samples = Vec::new();
    loop {
        let felt = cell.guarded_frame(&trigger)?;
        let status = cell.devices.robot.status()?;
        let travel_mm = (status.t_base_gripper.translation_mm - plan.start.translation_mm).dot(plan.way);
        samples.push(Sample { travel_mm, motion_px: felt.motion_px });
        if felt.triggered {
            break;
        }
        if !status.moving {
            cell.log.end(vec![figure("motion_px", felt.motion_px), figure("travel_mm", travel_mm)]);
            return Err(Halt::Outcome(Outcome::EdgeNotFelt { edge, travel_mm }));
        }
    }
    Ok(onset(&samples))
}

/// Fuses the position of the touch with the belief, and reports both.
fn fuse(cell: &mut Cell, mut held: Held, plan: &TouchPlan, found: &Onset) -> Result<Localization, Halt> {
    let task = &cell.config.task;
    let before = held.belief.map(|known| expected_anyway(known, task.part_sigma_rad, task.part_sigma_mm));
    let fused = before.touching(|known| plan.contact(cell, known, found.travel_mm, found.sigma_mm));
    let expected_mm = 0.5 * plan.max_travel_mm;
    let note = serde_json::json!({
        "touch": plan.touched.edge,
        "side": plan.touched.side.name(),
        "touched_mm": found.travel_mm,
        "onset_sigma_mm": found.sigma_mm,
        "expected_mm": expected_mm,
        "squared_distance": fused.as_ref().ok().map(|fused| fused.squared_distance),
    });
    cell.log.note(&note);
    cell.log.end(vec![
        figure("touched_mm", found.travel_mm),
        figure("expected_mm", expected_mm),
        figure("onset_sigma_mm", found.sigma_mm),
    ]);
    match fused {
        Ok(FusedBelief { squared_distance, .. }) if squared_distance > MAX_SQUARED_DISTANCE => {
            let reason = format!(
                "the part touched face {} of task.edges {:.2} mm from where it was expected: a squared \
                 distance of {squared_distance:.1}, of which {MAX_SQUARED_DISTANCE} is the limit; is the \
                 face where the configuration says, and did the part slip in the fingers?",
                plan.touched.edge,
                found.travel_mm - expected_mm
            );
            Ok(Localization::Declined { reason })
        }
        Ok(FusedBelief { belief, .. }) => {
            held.t_gripper_object = belief.likeliest().pose;
            held.localized.t_gripper_object = held.t_gripper_object.to_rows();
            held.belief = belief;
            Ok(Localization::Go(Box::new(held)))
        }
        Err(error) => Ok(Localization::Declined { reason: error.to_string() }),
    }
}
