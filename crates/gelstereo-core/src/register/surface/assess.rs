//! The result for a pose: information, free directions, evidence, and alternatives.

use super::candidate::Candidate;
use super::contact::Samples;
use super::objective::Objective;
use super::search::Outcome;
use super::state::Problem;
use crate::math::{Pose, exp, ln, sqrt};
use crate::register::observe::halves;
use crate::register::{Alternative, Alternatives, FreeDirections, Observability, Registration, Verdict};

/// Result for the best candidate, from the readings at the outcome's pose.
pub(super) fn registration(
    problem: &Problem<'_>,
    objective: &mut dyn Objective,
    candidates: &[Candidate],
    outcome: Outcome,
) -> Registration {
    let Problem { params, samples, .. } = *problem;
    let (best, Outcome { end, read, .. }) = (&candidates[0], &outcome);
    let t_sensor_object = pose(samples, best);
    let back = t_sensor_object.inverse();
    let in_object = objective.observe(problem, read, end.converged).widened(objective.excess(problem));
    let at_pose = objective.odds(problem).log;
    let elsewhere = if outcome.is_selected { searched(problem, &in_object, candidates) } else { 0.0 };
    let log_odds = at_pose - elsewhere;
    let (mut sum_squared, mut total, mut inliers) = (0.0, 0.0, 0);
    let distances = objective.distances();
    for (r, touches) in distances.here.all[..samples.pressed.len()].iter().zip(&distances.touches) {
        inliers += usize::from(r.distance_mm.abs() <= params.advanced.max_distance_mm);
        sum_squared += touches * r.distance_mm * r.distance_mm;
        total += touches;
    }
    let observability = in_object.turned(&pose(samples, read), samples.centre_mm);
    let in_object = observability.turned(&back, back.transform_point(samples.centre_mm));
    Registration {
        t_sensor_object,
        information: observability.information(),
        observability,
        guess_sigma: params.guess_sigma(),
        converged: end.converged,
        iterations: end.iterations,
        inliers,
        points: samples.pressed.len(),
        rmse_mm: sqrt(sum_squared / total.max(f64::MIN_POSITIVE)),
        free: FreeDirections::new(&in_object, params.point_sigma_mm, &[]),
        log_likelihood: Some(-best.cost),
        log_odds: Some(log_odds),
        verdict: Verdict::new(log_odds, objective.misfit(problem), end.converged),
        gel_decay: objective.gel_decay(problem, best),
        alternatives: alternatives(samples, candidates, outcome.is_cut),
        work: outcome.work,
    }
}

/// Correction for the search over the guess's uncertainty: some pose always fits noise a little. The
/// evidence is the mean over all poses, i.e. the likelihood at a peak times the share of that volume that
/// the peak fills (Laplace's evidence; MacKay 1992), summed over all solutions, the best first.
fn searched(problem: &Problem<'_>, seen: &Observability, answers: &[Candidate]) -> f64 {
    let turn_mm = problem.params.start_sigma_deg.to_radians() * seen.radius_mm;
    let shift_mm = problem.params.start_sigma_mm;
    // Free directions stay at the guess.
    let narrowed = |(u, value): (&[f64; 6], f64)| {
        let (omega, v) = halves(u);
        let guessed = turn_mm * turn_mm * omega.length_squared() + shift_mm * shift_mm * v.length_squared();
        0.5 * ln(1.0 + value * guessed)
    };
    let peaks: f64 = answers.iter().map(|one| exp(answers[0].cost - one.cost)).sum();
    seen.directions.iter().zip(seen.values).map(narrowed).sum::<f64>() - ln(peaks)
}

fn pose(samples: &Samples, candidate: &Candidate) -> Pose {
    let pose = candidate.placement.pose;
    Pose { translation_mm: pose.translation_mm + samples.centre_mm, ..pose }
}

/// The candidates after the best one.
fn alternatives(samples: &Samples, candidates: &[Candidate], is_cut: bool) -> Alternatives {
    let mut out = Alternatives::none_of(is_cut);
    for one in &candidates[1..] {
        out.push(Alternative { t_sensor_object: pose(samples, one), log_likelihood: -one.cost });
    }
    out
}
