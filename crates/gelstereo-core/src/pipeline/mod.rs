//! The sensing stages in order, with scratch memory allocated once.

mod bent;
mod centres;
mod common_rest;
mod discs;
mod epipolar;
mod error;
mod feel;
mod frame;
mod heights;
mod label_rest;
mod marker_tracker;
mod pace;
mod pitch;
mod rest_record;
mod resume;
mod skin;
mod view;
mod windows;
mod work;

pub use error::{PipelineError, View};
pub use frame::{Frame, LabelSource, Searched, Touch, ViewEvidence};
pub use marker_tracker::{MarkerTracker, MarkerTrackerError};
pub use pace::Pace;
pub use pitch::PitchCheck;
pub use rest_record::{RestRecord, RestRecordError, RestView};
pub use skin::{Skin, SkinDepth};

use crate::contact::{self, ContactDetector, ContactRule, Decay, MarkerHeights, RestSurface, StereoMismatch};
use crate::detect::DetectError;
use crate::force::{Compliance, ForceEstimator};
use crate::image::GrayView;
use crate::lattice::Topology;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, DVec3};
use crate::params::{DiscBias, Params};
use crate::rig::Rig;
use crate::slip::SlipTracker;
use crate::track::{MarkerState, Tracks};
use crate::triangulate::{Centres, Triangulator};
use alloc::vec::Vec;
use discs::Discs;
use epipolar::{Epipolar, variance_px2};
use heights::Heights;
use view::{ViewStages, share_workloads};

/// Sensing: stereo frames in, tactile point clouds out.
#[derive(Clone, Debug)]
pub struct Pipeline {
    params: Params,
    triangulator: Triangulator,
    left: ViewStages,
    right: ViewStages,
    rest: Option<RestSurface>,
    /// Of the print, since the rest frame.
    topology: Topology,
    left_out: [usize; 4],
    /// With `lattice.depth_mm` above 0, since the rest frame.
    skin: Option<Skin>,
    contact: ContactDetector,
    /// With `force.method`, since the rest frame.
    force: Option<ForceEstimator>,
    /// For `force`, in place of the layer.
    compliance: Option<Compliance>,
    /// With `slip.method`, since the rest frame.
    slip: Option<SlipTracker>,
    /// With `slip.method` and `force.method`: the patch, and its neighbours that the part presses.
    touching: Vec<bool>,
    rest_variance_mm2: Vec<f64>,
    epipolar: Epipolar,
    reference_px: Vec<DVec2>,
    stereo_mismatch: StereoMismatch,
    discs: Discs,
    points_mm: Vec<DVec3>,
    covariance_mm2: Vec<Symmetric<3>>,
    heights: Heights,
    frames: u64,
    /// Whether no frame was processed since resuming from a record.
    resumes: bool,
}

impl Pipeline {
    /// For this rig and these settings. The first frame processed is the rest frame: nothing may touch
    /// the gel.
    ///
    /// # Errors
    /// [`PipelineError::Params`], [`PipelineError::Triangulate`] for an invalid rig, or
    /// [`PipelineError::Detect`] for a region of interest that exceeds a camera's image.
    pub fn new(rig: &Rig, params: &Params) -> Result<Self, PipelineError> {
        params.validate().map_err(PipelineError::Params)?;
        let triangulator = Triangulator::new(rig, &params.triangulate).map_err(PipelineError::Triangulate)?;
        let size = |camera: &crate::camera::Camera| (camera.width_px, camera.height_px);
        for (view, (width, height)) in [(View::Left, size(&rig.left)), (View::Right, size(&rig.right))] {
            let roi_px = params.detect.roi.of(view).rect_px;
            if let Some(error) = roi_px.and_then(|roi_px| DetectError::beyond(roi_px, (width, height))) {
                return Err(PipelineError::Detect { view, error });
            }
        }
        Ok(Self {
            params: params.clone(),
            triangulator,
            left: ViewStages::new(View::Left, size(&rig.left), params),
            right: ViewStages::new(View::Right, size(&rig.right), params),
            rest: None,
            topology: Topology::default(),
            left_out: [0; 4],
            skin: None,
            contact: ContactDetector::new(&params.contact),
            force: None,
            compliance: None,
            slip: None,
            touching: Vec::new(),
            rest_variance_mm2: Vec::new(),
            epipolar: Epipolar::default(),
            reference_px: Vec::new(),
            stereo_mismatch: StereoMismatch::default(),
            discs: Discs::default(),
            points_mm: Vec::new(),
            covariance_mm2: Vec::new(),
            heights: Heights::default(),
            frames: 0,
            resumes: false,
        })
    }

