//! What the gel does between the markers: how high it stands over a part that is pressed into it.
//!
//! The gel is a Pasternak foundation (springs joined by a shear layer; Pasternak 1954) under an obstacle: its height h
//! over the rest plane obeys h - l² Δh = p, no lower than the part, with a pressure p >= 0 that is positive only where
//! they touch. It is solved on the markers themselves by projected over-relaxation (Cryer 1971). What touches at a pose
//! follows from the pose, not from the noise of the markers: choosing those that happen to lie near the part would pull
//! the part to them.

use super::contact::Sample;
use super::step::cholesky;
use crate::math::{DVec2, DVec3, abs, exp, floor, sqrt};
use alloc::vec::Vec;

/// Neighbours along both axes of the lattice, both ways.
const RING: usize = 4;
/// A neighbour is no farther than this, in pitches, and lies along an axis to this cosine: diagonals are none.
const FARTHEST: f64 = 1.5;
const ALONG: f64 = 0.9;
/// Fewer nodes are no lattice; more are those of a part as a whole.
const NODES: core::ops::RangeInclusive<usize> = 30..=6000;
/// Markers this far beyond the salient ones, along the press's axes, are where the gel is at rest.
const MARGIN_MM: f64 = 6.0;
/// Sweeps that move nothing by more have converged, far below any noise.
const SETTLED_MM: f64 = 3e-4;
/// Markers whose nearest neighbour tells the pitch.
const ASKED: usize = 15;

/// A marker as a node of the gel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    pub sample: Sample,
    /// Across the press, about the patch's centroid.
    pub across_mm: DVec2,
    /// Along it.
    pub along_mm: f64,
}

/// The markers as nodes of the gel, row by row of the plane across the press.
#[derive(Clone, Debug, Default)]
pub(super) struct Gel {
    pub nodes: Vec<Node>,
    /// In the order in which sweeps go: no node, if it can be, next to one of the same half.
    rings: Vec<Ring>,
    /// (l / pitch)².
    stiffness: f64,
    starts: Vec<u32>,
    halves: Vec<u32>,
}

/// A node and its neighbours.
#[derive(Clone, Copy, Debug)]
struct Ring {
    node: u32,
    count: u32,
    near: [u32; RING],
}

impl Ring {
    /// Sum over the neighbours.
    #[inline]
    fn sum(&self, heights_mm: &[f64]) -> f64 {
        let [a, b, c, d] = self.near.map(|j| j as usize);
        if self.count as usize == RING {
            return heights_mm[a] + heights_mm[b] + heights_mm[c] + heights_mm[d];
        }
        self.near[..self.count as usize].iter().fold(0.0, |sum, &j| sum + heights_mm[j as usize])
    }

    /// The same of every column.
    #[inline]
    fn sums<const N: usize>(&self, changes: &[[f64; N]]) -> [f64; N] {
        if self.count as usize == RING {
            let [a, b, c, d] = self.near.map(|j| &changes[j as usize]);
            return core::array::from_fn(|i| a[i] + b[i] + c[i] + d[i]);
        }
        let mut sum = [0.0; N];
        for &j in &self.near[..self.count as usize] {
            let other = &changes[j as usize];
            (0..N).for_each(|i| sum[i] += other[i]);
        }
        sum
    }
}

impl Gel {
    /// Whether there is a lattice of nodes.
    pub fn is_known(&self) -> bool {
        !self.nodes.is_empty()
    }

    pub fn clear(&mut self) {
        self.nodes.clear();
    }

    /// (l / pitch)² at a decay length whose square is e^`log_squared` times the nominal one.
    pub fn stiffness(&self, log_squared: f64) -> f64 {
        self.stiffness * exp(log_squared)
    }

