//! Final steps: maximum likelihood under the mixture of contact, free gel and outliers.
//!
//! Distances are looked up once per step, and the contact probabilities follow from them (expectation
//! maximisation). A step that does not increase the likelihood is halved: at creases the nearest face
//! changes, and full Gauss-Newton steps would oscillate between two faces.

use super::candidate::{Candidate, End};
use super::coarse::{Clear, View};
use super::contact::Samples;
use super::distances::{Distances, Last, Near, Range, press_in_object};
use super::mixture::{Bell, Likelihood, Loose, STRAY_MM};
use super::normal_system::{Normal, Placement};
use super::state::{Limits, Problem};
use crate::math::{DVec3, sqrt};
use alloc::vec::Vec;

/// Largest height over the part of salient points that are not in contact.
const SHOULDER_MM: f64 = 1.0;
/// The same for the other markers.
const FREE_MM: f64 = 4.0;
/// Markers that are not salient have no influence from this distance over the part.
const FAR_MM: f64 = 0.5;
/// Initial distance over the part from which these are not evaluated; refinement does not move the part
/// as far.
const OUT_OF_REACH_MM: f64 = 1.2;
/// Halvings of a step on the exact surface.
const HALVINGS: u32 = 4;
/// Length of the last step of a run, in tolerances.
const LAST_STEP: f64 = 10.0;
/// Expectation steps per maximisation step; they cost no lookups.
const EXPECTATIONS: u32 = 2;
/// Longest step, over the patch.
const LONGEST_MM: f64 = 0.5;
/// Faces with a smaller cosine to the press are too steep for contact; the gel is free beside them.
const STEEP_COSINE: f64 = 0.35;
/// Depth inside the part, in standard deviations, from which a marker that cannot be in contact pushes.
const SLACK: f64 = 2.0;
/// Distance, in standard deviations, from which the triangles are not evaluated. The weight there is e^-8
/// of the maximum, and the field suffices.
const ASKED: f64 = 4.0;
/// Contact probability of a salient point where the gel is concave (fillets).
const HANGING: f64 = 0.02;
/// Initial contact probability of salient points, and of others.
const FIRST: [f64; 2] = [0.6, 0.05];

/// Distance of a point, its normal in the sensor's frame, and its variance along that.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading {
    pub distance_mm: f64,
    pub normal: DVec3,
    pub variance_mm2: f64,
    pub sigma_mm: f64,
    /// Normal density of the distance in contact.
    pub bell: Bell,
    pub curvature_per_mm: f64,
    /// False if the face is too steep, or if the foot on the part is below the start of saliency. The latter
    /// holds for all markers: keeping only those that noise has raised above it would raise the part.
    can_touch: bool,
}

impl Reading {
    const NOTHING: Self = Self {
        distance_mm: 0.0,
        normal: DVec3::ZERO,
        variance_mm2: 1.0,
        sigma_mm: 1.0,
        bell: Bell::NONE,
        curvature_per_mm: 0.0,
        can_touch: false,
    };
}

/// Readings at one placement, salient points first.
#[derive(Clone, Debug, Default)]
pub(super) struct Readings {
    pub all: Vec<Reading>,
    /// The last nearest triangle, or [`SKIP`].
    hints: Vec<u32>,
}

/// Hint of a marker that is not evaluated.
const SKIP: u32 = u32::MAX;

/// What is evaluated for markers that are not salient.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Asked {
    /// Their depth inside the part.
    Within,
    /// Also whether they are in contact.
    Touching,
}

/// Buffers reused between runs.
#[derive(Clone, Debug, Default)]
pub(super) struct RefineScratch {
    pub here: Readings,
    there: Readings,
    /// Contact probability of a point from its neighbours; 0 where contact is impossible.
    before: Vec<f64>,
    /// The same including its own distance.
    pub touches: Vec<f64>,
    /// Clearance of the markers that are not salient, kept between passes.
    pub clear: Vec<Clear>,
}

impl RefineScratch {
    /// Discards the state of another contact.
    pub fn begin(&mut self, samples: &Samples) {
        self.clear.clear();
        self.clear.resize(samples.unpressed.len(), Clear::NOT);
    }
}

