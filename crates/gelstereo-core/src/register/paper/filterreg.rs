//! FilterReg (W. Gao and R. Tedrake, "FilterReg: Robust and Efficient Probabilistic Point-Set
//! Registration", 2019).
//!
//! The patch is the model, the template the observation. Every point of the patch is attracted to the
//! Gaussian mean of the template around it (E step), the patch moves rigidly (M step), and the Gaussian
//! shrinks to fit.
//!
//! It is as published: point to point, uniform outliers, and a width that follows from the residuals. The
//! gel's shoulder around the contact violates both: it is one-sided, dense beside the contact, and widens
//! the Gaussian that should reject it. The result is then biased outwards.

use super::icp;
use super::problem::{Outcome, Problem, Scratch, check_reach, compose};
use super::soft::soft_match;
use crate::math::{Pose, exp, ln, sqrt};
use crate::register::error::MIN_PATCH;
use crate::register::error::RegisterError;
use crate::register::observe::{PatchFrame, System};
use crate::stop::{Stopped, ask_often};

/// Registers from the guess.
pub(super) fn run(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    guess: &Pose,
) -> Result<Outcome, RegisterError> {
    let (params, spacing_mm) = (problem.params, problem.template.spacing_mm());
    let floor_mm = width_floor_mm(problem);
    let tolerance_mm = params.advanced.step_tolerance * spacing_mm;
    let max_sigma_mm = params.filterreg.max_sigma_mm.max(floor_mm);
    let mut sigma_mm = max_sigma_mm;
    let mut outcome = Outcome { t_sensor_object: *guess, converged: false, iterations: 0 };
    scratch.place(problem.points_mm, guess);
    check_reach(problem, &scratch.placed, params.advanced.search_radius_mm)?;
    while outcome.iterations < params.advanced.max_iterations && !outcome.converged {
        expect(problem, scratch, sigma_mm)?;
        let motion = icp::fit(scratch);
        let next_sigma_mm = width_mm(scratch, &motion).clamp(floor_mm, max_sigma_mm);
        let is_short = |motion: &Pose| scratch.largest_move_mm(motion) <= tolerance_mm;
        outcome.converged = (next_sigma_mm - sigma_mm).abs() <= tolerance_mm
            && (is_short(&motion) || is_short(&determined(problem, scratch, &motion)));
        sigma_mm = next_sigma_mm;
        outcome.t_sensor_object = compose(&outcome.t_sensor_object, &motion);
        outcome.iterations += 1;
        scratch.place(problem.points_mm, &outcome.t_sensor_object);
    }
    Ok(outcome)
}

/// Smallest width. Over samples with spacing s the sum of Gaussians of width s/2 ripples by
/// 2 e^(-π²/2) = 1.4 % (Poisson summation). Narrower ones resolve single points and lock the patch to them.
pub(super) fn width_floor_mm(problem: &Problem<'_>) -> f64 {
    problem.params.filterreg.min_sigma_mm.max(0.5 * problem.template.spacing_mm())
}

/// Computes soft matches, targets and responsibilities of all points.
fn expect(problem: &Problem<'_>, scratch: &mut Scratch, sigma_mm: f64) -> Result<(), Stopped> {
    scratch.clear_pairs();
    let log_outlier = log_outlier_mass(problem, sigma_mm);
    for (step, &point) in scratch.placed.iter().enumerate() {
        ask_often(problem.stop, step)?;
        let soft = soft_match(problem.template, point, sigma_mm);
        scratch.sources.push(point);
        scratch.targets.push(point + soft.offset_mm);
        scratch.weights.push(1.0 / (1.0 + exp(log_outlier - soft.log_mass)));
        scratch.soft.push(soft);
    }
    // A width far below the distances makes every point an outlier, with no step. Then all points count
    // equally, and the width follows from their distances.
    if scratch.weights.iter().sum::<f64>() < MIN_PATCH as f64 {
        scratch.weights.fill(1.0);
    }
    Ok(())
}

/// The part of a step that counts for convergence. Along free directions the patch drifts
/// between samples indefinitely. Free directions are judged by the soft normals, as in the steps: facet
/// normals would give more of them, and box faces would stop while their edges still push.
fn determined(problem: &Problem<'_>, scratch: &Scratch, motion: &Pose) -> Pose {
    let frame = PatchFrame::new(&scratch.sources, problem.template.spacing_mm());
    let sigma_mm = problem.params.point_sigma_mm;
    let mut system = System::new(frame.radius_mm, sigma_mm);
    for ((soft, &point), &weight) in scratch.soft.iter().zip(&scratch.sources).zip(&scratch.weights) {
        system.add(&soft.sighting(problem.template, point - frame.centre_mm, weight, sigma_mm));
    }
    frame.motion(system.observe(frame.centre_mm).determined(frame.twist(motion)))
}

/// Standard deviation per axis of the points around their Gaussian means' samples, at the coordinates
/// after `motion`: Σ w (|D x - m|² + Σ p |y - m|²) / 3 Σ w, a sum of squares and so never negative.
fn width_mm(scratch: &Scratch, motion: &Pose) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for (((&x, &m), soft), &w) in
        scratch.sources.iter().zip(&scratch.targets).zip(&scratch.soft).zip(&scratch.weights)
    {
        sum += w * (motion.transform_point(x).distance_squared(m) + soft.spread_mm2);
        total += w;
    }
    sqrt(sum / (3.0 * total))
}

/// ln c, with M / (M + c) the responsibility of a point with Gaussian mass M = Σ exp(-|y - x|² / 2σ²).
///
/// Outliers are uniform over the slab within D = `max_distance_mm` of a surface with one sample per s²,
/// hence of density 1 / (2 D s²) per sample: c = (2π σ²)^(3/2) w / (1 - w) / (2 D s²). The unit-free 1/N
/// of the original would make the result depend on the unit of length.
fn log_outlier_mass(problem: &Problem<'_>, sigma_mm: f64) -> f64 {
    let share = problem.params.advanced.outlier_share;
    if share == 0.0 {
        // ln 0, which the exponential maps back to 0.
        return f64::NEG_INFINITY;
    }
    let spacing_mm = problem.template.spacing_mm();
    let variance = core::f64::consts::TAU * sigma_mm * sigma_mm;
    let slab = 2.0 * problem.params.advanced.max_distance_mm * spacing_mm * spacing_mm;
    1.5 * ln(variance) + ln(share / (1.0 - share)) - ln(slab)
}
