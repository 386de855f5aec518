//! The last steps: maximum likelihood under the mixture of contact, free gel and outliers.
//!
//! Distances are looked up once a step; the probabilities of contact follow from them (expectation and maximisation). A
//! step that does not make the pose more likely is halved: at creases the nearest face changes, and whole steps of
//! Gauss and Newton would go back and forth between two faces for ever.

use super::candidate::{Candidate, End};
use super::coarse::{Clear, View};
use super::contact::Samples;
use super::distances::{Coarse, Distances, Last, Near, Range, press_in_object};
use super::mixture::{Bell, Likelihood, Loose, STRAY_MM};
use super::normal_system::{Normal, Placement, Prior};
use crate::math::{DVec3, sqrt};
use crate::params::RegisterParams;
use crate::stop::Stop;
use alloc::vec::Vec;

/// Salient points that do not touch hang up to this far over the part.
const SHOULDER_MM: f64 = 1.0;
/// And the other markers.
const FREE_MM: f64 = 4.0;
/// Markers that are not salient and this far over the part say nothing.
const FAR_MM: f64 = 0.5;
/// Those this far over it at the start are not looked at again: polishing does not move the part as far.
pub(super) const OUT_OF_REACH_MM: f64 = 1.2;
/// The last step of a run, in tolerances.
const LAST_STEP: f64 = 10.0;
/// Steps of expectation for one of maximisation: they cost no lookups.
const EXPECTATIONS: u32 = 2;
/// Longest step, over the patch.
const LONGEST_MM: f64 = 0.5;
/// The gel hangs beside faces that are steeper than this, cosine to the press, and does not touch them.
const STEEP_COSINE: f64 = 0.35;
/// Standard deviations that a marker that cannot touch may lie in the part before it pushes.
const SLACK: f64 = 2.0;
/// The triangles need not be asked for points that are surely farther off than this, in standard deviations: the weight of such
/// a one is e^-8 of the greatest, and the field tells as well that it is far.
const ASKED: f64 = 4.0;
/// Probability that a salient point touches around which the gel is hollow: in a fillet it would.
const HANGING: f64 = 0.02;
/// Probability of contact before anything is known: of salient points, and of others.
const FIRST: [f64; 2] = [0.6, 0.05];

/// The distance of a point, its normal in the sensor's frame, and its variance along that.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading {
    pub distance_mm: f64,
    pub normal: DVec3,
    pub variance_mm2: f64,
    pub sigma_mm: f64,
    /// What contact would say of the distance.
    pub bell: Bell,
    pub curvature_per_mm: f64,
    /// A marker whose foot on the part lies below where saliency begins is not asked, salient or not: asking those
    /// alone that noise has raised over it would raise the part.
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

/// What was read at one placement, salient points first.
#[derive(Clone, Debug, Default)]
pub(super) struct Readings {
    pub all: Vec<Reading>,
    /// The triangle that was nearest last, or [`SKIP`].
    hints: Vec<u32>,
}

/// A marker that is not looked at.
const SKIP: u32 = u32::MAX;

/// What is asked of markers that are not salient.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Asked {
    /// How far they are in the part.
    Within,
    /// Whether they touch it, too.
    Touching,
}

/// Vectors that are kept from run to run.
#[derive(Clone, Debug, Default)]
pub(super) struct RefineScratch {
    pub here: Readings,
    there: Readings,
    /// Probability that a point touches, by its neighbours; 0 for one that cannot.
    before: Vec<f64>,
    /// The same by its own distance too.
    pub touches: Vec<f64>,
    /// Of the markers that are not salient, from look to look.
    pub clear: Vec<Clear>,
}

impl RefineScratch {
    /// Forgets what was of another contact.
    pub fn begin(&mut self, samples: &Samples) {
        self.clear.clear();
        self.clear.resize(samples.unpressed.len(), Clear::NOT);
    }
}

/// The way of one candidate to the greatest likelihood.
pub(super) struct Refinement<'a, D> {
    pub params: &'a RegisterParams,
    pub samples: &'a Samples,
    pub view: View<'a>,
    pub field: Coarse<'a>,
    pub part: D,
    pub prior: Prior,
    pub stop: Stop<'a>,
    /// Markers this far over the part at the start that are not salient are not looked at.
    pub reach_mm: f64,
    /// Halvings of a step before it is given up.
    pub halvings: u32,
    /// Whether the field tells how far the other markers are in the part: at edges it is blunt, and takes a tenth as long.
    pub pushes_bluntly: bool,
}

