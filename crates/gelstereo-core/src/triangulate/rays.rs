//! The exact rung: the most likely point of two centres with covariances, seen through the rig's layers.

use super::error::TriangulateError;
use super::point::{Pair, StereoPoint, finite, sum_of_squares};
use super::root::Root;
use crate::camera::{CameraError, Ray};
use crate::math::{DVec2, DVec3, sqrt};
use crate::rig::{RigView, View};

/// Most Gauss-Newton steps. Two suffice for a marker; more only help pairs whose rays miss each other by
/// millimetres.
const MAX_STEPS: usize = 20;

/// Gradients of one view's pixel by the point, and the residual to its centre.
type Linear = ([DVec3; 2], DVec2);

/// Result of a Gauss-Newton step.
struct Step {
    found: StereoPoint,
    step_mm: DVec3,
}

/// One Gauss-Newton step: least squares of both views' residuals, each weighted by its covariance. `None`
/// when the point is not determined.
///
/// The gradients, whitened by the centres' noise, are orthogonalised (modified Gram-Schmidt). This keeps
/// precision that the information matrix A = Jᵀ W J would lose, and makes the covariance A⁻¹ = R⁻¹ R⁻ᵀ a
/// sum of squares (Björck 1996, section 2.4).
fn step(from_mm: DVec3, views: &[Linear; 2], roots: &[Root; 2]) -> Option<Step> {
    let (mut j, mut rest) = ([[0.0; 4]; 3], [0.0; 4]);
    for k in 0..2 {
        let (rows, residual) = roots[k].whiten(&views[k].0, views[k].1);
        for (axis, column) in j.iter_mut().enumerate() {
            (column[2 * k], column[2 * k + 1]) = (rows[0][axis], rows[1][axis]);
        }
        (rest[2 * k], rest[2 * k + 1]) = (residual.x, residual.y);
    }
    let [mut x, mut y, mut z] = j;
    let least = DVec3::new(dot(&x, &x), dot(&y, &y), dot(&z, &z)) * ROUND_OFF;
    let xx = normalise(&mut x, least.x)?;
    let (xy, xz, x_rest) = (take(&mut y, &x), take(&mut z, &x), take(&mut rest, &x));
    let yy = normalise(&mut y, least.y)?;
    let (yz, y_rest) = (take(&mut z, &y), take(&mut rest, &y));
    let zz = normalise(&mut z, least.z)?;
    let z_rest = take(&mut rest, &z);
    // Columns of R⁻¹; xx, yy and zz are the inverses of R's diagonal.
    let first = DVec3::new(xx, 0.0, 0.0);
    let second = DVec3::new(-xy * xx, 1.0, 0.0) * yy;
    let third = DVec3::new((xy * yz * yy - xz) * xx, -yz * yy, 1.0) * zz;
    let step_mm = first * x_rest + second * y_rest + third * z_rest;
    let left = roots[0].colour(DVec2::new(rest[0], rest[1]));
    let right = roots[1].colour(DVec2::new(rest[2], rest[3]));
    let epipolar_px = (left.length() + right.length()).copysign(left.y - right.y);
    let covariance_mm2 = sum_of_squares(&[first, second, third]);
    let found = StereoPoint { point_mm: from_mm + step_mm, covariance_mm2, epipolar_px };
    Some(Step { found, step_mm })
}

/// Squared rounding error of a column that depends on those before it: some ten roundings.
const ROUND_OFF: f64 = 100.0 * f64::EPSILON * f64::EPSILON;

fn dot(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
}

/// Normalises a column and returns its inverse length, unless its squared length is a rounding error.
fn normalise(column: &mut [f64; 4], least: f64) -> Option<f64> {
    let square = dot(column, column);
    if !(square > least) {
        return None;
    }
    let inverse = 1.0 / sqrt(square);
    column.iter_mut().for_each(|x| *x *= inverse);
    Some(inverse)
}

/// Removes the component along a unit vector and returns it.
fn take(column: &mut [f64; 4], unit: &[f64; 4]) -> f64 {
    let along = dot(column, unit);
    column.iter_mut().zip(unit).for_each(|(x, u)| *x -= along * u);
    along
}

