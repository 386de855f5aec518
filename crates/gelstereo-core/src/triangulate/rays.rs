//! The exact rung: the most likely point of two centres with covariances, seen through the rig's layers.

use super::{Pair, StereoPoint, TriangulateError};
use crate::camera::{CameraError, Ray};
use crate::math::linalg::Symmetric;
use crate::math::{DMat3, DVec2, DVec3};
use crate::rig::{RigView, View};

/// Steps of Gauss and Newton. Two do for a marker; more only help pairs whose rays miss each other by millimetres.
const MAX_STEPS: usize = 20;

/// The least squares around one point: information A and gradient b of the step A⁻¹ b.
struct Normal {
    information: DMat3,
    gradient: DVec3,
}

impl Normal {
    const fn zero() -> Self {
        Self { information: DMat3::ZERO, gradient: DVec3::ZERO }
    }

    /// Adds one view: the gradients of its pixel, what is left to its centre, and the centre's weight.
    fn add(&mut self, [u, v]: &[DVec3; 2], residual: DVec2, weight: &Symmetric<2>) {
        let [[uu, uv], [_, vv]] = *weight;
        let (wu, wv) = (*u * uu + *v * uv, *u * uv + *v * vv);
        for (axis, (a, b)) in [(u.x, v.x), (u.y, v.y), (u.z, v.z)].into_iter().enumerate() {
            *self.information.col_mut(axis) += wu * a + wv * b;
        }
        self.gradient += wu * residual.x + wv * residual.y;
    }

    /// One step from `from_mm`, with what it leaves of the views' residuals, and its length and direction.
    fn solve(&self, from_mm: DVec3, views: &[([DVec3; 2], DVec2); 2]) -> (StereoPoint, DVec3) {
        let covariance = self.information.inverse();
        let step = covariance * self.gradient;
        let [left, right] = views.map(|(rows, residual)| residual - along(&rows, step));
        let epipolar_px = (left.length() + right.length()).copysign(left.y - right.y);
        let covariance_mm2 = covariance.to_cols_array_2d();
        (StereoPoint { point_mm: from_mm + step, covariance_mm2, epipolar_px }, step)
    }
}

/// The most likely point, in the sensor frame, with the inverse of the information as its covariance.
///
/// From the middle of the two refracted rays on, Gauss and Newton minimise the sum of the squared pixel residuals,
/// each weighted by its covariance (Hartley and Zisserman 2004, section 12.3).
pub(super) fn point(
    views: &[RigView<'_>; 2],
    index: usize,
    pair: &Pair<'_>,
) -> Result<StereoPoint, TriangulateError> {
    let mut weights = [[[0.0; 2]; 2]; 2];
    for (k, view) in VIEWS.into_iter().enumerate() {
        weights[k] =
            inverse(&pair.centres[k].covariance_px2).ok_or(TriangulateError::Covariance { index, view })?;
    }
    let (first, slopes) = start(views, index, pair, &weights)?;
    let mut point_mm = match first {
        Start::Done(found) => return Ok(found),
        Start::At(point_mm) => point_mm,
    };
    for _ in 0..MAX_STEPS {
        let mut normal = Normal::zero();
        let mut linear = [([DVec3::ZERO; 2], DVec2::ZERO); 2];
        for (k, view) in VIEWS.into_iter().enumerate() {
            let seen = views[k].project_with_jacobian(point_mm, slopes[k]);
            let seen = seen.map_err(|error| TriangulateError::Ray { index, view, error })?;
            linear[k] = (seen.jacobian, pair.centres[k].at_px - seen.pixel_px);
            normal.add(&linear[k].0, linear[k].1, &weights[k]);
        }
        let (found, step) = normal.solve(point_mm, &linear);
        point_mm = found.point_mm;
        // A step leaves some residual / f of itself, or its own square over the depth: both below 1e-11 of the depth.
        let (length, depth) = (step.length(), point_mm.length());
        if length <= 1e-6 * depth && length * found.epipolar_px.abs() <= 2e-9 * depth {
            return Ok(found);
        }
    }
    Err(TriangulateError::NoPoint { index })
}

const VIEWS: [View; 2] = [View::Left, View::Right];

/// Where the search begins, or already ends.
enum Start {
    At(DVec3),
    Done(StereoPoint),
}

/// A step that ends nearer than this to both rays, in units of sqrt(mm · depth), is the last: it leaves pixel residuals
/// of f (distance / depth)², 1e-6 px, and so a ten-thousandth of the standard deviation of centres good to 0.01 px.
const NEAR: f64 = 1.5e-4;

/// One step from the middle of the refracted rays, and the slope of both rays in air. It needs no search for a light
/// path, because the nearest points of both rays are seen exactly at their pixels.
fn start(
    views: &[RigView<'_>; 2],
    index: usize,
    pair: &Pair<'_>,
    weights: &[Symmetric<2>; 2],
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
    let mut normal = Normal::zero();
    let mut linear = [([DVec3::ZERO; 2], DVec2::ZERO); 2];
    for k in 0..2 {
        let rows = views[k].jacobian_on_ray(nearest[k], slopes[k]);
        linear[k] = (rows, along(&rows, nearest[k] - middle));
        normal.add(&rows, linear[k].1, &weights[k]);
    }
    let (found, _) = normal.solve(middle, &linear);
    let limit = NEAR * NEAR * found.point_mm.length();
    let near = nearest.iter().all(|on_ray| (*on_ray - found.point_mm).length_squared() <= limit);
    Ok((if near { Start::Done(found) } else { Start::At(found.point_mm) }, slopes))
}

/// The points of two lines that are nearest to each other; not finite for parallel lines.
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

/// Inverse of a positive definite matrix.
fn inverse(m: &Symmetric<2>) -> Option<Symmetric<2>> {
    let [[a, b], [c, d]] = *m;
    let determinant = a * d - b * c;
    let scale = 1.0 / determinant;
    let valid = a > 0.0 && determinant > 0.0 && scale.is_finite();
    valid.then(|| [[d * scale, -b * scale], [-c * scale, a * scale]])
}
