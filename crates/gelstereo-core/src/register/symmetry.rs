//! Rotational symmetries of a part, and the equivalent copies of a pose.

use crate::math::{DQuat, DVec3, Pose, abs, atan2, cos, round, sin, sqrt};
use core::f64::consts::{PI, TAU};

/// Largest number of combined rotations. A symmetry is a rotation about one axis; declared generators
/// need two or three.
const MAX_COMBINED: usize = 8;
/// Largest number of rotation pairs tried.
const MAX_PAIRS: usize = 512;

/// A rotation axis of symmetry of a part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Symmetry {
    /// Unit vector along the axis, object frame.
    pub axis: DVec3,
    /// A point on the axis, object frame.
    pub centre_mm: DVec3,
    /// Number of equal rotations in a full turn; `None` for continuous symmetry.
    pub order: Option<u32>,
}

impl Symmetry {
    /// About an axis of any length; `None` if it has no direction, a number is not finite, or the order
    /// is below 2.
    #[must_use]
    pub fn new(axis: DVec3, centre_mm: DVec3, order: Option<u32>) -> Option<Self> {
        let scaled = axis / axis.abs().max_element();
        let sound = scaled.is_finite() && centre_mm.is_finite() && order.is_none_or(|n| n >= 2);
        sound.then(|| Self { axis: scaled / sqrt(scaled.length_squared()), centre_mm, order })
    }

    /// The rotation by an angle, object frame to object frame.
    #[must_use]
    pub fn turned(&self, angle_rad: f64) -> Pose {
        let turn = Pose::exp(self.axis * angle_rad, DVec3::ZERO);
        Pose { rotation: turn.rotation, translation_mm: self.centre_mm - turn.rotation * self.centre_mm }
    }

    /// The copy of a pose under these symmetries that is nearest to another pose, by rotation angle.
    #[must_use]
    pub fn nearest_copy(symmetries: &[Self], t_sensor_object: &Pose, other: &Pose) -> Pose {
        nearest_copy(symmetries, t_sensor_object, other)
    }
}

/// The copy of a pose with the smallest rotation from another.
pub(super) fn nearest_copy(symmetries: &[Symmetry], t_sensor_object: &Pose, other: &Pose) -> Pose {
    let product = *t_sensor_object * nearest_turn(symmetries, t_sensor_object, other);
    product.normalized().unwrap_or(*t_sensor_object)
}

/// The symmetry rotation S, object frame to object frame, that brings T S nearest to the other pose by angle.
///
/// Every rotation of a symmetry group is about one of its axes; if only generators are declared, most
/// need two. The best one or two rotations are applied until none improves.
fn nearest_turn(symmetries: &[Symmetry], t_sensor_object: &Pose, other: &Pose) -> Pose {
    let turns: usize = symmetries.iter().filter_map(|s| s.order).map(|n| n as usize).sum();
    // A list this long contains all axes.
    let has_pairs = turns * symmetries.len() <= MAX_PAIRS;
    let mut turn = Pose::IDENTITY;
    for _ in 0..MAX_COMBINED {
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

/// The rotation that leaves the largest cosine w of half the angle.
struct Best {
    w: f64,
    turn: Option<Pose>,
}

impl Best {
    /// Tries one rotation about each axis, after `first`, which leaves the rotation `off`.
    fn try_one(&mut self, symmetries: &[Symmetry], off: DQuat, first: &Pose) {
        for symmetry in symmetries {
            let half_rad = best_half_turn(symmetry, off);
            let w = abs(off.w * cos(half_rad) - along(symmetry, off) * sin(half_rad));
            // Ignores improvements within round-off.
            if w > self.w + 8.0 * f64::EPSILON {
                *self = Self { w, turn: Some(*first * symmetry.turned(2.0 * half_rad)) };
            }
        }
    }
}

fn along(symmetry: &Symmetry, off: DQuat) -> f64 {
    DVec3::new(off.x, off.y, off.z).dot(symmetry.axis)
}

/// Half the angle h of the rotation about the axis that leaves the smallest remainder: w cos h - (v·a)
/// sin h is largest.
fn best_half_turn(symmetry: &Symmetry, off: DQuat) -> f64 {
    let (w, v) = (off.w, along(symmetry, off));
    // If both vanish, all rotations are equally good.
    if sqrt(w * w + v * v) < 1e-9 {
        return 0.0;
    }
    let half_rad = atan2(-v, w);
    // Within half a turn, as w and -w are the same rotation.
    let half_rad = half_rad - PI * round(half_rad / PI);
    symmetry.order.map_or(half_rad, |n| {
        let step = PI / f64::from(n);
        step * round(half_rad / step)
    })
}
