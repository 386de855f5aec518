//! Reduces symmetric copies of a pose to one: the copy nearest to the guess.

use super::alternatives::{Alternative, Alternatives};
use super::free::FreeDirections;
use super::observe::{Observability, PatchFrame};
use super::registration::Registration;
use super::symmetry::{Symmetry, nearest_copy};
use crate::math::Pose;

/// Poses this many standard deviations apart over the determined directions count as distinct.
pub(super) const APART: f64 = 5.0;

/// Replaces a registration and its alternatives by the copies nearest to `guess` and drops alternatives
/// that then coincide. Marks the part's own symmetry rotations among the free directions.
pub(super) fn honour(found: &mut Registration, symmetries: &[Symmetry], guess: &Pose, resolution_mm: f64) {
    if symmetries.is_empty() {
        return;
    }
    found.t_sensor_object = nearest_copy(symmetries, &found.t_sensor_object, guess);
    let best = found.t_sensor_object;
    let back = best.inverse();
    let seen = found.observability;
    let in_object = seen.turned(&back, back.transform_point(seen.centre_mm));
    found.free = FreeDirections::new(&in_object, resolution_mm, symmetries);
    let mut kept = Alternatives::none_of(found.alternatives.is_cut());
    for one in found.alternatives.iter() {
        let t_sensor_object = nearest_copy(symmetries, &one.t_sensor_object, guess);
        // Nearest to each other: midway between two copies, noise decides which is nearest to the guess.
        let is_copy =
            |other: &Pose| !are_apart(&seen, &nearest_copy(symmetries, &t_sensor_object, other), other);
        if !is_copy(&best) && !kept.iter().any(|k| is_copy(&k.t_sensor_object)) {
            kept.push(Alternative { t_sensor_object, ..*one });
        }
    }
    found.alternatives = kept;
}

/// Whether two poses are distinct over the directions that the contact determines.
pub(super) fn are_apart(seen: &Observability, one: &Pose, other: &Pose) -> bool {
    let frame = PatchFrame { centre_mm: seen.centre_mm, radius_mm: seen.radius_mm };
    seen.squared(frame.log(&(*one * other.inverse()))) > APART * APART
}
