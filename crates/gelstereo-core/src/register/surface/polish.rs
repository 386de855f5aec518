//! The last steps: maximum likelihood under the mixture of contact, free gel and outliers.
//!
//! Distances are looked up once a step; the shares of the mixture follow from them (expectation and maximisation). A
//! step that does not make the pose more likely is halved: at creases the nearest face changes, and whole steps of
//! Gauss and Newton would go back and forth between two faces for ever.

use super::fit::View;
use super::noise::Mixture;
use super::part::{Distances, Near, press_in_object};
use super::search::Candidate;
use super::step::{Normal, Placement, Prior};
use crate::math::{DVec3, sqrt};
use crate::params::RegisterParams;
use alloc::vec::Vec;

/// Salient points that do not touch hang up to this far over the part.
const SHOULDER_MM: f64 = 1.0;
/// And the other markers.
const FREE_MM: f64 = 4.0;
/// Markers that are not salient and this far over the part say nothing.
const FAR_MM: f64 = 0.5;
/// Halvings of a step before it is given up.
const HALVINGS: u32 = 4;

/// The distance of a point, its normal in the sensor's frame, and its variance along that.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading {
    pub distance_mm: f64,
    pub normal: DVec3,
    pub variance_mm2: f64,
    pub curvature_per_mm: f64,
}

/// What was read at one placement: salient points first.
#[derive(Clone, Debug, Default)]
pub(super) struct Readings {
    pub all: Vec<Reading>,
    hints: Vec<u32>,
    /// Probabilities that each point touches: what is believed before its own distance, and after.
    pub prior: Vec<f64>,
    pub touches: Vec<f64>,
}

/// One candidate's way to the greatest likelihood.
pub(super) struct Polish<'a, D> {
    pub params: &'a RegisterParams,
    pub view: View<'a>,
    pub samples: &'a super::contact::Samples,
    pub part: D,
    pub prior: Prior,
}

/// Where it ended.
#[derive(Clone, Copy, Debug)]
pub(super) struct End {
    pub converged: bool,
    pub iterations: u32,
    pub work: u64,
}

