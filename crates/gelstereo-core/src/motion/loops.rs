//! Recognizes a surface that comes back, and corrects the keyframes by it.

use super::cloud::{Cloud, Element};
use super::fit::Problem;
use super::joint::JointPoses;
use super::recognize::{Optimum, RecognitionStatus, judge, optima};
use crate::math::{DVec3, sqrt};
use crate::slip::RigidMotion;
use alloc::vec::Vec;

/// Elements that are kept of a keyframe; larger contacts are thinned. 40 are usual.
const MAX_ELEMENTS: usize = 64;
/// Starts about the expected motion, whose error is far below the size of the contact.
const STARTS: usize = 8;
const MATCHING_ROUNDS: u32 = 15;
/// Least standard deviations of the guess, rad and mm: those of a contact of a few markers.
const LEAST: [f64; 2] = [0.01, 0.05];
/// Largest standard deviations of the expected motion, rad and mm. Beyond, another place of a part that looks
/// the same is as likely: half the distance of two markers, and a tenth of the angle between the faces of a
/// hexagon.
const MOST: [f64; 2] = [0.1, 0.5];
/// The measured motion is that of the surface alone: the variance of a guess this many times less sure than
/// the expected motion is its share in it.
const UNSURE: f64 = 30.0;
/// Squared distance of the measured and the expected motion, in their variances, beyond which a surface is
/// not the one that it seems to be: 99.99 % of six components.
const GATE: f64 = 27.9;

/// A keyframe that is remembered.
#[derive(Clone, Debug)]
struct Remembered {
    number: u32,
    /// Its elements with normals, sensor frame.
    elements: Vec<Element>,
    /// Their mean, in the part's frame at that time.
    middle_mm: DVec3,
}

/// Keyframes of a contact, their surfaces, and their joint poses. All memory is allocated at first.
#[derive(Clone, Debug)]
pub(super) struct Loops {
    limit: usize,
    joint: JointPoses,
    /// In the order of time. Entries beyond the number of poses are spare.
    remembered: Vec<Remembered>,
    found: Vec<Optimum>,
    matches: Vec<Option<usize>>,
    /// Keyframe nearest to the last frame, and its squared distance on the part.
    nearest: Option<(usize, f64)>,
    /// Keyframe that was passed last.
    passed: Option<usize>,
    /// Loops closed in this contact.
    pub closed: u32,
}

impl Loops {
    /// Remembers `limit` keyframes; none if it is less than three, which close no loop.
    pub fn new(limit: usize) -> Self {
        // One more for the frame that is compared.
        let places = if limit < 3 { 0 } else { limit + 1 };
        let empty =
            || Remembered { number: 0, elements: Vec::with_capacity(MAX_ELEMENTS), middle_mm: DVec3::ZERO };
        Self {
            limit,
            joint: JointPoses::new(places),
            remembered: (0..places).map(|_| empty()).collect(),
            found: Vec::with_capacity(STARTS),
            matches: Vec::with_capacity(MAX_ELEMENTS),
            nearest: None,
            passed: None,
            closed: 0,
        }
    }

    /// Begins a contact with its first keyframe.
    pub fn start(&mut self, about_mm: DVec3, cloud: &Cloud) {
        self.closed = 0;
        (self.nearest, self.passed) = (None, None);
        if self.limit >= 3 {
            self.joint.start(about_mm);
            self.set_surface(0, cloud);
        }
    }

    /// Adds a keyframe after a motion since the last one. Its corrected pose if a loop was closed.
    pub fn add(
        &mut self,
        motion: &RigidMotion,
        number: u32,
        cloud: &Cloud,
        like: &Problem<'_>,
    ) -> Option<RigidMotion> {
        if self.limit < 3 {
            return None;
        }
        if self.joint.len() == self.limit {
            self.forget();
        }
        self.remember(motion, number, cloud);
        let newest = self.joint.len() - 1;
        (self.nearest, self.passed) = (None, None);
        let (other, _) = self.candidate(newest)?;
        self.close(other, newest, like)?;
        Some(self.joint.pose(newest, motion.about_mm))
    }

    /// Compares a frame, after a motion since the last keyframe, with the keyframe that it passes. The
    /// corrected poses of the last keyframe and of the frame, if a loop was closed.
    pub fn pass(
        &mut self,
        motion: &RigidMotion,
        number: u32,
        cloud: &Cloud,
        like: &Problem<'_>,
    ) -> Option<[RigidMotion; 2]> {
        if self.limit < 3 {
            return None;
        }
        self.remember(motion, number, cloud);
        let newest = self.joint.len() - 1;
        let found = self.candidate(newest);
        let passes = |(other, away): (usize, f64)| {
            let is_next = self.nearest.is_some_and(|(before, least)| before == other && away > least);
            is_next && self.passed != Some(other) && away < like.pitch_mm * like.pitch_mm
        };
        let passed = found.filter(|&found| passes(found));
        let closed = passed.and_then(|(other, _)| {
            self.passed = Some(other);
            self.close(other, newest, like)?;
            Some([newest - 1, newest].map(|index| self.joint.pose(index, motion.about_mm)))
        });
        self.nearest = found;
        self.joint.remove(newest);
        closed
    }

