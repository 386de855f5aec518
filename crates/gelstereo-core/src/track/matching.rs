//! Which detection belongs to which place of the lattice, up to a shift by whole pitches.

use super::extended_lattice::{ExtendedLattice, NONE, SUGGESTED_FROM};
use super::near;
use super::window_detections::WindowDetections;
use crate::math::DVec2;
use crate::spatial::Grid;
use alloc::vec::Vec;

/// Residuals of neighbours that belong together differ by less, in pitches: a slip makes them differ by one pitch less the
/// true difference.
const NEIGHBOURS_AGREE: f64 = 0.35;

/// Neighbours whose residuals differ by more, in pitches, have slipped against each other: where the prediction is fresh,
/// and where it is of a frame some time ago.
const SLIPPED: f64 = 0.5;
const SLIPPED_STALE: f64 = 0.3;

/// A marker farther from the middle of its neighbours, in pitches, is not between them: a slip leaves half a pitch.
const BENT: f64 = 1.0 / 3.0;

/// Where all residuals lie so close to their mean, in pitches, every two agree.
const ALL_AGREE: f64 = 0.5 * NEIGHBOURS_AGREE;

/// Without neighbours in between, residuals agree up to this share of the distance to the nearest neighbour, which is less than a
/// pitch where the gel is squeezed: beyond a half it would be the neighbour.
const ALONE_AGREE: f64 = 0.35;

/// A detection that two places want about equally, in pitches, is two markers in one, and nobody's.
const DISPUTED: f64 = 0.25;

/// Where a lattice has moved by any part of a pitch, some marker is at most this far from every place, in pitches: half a
/// diagonal and a little.
const HALF_DIAGONAL: f64 = 0.75;

/// A marker may differ from what its neighbours suggest by so many pitches, and by twice as much as they differ among
/// themselves; by a little more for each frame that it was hidden, up to a limit.
const LONE: f64 = 0.12;
const LONE_HIDDEN: f64 = 0.02;
const HIDDEN_FRAMES: u32 = 4;
/// But never by more than so much of the distance to its nearest neighbour, which is less than a pitch where the gel is squeezed.
const LONE_MOST: f64 = 0.25;

/// A marker needs so many matched neighbours; one that was hidden, more.
const BESIDE: usize = 2;
const BESIDE_HIDDEN: usize = 3;

/// With fewer suggestions than this a marker is given no more room.
const SUPPORT: usize = 5;

/// What is known of the frames before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Before<'a> {
    /// How many certain frames in succession did not show each marker.
    pub missed_frames: &'a [u32],
    /// Positions are of some time ago.
    pub stale: bool,
    pub pitch_px: f64,
}

impl Before<'_> {
    fn missed(&self, canvas: &ExtendedLattice, site: usize) -> Option<u32> {
        canvas.marker(site).map(|n| self.missed_frames[n])
    }

    /// Whether the marker of a place was seen in the last certain frame.
    fn is_fresh(&self, canvas: &ExtendedLattice, site: usize) -> bool {
        self.missed(canvas, site) == Some(0)
    }
}

/// The places that want a detection.
#[derive(Clone, Copy, Debug)]
struct Claim {
    site: u32,
    nearest_px2: f64,
    second_px2: f64,
}

const UNCLAIMED: Claim = Claim { site: NONE, nearest_px2: f64::INFINITY, second_px2: f64::INFINITY };

