//! One view, from image to labelled markers.

use super::error::{PipelineError, View};
use super::frame::{LabelSource, Searched, ViewEvidence};
use super::rest_record::RestView;
use super::windows::{LatticeScale, Windows};
use crate::detect::{DetectError, Detector, Markers, max_markers};
use crate::image::GrayView;
use crate::lattice::{self, LatticeFinder, RestLattice};
use crate::math::DVec2;
use crate::params::{LabelMethod, Params, Search};
use crate::track::{Certainty, MarkerState, Tracker, Tracks, VerifiedTracker};
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
    checked: VerifiedTracker,
    tracks: Tracks,
    windows: Windows,
    searched: Searched,
    /// Lattice size and pitch, as found in the rest frame.
    pub rows: usize,
    pub cols: usize,
    pub pitch_px: f64,
    /// Marker positions without contact, and which of them the rest frame showed.
    rest_px: Vec<DVec2>,
    shown: Vec<bool>,
    /// Whether the labels of a recorded rest frame are still to be found again.
    resumes: bool,
    order: Vec<usize>,
    /// The tracks in the order of the sort, if that succeeded.
    sorted: Tracks,
    is_sorted: bool,
    pub evidence: ViewEvidence,
}

impl ViewStages {
    pub fn new(view: View, size_px: (usize, usize), params: &Params) -> Self {
        Self {
            view,
            size_px,
            detector: Detector::new(&params.detect).within(params.detect.roi.of(view)),
            markers: Markers::default(),
            detected: Ok(()),
            tracker: Tracker::new(&params.track),
            checked: VerifiedTracker::new(&params.track, size_px),
            tracks: Tracks::default(),
            windows: Windows::default(),
            searched: Searched::Whole,
            rows: 0,
            cols: 0,
            pitch_px: 0.0,
            rest_px: Vec::new(),
            shown: Vec::new(),
            resumes: false,
            order: Vec::new(),
            sorted: Tracks::default(),
            is_sorted: false,
            evidence: ViewEvidence::default(),
        }
    }

    /// Clears detection state from earlier images.
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

    /// Finds markers, by the method of `detect.search` if this frame follows another. Leaves the tracks
    /// unchanged.
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

    /// Runs detection and tracking in windows. Returns whether they are as certain as the previous frame;
    /// the tracks are then in `windows`.
    fn detect_in_windows(&mut self, image: GrayView<'_>, params: &Params) -> bool {
        let Self { windows, detector, tracker, checked, tracks, .. } = self;
        let predicted_px = match params.label.method {
            LabelMethod::Lattice => checked.predict(tracks),
            LabelMethod::Foresight => tracks.positions_px.as_slice(),
        };
        let lattice = LatticeScale { cols: self.cols, pitch_px: self.pitch_px };
        if !windows.look(detector, image, predicted_px, lattice, tracks) {
            return false;
        }
        match params.label.method {
            LabelMethod::Lattice => {
                checked.run_near(&windows.found, &mut windows.tracks) == Certainty::Certain
            }
            LabelMethod::Foresight => {
                tracker.run(&windows.found.markers, &mut windows.tracks);
                is_certain(params, &windows.tracks)
            }
        }
    }

    /// Reserves memory for windows in the rest frame, so that no later frame allocates.
    pub fn prepare(&mut self, image: GrayView<'_>, params: &Params) {
        if params.detect.search == Search::Windows {
            let Self { windows, detector, markers, tracks, .. } = self;
            let size_px = (image.width(), image.height());
            let lattice = LatticeScale { cols: self.cols, pitch_px: self.pitch_px };
            windows.begin(detector, size_px, lattice, markers, tracks);
        }
    }

    /// Median area of the markers found in the whole image; 0 when there are none.
    pub fn median_area_px2(&self) -> f64 {
        let mut areas: Vec<f64> = self.markers.area_px2.iter().map(|&area| f64::from(area)).collect();
        crate::math::median(&mut areas).unwrap_or(0.0)
    }

