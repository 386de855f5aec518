//! Iterated closest points: to the points (Besl and McKay 1992) and to their planes (Chen and Medioni 1992).

use super::observe::{PatchFrame, Sighting, System};
use super::rigid::rigid_fit;
use super::{Outcome, Problem, RegisterError, Scratch, check_reach, compose};
use crate::math::{DVec3, Pose};

/// Point to point, from a start.
pub(super) fn point_to_point(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    start: &Pose,
) -> Result<Outcome, RegisterError> {
    iterate(problem, scratch, start, |problem, scratch| {
        pair(problem, scratch, |_| {});
        fit(scratch)
    })
}

/// Point to plane, from a start.
pub(super) fn point_to_plane(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    start: &Pose,
) -> Result<Outcome, RegisterError> {
    iterate(problem, scratch, start, |problem, scratch| {
        let frame = PatchFrame::new(&scratch.placed, problem.template.spacing_mm());
        let sigma_mm = problem.params.point_sigma_mm;
        let mut system = System::new(frame.radius_mm, sigma_mm);
        pair(problem, scratch, |(nearest, source)| {
            let (target, normal) =
                (problem.template.points_mm()[nearest], problem.template.normals()[nearest]);
            let offset = target - source;
            system.add(&Sighting {
                lever: source - frame.centre_mm,
                normal,
                residual: normal.dot(offset),
                weight: 1.0,
                normal_variance: problem.template.step_variance(nearest, offset, sigma_mm),
            });
        });
        frame.motion(system.solve(problem.params.max_distance_mm))
    })
}

/// Steps until they are short enough or the iterations run out.
fn iterate(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    start: &Pose,
    step: impl Fn(&Problem<'_>, &mut Scratch) -> Pose,
) -> Result<Outcome, RegisterError> {
    let tolerance_mm = problem.params.step_tolerance * problem.template.spacing_mm();
    let mut outcome = Outcome { t_sensor_object: *start, converged: false, iterations: 0 };
    scratch.place(problem.points_mm, start);
    check_reach(problem, &scratch.placed, problem.params.max_distance_mm)?;
    while outcome.iterations < problem.params.max_iterations && !outcome.converged {
        let motion = step(problem, scratch);
        outcome.converged = scratch.largest_move_mm(&motion) <= tolerance_mm;
        outcome.t_sensor_object = compose(&outcome.t_sensor_object, &motion);
        outcome.iterations += 1;
        scratch.place(problem.points_mm, &outcome.t_sensor_object);
    }
    Ok(outcome)
}

/// Pairs every placed point with its nearest within the reach, and shows each (template index, point) to `see`.
fn pair(problem: &Problem<'_>, scratch: &mut Scratch, mut see: impl FnMut((usize, DVec3))) {
    let reach_squared = problem.params.max_distance_mm * problem.params.max_distance_mm;
    scratch.clear_pairs();
    for &point in &scratch.placed {
        if let Some((nearest, distance_squared)) = problem.template.tree().nearest(point)
            && distance_squared <= reach_squared
        {
            scratch.sources.push(point);
            scratch.targets.push(problem.template.points_mm()[nearest]);
            see((nearest, point));
        }
    }
}

/// The rigid motion of the pairs in the scratch; none when there are none.
pub(super) fn fit(scratch: &Scratch) -> Pose {
    rigid_fit(&scratch.sources, &scratch.targets, &scratch.weights)
        .map_or(Pose::IDENTITY, |fit| fit.t_target_source)
}
