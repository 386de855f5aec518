//! Matches detections to places of the lattice, up to a shift by whole pitches.

use super::agreement::{BENT, Before, NEIGHBOURS_AGREE, agree_all, in_one_piece, moved_alike, torn};
use super::extended_lattice::{ExtendedLattice, NONE, SUGGESTED_FROM};
use super::near;
use super::window_detections::WindowDetections;
use crate::math::DVec2;
use crate::spatial::Grid;
use alloc::vec::Vec;

/// If the distances of a detection from two places differ by less than this, in pitches, it is two merged
/// markers and is given to neither.
const DISPUTED: f64 = 0.25;

/// After any shift of a lattice, some marker lies within this distance of each place, in pitches: half a
/// diagonal plus a margin.
const HALF_DIAGONAL: f64 = 0.75;

/// Largest difference of a marker from the estimate of its neighbours, in pitches. Added to it are twice
/// the spread of the estimates and a small amount per frame that the marker was hidden, up to a limit.
const LONE: f64 = 0.12;
const LONE_HIDDEN: f64 = 0.02;
const HIDDEN_FRAMES: u32 = 4;
/// Upper bound of that difference, as a share of the distance to the nearest neighbour, which is less
/// than a pitch where the gel is compressed.
const LONE_MOST: f64 = 0.25;

/// Fewest matched neighbours of a marker, and of one that was hidden.
const BESIDE: usize = 2;
const BESIDE_HIDDEN: usize = 3;

/// With fewer estimates than this, the tolerance is not enlarged.
const SUPPORT: usize = 5;

/// Competing places of a detection.
#[derive(Clone, Copy, Debug)]
struct Claim {
    site: u32,
    nearest_px2: f64,
    second_px2: f64,
}

const UNCLAIMED: Claim = Claim { site: NONE, nearest_px2: f64::INFINITY, second_px2: f64::INFINITY };

/// Matches detections to the places of a canvas.
///
/// Nearest-neighbour matching fails where the gel has moved by half a pitch or more. But correctly
/// matched neighbours have moved alike, so matches whose residuals disagree with their neighbours' are
/// slips. The largest set of consistent places, grown from place to place, is labelled correctly up to
/// one common shift.
#[derive(Clone, Debug, Default)]
pub(super) struct Matching {
    grid: Grid,
    taken: Vec<bool>,
    claims: Vec<Claim>,
    targets: Vec<(u32, DVec2)>,
    claimants: Vec<(u32, u32)>,
    component: Vec<u32>,
    stack: Vec<u32>,
    known: Vec<bool>,
}

impl Matching {
    /// Reserves memory for this many places and detections, and for this image size.
    pub fn reserve(&mut self, sites: usize, detections: usize, size_px: (usize, usize), pitch_px: f64) {
        self.grid.reserve(detections, size_px, pitch_px);
        self.taken.reserve(detections.saturating_sub(self.taken.len()));
        self.claims.reserve(detections.saturating_sub(self.claims.len()));
        self.targets.reserve(sites);
        self.claimants.reserve(sites);
        self.component.reserve(sites);
        self.stack.reserve(sites);
        self.known.reserve(sites);
    }

    /// Loads the detections of a frame.
    pub fn load(&mut self, detected_px: &[DVec2], pitch_px: f64) {
        self.grid.build(detected_px, pitch_px);
    }

    /// Matches the loaded detections. Initial matches are closer than `gate_px`; without a gate, all
    /// within half a diagonal of a place are tried. Returns whether all neighbours agree in the end.
    pub fn run(
        &mut self,
        canvas: &mut ExtendedLattice,
        detected_px: &[DVec2],
        before: Before<'_>,
        gate_px: Option<f64>,
        sights: WindowDetections<'_>,
    ) -> bool {
        let disputed_px = DISPUTED * before.pitch_px;
        self.start(detected_px.len());
        self.targets.clear();
        self.targets.extend(canvas.predicted_px.iter().enumerate().map(|(s, &p)| (s as u32, p)));
        match gate_px {
            Some(gate_px) => self.claim(canvas, detected_px, gate_px, disputed_px, sights),
            None => self.claim(canvas, detected_px, HALF_DIAGONAL * before.pitch_px, 0.0, sights),
        };
        if agree_all(canvas, before) {
            // Adds markers beyond the gate when all have moved by nearly the same amount.
            if self.taken.contains(&false) {
                self.grow(canvas, detected_px, before.pitch_px);
                self.weed(canvas, before);
            }
            return true;
        }
        self.agree(canvas, detected_px, before)
    }

