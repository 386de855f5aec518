//! The sensing stages in order, over scratch that is allocated once.

use crate::contact::{self, ContactError, RestSurface};
use crate::detect::{DetectError, Detector, Markers};
use crate::digest::Digest;
use crate::image::GrayView;
use crate::label::{self, LabelError};
use crate::math::{DVec2, DVec3};
use crate::params::{LabelMethod, LatticeParams, Params, ParamsError};
use crate::rig::Rig;
use crate::track::{MarkerState, Tracker, Tracks};
use crate::triangulate::{StereoPoint, TriangulateError, Triangulator};
use alloc::vec::Vec;

/// Where the rows and columns of a frame come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LabelSource {
    /// The rest frame's lattice.
    #[default]
    Rest,
    /// Foresight sort of this frame.
    Foresight,
    /// The tracks since the rest frame.
    Tracks,
}

/// What one view contributed to a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ViewEvidence {
    /// Markers detected.
    pub detected: usize,
    /// Where the labels come from; `Tracks` under `label.method = foresight` means that the sort refused.
    pub labels: LabelSource,
    /// Markers whose label by the sort differs from that by their track.
    pub relabelled: usize,
}

/// Everything that one stereo frame gave; marker `row * cols + col` stands at that index in every list.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Frames since the last reset, from 0 (the rest frame).
    pub index: u64,
    /// Positions in the left image, pixels.
    pub left_px: Vec<DVec2>,
    /// Positions in the right image, pixels.
    pub right_px: Vec<DVec2>,
    /// Seen only when both views saw it and their rows agree.
    pub state: Vec<MarkerState>,
    /// Positions in the sensor frame, millimetres; of a marker that is not seen, from its last good positions.
    pub points_mm: Vec<DVec3>,
    /// Height above the rest surface, towards the camera, millimetres.
    pub indentation_mm: Vec<f64>,
    /// Indented by more than the threshold (Eq. 4).
    pub salient: Vec<bool>,
    /// Salient and in the contact patch, which is what registration is given.
    pub patch: Vec<bool>,
    /// Mean motion of the seen markers of the left view since the reference, pixels.
    pub motion_px: f64,
    /// Markers that both views saw, but that no point of space explains (rows or disparity disagree).
    pub mismatched: usize,
    /// The left view's evidence.
    pub left: ViewEvidence,
    /// The right view's evidence.
    pub right: ViewEvidence,
}

impl Frame {
    /// Digest of all results, bit for bit.
    #[must_use]
    pub fn digest(&self) -> u64 {
        let view = |digest: Digest, view: &ViewEvidence| {
            digest.u64(view.detected as u64).u64(view.labels as u64).u64(view.relabelled as u64)
        };
        let digest = Digest::new()
            .u64(self.index)
            .f64s(self.left_px.iter().chain(&self.right_px).flat_map(|p| p.to_array()))
            .f64s(self.points_mm.iter().flat_map(|p| p.to_array()))
            .f64s(self.indentation_mm.iter().copied())
            .f64s([self.motion_px])
            .u64(self.mismatched as u64);
        let digest = self.state.iter().fold(digest, |d, &state| d.bytes(&[state as u8]));
        let flags = self.salient.iter().zip(&self.patch);
        let digest =
            flags.fold(digest, |d, (&salient, &patch)| d.bytes(&[u8::from(salient), u8::from(patch)]));
        view(view(digest, &self.left), &self.right).value()
    }

    /// The points of the contact patch in the order of the markers (sensor frame, millimetres); `out` is cleared first.
    pub fn patch_points_mm(&self, out: &mut Vec<DVec3>) {
        out.clear();
        out.extend(self.points_mm.iter().zip(&self.patch).filter(|&(_, &p)| p).map(|(&point, _)| point));
    }
}

/// Which camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// The left one.
    Left,
    /// The right one.
    Right,
}

impl core::fmt::Display for View {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Left => "left",
            Self::Right => "right",
        })
    }
}