/// Likelihood maximisation of one candidate.
pub(super) struct Refinement<'a, D> {
    pub problem: &'a Problem<'a>,
    pub view: View<'a>,
    pub part: D,
    /// Markers that are not salient are not evaluated from this initial distance over the part.
    pub reach_mm: f64,
    /// Halvings of a step before it is given up.
    pub halvings: u32,
    /// Whether the field gives the depth of the other markers: inaccurate at edges, but a tenth of the time.
    pub pushes_bluntly: bool,
}

impl<'a, D: Distances> Refinement<'a, D> {
    /// By these distances, of all points.
    pub fn new(problem: &'a Problem<'a>, part: D) -> Self {
        let reach_mm = problem.params.scaled(OUT_OF_REACH_MM);
        Self { problem, view: problem.whole(), part, reach_mm, halvings: HALVINGS, pushes_bluntly: false }
    }

    /// Steps until convergence, or to the limits.
    pub fn run(&self, candidate: &mut Candidate, limits: Limits, scratch: &mut RefineScratch) -> End {
        let mut end = End { work: self.start(&candidate.placement, scratch), ..End::NONE };
        let min_mm = LAST_STEP * self.problem.params.advanced.step_tolerance * scratch.here.all[0].sigma_mm;
        while end.iterations < limits.max_steps
            && !end.converged
            && end.work < limits.max_work
            && !(self.problem.stop)()
        {
            end.iterations += 1;
            for _ in 0..EXPECTATIONS {
                self.believe(scratch, Asked::Within);
            }
            let now = self.sum::<true>(scratch, &scratch.here, &candidate.placement);
            let Some((omega, v)) = now.solve(self.view.radius_mm, self.problem.params.scaled(LONGEST_MM))
            else {
                break;
            };
            let full_mm = self.length_mm(omega, v);
            let cost = self.cost(scratch, &scratch.here, &candidate.placement);
            let mut share = 1.0;
            let mut accepted = false;
            for _ in 0..=self.halvings {
                let next = candidate.placement.moved(omega * share, v * share);
                end.work += self.read(&next, &mut scratch.there, 0, Asked::Within);
                if self.cost(scratch, &scratch.there, &next) < cost {
                    candidate.placement = next;
                    core::mem::swap(&mut scratch.here, &mut scratch.there);
                    accepted = true;
                    break;
                }
                share *= 0.5;
                if share * full_mm < min_mm {
                    break;
                }
            }
            // No increase along the step within the step tolerance.
            end.converged = !accepted || share * full_mm < min_mm;
        }
        end
    }

    /// Distance by which a rotation and a translation move the patch.
    fn length_mm(&self, omega: DVec3, v: DVec3) -> f64 {
        sqrt((omega * self.view.radius_mm).length_squared() + v.length_squared())
    }

    /// Unchecked full steps until convergence, or to the limits. The field has no creases to oscillate at,
    /// and checking a step costs as much as the next step. The caller reads the final distances.
    pub fn slide(&self, candidate: &mut Candidate, limits: Limits, scratch: &mut RefineScratch) -> End {
        let mut end = End { work: self.start(&candidate.placement, scratch), ..End::NONE };
        while end.iterations < limits.max_steps
            && !end.converged
            && end.work < limits.max_work
            && !(self.problem.stop)()
        {
            if end.iterations > 0 {
                end.work += self.read(&candidate.placement, &mut scratch.here, 0, Asked::Within);
            }
            end.iterations += 1;
            self.believe(scratch, Asked::Within);
            let now = self.sum::<true>(scratch, &scratch.here, &candidate.placement);
            let Some((omega, v)) = now.solve(self.view.radius_mm, self.problem.params.scaled(LONGEST_MM))
            else {
                break;
            };
            candidate.placement = candidate.placement.moved(omega, v);
            let min_mm =
                LAST_STEP * self.problem.params.advanced.step_tolerance * scratch.here.all[0].sigma_mm;
            end.converged = self.length_mm(omega, v) < min_mm;
        }
        end
    }

    /// Negative log-likelihood, with the same contact probabilities for all candidates, and the work.
    /// Leaves the readings and their contact probabilities in the scratch.
    pub fn compare(&self, placement: &Placement, scratch: &mut RefineScratch) -> (f64, u64) {
        let work = self.start(placement, scratch);
        let (cost, more) = self.compare_ended(placement, scratch);
        (cost, work + more)
    }

