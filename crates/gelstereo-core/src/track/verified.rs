//! Tracking with verified identity: labels are correct or not reported.

use super::agreement::Before;
use super::extended_lattice::{ExtendedLattice, NONE};
use super::interpolate::Interpolator;
use super::matching::Matching;
use super::pitch_shift::{self, Expectation, PitchShift};
use super::relabel::Relabel;
use super::window_detections::WindowDetections;
use super::{MarkerState, NEVER_SEEN, Tracks};
use crate::detect::Found;
use crate::detect::Markers;
use crate::lattice::RestLattice;
use crate::math::DVec2;
use crate::params::{Motion, TrackParams};
use alloc::vec::Vec;

/// Rings of empty places searched around the lattice: one while all is as expected, otherwise the largest
/// shift from the prediction in pitches, plus one.
const RINGS: [usize; 2] = [1, 4];

/// A marker missed in more than this many consecutive certain frames is not expected.
const EXPECTED_FRAMES: u32 = 2;

/// Without a border in view, the largest mean residual, in pitches: labels fail at half a pitch, and half
/// of that is a margin for single jumps.
const UNANCHORED_PITCHES: f64 = 0.25;

/// A lattice to which most detections do not belong is rejected.
const MAX_PER_SITE: usize = 2;

/// Certainty of the identification of a frame's markers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Certainty {
    /// Every match agrees with its neighbours, and the border excludes an unnoticed shift by a whole
    /// pitch.
    Certain,
    /// Nothing could be identified with certainty: all markers are held in place.
    #[default]
    Uncertain,
}

/// Tracks the markers of one view and reports only verified identities.
///
/// A lattice shifted by a pitch between two frames differs only at its border, and a nearest-neighbour
/// search fails if it is bent by half a pitch. So each frame is matched to the prediction
/// (`track.motion`). Matches that disagree with their neighbours are dropped and rematched from those
/// that agree, and places around the lattice are searched too. The shift of the whole follows from its
/// border, the limits of the view and unprinted places. When two shifts fit a frame about equally well,
/// all markers are held, and later frames are compared with the last certain one.
#[derive(Clone, Debug)]
pub struct VerifiedTracker {
    params: TrackParams,
    size_px: (usize, usize),
    pitch_px: f64,
    rows: usize,
    cols: usize,
    /// Frames with more detections do not show the lattice.
    most_detections: usize,
    rest_px: Vec<DVec2>,
    /// Whether the border of the rest lattice determines its shift.
    anchored: bool,
    expected_px: Vec<DVec2>,
    canvas: ExtendedLattice,
    matching: Matching,
    relabel: Relabel,
    anchor: PitchShift,
    interpolator: Interpolator,
}

impl VerifiedTracker {
    /// For images of `size_px` (width, height). Not yet initialised: [`Self::run`] leaves `out` unchanged
    /// until [`Self::initialise`] was called.
    #[must_use]
    pub fn new(params: &TrackParams, size_px: (usize, usize)) -> Self {
        Self {
            params: params.clone(),
            size_px,
            pitch_px: 0.0,
            rows: 0,
            cols: 0,
            most_detections: 0,
            rest_px: Vec::new(),
            anchored: false,
            expected_px: Vec::new(),
            canvas: ExtendedLattice::default(),
            matching: Matching::default(),
            relabel: Relabel::default(),
            anchor: PitchShift::default(),
            interpolator: Interpolator::default(),
        }
    }

    /// Starts from a labelled rest frame of at least 3 x 3 markers and its detections, and reserves
    /// memory for later frames with up to `most_detections`.
    pub fn initialise(
        &mut self,
        rest: &RestLattice,
        detected: &Markers,
        most_detections: usize,
        out: &mut Tracks,
    ) {
        (self.rows, self.cols, self.pitch_px) = (rest.rows, rest.cols, rest.pitch_px);
        self.rest_px.clone_from(&rest.positions_px);
        out.initialise(rest, detected, self.params.gate_pitches * rest.pitch_px);
        let (markers, widest) = (self.rest_px.len(), 2 * RINGS[RINGS.len() - 1]);
        let sites = (self.rows + widest) * (self.cols + widest);
        self.most_detections = MAX_PER_SITE * sites;
        let most_detections = most_detections.min(self.most_detections);
        self.expected_px.clone_from(&self.rest_px);
        self.matching.reserve(sites, most_detections, self.size_px, self.pitch_px);
        self.relabel.reserve(self.size_px, most_detections, self.rows.max(self.cols));
        let (lattice, rings) = ((self.rows, self.cols), RINGS[RINGS.len() - 1]);
        self.anchor.reserve(lattice, rings, most_detections);
        self.interpolator.reserve(markers);
        self.canvas.lay(&self.rest_px, self.rows, self.cols, RINGS[RINGS.len() - 1]);
        for (n, detection) in rest.detection.iter().enumerate() {
            if let (Some(m), Some(site)) = (detection, self.canvas.site(n, [0, 0])) {
                self.canvas.found[site] = *m;
            }
        }
        let alone = self.anchor.run(
            &self.canvas,
            &detected.centres_px,
            expectations(out),
            self.size_px,
            self.pitch_px,
        );
        self.anchored = alone.certain && alone.shift == [0, 0];
    }

