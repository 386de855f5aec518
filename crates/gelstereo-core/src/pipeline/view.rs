//! One view, from image to labelled markers.

use super::error::{PipelineError, View};
use super::frame::{LabelSource, Searched, ViewEvidence};
use super::rest_record::RestView;
use super::windows::{LatticeScale, Windows};
use super::work::{self, DetectRung, ViewSize};
use crate::detect::{DetectError, Detector, Markers, Workload, max_markers};
use crate::image::GrayView;
use crate::lattice::{self, LatticeFinder, RestLattice};
use crate::math::DVec2;
use crate::params::{
    Background, Centre, DetectParams, FindAt, LabelMethod, Params, PrintLayout, Search, Threshold,
};
use crate::track::{Certainty, MarkerState, ScatteredTracker, Tracker, Tracks, VerifiedTracker};
use alloc::boxed::Box;
use alloc::vec::Vec;

/// One view's stages, from image to labelled markers.
#[derive(Clone, Debug)]
pub(super) struct ViewStages {
    view: View,
    size_px: (usize, usize),
    /// x, y, width and height of the region that is searched, if set.
    roi_px: Option<[usize; 4]>,
    detector: Detector,
    /// [`DetectRung::Cheaper`], since the first frame with a limit; `None` where the settings have none.
    cheaper: Option<Box<Detector>>,
    rung: DetectRung,
    /// The settings' own rung.
    centre: Centre,
    /// Whether frames have limits.
    is_limited: bool,
    /// Predicted work of this frame's detection.
    pub work: u64,
    /// Whether this frame's markers are held because its limit left no time to label them afresh.
    skipped: bool,
    /// Area of the usual marker of the rest frame, and what it showed of the work of later frames.
    usual_px2: f64,
    workloads: [Workload; 2],
    markers: Markers,
    detected: Result<(), DetectError>,
    tracker: Tracker,
    checked: VerifiedTracker,
    /// Tracks instead of `checked` where rows are shifted: the other one knows rows and columns at right
    /// angles.
    hexagonal: Option<Box<ScatteredTracker>>,
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
            roi_px: params.detect.roi.of(view).rect_px,
            detector: Detector::new(&params.detect).within(params.detect.roi.of(view)),
            cheaper: None,
            rung: DetectRung::Configured,
            centre: params.detect.centre,
            is_limited: false,
            work: 0,
            skipped: false,
            usual_px2: 0.0,
            workloads: [Workload::default(); 2],
            markers: Markers::default(),
            detected: Ok(()),
            tracker: Tracker::new(&params.track),
            checked: VerifiedTracker::new(&params.track, size_px),
            hexagonal: (params.lattice.layout == PrintLayout::Hexagonal)
                .then(|| Box::new(ScatteredTracker::new(&params.track, size_px))),
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
        self.cheaper.iter_mut().for_each(|detector| detector.reset());
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
    ///
    /// With a limit, the first of these whose predicted work fits: the settings' own search; windows with the
    /// settings' rung; windows with the cheaper one. If windows are not sufficient, the whole image is
    /// searched by the first rung that fits. If none fits after the windows, but would without them, the
    /// markers are held for this frame, and the next one is searched whole. If none would, the cheaper rung
    /// searches the whole image beyond the limit: without labels, later frames would be lost too.
    pub fn detect(&mut self, image: GrayView<'_>, params: &Params, follows: bool, limit: Option<u64>) {
        (self.work, self.skipped, self.rung) = (0, false, DetectRung::Configured);
        let size = self.size(params);
        let limit = limit.filter(|_| follows);
        if let Some(rung) = self.rung_of_windows(params, follows, limit, &size) {
            self.rung = rung;
            self.work = work::windows(&params.detect, rung, &size);
            self.searched = Searched::Windows;
            self.detected = Ok(());
            if self.detect_in_windows(image, params) {
                return;
            }
            let least = work::whole(&params.detect, self.last_rung(), &size);
            let fits_next = |limit| (least..self.work + least).contains(&limit);
            self.skipped = params.label.method == LabelMethod::Lattice && limit.is_some_and(fits_next);
            if self.skipped {
                return;
            }
        }
        let is_over = |rung| {
            let work = self.work + work::whole(&params.detect, rung, &size);
            limit.is_some_and(|limit| work > limit)
        };
        self.rung = if is_over(DetectRung::Configured) { self.last_rung() } else { DetectRung::Configured };
        self.work += work::whole(&params.detect, self.rung, &size);
        let detector = of_rung(self.rung, &mut self.detector, &mut self.cheaper);
        self.detected = detector.run(image, &mut self.markers);
        self.searched = Searched::Whole;
    }

