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
    let (mut point_mm, slopes) = start(views, index, pair, &weights)?;
    for _ in 0..MAX_STEPS {
        let mut normal = Normal::zero();
        let mut linear = [([DVec3::ZERO; 2], DVec2::ZERO); 2];
        for (k, view) in VIEWS.into_iter().enumerate() {
            let seen = views[k].project_with_jacobian(point_mm, slopes[k]);
            let seen = seen.map_err(|error| TriangulateError::Ray { index, view, error })?;
            linear[k] = (seen.jacobian, pair.centres[k].at_px - seen.pixel_px);
            normal.add(&linear[k].0, linear[k].1, &weights[k]);
        }
        let covariance = normal.information.inverse();
        let step = covariance * normal.gradient;
        point_mm += step;
        let [left, right] = linear.map(|(rows, residual)| residual - along(&rows, step));
        let missed_px = left.length() + right.length();
        // A step leaves some residual / f of itself, or its own square over the depth: both below 1e-11 of the depth.
        let (length, depth) = (step.length(), point_mm.length());
        if length <= 1e-6 * depth && length * missed_px <= 2e-9 * depth {
            let epipolar_px = missed_px.copysign(left.y - right.y);
            return Ok(StereoPoint { point_mm, covariance_mm2: covariance.to_cols_array_2d(), epipolar_px });
        }
    }
    Err(TriangulateError::NoPoint { index })
}

const VIEWS: [View; 2] = [View::Left, View::Right];

/// A point to start from, and the slope of both rays in air: one step from the middle of the refracted rays. It needs
/// no search for a light path, because the nearest points of both rays are seen exactly at their pixels.
fn start(
    views: &[RigView<'_>; 2],
    index: usize,
    pair: &Pair<'_>,
    weights: &[Symmetric<2>; 2],
) -> Result<(DVec3, [f64; 2]), TriangulateError> {
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
        return Ok(((a + b) * 0.5, slopes));
    }
    let mut normal = Normal::zero();
    for k in 0..2 {
        let rows = views[k].jacobian_on_ray(nearest[k], slopes[k]);
        normal.add(&rows, along(&rows, nearest[k] - middle), &weights[k]);
    }
    Ok((middle + normal.information.inverse() * normal.gradient, slopes))
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
