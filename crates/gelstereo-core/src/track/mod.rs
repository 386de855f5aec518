//! Tracks markers from frame to frame (Eq. 1 and 2).

mod agreement;
mod extended_lattice;
mod interpolate;
mod matching;
mod pitch_shift;
mod relabel;
mod scattered;
mod verified;
mod window_detections;

pub use scattered::{MIN_MARKERS, ScatteredTracker, TooFewMarkers, pair_views};
pub use verified::{Certainty, VerifiedTracker};

use crate::detect::Markers;
use crate::lattice::RestLattice;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, sqrt};
use crate::params::TrackParams;
use crate::spatial::Grid;
use alloc::vec::Vec;
use core::f64::consts::FRAC_1_PI;

/// State of a marker in the present frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum MarkerState {
    /// Measured in this frame.
    Seen = 0,
    /// Not measured. Its position is interpolated from its neighbours, starting at the last measured
    /// position or, if it was never printed, at the filled-in one.
    Held = 1,
    /// Not measured for longer than `track.max_held_frames`; its position is still interpolated.
    Lost = 2,
}

/// Position and state of every marker, in the order of the lattice: row by row, `row * cols + col`.
///
/// This is the complete tracking state between frames: a copy is a checkpoint, and `clone_from` makes one
/// without allocating.
#[derive(Debug, Default, PartialEq)]
pub struct Tracks {
    /// Positions, pixels.
    pub positions_px: Vec<DVec2>,
    /// Covariances of the positions when they were last measured, px².
    pub covariance_px2: Vec<Symmetric<2>>,
    /// States.
    pub state: Vec<MarkerState>,
    /// Frames since the marker was measured, or `NEVER_SEEN`.
    unseen_frames: Vec<u32>,
    /// Displacement since the rest frame, minus the mean one of its neighbours, when the marker was last
    /// measured.
    own_px: Vec<DVec2>,
    /// Positions in the previous frame, if `steady`.
    previous_px: Vec<DVec2>,
    /// Consecutive frames that were matched with certainty but did not show the marker.
    missed_frames: Vec<u32>,
    /// Whether the last two frames were matched with certainty.
    steady: bool,
    /// Whether the last frame was not matched with certainty, so that positions are from an earlier one.
    stale: bool,
}

/// Probability that a random detection counts as near. At least half of the pairs plus two standard
/// deviations of that half must be near. By chance this happens in fewer than 1 of 100 frames of 4
/// markers, and never with 625.
const CHANCE: f64 = 0.25;

/// A marker that was filled in at rest is held until it is seen.
const NEVER_SEEN: u32 = u32::MAX;

impl Clone for Tracks {
    fn clone(&self) -> Self {
        let mut copy = Self::default();
        copy.clone_from(self);
        copy
    }

    fn clone_from(&mut self, source: &Self) {
        self.positions_px.clone_from(&source.positions_px);
        self.covariance_px2.clone_from(&source.covariance_px2);
        self.state.clone_from(&source.state);
        self.unseen_frames.clone_from(&source.unseen_frames);
        self.own_px.clone_from(&source.own_px);
        self.previous_px.clone_from(&source.previous_px);
        self.missed_frames.clone_from(&source.missed_frames);
        (self.steady, self.stale) = (source.steady, source.stale);
    }
}

impl Tracks {
    /// Starts from a labelled rest frame and its detections; a filled-in position has a standard
    /// deviation of `unknown_px`.
    fn initialise(&mut self, rest: &RestLattice, detected: &Markers, unknown_px: f64) {
        let unknown = [[unknown_px * unknown_px, 0.0], [0.0, unknown_px * unknown_px]];
        self.covariance_px2.clear();
        self.covariance_px2.extend(
            rest.detection.iter().map(|d| d.map_or(unknown, |m| detected.covariance_px2[m as usize])),
        );
        self.start(&rest.positions_px, rest.detection.iter().map(Option::is_none));
    }

    /// Starts at rest positions, of which some may be filled in; covariances are already set.
    fn start(&mut self, rest_px: &[DVec2], held: impl Iterator<Item = bool> + Clone) {
        self.positions_px.clear();
        self.positions_px.extend_from_slice(rest_px);
        self.state.clear();
        self.state.extend(held.clone().map(|held| if held { MarkerState::Held } else { MarkerState::Seen }));
        self.unseen_frames.clear();
        self.unseen_frames.extend(held.clone().map(|held| if held { NEVER_SEEN } else { 0 }));
        self.own_px.clear();
        self.own_px.resize(rest_px.len(), DVec2::ZERO);
        self.previous_px.clone_from(&self.positions_px);
        self.missed_frames.clear();
        self.missed_frames.extend(held.map(u32::from));
        (self.steady, self.stale) = (false, false);
    }

