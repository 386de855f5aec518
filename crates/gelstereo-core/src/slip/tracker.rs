//! Follows the markers of a contact and tells which of them slip.

use super::error::SlipError;
use super::fit::{Pair, RigidMotion, columns, rigid};
use super::margin::Margin;
use super::stick::{Slip, SlipStatus, Stick};
use crate::contact::RestSurface;
use crate::force::MovedMarkers;
use crate::lattice::Topology;
use crate::math::linalg::Symmetric;
use crate::math::{DMat3, DVec3, Factor, Pose, abs, hypot, sqrt};
use crate::params::SlipParams;
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Fewest markers of a rigid motion.
const MIN_MARKERS: usize = 3;
/// Lower end of the stick range below which the part is not held. Against the frame in which less than 0.1 of
/// the true contact sticks, 37 simulated drags and twists with noise were reported at least 7, 1 and 0 frames
/// late with 0.1, 0.15 and 0.2; 4, 7 and 9 of 59 others were reported, too.
const HELD: f64 = 0.2;
/// Width of the rim of a patch in which markers may be in contact unseen, in pitches: patches leave out
/// markers that are hardly pressed. With 0.5, 0.8 and 1, the range holds the true ratio in 86, 93 and 95 % of
/// the frames of 144 simulated contacts with noise, and is 0.21, 0.28 and 0.32 wide.
const RIM: f64 = 1.0;
/// A slipping marker sticks again once its squared motion with the part is this many gates: at ten times the
/// distance that can hide a slip. With 4, 25 and 100, the stick ratio of 144 simulated contacts, whose patch
/// is known, has an rms error of 0.067, 0.055 and 0.053.
const AGAIN: f64 = 100.0;
// FREE_LAG and FEW were chosen on 183 simulated drags and twists and 85 contacts that stick, whose patch is
// from heights (seeds 31 and 33 of the report). SURE, UNSURE and FRAMES were chosen on 120 and 53 (seeds 101
// and 102), with markers at another depth than the part's as free; docs/slip.md judges by other seeds.

/// Least share of the part's motion by which free gel beside the patch lags behind, within a pitch of it:
/// 99 % of such markers lag by 0.21 or more at first. With 0.15 and 0.2, 136 and 142 slips are found in time.
const FREE_LAG: f64 = 0.2;
/// How far a marker beside the patch must be from [`FREE_LAG`] to count as touching, in standard deviations.
/// With 2.5, 3 and 4, 92, 91 and 89 slips are found in time, with two false alarms each.
const SURE: f64 = 2.5;
/// Largest share of the markers that may slip while the contact as a whole sticks: patches hold free markers
/// beside an edge. With 0, 0.025 and 0.04, 150, 148 and 145 slips are found in time, with 19, 11 and 10 false
/// alarms.
const FEW: f64 = 0.025;
/// Share by which a marker beside the patch that slips does not count, since it may be free gel. With 0.5,
/// 0.67 and 0.75, 93, 92 and 90 slips are found in time, with 4, 2 and 2 false alarms.
const UNSURE: f64 = 2.0 / 3.0;
/// Frames over which the anchor of a marker that sticks is averaged. With 1, 4, 8 and 16, the stick ratio of
/// balls whose patch is known has an rms error of 0.070, 0.061, 0.060 and 0.060.
const FRAMES: u8 = 8;
/// Thousands of instructions of a baseline x86-64 processor for one marker in contact and frame, with those
/// beside the patch: touch and the next frame take 8.9 together, by callgrind, for contacts of 37 markers.
const PER_MARKER: u64 = 9;

/// Why a marker counts as touching.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Touch {
    #[default]
    No,
    /// Beside the patch, and it moved with the part.
    Motion,
    /// In the patch.
    Patch,
}

/// A marker since it touched the part, or since it slipped last. Markers beside the patch have one, too.
#[derive(Clone, Copy, Debug, Default)]
struct Anchor {
    is_set: bool,
    touch: Touch,
    slips: bool,
    /// Frames whose mean the position is.
    frames: u8,
    /// Part frame, which is the sensor frame at touch.
    part_mm: DVec3,
    /// Of the position in the first frame, part frame.
    covariance_mm2: Symmetric<3>,
    /// Position in the first frame, sensor frame.
    sensor_mm: DVec3,
}

