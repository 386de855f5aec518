//! Linear system of a [`GelFit`] step: derivatives of the predicted heights by the unknowns.

use super::fit::{GelFit, LAST_SCALE_MM, LONGEST_MM, SWEEPS_A_LOOKUP};
use super::lattice::Node;
use super::model::FEW_SWEEPS;
use super::prediction::{DECAY, GelFitScratch, PLANE, Prediction, Row, Sight, UNKNOWN};
use super::rest::Rest;
use crate::math::linalg::{Symmetric, eigen};
use crate::math::{solve_definite, sqrt};
use crate::register::observe::dot;
use crate::register::surface::candidate::Candidate;
use crate::register::surface::distances::{Line, UNDER_MM};
use crate::register::surface::normal_system::Normal;

/// Standard deviation of the initial rest plane.
const PLANE_SIGMA_MM: f64 = 1.0;
/// Directions with a smaller standard deviation from derivatives alone need no finite differences.
const SMOOTH_MM: f64 = 0.02;
/// Steps with a larger blur use derivatives alone.
const WIDEST_MM: f64 = 0.25;
/// Largest motion of a node, in multiples of the finite difference step.
const BESIDE: f64 = 2.5;
/// Smallest share of a failed step that is tried next.
const MIN_SHARE: f64 = 0.02;

/// A step of all unknowns.
pub(in crate::register::surface) struct Step {
    pub row: Row,
    /// Initial decrease of the cost, per length of the step.
    slope: f64,
}

impl Step {
    /// Minimum of the parabola through the start and a failed try, where `share` of the step raised the
    /// cost by `rise`. Returns the share at the minimum, clamped to 1/50 to 1/2 of `share`, and the
    /// decrease of the cost there. Where clamped to 1/2, the decrease is at least that.
    pub fn lowest(&self, share: f64, rise: f64) -> (f64, f64) {
        let lowest = 0.5 * self.slope * share * share / (rise + self.slope * share);
        // For 0 / 0, `max` returns the operand that is a number.
        let lowest = lowest.max(MIN_SHARE * share).min(0.5 * share);
        (lowest, 0.5 * self.slope * lowest)
    }
}

