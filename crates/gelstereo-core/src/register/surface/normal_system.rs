//! Linear system of a step in six directions (ρ ω, v) about the patch's centroid, in the sensor's axes.

use crate::math::{DMat3, DVec3, Pose, so3, solve_definite, sqrt};

/// Pose of the part relative to the patch's centroid: a common offset costs no digits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    /// Maps object coordinates to sensor axes about the centroid.
    pub pose: Pose,
    /// Maps sensor axes to object axes.
    back: DMat3,
}

impl Placement {
    pub fn new(pose: Pose) -> Self {
        Self { pose, back: pose.matrix().transpose() }
    }

    /// Maps a point relative to the centroid to the object's frame.
    #[inline]
    pub fn object_point(&self, p_mm: DVec3) -> DVec3 {
        self.back * (p_mm - self.pose.translation_mm)
    }

    /// Maps a direction from the sensor's frame to the object's.
    #[inline]
    pub fn object_direction(&self, v: DVec3) -> DVec3 {
        self.back * v
    }

    /// Maps a direction from the object's frame to the sensor's.
    #[inline]
    pub fn sensor_direction(&self, v: DVec3) -> DVec3 {
        self.back.transpose() * v
    }

    /// The placement after a rotation by ω about the centroid and a translation by v.
    pub fn moved(&self, omega: DVec3, v_mm: DVec3) -> Self {
        let turn = so3::exp(omega);
        let rotation = turn * self.pose.rotation;
        let translation_mm = turn * self.pose.translation_mm + v_mm;
        let moved = Pose { rotation, translation_mm };
        Self::new(moved.normalized().unwrap_or(self.pose))
    }

    /// Rotation ω and translation v about the centroid from another placement to this one.
    pub fn since(&self, other: &Self) -> (DVec3, DVec3) {
        let turn = (self.pose.rotation * other.pose.rotation.conjugate()).normalize();
        let omega = so3::log(if turn.w < 0.0 { -turn } else { turn });
        (omega, self.pose.translation_mm - turn * other.pose.translation_mm)
    }
}

/// Upper triangle of H = Σ w J Jᵀ / σ² by rows, g = Σ w J d / σ², and the cost.
#[derive(Clone, Copy, Debug)]
pub(super) struct Normal {
    h: [[f64; 6]; 6],
    g: [f64; 6],
    pub cost: f64,
}

impl Normal {
    pub const ZERO: Self = Self { h: [[0.0; 6]; 6], g: [0.0; 6], cost: 0.0 };

    /// Adds a point p at distance d with the sensor-frame normal n and weight w / σ². Moving the part by
    /// (ω, v) changes d by -n·(v + ω × p). `per_radius` is 1 / ρ.
    #[inline]
    pub fn add(&mut self, p_mm: DVec3, n: DVec3, d_mm: f64, weight: f64, per_radius: f64) {
        let m = p_mm.cross(n) * per_radius;
        let j = [m.x, m.y, m.z, n.x, n.y, n.z];
        for i in 0..6 {
            let wj = weight * j[i];
            self.g[i] += wj * d_mm;
            for k in i..6 {
                self.h[i][k] += wj * j[k];
            }
        }
    }

    /// Adds the guess as a prior with standard deviations of ρ ω and v per axis.
    pub fn add_prior(&mut self, prior: &Prior, placement: &Placement, radius_mm: f64, scale: f64) {
        let (omega, v) = placement.since(&prior.guess);
        let turn = scale / (prior.sigma_rad * prior.sigma_rad * radius_mm * radius_mm);
        let shift = scale / (prior.sigma_mm * prior.sigma_mm);
        let z = [omega * radius_mm, v];
        for (half, weight) in [turn, shift].into_iter().enumerate() {
            for axis in 0..3 {
                let k = 3 * half + axis;
                self.h[k][k] += weight;
                self.g[k] -= weight * z[half][axis];
                self.cost += 0.5 * weight * z[half][axis] * z[half][axis];
            }
        }
    }

    /// Upper triangle of H, and g.
    pub fn parts(&self) -> (&[[f64; 6]; 6], &[f64; 6]) {
        (&self.h, &self.g)
    }

    /// The step (ω, v), at most `limit_mm` over the patch. The prior keeps H positive definite.
    pub fn solve(&self, radius_mm: f64, limit_mm: f64) -> Option<(DVec3, DVec3)> {
        let z = solve_definite(&self.h, &self.g)?;
        let length = sqrt(z.iter().map(|z| z * z).sum());
        if !length.is_finite() {
            return None;
        }
        let share = if length > limit_mm { limit_mm / length } else { 1.0 };
        let z = z.map(|z| z * share);
        Some((DVec3::new(z[0], z[1], z[2]) / radius_mm, DVec3::new(z[3], z[4], z[5])))
    }
}

/// Guess of the pose, and its standard deviations.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prior {
    pub guess: Placement,
    pub sigma_rad: f64,
    pub sigma_mm: f64,
}
