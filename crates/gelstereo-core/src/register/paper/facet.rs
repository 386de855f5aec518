//! Facet of the template's surface under a point, with its uncertainty.

use crate::math::{DVec3, exp};
use crate::register::template::Template;

/// A surface normal with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Facet {
    /// Normal of the most probable template point.
    pub normal: DVec3,
    /// τ², the variance of the normal along the axes across it: Σ p |n_k - n|² / 2.
    pub normal_variance: f64,
}

/// Cutoff in widths: template points farther beyond the nearest one have less than e^-8 of its weight.
const WIDTHS: f64 = 4.0;

/// The facet under `point`, which is known to `sigma_mm` along normals.
///
/// Its normal is that of the template point with the largest
/// exp(-|y_k - x|² / 2 s² - (n_k·(y_k - x))² / 2 σ²): near x, with x in its plane. This separates the two
/// faces of an edge although samples are much farther apart than σ. Its variance is over all p_k ∝
/// exp(-|y_k - x|² / 2 s²). Near an edge a point is evidence for neither face alone, because a contact
/// that ends at an edge is constrained from one side only.
pub(super) fn facet(template: &Template, point: DVec3, width_mm: f64, sigma_mm: f64) -> Facet {
    let (tree, points, normals) = (template.tree(), template.points_mm(), template.normals());
    let (nearest, min_squared) = tree.nearest(point).unwrap_or((0, 0.0));
    let reach = min_squared + (WIDTHS * width_mm) * (WIDTHS * width_mm);
    let log_near = |distance_squared: f64| 0.5 * (min_squared - distance_squared) / (width_mm * width_mm);
    let mut best = (nearest, f64::NEG_INFINITY);
    tree.within(point, reach, &mut |k, distance_squared| {
        let off_plane = normals[k].dot(points[k] - point) / sigma_mm;
        let log = log_near(distance_squared) - 0.5 * off_plane * off_plane;
        if log > best.1 || (log == best.1 && k < best.0) {
            best = (k, log);
        }
    });
    let normal = normals[best.0];
    let (mut mass, mut turn) = (0.0, 0.0);
    tree.within(point, reach, &mut |k, distance_squared| {
        let p = exp(log_near(distance_squared));
        mass += p;
        turn += p * normals[k].distance_squared(normal);
    });
    Facet { normal, normal_variance: 0.5 * turn / mass }
}
