//! Gel model between the markers: predicted gel height over an indenter (membrane obstacle problem).
//!
//! The gel is a Pasternak foundation (springs joined by a shear layer; Pasternak 1954) above an obstacle.
//! Its height h over the rest plane obeys h - l² Δh = p and is nowhere below the part. The pressure
//! p >= 0 is positive only where they are in contact. Projected over-relaxation (Cryer 1971) solves it
//! with the markers as nodes. The contact set follows from the pose, not from the noise of the markers:
//! selecting those that happen to lie near the part would bias the pose towards them.

use super::lattice::{Lattice, Node, Relaxation, Sweeps};
use crate::math::{DVec2, DVec3, exp, floor, solve_definite, sqrt};
use crate::register::surface::point::Sample;
use alloc::vec::Vec;

/// Accepted number of nodes. Fewer do not form a lattice; more come from a whole part.
const NODES: core::ops::RangeInclusive<usize> = 30..=6000;
/// Margin around the salient markers along both axes across the press; the gel is at rest beyond it.
const MARGIN_MM: f64 = 6.0;
/// Convergence limit of a sweep's largest change, far below any noise.
const SETTLED_MM: f64 = 3e-4;
/// Sweeps over the gel where the result only directs a step.
pub(in crate::register::surface) const FEW_SWEEPS: u32 = 8;
/// Number of markers whose nearest-neighbour distances estimate the pitch.
const ASKED: usize = 15;

/// The markers as nodes of the gel, sorted row by row in the plane across the press.
#[derive(Clone, Debug, Default)]
pub(in crate::register::surface) struct Gel {
    pub nodes: Vec<Node>,
    lattice: Lattice,
    /// (l / pitch)².
    stiffness: f64,
    /// As [`AdvancedRegisterParams::gel_scale`](crate::params::AdvancedRegisterParams::gel_scale).
    scale: f64,
}

impl Gel {
    /// Whether there is a lattice of nodes.
    pub fn is_known(&self) -> bool {
        !self.nodes.is_empty()
    }

    pub fn clear(&mut self) {
        self.nodes.clear();
    }

    /// (l / pitch)² for a decay length whose square is e^`log_squared` times the nominal one.
    pub fn stiffness(&self, log_squared: f64) -> f64 {
        self.stiffness * exp(log_squared)
    }

    /// Builds the nodes from all markers, relative to the patch's centroid; the first `salient` of them
    /// are salient. Empty if they do not form a lattice.
    pub fn fill(
        &mut self,
        markers: impl Iterator<Item = Sample>,
        salient: usize,
        press: DVec3,
        decay_mm: f64,
        gel_scale: f64,
    ) {
        self.clear();
        self.scale = gel_scale;
        let margin_mm = MARGIN_MM * gel_scale;
        let (a, b) = press.any_orthonormal_pair();
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for (k, sample) in markers.enumerate() {
            let p = sample.p_mm;
            let across_mm = DVec2::new(p.dot(a), p.dot(b));
            if k < salient {
                (low, high) = (low.min(across_mm), high.max(across_mm));
            } else if !is_within(across_mm, low - margin_mm, high + margin_mm) {
                continue;
            }
            self.nodes.push(Node { sample, across_mm, along_mm: p.dot(press), index: k });
            if self.nodes.len() > *NODES.end() {
                return self.clear();
            }
        }
        let pitch_mm = pitch(&self.nodes);
        // With a decay length below the pitch, the gel returns to rest between the markers, unseen.
        if !(NODES.contains(&self.nodes.len()) && pitch_mm > 0.0 && pitch_mm <= decay_mm) {
            return self.clear();
        }
        let low_mm = self.nodes.iter().map(|node| node.across_mm.y).fold(f64::INFINITY, f64::min);
        let row = |node: &Node| floor((node.across_mm.y - low_mm) / pitch_mm);
        // Row by row, independent of the input order.
        self.nodes.sort_unstable_by(|p, q| {
            let by_place = row(p).total_cmp(&row(q)).then(p.across_mm.x.total_cmp(&q.across_mm.x));
            by_place.then(p.across_mm.y.total_cmp(&q.across_mm.y)).then(p.along_mm.total_cmp(&q.along_mm))
        });
        self.stiffness = (decay_mm / pitch_mm) * (decay_mm / pitch_mm);
        if !self.lattice.find(&self.nodes, pitch_mm) {
            self.clear();
        }
    }

