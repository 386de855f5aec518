//! Back to the guess along what a contact leaves free.
//!
//! A search starts all over the uncertainty of its guess, and along a free direction every start ends where it began:
//! chance would choose among them. A free direction is a motion of the part's surface within itself, a slide, a spin or a
//! screw, so that the whole of it can be taken back, not a small step alone.

use super::observe::{Observability, PatchFrame};
use super::{Contact, FreeDirections, Registration, Template};
use crate::math::linalg::Symmetric;
use crate::math::{DMat3, DVec3, Pose};
use crate::surface::Field;

/// Projections; each leaves a small share of what the one before left.
const MOST_STEPS: u32 = 12;
/// Shorter ones, over the patch, are none.
const SHORTEST_MM: f64 = 1e-9;
/// A marker so many standard deviations off, squared, says no more than that it is an outlier.
const STRAY: f64 = 9.0;
/// Three standard deviations, squared: by so much less may the markers like the pose.
const WORSE: f64 = 9.0;

/// Takes back the way from `guess` along the free directions, if the markers like the pose as well then.
pub(super) fn at_guess(
    found: &mut Registration,
    contact: &Contact<'_>,
    template: &Template,
    guess: &Pose,
    sigma_mm: f64,
) {
    let Some((_, field, _)) = template.touchable().filter(|_| found.observability.free_count() > 0) else {
        return;
    };
    let held = nearest(&found.observability, &found.t_sensor_object, guess);
    let worse =
        misfit(field, contact, &held, sigma_mm) - misfit(field, contact, &found.t_sensor_object, sigma_mm);
    if worse > WORSE {
        return;
    }
    found.t_sensor_object = held;
    let back = held.inverse();
    let in_object = found.observability.turned(&back, back.transform_point(found.observability.centre_mm));
    found.free = FreeDirections::new(&in_object, sigma_mm, &[]);
}

/// The pose nearest to another one, over the patch, that free motions lead to.
fn nearest(seen: &Observability, t_sensor_object: &Pose, other: &Pose) -> Pose {
    let frame = PatchFrame { centre_mm: seen.centre_mm, radius_mm: seen.radius_mm };
    let about = Pose::from_translation_mm(seen.centre_mm);
    let back = other.inverse();
    let mut pose = *t_sensor_object;
    for _ in 0..MOST_STEPS {
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

/// What a pose says of the markers, a sum of squares in standard deviations: those in contact lie on the part, or
/// anywhere else, and no other is within it.
fn misfit(field: &Field, contact: &Contact<'_>, t_sensor_object: &Pose, sigma_mm: f64) -> f64 {
    let back = t_sensor_object.inverse();
    let squared = |p: DVec3, covariance: Option<&Symmetric<3>>, touches: bool| {
        let Some((distance_mm, gradient)) = field.distance(back.transform_point(p)) else {
            return if touches { STRAY } else { 0.0 };
        };
        let normal = t_sensor_object.transform_vector(gradient);
        let variance = |c: &Symmetric<3>| normal.dot(DMat3::from_cols_array_2d(c) * normal).max(0.0);
        let off_mm = if touches { distance_mm } else { distance_mm.min(0.0) };
        (off_mm * off_mm / covariance.map_or(sigma_mm * sigma_mm, variance)).min(STRAY)
    };
    let pressed = contact.points_mm.iter().enumerate();
    let pressed = pressed.map(|(k, &p)| squared(p, contact.covariance_mm2.and_then(|c| c.get(k)), true));
    pressed.chain(contact.unpressed_mm.iter().map(|&p| squared(p, None, false))).sum()
}
