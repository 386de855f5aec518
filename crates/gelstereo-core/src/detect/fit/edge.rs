//! The profile of a blurred edge, and the weights that locate it best in the image's noise.

use super::contour::Across;
use super::lanes::{Lanes, WIDTH};
use super::noise::Noise;
use crate::math::{cos, erf, exp, sqrt};
use alloc::boxed::Box;
use alloc::vec::Vec;
use core::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

/// Nodes per unit of distance over blur. Half a step off a node, the profile by its tangent is right to
/// 1 / 128² / 2 · 0.24 = 7e-6 of the contrast.
const PER_UNIT: usize = 64;
/// Distances over blur beyond which the profile is flat: Φ(-8) = 1e-15.
const REACH: usize = 8;
const NODES: usize = 2 * REACH * PER_UNIT;
/// Nodes for one cosine sum of the weights, which are smooth, and linear in between.
const COARSE: usize = 8;
/// Frequencies of that sum, up to [`HIGHEST`] over blur, where the edge has e^-12.5 of its contrast left.
const FREQUENCIES: usize = 48;
const HIGHEST: f64 = 5.0;

/// Noise that is assumed at all frequencies, over that at the lowest: in grain alone the weights would swing ever more
/// between neighbouring pixels, and the fit would not settle.
const LEAST_SHARE: f64 = 0.03;

/// What an edge does at one distance z (in units of the blur, positive outside): Φ(-z), the share of the dot's contrast;
/// φ(z), how fast that falls with z; the weight of a residual in the sum that moves the edge, 1 / levels² / px. The
/// fourth makes it 16 bytes.
type Node = [f32; 4];

/// An edge at some places.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Shares {
    pub inside: Lanes,
    pub density: Lanes,
    pub weight: Lanes,
}

/// Profile and weights over the distance from an edge.
#[derive(Clone, Debug)]
pub(super) struct Edge {
    nodes: Box<[Node; NODES]>,
    coarse: Vec<f64>,
    across: Across,
}

impl Edge {
    pub fn new() -> Self {
        let node = |k: usize| {
            let z = k as f64 / PER_UNIT as f64 - REACH as f64;
            let density = exp(-0.5 * z * z) / sqrt(TAU);
            [(0.5 - 0.5 * erf(z * FRAC_1_SQRT_2)) as f32, density as f32, 0.0, 0.0]
        };
        Self {
            nodes: Box::new(core::array::from_fn(node)),
            coarse: alloc::vec![0.0; REACH * COARSE + 2],
            across: Across::default(),
        }
    }

    /// Chooses the weights for an edge of this blur in this noise: in frequencies, the edge's density over the
    /// spectrum of the noise (the matched filter of an edge that is long compared with the grain). In white noise
    /// that is least squares; in grain the weights are negative on both sides of the edge, so that every stretch of it
    /// is judged against the levels beside it.
    pub fn weigh(&mut self, blur_px: f64, noise: &Noise) {
        self.coarse.fill(0.0);
        let step = HIGHEST / FREQUENCIES as f64;
        let least = LEAST_SHARE * noise.spectrum(0.0);
        for n in 0..=FREQUENCIES {
            let k = n as f64 * step;
            let share = if n == 0 { 0.5 } else { 1.0 };
            let k_px = k / blur_px;
            let height =
                share * step / (PI * blur_px) * exp(-0.5 * k * k) / noise.spectrum(k_px * k_px).max(least);
            // cos((j + 1) a) = 2 cos a cos(j a) - cos((j - 1) a)
            let twice = 2.0 * cos(k / COARSE as f64);
            let (mut before, mut here) = (0.5 * twice, 1.0);
            for weight in &mut self.coarse {
                *weight += height * here;
                (before, here) = (here, twice * here - before);
            }
        }
        let mut across = Across::default();
        let (middle, per) = (REACH * PER_UNIT, PER_UNIT / COARSE);
        for (k, node) in self.nodes.iter_mut().enumerate() {
            let from_edge = k.abs_diff(middle);
            let (first, part) = (from_edge / per, (from_edge % per) as f64 / per as f64);
            let weight = self.coarse[first] + (self.coarse[first + 1] - self.coarse[first]) * part;
            node[2] = weight as f32;
            across.slope += weight * f64::from(node[1]);
            across.weight += weight;
            across.inside += weight * f64::from(node[0]);
        }
        let (per_node, px) = (1.0 / PER_UNIT as f64, blur_px / PER_UNIT as f64);
        let Across { slope, weight, inside } = across;
        self.across = Across { slope: slope * per_node, weight: weight * px, inside: inside * px };
    }

    /// Integrals across a straight edge.
    pub const fn across(&self) -> &Across {
        &self.across
    }

    /// At distances `z` over blur, the share with its tangent.
    #[inline]
    pub fn at(&self, z: &Lanes) -> Shares {
        // 2^23: a sum with it is rounded to an integer, which stands in its lowest bits.
        const ROUND: f32 = 8_388_608.0;
        let (mut shares, mut off, mut place) = (Shares::default(), Lanes::default(), [0_u32; WIDTH]);
        let limit = REACH as f32 - 0.02;
        for k in 0..WIDTH {
            let low = if z[k] > -limit { z[k] } else { -limit };
            let within = if low < limit { low } else { limit };
            let at = (within + REACH as f32) * PER_UNIT as f32;
            let rounded = at + ROUND;
            place[k] = rounded.to_bits();
            off[k] = (at - (rounded - ROUND)) * (1.0 / PER_UNIT as f32);
        }
        for k in 0..WIDTH {
            let node = &self.nodes[place[k] as usize % NODES];
            (shares.inside[k], shares.density[k], shares.weight[k]) = (node[0], node[1], node[2]);
        }
        for k in 0..WIDTH {
            shares.inside[k] -= off[k] * shares.density[k];
        }
        shares
    }
}
