//! Symmetric copies of a pose are one answer: the one nearest to the guess.

use super::observe::{Observability, PatchFrame};
use super::symmetry::Symmetry;
use super::{Alternatives, FreeDirections, Registration};
use crate::math::{DQuat, DVec3, Pose, abs, atan2, cos, round, sin, sqrt};
use core::f64::consts::{PI, TAU};

/// Poses whose difference is this many standard deviations over the determined directions are two.
pub(super) const APART: f64 = 5.0;
/// Turns that are put together; symmetries of a body are turns about one axis each, and declared ones two or three.
const MOST_TURNS: usize = 8;
/// Pairs of turns that are tried.
const MOST_PAIRS: usize = 512;

/// Brings a registration and its alternatives to the copies nearest to `guess`, drops alternatives that
/// are none then, and names the part's own turns among the free directions.
pub(super) fn honour(found: &mut Registration, symmetries: &[Symmetry], guess: &Pose, resolution_mm: f64) {
    if symmetries.is_empty() {
        return;
    }
    found.t_sensor_object = nearest(symmetries, &found.t_sensor_object, guess);
    let best = found.t_sensor_object;
    let back = best.inverse();
    let seen = found.observability;
    let in_object = seen.turned(&back, back.transform_point(seen.centre_mm));
    found.free = FreeDirections::new(&in_object, resolution_mm, symmetries);
    let mut kept = Alternatives::none_of(found.alternatives.is_cut());
    for one in found.alternatives.iter() {
        let t_sensor_object = nearest(symmetries, &one.t_sensor_object, guess);
        // Nearest to each other: in the middle between two copies noise chooses which is nearest to the guess.
        let is_copy = |other: &Pose| !are_apart(&seen, &nearest(symmetries, &t_sensor_object, other), other);
        if !is_copy(&best) && !kept.iter().any(|k| is_copy(&k.t_sensor_object)) {
            kept.push(super::Alternative { t_sensor_object, ..*one });
        }
    }
    found.alternatives = kept;
}

/// The copy of a pose that is the least turn away from another.
pub(super) fn nearest(symmetries: &[Symmetry], t_sensor_object: &Pose, other: &Pose) -> Pose {
    let product = *t_sensor_object * nearest_turn(symmetries, t_sensor_object, other);
    product.normalized().unwrap_or(*t_sensor_object)
}

fn are_apart(seen: &Observability, one: &Pose, other: &Pose) -> bool {
    let frame = PatchFrame { centre_mm: seen.centre_mm, radius_mm: seen.radius_mm };
    seen.squared(frame.log(&(*one * other.inverse()))) > APART * APART
}

/// The turn S of the part, object frame to object frame, that brings T S nearest to the other pose by its angle.
///
/// Every turn of a body's group is one about one of its axes, or where these are declared by what makes them alone, mostly
/// two put together. The best one or two are taken until none is better.
fn nearest_turn(symmetries: &[Symmetry], t_sensor_object: &Pose, other: &Pose) -> Pose {
    let turns: usize = symmetries.iter().filter_map(|s| s.order).map(|n| n as usize).sum();
    // A list of so many has all axes.
    let has_pairs = turns * symmetries.len() <= MOST_PAIRS;
    let mut turn = Pose::IDENTITY;
    for _ in 0..MOST_TURNS {
        let off = other.rotation.conjugate() * t_sensor_object.rotation * turn.rotation;
        let mut best = Best { w: abs(off.w), turn: None };
        best.try_one(symmetries, off, &Pose::IDENTITY);
        for symmetry in symmetries.iter().filter(|_| has_pairs) {
            for k in 1..symmetry.order.unwrap_or(1) {
                let first = symmetry.turned(TAU * f64::from(k) / f64::from(symmetry.order.unwrap_or(1)));
                best.try_one(symmetries, off * first.rotation, &first);
            }
        }
        let Some(next) = best.turn else { break };
        turn = turn * next;
    }
    turn
}

/// The turn that leaves the largest cosine w of half the angle.
struct Best {
    w: f64,
    turn: Option<Pose>,
}

impl Best {
    /// One turn about each axis, after `first`, which leaves the rotation `off`.
    fn try_one(&mut self, symmetries: &[Symmetry], off: DQuat, first: &Pose) {
        for symmetry in symmetries {
            let half_rad = best_half_turn(symmetry, off);
            let w = abs(off.w * cos(half_rad) - along(symmetry, off) * sin(half_rad));
            // Round-off is no reason to turn.
            if w > self.w + 8.0 * f64::EPSILON {
                *self = Self { w, turn: Some(*first * symmetry.turned(2.0 * half_rad)) };
            }
        }
    }
}

fn along(symmetry: &Symmetry, off: DQuat) -> f64 {
    DVec3::new(off.x, off.y, off.z).dot(symmetry.axis)
}

/// Half the angle h of the turn about the axis that leaves the least rotation: w cos h - (v·a) sin h is largest.
fn best_half_turn(symmetry: &Symmetry, off: DQuat) -> f64 {
    let (w, v) = (off.w, along(symmetry, off));
    // Where both vanish any turn is as good.
    if sqrt(w * w + v * v) < 1e-9 {
        return 0.0;
    }
    let half_rad = atan2(-v, w);
    // Within half a turn: w and -w are one rotation.
    let half_rad = half_rad - PI * round(half_rad / PI);
    symmetry.order.map_or(half_rad, |n| {
        let step = PI / f64::from(n);
        step * round(half_rad / step)
    })
}