    /// Predicted marker positions in the next frame, row by row, for a search around predictions.
    #[must_use]
    pub fn predict(&mut self, tracks: &Tracks) -> &[DVec2] {
        let steps = tracks.positions_px.iter().zip(&tracks.previous_px);
        self.expected_px.clear();
        match self.params.motion {
            Motion::ConstantVelocity if tracks.steady => {
                self.expected_px.extend(steps.map(|(&now, &before)| now + (now - before)));
            }
            _ => self.expected_px.extend_from_slice(&tracks.positions_px),
        }
        &self.expected_px
    }

    /// Updates the tracks by the detections of the next frame. `out` holds the tracks of the previous
    /// frame.
    pub fn run(&mut self, detected: &Markers, out: &mut Tracks) -> Certainty {
        self.follow(detected, WindowDetections::default(), out)
    }

    /// As [`Self::run`], with bit-identical results, for detections found near the positions of
    /// [`Self::predict`], which must be the first ones searched. Known nearest detections are not
    /// searched again.
    pub fn run_near(&mut self, found: &Found, out: &mut Tracks) -> Certainty {
        self.follow(&found.markers, WindowDetections::of(found), out)
    }

    fn follow(&mut self, detected: &Markers, sights: WindowDetections<'_>, out: &mut Tracks) -> Certainty {
        if self.rest_px.is_empty() || out.positions_px.len() != self.rest_px.len() {
            return Certainty::Uncertain;
        }
        if detected.centres_px.len() > self.most_detections {
            self.hold(out);
            return Certainty::Uncertain;
        }
        let _ = self.predict(out);
        self.matching.load(&detected.centres_px, self.pitch_px);
        for rings in RINGS {
            if let Some(shift) = self.identify(&detected.centres_px, rings, sights, out) {
                self.take(detected, shift, out);
                return Certainty::Certain;
            }
        }
        // Gel released during uncertain frames looks as at rest.
        if out.stale {
            self.expected_px.clone_from(&self.rest_px);
            if let Some(shift) = self.identify(&detected.centres_px, RINGS[1], sights, out) {
                self.take(detected, shift, out);
                return Certainty::Certain;
            }
        }
        if let Some(shift) = self.relabel(detected, out) {
            self.take(detected, shift, out);
            return Certainty::Certain;
        }
        self.hold(out);
        Certainty::Uncertain
    }

    /// Shift of the lattice from this frame alone, if it is certain and agrees with the last certain
    /// frame or with rest.
    fn relabel(&mut self, detected: &Markers, tracks: &Tracks) -> Option<[isize; 2]> {
        if !self.anchored || !self.relabel.find(detected, self.size_px) {
            return None;
        }
        let detected_px = &detected.centres_px;
        let since = [&tracks.positions_px, &self.rest_px];
        for expected_px in since.into_iter().take(if tracks.stale { 2 } else { 1 }) {
            let Self { canvas, matching, relabel, pitch_px, .. } = self;
            canvas.lay(expected_px, self.rows, self.cols, RINGS[1]);
            let Some(evidence) = relabel.lay(detected_px, expected_px, canvas) else { continue };
            let mut whole =
                relabel.complete(canvas) || matching.check(canvas, detected_px, before(tracks, *pitch_px));
            // An indenter that arrives within one frame bends the gel more than matches may disagree.
            // With all sides of the print in view, the frame is labelled without history, like a first
            // frame.
            if !whole && evidence.by_extents {
                canvas.lay(expected_px, self.rows, self.cols, RINGS[1]);
                whole = relabel.lay(detected_px, expected_px, canvas).is_some();
            }
            let matched = canvas.found.iter().filter(|&&m| m != NONE).count();
            if !whole || MAX_PER_SITE * matched < detected_px.len() {
                continue;
            }
            let found = self.anchor.run(canvas, detected_px, expectations(tracks), self.size_px, *pitch_px);
            if found.certain {
                return Some(found.shift);
            }
        }
        None
    }

