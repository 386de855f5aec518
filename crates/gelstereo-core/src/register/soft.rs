//! The soft nearest neighbour of FilterReg (Gao and Tedrake 2019, Eq. 8): exact Gaussian sums over the template.

use super::observe::Sighting;
use super::template::Template;
use crate::math::{DVec3, exp, ln, sqrt};

/// What a point sees of the template through a Gaussian of width σ, with p_k ∝ exp(-|y_k - x|² / 2σ²).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoftMatch {
    /// ln Σ exp(-|y_k - x|² / 2σ²): finite however far the template is.
    pub log_mass: f64,
    /// m - x, with m = Σ p_k y_k.
    pub offset_mm: DVec3,
    /// Σ p_k |y_k - m|².
    pub spread_mm2: f64,
    /// Unit mean normal Σ p_k n_k; the nearest point's where that vanishes.
    pub normal: DVec3,
    /// Σ p_k n_k·(y_k - x), the mean distance to the planes of the template's points.
    pub plane_distance_mm: f64,
    /// Index of the nearest point.
    pub nearest: usize,
    /// Distance of the nearest point.
    pub distance_mm: f64,
}

impl SoftMatch {
    /// The point's line of the linear system.
    ///
    /// On a curved surface n̂·(m - x) is short by κ σ² and Σ p n·(y - x) long by as much; their mean, the distance along
    /// the mean of the two points' normals, is right to the second order (Rusinkiewicz 2019).
    pub(super) fn sighting(&self, template: &Template, lever: DVec3, weight: f64, sigma_mm: f64) -> Sighting {
        let along = self.normal.dot(self.offset_mm);
        Sighting {
            lever,
            normal: self.normal,
            residual: 0.5 * (along + self.plane_distance_mm),
            weight,
            normal_variance: template.step_variance(self.nearest, self.offset_mm, sigma_mm),
        }
    }
}

/// The soft match of `point` (object frame) at width `sigma_mm`.
///
/// The sums are taken relative to the nearest point's term, so that none of them underflows, and to offsets from
/// `point`, so that none of them cancels. Points whose term is below e^-45 / N of the nearest one's are left out:
/// all N of them together are less than e^-45 = 3e-20 of the sum, and their lever, (1 + 90 + 2 ln N)^½ σ at the cut
/// where it matters most, keeps them below half an ulp of the mean.
#[must_use]
pub fn soft_match(template: &Template, point: DVec3, sigma_mm: f64) -> SoftMatch {
    let (tree, points, normals) = (template.tree(), template.points_mm(), template.normals());
    let (nearest, least) = tree.nearest(point).unwrap_or((0, 0.0));
    let twice_variance = 2.0 * sigma_mm * sigma_mm;
    let reach = least + twice_variance * (45.0 + ln(points.len() as f64));
    let mut sum = Sums::default();
    tree.within(point, reach, &mut |k, distance_squared| {
        let term = exp((least - distance_squared) / twice_variance);
        sum.add(term, points[k] - point, normals[k]);
    });
    let mean_normal = sum.normal / sum.mass;
    let length = sqrt(mean_normal.length_squared());
    SoftMatch {
        log_mass: ln(sum.mass) - least / twice_variance,
        offset_mm: sum.mean,
        spread_mm2: sum.spread / sum.mass,
        normal: if length > 1e-6 { mean_normal / length } else { normals[nearest] },
        plane_distance_mm: sum.plane / sum.mass,
        nearest,
        distance_mm: sqrt(least),
    }
}

/// Weighted moments; mean and spread by the update of West (1979), which does not cancel.
#[derive(Default)]
struct Sums {
    mass: f64,
    mean: DVec3,
    spread: f64,
    normal: DVec3,
    plane: f64,
}

impl Sums {
    fn add(&mut self, weight: f64, offset: DVec3, normal: DVec3) {
        self.mass += weight;
        let from_mean = offset - self.mean;
        self.mean += from_mean * (weight / self.mass);
        self.spread += weight * from_mean.dot(offset - self.mean);
        self.normal += normal * weight;
        self.plane += weight * normal.dot(offset);
    }
}
