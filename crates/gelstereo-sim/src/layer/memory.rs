//! Deformation history of a viscoelastic gel.
//!
//! The modulus relaxes from 1 to 1 - Σ g_i, each share g_i with its time constant τ_i (Prony series;
//! Poisson's ratio is constant). In the dashpot of each share, a deformation x_i follows the surface's
//! motion w: x_i' = (w - x_i) / τ_i. Tractions p move the surface by w = Kp + Σ g_i x_i, so the history
//! acts on the part like a shape printed into the surface. Between two frames w is taken as linear,
//! which gives x_i in closed form: e x_i + b w_before + c w_now. The term in w_now only rescales the
//! tractions, and the surface does not depend on that scale when the part is held in place.

use super::zeros;
use alloc::vec::Vec;
use gelstereo_core::math::expm1;

/// One relaxing share of the modulus.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct PronyTerm {
    /// Share of the instantaneous modulus, 0 to 1.
    pub share: f64,
    /// Relaxation time constant, seconds.
    pub time_s: f64,
}

/// Motion of the surface over the cells: into the layer, along x, along y.
pub(crate) type Surface = [Vec<f64>; 3];

/// History of the surface's motion, frame by frame.
#[derive(Clone, Debug)]
pub(crate) struct Memory {
    terms: Vec<Term>,
    /// Motion in the last frame.
    last: Surface,
    /// Motion without tractions in this frame.
    remembered: Surface,
    /// Number of frames stored.
    frames: u64,
}

#[derive(Clone, Debug)]
struct Term {
    share: f64,
    /// Weights of `x`, of the last frame's motion and of this frame's motion in the new `x`.
    own: f64,
    before: f64,
    now: f64,
    x: Surface,
}

impl Memory {
    pub(crate) fn new(terms: &[PronyTerm], frame_s: f64, cells: usize) -> Self {
        let none = || [zeros(cells), zeros(cells), zeros(cells)];
        let term = |term: &PronyTerm| {
            let a = frame_s / term.time_s;
            // (1 - e^-a) / a.
            let mean = -expm1(-a) / a;
            let own = 1.0 + expm1(-a);
            Term { share: term.share, own, before: mean - own, now: 1.0 - mean, x: none() }
        };
        Self { terms: terms.iter().map(term).collect(), last: none(), remembered: none(), frames: 0 }
    }

    /// Number of frames stored.
    pub(crate) fn frames(&self) -> u64 {
        self.frames
    }

    pub(crate) fn forget(&mut self) {
        let Self { terms, last, remembered, .. } = self;
        let all = terms.iter_mut().map(|term| &mut term.x).chain([last, remembered]);
        all.flatten().for_each(|field| field.fill(0.0));
        self.frames = 0;
    }

    /// Motion that the surface would have without tractions in the next frame.
    pub(crate) fn remembered(&self) -> &Surface {
        &self.remembered
    }

    /// Adds one frame. Its motion is `added`, due to tractions, plus the remembered motion.
    pub(crate) fn add(&mut self, added: [&[f64]; 3]) {
        let Self { terms, last, remembered, frames } = self;
        let instant: f64 = 1.0 - terms.iter().map(|term| term.share * term.now).sum::<f64>();
        for axis in 0..3 {
            for cell in 0..last[axis].len() {
                let now = added[axis][cell] + remembered[axis][cell];
                let mut sum = 0.0;
                for Term { share, own, before, now: weight, x } in &mut *terms {
                    let x = &mut x[axis][cell];
                    *x = *own * *x + *before * last[axis][cell] + *weight * now;
                    sum += *share * (*own * *x + *before * now);
                }
                last[axis][cell] = now;
                remembered[axis][cell] = sum / instant;
            }
        }
        *frames += 1;
    }
}