    /// The settings in use.
    #[must_use]
    pub const fn params(&self) -> &Params {
        &self.params
    }

    /// The rig in use.
    #[must_use]
    pub const fn rig(&self) -> &Rig {
        self.triangulator.rig()
    }

    /// The rest surface of the points, once a rest frame was processed: of the skin over the markers, or of
    /// the markers where `lattice.depth_mm` is 0.
    #[must_use]
    pub fn rest(&self) -> Option<&RestSurface> {
        self.skin.as_ref().map(Skin::rest).or(self.rest.as_ref())
    }

    /// The gel's decay length estimated from the contacts since the rest frame; `None` until they
    /// suffice, or without `contact.learn_decay`.
    #[must_use]
    pub fn decay(&self) -> Option<Decay> {
        self.contact.decay()
    }

    /// The rule that found the last frame's contact with `contact.saliency = adaptive`; `None` otherwise,
    /// and without contact.
    #[must_use]
    pub const fn contact_rule(&self) -> Option<ContactRule> {
        self.contact.rule()
    }

    /// Factor applied to the variances of the centres: actual over stated noise, from the epipolar
    /// residuals of the rest frame. 1 before the rest frame, and where the difference may be chance.
    #[must_use]
    pub const fn noise_scale(&self) -> f64 {
        self.epipolar.scale
    }

    /// The print's pitch at rest beside its setting; `None` before the rest frame.
    #[must_use]
    pub fn pitch_check(&self) -> Option<PitchCheck> {
        PitchCheck::new(self.rest.as_ref()?.points_mm(), self.left.cols, self.params.lattice.pitch_mm)
    }

    /// Clears tracks, rest surface and reference: the next frame is the rest frame.
    pub fn reset(&mut self) {
        self.rest = None;
        self.skin = None;
        self.force = None;
        self.slip = None;
        self.left_out = [0; 4];
        self.contact.forget();
        self.epipolar = Epipolar::default();
        self.frames = 0;
        self.resumes = false;
        self.left.forget();
        self.right.forget();
    }

    /// Measures [`Frame::motion_px`] from the last processed frame on: the paper's "moment before
    /// grasping" or "before insertion". Before the first call, motion is measured from the rest frame.
    pub fn mark_reference(&mut self) {
        copy_into(&self.left.labelled().positions_px, &mut self.reference_px);
    }

    /// Runs all sensing stages on one stereo frame; the lists of `out` are reused.
    ///
    /// # Errors
    /// [`PipelineError`] with stage and view.
    pub fn process(
        &mut self,
        left: GrayView<'_>,
        right: GrayView<'_>,
        out: &mut Frame,
    ) -> Result<(), PipelineError> {
        self.process_within(left, right, None, out)
    }

    /// As [`Self::process`], by the best rungs of each stage whose predicted work fits into a limit, in
    /// units of 1000 instructions; [`Pace`] converts time to such units. [`Frame::left`] and
    /// [`Frame::right`] state the rungs.
    ///
    /// Give limits from the rest frame on, which itself is not limited: it prepares the cheaper rungs. A
    /// frame in which only a whole search finds the labels exceeds a limit that no such search fits into. The
    /// result depends on images, settings and limits alone.
    ///
    /// # Errors
    /// [`PipelineError`] with stage and view.
    pub fn process_within(
        &mut self,
        left: GrayView<'_>,
        right: GrayView<'_>,
        limit: Option<u64>,
        out: &mut Frame,
    ) -> Result<(), PipelineError> {
        self.process_with(left, right, limit, out, |left, right| {
            left();
            right();
        })
    }

