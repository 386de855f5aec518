//! Evidence at the returned pose: inliers, residual, information and free directions.

use super::facet::{Facet, facet};
use super::filterreg::width_floor_mm;
use super::problem::{Outcome, Problem, Scratch, check_reach};
use super::soft::soft_match;
use crate::math::{centroid, sqrt};
use crate::register::error::MIN_PATCH;
use crate::register::observe::{PatchFrame, Sighting, System};
use crate::register::{Alternatives, FreeDirections, RegisterError, Registration, Verdict};
use crate::stop::{Stopped, ask_often};

/// The result of a stage that ended at `outcome`. All rungs are assessed alike, on soft matches of the
/// points within `max_distance_mm`.
pub(super) fn registration(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    outcome: &Outcome,
) -> Result<Registration, RegisterError> {
    let Problem { params, points_mm, template, stop } = *problem;
    let pose = &outcome.t_sensor_object;
    scratch.place(points_mm, pose);
    let width_mm = width_floor_mm(problem);
    match_inliers(problem, scratch, width_mm)?;
    if scratch.sources.len() < MIN_PATCH {
        check_reach(problem, &scratch.placed, params.advanced.max_distance_mm)?;
    }
    let frame = PatchFrame::new(&scratch.sources, template.spacing_mm());
    let mut system = System::new(frame.radius_mm, params.point_sigma_mm);
    let (mut sum_squared, mut along_normals) = (0.0, 0.0);
    for (step, (soft, &point)) in scratch.soft.iter().zip(&scratch.sources).enumerate() {
        ask_often(stop, step)?;
        let lever = point - frame.centre_mm;
        let seen = soft.sighting(template, lever, 1.0, params.point_sigma_mm);
        sum_squared += soft.distance_mm * soft.distance_mm;
        along_normals += seen.residual * seen.residual;
        // Uses the facet's normal. A soft mean over two faces would falsely observe sideways motion at
        // every edge of a flat contact.
        let Facet { normal, normal_variance } = facet(template, point, width_mm, params.point_sigma_mm);
        system.add(&Sighting { normal, normal_variance, ..seen });
    }
    let total = scratch.sources.len() as f64;
    if !outcome.converged {
        system.blur(None);
    }
    let in_object = system.observe(frame.centre_mm);
    let determined = 6 - in_object.free_count();
    let excess = along_normals
        / (params.point_sigma_mm * params.point_sigma_mm * (total - determined as f64).max(1.0));
    let observability = in_object.turned(pose, centroid(&scratch.targets)).widened(excess);
    Ok(Registration {
        t_sensor_object: *pose,
        information: observability.information(),
        observability,
        guess_sigma: params.guess_sigma(),
        converged: outcome.converged,
        iterations: outcome.iterations,
        inliers: scratch.sources.len(),
        points: points_mm.len(),
        rmse_mm: sqrt(sum_squared / total.max(f64::MIN_POSITIVE)),
        log_likelihood: None,
        log_odds: None,
        verdict: Verdict::Unsure,
        gel_decay: None,
        alternatives: Alternatives::NONE,
        work: 0,
        // Normals are read at samples, hence up to half a spacing away.
        free: FreeDirections::new(&in_object, params.point_sigma_mm.max(0.5 * template.spacing_mm()), &[]),
    })
}

/// Stores the inliers in the scratch: sources in the object's frame, targets as the same points in the
/// sensor's.
fn match_inliers(problem: &Problem<'_>, scratch: &mut Scratch, width_mm: f64) -> Result<(), Stopped> {
    scratch.clear_pairs();
    for (step, (&placed, &point)) in scratch.placed.iter().zip(problem.points_mm).enumerate() {
        ask_often(problem.stop, step)?;
        let soft = soft_match(problem.template, placed, width_mm);
        if soft.distance_mm <= problem.params.advanced.max_distance_mm {
            scratch.sources.push(placed);
            scratch.targets.push(point);
            scratch.soft.push(soft);
        }
    }
    Ok(())
}
