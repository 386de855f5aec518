//! Tracks markers of any layout: random dots, hexagonal pins, prints with gaps.

mod hypothesis;
mod neighbours;
mod pairing;
mod votes;

pub use pairing::pair_views;

use super::interpolate::{Affine, pairs};
use super::verified::Certainty;
use super::{MarkerState, Tracks, pitch_shift};
use crate::detect::Markers;
use crate::lattice::RestLattice;
use crate::math::DVec2;
use crate::math::linalg::Symmetric;
use crate::params::{Motion, TrackParams};
use alloc::vec::Vec;
use core::fmt;
use hypothesis::{Hypothesis, NONE, Scene};
use neighbours::Neighbours;
use votes::Votes;

/// Fewest markers of a rest frame: a marker is checked against at least two neighbours that agree, and an
/// affine map needs four.
pub const MIN_MARKERS: usize = 5;

/// A marker missed in more than this many consecutive certain frames is not expected.
const EXPECTED_FRAMES: u32 = 2;

/// Two displacements that differ by at most this many matched markers fit equally well: so many markers may
/// be hidden, or be false detections, by chance.
const EQUAL_MARKERS: usize = 2;

/// Without a border in view, the largest mean distance of the markers from their expected places, in
/// spacings: names fail at a half, and half of that is a margin for single jumps.
const UNANCHORED_SPACINGS: f64 = 0.25;

/// The rest frame has too few markers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooFewMarkers {
    /// Number of markers found.
    pub found: usize,
}

impl fmt::Display for TooFewMarkers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the first image shows {} markers, and at least {MIN_MARKERS} are needed to tell them apart; \
             give an image of the whole print at rest, or check detect.polarity, detect.dot_px and \
             detect.roi",
            self.found
        )
    }
}

impl core::error::Error for TooFewMarkers {}

/// Tracks the markers of one view, in any layout. The first frame is the rest frame, and its markers keep
/// their order.
///
/// Each frame is matched to the prediction (`track.motion`), with `track.gate_pitches` in units of the
/// spacing: the median distance of a marker from its nearest neighbour at rest. Matches that move unlike
/// their neighbours are dropped, and rematched from those that agree. If markers remain unmatched, common
/// displacements of up to three spacings are tried too, and the one that explains more markers is taken. If
/// two explain about as many, or none explains half of them, all markers are held.
///
/// A regular print that reaches beyond the view looks the same after a step of a whole pitch. Such steps
/// between two frames must be excluded by the frame rate.
#[derive(Clone, Debug)]
pub struct ScatteredTracker {
    params: TrackParams,
    size_px: (usize, usize),
    spacing_px: f64,
    /// Whether no more markers of the print come into view around those tracked.
    has_border: bool,
    rest_px: Vec<DVec2>,
    neighbours: Neighbours,
    expected_px: Vec<DVec2>,
    votes: Votes,
    best: Hypothesis,
    other: Hypothesis,
    /// Markers whose positions are known in the present frame.
    known: Vec<bool>,
    round: Vec<u32>,
}

impl ScatteredTracker {
    /// For images of `size_px` (width, height). Not yet initialised: [`Self::run`] leaves `out` unchanged
    /// until [`Self::initialise`] was called.
    #[must_use]
    pub fn new(params: &TrackParams, size_px: (usize, usize)) -> Self {
        Self {
            params: params.clone(),
            size_px,
            spacing_px: 0.0,
            has_border: true,
            rest_px: Vec::new(),
            neighbours: Neighbours::default(),
            expected_px: Vec::new(),
            votes: Votes::default(),
            best: Hypothesis::default(),
            other: Hypothesis::default(),
            known: Vec::new(),
            round: Vec::new(),
        }
    }

    /// Starts from the detections of a rest frame, and reserves memory for later frames with up to
    /// `most_detections`.
    ///
    /// # Errors
    /// [`TooFewMarkers`]; tracker and `out` are then unchanged.
    pub fn initialise(
        &mut self,
        rest: &Markers,
        most_detections: usize,
        out: &mut Tracks,
    ) -> Result<(), TooFewMarkers> {
        let count = rest.centres_px.len();
        if count < MIN_MARKERS {
            return Err(TooFewMarkers { found: count });
        }
        self.lay(&rest.centres_px, most_detections);
        self.has_border = true;
        out.covariance_px2.clone_from(&rest.covariance_px2);
        out.start(&self.rest_px, core::iter::repeat_n(false, count));
        Ok(())
    }