impl<D: Distances> Refinement<'_, D> {
    /// At most `most` steps, and none once `budget` of work is spent.
    pub fn run(&self, candidate: &mut Candidate, most: u32, budget: u64, scratch: &mut RefineScratch) -> End {
        let mut end =
            End { converged: false, iterations: 0, work: self.start(&candidate.placement, scratch) };
        let least_mm = LAST_STEP * self.params.step_tolerance * scratch.here.all[0].sigma_mm;
        while end.iterations < most && !end.converged && end.work < budget && !(self.stop)() {
            end.iterations += 1;
            for _ in 0..EXPECTATIONS {
                self.believe(scratch, Asked::Within);
            }
            let now = self.sum::<true>(scratch, &scratch.here, &candidate.placement);
            let Some((omega, v)) = now.solve(self.view.radius_mm, self.params.scaled(LONGEST_MM)) else {
                break;
            };
            let full_mm = self.length_mm(omega, v);
            let cost = self.cost(scratch, &scratch.here, &candidate.placement);
            let mut share = 1.0;
            let mut accepted = false;
            for _ in 0..=self.halvings {
                let next = candidate.placement.moved(omega * share, v * share);
                end.work += self.read(&next, &mut scratch.there, Asked::Within);
                if self.cost(scratch, &scratch.there, &next) < cost {
                    candidate.placement = next;
                    core::mem::swap(&mut scratch.here, &mut scratch.there);
                    accepted = true;
                    break;
                }
                share *= 0.5;
                if share * full_mm < least_mm {
                    break;
                }
            }
            // Nothing more likely along the step, within what steps are told apart by.
            end.converged = !accepted || share * full_mm < least_mm;
        }
        end
    }

    /// How far a turn and a shift move the patch.
    fn length_mm(&self, omega: DVec3, v: DVec3) -> f64 {
        sqrt((omega * self.view.radius_mm).length_squared() + v.length_squared())
    }

    /// At most `most` steps, each as far as it says, and none once `budget` of work is spent: the field has no creases for
    /// steps to go back and forth between, and what a step would cost takes as long to ask as the next one to do. What is
    /// read where it ends is another's to ask.
    pub fn slide(
        &self,
        candidate: &mut Candidate,
        most: u32,
        budget: u64,
        scratch: &mut RefineScratch,
    ) -> End {
        let mut end =
            End { converged: false, iterations: 0, work: self.start(&candidate.placement, scratch) };
        while end.iterations < most && !end.converged && end.work < budget && !(self.stop)() {
            if end.iterations > 0 {
                end.work += self.read(&candidate.placement, &mut scratch.here, Asked::Within);
            }
            end.iterations += 1;
            self.believe(scratch, Asked::Within);
            let now = self.sum::<true>(scratch, &scratch.here, &candidate.placement);
            let Some((omega, v)) = now.solve(self.view.radius_mm, self.params.scaled(LONGEST_MM)) else {
                break;
            };
            candidate.placement = candidate.placement.moved(omega, v);
            let least_mm = LAST_STEP * self.params.step_tolerance * scratch.here.all[0].sigma_mm;
            end.converged = self.length_mm(omega, v) < least_mm;
        }
        end
    }

    /// The likelihood's negative logarithm, with the same probabilities of contact for all candidates. Leaves what it
    /// read in the scratch, and what is believed of it.
    pub fn compare(&self, placement: &Placement, scratch: &mut RefineScratch) -> (f64, u64) {
        let work = self.start(placement, scratch);
        let (cost, more) = self.compare_ended(placement, scratch);
        (cost, work + more)
    }

    /// As [`Self::compare`], where a run has just ended.
    pub fn compare_ended(&self, placement: &Placement, scratch: &mut RefineScratch) -> (f64, u64) {
        self.forget(scratch);
        let work = self.read_some(placement, &mut scratch.here, self.view.pressed.len(), Asked::Touching);
        for k in 0..scratch.before.len() {
            if !scratch.here.all[k].can_touch {
                scratch.before[k] = 0.0;
            }
        }
        let cost = self.cost(scratch, &scratch.here, placement);
        self.believe(scratch, Asked::Touching);
        (cost, work)
    }

    /// Reads the first placement, and leaves out the markers that are far from the part.
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
                || self.field.near_at(x_mm, press).distance_mm > self.reach_mm;
            if is_far {
                for readings in [&mut scratch.here, &mut scratch.there] {
                    readings.all[pressed + k].distance_mm = self.reach_mm;
                    readings.hints[pressed + k] = SKIP;
                }
            }
        }
        self.forget(scratch);
        self.view.unpressed.len() as u64 + self.read(placement, &mut scratch.here, Asked::Within)
    }

    /// Believes again what is believed before anything is known.
    fn forget(&self, scratch: &mut RefineScratch) {
        for beliefs in [&mut scratch.before, &mut scratch.touches] {
            beliefs.clear();
            beliefs.extend(self.view.pressed.iter().map(|s| if s.hangs { HANGING } else { FIRST[0] }));
            beliefs.resize(self.view.len() as usize, FIRST[1]);
        }
    }

    /// Looks up all distances; returns what that cost.
    fn read(&self, placement: &Placement, out: &mut Readings, asked: Asked) -> u64 {
        self.read_some(placement, out, 0, asked)
    }

    /// The same of the markers from `first` on.
    fn read_some(&self, placement: &Placement, out: &mut Readings, first: usize, asked: Asked) -> u64 {
        let press = press_in_object(placement, self.view.press_direction);
        let toward = self.view.press_direction;
        let surface_mm = self.params.surface_sigma_mm;
        let model = surface_mm * surface_mm;
        let pressed = self.view.pressed.len();
        let samples = self.view.pressed.iter().chain(self.view.unpressed);
        let all = samples.zip(&mut out.all).zip(&mut out.hints).enumerate();
        let mut work = 0;
        for (k, ((sample, reading), hint)) in all.skip(first) {
            if *hint == SKIP {
                continue;
            }
            let most_mm = sample.most_sigma_mm + surface_mm;
            let may_touch = k < pressed || asked == Asked::Touching;
            let to_mm = if may_touch { ASKED * most_mm } else { 0.0 };
            let range = Range { from_mm: -(ASKED + SLACK) * most_mm, to_mm };
            let mut last = Last { triangle: *hint, work: 0 };
            let x_mm = placement.object_point(sample.p_mm);
            let Near { distance_mm, normal, curvature_per_mm } = if !may_touch && self.pushes_bluntly {
                self.field.at(x_mm, press, range, &mut last)
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
            let can_touch =
                normal.dot(toward) >= STEEP_COSINE && foot_mm.dot(toward) >= self.samples.salient_from_mm;
            // A salient point that cannot touch here may have been believed to before the step.
            let is_asked = k < pressed || (can_touch && may_touch);
            let bell = if is_asked { Bell::at(distance_mm, sigma_mm) } else { Bell::NONE };
            *reading =
                Reading { distance_mm, normal, variance_mm2, sigma_mm, bell, curvature_per_mm, can_touch };
        }
        work
    }

    /// One step of expectation: contact and shoulder are regions, so what is believed of a salient point before its own
    /// distance is what its neighbours say.
    ///
    /// Nobody knows which of the others touch, and whom to believe would bias the pose: they only push.
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
        // Laplace's rule keeps it off 0 and 1.
        let whole = (total + 1.0) / (pressed as f64 + 2.0);
        for (k, (r, near)) in here.all.iter().zip(&self.samples.neighbours).enumerate() {
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

    /// Where salient markers are that do not touch, and where others.
    fn loose(&self) -> [Loose; 2] {
        let of = |mm| (self.params.scaled(mm), self.params.scaled(STRAY_MM));
        [SHOULDER_MM, FREE_MM].map(|mm| Loose::new(self.params.outlier_share, of(mm)))
    }

    /// What a placement costs.
    fn cost(&self, scratch: &RefineScratch, readings: &Readings, placement: &Placement) -> f64 {
        self.sum::<false>(scratch, readings, placement).cost
    }

    /// The linear system, or what it costs.
    fn sum<const SYSTEM: bool>(
        &self,
        scratch: &RefineScratch,
        readings: &Readings,
        placement: &Placement,
    ) -> Normal {
        let pressed = self.view.pressed.len();
        let mut sum = Normal::ZERO;
        let [shoulder_mm, far_mm, stray_mm] =
            [SHOULDER_MM, FAR_MM, STRAY_MM].map(|mm| self.params.scaled(mm));
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
                // Neither the part nor its shoulder brings it there: an outlier.
                (0.0, (0.0, 1.0 / stray_mm))
            } else {
                (pushed_mm, mixture.free(pushed_mm, r.sigma_mm))
            };
            if SYSTEM && weight > 0.0 {
                sum.add(sample.p_mm, r.normal, d_mm, weight / r.variance_mm2, per_radius);
            }
            if !SYSTEM {
                // That of a marker that is not salient is over that of gel out of the part's reach.
                likelihood.times(if k < pressed { density } else { density / mixture.free_density() });
            }
        }
        sum.cost = likelihood.cost();
        sum.add_prior(&self.prior, placement, self.view.radius_mm, 1.0);
        sum
    }
}