/// Why a frame gave no result. Tracks and rest surface are then as after the last good frame.
#[derive(Clone, Debug, PartialEq)]
pub enum PipelineError {
    /// A setting makes no sense.
    Params(ParamsError),
    /// An image is not of the size that the rig was calibrated for.
    Size {
        /// Which view.
        view: View,
        /// Width and height found, pixels.
        found: (usize, usize),
        /// Width and height of the rig's camera, pixels.
        expected: (usize, usize),
    },
    /// Detection failed in one view.
    Detect {
        /// Which view.
        view: View,
        /// Why.
        error: DetectError,
    },
    /// The rest frame could not be labelled in one view.
    Label {
        /// Which view.
        view: View,
        /// Why.
        error: LabelError,
    },
    /// The rest frame's views make no points, or the rig is none.
    Triangulate(TriangulateError),
    /// The rest frame's points make no surface.
    Contact(ContactError),
    /// The rest frame's rows disagree between the views.
    Epipolar {
        /// Median distance of the rectified rows of one marker, pixels.
        median_px: f64,
        /// Largest valid one, pixels.
        max_px: f64,
    },
}

impl core::fmt::Display for PipelineError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Params(error) => error.fmt(f),
            Self::Size { view, found, expected } => write!(
                f,
                "the {view} image is {} x {} pixels but the rig was calibrated for {} x {}",
                found.0, found.1, expected.0, expected.1
            ),
            Self::Detect { view, error } => write!(f, "{view} view: {error}"),
            Self::Label { view, error } => write!(f, "{view} view: {error}"),
            Self::Triangulate(error) => error.fmt(f),
            Self::Contact(error) => error.fmt(f),
            Self::Epipolar { median_px, max_px } => write!(
                f,
                "the rows of the two views disagree by {median_px:.2} px in the median; valid is at most {max_px} px: \
                 the rig does not belong to these cameras, or a row was lost in one view"
            ),
        }
    }
}

impl core::error::Error for PipelineError {}

/// One view's stages, from image to labelled markers.
#[derive(Clone, Debug)]
struct ViewStages {
    view: View,
    size_px: (usize, usize),
    detector: Detector,
    markers: Markers,
    detected: Result<(), DetectError>,
    tracker: Tracker,
    tracks: Tracks,
    pitch_px: f64,
    order: Vec<usize>,
    labelled: Tracks,
    evidence: ViewEvidence,
}

impl ViewStages {
    fn new(view: View, size_px: (usize, usize), params: &Params) -> Self {
        Self {
            view,
            size_px,
            detector: Detector::new(&params.detect),
            markers: Markers::default(),
            detected: Ok(()),
            tracker: Tracker::new(&params.track),
            tracks: Tracks::default(),
            pitch_px: 0.0,
            order: Vec::new(),
            labelled: Tracks::default(),
            evidence: ViewEvidence::default(),
        }
    }

    fn check_size(&self, image: &GrayView<'_>) -> Result<(), PipelineError> {
        let found = (image.width(), image.height());
        if found == self.size_px {
            Ok(())
        } else {
            Err(PipelineError::Size { view: self.view, found, expected: self.size_px })
        }
    }

    fn detect(&mut self, image: GrayView<'_>) {
        self.detected = self.detector.run(image, &mut self.markers);
    }

    fn check_detected(&self) -> Result<(), PipelineError> {
        self.detected.map_err(|error| PipelineError::Detect { view: self.view, error })
    }

    fn start(&mut self, params: &Params) -> Result<(), PipelineError> {
        let lattice = &params.lattice;
        let rest = label::rest_lattice(&self.markers.centres_px, lattice, params.label.tolerance_pitches)
            .map_err(|error| PipelineError::Label { view: self.view, error })?;
        self.pitch_px = rest.pitch_px;
        self.tracker.initialise(&rest, lattice.cols, &mut self.tracks);
        self.tracker.reserve(self.size_px, self.markers.centres_px.capacity());
        self.take_tracks(LabelSource::Rest);
        Ok(())
    }

    fn follow(&mut self, params: &Params) {
        self.tracker.run(&self.markers.centres_px, &mut self.tracks);
        match params.label.method {
            LabelMethod::Temporal => self.take_tracks(LabelSource::Tracks),
            LabelMethod::Foresight => self.sort(&params.lattice, params.label.tolerance_pitches),
        }
    }