    /// As [`Self::initialise`], from a labelled rest frame of at least 3 x 3 markers and its detections.
    /// Markers that were filled in are held until they are seen. If rows or columns were left out, a step by
    /// a whole pitch looks like no step. No marker may then move by half a pitch between two frames.
    pub fn initialise_labelled(
        &mut self,
        rest: &RestLattice,
        detected: &Markers,
        most_detections: usize,
        out: &mut Tracks,
    ) {
        self.lay(&rest.positions_px, most_detections);
        self.has_border = rest.left_out == [0; 4];
        out.initialise(rest, detected, self.params.gate_pitches * rest.pitch_px);
        // Those that were not seen are not expected either.
        for missed in out.missed_frames.iter_mut().filter(|missed| **missed > 0) {
            *missed = EXPECTED_FRAMES + 1;
        }
    }

    /// Rest positions, pixels, in the order of the tracks.
    #[must_use]
    pub fn rest_px(&self) -> &[DVec2] {
        &self.rest_px
    }

    /// Median distance of a marker from its nearest neighbour at rest, pixels.
    #[must_use]
    pub const fn spacing_px(&self) -> f64 {
        self.spacing_px
    }

    /// Takes rest positions, and reserves memory.
    fn lay(&mut self, rest_px: &[DVec2], most_detections: usize) {
        let count = rest_px.len();
        self.rest_px.clear();
        self.rest_px.extend_from_slice(rest_px);
        self.neighbours = Neighbours::new(&self.rest_px);
        self.spacing_px = self.neighbours.spacing_px();
        self.expected_px.clone_from(&self.rest_px);
        for hypothesis in [&mut self.best, &mut self.other] {
            hypothesis.reserve(count, most_detections, self.size_px, self.spacing_px);
        }
        self.votes.reserve();
        self.known.reserve(count);
        self.round.reserve(count);
    }

    /// Updates the tracks by the detections of the next frame. `out` holds the tracks of the previous frame.
    pub fn run(&mut self, detected: &Markers, out: &mut Tracks) -> Certainty {
        if self.rest_px.is_empty() || out.positions_px.len() != self.rest_px.len() {
            return Certainty::Uncertain;
        }
        let _ = self.predict(out);
        let is_found = self.identify(&detected.centres_px, out)
            // Gel released during uncertain frames looks as at rest.
            || out.stale && {
                self.expected_px.clone_from(&self.rest_px);
                self.identify(&detected.centres_px, out)
            };
        if is_found {
            self.take(detected, out);
            return Certainty::Certain;
        }
        self.hold(out);
        Certainty::Uncertain
    }

    /// Holds all markers in place, as in a frame in which nothing is certain.
    pub fn hold(&self, out: &mut Tracks) {
        for n in 0..self.rest_px.len() {
            out.update_state(n, false, self.params.max_held_frames);
        }
        out.previous_px.clone_from(&out.positions_px);
        (out.steady, out.stale) = (false, true);
    }

    /// Predicted marker positions in the next frame, for a search around predictions.
    #[must_use]
    pub fn predict(&mut self, tracks: &Tracks) -> &[DVec2] {
        let is_moving = self.params.motion == Motion::ConstantVelocity && tracks.steady;
        let steps = tracks.positions_px.iter().zip(&tracks.previous_px);
        self.expected_px.clear();
        self.expected_px
            .extend(steps.map(|(&now, &before)| if is_moving { now + (now - before) } else { now }));
        &self.expected_px
    }

    /// Matches the detections to the expected positions, with the matches in `best`; returns whether they
    /// are certain.
    fn identify(&mut self, detected_px: &[DVec2], tracks: &Tracks) -> bool {
        let Self { best, other, votes, spacing_px, .. } = self;
        let scene = Scene {
            detected_px,
            expected_px: &self.expected_px,
            neighbours: &self.neighbours,
            spacing_px: *spacing_px,
            gate_px: self.params.gate_pitches * *spacing_px,
        };
        let expected = tracks.missed_frames.iter().filter(|&&missed| missed <= EXPECTED_FRAMES).count();
        best.run(&scene, DVec2::ZERO);
        let is_enough = |count: usize| {
            count >= MIN_MARKERS - 1 && 2 * count >= expected && 2 * count >= detected_px.len()
        };
        // Unmatched markers and detections may be explained by a common displacement.
        if best.count() + EQUAL_MARKERS >= expected.min(detected_px.len()) && is_enough(best.count()) {
            return true;
        }
        if !self.has_border {
            let max_px = UNANCHORED_SPACINGS * *spacing_px;
            return is_enough(best.count()) && best.mean_residual_px().is_some_and(|px| px <= max_px);
        }
        votes.count(&scene, best.grid());
        let mut is_unique = true;
        for n in 0..votes::PEAKS {
            let Some(shift_px) = votes.peak_px(n) else { break };
            // The displacement of the first hypothesis.
            if shift_px.length() < 0.5 * *spacing_px {
                continue;
            }
            other.run(&scene, shift_px);
            if other.count() > best.count() + EQUAL_MARKERS {
                core::mem::swap(best, other);
                is_unique = true;
            } else if other.count() + EQUAL_MARKERS >= best.count() && !other.is_like(best) {
                is_unique = false;
            }
        }
        is_unique && is_enough(best.count())
    }