    /// Checks a labelling of the loaded detections made without the prediction, as [`Self::run`] checks
    /// its matches.
    pub fn check(&mut self, canvas: &mut ExtendedLattice, detected_px: &[DVec2], before: Before<'_>) -> bool {
        self.start(detected_px.len());
        for &m in canvas.found.iter().filter(|&&m| m != NONE) {
            self.taken[m as usize] = true;
        }
        self.agree(canvas, detected_px, before)
    }

    fn start(&mut self, detections: usize) {
        self.taken.clear();
        self.taken.resize(detections, false);
        self.claims.clear();
        self.claims.resize(detections, UNCLAIMED);
    }

    /// Keeps matches that agree with their neighbours and grows them; returns whether all agree in the
    /// end.
    fn agree(&mut self, canvas: &mut ExtendedLattice, detected_px: &[DVec2], before: Before<'_>) -> bool {
        let pitch_px = before.pitch_px;
        self.keep_largest(canvas, pitch_px, |_, _| false);
        let mut changed = self.grow(canvas, detected_px, pitch_px);
        // Separate parts are joined if everything has moved alike. Markers that were hidden until now are
        // excluded: they could have moved unseen.
        if let Some(mean) = moved_alike(canvas, pitch_px) {
            self.targets.clear();
            for site in (0..canvas.found.len()).filter(|&s| canvas.found[s] == NONE) {
                if before.is_fresh(canvas, site) {
                    self.targets.push((site as u32, canvas.predicted_px[site] + mean));
                }
            }
            let (reach_px, disputed_px) = (NEIGHBOURS_AGREE * pitch_px, DISPUTED * pitch_px);
            if self.claim(canvas, detected_px, reach_px, disputed_px, WindowDetections::default()) {
                self.grow(canvas, detected_px, pitch_px);
                changed = true;
            }
        }
        changed |= self.settle(canvas, detected_px, pitch_px);
        // With a one-to-one match of all places and detections, none is a false detection or a merged
        // pair.
        changed |= !self.is_complete(canvas) && self.weed(canvas, before);
        // A part cut off by weeding may have slipped as a whole.
        if changed {
            let alike = moved_alike(canvas, pitch_px).is_some();
            self.keep_largest(canvas, pitch_px, |canvas, site| alike && before.is_fresh(canvas, site));
        }
        canvas.spread(&mut self.known, &mut self.targets);
        !torn(canvas, before)
    }

    /// Assigns to each target the nearest free detection within the gate, unless another target is about
    /// as near. Returns whether any was assigned.
    fn claim(
        &mut self,
        canvas: &mut ExtendedLattice,
        detected_px: &[DVec2],
        gate_px: f64,
        disputed_px: f64,
        sights: WindowDetections<'_>,
    ) -> bool {
        let Self { grid, taken, claims, targets, claimants, .. } = self;
        let sure_px2 = sights.nearest_px2.min(gate_px * gate_px);
        claimants.clear();
        for &(site, target) in targets.iter() {
            let seen = canvas.marker(site as usize).and_then(|n| sights.detection(n));
            let is_nearest = |m: &usize| {
                *m < taken.len() && !taken[*m] && detected_px[*m].distance_squared(target) < sure_px2
            };
            let nearest = || grid.nearest(detected_px, target, gate_px, |m| !taken[m]);
            let Some(m) = seen.filter(is_nearest).or_else(nearest) else { continue };
            let px2 = detected_px[m].distance_squared(target);
            let claim = &mut claims[m];
            *claim = if px2 < claim.nearest_px2 {
                Claim { site, nearest_px2: px2, second_px2: claim.nearest_px2 }
            } else {
                Claim { second_px2: claim.second_px2.min(px2), ..*claim }
            };
            claimants.push((site, m as u32));
        }
        let before = claimants.len();
        claimants.retain(|&(site, m)| {
            let claim = &claims[m as usize];
            // Skips a square root when there is no second.
            claim.site == site
                && (claim.second_px2 == f64::INFINITY
                    || crate::math::sqrt(claim.second_px2) - crate::math::sqrt(claim.nearest_px2)
                        >= disputed_px)
        });
        for &(site, m) in claimants.iter() {
            let (site, m) = (site as usize, m as usize);
            canvas.found[site] = m as u32;
            canvas.residual_px[site] = detected_px[m] - canvas.predicted_px[site];
            taken[m] = true;
        }
        if before > 0 {
            claims.fill(UNCLAIMED);
        }
        !claimants.is_empty()
    }