    /// Reserves memory for as many markers as `other` has.
    pub(crate) fn reserve_like(&mut self, other: &Self) {
        let count = other.positions_px.len();
        for list in [&mut self.positions_px, &mut self.own_px, &mut self.previous_px] {
            list.clear();
            list.reserve(count);
        }
        self.covariance_px2.clear();
        self.covariance_px2.reserve(count);
        self.state.clear();
        self.state.reserve(count);
        for list in [&mut self.unseen_frames, &mut self.missed_frames] {
            list.clear();
            list.reserve(count);
        }
    }

    /// Whether the positions are from the last frame; always true with [`Tracker`].
    #[must_use]
    pub const fn is_current(&self) -> bool {
        !self.stale
    }

    /// Sets all markers to the detections in this order (Eq. 1); returns how many positions changed.
    pub(crate) fn update(&mut self, detected: &Markers, order: &[usize]) -> usize {
        let mut elsewhere = 0;
        for (n, &m) in order.iter().enumerate() {
            elsewhere += usize::from(self.positions_px[n] != detected.centres_px[m]);
            (self.positions_px[n], self.covariance_px2[n]) =
                (detected.centres_px[m], detected.covariance_px2[m]);
            self.update_state(n, true, 0);
        }
        elsewhere
    }

    /// Updates the count of unseen frames of a marker and its state.
    fn update_state(&mut self, n: usize, seen: bool, max_held_frames: u32) {
        let unseen = &mut self.unseen_frames[n];
        *unseen = match (seen, *unseen) {
            (true, _) => 0,
            (false, NEVER_SEEN) => NEVER_SEEN,
            (false, frames) => (frames + 1).min(NEVER_SEEN - 1),
        };
        self.state[n] = match *unseen {
            0 => MarkerState::Seen,
            NEVER_SEEN => MarkerState::Held,
            frames if frames <= max_held_frames => MarkerState::Held,
            _ => MarkerState::Lost,
        };
    }
}

/// Tracks the markers of one view.
///
/// Eq. 2 gives a marker the detection nearest to its last position, if closer than the gate d. There are
/// two additions. The pair must be mutually nearest, so that two markers never share a detection. Where
/// the paper freezes an undetected marker, its position moves with its detected lattice neighbours, and a
/// detection within the gate of that position is accepted. Eq. 1's direct update when all N are found
/// needs the same correspondence, as detections are unordered; the sort provides it.
///
/// Eq. 2 also pairs noise with markers. If the pairs move with their neighbours no more often than by
/// chance, all markers are held.
///
/// A motion of the whole lattice by more than the gate is indistinguishable from one that is a pitch
/// shorter, so the frame rate must be high enough to exclude it.
#[derive(Clone, Debug)]
pub struct Tracker {
    params: TrackParams,
    gate_px: f64,
    cols: usize,
    rest_px: Vec<DVec2>,
    tracks_grid: Grid,
    detections_grid: Grid,
    /// Detection of each marker in this frame.
    detection_of: Vec<Option<u32>>,
    taken: Vec<bool>,
    pairs: Vec<(u32, u32)>,
    previous_px: Vec<DVec2>,
}

impl Tracker {
    /// Not yet initialised: [`Self::run`] leaves `out` unchanged until [`Self::initialise`] was called.
    #[must_use]
    pub fn new(params: &TrackParams) -> Self {
        Self {
            params: params.clone(),
            gate_px: 0.0,
            cols: 1,
            rest_px: Vec::new(),
            tracks_grid: Grid::default(),
            detections_grid: Grid::default(),
            detection_of: Vec::new(),
            taken: Vec::new(),
            pairs: Vec::new(),
            previous_px: Vec::new(),
        }
    }

    /// Starts from a labelled rest frame and its detections. Detected markers are seen; filled-in ones
    /// are held, moving with their lattice neighbours, until they are seen.
    pub fn initialise(&mut self, rest: &RestLattice, detected: &Markers, out: &mut Tracks) {
        self.gate_px = self.params.gate_pitches * rest.pitch_px;
        self.cols = rest.cols.max(1);
        self.rest_px.clone_from(&rest.positions_px);
        // The gate is the smallest plausible standard deviation of a filled-in position.
        out.initialise(rest, detected, self.gate_px);
    }

    /// Reserves memory for any later frame of `size_px` (width, height) with up to `most_detections`.
    /// After the first [`Self::run`] nothing is allocated.
    pub fn reserve(&mut self, size_px: (usize, usize), most_detections: usize) {
        self.taken.clear();
        self.taken.reserve(most_detections);
        self.pairs.clear();
        self.pairs.reserve(self.rest_px.len());
        self.tracks_grid.reserve(self.rest_px.len(), size_px, self.gate_px);
        self.detections_grid.reserve(most_detections, size_px, self.gate_px);
    }