/// The most likely point, in the sensor frame, with the inverse of the information matrix as its
/// covariance.
///
/// Starting midway between the two refracted rays, Gauss-Newton minimises the sum of the squared pixel
/// residuals, each weighted by its covariance (Hartley and Zisserman 2004, section 12.3). If the first
/// step ends as `near` to both rays, it is the last ([`NEAR`]).
pub(super) fn point(
    views: &[RigView<'_>; 2],
    index: usize,
    pair: &Pair<'_>,
    near: f64,
) -> Result<StereoPoint, TriangulateError> {
    let (first, slopes) = start(views, index, pair, near)?;
    let mut point_mm = match first {
        Start::Done(found) => return finite(index, found),
        Start::At(point_mm) => point_mm,
    };
    for _ in 0..MAX_STEPS {
        let mut linear = [([DVec3::ZERO; 2], DVec2::ZERO); 2];
        for (k, view) in VIEWS.into_iter().enumerate() {
            let seen = views[k].project_with_jacobian(point_mm, slopes[k]);
            let seen = seen.map_err(|error| TriangulateError::Ray { index, view, error })?;
            linear[k] = (seen.jacobian, pair.centres[k].at_px - seen.pixel_px);
        }
        let next = step(point_mm, &linear, &pair.roots).ok_or(TriangulateError::Unknown { index })?;
        let found = next.found;
        point_mm = found.point_mm;
        // The remaining error of a step is about residual / f of its length, or its square over the
        // depth: both below 1e-11 of the depth.
        let (length, depth) = (next.step_mm.length(), point_mm.length());
        if length <= 1e-6 * depth && length * found.epipolar_px.abs() <= 2e-9 * depth {
            return finite(index, found);
        }
    }
    Err(TriangulateError::NoPoint { index })
}

const VIEWS: [View; 2] = [View::Left, View::Right];

/// Start of the iteration, or its result.
enum Start {
    At(DVec3),
    Done(StereoPoint),
}

/// A step that ends nearer than this to both rays, in units of sqrt(mm · depth), is the last. It leaves
/// pixel residuals of f (distance / depth)², 3e-6 px, less than a thousandth of the standard deviation of
/// centres good to 0.01 px.
pub(super) const NEAR: f64 = 2.4e-4;

/// The same for points that need only a map's accuracy: 3e-4 px at most, and less than 0.1 um.
pub(super) const NEAR_AS_MAPPED: f64 = 10.0 * NEAR;

/// One step from the midpoint of the refracted rays, and the slope of both rays in air. It needs no
/// search for a light path, as the nearest points of both rays project exactly to their pixels.
fn start(
    views: &[RigView<'_>; 2],
    index: usize,
    pair: &Pair<'_>,
    near: f64,
) -> Result<(Start, [f64; 2]), TriangulateError> {
    let mut sights = [(Ray { origin_mm: DVec3::ZERO, direction: DVec3::Z }, 0.0); 2];
    for (k, view) in VIEWS.into_iter().enumerate() {
        let error = CameraError::MissesLayers { pixel_px: pair.centres[k].at_px };
        let fail = TriangulateError::Ray { index, view, error };
        sights[k] = views[k].ray_along(pair.normalised[k]).ok_or(fail)?;
    }
    let slopes = [sights[0].1, sights[1].1];
    let nearest = nearest_points(&sights[0].0, &sights[1].0);
    let middle = (nearest[0] + nearest[1]) * 0.5;
    if !views[0].is_in_gel(middle) {
        let [a, b] = nearest_points(
            &views[0].ray_in_air(pair.normalised[0]),
            &views[1].ray_in_air(pair.normalised[1]),
        );
        return Ok((Start::At((a + b) * 0.5), slopes));
    }
    let mut linear = [([DVec3::ZERO; 2], DVec2::ZERO); 2];
    for k in 0..2 {
        let rows = views[k].jacobian_on_ray(nearest[k], slopes[k]);
        linear[k] = (rows, along(&rows, nearest[k] - middle));
    }
    let next = step(middle, &linear, &pair.roots).ok_or(TriangulateError::Unknown { index })?;
    let found = next.found;
    let limit = near * near * found.point_mm.length();
    let is_near = nearest.iter().all(|on_ray| (*on_ray - found.point_mm).length_squared() <= limit);
    Ok((if is_near { Start::Done(found) } else { Start::At(found.point_mm) }, slopes))
}

/// Mutually nearest points of two lines; not finite for parallel lines.
fn nearest_points(a: &Ray, b: &Ray) -> [DVec3; 2] {
    let normal = a.direction.cross(b.direction);
    let between = b.origin_mm - a.origin_mm;
    let scale = 1.0 / normal.length_squared();
    let reach = |other: DVec3| between.cross(other).dot(normal) * scale;
    [a.origin_mm + a.direction * reach(b.direction), b.origin_mm + b.direction * reach(a.direction)]
}

fn along([u, v]: &[DVec3; 2], step: DVec3) -> DVec2 {
    DVec2::new(u.dot(step), v.dot(step))
}
