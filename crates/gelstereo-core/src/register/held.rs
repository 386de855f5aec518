//! Back to the guess along what a contact leaves free.
//!
//! A search starts all over the uncertainty of its guess, and along a free direction every start ends where it began:
//! chance would choose among them. A free direction is a motion of the part's surface within itself, a slide, a spin or a
//! screw, so that the whole of it can be taken back, not a small step alone.

use super::observe::{Observability, PatchFrame};
use crate::math::Pose;

/// Projections; each leaves a small share of what the one before left.
const MAX_STEPS: u32 = 12;
/// Shorter ones, over the patch, are none.
const SHORTEST_MM: f64 = 1e-9;

/// The pose nearest to another one, over the patch, that free motions lead to.
pub(super) fn nearest(seen: &Observability, t_sensor_object: &Pose, other: &Pose) -> Pose {
    let frame = PatchFrame { centre_mm: seen.centre_mm, radius_mm: seen.radius_mm };
    let about = Pose::from_translation_mm(seen.centre_mm);
    let back = other.inverse();
    let mut pose = *t_sensor_object;
    for _ in 0..MAX_STEPS {
        let (omega, v) = frame.twist(&(pose * back));
        let (fixed_omega, fixed_v) = seen.determined((omega, v));
        let (omega, v) = (fixed_omega - omega, fixed_v - v);
        // As a screw: seen from the sensor, the surface is then where it was.
        let product = about * Pose::exp(omega, v) * about.inverse() * pose;
        pose = product.normalized().unwrap_or(pose);
        if (omega * frame.radius_mm).length_squared() + v.length_squared() < SHORTEST_MM * SHORTEST_MM {
            break;
        }
    }
    pose
}
