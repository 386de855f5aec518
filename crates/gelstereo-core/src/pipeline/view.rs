//! One view, from image to labelled markers.

use super::copy_into;
use super::error::{PipelineError, View};
use super::frame::{LabelSource, Searched, ViewEvidence};
use super::windows::Windows;
use crate::detect::{DetectError, Detector, Markers};
use crate::image::GrayView;
use crate::label::{self, RestLattice};
use crate::params::{LabelMethod, Params, Search};
use crate::track::{CheckedTracker, MarkerState, Tracker, Tracks, Verdict};
use alloc::vec::Vec;

/// One view's stages, from image to labelled markers.
#[derive(Clone, Debug)]
pub(super) struct ViewStages {
    view: View,
    size_px: (usize, usize),
    detector: Detector,
    markers: Markers,
    detected: Result<(), DetectError>,
    tracker: Tracker,
    checked: CheckedTracker,
    tracks: Tracks,
    windows: Windows,
    searched: Searched,
    /// Of the lattice, as found in the rest frame.
    pub rows: usize,
    pub cols: usize,
    pitch_px: f64,
    order: Vec<usize>,
    pub labelled: Tracks,
    pub evidence: ViewEvidence,
}

impl ViewStages {
    pub fn new(view: View, size_px: (usize, usize), params: &Params) -> Self {
        Self {
            view,
            size_px,
            detector: Detector::new(&params.detect),
            markers: Markers::default(),
            detected: Ok(()),
            tracker: Tracker::new(&params.track),
            checked: CheckedTracker::new(&params.track, size_px),
            tracks: Tracks::default(),
            windows: Windows::default(),
            searched: Searched::Whole,
            rows: 0,
            cols: 0,
            pitch_px: 0.0,
            order: Vec::new(),
            labelled: Tracks::default(),
            evidence: ViewEvidence::default(),
        }
    }

    /// Forgets what detection learned of earlier images.
    pub fn forget(&mut self) {
        self.detector.reset();
    }

    pub fn check_size(&self, image: &GrayView<'_>) -> Result<(), PipelineError> {
        let found = (image.width(), image.height());
        if found == self.size_px {
            Ok(())
        } else {
            Err(PipelineError::Size { view: self.view, found, expected: self.size_px })
        }
    }

    /// Finds markers, as `detect.search` says if this frame follows another. Leaves the tracks alone.
    pub fn detect(&mut self, image: GrayView<'_>, params: &Params, follows: bool) {
        let windows = follows && params.detect.search == Search::Windows && is_certain(params, &self.tracks);
        self.searched = if windows && self.detect_in_windows(image, params) {
            self.detected = Ok(());
            Searched::Windows
        } else {
            self.detected = self.detector.run(image, &mut self.markers);
            Searched::Whole
        };
    }

    /// Whether windows and the tracks through them are as certain as the frame before; tracks are then ready in `windows`.
    fn detect_in_windows(&mut self, image: GrayView<'_>, params: &Params) -> bool {
        let Self { windows, detector, tracker, checked, tracks, .. } = self;
        let predicted_px = match params.label.method {
            LabelMethod::Lattice => checked.predict(tracks),
            LabelMethod::Temporal | LabelMethod::Foresight => tracks.positions_px.as_slice(),
        };
        let lattice = (self.cols, self.pitch_px);
        // What fails here fails on the whole image too, which then says so.
        if !windows.look(detector, image, predicted_px, lattice, tracks).unwrap_or(false) {
            return false;
        }
        match params.label.method {
            LabelMethod::Lattice => {
                checked.run(&windows.found.markers, &mut windows.tracks) == Verdict::Certain
            }
            LabelMethod::Temporal | LabelMethod::Foresight => {
                tracker.run(&windows.found.markers, &mut windows.tracks);
                is_certain(params, &windows.tracks)
            }
        }
    }

    /// Makes room for windows, in the rest frame, so that no later frame has to.
    pub fn prepare(&mut self, image: GrayView<'_>, params: &Params) {
        if params.detect.search == Search::Windows {
            let Self { windows, detector, markers, tracks, .. } = self;
            let size_px = (image.width(), image.height());
            windows.begin(detector, size_px, (self.cols, self.pitch_px), (markers, tracks));
            if windows.kind.is_none() {
                self.detect_in_windows(image, params);
            }
        }
    }

    pub fn check_detected(&self) -> Result<(), PipelineError> {
        self.detected.map_err(|error| PipelineError::Detect { view: self.view, error })
    }