    fn take(&mut self, detected: &Markers, out: &mut Tracks) {
        let in_view = pitch_shift::in_view(self.size_px, self.spacing_px);
        core::mem::swap(&mut out.previous_px, &mut out.positions_px);
        for (n, &m) in self.best.detection().iter().enumerate() {
            let is_seen = m != NONE;
            if is_seen {
                out.positions_px[n] = detected.centres_px[m as usize];
                out.covariance_px2[n] = detected.covariance_px2[m as usize];
            }
            let missed = &mut out.missed_frames[n];
            // Outside the view it does not count as missed, and is expected once it is back.
            *missed = match (is_seen, in_view(out.previous_px[n])) {
                (true, _) => 0,
                (false, false) => (*missed).max(1),
                (false, true) => missed.saturating_add(1),
            };
            out.update_state(n, is_seen, self.params.max_held_frames);
        }
        (out.steady, out.stale) = (true, false);
        self.interpolate(out);
    }

    /// Moves each unseen marker by the affine map from the rest positions of its known neighbours to their
    /// present ones, starting beside the seen ones. Its covariance follows from the errors of the same rule
    /// at these neighbours, each left out in turn.
    fn interpolate(&mut self, out: &mut Tracks) {
        let Self { neighbours, rest_px, known, round, .. } = self;
        known.clear();
        known.extend(out.state.iter().map(|&state| state == MarkerState::Seen));
        if !known.contains(&false) {
            return;
        }
        let whole = Affine::fit(pairs(rest_px, &out.positions_px, (0..rest_px.len()).filter(|&n| known[n])));
        let turn = whole.columns().unwrap_or([DVec2::X, DVec2::Y]);
        let from_neighbours = |n: usize, but: usize, known: &[bool], positions_px: &[DVec2]| {
            let around = neighbours.of(n).filter(|&m| known[m] && m != but);
            let local = Affine::fit(pairs(rest_px, positions_px, around));
            local.apply(local.columns().unwrap_or(turn), rest_px[n])
        };
        // Where no neighbour leads to a seen marker, nothing better is known than the map of all markers.
        let unknown = self.params.gate_pitches * self.spacing_px;
        let unknown_px2 = [[unknown * unknown, 0.0], [0.0, unknown * unknown]];
        for n in (0..rest_px.len()).filter(|&n| !known[n]) {
            (out.positions_px[n], out.covariance_px2[n]) = (whole.apply(turn, rest_px[n]), unknown_px2);
        }
        loop {
            round.clear();
            round.extend(
                (0..rest_px.len())
                    .filter(|&n| !known[n] && neighbours.of(n).any(|m| known[m]))
                    .map(|n| n as u32),
            );
            if round.is_empty() {
                return;
            }
            for &n in round.iter() {
                let n = n as usize;
                let mut squares = Squares::default();
                for m in neighbours.of(n).filter(|&m| known[m]) {
                    if neighbours.of(m).any(|other| known[other] && other != n) {
                        let error_px = out.positions_px[m] - from_neighbours(m, n, known, &out.positions_px);
                        squares.add(error_px, out.covariance_px2[m]);
                    }
                }
                out.positions_px[n] = from_neighbours(n, n, known, &out.positions_px);
                out.covariance_px2[n] = squares.covariance(unknown_px2);
            }
            round.iter().for_each(|&n| known[n as usize] = true);
        }
    }
}

/// Squared errors of interpolated markers against their measured positions.
#[derive(Clone, Copy, Debug, Default)]
struct Squares {
    errors_px2: f64,
    measured_px2: f64,
    count: f64,
}

impl Squares {
    fn add(&mut self, error_px: DVec2, measured_px2: Symmetric<2>) {
        self.errors_px2 += error_px.length_squared();
        self.measured_px2 += measured_px2[0][0] + measured_px2[1][1];
        self.count += 1.0;
    }

    /// Covariance of an interpolated marker: the mean square per axis without the variance of the measured
    /// positions, and at least the variance of the neighbours' mean. A few errors do not determine a
    /// direction.
    fn covariance(&self, otherwise: Symmetric<2>) -> Symmetric<2> {
        if self.count == 0.0 {
            return otherwise;
        }
        let least_px2 = self.measured_px2 / self.count;
        let variance = (self.errors_px2 - self.measured_px2).max(least_px2) / (2.0 * self.count);
        [[variance, 0.0], [0.0, variance]]
    }
}
