//! Frames of a printed lattice that moves and bends, with every marker's identity.

use super::paper_lattice;
use gelstereo_core::detect::Markers;
use gelstereo_core::lattice::RestLattice;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, cos, exp, sin};
use gelstereo_core::params::TrackParams;
use gelstereo_core::track::{Certainty, MarkerState, Tracks, VerifiedTracker};

pub const PITCH_PX: f64 = 17.56;
pub const SIDE: usize = 25;
pub const MARKERS: usize = SIDE * SIDE;
pub const SIZE_PX: (usize, usize) = (640, 480);
/// Closer to the image's border a marker is cut off and not detected.
const CUT_PX: f64 = 5.0;

/// How the gel is bent and moved against the rest frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Warp {
    /// Middle of the contact.
    pub contact_px: DVec2,
    /// 1/e radius of what the contact does.
    pub radius_px: f64,
    /// A press brings the surface nearer, so that it looks larger: displacement away from the principal
    /// point, per pixel from it. 2 mm at 28 mm are 0.077.
    pub press: f64,
    /// Motion of the contact, pixels.
    pub shear_px: DVec2,
    /// Turn of the contact.
    pub twist_rad: f64,
    /// Turn of the whole lattice.
    pub turn_rad: f64,
    /// Motion of the whole lattice, pixels.
    pub shift_px: DVec2,
}

impl Warp {
    pub fn new() -> Self {
        Self { contact_px: DVec2::new(300.0, 260.0), radius_px: 6.0 * PITCH_PX, ..Self::default() }
    }

    pub fn apply(&self, rest: DVec2) -> DVec2 {
        let middle = DVec2::new(330.3, 240.7);
        let arm = rest - self.contact_px;
        let near = exp(-arm.length_squared() / (self.radius_px * self.radius_px));
        let press = (rest - middle) * (self.press * near);
        let bent = self.contact_px + DVec2::from_angle(self.twist_rad * near).rotate(arm) + press;
        let turn = DVec2::new(cos(self.turn_rad), sin(self.turn_rad));
        middle + turn.rotate(bent + self.shear_px * near - middle) + self.shift_px
    }
}

/// What the detector makes of a frame.
#[derive(Clone, Debug)]
pub struct Seeing {
    pub sigma_px: f64,
    /// Share of markers missed.
    pub missing: f64,
    /// Pairs of neighbours that are found as one.
    pub merged: usize,
    /// Detections that are no marker.
    pub specks: usize,
    /// Markers that do not exist.
    pub unprinted: &'static [usize],
    /// Middle and radius of a smear that hides what lies below it.
    pub smear: Option<(DVec2, f64)>,
}

impl Default for Seeing {
    fn default() -> Self {
        Self { sigma_px: 0.1, missing: 0.0, merged: 0, specks: 0, unprinted: &[], smear: None }
    }
}

/// Detections, and which marker each is.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    pub markers: Markers,
    pub identity: Vec<Option<usize>>,
}

pub fn see(rest_px: &[DVec2], warp: &Warp, seeing: &Seeing, stream: &mut Stream) -> Seen {
    let mut found: Vec<(DVec2, Option<usize>)> = Vec::new();
    let truth: Vec<DVec2> = rest_px.iter().map(|&p| warp.apply(p)).collect();
    let mut present: Vec<bool> = truth.iter().map(|_| stream.uniform() >= seeing.missing).collect();
    for &n in seeing.unprinted {
        present[n] = false;
    }
    for _ in 0..seeing.merged {
        let (row, col) = (stream.below(SIDE - 1), stream.below(SIDE - 1));
        let n = row * SIDE + col;
        let m = n + if stream.below(2) == 0 { 1 } else { SIDE };
        if present[n] && present[m] {
            (present[n], present[m]) = (false, false);
            found.push(((truth[n] + truth[m]) * 0.5, None));
        }
    }
    found.extend((0..MARKERS).filter(|&n| present[n]).map(|n| (truth[n], Some(n))));
    for _ in 0..seeing.specks {
        let at = DVec2::new(stream.uniform() * SIZE_PX.0 as f64, stream.uniform() * SIZE_PX.1 as f64);
        // Nearer to where a marker should be, nothing tells it from the marker.
        if truth.iter().all(|t| t.distance(at) > 0.4 * PITCH_PX) {
            found.push((at, None));
        }
    }
    let far = DVec2::new(SIZE_PX.0 as f64 - CUT_PX, SIZE_PX.1 as f64 - CUT_PX);
    let mut seen = Seen::default();
    let mut centres = Vec::new();
    for (at, identity) in found {
        let (x, y) = stream.normal_pair();
        let at = at + DVec2::new(x, y) * seeing.sigma_px;
        let hidden = seeing.smear.is_some_and(|(middle, radius)| at.distance(middle) < radius);
        if at.cmpgt(DVec2::splat(CUT_PX)).all() && at.cmplt(far).all() && !hidden {
            centres.push(at);
            seen.identity.push(identity);
        }
    }
    // Detections come in no particular order.
    for n in (1..centres.len()).rev() {
        let other = stream.below(n + 1);
        centres.swap(n, other);
        seen.identity.swap(n, other);
    }
    seen.markers = Markers::at(centres, seeing.sigma_px);
    seen
}

