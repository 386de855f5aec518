//! Follows the markers of a contact and tells which of them slip.

use super::error::SlipError;
use super::fit::{Pair, RigidMotion, columns, rigid};
use super::margin::Margin;
use super::stick::{Slip, SlipStatus, Stick};
use crate::contact::RestSurface;
use crate::force::MovedMarkers;
use crate::math::linalg::Symmetric;
use crate::math::{DMat3, DVec3, Factor, Pose};
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
/// Thousands of instructions of a baseline x86-64 processor for one marker in contact and frame: 5.6 counted
/// by callgrind, for contacts of 37 markers.
const PER_MARKER: u64 = 6;

/// A marker since it touched the part, or since it slipped last.
#[derive(Clone, Copy, Debug, Default)]
struct Anchor {
    is_set: bool,
    slips: bool,
    /// Part frame, which is the sensor frame at touch.
    part_mm: DVec3,
    /// Of the position, part frame.
    covariance_mm2: Symmetric<3>,
    /// The same position, sensor frame.
    sensor_mm: DVec3,
}

/// Finds slip from frame to frame. It allocates nothing after it was made.
#[derive(Clone, Debug)]
pub struct SlipTracker {
    params: SlipParams,
    cols: usize,
    /// Two directions along the gel.
    along: [DVec3; 2],
    /// Towards the camera.
    up: DVec3,
    anchors: Vec<Anchor>,
    pose: Pose,
    is_gross: bool,
    pairs: Vec<Pair>,
    /// Markers in contact in the last frame.
    touched: usize,
}

impl SlipTracker {
    /// For the markers of this rest surface, row by row, `cols` in each.
    ///
    /// # Errors
    /// [`SlipError::Params`], or [`SlipError::Lattice`] unless the markers fill whole rows.
    pub fn new(params: &SlipParams, rest: &RestSurface, cols: usize) -> Result<Self, SlipError> {
        params.validate().map_err(SlipError::Params)?;
        let markers = rest.points_mm().len();
        if cols == 0 || !markers.is_multiple_of(cols) {
            return Err(SlipError::Lattice { markers, cols });
        }
        let (x, y) = rest.normal().any_orthonormal_pair();
        let mut anchors = Vec::new();
        anchors.resize(markers, Anchor::default());
        let (params, pairs) = (params.clone(), Vec::with_capacity(markers));
        let pose = Pose::IDENTITY;
        let up = rest.normal();
        Ok(Self { params, cols, along: [x, y], up, anchors, pose, is_gross: false, pairs, touched: 0 })
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
        self.touched = moved.patch.iter().filter(|&&touches| touches).count();
        if self.touched == 0 {
            self.restart();
            out.resize(rest, Stick::Free);
            return Ok(None);
        }
        for (anchor, _) in self.anchors.iter_mut().zip(moved.patch).filter(|(_, touches)| !**touches) {
            *anchor = Anchor::default();
        }
        let motion = if self.is_gross { None } else { self.follow(moved) };
        if motion.is_none() {
            // Without a motion of the part, all markers begin anew together.
            self.anchors.fill(Anchor::default());
            self.pose = Pose::IDENTITY;
        }
        let gate = self.params.gate(self.touched);
        out.extend((0..rest).map(|i| self.judge(moved, i, motion.as_ref(), gate)));
        Ok(Some(self.summary(moved, out, motion)))
    }

    /// The part's motion, from the markers that stick.
    fn follow(&mut self, moved: &MovedMarkers<'_>) -> Option<RigidMotion> {
        self.pairs.clear();
        let turn = self.pose.matrix();
        for (i, anchor) in self.anchors.iter().enumerate() {
            if !anchor.is_set || anchor.slips || !is_usable(moved, i) {
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
        if !moved.patch[i] {
            return Stick::Free;
        }
        if !is_usable(moved, i) {
            return Stick::Unknown;
        }
        let (point_mm, covariance) = (moved.points_mm[i], &moved.covariance_mm2[i]);
        let mut anchor = self.anchors[i];
        if !anchor.is_set {
            self.anchors[i] = self.anchored(point_mm, covariance, false);
            return Stick::Unknown;
        }
        let Some(motion) = motion else { return Stick::Unknown };
        let turn = self.pose.matrix();
        let at_mm = self.pose.transform_point(anchor.part_mm);
        let anchored = turned(&turn, &anchor.covariance_mm2);
        let mut noise = self.noise(covariance, &anchored, self.lifted_mm(&anchor, point_mm));
        if anchor.slips {
            // The others were used by the fit, which makes their residuals smaller.
            noise = sum(&noise, &of_motion(motion, at_mm));
        }
        let Some(squared) = self.squared(point_mm - at_mm, &noise) else { return Stick::Unknown };
        if squared > gate {
            self.anchors[i] = self.anchored(point_mm, covariance, true);
            return Stick::Slips;
        }
        let moved_squared = self.squared(point_mm - anchor.sensor_mm, &noise);
        if anchor.slips && moved_squared.is_some_and(|squared| squared > AGAIN * gate) {
            anchor.slips = false;
            self.anchors[i] = anchor;
        }
        if anchor.slips { Stick::Slips } else { Stick::Stuck }
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

    fn anchored(&self, point_mm: DVec3, covariance: &Symmetric<3>, slips: bool) -> Anchor {
        let back = self.pose.inverse();
        Anchor {
            is_set: true,
            slips,
            part_mm: back.transform_point(point_mm),
            covariance_mm2: turned(&back.matrix(), covariance),
            sensor_mm: point_mm,
        }
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

    fn summary(&mut self, moved: &MovedMarkers<'_>, stick: &[Stick], motion: Option<RigidMotion>) -> Slip {
        let count = |which| stick.iter().filter(|&&s| s == which).count();
        let [stuck, slips, unknown] = [Stick::Stuck, Stick::Slips, Stick::Unknown].map(count);
        let known = stuck + slips;
        let ratio = (known > 0).then(|| stuck as f64 / known as f64);
        let border = (0..stick.len()).filter(|&i| moved.patch[i] && self.is_border(moved.patch, i)).count();
        let all = (known + unknown) as f64;
        let stick_range = [stuck as f64 / (all + RIM * border as f64), (stuck + unknown) as f64 / all];
        let is_lost = slips > 0 && (stuck < MIN_MARKERS || stick_range[0] < HELD);
        self.is_gross |= is_lost;
        let status = match ratio {
            _ if self.is_gross => SlipStatus::Gross,
            None => SlipStatus::Unknown,
            Some(_) if slips > 0 => SlipStatus::Incipient,
            Some(_) => SlipStatus::Stuck,
        };
        let is_held = matches!(status, SlipStatus::Stuck | SlipStatus::Incipient);
        let margin = if is_held { Margin::of_stick(self.params.shape, stick_range) } else { None };
        Slip { status, stick_ratio: ratio, stick_range, motion, margin }
    }

    /// Whether a neighbour in the row or column is outside the patch.
    fn is_border(&self, patch: &[bool], i: usize) -> bool {
        let (cols, column) = (self.cols, i % self.cols);
        let out = |inside: bool, j: usize| !(inside && patch[j]);
        out(column > 0, i.wrapping_sub(1))
            || out(column + 1 < cols, i + 1)
            || out(i >= cols, i.wrapping_sub(cols))
            || out(i + cols < patch.len(), i + cols)
    }
}

fn is_usable(moved: &MovedMarkers<'_>, i: usize) -> bool {
    moved.patch[i] && moved.state[i] == MarkerState::Seen && moved.points_mm[i].is_finite()
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