    /// Of all markers about the patch's centroid, of which the first so many are salient.
    pub fn fill(
        &mut self,
        markers: impl Iterator<Item = Sample>,
        salient: usize,
        press: DVec3,
        decay_mm: f64,
    ) {
        self.clear();
        let (a, b) = press.any_orthonormal_pair();
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for (k, sample) in markers.enumerate() {
            let p = sample.p_mm;
            let across_mm = DVec2::new(p.dot(a), p.dot(b));
            if k < salient {
                (low, high) = (low.min(across_mm), high.max(across_mm));
            } else if !is_within(across_mm, low - MARGIN_MM, high + MARGIN_MM) {
                continue;
            }
            self.nodes.push(Node { sample, across_mm, along_mm: p.dot(press) });
            if self.nodes.len() > *NODES.end() {
                return self.clear();
            }
        }
        let pitch_mm = pitch(&self.nodes);
        // A gel that comes back to rest within a pitch does so between the markers.
        if !(NODES.contains(&self.nodes.len()) && pitch_mm > 0.0 && pitch_mm <= decay_mm) {
            return self.clear();
        }
        let low_mm = self.nodes.iter().map(|node| node.across_mm.y).fold(f64::INFINITY, f64::min);
        let row = |node: &Node| floor((node.across_mm.y - low_mm) / pitch_mm);
        // Row by row, whatever the order they come in.
        self.nodes.sort_unstable_by(|p, q| {
            let by_place = row(p).total_cmp(&row(q)).then(p.across_mm.x.total_cmp(&q.across_mm.x));
            by_place.then(p.across_mm.y.total_cmp(&q.across_mm.y)).then(p.along_mm.total_cmp(&q.along_mm))
        });
        self.stiffness = (decay_mm / pitch_mm) * (decay_mm / pitch_mm);
        self.join(pitch_mm, low_mm);
    }

    /// The plane a + b u + c v of the gel at rest, over the place across the press in radii of the patch. Beside contacts
    /// the gel is higher, and nowhere lower: what is over the plane counts little (asymmetric least squares; Newey and
    /// Powell 1987).
    pub fn rest_plane(&self, radius_mm: f64) -> [f64; 3] {
        const ABOVE: f64 = 0.05;
        let mut plane = [f64::INFINITY, 0.0, 0.0];
        for _ in 0..8 {
            // The level is known of itself; the slopes are held as if by one more marker a radius away.
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
            plane = cholesky(&h, &g).unwrap_or(plane);
        }
        plane
    }

    /// Finds the neighbours: the nearest marker shows one axis, and along both axes the nearest one each way counts.
    fn join(&mut self, pitch_mm: f64, low_mm: f64) {
        let Self { nodes, rings, starts, .. } = self;
        let row = |node: &Node| ((node.across_mm.y - low_mm) / pitch_mm) as usize;
        let rows = nodes.last().map_or(0, row) + 1;
        // A marker far off makes no rows.
        if rows > nodes.len() {
            return nodes.clear();
        }
        starts.clear();
        starts.resize(rows + 1, 0);
        nodes.iter().for_each(|node| starts[row(node) + 1] += 1);
        for r in 0..rows {
            starts[r + 1] += starts[r];
        }
        rings.clear();
        let farthest = FARTHEST * FARTHEST * pitch_mm * pitch_mm;
        for (k, node) in nodes.iter().enumerate() {
            let first = starts[row(node).saturating_sub(2)] as usize;
            let last = starts[(row(node) + 3).min(rows)] as usize;
            let around = || {
                let near = (first..last).filter(|&j| j != k);
                let offsets = near.map(|j| (nodes[j].across_mm - node.across_mm, j as u32));
                offsets.filter(|(offset, _)| (0.0..=farthest).contains(&offset.length_squared()))
            };
            let nearest = around().fold((f64::INFINITY, DVec2::X), |best, (offset, _)| {
                let squared = offset.length_squared();
                if squared < best.0 && squared > 0.0 { (squared, offset) } else { best }
            });
            let axis = nearest.1 / sqrt(nearest.1.length_squared());
            let mut best = [(farthest, None); RING];
            for (offset, j) in around() {
                let squared = offset.length_squared();
                let (x, y) = (offset.dot(axis), offset.dot(axis.perp()));
                let way = if abs(x) > abs(y) { usize::from(x < 0.0) } else { 2 + usize::from(y < 0.0) };
                let along = abs(x).max(abs(y));
                if squared < best[way].0 && along * along > ALONG * ALONG * squared {
                    best[way] = (squared, Some(j));
                }
            }
            let mut ring = Ring { node: k as u32, count: 0, near: [0; RING] };
            for j in best.iter().filter_map(|(_, j)| *j) {
                ring.near[ring.count as usize] = j;
                ring.count += 1;
            }
            rings.push(ring);
        }
        self.halve();
    }