    /// Plane a + b u + c v of the gel at rest, with the position (u, v) across the press in patch radii.
    /// Beside contacts the gel is higher than at rest and nowhere lower, so points above the plane get a
    /// small weight (asymmetric least squares; Newey and Powell 1987).
    pub fn rest_plane(&self, radius_mm: f64) -> [f64; 3] {
        const ABOVE: f64 = 0.05;
        let mut plane = [f64::INFINITY, 0.0, 0.0];
        for _ in 0..8 {
            // The level needs no regularisation; the slopes get that of one more marker a radius away.
            let (mut h, mut g) = ([[0.0; 3]; 3], [0.0; 3]);
            (1..3).for_each(|i| h[i][i] = 1.0);
            for node in &self.nodes {
                let [u, v] = (node.across_mm / radius_mm).to_array();
                let is_over = node.along_mm > plane[0] + plane[1] * u + plane[2] * v;
                let weight = if is_over { ABOVE } else { 1.0 };
                let row = [1.0, u, v];
                for i in 0..3 {
                    g[i] += weight * row[i] * node.along_mm;
                    (i..3).for_each(|j| h[i][j] += weight * row[i] * row[j]);
                }
            }
            plane = solve_definite(&h, &g).unwrap_or(plane);
        }
        plane
    }

    /// Reserves memory for sweeps over the gel.
    pub fn lay_out(&self, sweeps: &mut Sweeps) {
        self.lattice.lay_out(sweeps);
    }

    /// Heights of the gel over an obstacle, from the initial `heights_mm`. Returns the number of sweeps.
    pub fn settle(
        &self,
        stiffness: f64,
        max_sweeps: u32,
        obstacle_mm: &[f64],
        heights_mm: &mut [f64],
        sweeps: &mut Sweeps,
    ) -> u32 {
        let relaxation = Relaxation { stiffness, max_sweeps, tolerance: SETTLED_MM * self.scale };
        self.lattice.settle(&relaxation, obstacle_mm, heights_mm, sweeps)
    }

    /// The neighbours of a node, at most four.
    pub fn near(&self, node: usize) -> impl Iterator<Item = usize> {
        self.lattice.near_marker(node)
    }

    /// Height of the gel at a node if it were not in contact there.
    pub fn free_mm(&self, node: usize, stiffness: f64, heights_mm: &[f64]) -> f64 {
        self.share(node, stiffness) * self.near(node).map(|k| heights_mm[k]).sum::<f64>()
    }

    /// Weight of each neighbour's height in `free_mm`.
    pub fn share(&self, node: usize, stiffness: f64) -> f64 {
        stiffness / (1.0 + stiffness * self.near(node).count() as f64)
    }

    /// Derivatives of the heights where the gel is free, from those where it is in contact. The last of
    /// the `N` columns is for the logarithm of l²; its source is the heights: (I - l² Δ) ∂h = h. Returns
    /// the number of sweeps.
    pub fn follow<const N: usize>(
        &self,
        stiffness: f64,
        touches: impl Fn(usize) -> bool,
        heights_mm: &[f64],
        changes: &mut [[f64; N]],
        sweeps: &mut Sweeps,
        cells: &mut Vec<[f64; N]>,
    ) -> u32 {
        let mut tolerance = [FOLLOWED; N];
        tolerance[N - 1] *= self.scale;
        let relaxation = Relaxation { stiffness, max_sweeps: FEW_SWEEPS, tolerance };
        self.lattice.follow(&relaxation, touches, heights_mm, changes, sweeps, cells)
    }
}

/// Convergence limit of the derivatives, which steps need only to some percent; in mm where they are heights.
const FOLLOWED: f64 = 1e-2;

fn is_within(p: DVec2, low: DVec2, high: DVec2) -> bool {
    p.cmpge(low).all() && p.cmple(high).all()
}

/// Median nearest-neighbour distance of some markers.
fn pitch(nodes: &[Node]) -> f64 {
    let mut nearest = [f64::INFINITY; ASKED];
    let count = ASKED.min(nodes.len());
    for (k, nearest) in nearest.iter_mut().enumerate().take(count) {
        let p = nodes[k * nodes.len() / count].across_mm;
        let squared = |q: &Node| q.across_mm.distance_squared(p);
        *nearest = nodes.iter().map(squared).filter(|&x| x > 0.0).fold(f64::INFINITY, f64::min);
    }
    nearest[..count].sort_unstable_by(f64::total_cmp);
    let squared = nearest.get(count / 2).copied().unwrap_or(f64::INFINITY);
    if squared.is_finite() { sqrt(squared) } else { 0.0 }
}