    /// Keyframes that are remembered, by number, with the motion from first touch to them, about the centroid
    /// of the contact.
    pub fn keyframes(&self) -> impl Iterator<Item = (u32, RigidMotion)> {
        let all = self.remembered.iter().take(self.joint.len()).enumerate();
        all.map(|(i, each)| (each.number, self.joint.pose(i, mean(&each.elements))))
    }

    /// Adds a pose with its surface.
    fn remember(&mut self, motion: &RigidMotion, number: u32, cloud: &Cloud) {
        self.joint.push(motion);
        self.set_surface(number, cloud);
    }

    fn set_surface(&mut self, number: u32, cloud: &Cloud) {
        let index = self.joint.len() - 1;
        let entry = &mut self.remembered[index];
        let count = cloud.elements.iter().filter(|e| e.is_checked).count();
        let every = count.div_ceil(MAX_ELEMENTS).max(1);
        entry.number = number;
        entry.elements.clear();
        let elements = cloud.elements.iter().filter(|e| e.is_checked).step_by(every);
        entry.elements.extend(elements.take(MAX_ELEMENTS));
        let back = self.joint.pose(index, DVec3::ZERO).pose.inverse();
        entry.middle_mm = back.transform_point(mean(&entry.elements));
    }

    /// Forgets the keyframe that is nearest to another one on the part, but neither the first nor the last:
    /// it shows what the other one shows.
    fn forget(&mut self) {
        let count = self.joint.len();
        let mut nearest = (f64::INFINITY, 1);
        for i in 1..count - 1 {
            for k in (0..count).filter(|&k| k != i) {
                let squared = self.remembered[i].middle_mm.distance_squared(self.remembered[k].middle_mm);
                if squared < nearest.0 {
                    nearest = (squared, i);
                }
            }
        }
        self.joint.remove(nearest.1);
        // The entry becomes spare; its memory is used again.
        self.remembered[nearest.1..].rotate_left(1);
    }

    /// The keyframe nearest on the part among those that share no marker with this one, and its squared
    /// distance.
    fn candidate(&self, newest: usize) -> Option<(usize, f64)> {
        let Remembered { number, middle_mm, .. } = self.remembered[newest];
        let others =
            self.remembered[..newest].iter().enumerate().filter(|(_, other)| other.number + 1 < number);
        others
            .map(|(i, other)| (i, other.middle_mm.distance_squared(middle_mm)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Measures the motion between two keyframes by their surfaces, and corrects all by it.
    fn close(&mut self, from: usize, to: usize, like: &Problem<'_>) -> Option<()> {
        let (now, before) = (&self.remembered[to].elements, &self.remembered[from].elements);
        if now.is_empty() || before.is_empty() {
            return None;
        }
        let about_mm = mean(now);
        let expected = self.joint.between(from, to, about_mm);
        let variance = |k: usize| (k..k + 3).map(|i| expected.covariance[i][i]).fold(0.0, f64::max);
        let free = [variance(0), variance(3)].map(sqrt);
        if free[0] > MOST[0] || free[1] > MOST[1] {
            return None;
        }
        let free = [free[0].max(LEAST[0]), free[1].max(LEAST[1])];
        let (pairs, matching_rounds) = (&[][..], MATCHING_ROUNDS);
        let problem = Problem { pairs, now, before, about_mm, free, frames: 1.0, matching_rounds, ..*like };
        optima(&problem, &expected.pose, STARTS, &mut self.matches, &mut self.found);
        if judge(&self.found, now.len()) != Some(RecognitionStatus::Found) {
            return None;
        }
        let best = self.found.first()?.fitted.motion.pose;
        let measured = Problem { frames: UNSURE, ..problem }.fit(&best, &mut self.matches)?;
        let squared = self.joint.measure(from, to, &measured.motion, GATE)?;
        if !(squared < GATE) {
            return None;
        }
        self.closed = self.closed.saturating_add(1);
        Some(())
    }
}

fn mean(elements: &[Element]) -> DVec3 {
    elements.iter().map(|e| e.point_mm).sum::<DVec3>() / (elements.len() as f64).max(1.0)
}