    /// As [`Self::process_within`], with the detection of the two views passed to `join`, which may run them
    /// on two threads and must run both to completion. The result is bit-identical either way.
    ///
    /// # Errors
    /// [`PipelineError`] with stage and view.
    pub fn process_with(
        &mut self,
        left: GrayView<'_>,
        right: GrayView<'_>,
        limit: Option<u64>,
        out: &mut Frame,
        join: impl FnOnce(&mut (dyn FnMut() + Send), &mut (dyn FnMut() + Send)),
    ) -> Result<(), PipelineError> {
        self.left.check_size(&left)?;
        self.right.check_size(&right)?;
        let after = work::after_detection(&self.params, &self.left.size(&self.params))
            + self.force.as_ref().map_or(0, ForceEstimator::work)
            + self.slip.as_ref().map_or(0, SlipTracker::work);
        let of_view = limit.map(|limit| limit.saturating_sub(after) / 2);
        let (left_stages, right_stages) = (&mut self.left, &mut self.right);
        let (params, follows) = (&self.params, self.rest.is_some());
        join(&mut || left_stages.detect(left, params, follows, of_view), &mut || {
            right_stages.detect(right, params, follows, of_view);
        });
        (out.work, out.work_limit) = (after + self.left.work + self.right.work, limit);
        // No persistent state has changed so far: a frame that fails here leaves the tracks unchanged.
        self.left.check_detected()?;
        self.right.check_detected()?;
        let begins =
            limit.is_some() && (self.left.begin_limits(&self.params) | self.right.begin_limits(&self.params));
        if self.rest.is_none() {
            self.start(out)?;
            self.left.prepare(left, &self.params);
            self.right.prepare(right, &self.params);
            share_workloads(&mut self.left, &mut self.right);
        } else {
            self.left.follow(&self.params);
            self.right.follow(&self.params);
            self.follow_points(out)?;
            if core::mem::take(&mut self.resumes) || begins {
                self.left.prepare(left, &self.params);
                self.right.prepare(right, &self.params);
                share_workloads(&mut self.left, &mut self.right);
            }
        }
        self.finish(out)
    }

    /// Processes the rest frame: here a pair without a point is an error.
    fn start(&mut self, out: &mut Frame) -> Result<(), PipelineError> {
        let [left_rest, right_rest] = self.label_rest()?;
        self.left.begin(&self.params, &left_rest);
        self.right.begin(&self.params, &right_rest);
        self.left_out = left_rest.left_out;
        let (left, right) = (self.left.labelled(), self.right.labelled());
        let mut stereo = Vec::with_capacity(left.positions_px.len());
        self.triangulator
            .run(centres(left), centres(right), &mut stereo)
            .map_err(PipelineError::Triangulate)?;
        let max_px = self.params.triangulate.max_epipolar_px;
        let mut offsets: Vec<f64> = stereo.iter().map(|s| s.epipolar_px.abs()).collect();
        let median_px = crate::math::median(&mut offsets).unwrap_or(0.0);
        if !(median_px <= max_px) {
            return Err(PipelineError::Epipolar { median_px, max_px });
        }
        self.points_mm.clear();
        self.points_mm.extend(stereo.iter().map(|s| s.point_mm));
        self.topology = Topology::of(self.params.lattice.layout, self.left.cols, &self.points_mm);
        let pitch = PitchCheck::new(&self.points_mm, self.left.cols, self.params.lattice.pitch_mm);
        if let Some(pitch) = pitch.filter(PitchCheck::is_absurd) {
            return Err(PipelineError::Pitch { found_mm: pitch.measured_mm, expected: pitch.expected });
        }
        self.covariance_mm2.clear();
        let state = left.state.iter().zip(&right.state).map(|(&l, &r)| l.max(r));
        out.state.clear();
        out.state.extend(state);
        let views = (centres(left), centres(right));
        self.epipolar = Epipolar::learn(self.topology, &stereo, &out.state, views.0, views.1);
        self.covariance_mm2.extend(stereo.iter().enumerate().map(|(i, stereo)| {
            let variance_px2 = variance_px2(views.0, views.1, i);
            scaled(&stereo.covariance_mm2, self.epipolar.widening(i, stereo.epipolar_px, variance_px2))
        }));
        self.discs = Discs::default();
        if self.params.triangulate.disc_bias == DiscBias::Corrected {
            let lattice = &self.params.lattice;
            let radius_pitches =
                lattice.dot_radius_mm.map(|radius_mm| radius_mm / lattice.pitch_mm.mean_mm());
            let area_px2 = self.left.median_area_px2();
            let ready = self.triangulator.ready();
            self.discs.start(self.topology, radius_pitches, area_px2, &ready, &self.points_mm);
            self.discs.correct(&ready, centres(left), centres(right), &mut self.points_mm);
        }
        let rest = RestSurface::new(&self.points_mm).map_err(PipelineError::Contact)?;
        let variances = self.covariance_mm2.iter().map(|c| contact::variance_along(c, rest.normal()));
        self.rest_variance_mm2.clear();
        self.rest_variance_mm2.extend(variances);
        out.mismatched = 0;
        for (stereo, state) in stereo.iter().zip(&mut out.state) {
            if stereo.epipolar_px.abs() > max_px && *state == MarkerState::Seen {
                *state = MarkerState::Held;
                out.mismatched += 1;
            }
        }
        copy_into(&self.points_mm, &mut out.points_mm);
        copy_into(&self.covariance_mm2, &mut out.covariance_mm2);
        rest.indentation_mm(&self.points_mm, &mut out.indentation_mm).map_err(PipelineError::Contact)?;
        self.frames = 0;
        self.rest_on(rest)
    }

