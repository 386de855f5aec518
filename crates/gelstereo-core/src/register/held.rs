//! Moves a pose back to the guess along free directions.
//!
//! Starts are spread over the uncertainty of the guess, and along a free direction each ends where it
//! began, so the result would be random. A free direction moves the part's surface within itself (slide,
//! spin or screw). The whole motion can therefore be undone, not just a small step.

use super::observe::{Observability, PatchFrame};
use crate::math::Pose;

/// Largest number of projections; each leaves a small share of the previous remainder.
const MAX_STEPS: u32 = 12;
/// Motions shorter than this over the patch count as zero.
const SHORTEST_MM: f64 = 1e-9;

/// The pose reachable by free motions that is nearest to `other` over the patch.
pub(super) fn nearest(seen: &Observability, t_sensor_object: &Pose, other: &Pose) -> Pose {
    let frame = PatchFrame { centre_mm: seen.centre_mm, radius_mm: seen.radius_mm };
    let about = Pose::from_translation_mm(seen.centre_mm);
    let back = other.inverse();
    let mut pose = *t_sensor_object;
    for _ in 0..MAX_STEPS {
        let (omega, v) = frame.twist(&(pose * back));
        let (fixed_omega, fixed_v) = seen.determined((omega, v));
        let (omega, v) = (fixed_omega - omega, fixed_v - v);
        // As a screw, which leaves the surface in place as seen from the sensor.
        let product = about * Pose::exp(omega, v) * about.inverse() * pose;
        pose = product.normalized().unwrap_or(pose);
        if (omega * frame.radius_mm).length_squared() + v.length_squared() < SHORTEST_MM * SHORTEST_MM {
            break;
        }
    }
    pose
}