impl GelFit<'_> {
    /// Computes the derivatives of the predictions by the unknowns; returns the work.
    fn follow(&self, state: &Candidate, scratch: &mut GelFitScratch) -> u64 {
        let GelFitScratch { here, changes, sweeps, cells, .. } = scratch;
        let gel = self.gel();
        for ((node, sight), change) in gel.nodes.iter().zip(&here.sights).zip(&mut *changes) {
            let Some(foot) = sight.foot.as_ref().filter(|_| sight.touches) else { continue };
            *change = self.touching_row(state, node, foot);
        }
        let touches = |k: usize| here.sights[k].touches;
        let stiffness = gel.stiffness(state.rest.log_decay);
        let sweeps = gel.follow(stiffness, touches, &here.heights_mm, changes, sweeps, cells);
        u64::from(sweeps) * (gel.nodes.len() * UNKNOWN) as u64 / SWEEPS_A_LOOKUP / 4
    }

    /// H and g of all unknowns, from `here`. Includes the prior precisions of rest plane and decay, but
    /// not the prior of the pose nor the decay's gradient.
    fn system(&self, rows: &[Row], here: &Prediction) -> (Symmetric<UNKNOWN>, Row) {
        let (mut h, mut g) = ([[0.0; UNKNOWN]; UNKNOWN], [0.0; UNKNOWN]);
        for (sight, row) in here.sights.iter().zip(rows) {
            let weight = sight.weight / sight.variance_mm2;
            for i in 0..UNKNOWN {
                let wj = weight * row[i];
                g[i] += wj * sight.residual_mm;
                (i..UNKNOWN).for_each(|k| h[i][k] += wj * row[k]);
            }
        }
        let plane_mm = self.problem.params.scaled(PLANE_SIGMA_MM);
        for i in PLANE..DECAY {
            h[i][i] += 1.0 / (plane_mm * plane_mm);
        }
        h[DECAY][DECAY] += Rest::decay_precision();
        (h, g)
    }

    /// Predicts the heights of a state near that of `here`, on the field, into `there`; returns the work.
    fn beside(&self, state: &Candidate, scale_mm: f64, scratch: &mut GelFitScratch) -> u64 {
        let GelFitScratch { here, there, obstacle_mm, lines, sweeps, .. } = scratch;
        let (placement, gel) = (&state.placement, self.gel());
        let press = placement.object_direction(self.problem.press_direction);
        let per_radius = 1.0 / self.problem.samples.radius_mm;
        let (near_mm, under_mm) = (BESIDE * scale_mm, self.problem.params.scaled(UNDER_MM));
        let mut lookups = 0;
        let line = |(node, sight): (&Node, &Sight)| {
            let start_mm = match sight.foot {
                Some(foot) => near_mm - foot.over_mm,
                None if sight.clear_mm > near_mm => return Line::past(),
                None => under_mm,
            };
            lookups += 2;
            Line::new(placement.object_point(node.sample.p_mm), start_mm)
        };
        lines.clear();
        lines.extend(gel.nodes.iter().zip(&here.sights).map(line));
        self.problem.field.march(lines, press);
        obstacle_mm.clear();
        obstacle_mm.extend(gel.nodes.iter().zip(&*lines).map(|(node, line)| {
            let over_plane_mm = node.along_mm - state.rest.at(node.across_mm * per_radius);
            line.foot.map_or(f64::NEG_INFINITY, |foot| over_plane_mm - foot.over_mm)
        }));
        there.heights_mm.clear();
        there.heights_mm.extend_from_slice(&here.heights_mm);
        let stiffness = gel.stiffness(state.rest.log_decay);
        let sweeps = gel.settle(stiffness, FEW_SWEEPS, obstacle_mm, &mut there.heights_mm, sweeps);
        lookups + u64::from(sweeps) * gel.nodes.len() as u64 / SWEEPS_A_LOOKUP
    }

    /// Linear system from `here` in an eigenbasis of the pose, the basis with one direction per row, and
    /// the work. Directions that derivatives determine poorly use finite differences over `scale_mm`,
    /// which include the markers that an edge passes.
    fn linear(
        &self,
        state: &Candidate,
        scale_mm: f64,
        scratch: &mut GelFitScratch,
    ) -> (Symmetric<UNKNOWN>, Row, [[f64; 6]; 6], u64) {
        let mut work = self.follow(state, scratch);
        self.fill_rows(scratch);
        let (h, _) = self.system(&scratch.rows, &scratch.here);
        let spectrum = eigen(&without_rest(h));
        for row in &mut scratch.rows {
            let turned: [f64; 6] =
                core::array::from_fn(|k| spectrum.vectors[k].iter().zip(&*row).map(|(u, x)| u * x).sum());
            row[..6].copy_from_slice(&turned);
        }
        let [smooth_mm, widest_mm] = [SMOOTH_MM, WIDEST_MM].map(|mm| self.problem.params.scaled(mm));
        for (k, (value, u)) in spectrum.values.iter().zip(&spectrum.vectors).enumerate() {
            if *value * smooth_mm * smooth_mm > 1.0 || scale_mm > widest_mm {
                continue;
            }
            scratch.rows.iter_mut().for_each(|row| row[k] = 0.0);
            for sign in [-1.0, 1.0] {
                let mut step = [0.0; UNKNOWN];
                (0..6).for_each(|i| step[i] = sign * scale_mm * u[i]);
                let there = self.moved(state, &step, 1.0);
                work += self.beside(&there, scale_mm, scratch);
                for (row, height_mm) in scratch.rows.iter_mut().zip(&scratch.there.heights_mm) {
                    row[k] += sign * height_mm * (0.5 / scale_mm);
                }
            }
        }
        let (h, g) = self.system(&scratch.rows, &scratch.here);
        (h, g, spectrum.vectors, work)
    }

    /// The next step of a state whose prediction is in the scratch.
    pub(in crate::register::surface) fn next(
        &self,
        state: &Candidate,
        scratch: &mut GelFitScratch,
    ) -> Option<Row> {
        self.step(state, self.problem.params.scaled(LAST_SCALE_MM), scratch).0.map(|step| step.row)
    }

    /// The step from `here`, at most [`LONGEST_MM`] over the patch, and the work.
    pub(in crate::register::surface) fn step(
        &self,
        state: &Candidate,
        scale_mm: f64,
        scratch: &mut GelFitScratch,
    ) -> (Option<Step>, u64) {
        let (mut h, mut g, basis, work) = self.linear(state, scale_mm, scratch);
        let mut prior = Normal::ZERO;
        prior.add_prior(&self.problem.prior, &state.placement, self.problem.samples.radius_mm, 1.0);
        let (prior_h, prior_g) = prior.parts();
        for i in 0..6 {
            g[i] += dot(&basis[i], prior_g);
            // The prior's H is diagonal.
            (i..6).for_each(|k| {
                h[i][k] += (0..6).map(|j| basis[i][j] * prior_h[j][j] * basis[k][j]).sum::<f64>()
            });
        }
        g[DECAY] -= state.rest.decay_slope();
        let step = solve_definite(&h, &g).filter(|z| z.iter().all(|x| x.is_finite())).map(|z| {
            let length = sqrt(z[..6].iter().map(|x| x * x).sum());
            let longest_mm = self.problem.params.scaled(LONGEST_MM);
            let share = if length > longest_mm { longest_mm / length } else { 1.0 };
            let mut row = z.map(|x| share * x);
            let slope = row.iter().zip(&g).map(|(x, g)| x * g).sum();
            let along = [row[0], row[1], row[2], row[3], row[4], row[5]];
            (0..6).for_each(|i| row[i] = (0..6).map(|k| along[k] * basis[k][i]).sum());
            Step { row, slope }
        });
        (step, work)
    }

    fn fill_rows(&self, scratch: &mut GelFitScratch) {
        let radius_mm = self.problem.samples.radius_mm;
        scratch.rows.clear();
        for (node, change) in self.gel().nodes.iter().zip(&scratch.changes) {
            let [u, v] = (node.across_mm / radius_mm).to_array();
            let mut row = *change;
            row[PLANE] += 1.0;
            row[PLANE + 1] += u;
            row[PLANE + 2] += v;
            scratch.rows.push(row);
        }
    }
}