    pub fn check_detected(&self) -> Result<(), PipelineError> {
        self.detected.map_err(|error| PipelineError::Detect { view: self.view, error })
    }

    /// Labels the rest frame, with rows aligned to those of the other view, if that was labelled before.
    pub fn start(
        &mut self,
        params: &Params,
        finder: &mut LatticeFinder,
        other: Option<&RestLattice>,
    ) -> Result<RestLattice, PipelineError> {
        let tolerance_pitches = params.label.tolerance_pitches;
        let rest = lattice::rest_lattice_by(finder, &self.markers, &params.lattice, tolerance_pitches)
            .map_err(|error| PipelineError::Label { view: self.view, error })?;
        let rest = match other {
            Some(other) => rest.turned_like(other),
            None => rest,
        };
        self.begin(params, &rest);
        Ok(rest)
    }

    /// Starts from a rest frame labelled from the present markers.
    fn begin(&mut self, params: &Params, rest: &RestLattice) {
        (self.rows, self.cols, self.pitch_px) = (rest.rows, rest.cols, rest.pitch_px);
        self.rest_px.clone_from(&rest.positions_px);
        self.shown.clear();
        self.shown.extend(rest.detection.iter().map(Option::is_some));
        self.resumes = false;
        let most = max_markers(&params.detect, self.size_px);
        match params.label.method {
            LabelMethod::Lattice => self.checked.initialise(rest, &self.markers, most, &mut self.tracks),
            LabelMethod::Foresight => {
                self.tracker.initialise(rest, &self.markers, &mut self.tracks);
                self.tracker.reserve(self.size_px, most);
            }
        }
        self.take_tracks(LabelSource::Rest);
    }

    /// Record of this view's rest frame.
    pub fn rest_view(&self) -> RestView {
        RestView { pitch_px: self.pitch_px, positions_px: self.rest_px.clone(), shown: self.shown.clone() }
    }

    /// Starts from a recorded rest frame: the verified tracker labels the markers until it has found all
    /// again, whatever `label.method` is.
    pub fn resume(&mut self, params: &Params, (rows, cols): (usize, usize), record: &RestView) {
        (self.rows, self.cols, self.pitch_px) = (rows, cols, record.pitch_px);
        self.rest_px.clone_from(&record.positions_px);
        self.shown.clone_from(&record.shown);
        self.resumes = true;
        self.restart(params);
        self.take_tracks(LabelSource::Held);
    }

    /// Sets the tracks to the rest positions, as after a gap in which nothing was certain.
    fn restart(&mut self, params: &Params) {
        let detection = (0..).zip(&self.shown).map(|(n, &shown)| shown.then_some(n)).collect();
        let (rows, cols, pitch_px) = (self.rows, self.cols, self.pitch_px);
        let positions_px = self.rest_px.clone();
        let rest = RestLattice { rows, cols, positions_px, detection, pitch_px, left_out: [0; 4] };
        // Present positions are known to the gate at best.
        let markers = Markers::at(self.rest_px.clone(), params.track.gate_pitches * pitch_px);
        let most = max_markers(&params.detect, self.size_px);
        if params.label.method != LabelMethod::Lattice {
            self.tracker.initialise(&rest, &markers, &mut self.tracks);
            self.tracker.reserve(self.size_px, most);
        }
        self.checked.initialise(&rest, &markers, most, &mut self.tracks);
        self.checked.hold(&mut self.tracks);
    }

    /// Tracks the first frames after a record, until labels are certain.
    fn follow_record(&mut self, params: &Params) {
        let certain = self.track(params) == Certainty::Certain;
        let printed = |&[row, col]: &[usize; 2]| {
            self.tracks.state.get(row * self.cols + col).is_some_and(|&state| state == MarkerState::Seen)
        };
        if certain && params.lattice.missing.iter().any(printed) {
            // The lattice fits but is turned or shifted: a marker was seen where none was printed.
            self.restart(params);
        } else {
            self.resumes = !certain;
        }
        if !self.resumes && params.label.method != LabelMethod::Lattice {
            self.checked = VerifiedTracker::new(&params.track, self.size_px);
        }
        self.take_tracks(if self.resumes { LabelSource::Held } else { LabelSource::Lattice });
    }