/// Matches detections to the places of a canvas.
///
/// Nearest neighbours alone go wrong where the gel has moved by half a pitch or more. But two neighbours that are both
/// right have moved alike: matches whose residuals disagree with their neighbours' are slips, and the largest set of
/// places in agreement, grown from place to place, is labelled right up to one shift for all of it.
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
    /// Makes room for so many places and detections, spread over so many pixels.
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

    /// Takes the detections of a frame.
    pub fn load(&mut self, detected_px: &[DVec2], pitch_px: f64) {
        self.grid.build(detected_px, pitch_px);
    }

    /// Matches the loaded detections. Matches start closer than `gate_px` or, without one, from any that make a lattice.
    /// Returns whether all neighbours agree in the end.
    pub fn run(
        &mut self,
        canvas: &mut ExtendedLattice,
        detected_px: &[DVec2],
        before: Before<'_>,
        (gate_px, sights): (Option<f64>, WindowDetections<'_>),
    ) -> bool {
        let disputed_px = DISPUTED * before.pitch_px;
        self.start(detected_px.len());
        self.targets.clear();
        self.targets.extend(canvas.predicted_px.iter().enumerate().map(|(s, &p)| (s as u32, p)));
        match gate_px {
            Some(gate_px) => self.claim(canvas, detected_px, (gate_px, disputed_px), sights),
            None => self.claim(canvas, detected_px, (HALF_DIAGONAL * before.pitch_px, 0.0), sights),
        };
        if agree_all(canvas, before) {
            // What lies beyond the gate when all have moved nearly as far.
            if self.taken.contains(&false) {
                self.grow(canvas, detected_px, before.pitch_px);
                self.weed(canvas, before);
            }
            return true;
        }
        self.agree(canvas, detected_px, before)
    }

    /// Checks a labelling of the loaded detections that was made without the prediction, as [`Self::run`] checks its matches.
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

    /// Keeps what agrees with its neighbours and grows it; whether all do in the end.
    fn agree(&mut self, canvas: &mut ExtendedLattice, detected_px: &[DVec2], before: Before<'_>) -> bool {
        let pitch_px = before.pitch_px;
        self.keep_largest(canvas, pitch_px, |_, _| false);
        let mut changed = self.grow(canvas, detected_px, pitch_px);
        // Islands beyond a gap are joined while all has moved alike; those that were hidden until now could have moved unseen.
        if let Some(mean) = moved_alike(canvas, pitch_px) {
            self.targets.clear();
            for site in (0..canvas.found.len()).filter(|&s| canvas.found[s] == NONE) {
                if before.is_fresh(canvas, site) {
                    self.targets.push((site as u32, canvas.predicted_px[site] + mean));
                }
            }
            let reach_px = (NEIGHBOURS_AGREE * pitch_px, DISPUTED * pitch_px);
            if self.claim(canvas, detected_px, reach_px, WindowDetections::default()) {
                self.grow(canvas, detected_px, pitch_px);
                changed = true;
            }
        }
        changed |= self.settle(canvas, detected_px, pitch_px);
        // With a place for every detection and a detection for every place, no speck and no merged pair is among them.
        changed |= !self.is_complete(canvas) && self.weed(canvas, before);
        // What weeding cut off may have slipped as a whole.
        if changed {
            let alike = moved_alike(canvas, pitch_px).is_some();
            self.keep_largest(canvas, pitch_px, |canvas, site| alike && before.is_fresh(canvas, site));
        }
        canvas.spread(&mut self.known, &mut self.targets);
        !torn(canvas, before)
    }

    /// Gives every target the free detection nearest to it and closer than the gate, if no other wants it about as
    /// much; whether any was given.
    fn claim(
        &mut self,
        canvas: &mut ExtendedLattice,
        detected_px: &[DVec2],
        (gate_px, disputed_px): (f64, f64),
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
            // The root of the smaller one is spared where there is no second.
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

    /// Drops all but the largest set of neighbours in agreement; of other sets some places may be spared.
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

    /// Matches places beside matched ones, predicted by their residuals, until nothing new is found; whether anything was.
    fn grow(&mut self, canvas: &mut ExtendedLattice, detected_px: &[DVec2], pitch_px: f64) -> bool {
        let (mut any, reach_px) = (false, (NEIGHBOURS_AGREE * pitch_px, DISPUTED * pitch_px));
        loop {
            self.targets.clear();
            for site in (0..canvas.found.len()).filter(|&s| canvas.found[s] == NONE) {
                if let Some(around) = canvas.suggested(site) {
                    self.targets.push((site as u32, canvas.predicted_px[site] + around.middle_px));
                }
            }
            if !self.claim(canvas, detected_px, reach_px, WindowDetections::default()) {
                return any;
            }
            any = true;
        }
    }

    /// Drops detections that an empty place wants about as much as the one that has it; whether there are any.
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
            // How far the owner is from where its neighbours say.
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

    /// Drops detections that stand alone against their neighbours: specks, and merged pairs; until none does. Whether there
    /// were any.
    fn weed(&mut self, canvas: &mut ExtendedLattice, before: Before<'_>) -> bool {
        let suspects = &mut self.known;
        suspects.clear();
        suspects.resize(canvas.found.len(), true);
        // Closer than that nobody is asked how far it may be off.
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
            // What is dropped is missed by those who look at it, at most two places away.
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

/// Whether every match but the first agrees with its left or upper neighbour: then all hang together. Most frames are like
/// that; of others it says nothing.
fn in_one_piece(canvas: &ExtendedLattice, agree_px2: f64) -> bool {
    let (width, found) = (canvas.width(), &canvas.found);
    let mut matched = (0..found.len()).filter(|&s| found[s] != NONE);
    let _first = matched.next();
    matched.all(|site| {
        let agrees = |other: usize| {
            found[other] != NONE
                && canvas.residual_px[other].distance_squared(canvas.residual_px[site]) < agree_px2
        };
        (!site.is_multiple_of(width) && agrees(site - 1)) || site.checked_sub(width).is_some_and(agrees)
    })
}

/// Whether a match differs from what its neighbours suggest, by more than is sure to be little, or has too few of them.
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
    // What all suggest alike needs no medians.
    if !canvas.is_as_suggested(site, sure_px) && differs() {
        return true;
    }
    let bent = |between: DVec2| canvas.position_px(site).distance(between) > BENT * pitch_px;
    let beside = canvas.around(site).filter(|&s| canvas.found[s] != NONE).count();
    beside < if hidden { BESIDE_HIDDEN } else { BESIDE }
        || (hidden && canvas.between_px(site).is_some_and(bent))
}

/// Whether two neighbours have slipped against each other: their motions differ too much, or a marker does not stand between
/// its neighbours. Where all three were seen in the frame before, it may, if it has moved as they have: gel that is
/// twisted bends as far at the rim of the contact.
fn torn(canvas: &ExtendedLattice, before: Before<'_>) -> bool {
    let most_slip = if before.stale { SLIPPED_STALE } else { SLIPPED };
    let (slip, bent) = (most_slip * before.pitch_px, BENT * before.pitch_px);
    let (width, height) = (canvas.width(), canvas.height());
    let found = |site: usize| canvas.found[site] != NONE;
    let tears = |row: usize, col: usize| {
        let site = row * width + col;
        let between = |one: usize, other: usize| {
            let off2 = |[a, b, c]: [DVec2; 3]| ((a + c) * 0.5).distance_squared(b);
            let line = [one, site, other];
            found(one)
                && found(other)
                && off2(line.map(|s| canvas.position_px(s))) > bent * bent
                && !(line.iter().all(|&s| before.is_fresh(canvas, s))
                    && off2(line.map(|s| canvas.residual_px[s])) < bent * bent)
        };
        let slipped = |other: usize| {
            let apart = canvas.residual_px[site] - canvas.residual_px[other];
            found(other) && apart.length_squared() > slip * slip
        };
        let (inner, below) = (col > 0 && col + 1 < width, row + 1 < height);
        // Each two neighbours once.
        found(site)
            && ((inner && between(site - 1, site + 1))
                || (row > 0 && below && between(site - width, site + width))
                || (col + 1 < width && slipped(site + 1))
                || (below && slipped(site + width))
                || (below && col > 0 && slipped(site + width - 1))
                || (below && col + 1 < width && slipped(site + width + 1)))
    };
    (0..height).any(|row| (0..width).any(|col| tears(row, col)))
}

/// Mean residual of all matches if all lie closer to it than `most_px`.
fn common_residual(canvas: &ExtendedLattice, most_px: f64) -> Option<DVec2> {
    let matched =
        || canvas.found.iter().zip(&canvas.residual_px).filter(|&(&m, _)| m != NONE).map(|(_, &r)| r);
    let (sum, count) = matched().fold((DVec2::ZERO, 0.0), |(sum, count), r| (sum + r, count + 1.0));
    let mean = sum / count;
    (count > 0.0 && matched().all(|r| r.distance_squared(mean) < most_px * most_px)).then_some(mean)
}

/// Mean residual of all matches if each lies so close to it that its neighbours in line are farther off: then none slipped, not
/// even those that no neighbour ties to the others.
fn moved_alike(canvas: &ExtendedLattice, pitch_px: f64) -> Option<DVec2> {
    let mean = common_residual(canvas, NEIGHBOURS_AGREE * pitch_px)?;
    let near = |s: usize| canvas.residual_px[s].distance(mean) < ALONE_AGREE * canvas.step_px(s);
    (0..canvas.found.len()).filter(|&s| canvas.found[s] != NONE).all(near).then_some(mean)
}

/// Whether all matches agree with each other, and those that reappear stand beside one that was seen before; then what was
/// not found is given the mean residual.
fn agree_all(canvas: &mut ExtendedLattice, before: Before<'_>) -> bool {
    let Some(mean) = common_residual(canvas, ALL_AGREE * before.pitch_px) else { return false };
    let fresh_match = |s: usize| canvas.found[s] != NONE && before.is_fresh(canvas, s);
    let joined = |s: usize| before.is_fresh(canvas, s) || canvas.around(s).any(fresh_match);
    let agree = (0..canvas.found.len()).filter(|&s| canvas.found[s] != NONE).all(joined);
    if agree {
        for (residual, &m) in canvas.residual_px.iter_mut().zip(&canvas.found) {
            if m == NONE {
                *residual = mean;
            }
        }
    }
    agree
}
