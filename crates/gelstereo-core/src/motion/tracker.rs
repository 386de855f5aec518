//! Follows a part from keyframe to keyframe.

use super::answer::{MotionSource, MotionStatus, PartMotion, SurfacePoint};
use super::chain::product;
use super::cloud::{Cloud, Element, pitch_mm};
use super::fit::{Fitted, Pair, Problem, inverse};
use super::loops::Loops;
use super::travel::{Hold, MotionKind, Travel, TravelMeter};
use crate::contact::RestSurface;
use crate::force::MovedMarkers;
use crate::lattice::Topology;
use crate::math::{DVec3, Pose};
use crate::params::{MotionParams, SlipParams};
use crate::slip::{RigidMotion, Slip, SlipError, SlipStatus, SlipTracker, Stick};
use alloc::vec::Vec;

/// Fewest markers of a rigid motion.
const MIN_MARKERS: usize = 3;
/// The part has hardly moved since the last frame, so that matches settle soon.
const MATCHING_ROUNDS: u32 = 4;

/// The frame that later ones are compared with.
#[derive(Clone, Debug)]
struct Keyframe {
    cloud: Cloud,
    /// Markers that have stuck in all frames since.
    held: Vec<bool>,
    pose: RigidMotion,
    /// Motion from here to the last frame.
    to_last: Pose,
    /// Frames since.
    frames: u32,
    /// Markers in contact in this frame.
    markers: usize,
}

impl Keyframe {
    fn set(&mut self, cloud: &Cloud, pose: RigidMotion) {
        self.cloud.copy(cloud);
        for (held, element) in self.held.iter_mut().zip(&cloud.elements) {
            *held = element.is_used;
        }
        self.markers = self.held.iter().filter(|&&held| held).count();
        (self.pose, self.to_last, self.frames) = (pose, Pose::IDENTITY, 0);
    }
}

/// Follows a part without a model, from frame to frame. It allocates nothing after it was made.
#[derive(Clone, Debug)]
pub struct MotionTracker {
    params: MotionParams,
    /// Squared deviation, in variances, beyond which a length is no noise.
    gate: f64,
    slip: SlipTracker,
    stick: Vec<Stick>,
    pitch_mm: f64,
    now: Cloud,
    last: Cloud,
    /// Of the last frame.
    last_pose: RigidMotion,
    /// From the keyframe to the last frame.
    since_keyframe: RigidMotion,
    was_held: bool,
    /// Whether enough elements of the last frame were matched with the keyframe's.
    is_surface_left: bool,
    in_contact: bool,
    contacts: u32,
    keyframes: u32,
    keyframe: Keyframe,
    loops: Loops,
    meter: TravelMeter,
    pairs: Vec<Pair>,
    surface: Vec<Element>,
    known: Vec<Element>,
    matches: Vec<Option<usize>>,
}

const AT_REST: RigidMotion =
    RigidMotion { pose: Pose::IDENTITY, about_mm: DVec3::ZERO, covariance: [[0.0; 6]; 6] };

impl MotionTracker {
    /// For the markers of this rest surface, row by row, `cols` in each. Slip is found with `slip`, even if
    /// its method is `none`.
    ///
    /// # Errors
    /// [`SlipError::Params`], or [`SlipError::Lattice`] unless the markers fill whole rows.
    pub fn new(
        slip: &SlipParams,
        params: &MotionParams,
        rest: &RestSurface,
        cols: usize,
    ) -> Result<Self, SlipError> {
        let rows = rest.points_mm().len().checked_div(cols).unwrap_or(0);
        Self::on(slip, params, rest, Topology::square(rows, cols))
    }