/// Finds slip from frame to frame. It allocates nothing after it was made.
#[derive(Clone, Debug)]
pub struct SlipTracker {
    params: SlipParams,
    topology: Topology,
    /// Two directions along the gel.
    along: [DVec3; 2],
    /// Towards the camera.
    up: DVec3,
    anchors: Vec<Anchor>,
    pose: Pose,
    is_gross: bool,
    pairs: Vec<Pair>,
    /// Whether each marker touches the part, in the last frame.
    touches: Vec<bool>,
    /// Their number.
    touched: usize,
}

impl SlipTracker {
    /// For the markers of this rest surface, row by row, `cols` in each.
    ///
    /// # Errors
    /// [`SlipError::Params`], or [`SlipError::Lattice`] unless the markers fill whole rows.
    pub fn new(params: &SlipParams, rest: &RestSurface, cols: usize) -> Result<Self, SlipError> {
        let rows = rest.points_mm().len().checked_div(cols).unwrap_or(0);
        Self::on(params, rest, Topology::square(rows, cols))
    }

    /// As [`Self::new`], for a print of any topology.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn on(params: &SlipParams, rest: &RestSurface, topology: Topology) -> Result<Self, SlipError> {
        params.validate().map_err(SlipError::Params)?;
        let markers = rest.points_mm().len();
        if topology.places() != markers {
            return Err(SlipError::Lattice { markers, cols: topology.cols() });
        }
        let (x, y) = rest.normal().any_orthonormal_pair();
        let mut anchors = Vec::new();
        anchors.resize(markers, Anchor::default());
        Ok(Self {
            params: params.clone(),
            topology,
            along: [x, y],
            up: rest.normal(),
            anchors,
            pose: Pose::IDENTITY,
            is_gross: false,
            pairs: Vec::with_capacity(markers),
            touches: Vec::with_capacity(markers),
            touched: 0,
        })
    }

    /// Number of markers.
    #[must_use]
    pub fn markers(&self) -> usize {
        self.anchors.len()
    }

    /// Predicted work of the next frame, in units of 1000 instructions: that of a contact as large as the
    /// last one.
    #[must_use]
    pub const fn work(&self) -> u64 {
        PER_MARKER * self.touched as u64
    }

    /// Forgets the contact: the next frame is the first touch.
    pub fn restart(&mut self) {
        self.anchors.fill(Anchor::default());
        (self.pose, self.is_gross) = (Pose::IDENTITY, false);
    }

    /// Tells for every marker whether it sticks, and for the contact whether it slips; `None` without
    /// contact. `out` is cleared first.
    ///
    /// # Errors
    /// [`SlipError::Lengths`].
    pub fn run(&mut self, moved: &MovedMarkers<'_>, out: &mut Vec<Stick>) -> Result<Option<Slip>, SlipError> {
        let rest = self.anchors.len();
        let lengths =
            [moved.points_mm.len(), moved.covariance_mm2.len(), moved.state.len(), moved.patch.len()];
        if let Some(&found) = lengths.iter().find(|&&found| found != rest) {
            return Err(SlipError::Lengths { rest, found });
        }
        out.clear();
        self.touch(moved.patch);
        if self.touched == 0 {
            self.restart();
            out.resize(rest, Stick::Free);
            return Ok(None);
        }
        let motion = if self.is_gross { None } else { self.follow(moved) };
        if motion.is_none() {
            // Without a motion of the part, all markers begin anew together.
            self.forget(moved.patch);
        }
        let gate = self.params.gate(self.touched);
        out.extend((0..rest).map(|i| self.judge(moved, i, motion.as_ref(), gate)));
        self.average(moved, out);
        Ok(Some(self.summary(out, motion)))
    }

    /// Selects the markers that touch the part: those of the patch, and those beside it that moved with it.
    fn touch(&mut self, patch: &[bool]) {
        self.touches.clear();
        for (i, &is_in) in patch.iter().enumerate() {
            let anchor = self.anchors[i];
            let touch = match anchor.touch {
                _ if is_in => Touch::Patch,
                Touch::Motion if self.is_beside(patch, i) => Touch::Motion,
                _ => Touch::No,
            };
            // Until now it may have been free gel, which moves on its own.
            let enters = touch == Touch::Patch && anchor.touch != Touch::Patch;
            if enters || touch == Touch::No && !self.is_beside(patch, i) {
                self.anchors[i] = Anchor::default();
            }
            self.anchors[i].touch = touch;
            self.touches.push(touch != Touch::No);
        }
        self.touched = self.touches.iter().filter(|&&touches| touches).count();
    }

    /// Forgets all anchors, and which markers beside the patch moved with the part.
    fn forget(&mut self, patch: &[bool]) {
        self.pose = Pose::IDENTITY;
        for ((anchor, touches), &is_in) in self.anchors.iter_mut().zip(&mut self.touches).zip(patch) {
            *anchor = Anchor { touch: if is_in { Touch::Patch } else { Touch::No }, ..Anchor::default() };
            *touches = is_in;
        }
    }

    /// The part's motion, from the markers that stick.
    fn follow(&mut self, moved: &MovedMarkers<'_>) -> Option<RigidMotion> {
        self.pairs.clear();
        let turn = self.pose.matrix();
        for (i, anchor) in self.anchors.iter().enumerate() {
            if !anchor.is_set || anchor.slips || !self.touches[i] || !is_usable(moved, i) {
                continue;
            }
            let lifted_mm = self.lifted_mm(anchor, moved.points_mm[i]);
            let anchored = turned(&turn, &anchor.covariance_mm2);
            let covariance = self.noise(&moved.covariance_mm2[i], &anchored, lifted_mm);
            if let Some(factor) = Factor::new(&covariance) {
                let (anchor_mm, point_mm) = (anchor.part_mm, moved.points_mm[i]);
                self.pairs.push(Pair { anchor_mm, point_mm, factor });
            }
        }
        if self.pairs.len() < MIN_MARKERS {
            return None;
        }
        let motion = rigid(&self.pairs, &self.pose)?;
        self.pose = motion.pose;
        Some(motion)
    }

    /// Whether a marker sticks. A marker that slips, or touches, is anchored where it is.
    fn judge(
        &mut self,
        moved: &MovedMarkers<'_>,
        i: usize,
        motion: Option<&RigidMotion>,
        gate: f64,
    ) -> Stick {
        if !self.touches[i] {
            self.judge_beside(moved, i, motion, gate);
            return Stick::Free;
        }
        if !is_usable(moved, i) {
            return Stick::Unknown;
        }
        let (point_mm, covariance) = (moved.points_mm[i], &moved.covariance_mm2[i]);
        let mut anchor = self.anchors[i];
        if !anchor.is_set {
            self.anchor(i, moved, false);
            return Stick::Unknown;
        }
        let Some(motion) = motion else { return Stick::Unknown };
        let at_mm = self.pose.transform_point(anchor.part_mm);
        let off_mm = point_mm - at_mm;
        let of_one = turned(&self.pose.matrix(), &anchor.covariance_mm2);
        let anchored = of_one.map(|row| row.map(|entry| entry / f64::from(anchor.frames)));
        let mut noise = self.noise(covariance, &anchored, self.lifted_mm(&anchor, point_mm));
        if anchor.slips {
            // The others were used by the fit, which makes their residuals smaller.
            noise = sum(&noise, &of_motion(motion, at_mm));
        }
        let Some(squared) = self.squared(off_mm, &noise) else { return Stick::Unknown };
        if self.is_free(off_mm, &noise, gate) {
            self.anchor(i, moved, false);
            return Stick::Free;
        }
        if squared > gate {
            self.anchor(i, moved, true);
            return Stick::Slips;
        }
        let moved_squared = self.squared(point_mm - anchor.sensor_mm, &noise);
        if anchor.slips && moved_squared.is_some_and(|squared| squared > AGAIN * gate) {
            anchor.slips = false;
            self.anchors[i] = anchor;
        }
        if anchor.slips { Stick::Slips } else { Stick::Stuck }
    }

    /// Whether a marker beside the patch touches the part from the next frame on. Free gel lags behind the
    /// part from the first motion on; gel that sticks does not.
    fn judge_beside(&mut self, moved: &MovedMarkers<'_>, i: usize, motion: Option<&RigidMotion>, gate: f64) {
        if !is_usable(moved, i) || !self.is_beside(moved.patch, i) {
            return;
        }
        let anchor = self.anchors[i];
        let (true, Some(motion)) = (anchor.is_set, motion) else { return self.anchor(i, moved, false) };
        let (point_mm, at_mm) = (moved.points_mm[i], self.pose.transform_point(anchor.part_mm));
        let anchored = turned(&self.pose.matrix(), &anchor.covariance_mm2);
        let own = self.noise(&moved.covariance_mm2[i], &anchored, self.lifted_mm(&anchor, point_mm));
        let [moved_mm, lag_mm] = [at_mm - anchor.sensor_mm, point_mm - at_mm].map(|off_mm| {
            let [x, y] = self.along.map(|axis| off_mm.dot(axis));
            hypot(x, y)
        });
        let is_far = |noise: &Symmetric<3>| {
            let [x, y] = self.along.map(|axis| form(noise, axis, axis));
            FREE_LAG * moved_mm - lag_mm > SURE * sqrt(x.max(y))
        };
        if !is_far(&own) {
            return;
        }
        let noise = sum(&own, &of_motion(motion, at_mm));
        let is_near = self.squared(point_mm - at_mm, &noise).is_some_and(|squared| squared < gate);
        if is_near && is_far(&noise) {
            self.anchors[i].touch = Touch::Motion;
        }
    }

    /// Whether a marker does not touch the part: it is less deep, or deeper, than the part's motion carries
    /// it, and that is most of its distance. On slopes of up to 45 degrees, slip does not explain that.
    fn is_free(&self, off_mm: DVec3, noise: &Symmetric<3>, gate: f64) -> bool {
        let (deep_mm, [x, y]) = (off_mm.dot(self.up), self.along.map(|axis| off_mm.dot(axis)));
        abs(deep_mm) > hypot(x, y) && deep_mm * deep_mm > gate * form(noise, self.up, self.up)
    }

    /// Averages the anchors of markers that stick over their first frames. The part's motion keeps the
    /// covariance of one frame: averaging takes nothing from what all anchors of a frame have in common.
    fn average(&mut self, moved: &MovedMarkers<'_>, stick: &[Stick]) {
        let back = self.pose.inverse();
        let anchors = self.anchors.iter_mut().zip(moved.points_mm).zip(stick);
        for ((anchor, &point_mm), _) in anchors.filter(|(_, stick)| **stick == Stick::Stuck) {
            if anchor.frames < FRAMES {
                anchor.frames += 1;
                let off_mm = back.transform_point(point_mm) - anchor.part_mm;
                anchor.part_mm += off_mm / f64::from(anchor.frames);
            }
        }
    }

    /// How much deeper a marker is pressed than where it was anchored.
    fn lifted_mm(&self, anchor: &Anchor, point_mm: DVec3) -> f64 {
        (point_mm - anchor.sensor_mm).dot(self.up)
    }

    /// Covariance of a marker's distance from where its anchor has moved, after it was lifted by so much.
    fn noise(&self, now: &Symmetric<3>, anchor: &Symmetric<3>, lifted_mm: f64) -> Symmetric<3> {
        let mut noise = sum(now, anchor);
        let (strain_mm, of_lift_mm) = (self.params.strain_sigma_mm, self.params.strain_share * lifted_mm);
        let variance = strain_mm * strain_mm + of_lift_mm * of_lift_mm;
        noise.iter_mut().enumerate().for_each(|(i, row)| row[i] += variance);
        noise
    }

    /// Anchors a marker where it is.
    fn anchor(&mut self, i: usize, moved: &MovedMarkers<'_>, slips: bool) {
        let (back, sensor_mm) = (self.pose.inverse(), moved.points_mm[i]);
        self.anchors[i] = Anchor {
            is_set: true,
            touch: self.anchors[i].touch,
            slips,
            frames: 1,
            part_mm: back.transform_point(sensor_mm),
            covariance_mm2: turned(&back.matrix(), &moved.covariance_mm2[i]),
            sensor_mm,
        };
    }

    /// Squared distance along the gel over its variance. The noise of markers that stick exceeds it with the
    /// probability exp(-d²/2) (two degrees of freedom). `None` unless the covariance is positive definite.
    fn squared(&self, off_mm: DVec3, noise: &Symmetric<3>) -> Option<f64> {
        let [x, y] = self.along;
        let [xx, xy, yy] = [(x, x), (x, y), (y, y)].map(|(a, b)| form(noise, a, b));
        let (u, v) = (off_mm.dot(x), off_mm.dot(y));
        let determinant = xx * yy - xy * xy;
        (xx > 0.0 && determinant > 0.0).then(|| (yy * u * u - 2.0 * xy * u * v + xx * v * v) / determinant)
    }

    fn summary(&mut self, stick: &[Stick], motion: Option<RigidMotion>) -> Slip {
        let count = |which| stick.iter().filter(|&&s| s == which).count();
        let [stuck, slips, unknown] = [Stick::Stuck, Stick::Slips, Stick::Unknown].map(count);
        let known = stuck + slips;
        let ratio = (known > 0).then(|| stuck as f64 / known as f64);
        let border = (0..stick.len()).filter(|&i| self.touches[i] && self.is_border(i)).count();
        // A marker beside the patch that slips may be free gel, and counts as a third of one.
        let beside = |i: &usize| self.anchors[*i].touch == Touch::Motion && stick[*i] == Stick::Slips;
        let (all, unsure) = (known + unknown, (0..stick.len()).filter(beside).count());
        let low = stuck as f64 / (all as f64 + RIM * border as f64);
        let stick_range = [low, (stuck + unknown) as f64 / (all - unsure).max(1) as f64];
        let is_lost = slips > 0 && (stuck < MIN_MARKERS || stick_range[0] < HELD);
        self.is_gross |= is_lost;
        let status = match ratio {
            _ if self.is_gross => SlipStatus::Gross,
            None => SlipStatus::Unknown,
            Some(_) if (slips as f64 - UNSURE * unsure as f64) > FEW * known as f64 => SlipStatus::Incipient,
            Some(_) => SlipStatus::Stuck,
        };
        let is_held = matches!(status, SlipStatus::Stuck | SlipStatus::Incipient);
        let margin = if is_held { Margin::of_stick(self.params.shape, stick_range) } else { None };
        Slip { status, stick_ratio: ratio, stick_range, motion, margin }
    }

    /// Whether a neighbour does not touch the part, or is missing.
    fn is_border(&self, i: usize) -> bool {
        let touching = self.topology.neighbours(i).filter(|&k| self.touches[k]);
        touching.count() < 2 * self.topology.axes()
    }

    /// Whether a marker outside the patch has one of those around it in the patch.
    fn is_beside(&self, patch: &[bool], i: usize) -> bool {
        !patch[i] && self.topology.around(i).any(|k| patch[k])
    }
}

