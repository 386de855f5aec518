//! Profile of a blurred edge, and the optimal weights for locating a disc in the image's noise.

use super::bessel::Bessel;
use super::lanes::{Lanes, WIDTH};
use crate::detect::centre::noise::Noise;
use crate::math::{ceil, erf, exp, sqrt};
use alloc::boxed::Box;
use alloc::vec::Vec;
use core::f64::consts::{FRAC_1_SQRT_2, TAU};

/// Integrals across a straight edge over the distance in px: weight times slope, weight, weight times share.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Across {
    pub slope: f64,
    pub weight: f64,
    pub inside: f64,
}

/// Nodes per unit of distance over blur. Half a step off a node, the tangent is accurate to
/// 1 / 128² / 2 · 0.24 = 7e-6 of the contrast.
const PER_UNIT: usize = 64;
/// Distances over blur beyond which the profile is flat: Φ(-8) = 1e-15.
const REACH: usize = 8;
const NODES: usize = 2 * REACH * PER_UNIT;
/// Nodes per cosine sum of the weights, which are smooth; linear in between.
const COARSE: usize = 8;
/// Least number of frequencies of that sum, up to [`HIGHEST`] over blur, where e^-12.5 of the edge's
/// contrast is left.
const FREQUENCIES: usize = 48;
const HIGHEST: f64 = 5.0;
/// Radius over blur above which an edge counts as straight.
const STRAIGHT: f64 = 24.0;
/// Distance over blur, beyond twice the radius, at which the sum may repeat.
const PERIOD: f64 = 44.0;
/// Frequencies for the straightest edge.
const MAX_FREQUENCIES: usize = (HIGHEST * (2.0 * STRAIGHT + PERIOD) / TAU) as usize + 1;

/// Least assumed noise spectrum relative to that at frequency zero. With grain alone the weights would
/// oscillate between neighbouring pixels, and the fit would not converge.
const MIN_SHARE: f64 = 0.03;

/// Edge values at one distance z (in units of the blur, positive outside): Φ(-z), the share of the dot's
/// contrast; φ(z), its decrease with z; the weight of a residual in the sum that moves the edge,
/// 1 / levels² / px. The fourth entry pads to 16 bytes.
type Node = [f32; 4];

/// Profile and weights over the distance from an edge.
#[derive(Clone, Debug)]
pub(super) struct Edge {
    nodes: Box<[Node; NODES]>,
    coarse: Vec<f64>,
    across: Across,
    curvature_per_px2: f64,
    bessel: Bessel,
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
            coarse: alloc::vec![0.0; 2 * REACH * COARSE + 2],
            across: Across::default(),
            curvature_per_px2: 0.0,
            bessel: Bessel::up_to(HIGHEST * (STRAIGHT + REACH as f64 + 1.0)),
        }
    }

    /// Chooses the weights for the outline of a disc of this radius and blur in this noise. In the
    /// frequency domain they are the disc's slope over the noise spectrum (the matched filter of a single
    /// disc on the gel). In white noise that is least squares. In grain the weights are negative on both
    /// sides of the edge, so that every stretch of it is compared with the levels beside it.
    ///
    /// With the disc's transform 2 pi r J1(kr) / k, the weight at a distance p from the centre is
    /// r ∫ k J1(kp) J1(kr) e^(-k² b² / 2) / S(k) dk; times the direction's cosine and sine it locates the
    /// centre best. For a long straight edge that is the integral of cos(k (p - r)). A dot's grain is not
    /// small relative to its radius, and the straight edge's weights would cost 2 % of precision.
    pub fn weigh(&mut self, blur_px: f64, radius_px: f64, noise: &Noise) {
        let radius = (radius_px / blur_px).clamp(1.0, STRAIGHT);
        let count =
            FREQUENCIES.max(ceil(HIGHEST * (2.0 * radius + PERIOD) / TAU) as usize).min(MAX_FREQUENCIES);
        let step = HIGHEST / count as f64;
        let min = MIN_SHARE * noise.spectrum(0.0);
        // Weight of every frequency; sums for the slope and for its mean square frequency.
        let mut heights = [0.0; MAX_FREQUENCIES];
        let (mut slopes, mut bends) = (0.0, 0.0);
        for (n, height) in (1..=count).zip(&mut heights) {
            let k = n as f64 * step;
            let k_px = k / blur_px;
            let density = exp(-0.5 * k * k);
            let share = density / noise.spectrum(k_px * k_px).max(min);
            *height = radius * step * k / blur_px * share * self.bessel.j1(k * radius);
            slopes += share * density;
            bends += share * density * k_px * k_px;
        }
        self.curvature_per_px2 = bends / slopes;
        for (j, weight) in self.coarse.iter_mut().enumerate() {
            let from_centre = radius + j as f64 / COARSE as f64 - REACH as f64;
            let rate = step * from_centre;
            // Negative distances are on the other side of the centre.
            *weight =
                (1..=count).zip(&heights).map(|(n, height)| height * self.bessel.j1(n as f64 * rate)).sum();
        }
        self.spread(blur_px);
    }

    /// Chooses the least-squares weights for white noise: the slope of the profile.
    pub fn weigh_alike(&mut self, blur_px: f64) {
        for node in self.nodes.iter_mut() {
            node[2] = node[1] / blur_px as f32;
        }
    }

    /// Interpolates the weights between the coarse nodes and integrates them.
    fn spread(&mut self, blur_px: f64) {
        let mut across = Across::default();
        const PER: usize = PER_UNIT / COARSE;
        for (k, node) in self.nodes.iter_mut().enumerate() {
            let (first, part) = (k / PER, (k % PER) as f64 / PER as f64);
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

    /// Mean square of the edge's angular frequencies, weighted as in the step, 1/px²: 1 / (2 b²) in white
    /// noise.
    pub const fn curvature_per_px2(&self) -> f64 {
        self.curvature_per_px2
    }

    /// Integrals across a straight edge.
    pub const fn across(&self) -> &Across {
        &self.across
    }

    /// Nodes nearest to these distances, px, and the remaining offsets over blur.
    #[inline]
    pub fn find(distance: &Lanes, per_blur: f32, place: &mut [u32; WIDTH], off: &mut Lanes) {
        // 2^23: adding it rounds to an integer, which is in the lowest bits.
        const ROUND: f32 = 8_388_608.0;
        let limit = REACH as f32 - 0.02;
        for k in 0..WIDTH {
            let z = distance[k] * per_blur;
            let low = if z > -limit { z } else { -limit };
            let within = if low < limit { low } else { limit };
            let at = (within + REACH as f32) * PER_UNIT as f32;
            let rounded = at + ROUND;
            place[k] = rounded.to_bits();
            off[k] = (at - (rounded - ROUND)) * (1.0 / PER_UNIT as f32);
        }
    }

    /// Shares (with tangents), their decrease with distance over blur, and weights of the nodes.
    #[inline]
    pub fn look_up(&self, place: &[u32; WIDTH], off: &Lanes, [inside, density, weight]: [&mut Lanes; 3]) {
        for k in 0..WIDTH {
            let node = &self.nodes[place[k] as usize % NODES];
            (inside[k], density[k], weight[k]) = (node[0], node[1], node[2]);
        }
        for k in 0..WIDTH {
            inside[k] -= off[k] * density[k];
        }
    }
}
