//! One view, from image to labelled markers.

use super::copy_into;
use super::error::{PipelineError, View};
use super::frame::{LabelSource, ViewEvidence};
use crate::detect::{DetectError, Detector, Markers};
use crate::image::GrayView;
use crate::label::{self, RestLattice};
use crate::params::{LabelMethod, Params};
use crate::track::{CheckedTracker, Tracker, Tracks, Verdict};
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
            rows: 0,
            cols: 0,
            pitch_px: 0.0,
            order: Vec::new(),
            labelled: Tracks::default(),
            evidence: ViewEvidence::default(),
        }
    }

    pub fn check_size(&self, image: &GrayView<'_>) -> Result<(), PipelineError> {
        let found = (image.width(), image.height());
        if found == self.size_px {
            Ok(())
        } else {
            Err(PipelineError::Size { view: self.view, found, expected: self.size_px })
        }
    }

    pub fn detect(&mut self, image: GrayView<'_>) {
        self.detected = self.detector.run(image, &mut self.markers);
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
        match params.label.method {
            LabelMethod::Temporal => {
                self.tracker.run(&self.markers, &mut self.tracks);
                self.take_tracks(LabelSource::Tracks);
            }
            LabelMethod::Foresight => {
                self.tracker.run(&self.markers, &mut self.tracks);
                self.sort(params.label.tolerance_pitches);
            }
            LabelMethod::Lattice => {
                let verdict = self.checked.run(&self.markers, &mut self.tracks);
                self.take_tracks(match verdict {
                    Verdict::Certain => LabelSource::Lattice,
                    Verdict::Uncertain => LabelSource::Held,
                });
            }
        }
    }

    fn take_tracks(&mut self, labels: LabelSource) {
        copy_into(&self.tracks.positions_px, &mut self.labelled.positions_px);
        copy_into(&self.tracks.state, &mut self.labelled.state);
        copy_into(&self.tracks.covariance_px2, &mut self.labelled.covariance_px2);
        self.evidence = ViewEvidence { detected: self.markers.centres_px.len(), labels, relabelled: 0 };
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
        self.evidence = ViewEvidence {
            detected: self.markers.centres_px.len(),
            labels: LabelSource::Foresight,
            relabelled: self.order.iter().enumerate().filter(|&(slot, &track)| slot != track).count(),
        };
    }
}