/// The checked tracker at work, with what it got right and wrong.
pub struct Run {
    pub tracker: VerifiedTracker,
    pub tracks: Tracks,
    pub rest_px: Vec<DVec2>,
    pub stream: Stream,
    pub frames: usize,
    pub certain: usize,
    /// Markers identified, in all frames.
    pub seen: usize,
    /// Of those, how many stand on a speck or a merged pair.
    pub strays: usize,
    /// Markers identified in the last frame.
    pub last_seen: usize,
    /// Markers that were detected in the last frame, but not identified.
    pub missed: Vec<usize>,
}

impl Run {
    /// From a rest frame in this pose; `unprinted` markers do not exist.
    pub fn start(params: &TrackParams, pose: &Warp, unprinted: &[usize], seed: u64) -> Self {
        let rest_px: Vec<DVec2> = paper_lattice().into_iter().map(|p| pose.apply(p)).collect();
        let rest = RestLattice {
            rows: SIDE,
            cols: SIDE,
            positions_px: rest_px.clone(),
            detection: (0..MARKERS).map(|n| (!unprinted.contains(&n)).then_some(n as u32)).collect(),
            pitch_px: PITCH_PX,
            left_out: [0; 4],
        };
        let (mut tracker, mut tracks) = (VerifiedTracker::new(params, SIZE_PX), Tracks::default());
        tracker.initialise(&rest, &Markers::at(rest_px, 0.1), 4000, &mut tracks);
        Self {
            tracker,
            tracks,
            rest_px: paper_lattice(),
            stream: Stream::new(seed, "frames"),
            frames: 0,
            certain: 0,
            seen: 0,
            strays: 0,
            last_seen: 0,
            missed: Vec::new(),
        }
    }

    /// Tracks one frame; an error names the markers that are taken for others.
    pub fn step(&mut self, warp: &Warp, seeing: &Seeing) -> Result<Certainty, String> {
        let frame = see(&self.rest_px, warp, seeing, &mut self.stream);
        let verdict = self.tracker.run(&frame.markers, &mut self.tracks);
        self.frames += 1;
        self.certain += usize::from(verdict == Certainty::Certain);
        self.missed = frame.identity.iter().flatten().copied().collect();
        self.missed.retain(|&n| self.tracks.state[n] != MarkerState::Seen);
        self.last_seen = 0;
        let mut wrong = Vec::new();
        for (n, _) in self.tracks.state.iter().enumerate().filter(|(_, s)| **s == MarkerState::Seen) {
            self.last_seen += 1;
            let here = self.tracks.positions_px[n];
            let found = frame.markers.centres_px.iter().position(|&p| p == here);
            match found.map(|m| frame.identity[m]) {
                Some(Some(identity)) if identity == n => {}
                Some(None) => self.strays += 1,
                other => wrong.push((n, other)),
            }
        }
        self.seen += self.last_seen;
        if wrong.is_empty() {
            Ok(verdict)
        } else {
            Err(format!("frame {}: {} of {} wrong: {wrong:?}", self.frames, wrong.len(), self.last_seen))
        }
    }
}