    /// Drops all but the largest connected set of consistent neighbours, except places for which `spared`
    /// holds.
    fn keep_largest(
        &mut self,
        canvas: &mut ExtendedLattice,
        pitch_px: f64,
        spared: impl Fn(&ExtendedLattice, usize) -> bool,
    ) {
        let agree_px2 = (NEIGHBOURS_AGREE * pitch_px) * (NEIGHBOURS_AGREE * pitch_px);
        if in_one_piece(canvas, agree_px2) {
            return;
        }
        self.component.clear();
        self.component.resize(canvas.found.len(), NONE);
        let (mut largest, mut most) = (NONE, 0);
        for seed in 0..canvas.found.len() {
            if canvas.found[seed] == NONE || self.component[seed] != NONE {
                continue;
            }
            let mut size = 0;
            self.component[seed] = seed as u32;
            self.stack.clear();
            self.stack.push(seed as u32);
            while let Some(site) = self.stack.pop() {
                size += 1;
                for other in canvas.around(site as usize) {
                    let apart = canvas.residual_px[other] - canvas.residual_px[site as usize];
                    if canvas.found[other] != NONE
                        && self.component[other] == NONE
                        && apart.length_squared() < agree_px2
                    {
                        self.component[other] = seed as u32;
                        self.stack.push(other as u32);
                    }
                }
            }
            if size > most {
                (largest, most) = (seed as u32, size);
            }
        }
        for site in (0..canvas.found.len()).filter(|&s| self.component[s] != largest) {
            if canvas.found[site] != NONE && !spared(canvas, site) {
                self.taken[canvas.found[site] as usize] = false;
                canvas.found[site] = NONE;
                canvas.residual_px[site] = DVec2::ZERO;
            }
        }
    }

    /// Matches places next to matched ones, predicted from their residuals, until nothing new is found;
    /// returns whether anything was.
    fn grow(&mut self, canvas: &mut ExtendedLattice, detected_px: &[DVec2], pitch_px: f64) -> bool {
        let (reach_px, disputed_px) = (NEIGHBOURS_AGREE * pitch_px, DISPUTED * pitch_px);
        let mut any = false;
        loop {
            self.targets.clear();
            for site in (0..canvas.found.len()).filter(|&s| canvas.found[s] == NONE) {
                if let Some(around) = canvas.suggested(site) {
                    self.targets.push((site as u32, canvas.predicted_px[site] + around.middle_px));
                }
            }
            if !self.claim(canvas, detected_px, reach_px, disputed_px, WindowDetections::default()) {
                return any;
            }
            any = true;
        }
    }