    /// Labels the rest frame, with rows that run as those of the other view, if that was labelled before.
    pub fn start(
        &mut self,
        params: &Params,
        other: Option<&RestLattice>,
    ) -> Result<RestLattice, PipelineError> {
        let tolerance_pitches = params.label.tolerance_pitches;
        let rest = label::rest_lattice(&self.markers.centres_px, &params.lattice, tolerance_pitches)
            .map_err(|error| PipelineError::Label { view: self.view, error })?;
        let rest = other.map_or_else(|| rest.clone(), |other| rest.turned_like(other));
        self.begin(params, &rest);
        Ok(rest)
    }

    /// Starts from a labelled rest frame, made of the present markers.
    fn begin(&mut self, params: &Params, rest: &RestLattice) {
        (self.rows, self.cols, self.pitch_px) = (rest.rows, rest.cols, rest.pitch_px);
        let most = self.markers.centres_px.capacity();
        match params.label.method {
            LabelMethod::Lattice => self.checked.initialise(rest, &self.markers, most, &mut self.tracks),
            LabelMethod::Temporal | LabelMethod::Foresight => {
                self.tracker.initialise(rest, &self.markers, &mut self.tracks);
                self.tracker.reserve(self.size_px, most);
            }
        }
        self.take_tracks(LabelSource::Rest);
    }

    pub fn follow(&mut self, params: &Params) {
        let verdict = self.track(params);
        match (params.label.method, verdict) {
            (LabelMethod::Temporal, _) => self.take_tracks(LabelSource::Tracks),
            (LabelMethod::Foresight, _) => self.sort(params.label.tolerance_pitches),
            (LabelMethod::Lattice, Verdict::Certain) => self.take_tracks(LabelSource::Lattice),
            (LabelMethod::Lattice, Verdict::Uncertain) => self.take_tracks(LabelSource::Held),
        }
    }

    /// Brings the tracks to this frame.
    fn track(&mut self, params: &Params) -> Verdict {
        if self.searched == Searched::Windows {
            core::mem::swap(&mut self.tracks, &mut self.windows.tracks);
            return Verdict::Certain;
        }
        if params.label.method == LabelMethod::Lattice {
            return self.checked.run(&self.markers, &mut self.tracks);
        }
        self.tracker.run(&self.markers, &mut self.tracks);
        Verdict::Certain
    }

    fn evidence(&self, labels: LabelSource, relabelled: usize) -> ViewEvidence {
        let markers = match self.searched {
            Searched::Whole => &self.markers,
            Searched::Windows => &self.windows.found.markers,
        };
        ViewEvidence { detected: markers.centres_px.len(), labels, relabelled, searched: self.searched }
    }

    fn take_tracks(&mut self, labels: LabelSource) {
        copy_into(&self.tracks.positions_px, &mut self.labelled.positions_px);
        copy_into(&self.tracks.state, &mut self.labelled.state);
        copy_into(&self.tracks.covariance_px2, &mut self.labelled.covariance_px2);
        self.evidence = self.evidence(labels, 0);
    }

    /// Labels as the paper does; where the sort refuses, the tracks' labels stand and the evidence says so.
    fn sort(&mut self, tolerance_pitches: f64) {
        let positions = &self.tracks.positions_px;
        let tolerance_px = tolerance_pitches * self.pitch_px;
        if label::foresight_sort(positions, self.rows, self.cols, tolerance_px, &mut self.order).is_err() {
            return self.take_tracks(LabelSource::Tracks);
        }
        self.labelled.positions_px.clear();
        self.labelled.positions_px.extend(self.order.iter().map(|&i| positions[i]));
        self.labelled.covariance_px2.clear();
        self.labelled.covariance_px2.extend(self.order.iter().map(|&i| self.tracks.covariance_px2[i]));
        self.labelled.state.clear();
        self.labelled.state.extend(self.order.iter().map(|&i| self.tracks.state[i]));
        let relabelled = self.order.iter().enumerate().filter(|&(slot, &track)| slot != track).count();
        self.evidence = self.evidence(LabelSource::Foresight, relabelled);
    }
}

/// Whether the tracks tell where each marker is. They are all that decides where to search: a replay from a checkpoint
/// decides alike.
fn is_certain(params: &Params, tracks: &Tracks) -> bool {
    match params.label.method {
        LabelMethod::Lattice => tracks.is_current(),
        LabelMethod::Temporal | LabelMethod::Foresight => {
            tracks.state.iter().all(|&state| state == MarkerState::Seen)
        }
    }
}