fn is_usable(moved: &MovedMarkers<'_>, i: usize) -> bool {
    moved.state[i] == MarkerState::Seen && moved.points_mm[i].is_finite()
}

/// R C Rᵀ.
fn turned(turn: &DMat3, covariance: &Symmetric<3>) -> Symmetric<3> {
    let c = DMat3::from_cols_array_2d(covariance);
    (*turn * c * turn.transpose()).to_cols_array_2d()
}

fn sum(a: &Symmetric<3>, b: &Symmetric<3>) -> Symmetric<3> {
    core::array::from_fn(|i| core::array::from_fn(|k| a[i][k] + b[i][k]))
}

/// aᵀ C b.
fn form(covariance: &Symmetric<3>, a: DVec3, b: DVec3) -> f64 {
    (DMat3::from_cols_array_2d(covariance) * b).dot(a)
}

/// Covariance of a point of the part by that of its motion: J C Jᵀ.
fn of_motion(motion: &RigidMotion, at_mm: DVec3) -> Symmetric<3> {
    let jacobian = columns(at_mm - motion.about_mm);
    core::array::from_fn(|r| {
        core::array::from_fn(|s| {
            let all = (0..6).flat_map(|i| (0..6).map(move |k| (i, k)));
            all.map(|(i, k)| jacobian[i][r] * motion.covariance[i][k] * jacobian[k][s]).sum()
        })
    })
}