    /// Shift of the lattice on a canvas with `rings` rings, if it is certain.
    fn identify(
        &mut self,
        detected_px: &[DVec2],
        rings: usize,
        sights: WindowDetections<'_>,
        tracks: &Tracks,
    ) -> Option<[isize; 2]> {
        let Self { canvas, matching, pitch_px, .. } = self;
        canvas.lay(&self.expected_px, self.rows, self.cols, rings);
        let gate_px = (rings == RINGS[0]).then_some(self.params.gate_pitches * *pitch_px);
        let whole = matching.run(canvas, detected_px, before(tracks, *pitch_px), gate_px, sights);
        // A lattice to which most detections do not belong is rejected.
        let matched = canvas.found.iter().filter(|&&m| m != NONE).count();
        if !whole || MAX_PER_SITE * matched < detected_px.len() {
            return None;
        }
        let found = self.anchor.run(canvas, detected_px, expectations(tracks), self.size_px, *pitch_px);
        if self.anchored { found.certain.then_some(found.shift) } else { self.unanchored() }
    }

    /// Zero shift for a lattice without a border in view, if its residuals are small.
    fn unanchored(&self) -> Option<[isize; 2]> {
        let canvas = &self.canvas;
        let found = || (0..canvas.found.len()).filter(|&s| canvas.found[s] != NONE);
        let (sum, count) =
            found().fold((0.0, 0), |(sum, n), s| (sum + canvas.residual_px[s].length(), n + 1));
        (count >= 9 && sum < UNANCHORED_PITCHES * self.pitch_px * f64::from(count)).then_some([0, 0])
    }

    fn take(&mut self, detected: &Markers, shift: [isize; 2], out: &mut Tracks) {
        let Self { canvas, interpolator, rest_px, cols, .. } = self;
        let in_view = pitch_shift::in_view(self.size_px, self.pitch_px);
        core::mem::swap(&mut out.previous_px, &mut out.positions_px);
        for (n, site) in canvas.sites(shift).enumerate() {
            let found = site.map(|s| canvas.found[s]).filter(|&m| m != NONE);
            if let Some(m) = found {
                out.positions_px[n] = detected.centres_px[m as usize];
                out.covariance_px2[n] = detected.covariance_px2[m as usize];
            }
            let missed = &mut out.missed_frames[n];
            // Outside the view it does not count as missed, and is expected once it is back.
            let out_of_view = site.is_none_or(|s| !in_view(canvas.position_px(s)));
            *missed = match (found, out_of_view) {
                (Some(_), _) => 0,
                (None, true) => (*missed).max(1),
                (None, false) => missed.saturating_add(1),
            };
            out.update_state(n, found.is_some(), self.params.max_held_frames);
        }
        (out.steady, out.stale) = (true, false);
        let Tracks { positions_px, state, .. } = out;
        interpolator.run(rest_px, *cols, |n| state[n] == MarkerState::Seen, positions_px);
    }

    /// Holds all markers in place, as in a frame in which nothing is certain.
    pub fn hold(&self, out: &mut Tracks) {
        for n in 0..self.rest_px.len() {
            out.update_state(n, false, self.params.max_held_frames);
        }
        out.previous_px.clone_from(&out.positions_px);
        (out.steady, out.stale) = (false, true);
    }
}

fn before(tracks: &Tracks, pitch_px: f64) -> Before<'_> {
    Before { missed_frames: &tracks.missed_frames, stale: tracks.stale, pitch_px }
}

fn expectations(tracks: &Tracks) -> impl Iterator<Item = Expectation> + Clone {
    tracks.unseen_frames.iter().zip(&tracks.missed_frames).map(|(&unseen, &missed)| match (unseen, missed) {
        (NEVER_SEEN, _) => Expectation::Absent,
        (_, missed) if missed <= EXPECTED_FRAMES => Expectation::Present,
        _ => Expectation::Unknown,
    })
}