    /// As [`Self::compare`], directly after a run.
    pub fn compare_ended(&self, placement: &Placement, scratch: &mut RefineScratch) -> (f64, u64) {
        self.forget(scratch);
        let work = self.read(placement, &mut scratch.here, self.view.pressed.len(), Asked::Touching);
        for k in 0..scratch.before.len() {
            if !scratch.here.all[k].can_touch {
                scratch.before[k] = 0.0;
            }
        }
        let cost = self.cost(scratch, &scratch.here, placement);
        self.believe(scratch, Asked::Touching);
        (cost, work)
    }

    /// Reads the first placement, and excludes the markers that are far from the part; returns the work.
    fn start(&self, placement: &Placement, scratch: &mut RefineScratch) -> u64 {
        let (pressed, count) = (self.view.pressed.len(), self.view.len() as usize);
        for readings in [&mut scratch.here, &mut scratch.there] {
            readings.all.clear();
            readings.all.resize(count, Reading::NOTHING);
            readings.hints.clear();
            readings.hints.resize(count, 0);
        }
        let press = press_in_object(placement, self.view.press_direction);
        for (k, (sample, clear)) in self.view.unpressed.iter().zip(&scratch.clear).enumerate() {
            let x_mm = placement.object_point(sample.p_mm);
            let is_far = clear.is_over(x_mm, self.reach_mm)
                || self.problem.field.near_at(x_mm, press).distance_mm > self.reach_mm;
            if is_far {
                for readings in [&mut scratch.here, &mut scratch.there] {
                    readings.all[pressed + k].distance_mm = self.reach_mm;
                    readings.hints[pressed + k] = SKIP;
                }
            }
        }
        self.forget(scratch);
        self.view.unpressed.len() as u64 + self.read(placement, &mut scratch.here, 0, Asked::Within)
    }

    /// Resets the contact probabilities to their initial values.
    fn forget(&self, scratch: &mut RefineScratch) {
        for beliefs in [&mut scratch.before, &mut scratch.touches] {
            beliefs.clear();
            beliefs.extend(self.view.pressed.iter().map(|s| if s.hangs { HANGING } else { FIRST[0] }));
            beliefs.resize(self.view.len() as usize, FIRST[1]);
        }
    }

    /// Looks up the distances of the markers from `first` on; returns the work.
    fn read(&self, placement: &Placement, out: &mut Readings, first: usize, asked: Asked) -> u64 {
        let press = press_in_object(placement, self.view.press_direction);
        let toward = self.view.press_direction;
        let surface_mm = self.problem.params.advanced.surface_sigma_mm;
        let model = surface_mm * surface_mm;
        let pressed = self.view.pressed.len();
        let samples = self.view.pressed.iter().chain(self.view.unpressed);
        let all = samples.zip(&mut out.all).zip(&mut out.hints).enumerate();
        let mut work = 0;
        for (k, ((sample, reading), hint)) in all.skip(first) {
            if *hint == SKIP {
                continue;
            }
            let max_mm = sample.max_sigma_mm + surface_mm;
            let may_touch = k < pressed || asked == Asked::Touching;
            let to_mm = if may_touch { ASKED * max_mm } else { 0.0 };
            let range = Range { from_mm: -(ASKED + SLACK) * max_mm, to_mm };
            let mut last = Last { triangle: *hint, work: 0 };
            let x_mm = placement.object_point(sample.p_mm);
            let Near { distance_mm, normal, curvature_per_mm } = if !may_touch && self.pushes_bluntly {
                self.problem.field.at(x_mm, press, range, &mut last)
            } else {
                self.part.at(x_mm, press, range, &mut last)
            };
            (*hint, work) = (last.triangle, work + last.work);
            if !may_touch && distance_mm > 0.0 {
                *reading = Reading { distance_mm, ..Reading::NOTHING };
                continue;
            }
            let normal = placement.sensor_direction(normal);
            let variance_mm2 = sample.variance(normal) + model;
            let foot_mm = sample.p_mm - normal * distance_mm;
            let sigma_mm = sqrt(variance_mm2);
            let can_touch = normal.dot(toward) >= STEEP_COSINE
                && foot_mm.dot(toward) >= self.problem.samples.salient_from_mm;
            // A salient point that cannot be in contact here may have had a contact probability before
            // the step.
            let is_asked = k < pressed || (can_touch && may_touch);
            let bell = if is_asked { Bell::at(distance_mm, sigma_mm) } else { Bell::NONE };
            *reading =
                Reading { distance_mm, normal, variance_mm2, sigma_mm, bell, curvature_per_mm, can_touch };
        }
        work
    }