/// Schur complement of the unknowns other than the pose, eliminated from the last one on. Reads only the
/// upper triangle of `h`.
fn without_rest(mut h: Symmetric<UNKNOWN>) -> Symmetric<6> {
    for last in (6..UNKNOWN).rev() {
        for i in 0..last {
            let factor = h[i][last] / h[last][last];
            for k in i..last {
                h[i][k] -= factor * h[k][last];
            }
        }
    }
    core::array::from_fn(|i| core::array::from_fn(|k| if i <= k { h[i][k] } else { h[k][i] }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn step(slope: f64) -> Step {
        Step { row: [0.0; UNKNOWN], slope }
    }

    proptest! {
        /// A parabola c(s) = -slope s + curve s² that is higher at `share` than at 0.
        #[test]
        fn a_parabola_is_lowest_where_it_is_said_to_be(
            slope in 1e-3_f64..1e3,
            share in 0.01_f64..1.0,
            lowest in 0.03_f64..0.49,
        ) {
            let curve = 0.5 * slope / (lowest * share);
            let rise = -slope * share + curve * share * share;
            let (at, gain) = step(slope).lowest(share, rise);
            prop_assert!((at / (lowest * share) - 1.0).abs() < 1e-9, "{at}");
            let there = -slope * at + curve * at * at;
            prop_assert!((gain / -there - 1.0).abs() < 1e-9, "{gain} of {there}");
        }
    }

    #[test]
    fn a_step_without_a_way_down_is_tried_at_its_least_share() {
        for rise in [0.0, 1.0, f64::INFINITY] {
            assert_eq!(step(0.0).lowest(1.0, rise), (MIN_SHARE, 0.0));
        }
        // Without a rise: half the share.
        assert_eq!(step(1.0).lowest(1.0, 0.0).0, 0.5);
    }
}