    /// Makes the cheaper rung before the first frame with a limit; returns whether [`Self::prepare`] is
    /// then due.
    pub fn begin_limits(&mut self, params: &Params) -> bool {
        if core::mem::replace(&mut self.is_limited, true) {
            return false;
        }
        let within = |detect| Detector::new(&detect).within(params.detect.roi.of(self.view));
        self.cheaper = cheaper(&params.detect).map(within).map(Box::new);
        true
    }

    /// The rung that searches windows of this frame; `None` to search the whole image.
    fn rung_of_windows(
        &self,
        params: &Params,
        follows: bool,
        limit: Option<u64>,
        size: &ViewSize,
    ) -> Option<DetectRung> {
        let are_ready = follows && self.windows.are_ready() && is_certain(params, &self.tracks);
        let fits = |work: u64| limit.is_none_or(|limit| work <= limit);
        match params.detect.search {
            _ if !are_ready => None,
            Search::Whole if fits(work::whole(&params.detect, DetectRung::Configured, size)) => None,
            _ if fits(work::windows(&params.detect, DetectRung::Configured, size)) => {
                Some(DetectRung::Configured)
            }
            _ => Some(self.last_rung()),
        }
    }

    /// The cheapest rung that these settings have.
    const fn last_rung(&self) -> DetectRung {
        if self.cheaper.is_some() { DetectRung::Cheaper } else { DetectRung::Configured }
    }

    /// What this view's work grows with.
    pub fn size(&self, params: &Params) -> ViewSize {
        let size_px = match params.detect.roi.of(self.view).rect_px {
            Some([.., width, height]) => (width, height),
            None => self.size_px,
        };
        let (markers, marker_px2) = (self.rows * self.cols, self.usual_px2);
        let [configured, cheaper] = self.workloads;
        ViewSize { size_px, markers, marker_px2, configured, cheaper }
    }

    /// Runs detection and tracking in windows. Returns whether they are as certain as the previous frame;
    /// the tracks are then in `windows`.
    fn detect_in_windows(&mut self, image: GrayView<'_>, params: &Params) -> bool {
        let Self { windows, detector, cheaper, rung, tracker, checked, hexagonal, tracks, .. } = self;
        let detector = of_rung(*rung, detector, cheaper);
        let predicted_px = match (params.label.method, &mut *hexagonal) {
            (LabelMethod::Lattice, Some(tracker)) => tracker.predict(tracks),
            (LabelMethod::Lattice, None) => checked.predict(tracks),
            (LabelMethod::Foresight, _) => tracks.positions_px.as_slice(),
        };
        let lattice = LatticeScale { cols: self.cols, pitch_px: self.pitch_px };
        if !windows.look(detector, image, predicted_px, lattice, tracks) {
            return false;
        }
        match (params.label.method, hexagonal) {
            (LabelMethod::Lattice, Some(tracker)) => {
                tracker.run(&windows.found.markers, &mut windows.tracks) == Certainty::Certain
            }
            (LabelMethod::Lattice, None) => {
                checked.run_near(&windows.found, &mut windows.tracks) == Certainty::Certain
            }
            (LabelMethod::Foresight, _) => {
                tracker.run(&windows.found.markers, &mut windows.tracks);
                is_certain(params, &windows.tracks)
            }
        }
    }

