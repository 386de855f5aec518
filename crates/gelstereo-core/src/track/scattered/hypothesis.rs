//! Matches of a frame's detections to scattered markers, for one common displacement.

use super::neighbours::Neighbours;
use crate::math::{DVec2, sqrt};
use crate::spatial::Grid;
use alloc::vec::Vec;

/// No detection, or no marker.
pub(super) const NONE: u32 = u32::MAX;

// Ranges tried on simulated prints of four layouts (track_scattered.rs, 300 cases a property), in which no
// marker had a wrong name and every test passed: NEIGHBOURS_AGREE 0.2 to 0.5, DISPUTED 0.12 to 0.4, LONE 0.06
// to 0.24, LONE_MOST 0.15 to 0.4.

/// Neighbours that moved alike have residuals that differ by less than this, in spacings.
const NEIGHBOURS_AGREE: f64 = 0.35;

/// If the distances of a detection from two markers differ by less than this, in spacings, it is two merged
/// markers and is given to neither.
const DISPUTED: f64 = 0.25;

/// Largest difference of a marker from its neighbours, in spacings, plus twice the spread of the
/// neighbours. It is at most a share of the distance to the nearest neighbour.
const LONE: f64 = 0.12;
const LONE_MOST: f64 = 0.25;

/// Fewest matched neighbours of a match.
const BESIDE: usize = 2;

/// Most neighbours of a marker that are compared.
const COMPARED: usize = 12;

/// What a hypothesis is tried on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scene<'a> {
    pub detected_px: &'a [DVec2],
    pub expected_px: &'a [DVec2],
    pub neighbours: &'a Neighbours,
    pub spacing_px: f64,
    pub gate_px: f64,
}

/// Competing markers of a detection.
#[derive(Clone, Copy, Debug)]
struct Claim {
    marker: u32,
    nearest_px: f64,
    second_px: f64,
}

const UNCLAIMED: Claim = Claim { marker: NONE, nearest_px: f64::INFINITY, second_px: f64::INFINITY };

/// Residual of a marker as its neighbours suggest it: component-wise median, and mean distance from it.
#[derive(Clone, Copy, Debug)]
struct Suggested {
    middle_px: DVec2,
    spread_px: f64,
    count: usize,
}

/// Matches for one common displacement.
#[derive(Clone, Debug, Default)]
pub(super) struct Hypothesis {
    grid: Grid,
    /// Detection of each marker.
    detection: Vec<u32>,
    /// Difference of the detection from the expected position.
    residual_px: Vec<DVec2>,
    taken: Vec<bool>,
    claims: Vec<Claim>,
    targets: Vec<(u32, DVec2)>,
    component: Vec<u32>,
    stack: Vec<u32>,
}

impl Hypothesis {
    pub fn reserve(&mut self, markers: usize, detections: usize, size_px: (usize, usize), spacing_px: f64) {
        self.grid.reserve(detections, size_px, spacing_px);
        for list in [&mut self.detection, &mut self.component, &mut self.stack] {
            list.clear();
            list.reserve(markers);
        }
        self.residual_px.reserve(markers);
        self.targets.reserve(markers);
        self.taken.reserve(detections.saturating_sub(self.taken.len()));
        self.claims.reserve(detections.saturating_sub(self.claims.len()));
    }

    /// Detection of each marker, or [`NONE`].
    pub fn detection(&self) -> &[u32] {
        &self.detection
    }

    /// Detections of the last scene.
    pub const fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Number of matched markers.
    pub fn count(&self) -> usize {
        self.detection.iter().filter(|&&m| m != NONE).count()
    }

    /// Mean distance of the matched markers from their expected positions.
    pub fn mean_residual_px(&self) -> Option<f64> {
        let matched = || self.detection.iter().zip(&self.residual_px).filter(|(m, _)| **m != NONE);
        let sum: f64 = matched().map(|(_, residual_px)| residual_px.length()).sum();
        (matched().count() > 0).then(|| sum / matched().count() as f64)
    }

    /// Whether most markers have the same detections.
    pub fn is_like(&self, other: &Self) -> bool {
        let same = |(a, b): &(&u32, &u32)| a == b && **a != NONE;
        2 * self.detection.iter().zip(&other.detection).filter(same).count() > self.count()
    }

    /// Matches the detections to the expected positions displaced by `shift_px`.
    pub fn run(&mut self, scene: &Scene<'_>, shift_px: DVec2) {
        let (markers, detections) = (scene.expected_px.len(), scene.detected_px.len());
        self.grid.build(scene.detected_px, scene.spacing_px);
        self.detection.clear();
        self.detection.resize(markers, NONE);
        self.residual_px.clear();
        self.residual_px.resize(markers, DVec2::ZERO);
        self.taken.clear();
        self.taken.resize(detections, false);
        self.targets.clear();
        self.targets.extend(scene.expected_px.iter().enumerate().map(|(n, &p)| (n as u32, p + shift_px)));
        self.claim(scene, scene.gate_px);
        self.keep_largest(scene);
        self.grow(scene);
        if self.drop_lone(scene) {
            self.grow(scene);
            self.drop_lone(scene);
        }
    }