    /// As [`Self::new`], for a print of any topology.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn on(
        slip: &SlipParams,
        params: &MotionParams,
        rest: &RestSurface,
        topology: Topology,
    ) -> Result<Self, SlipError> {
        params.validate().map_err(SlipError::Params)?;
        let tracker = SlipTracker::on(slip, rest, topology)?;
        let (markers, up) = (tracker.markers(), rest.normal());
        let cloud = Cloud::new(topology, up);
        let keyframe = Keyframe {
            cloud: cloud.clone(),
            held: alloc::vec![false; markers],
            pose: AT_REST,
            to_last: Pose::IDENTITY,
            frames: 0,
            markers: 0,
        };
        Ok(Self {
            params: params.clone(),
            gate: slip.gate(1),
            slip: tracker,
            stick: Vec::with_capacity(markers),
            pitch_mm: pitch_mm(rest.points_mm(), topology.cols()),
            last: cloud.clone(),
            last_pose: AT_REST,
            since_keyframe: AT_REST,
            was_held: false,
            is_surface_left: true,
            in_contact: false,
            contacts: 0,
            keyframes: 0,
            keyframe,
            loops: Loops::new(params.loop_keyframes as usize),
            meter: TravelMeter::new(params.window_frames, rest.points_mm(), up),
            now: cloud,
            pairs: Vec::with_capacity(markers),
            surface: Vec::with_capacity(markers),
            known: Vec::with_capacity(markers),
            matches: Vec::with_capacity(markers),
        })
    }

    /// Number of markers.
    #[must_use]
    pub fn markers(&self) -> usize {
        self.slip.markers()
    }

    /// Whether each marker of the last frame sticks.
    #[must_use]
    pub fn stick(&self) -> &[Stick] {
        &self.stick
    }

    /// The part's surface in the last frame, in the part's frame: the sensor frame at first touch. Empty
    /// without contact.
    pub fn surface(&self) -> impl Iterator<Item = SurfacePoint> {
        let back = self.last_pose.pose.inverse();
        // A point stands for the surface up to half a marker distance away.
        let half_mm = 0.5 * self.pitch_mm;
        let elements = self.last.elements.iter().filter(|e| self.in_contact && e.has_normal());
        elements.map(move |e| SurfacePoint {
            point_mm: back.transform_point(e.point_mm),
            normal: back.transform_vector(e.normal),
            variance_mm2: e.normal.dot(e.covariance_mm2 * e.normal) + half_mm * half_mm * e.sharpness,
        })
    }

    /// Keyframes of the last contact that are remembered, by number, with the motion from first touch to them
    /// and its covariance about the contact's centroid. A loop corrects those before it.
    pub fn keyframes(&self) -> impl Iterator<Item = (u32, RigidMotion)> {
        self.loops.keyframes()
    }

    /// Forgets the contact: the next frame is the first touch.
    pub fn restart(&mut self) {
        self.slip.restart();
        self.end();
    }

    fn end(&mut self) {
        self.contacts += u32::from(self.in_contact);
        self.in_contact = false;
    }

    /// The part's motion up to this frame; `None` without contact.
    ///
    /// # Errors
    /// [`SlipError::Lengths`].
    pub fn run(&mut self, moved: &MovedMarkers<'_>) -> Result<Option<PartMotion>, SlipError> {
        let Some(slip) = self.slip.run(moved, &mut self.stick)? else {
            self.end();
            return Ok(None);
        };
        self.now.fill(moved);
        let Some(about_mm) = self.now.centroid_mm() else {
            // In contact, but no marker is seen: the part is not followed.
            self.keyframe.frames = self.keyframe.frames.saturating_add(1);
            return Ok(self.in_contact.then(|| self.unseen(slip)));
        };
        let motion = if self.in_contact { self.follow(slip, about_mm) } else { self.start(slip, about_mm) };
        self.last.copy(&self.now);
        self.last_pose = motion.since_touch;
        Ok(Some(motion))
    }

    fn start(&mut self, slip: Slip, about_mm: DVec3) -> PartMotion {
        self.in_contact = true;
        self.keyframes = 0;
        self.was_held = false;
        self.pairs.clear();
        let pose = RigidMotion { about_mm, ..AT_REST };
        self.keyframe.set(&self.now, pose);
        self.since_keyframe = pose;
        self.loops.start(about_mm, &self.now);
        self.meter.start(&self.now);
        self.answer(slip, MotionStatus::Started, pose, pose)
    }

    fn follow(&mut self, slip: Slip, about_mm: DVec3) -> PartMotion {
        self.keyframe.frames = self.keyframe.frames.saturating_add(1);
        self.find_pairs(slip.status);
        if self.keyframe.frames > 1 && self.is_due(slip.status) {
            // The last frame shares more with this one than this one with the keyframe.
            self.set_keyframe_to_last();
            self.find_pairs(slip.status);
        }
        self.find_surface();
        let Some(fitted) = self.fit(about_mm) else { return self.unseen(slip) };
        let mut motion = self.advance(slip, &fitted);
        let like = self.problem();
        if let Some([keyframe, now]) = self.loops.pass(&fitted.motion, self.keyframes + 1, &self.now, &like) {
            (self.keyframe.pose, motion.since_touch) = (keyframe, now);
            (motion.keyframe_pose, motion.loops) = (keyframe.pose, self.loops.closed);
        }
        motion
    }

    /// Drops markers that do not stick from the keyframe. Those that are not seen are kept.
    fn drop_lost(&mut self) {
        for ((held, stick), element) in self.keyframe.held.iter_mut().zip(&self.stick).zip(&self.now.elements)
        {
            let sticks = match stick {
                Stick::Stuck => true,
                Stick::Unknown => !element.is_used,
                Stick::Free | Stick::Slips => false,
            };
            *held &= sticks;
        }
    }

    /// Markers that stick; none if fewer than three do. Those left in gross slip creep together, too slowly
    /// to be found out.
    fn find_pairs(&mut self, slip: SlipStatus) {
        self.drop_lost();
        self.pairs.clear();
        if slip == SlipStatus::Gross {
            return;
        }
        let Keyframe { cloud, held, to_last, .. } = &self.keyframe;
        let turn = to_last.matrix();
        let now = self.now.elements.iter().zip(held);
        for (anchor, (now, held)) in cloud.elements.iter().zip(now) {
            if !*held || !now.is_used {
                continue;
            }
            let covariance = now.covariance_mm2 + turn * anchor.covariance_mm2 * turn.transpose();
            if let Some(weight) = inverse(&covariance) {
                self.pairs.push(Pair { anchor_mm: anchor.point_mm, point_mm: now.point_mm, weight });
            }
        }
        if self.pairs.len() < MIN_MARKERS {
            self.pairs.clear();
        }
    }

    /// Surface elements now that are not used as points, and those of the keyframe.
    fn find_surface(&mut self) {
        let by_markers = !self.pairs.is_empty();
        let held = &self.keyframe.held;
        let now = self.now.elements.iter().zip(held);
        self.surface.clear();
        self.surface
            .extend(now.filter(|(e, held)| e.has_normal() && !(by_markers && **held)).map(|(e, _)| *e));
        self.known.clear();
        self.known.extend(self.keyframe.cloud.elements.iter().filter(|e| e.has_normal()));
    }

    fn fit(&mut self, about_mm: DVec3) -> Option<Fitted> {
        let problem = Problem {
            pairs: &self.pairs,
            now: &self.surface,
            before: &self.known,
            about_mm,
            frames: f64::from(self.keyframe.frames),
            ..self.problem()
        };
        problem.fit(&self.keyframe.to_last, &mut self.matches)
    }

    /// What all fits have in common.
    fn problem(&self) -> Problem<'static> {
        Problem {
            pairs: &[],
            now: &[],
            before: &[],
            about_mm: DVec3::ZERO,
            pitch_mm: self.pitch_mm,
            surface_sigma_mm: self.params.surface_sigma_mm,
            free: [self.params.free_turn_rad, self.params.free_shift_mm],
            frames: 1.0,
            matching_rounds: MATCHING_ROUNDS,
        }
    }

    fn advance(&mut self, slip: Slip, fitted: &Fitted) -> PartMotion {
        let since_touch = product(&fitted.motion, &self.keyframe.pose);
        let step = RigidMotion {
            pose: fitted.motion.pose * self.keyframe.to_last.inverse(),
            about_mm: fitted.motion.about_mm,
            covariance: fitted.step_covariance,
        };
        self.keyframe.to_last = fitted.motion.pose;
        self.since_keyframe = fitted.motion;
        let source = match (self.pairs.is_empty(), fitted.matched) {
            (true, 0) => MotionSource::Nothing,
            (false, 0) => MotionSource::Markers,
            (true, _) => MotionSource::Surface,
            (false, _) => MotionSource::Both,
        };
        let status = match fitted.determined {
            0 => MotionStatus::Predicted,
            6 => MotionStatus::Tracked,
            _ => MotionStatus::Partial,
        };
        let is_held = !self.pairs.is_empty();
        let travel = self.meter.travel(&step, &self.last, &self.now);
        let mut motion = self.answer(slip, status, since_touch, step);
        motion.source = source;
        motion.determined = fitted.determined;
        motion.surface = fitted.matched;
        motion.travel = travel;
        let hold = match slip.status {
            SlipStatus::Gross => Hold::Slides,
            _ if is_held => Hold::Sticks,
            _ => Hold::Unknown,
        };
        motion.kind = travel.kind(self.gate, hold);
        self.is_surface_left = !self.is_less(fitted.matched as usize, self.surface.len());
        self.was_held = is_held;
        motion
    }

    /// Whether too little is left of the keyframe.
    fn is_due(&self, slip: SlipStatus) -> bool {
        if self.pairs.len() < MIN_MARKERS {
            // Without markers that stick, the keyframe's surface is kept as long as the part slides on it.
            return self.was_held || slip != SlipStatus::Gross || !self.is_surface_left;
        }
        let stuck = self.stick.iter().filter(|&&stick| stick == Stick::Stuck).count();
        self.is_less(self.pairs.len(), self.keyframe.markers) || self.is_less(self.pairs.len(), stuck)
    }

    fn is_less(&self, left: usize, of: usize) -> bool {
        (left as f64) < self.params.keyframe_share * of as f64
    }

    fn set_keyframe_to_last(&mut self) {
        self.keyframes = self.keyframes.saturating_add(1);
        let like = self.problem();
        if let Some(corrected) = self.loops.add(&self.since_keyframe, self.keyframes, &self.last, &like) {
            self.last_pose = corrected;
        }
        self.keyframe.set(&self.last, self.last_pose);
        self.since_keyframe = RigidMotion { about_mm: self.last_pose.about_mm, ..AT_REST };
        self.keyframe.frames = 1;
    }

    /// The answer in a frame in which the part is not seen: where it was, with the variance of free motion.
    fn unseen(&mut self, slip: Slip) -> PartMotion {
        let [turn, shift] = [self.params.free_turn_rad, self.params.free_shift_mm].map(|sigma| sigma * sigma);
        let mut step = RigidMotion { about_mm: self.last_pose.about_mm, ..AT_REST };
        for k in 0..6 {
            step.covariance[k][k] = if k < 3 { turn } else { shift };
        }
        let since_touch = product(&step, &self.last_pose);
        self.since_keyframe = product(&step, &self.since_keyframe);
        self.last_pose = since_touch;
        self.answer(slip, MotionStatus::Predicted, since_touch, step)
    }

    fn answer(
        &self,
        slip: Slip,
        status: MotionStatus,
        since_touch: RigidMotion,
        step: RigidMotion,
    ) -> PartMotion {
        PartMotion {
            status,
            source: MotionSource::Nothing,
            kind: MotionKind::Unknown,
            since_touch,
            step,
            keyframe_pose: self.keyframe.pose.pose,
            determined: 0,
            contact: self.contacts,
            keyframe: self.keyframes,
            loops: self.loops.closed,
            stuck: self.pairs.len() as u32,
            surface: 0,
            travel: Travel::default(),
            slip,
        }
    }
}