    /// Drops detections that fit an empty place about as well as their own; returns whether there are
    /// any.
    fn settle(&mut self, canvas: &mut ExtendedLattice, detected_px: &[DVec2], pitch_px: f64) -> bool {
        let (reach_px, disputed_px) = (NEIGHBOURS_AGREE * pitch_px, DISPUTED * pitch_px);
        self.claimants.clear();
        for (site, &m) in canvas.found.iter().enumerate().filter(|&(_, &m)| m != NONE) {
            self.claims[m as usize].site = site as u32;
        }
        for empty in (0..canvas.found.len()).filter(|&s| canvas.found[s] == NONE) {
            let Some(around) = canvas.suggested(empty) else { continue };
            let target = canvas.predicted_px[empty] + around.middle_px;
            let Some(m) = self.grid.nearest(detected_px, target, reach_px, |_| true) else { continue };
            let owner = self.claims[m].site;
            if owner == NONE {
                continue;
            }
            // Distance of the owner from the estimate of its neighbours.
            let off_px = canvas
                .suggested(owner as usize)
                .map_or(0.0, |around| around.middle_px.distance(canvas.residual_px[owner as usize]));
            if detected_px[m].distance(target) - off_px < disputed_px {
                self.claimants.push((owner, m as u32));
            }
        }
        for &(site, m) in &self.claimants {
            canvas.found[site as usize] = NONE;
            self.taken[m as usize] = false;
        }
        !self.claimants.is_empty()
    }

    /// Whether all markers of the lattice were found, and nothing else.
    fn is_complete(&self, canvas: &ExtendedLattice) -> bool {
        let markers = canvas.rows * canvas.cols;
        let found = |s: &usize| canvas.found[*s] != NONE && canvas.marker(*s).is_some();
        self.taken.len() == markers && (0..canvas.found.len()).filter(found).count() == markers
    }

    /// Repeatedly drops detections that disagree with their neighbours (false detections and merged
    /// pairs) until none does. Returns whether there were any.
    fn weed(&mut self, canvas: &mut ExtendedLattice, before: Before<'_>) -> bool {
        let suspects = &mut self.known;
        suspects.clear();
        suspects.resize(canvas.found.len(), true);
        // Below this difference no further test is needed.
        let sure_px = (LONE_MOST * canvas.least_step_px()).min(LONE * before.pitch_px);
        let mut any = false;
        loop {
            self.claimants.clear();
            for (site, &m) in canvas.found.iter().enumerate() {
                if m != NONE && suspects[site] && stands_alone(canvas, before, site, sure_px) {
                    self.claimants.push((site as u32, m));
                }
            }
            if self.claimants.is_empty() {
                return any;
            }
            any = true;
            // A dropped detection changes the estimates of places at most two away.
            suspects.fill(false);
            for &(site, m) in &self.claimants {
                self.taken[m as usize] = false;
                canvas.found[site as usize] = NONE;
                for near in near(site as usize, canvas.width(), canvas.found.len(), SUGGESTED_FROM) {
                    suspects[near] = true;
                }
            }
        }
    }
}

/// Whether a match differs from the estimate of its neighbours by more than its tolerance (never below
/// `sure_px`), or has too few of them.
fn stands_alone(canvas: &ExtendedLattice, before: Before<'_>, site: usize, sure_px: f64) -> bool {
    let pitch_px = before.pitch_px;
    let hidden = !before.is_fresh(canvas, site);
    if !hidden && canvas.is_amid(site, sure_px) {
        return false;
    }
    let differs = || {
        let nearest_px = LONE_MOST * canvas.step_px(site);
        canvas.suggested(site).is_none_or(|around| {
            let hidden = before.missed(canvas, site).map_or(HIDDEN_FRAMES, |m| m.min(HIDDEN_FRAMES));
            let most_px = if around.count < SUPPORT {
                LONE * pitch_px
            } else {
                let most_px = (LONE + LONE_HIDDEN * f64::from(hidden)) * pitch_px;
                most_px + 2.0 * around.spread_px
            };
            canvas.residual_px[site].distance(around.middle_px) > most_px.min(nearest_px)
        })
    };
    // If all estimates agree, no medians are needed.
    if !canvas.is_as_suggested(site, sure_px) && differs() {
        return true;
    }
    let bent = |between: DVec2| canvas.position_px(site).distance(between) > BENT * pitch_px;
    let beside = canvas.around(site).filter(|&s| canvas.found[s] != NONE).count();
    beside < if hidden { BESIDE_HIDDEN } else { BESIDE }
        || (hidden && canvas.between_px(site).is_some_and(bent))
}

#[cfg(test)]
mod tests;