    /// Uses this surface, of the views' present tracks, as the rest surface.
    fn rest_on(&mut self, rest: RestSurface) -> Result<(), PipelineError> {
        let (left, right) = (self.left.labelled(), self.right.labelled());
        self.contact.start(&rest, self.topology).map_err(PipelineError::Contact)?;
        let (cols, pitch_px) = (self.left.cols, self.left.pitch_px);
        self.stereo_mismatch.learn(
            &self.triangulator,
            &rest,
            [centres(left), centres(right)],
            cols,
            pitch_px,
        );
        copy_into(&left.positions_px, &mut self.reference_px);
        let depth = SkinDepth::of(&self.params.lattice);
        let skin = depth.map(|depth| Skin::new(&rest, self.topology, depth)).transpose();
        let skin = skin.map_err(PipelineError::Contact)?;
        self.feel_on(skin.as_ref().map_or(&rest, Skin::rest))?;
        (self.skin, self.rest) = (skin, Some(rest));
        Ok(())
    }

    /// Processes later frames. A pair without a point, or off this surface, is a mismatch, and the marker
    /// is held in place.
    fn follow_points(&mut self, out: &mut Frame) -> Result<(), PipelineError> {
        let Some(rest) = &self.rest else { return Ok(()) };
        if self.frames == 1 {
            // Not in the rest frame itself, so that a single frame needs no fit.
            self.triangulator.begin_map(rest.points_mm());
        } else {
            self.triangulator.continue_map();
        }
        let max_px = self.params.triangulate.max_epipolar_px;
        out.mismatched = 0;
        out.state.clear();
        copy_into(&self.points_mm, &mut out.points_mm);
        copy_into(&self.covariance_mm2, &mut out.covariance_mm2);
        let (left, right) = (self.left.labelled(), self.right.labelled());
        let ready = self.triangulator.ready();
        self.discs.fresh.clear();
        self.discs.fresh.reserve(self.points_mm.len());
        for (i, point_mm) in out.points_mm.iter_mut().enumerate() {
            let mut state = left.state[i].max(right.state[i]);
            match ready.point(i, &centres(left).at(i), &centres(right).at(i)) {
                Ok(stereo) if stereo.epipolar_px.abs() <= max_px => {
                    *point_mm = stereo.point_mm;
                    let variance_px2 = variance_px2(centres(left), centres(right), i);
                    let widening = self.epipolar.widening(i, stereo.epipolar_px, variance_px2);
                    out.covariance_mm2[i] = scaled(&stereo.covariance_mm2, widening);
                    self.discs.fresh.push(i);
                }
                _ if state == MarkerState::Seen => {
                    state = MarkerState::Held;
                    out.mismatched += 1;
                }
                _ => {}
            }
            out.state.push(state);
        }
        self.discs.correct(&ready, centres(left), centres(right), &mut out.points_mm);
        rest.indentation_mm(&out.points_mm, &mut out.indentation_mm).map_err(PipelineError::Contact)?;
        let Frame { indentation_mm, state, points_mm, covariance_mm2, mismatched, .. } = out;
        *mismatched += self.stereo_mismatch.hold(indentation_mm, state, |i| {
            (points_mm[i], covariance_mm2[i]) = (self.points_mm[i], self.covariance_mm2[i]);
        });
        rest.indentation_mm(points_mm, indentation_mm).map_err(PipelineError::Contact)?;
        copy_into(&out.points_mm, &mut self.points_mm);
        copy_into(&out.covariance_mm2, &mut self.covariance_mm2);
        let clouds = (rest.points_mm(), out.points_mm.as_slice());
        bent::add(self.topology, self.discs.radius_pitches(), clouds, &mut out.covariance_mm2);
        Ok(())
    }