impl<D: Distances> Polish<'_, D> {
    pub fn run(&self, candidate: &mut Candidate, most: u32, three: &mut [Readings; 3]) -> End {
        let [here, there, beliefs] = three;
        self.start([here, there, beliefs]);
        let mut end = End { converged: false, iterations: 0, work: self.read(&candidate.placement, here) };
        while end.iterations < most && !end.converged {
            end.iterations += 1;
            for _ in 0..2 {
                let (a, b) = (&*here, &mut *beliefs);
                self.share(&candidate.placement, a, b);
            }
            let now = self.system(&beliefs.prior, here, &candidate.placement);
            candidate.cost = now.cost;
            let Some((omega, v)) = now.solve(self.view.radius_mm, 0.5) else { break };
            let full_mm = sqrt((omega * self.view.radius_mm).length_squared() + v.length_squared());
            let tolerance_mm = self.params.step_tolerance * sqrt(here.all[0].variance_mm2);
            let mut share = 1.0;
            let mut accepted = false;
            for _ in 0..=HALVINGS {
                let next = candidate.placement.moved(omega * share, v * share);
                end.work += self.read(&next, there);
                let cost = self.system(&beliefs.prior, there, &next).cost;
                if cost < now.cost {
                    candidate.placement = next;
                    candidate.cost = cost;
                    core::mem::swap(here, there);
                    accepted = true;
                    break;
                }
                if share * full_mm < tolerance_mm {
                    break;
                }
                share *= 0.5;
            }
            end.converged = !accepted || share * full_mm < tolerance_mm;
        }
        end
    }

    /// The negative logarithm of the likelihood under shares that are the same for all candidates.
    pub fn compare(&self, candidate: &Candidate, three: &mut [Readings; 3]) -> f64 {
        let [here, there, beliefs] = three;
        self.start([there, beliefs, here]);
        self.read(&candidate.placement, here);
        self.system(&beliefs.prior, here, &candidate.placement).cost
    }

    fn start(&self, three: [&mut Readings; 3]) {
        let nothing = Reading {
            distance_mm: 0.0,
            normal: DVec3::ZERO,
            variance_mm2: 1.0,
            curvature_per_mm: 0.0,
        };
        for readings in three {
            readings.all.clear();
            readings.all.resize(self.view.len() as usize, nothing);
            readings.prior.clear();
            readings.prior.resize(self.view.len() as usize, 0.6);
            readings.prior[self.view.pressed.len()..].fill(0.05);
            readings.touches.clear();
            readings.touches.resize(self.view.len() as usize, 0.6);
            readings.hints.clear();
            readings.hints.resize(self.view.len() as usize, 0);
        }
    }

    /// Looks up all distances; returns what that cost.
    fn read(&self, placement: &Placement, out: &mut Readings) -> u64 {
        let press = press_in_object(placement, self.view.press_direction);
        let model = self.params.surface_sigma_mm * self.params.surface_sigma_mm;
        let samples = self.view.pressed.iter().chain(self.view.unpressed);
        for ((sample, reading), hint) in samples.zip(&mut out.all).zip(&mut out.hints) {
            let Near { distance_mm, normal, curvature_per_mm } =
                self.part.at(placement.to_object(sample.p_mm), press, hint);
            let normal = placement.direction_to_sensor(normal);
            let variance_mm2 = sample.variance(normal) + model;
            *reading = Reading { distance_mm, normal, variance_mm2, curvature_per_mm };
        }
        self.view.len() * D::WORK
    }

    /// Expectation of the contact, one step: every salient point's share is what its neighbours say, for contact and
    /// shoulder are regions. A marker whose foot on the part lies below where saliency begins is not asked:
    /// asking those that noise has raised over it would raise the part. It only pushes the part away.
    fn share(&self, placement: &Placement, from: &Readings, out: &mut Readings) {
        let outliers = self.params.outlier_share;
        let pressed = self.view.pressed.len();
        let press = self.view.press_direction;
        let samples = self.view.pressed.iter().chain(self.view.unpressed);
        let mut total = 0.0;
        for (k, (sample, r)) in samples.enumerate().map(|(k, s)| (k, (s, &from.all[k]))) {
            let mixture = Mixture::new(out.prior[k], outliers, SHOULDER_MM);
            out.touches[k] = mixture.at(r.distance_mm, sqrt(r.variance_mm2)).0;
            if k < pressed { total += out.touches[k]; }
            let foot = (sample.p_mm - r.normal * r.distance_mm).dot(press);
            if foot < self.samples.salient_from_mm || r.normal.dot(press) < super::search::tune("STEEP", &[0.35])[0] { out.touches[k] = -1.0; }
        }
        let whole = (total + 1.0) / (pressed as f64 + 2.0);
        for k in 0..out.all.len() {
            out.prior[k] = if out.touches[k] < 0.0 { 0.0 } else if k < pressed {
                let (mut sum, mut count) = (2.0 * whole, 2.0);
                for &j in &self.samples.neighbours[k] {
                    if usize::from(j) != k && out.touches[usize::from(j)] >= 0.0 {
                        sum += out.touches[usize::from(j)];
                        count += 1.0;
                    }
                }
                sum / count
            } else { 0.5 * whole };
        }
        let _ = placement;
    }

    fn system(&self, prior: &[f64], readings: &Readings, placement: &Placement) -> Normal {
        let outliers = self.params.outlier_share;
        let mut sum = Normal::ZERO;
        let per_radius = 1.0 / self.view.radius_mm;
        let samples = self.view.pressed.iter().chain(self.view.unpressed);
        for (k, (sample, r)) in samples.zip(&readings.all).enumerate() {
            let is_salient = k < self.view.pressed.len();
            if !is_salient && r.distance_mm > FAR_MM {
                continue;
            }
            let sigma_mm = sqrt(r.variance_mm2);
            if prior[k] == 0.0 {
                // Only what is clearly in the part counts.
                let d_mm = r.distance_mm + SLACK * sigma_mm;
                if d_mm < 0.0 {
                    let (weight, cost) = Mixture::inside(outliers, d_mm, sigma_mm);
                    sum.add(sample.p_mm, r.normal, d_mm, weight / r.variance_mm2, per_radius);
                    sum.cost += cost;
                }
                if is_salient { sum.cost += self.params.outlier_share.max(0.02) * 0.0 + UNEXPLAINED; }
                continue;
            }
            let mixture = Mixture::new(prior[k], outliers, if is_salient { SHOULDER_MM } else { FREE_MM });
            let (weight, cost) = mixture.at(r.distance_mm, sigma_mm);
            sum.add(sample.p_mm, r.normal, r.distance_mm, weight / r.variance_mm2, per_radius);
            sum.cost += cost;
        }
        sum.add_prior(&self.prior, placement, self.view.radius_mm, 1.0);
        sum
    }
}

/// Standard deviations that a marker may lie in the part before it pushes.
const SLACK: f64 = 2.0;
/// Cost of a salient point that nothing explains.
const UNEXPLAINED: f64 = 2.0;
