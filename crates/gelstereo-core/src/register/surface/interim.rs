//! Distances on a grid.

use crate::math::{DVec3, floor, sqrt};
use crate::surface::{Solid, TriangleMesh};
use alloc::vec::Vec;

#[derive(Clone, Debug)]
pub(crate) struct DistanceField {
    low: DVec3,
    spacing_mm: f64,
    n: [usize; 3],
    values: Vec<f32>,
}

impl DistanceField {
    pub fn new(mesh: &TriangleMesh, solid: &Solid, spacing_mm: f64, margin_mm: f64) -> Self {
        let (low, high) = mesh.bounds_mm();
        let low = low - margin_mm;
        let n = ((high + margin_mm - low) / spacing_mm).to_array().map(|x| x as usize + 2);
        let mut values = Vec::new();
        let mut hint = 0;
        for k in 0..n[2] {
            for j in 0..n[1] {
                for i in 0..n[0] {
                    let p = low + DVec3::new(i as f64, j as f64, k as f64) * spacing_mm;
                    let c = solid.closest_from(p, hint);
                    hint = c.triangle;
                    values.push(c.distance_mm as f32);
                }
            }
        }
        Self { low, spacing_mm, n, values }
    }

    pub fn spacing_mm(&self) -> f64 {
        self.spacing_mm
    }

    #[inline]
    pub fn distance_and_normal(&self, p: DVec3) -> (f64, DVec3) {
        let u = (p - self.low) / self.spacing_mm;
        let top = DVec3::new(self.n[0] as f64 - 1.001, self.n[1] as f64 - 1.001, self.n[2] as f64 - 1.001);
        let c = u.clamp(DVec3::ZERO, top);
        let (fx, fy, fz) = (floor(c.x), floor(c.y), floor(c.z));
        let (x, y, z) = (c.x - fx, c.y - fy, c.z - fz);
        let (sx, sy) = (self.n[0], self.n[0] * self.n[1]);
        let base = fx as usize + fy as usize * sx + fz as usize * sy;
        let v = |o: usize| f64::from(self.values[base + o]);
        let (v000, v100, v010, v110) = (v(0), v(1), v(sx), v(sx + 1));
        let (v001, v101, v011, v111) = (v(sy), v(sy + 1), v(sy + sx), v(sy + sx + 1));
        let lerp = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let (a00, a10, a01, a11) = (lerp(v000, v100, x), lerp(v010, v110, x), lerp(v001, v101, x), lerp(v011, v111, x));
        let (b0, b1) = (lerp(a00, a10, y), lerp(a01, a11, y));
        let d = lerp(b0, b1, z);
        let gx = lerp(lerp(v100 - v000, v110 - v010, y), lerp(v101 - v001, v111 - v011, y), z);
        let gy = lerp(a10 - a00, a11 - a01, z);
        let gz = b1 - b0;
        let mut g = DVec3::new(gx, gy, gz);
        let beyond = (u - c) * self.spacing_mm;
        if beyond != DVec3::ZERO {
            let far = sqrt(beyond.length_squared());
            return (d + far, beyond / far);
        }
        let length = sqrt(g.length_squared());
        g = if length > 1e-9 { g / length } else { DVec3::Z };
        (d, g)
    }
}