    fn take_tracks(&mut self, labels: LabelSource) {
        copy_into(&self.tracks.positions_px, &mut self.labelled.positions_px);
        copy_into(&self.tracks.state, &mut self.labelled.state);
        self.evidence = ViewEvidence { detected: self.markers.centres_px.len(), labels, relabelled: 0 };
    }

    /// Labels as the paper does; where the sort refuses, the tracks' labels stand and the evidence says so.
    fn sort(&mut self, lattice: &LatticeParams, tolerance_pitches: f64) {
        let positions = &self.tracks.positions_px;
        let tolerance_px = tolerance_pitches * self.pitch_px;
        if label::foresight_sort(positions, lattice, tolerance_px, &mut self.order).is_err() {
            return self.take_tracks(LabelSource::Tracks);
        }
        self.labelled.positions_px.clear();
        self.labelled.positions_px.extend(self.order.iter().map(|&i| positions[i]));
        self.labelled.state.clear();
        self.labelled.state.extend(self.order.iter().map(|&i| self.tracks.state[i]));
        self.evidence = ViewEvidence {
            detected: self.markers.centres_px.len(),
            labels: LabelSource::Foresight,
            relabelled: self.order.iter().enumerate().filter(|&(slot, &track)| slot != track).count(),
        };
    }
}

/// Sensing: stereo frames in, tactile point clouds out.
#[derive(Clone, Debug)]
pub struct Pipeline {
    params: Params,
    triangulator: Triangulator,
    left: ViewStages,
    right: ViewStages,
    rest: Option<RestSurface>,
    reference_px: Vec<DVec2>,
    stereo: Vec<StereoPoint>,
    points_mm: Vec<DVec3>,
    frames: u64,
}

impl Pipeline {
    /// For this rig, with these settings. The first frame processed is the rest frame: nothing may touch the gel.
    ///
    /// # Errors
    /// [`PipelineError::Params`], or [`PipelineError::Triangulate`] for an invalid rig.
    pub fn new(rig: &Rig, params: &Params) -> Result<Self, PipelineError> {
        params.validate().map_err(PipelineError::Params)?;
        let triangulator = Triangulator::new(rig, &params.triangulate).map_err(PipelineError::Triangulate)?;
        let size = |camera: &crate::camera::Camera| (camera.width_px, camera.height_px);
        Ok(Self {
            params: params.clone(),
            triangulator,
            left: ViewStages::new(View::Left, size(&rig.left), params),
            right: ViewStages::new(View::Right, size(&rig.right), params),
            rest: None,
            reference_px: Vec::new(),
            stereo: Vec::new(),
            points_mm: Vec::new(),
            frames: 0,
        })
    }

    /// The settings it was made with.
    #[must_use]
    pub const fn params(&self) -> &Params {
        &self.params
    }

    /// The rig it was made for.
    #[must_use]
    pub const fn rig(&self) -> &Rig {
        self.triangulator.rig()
    }

    /// The rest surface, once a rest frame was processed.
    #[must_use]
    pub const fn rest(&self) -> Option<&RestSurface> {
        self.rest.as_ref()
    }

    /// Forgets tracks, rest surface and reference: the next frame is the rest frame.
    pub fn reset(&mut self) {
        self.rest = None;
        self.frames = 0;
    }

    /// Measures [`Frame::motion_px`] from the last processed frame on: the paper's "moment before grasping" or
    /// "before insertion". Until it is called, motion is measured from the rest frame.
    pub fn mark_reference(&mut self) {
        copy_into(&self.left.labelled.positions_px, &mut self.reference_px);
    }

    /// Runs all sensing stages on one stereo frame; the lists of `out` are reused.
    ///
    /// # Errors
    /// [`PipelineError`] naming stage and view.
    pub fn process(
        &mut self,
        left: GrayView<'_>,
        right: GrayView<'_>,
        out: &mut Frame,
    ) -> Result<(), PipelineError> {
        self.process_with(left, right, out, |left, right| {
            left();
            right();
        })
    }

