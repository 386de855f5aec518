//! Many starts, successive halving: each round looks at fewer candidates more closely.

use super::contact::{COARSE, MEDIUM, Samples};
use super::fit::View;
use super::polish::{Polish, Readings};
use super::part::{Coarse, Distances, Exact};
use super::relief::Relief;
use super::starts::start;
use super::step::{Placement, Prior};
use crate::math::{DVec3, sqrt};
use crate::params::RegisterParams;
use crate::surface::{Field, Solid};
use alloc::vec::Vec;

/// A pose in the running.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub placement: Placement,
    pub cost: f64,
}

/// What a search works with.
pub(super) struct Search<'a> {
    pub params: &'a RegisterParams,
    pub samples: &'a Samples,
    pub press_direction: DVec3,
    pub field: &'a Field,
    pub solid: &'a Solid,
    pub relief: &'a Relief,
    pub prior: Prior,
    pub work: u64,
}

/// The prior counts little while weights are those of wide laws.
const COARSE_PRIOR: f64 = 0.1;

pub(super) fn tune(name: &str, default: &[f64]) -> Vec<f64> {
    match std::env::var(name) {
        Ok(v) => v.split(',').map(|x| x.parse().unwrap()).collect(),
        Err(_) => default.to_vec(),
    }
}

impl Search<'_> {
    pub fn screen(&mut self, candidates: &mut Vec<Candidate>) {
        candidates.clear();
        let starts = tune("STARTS", &[f64::from(self.params.starts)])[0] as u32;
        for k in 0..starts {
            candidates.push(Candidate { placement: start(&self.prior, k), cost: 0.0 });
        }
        let samples = self.samples;
        let a = View::of(samples, tune("NA", &[COARSE as f64])[0] as usize, samples.coarse_unpressed, self.press_direction);
        let b = View::of(samples, MEDIUM, samples.medium_unpressed, self.press_direction);
        self.round(candidates, &a, &tune("SA", &[1.5, 0.8, 0.4, 0.3]));
        keep(candidates, tune("KA", &[32.0])[0] as usize, 0.0, 0.0);
        self.round(candidates, &b, &tune("SB", &[0.6, 0.3, 0.2, 0.12, 0.1]));
        keep(candidates, tune("KB", &[8.0])[0] as usize, samples.radius_mm, 0.1);
    }

    /// Steps of these widths; the last one is for the cost alone.
    pub fn round(&mut self, candidates: &mut [Candidate], view: &View<'_>, widths_mm: &[f64]) {
        let part = Coarse(self.field);
        for candidate in candidates {
            for (k, &width_mm) in widths_mm.iter().enumerate() {
                let mut sum = view.look(&part, &candidate.placement, width_mm);
                self.work += view.len() * Coarse::WORK;
                candidate.cost = sum.cost;
                if k + 1 < widths_mm.len() {
                    sum.add_prior(&self.prior, &candidate.placement, view.radius_mm, COARSE_PRIOR);
                    if let Some((omega, v)) = sum.solve(view.radius_mm, 2.0) {
                        candidate.placement = candidate.placement.moved(omega, v);
                    }
                }
            }
        }
    }
}

/// The `most` cheapest, in order; of those closer than `same_mm` the cheaper one.
pub(super) fn keep(candidates: &mut Vec<Candidate>, most: usize, radius_mm: f64, same_mm: f64) {
    candidates.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut kept = 0;
    for k in 0..candidates.len() {
        let one = candidates[k];
        let is_new = candidates[..kept].iter().all(|other| {
            let (omega, v) = one.placement.since(&other.placement);
            sqrt((omega * radius_mm).length_squared() + v.length_squared()) > same_mm
        });
        if (same_mm == 0.0 || is_new) && kept < most {
            candidates[kept] = one;
            kept += 1;
        }
    }
    candidates.truncate(kept);
}

impl Search<'_> {
    pub fn run(&mut self, candidates: &mut Vec<Candidate>, two: &mut [Readings; 3]) -> (bool, u32) {
        if tune("SKIP", &[0.0])[0] > 0.0 { candidates.clear(); candidates.push(Candidate { placement: self.prior.guess, cost: 0.0 }); } else { self.screen(candidates); }
        let view = View::of(self.samples, usize::MAX, usize::MAX, self.press_direction);
        let (params, prior) = (self.params, self.prior);
        let on_field = Polish { params, view, samples: self.samples, part: Coarse(self.field), prior };
        for c in candidates.iter_mut() {
            self.work += on_field.run(c, tune("NC", &[4.0])[0] as u32, two).work;
            c.cost = on_field.compare(c, two);
        }
        keep(candidates, tune("KC", &[3.0])[0] as usize, self.samples.radius_mm, 0.1);
        let on_faces = Polish { params, view, samples: self.samples, part: Exact { solid: self.solid, relief: self.relief }, prior };
        let mut out = (false, 0);
        for (k, c) in candidates.iter_mut().enumerate() {
            let end = on_faces.run(c, tune("ND", &[12.0])[0] as u32, two);
            self.work += end.work;
            c.cost = on_faces.compare(c, two);
            if k == 0 { out = (end.converged, end.iterations); }
        }
        if std::env::var("COST").is_ok() { for c in candidates.iter() { let (w, v) = c.placement.since(&self.prior.guess); std::println!("   cost {:.2} moved {:.3} {:.3} {out:?} work {}", c.cost, w.length().to_degrees(), v.length(), self.work); } }
        keep(candidates, 3, self.samples.radius_mm, 0.05);
        out
    }
}