    pub fn follow(&mut self, params: &Params) {
        if self.resumes {
            return self.follow_record(params);
        }
        let verdict = self.track(params);
        match (params.label.method, verdict) {
            (LabelMethod::Foresight, _) => self.sort(params.label.tolerance_pitches),
            (LabelMethod::Lattice, Certainty::Certain) => self.take_tracks(LabelSource::Lattice),
            (LabelMethod::Lattice, Certainty::Uncertain) => self.take_tracks(LabelSource::Held),
        }
    }

    /// Updates the tracks to this frame.
    fn track(&mut self, params: &Params) -> Certainty {
        if self.searched == Searched::Windows {
            core::mem::swap(&mut self.tracks, &mut self.windows.tracks);
            return Certainty::Certain;
        }
        if params.label.method == LabelMethod::Lattice || self.resumes {
            return self.checked.run(&self.markers, &mut self.tracks);
        }
        self.tracker.run(&self.markers, &mut self.tracks);
        Certainty::Certain
    }

    fn evidence(&self, labels: LabelSource, relabelled: usize) -> ViewEvidence {
        let markers = match self.searched {
            Searched::Whole => &self.markers,
            Searched::Windows => &self.windows.found.markers,
        };
        ViewEvidence { detected: markers.centres_px.len(), labels, relabelled, searched: self.searched }
    }

    /// Every marker of this frame, row by row.
    pub const fn labelled(&self) -> &Tracks {
        if self.is_sorted { &self.sorted } else { &self.tracks }
    }

    fn take_tracks(&mut self, labels: LabelSource) {
        self.is_sorted = false;
        self.evidence = self.evidence(labels, 0);
    }

    /// Labels as in the paper; where the sort fails, the tracks' labels are kept and recorded as the
    /// source.
    fn sort(&mut self, tolerance_pitches: f64) {
        let (rows, cols, tolerance_px) = (self.rows, self.cols, tolerance_pitches * self.pitch_px);
        let all_found = self.searched == Searched::Whole && self.markers.centres_px.len() == rows * cols;
        let all_tracked = self.tracks.state.iter().all(|&state| state == MarkerState::Seen);
        let mut sorts = |positions: &[DVec2]| {
            lattice::foresight_sort(positions, rows, cols, tolerance_px, &mut self.order).is_ok()
        };
        if all_found && !all_tracked && sorts(&self.markers.centres_px) {
            let relabelled = self.tracks.update(&self.markers, &self.order);
            self.is_sorted = false;
            self.evidence = self.evidence(LabelSource::Foresight, relabelled);
            return;
        }
        let positions = &self.tracks.positions_px;
        if !sorts(positions) {
            return self.take_tracks(LabelSource::Tracks);
        }
        self.sorted.positions_px.clear();
        self.sorted.positions_px.extend(self.order.iter().map(|&i| positions[i]));
        self.sorted.covariance_px2.clear();
        self.sorted.covariance_px2.extend(self.order.iter().map(|&i| self.tracks.covariance_px2[i]));
        self.sorted.state.clear();
        self.sorted.state.extend(self.order.iter().map(|&i| self.tracks.state[i]));
        self.is_sorted = true;
        let relabelled = self.order.iter().enumerate().filter(|&(slot, &track)| slot != track).count();
        self.evidence = self.evidence(LabelSource::Foresight, relabelled);
    }
}

/// Whether the tracks give the position of each marker. Where to search depends on them alone, so a
/// replay from a checkpoint decides alike.
fn is_certain(params: &Params, tracks: &Tracks) -> bool {
    match params.label.method {
        LabelMethod::Lattice => tracks.is_current(),
        LabelMethod::Foresight => tracks.state.iter().all(|&state| state == MarkerState::Seen),
    }
}