    /// As [`Self::process`], with the detection of the two views handed to `join`, which may run them on two threads
    /// and must run both to the end. The result has the same bits whichever way they are run.
    ///
    /// # Errors
    /// [`PipelineError`] naming stage and view.
    pub fn process_with(
        &mut self,
        left: GrayView<'_>,
        right: GrayView<'_>,
        out: &mut Frame,
        join: impl FnOnce(&mut (dyn FnMut() + Send), &mut (dyn FnMut() + Send)),
    ) -> Result<(), PipelineError> {
        self.left.check_size(&left)?;
        self.right.check_size(&right)?;
        let (left_stages, right_stages) = (&mut self.left, &mut self.right);
        join(&mut || left_stages.detect(left), &mut || right_stages.detect(right));
        // Nothing that lasts has changed so far: a frame that fails here leaves the tracks alone.
        self.left.check_detected()?;
        self.right.check_detected()?;
        if self.rest.is_none() {
            self.start(out)?;
        } else {
            self.left.follow(&self.params);
            self.right.follow(&self.params);
            self.follow_points(out);
        }
        self.finish(out)
    }

    /// The rest frame: here a pair that makes no point is an error.
    fn start(&mut self, out: &mut Frame) -> Result<(), PipelineError> {
        self.left.start(&self.params)?;
        self.right.start(&self.params)?;
        let (left, right) = (&self.left.labelled, &self.right.labelled);
        self.triangulator
            .run(&left.positions_px, &right.positions_px, &mut self.stereo)
            .map_err(PipelineError::Triangulate)?;
        let max_px = self.params.triangulate.max_epipolar_px;
        let mut offsets: Vec<f64> = self.stereo.iter().map(|s| s.epipolar_px.abs()).collect();
        let median_px = crate::math::median(&mut offsets).unwrap_or(0.0);
        if !(median_px <= max_px) {
            return Err(PipelineError::Epipolar { median_px, max_px });
        }
        self.points_mm.clear();
        self.points_mm.extend(self.stereo.iter().map(|s| s.point_mm));
        self.rest = Some(RestSurface::new(&self.points_mm).map_err(PipelineError::Contact)?);
        copy_into(&left.positions_px, &mut self.reference_px);
        self.frames = 0;
        out.mismatched = 0;
        out.state.clear();
        out.state.extend(left.state.iter().zip(&right.state).map(|(&l, &r)| l.max(r)));
        for (stereo, state) in self.stereo.iter().zip(&mut out.state) {
            if stereo.epipolar_px.abs() > max_px && *state == MarkerState::Seen {
                *state = MarkerState::Held;
                out.mismatched += 1;
            }
        }
        Ok(())
    }

    /// Later frames: a pair that makes no point is not this marker, which is then held where it was.
    fn follow_points(&mut self, out: &mut Frame) {
        let max_px = self.params.triangulate.max_epipolar_px;
        out.mismatched = 0;
        out.state.clear();
        let (left, right) = (&self.left.labelled, &self.right.labelled);
        for (i, point_mm) in self.points_mm.iter_mut().enumerate() {
            let mut state = left.state[i].max(right.state[i]);
            match self.triangulator.point(i, left.positions_px[i], right.positions_px[i]) {
                Ok(stereo) if stereo.epipolar_px.abs() <= max_px => *point_mm = stereo.point_mm,
                _ if state == MarkerState::Seen => {
                    state = MarkerState::Held;
                    out.mismatched += 1;
                }
                _ => {}
            }
            out.state.push(state);
        }
    }

    fn finish(&mut self, out: &mut Frame) -> Result<(), PipelineError> {
        out.index = self.frames;
        copy_into(&self.left.labelled.positions_px, &mut out.left_px);
        copy_into(&self.right.labelled.positions_px, &mut out.right_px);
        copy_into(&self.points_mm, &mut out.points_mm);
        if let Some(rest) = &self.rest {
            rest.indentation_mm(&self.points_mm, &mut out.indentation_mm).map_err(PipelineError::Contact)?;
        }
        let contact = &self.params.contact;
        contact::saliency(&out.indentation_mm, &out.state, contact.saliency_mm, &mut out.salient);
        contact::patch(&out.indentation_mm, &out.salient, contact.patch_share, &mut out.patch);
        out.motion_px = contact::mean_motion_px(&self.reference_px, &out.left_px, &out.state);
        out.left = self.left.evidence;
        out.right = self.right.evidence;
        self.frames += 1;
        Ok(())
    }
}

fn copy_into<T: Copy>(from: &[T], to: &mut Vec<T>) {
    to.clear();
    to.extend_from_slice(from);
}
