//! Iterated closest points: to the points (Besl and McKay 1992) and to their planes (Chen and Medioni 1992).

use super::observe::{PatchFrame, Sighting, System};
use super::one_sided::{self, OneSided};
use super::rigid::rigid_fit;
use super::{Outcome, Problem, RegisterError, Scratch, check_reach, compose};
use crate::math::{DVec3, Pose};
use crate::stop::{Stopped, ask_often};

/// Point to point, from a start.
pub(super) fn point_to_point(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    start: &Pose,
) -> Result<Outcome, RegisterError> {
    iterate(problem, scratch, start, problem.params.point_sigma_mm, |problem, scratch, _| {
        pair(problem, scratch, |_| {})?;
        Ok(fit(scratch))
    })
}

/// Point to plane, from a start.
pub(super) fn point_to_plane(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    start: &Pose,
) -> Result<Outcome, RegisterError> {
    iterate(
        problem,
        scratch,
        start,
        one_sided::first(problem.params),
        |problem, scratch, contact_sigma_mm| {
            let one_sided = OneSided::new(contact_sigma_mm, problem.params.max_distance_mm);
            let frame = PatchFrame::new(&scratch.placed, problem.template.spacing_mm());
            let sigma_mm = problem.params.point_sigma_mm;
            let mut system = System::new(frame.radius_mm, sigma_mm);
            pair(problem, scratch, |(nearest, source)| {
                let (target, normal) =
                    (problem.template.points_mm()[nearest], problem.template.normals()[nearest]);
                let offset = target - source;
                let residual = normal.dot(offset);
                system.add(&Sighting {
                    lever: source - frame.centre_mm,
                    normal,
                    residual,
                    weight: one_sided.weight(residual),
                    normal_variance: problem.template.step_variance(nearest, offset, sigma_mm),
                });
            })?;
            Ok(frame.motion(system.solve(problem.params.max_distance_mm)))
        },
    )
}

/// Steps until they are short enough and their σ is the last, or the iterations run out. `step` is told σ.
fn iterate(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    start: &Pose,
    first_sigma_mm: f64,
    step: impl Fn(&Problem<'_>, &mut Scratch, f64) -> Result<Pose, Stopped>,
) -> Result<Outcome, RegisterError> {
    let tolerance_mm = problem.params.step_tolerance * problem.template.spacing_mm();
    let mut sigma_mm = first_sigma_mm;
    let mut outcome = Outcome { t_sensor_object: *start, converged: false, iterations: 0 };
    scratch.place(problem.points_mm, start);
    check_reach(problem, &scratch.placed, problem.params.max_distance_mm)?;
    while outcome.iterations < problem.params.max_iterations && !outcome.converged {
        let motion = step(problem, scratch, sigma_mm)?;
        let next_sigma_mm = one_sided::next(problem.params, sigma_mm);
        outcome.converged = scratch.largest_move_mm(&motion) <= tolerance_mm && next_sigma_mm == sigma_mm;
        sigma_mm = next_sigma_mm;
        outcome.t_sensor_object = compose(&outcome.t_sensor_object, &motion);
        outcome.iterations += 1;
        scratch.place(problem.points_mm, &outcome.t_sensor_object);
    }
    Ok(outcome)
}

/// Pairs every placed point with its nearest within the reach, and shows each (template index, point) to `see`.
fn pair(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    mut see: impl FnMut((usize, DVec3)),
) -> Result<(), Stopped> {
    let reach_squared = problem.params.max_distance_mm * problem.params.max_distance_mm;
    scratch.clear_pairs();
    for (step, &point) in scratch.placed.iter().enumerate() {
        ask_often(problem.stop, step)?;
        if let Some((nearest, distance_squared)) = problem.template.tree().nearest(point)
            && distance_squared <= reach_squared
        {
            scratch.sources.push(point);
            scratch.targets.push(problem.template.points_mm()[nearest]);
            see((nearest, point));
        }
    }
    Ok(())
}

/// The rigid motion of the pairs in the scratch; none when there are none.
pub(super) fn fit(scratch: &Scratch) -> Pose {
    rigid_fit(&scratch.sources, &scratch.targets, &scratch.weights)
        .map_or(Pose::IDENTITY, |fit| fit.t_target_source)
}