    /// Orders the rings by halves of which each has its neighbours in the other one (Young 1954, red and black): a sweep
    /// does not wait for the node before. On a lattice that is no plane's, some neighbours share a half; the heights that
    /// sweeps end on are the same.
    fn halve(&mut self) {
        const UNSEEN: u32 = u32::MAX;
        let Self { rings, starts: open, halves, .. } = self;
        halves.clear();
        halves.resize(rings.len(), UNSEEN);
        for first in 0..rings.len() {
            if halves[first] != UNSEEN {
                continue;
            }
            halves[first] = 0;
            open.clear();
            open.push(first as u32);
            while let Some(k) = open.pop() {
                let ring = &rings[k as usize];
                for &j in &ring.near[..ring.count as usize] {
                    if halves[j as usize] == UNSEEN {
                        halves[j as usize] = 1 - halves[k as usize];
                        open.push(j);
                    }
                }
            }
        }
        rings.sort_unstable_by_key(|ring| (halves[ring.node as usize], ring.node));
    }

    /// Heights of the gel over an obstacle; `heights_mm` is where to begin. Returns the sweeps that took.
    pub fn settle(&self, stiffness: f64, most: u32, obstacle_mm: &[f64], heights_mm: &mut [f64]) -> u32 {
        let jacobi = 4.0 * stiffness / (1.0 + 4.0 * stiffness);
        let over = 2.0 / (1.0 + sqrt(1.0 - jacobi * jacobi));
        let shares = shares(stiffness).map(|share| share * stiffness);
        for sweep in 1..=most {
            let mut largest = 0.0;
            for ring in &self.rings {
                let k = ring.node as usize;
                let here = heights_mm[k];
                let free = shares[ring.count as usize] * ring.sum(heights_mm);
                let next = larger(here + over * (free - here), obstacle_mm[k]);
                largest = larger((next - here).abs(), largest);
                heights_mm[k] = next;
            }
            if largest < SETTLED_MM {
                return sweep;
            }
        }
        most
    }

    /// Every node with its neighbours, and the height that the gel would have there if nothing touched it at that node.
    pub fn around<'a>(
        &'a self,
        stiffness: f64,
        heights_mm: &'a [f64],
    ) -> impl Iterator<Item = (usize, &'a [u32], f64)> {
        let shares = shares(stiffness).map(|share| share * stiffness);
        self.rings.iter().map(move |ring| {
            let free_mm = shares[ring.count as usize] * ring.sum(heights_mm);
            (ring.node as usize, &ring.near[..ring.count as usize], free_mm)
        })
    }

    /// How heights change where the gel is free, from how they change where it touches; of the last of the `N` columns,
    /// the logarithm of l², heights are the source: (I - l² Δ) ∂h = h. Returns the sweeps that took.
    pub fn follow<const N: usize>(
        &self,
        (stiffness, most): (f64, u32),
        (touches, heights_mm): (impl Fn(usize) -> bool, &[f64]),
        changes: &mut [[f64; N]],
    ) -> u32 {
        let jacobi = 4.0 * stiffness / (1.0 + 4.0 * stiffness);
        let over = 2.0 / (1.0 + sqrt(1.0 - jacobi * jacobi));
        let shares = shares(stiffness);
        for sweep in 1..=most {
            let mut largest = [0.0; N];
            for ring in &self.rings {
                let k = ring.node as usize;
                if touches(k) {
                    continue;
                }
                let mut source = [0.0; N];
                source[N - 1] = heights_mm[k];
                let (sum, share) = (ring.sums(changes), shares[ring.count as usize]);
                let mut here = changes[k];
                for i in 0..N {
                    let step = over * (share * (stiffness * sum[i] + source[i]) - here[i]);
                    largest[i] = larger(step.abs(), largest[i]);
                    here[i] += step;
                }
                changes[k] = here;
            }
            let largest = largest.into_iter().fold(0.0, larger);
            if largest < FOLLOWED {
                return sweep;
            }
        }
        most
    }
}

/// Changes are for steps, which need no more than some percent.
const FOLLOWED: f64 = 1e-2;

/// The larger one; a single instruction, unlike `f64::max`.
#[inline]
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// 1 / (1 + n l²) of nodes with n neighbours.
fn shares(stiffness: f64) -> [f64; RING + 1] {
    [0.0, 1.0, 2.0, 3.0, 4.0].map(|count| 1.0 / (1.0 + stiffness * count))
}

fn is_within(p: DVec2, low: DVec2, high: DVec2) -> bool {
    p.cmpge(low).all() && p.cmple(high).all()
}

/// Median of the distances of some markers to their nearest ones.
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