    /// One expectation step. Contact and shoulder are connected regions, so the prior contact probability
    /// of a salient point comes from its neighbours.
    ///
    /// Other markers only push: which of them are in contact is unknown, and selecting some would bias
    /// the pose.
    fn believe(&self, scratch: &mut RefineScratch, asked: Asked) {
        let RefineScratch { here, before, touches, .. } = scratch;
        let pressed = self.view.pressed.len();
        let loose = self.loose();
        let mut total = 0.0;
        let count = if asked == Asked::Touching { here.all.len() } else { pressed };
        for (k, r) in here.all[..count].iter().enumerate() {
            let mixture = loose[usize::from(k >= pressed)].with(before[k].max(0.01));
            touches[k] = if r.can_touch { mixture.at(r.distance_mm, r.bell).0 } else { 0.0 };
            if k < pressed {
                total += touches[k];
            }
        }
        // Laplace's rule of succession avoids 0 and 1.
        let whole = (total + 1.0) / (pressed as f64 + 2.0);
        for (k, (r, near)) in here.all.iter().zip(&self.problem.samples.neighbours).enumerate() {
            before[k] = if !r.can_touch {
                0.0
            } else if self.view.pressed[k].hangs {
                HANGING
            } else {
                let others = near.iter().map(|&j| j as usize).filter(|&j| j != k);
                let (sum, count) = others.fold((2.0 * whole, 2.0), |(sum, n), j| (sum + touches[j], n + 1.0));
                sum / count
            };
        }
        before[pressed..].fill(0.0);
    }

    /// Distributions of salient markers that are not in contact, and of others.
    fn loose(&self) -> [Loose; 2] {
        let params = self.problem.params;
        [SHOULDER_MM, FREE_MM]
            .map(|mm| Loose::new(params.advanced.outlier_share, params.scaled(mm), params.scaled(STRAY_MM)))
    }

    /// The cost of a placement.
    fn cost(&self, scratch: &RefineScratch, readings: &Readings, placement: &Placement) -> f64 {
        self.sum::<false>(scratch, readings, placement).cost
    }

    /// The linear system, or the cost.
    fn sum<const SYSTEM: bool>(
        &self,
        scratch: &RefineScratch,
        readings: &Readings,
        placement: &Placement,
    ) -> Normal {
        let pressed = self.view.pressed.len();
        let mut sum = Normal::ZERO;
        let [shoulder_mm, far_mm, stray_mm] =
            [SHOULDER_MM, FAR_MM, STRAY_MM].map(|mm| self.problem.params.scaled(mm));
        let loose = self.loose();
        let mut likelihood = Likelihood::after(0.0);
        let per_radius = 1.0 / self.view.radius_mm;
        let samples = self.view.pressed.iter().chain(self.view.unpressed);
        for (k, ((sample, r), &before)) in samples.zip(&readings.all).zip(&scratch.before).enumerate() {
            let pushed_mm = (r.distance_mm + SLACK * r.sigma_mm).min(0.0);
            if k >= pressed && (r.distance_mm > far_mm || (before == 0.0 && pushed_mm == 0.0)) {
                continue;
            }
            let mixture = loose[usize::from(k >= pressed)].with(before);
            let (d_mm, (weight, density)) = if before > 0.0 {
                (r.distance_mm, mixture.at(r.distance_mm, r.bell))
            } else if k < pressed && r.distance_mm > shoulder_mm {
                // Above the part and its shoulder: an outlier.
                (0.0, (0.0, 1.0 / stray_mm))
            } else {
                (pushed_mm, mixture.free(pushed_mm, r.sigma_mm))
            };
            if SYSTEM && weight > 0.0 {
                sum.add(sample.p_mm, r.normal, d_mm, weight / r.variance_mm2, per_radius);
            }
            if !SYSTEM {
                // The density of a marker that is not salient is relative to free gel out of the part's
                // reach.
                likelihood.times(if k < pressed { density } else { density / mixture.free_density() });
            }
        }
        sum.cost = likelihood.cost();
        sum.add_prior(&self.problem.prior, placement, self.view.radius_mm, 1.0);
        sum
    }
}