    fn finish(&mut self, out: &mut Frame) -> Result<(), PipelineError> {
        out.index = self.frames;
        copy_into(&self.left.labelled().positions_px, &mut out.left_px);
        copy_into(&self.right.labelled().positions_px, &mut out.right_px);
        (out.rows, out.cols) = (self.left.rows, self.left.cols);
        let normal = self.rest.as_ref().map_or(DVec3::Z, RestSurface::normal);
        self.heights.judge(&self.covariance_mm2, &self.rest_variance_mm2, normal, &out.state);
        let Heights { variance_mm2, state, .. } = &self.heights;
        let seen = MarkerHeights { indentation_mm: &out.indentation_mm, variance_mm2, state };
        self.contact.run(&seen, &mut out.salient).map_err(PipelineError::Contact)?;
        let share = self.params.contact.patch_share;
        contact::patch(&out.indentation_mm, &out.salient, share, &mut out.patch);
        out.decay_mm = self.contact.decay_mm();
        if let Some(skin) = &mut self.skin {
            skin.lift(&mut out.points_mm, &mut out.covariance_mm2);
            let rest = skin.rest();
            rest.indentation_mm(&out.points_mm, &mut out.indentation_mm).map_err(PipelineError::Contact)?;
        }
        out.offset_sigma_mm = self.params.lattice.depth_sigma_mm;
        self.feel(normal, out)?;
        out.motion_px = contact::mean_motion_px(&self.reference_px, &out.left_px, &out.state);
        out.left = self.left.evidence;
        out.right = self.right.evidence;
        self.frames += 1;
        Ok(())
    }
}

fn centres(tracks: &Tracks) -> Centres<'_> {
    Centres { positions_px: &tracks.positions_px, covariance_px2: &tracks.covariance_px2 }
}

fn scaled<const N: usize>(matrix: &Symmetric<N>, scale: f64) -> Symmetric<N> {
    matrix.map(|row| row.map(|entry| scale * entry))
}

fn copy_into<T: Copy>(from: &[T], to: &mut Vec<T>) {
    to.clear();
    to.extend_from_slice(from);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;

    fn pipeline() -> Pipeline {
        let camera = Camera {
            width_px: 640,
            height_px: 480,
            fx_px: 560.0,
            fy_px: 560.0,
            cx_px: 320.0,
            cy_px: 240.0,
            distortion: [0.0; 5],
        };
        Pipeline::new(&Rig::parallel(camera, 8.0), &Params::default()).unwrap()
    }

    /// The noise of one gel goes into its record, and is not the next one's.
    #[test]
    fn measured_noise_is_recorded_and_forgotten() {
        let mut pipeline = pipeline();
        let points_mm = [DVec3::ZERO, DVec3::X, DVec3::Y];
        pipeline.rest = Some(RestSurface::new(&points_mm).unwrap());
        pipeline.epipolar = Epipolar::resume(Topology::square(1, 3), 2.5, None);
        assert_eq!(pipeline.noise_scale(), 2.5);
        assert_eq!(pipeline.rest_record().map(|record| record.noise_scale), Some(2.5));
        pipeline.reset();
        assert_eq!(pipeline.noise_scale(), 1.0);
        assert_eq!(pipeline.rest_record(), None);
    }
}
