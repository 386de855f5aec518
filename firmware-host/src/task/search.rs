//! Searches for the hole: a part stopped at the rim is lifted, shifted a little, and lowered again.

use super::cell::Cell;
use super::error::Halt;
use super::insert::insert;
use super::localize::Held;
use super::log::figure;
use super::retreat::retreat;
use crate::report::{Outcome, Stage};
use gelstereo_core::math::{Pose, cos, sin, sqrt};

/// Standard deviations of the tip position that the search covers.
const REACH_SIGMAS: f64 = 3.0;

/// Inserts from `above` and leaves the hole. If the part jams, it retries on rings around `above`, up to
/// `task.max_tries` tries in all.
pub(super) fn insert_by_search(cell: &mut Cell, above: &Pose, held: &Held) -> Result<Outcome, Halt> {
    let mut outcome = try_at(cell, above, held)?;
    let task = &cell.config.task;
    let (Some(clearance_mm), Some(forecast)) = (task.clearance_mm, &held.localized.forecast) else {
        return Ok(outcome);
    };
    let axis = (*above * held.t_gripper_object).transform_vector(cell.config.insertion_axis());
    let across = axis.any_orthonormal_vector();
    let reach_mm = (REACH_SIGMAS * forecast.lateral_sigma_mm).max(clearance_mm);
    for step in rings(clearance_mm, reach_mm).take(task.max_tries.saturating_sub(1) as usize) {
        if !matches!(outcome, Outcome::Jammed { .. }) {
            break;
        }
        cell.log.begin(Stage::Align);
        let shift_mm = across * step.x_mm + axis.cross(across) * step.y_mm;
        let next = Pose::from_translation_mm(shift_mm) * *above;
        cell.go(&next, task.move_speed_mm_s)?;
        cell.log.end(vec![figure("shift_mm", shift_mm.length())]);
        outcome = try_at(cell, &next, held)?;
    }
    Ok(outcome)
}

/// Inserts once and leaves the hole; a part that jams returns to its start.
fn try_at(cell: &mut Cell, above: &Pose, held: &Held) -> Result<Outcome, Halt> {
    let outcome = insert(cell, above, held)?;
    retreat(cell, above, &outcome)?;
    Ok(outcome)
}

/// Shift of the part across the hole.
struct Step {
    x_mm: f64,
    y_mm: f64,
}

/// Positions on hexagonal rings, nearest ring first. A hole accepts an offset of half the clearance.
/// Neighbours are √3 times that apart, like the centres of circles that cover the plane.
fn rings(clearance_mm: f64, reach_mm: f64) -> impl Iterator<Item = Step> {
    let radius_mm = 0.5 * clearance_mm;
    let apart_mm = sqrt(3.0) * radius_mm;
    (1_u32..)
        .take_while(move |&ring| 0.5 * sqrt(3.0) * f64::from(ring) * apart_mm - radius_mm < reach_mm)
        .flat_map(move |ring| {
            (0..6 * ring).map(move |k| {
                // From a corner of the ring along its side.
                let (side, along) = (f64::from(k / ring), f64::from(k % ring));
                let corner = side * core::f64::consts::FRAC_PI_3;
                let way = corner + 2.0 * core::f64::consts::FRAC_PI_3;
                Step {
                    x_mm: apart_mm * (f64::from(ring) * cos(corner) + along * cos(way)),
                    y_mm: apart_mm * (f64::from(ring) * sin(corner) + along * sin(way)),
                }
            })
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gelstereo_core::math::random::Stream;

    #[test]
    fn every_place_within_reach_is_covered_by_half_the_clearance() {
        let (clearance_mm, reach_mm) = (0.2, 0.9);
        let mut steps: Vec<Step> = rings(clearance_mm, reach_mm).collect();
        steps.push(Step { x_mm: 0.0, y_mm: 0.0 });
        let mut stream = Stream::new(3, "places");
        for _ in 0..2000 {
            let (radius, angle) =
                (reach_mm * sqrt(stream.uniform()), core::f64::consts::TAU * stream.uniform());
            let (x, y) = (radius * cos(angle), radius * sin(angle));
            let off = |s: &Step| sqrt((s.x_mm - x) * (s.x_mm - x) + (s.y_mm - y) * (s.y_mm - y));
            let nearest = steps.iter().map(off).fold(f64::INFINITY, f64::min);
            assert!(nearest <= 0.5 * clearance_mm + 1e-9, "{nearest} mm from ({x}, {y})");
        }
    }

    #[test]
    fn places_differ_and_end_near_the_reach() {
        let steps: Vec<Step> = rings(0.2, 0.5).collect();
        assert_eq!(steps.len(), 6 + 12 + 18);
        for (k, step) in steps.iter().enumerate() {
            assert!(sqrt(step.x_mm * step.x_mm + step.y_mm * step.y_mm) < 0.5 + 0.2);
            let off = |s: &Step| sqrt((s.x_mm - step.x_mm).powi(2) + (s.y_mm - step.y_mm).powi(2));
            assert!(steps[..k].iter().all(|other| off(other) > 0.17));
        }
    }
}