    /// Updates the tracks by the detections of the next frame (Eq. 2): gate, mutual nearest, states.
    ///
    /// `out` holds the tracks of the previous frame.
    pub fn run(&mut self, detected: &Markers, out: &mut Tracks) {
        let detected_px = detected.centres_px.as_slice();
        if out.positions_px.len() != self.rest_px.len() {
            return;
        }
        self.previous_px.clone_from(&out.positions_px);
        self.detection_of.clear();
        self.detection_of.resize(self.rest_px.len(), None);
        self.taken.clear();
        self.taken.resize(detected_px.len(), false);
        self.detections_grid.build(detected_px, self.gate_px);
        // Unmatched markers are retried at positions interpolated from their neighbours until nothing new
        // is found. Each round but the last matches a marker, so the loop ends.
        while self.pair(detected_px, out) {
            self.interpolator(out);
        }
        if !self.moves_as_one(detected_px.len(), &out.positions_px) {
            self.detection_of.fill(None);
            out.positions_px.clone_from(&self.previous_px);
        }
        for (covariance, detection) in out.covariance_px2.iter_mut().zip(&self.detection_of) {
            if let Some(m) = detection {
                *covariance = detected.covariance_px2[*m as usize];
            }
        }
        for (n, detection) in self.detection_of.iter().enumerate() {
            out.update_state(n, detection.is_some(), self.params.max_held_frames);
        }
    }

    /// Pairs free markers and free detections that are mutually nearest and closer than the gate; returns
    /// whether there were any.
    fn pair(&mut self, detected_px: &[DVec2], out: &mut Tracks) -> bool {
        let Self { tracks_grid, detections_grid, detection_of, taken, pairs, gate_px, .. } = self;
        tracks_grid.build(&out.positions_px, *gate_px);
        pairs.clear();
        for (n, &position) in out.positions_px.iter().enumerate().filter(|&(n, _)| detection_of[n].is_none())
        {
            let nearest = detections_grid.nearest(detected_px, position, *gate_px, |m| !taken[m]);
            let back = nearest.and_then(|m| {
                tracks_grid
                    .nearest(&out.positions_px, detected_px[m], *gate_px, |n| detection_of[n].is_none())
            });
            if let (Some(m), true) = (nearest, back == Some(n)) {
                pairs.push((n as u32, m as u32));
            }
        }
        for &(n, m) in pairs.iter() {
            detection_of[n as usize] = Some(m);
            taken[m as usize] = true;
            out.positions_px[n as usize] = detected_px[m as usize];
        }
        !pairs.is_empty()
    }

    /// Whether enough paired markers move with their lattice neighbours to exclude chance pairs from a
    /// frame without the lattice.
    fn moves_as_one(&self, detections: usize, positions_px: &[DVec2]) -> bool {
        let pitch_px = self.gate_px / self.params.gate_pitches;
        // Detections of a lattice are as dense as its markers; noise may be denser.
        let lattice = self.rest_px.len() as f64;
        let area_px2 = pitch_px * pitch_px * lattice / (detections as f64).max(lattice);
        let near_px2 = CHANCE * area_px2 * FRAC_1_PI;
        let moved_px = |n: usize| positions_px[n] - self.previous_px[n];
        let (mut pairs, mut near_pairs) = (0.0, 0.0);
        for n in (0..self.rest_px.len()).filter(|&n| self.detection_of[n].is_some()) {
            let (mut sum_px, mut count) = (DVec2::ZERO, 0.0);
            for m in near(n, self.cols, self.rest_px.len(), 1) {
                if m != n && self.detection_of[m].is_some() {
                    sum_px += moved_px(m);
                    count += 1.0;
                }
            }
            pairs += 1.0;
            if count > 0.0 && (moved_px(n) - sum_px / count).length_squared() <= near_px2 {
                near_pairs += 1.0;
            }
        }
        near_pairs >= 0.5 * pairs + sqrt(pairs)
    }

    /// Moves the markers without a detection by the mean displacement of their neighbours with one.
    ///
    /// Displacements are measured from the rest frame: accumulated steps would let errors grow without
    /// bound.
    fn interpolator(&self, out: &mut Tracks) {
        for n in (0..self.rest_px.len()).filter(|&n| self.detection_of[n].is_none()) {
            let (mut now, mut before, mut seen) = (DVec2::ZERO, DVec2::ZERO, 0.0);
            for m in near(n, self.cols, self.rest_px.len(), 1) {
                if self.detection_of[m].is_some() {
                    now += out.positions_px[m] - self.rest_px[m];
                    before += self.previous_px[m] - self.rest_px[m];
                    seen += 1.0;
                }
            }
            if seen > 0.0 {
                if out.unseen_frames[n] == 0 {
                    out.own_px[n] = self.previous_px[n] - self.rest_px[n] - before / seen;
                }
                out.positions_px[n] = self.rest_px[n] + now / seen + out.own_px[n];
            }
        }
    }
}

/// Places up to `reach` rows and columns from place `n` of a lattice with `len` places, including `n`.
fn near(n: usize, cols: usize, len: usize, reach: usize) -> impl Iterator<Item = usize> + Clone {
    let (row, col, rows) = (n / cols, n % cols, len / cols);
    let around = move |at: usize, end: usize| at.saturating_sub(reach)..(at + reach + 1).min(end);
    around(row, rows).flat_map(move |r| around(col, cols).map(move |c| r * cols + c))
}