    /// Reserves memory for windows in the rest frame, so that no later frame allocates.
    pub fn prepare(&mut self, image: GrayView<'_>, params: &Params) {
        self.usual_px2 = self.median_area_px2();
        if let Some(cheaper) = &mut self.cheaper {
            // It learns the image's noise.
            let _ = cheaper.run(image, &mut self.windows.found.markers);
        }
        let of_cheaper = self.cheaper.as_deref().map(Detector::workload);
        self.workloads = [self.detector.workload(), of_cheaper.unwrap_or_default()];
        if self.is_limited || params.detect.search == Search::Windows {
            let Self { windows, detector, cheaper, markers, tracks, .. } = self;
            let size_px = (image.width(), image.height());
            let lattice = LatticeScale { cols: self.cols, pitch_px: self.pitch_px };
            cheaper
                .iter_mut()
                .for_each(|detector| windows.begin(detector, size_px, lattice, markers, tracks));
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

    /// First and last pixel of the region that is searched.
    pub fn searched_px(&self) -> (DVec2, DVec2) {
        let [x, y, width, height] = self.roi_px.unwrap_or([0, 0, self.size_px.0, self.size_px.1]);
        let low = DVec2::new(x as f64, y as f64);
        (low, low + DVec2::new(width as f64, height as f64) - 1.0)
    }

    /// Centres of the markers found in the whole image.
    pub fn centres_px(&self) -> &[DVec2] {
        &self.markers.centres_px
    }

    /// Labels the rest frame, with rows aligned to those of the other view, if that was labelled before.
    pub fn label(
        &self,
        params: &Params,
        finder: &mut LatticeFinder,
        other: Option<&RestLattice>,
    ) -> Result<RestLattice, PipelineError> {
        let tolerance_pitches = params.label.tolerance_pitches;
        lattice::rest_lattice_by(finder, &self.markers, &params.lattice, tolerance_pitches, other)
            .map_err(|error| PipelineError::Label { view: self.view, error })
    }

    /// Starts from a rest frame labelled from the present markers.
    pub fn begin(&mut self, params: &Params, rest: &RestLattice) {
        (self.rows, self.cols, self.pitch_px) = (rest.rows, rest.cols, rest.pitch_px);
        self.rest_px.clone_from(&rest.positions_px);
        self.shown.clear();
        self.shown.extend(rest.detection.iter().map(Option::is_some));
        self.resumes = false;
        let most = max_markers(&params.detect, self.size_px);
        match params.label.method {
            LabelMethod::Lattice => match &mut self.hexagonal {
                Some(tracker) => {
                    tracker.initialise_labelled(rest, &self.markers, most, &mut self.tracks);
                }
                None => self.checked.initialise(rest, &self.markers, most, &mut self.tracks),
            },
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
        if let Some(tracker) = &mut self.hexagonal {
            tracker.initialise_labelled(&rest, &markers, most, &mut self.tracks);
            return tracker.hold(&mut self.tracks);
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
        if self.skipped {
            match &self.hexagonal {
                Some(tracker) => tracker.hold(&mut self.tracks),
                None => self.checked.hold(&mut self.tracks),
            }
            return Certainty::Uncertain;
        }
        if self.searched == Searched::Windows {
            core::mem::swap(&mut self.tracks, &mut self.windows.tracks);
            return Certainty::Certain;
        }
        if let Some(tracker) = &mut self.hexagonal {
            return tracker.run(&self.markers, &mut self.tracks);
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
        let is_degraded = self.rung == DetectRung::Cheaper;
        ViewEvidence {
            detected: markers.centres_px.len(),
            labels,
            relabelled,
            searched: self.searched,
            centre: if is_degraded { Centre::SoftThreshold } else { self.centre },
            is_degraded,
        }
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

/// Lets both views count as the one that takes more, since both get the same limit.
pub(super) fn share_workloads(left: &mut ViewStages, right: &mut ViewStages) {
    let usual_px2 = left.usual_px2.max(right.usual_px2);
    let [own, cheaper] = left.workloads;
    let workloads = [own.larger(right.workloads[0]), cheaper.larger(right.workloads[1])];
    for view in [left, right] {
        (view.usual_px2, view.workloads) = (usual_px2, workloads);
    }
}

/// The detector of a rung.
fn of_rung<'a>(
    rung: DetectRung,
    detector: &'a mut Detector,
    cheaper: &'a mut Option<Box<Detector>>,
) -> &'a mut Detector {
    match (cheaper, rung) {
        (Some(cheaper), DetectRung::Cheaper) => cheaper.as_mut(),
        _ => detector,
    }
}

/// Settings of the cheaper rung; `None` where the settings' own is the cheapest, or is the paper's.
fn cheaper(params: &DetectParams) -> Option<DetectParams> {
    let has_one = params.centre == Centre::Fit
        && params.threshold == Threshold::Auto
        && params.background == Background::Blocks;
    has_one.then(|| DetectParams {
        centre: Centre::SoftThreshold,
        find_at: FindAt::HalfSize,
        ..params.clone()
    })
}

/// Whether the tracks give the position of each marker. Where to search depends on them alone, so a
/// replay from a checkpoint decides alike.
fn is_certain(params: &Params, tracks: &Tracks) -> bool {
    match params.label.method {
        LabelMethod::Lattice => tracks.is_current(),
        LabelMethod::Foresight => tracks.state.iter().all(|&state| state == MarkerState::Seen),
    }
}