    /// Assigns to each target the nearest free detection within the gate, unless another target is about as
    /// near. Returns whether any was assigned.
    fn claim(&mut self, scene: &Scene<'_>, gate_px: f64) -> bool {
        let Self { grid, detection, residual_px, taken, claims, targets, .. } = self;
        claims.clear();
        claims.resize(scene.detected_px.len(), UNCLAIMED);
        for &(n, target) in targets.iter() {
            if let Some(m) = grid.nearest(scene.detected_px, target, gate_px, |m| !taken[m]) {
                let (px, claim) = (scene.detected_px[m].distance(target), &mut claims[m]);
                *claim = if px < claim.nearest_px {
                    Claim { marker: n, nearest_px: px, second_px: claim.nearest_px }
                } else {
                    Claim { second_px: claim.second_px.min(px), ..*claim }
                };
            }
        }
        let mut any = false;
        for (m, claim) in claims.iter().enumerate().filter(|(_, claim)| claim.marker != NONE) {
            if claim.second_px - claim.nearest_px >= DISPUTED * scene.spacing_px {
                let n = claim.marker as usize;
                detection[n] = m as u32;
                residual_px[n] = scene.detected_px[m] - scene.expected_px[n];
                taken[m] = true;
                any = true;
            }
        }
        any
    }

    /// Drops all but the largest connected set of neighbours that moved alike.
    fn keep_largest(&mut self, scene: &Scene<'_>) {
        let agree_px = NEIGHBOURS_AGREE * scene.spacing_px;
        self.component.clear();
        self.component.resize(self.detection.len(), NONE);
        let (mut largest, mut most) = (NONE, 0);
        for seed in 0..self.detection.len() {
            if self.detection[seed] == NONE || self.component[seed] != NONE {
                continue;
            }
            let mut size = 0;
            self.component[seed] = seed as u32;
            self.stack.clear();
            self.stack.push(seed as u32);
            while let Some(n) = self.stack.pop() {
                size += 1;
                for other in scene.neighbours.of(n as usize) {
                    let apart_px = self.residual_px[other].distance(self.residual_px[n as usize]);
                    if self.detection[other] != NONE && self.component[other] == NONE && apart_px < agree_px {
                        self.component[other] = seed as u32;
                        self.stack.push(other as u32);
                    }
                }
            }
            if size > most {
                (largest, most) = (seed as u32, size);
            }
        }
        for n in 0..self.detection.len() {
            if self.component[n] != largest {
                self.release(n);
            }
        }
    }

    fn release(&mut self, n: usize) {
        if self.detection[n] != NONE {
            self.taken[self.detection[n] as usize] = false;
            self.detection[n] = NONE;
            self.residual_px[n] = DVec2::ZERO;
        }
    }

    /// Matches markers beside matched ones, from the residuals of these, until nothing new is found.
    fn grow(&mut self, scene: &Scene<'_>) {
        loop {
            self.targets.clear();
            for n in (0..self.detection.len()).filter(|&n| self.detection[n] == NONE) {
                if let Some(around) = self.suggested(scene, n).filter(|around| around.count >= BESIDE) {
                    self.targets.push((n as u32, scene.expected_px[n] + around.middle_px));
                }
            }
            if !self.claim(scene, NEIGHBOURS_AGREE * scene.spacing_px) {
                return;
            }
        }
    }

    /// Drops matches that moved unlike their neighbours (false detections and merged pairs), until none does;
    /// returns whether there were any.
    fn drop_lone(&mut self, scene: &Scene<'_>) -> bool {
        let mut any = false;
        loop {
            self.stack.clear();
            for n in (0..self.detection.len()).filter(|&n| self.detection[n] != NONE) {
                if self.is_lone(scene, n) {
                    self.stack.push(n as u32);
                }
            }
            if self.stack.is_empty() {
                return any;
            }
            any = true;
            while let Some(n) = self.stack.pop() {
                self.release(n as usize);
            }
        }
    }

    fn is_lone(&self, scene: &Scene<'_>, n: usize) -> bool {
        let Some(around) = self.suggested(scene, n).filter(|around| around.count >= BESIDE) else {
            return true;
        };
        let max_px = (LONE * scene.spacing_px + 2.0 * around.spread_px)
            .min(LONE_MOST * scene.neighbours.nearest_px(n));
        around.middle_px.distance(self.residual_px[n]) > max_px
    }

    fn suggested(&self, scene: &Scene<'_>, n: usize) -> Option<Suggested> {
        let (mut x, mut y) = ([0.0; COMPARED], [0.0; COMPARED]);
        let mut count = 0;
        for m in scene.neighbours.of(n).filter(|&m| self.detection[m] != NONE).take(COMPARED) {
            (x[count], y[count]) = (self.residual_px[m].x, self.residual_px[m].y);
            count += 1;
        }
        if count == 0 {
            return None;
        }
        let (x, y) = (&mut x[..count], &mut y[..count]);
        let pairs = || x.iter().zip(y.iter());
        let mean = pairs().fold(DVec2::ZERO, |sum, (&x, &y)| sum + DVec2::new(x, y)) / count as f64;
        let squares = pairs().fold(0.0, |sum, (&x, &y)| sum + DVec2::new(x, y).distance_squared(mean));
        let spread_px = sqrt(squares / count as f64);
        Some(Suggested { middle_px: DVec2::new(median(x), median(y)), spread_px, count })
    }
}

/// Median; of an even number, the mean of the middle two.
fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let n = values.len();
    0.5 * (values[(n - 1) / 2] + values[n / 2])
}
