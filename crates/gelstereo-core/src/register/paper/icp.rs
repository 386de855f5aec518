//! Iterated closest points, point to point (Besl and McKay 1992).

use super::problem::{Outcome, Problem, Scratch, check_reach, compose};
use crate::math::Pose;
use crate::register::error::RegisterError;
use crate::register::rigid::rigid_fit;
use crate::stop::{Stopped, ask_often};

/// Iterates from a start until steps are short enough or the iterations run out.
pub(super) fn run(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    start: &Pose,
) -> Result<Outcome, RegisterError> {
    let tolerance_mm = problem.params.advanced.step_tolerance * problem.template.spacing_mm();
    let mut outcome = Outcome { t_sensor_object: *start, converged: false, iterations: 0 };
    scratch.place(problem.points_mm, start);
    check_reach(problem, &scratch.placed, problem.params.advanced.max_distance_mm)?;
    while outcome.iterations < problem.params.advanced.max_iterations && !outcome.converged {
        pair(problem, scratch)?;
        let motion = fit(scratch);
        outcome.converged = scratch.largest_move_mm(&motion) <= tolerance_mm;
        outcome.t_sensor_object = compose(&outcome.t_sensor_object, &motion);
        outcome.iterations += 1;
        scratch.place(problem.points_mm, &outcome.t_sensor_object);
    }
    Ok(outcome)
}

/// Pairs every placed point with its nearest template point within reach.
fn pair(problem: &Problem<'_>, scratch: &mut Scratch) -> Result<(), Stopped> {
    let reach_squared = problem.params.advanced.max_distance_mm * problem.params.advanced.max_distance_mm;
    scratch.clear_pairs();
    for (step, &point) in scratch.placed.iter().enumerate() {
        ask_often(problem.stop, step)?;
        if let Some((nearest, distance_squared)) = problem.template.tree().nearest(point)
            && distance_squared <= reach_squared
        {
            scratch.sources.push(point);
            scratch.targets.push(problem.template.points_mm()[nearest]);
        }
    }
    Ok(())
}

/// The rigid motion of the pairs in the scratch; the identity without pairs.
pub(super) fn fit(scratch: &Scratch) -> Pose {
    rigid_fit(&scratch.sources, &scratch.targets, &scratch.weights)
        .map_or(Pose::IDENTITY, |fit| fit.t_target_source)
}
