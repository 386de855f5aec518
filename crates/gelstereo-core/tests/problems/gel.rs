//! A part pressed into a plane of gel: an obstacle under a Pasternak foundation (springs joined by a shear
//! layer).

use super::parts::Part;
use super::{PITCH_MM, REST_MM, SIDE};
use gelstereo_core::math::{DVec3, Pose};

/// Nodes between two markers.
pub const FINE: usize = 3;
/// Decay of the shoulder beside the contact: 0.17 of a layer of 3.5 mm at Poisson's ratio 0.45.
pub const SHOULDER_MM: f64 = 0.6;
/// Of a soft one: half of a layer of 5 mm.
pub const SOFT_MM: f64 = 2.5;
const NODES: usize = (SIDE - 1) * FINE + 1;
const STEP_MM: f64 = PITCH_MM / FINE as f64;

/// Where the part is above the rest plane, and what the gel does about it.
pub struct Gel {
    /// Height of the part over the rest plane toward the camera, and the outward normal there (sensor frame);
    /// negative infinity where there is no part.
    obstacle: Vec<(f64, DVec3)>,
    settled: Vec<f64>,
}

impl Gel {
    /// The part at that pose, its shape seen along z.
    pub fn press(part: &Part, t_sensor_object: &Pose) -> Self {
        Self::press_into(SHOULDER_MM, part, t_sensor_object)
    }

    /// The same in a gel of that decay length.
    pub fn press_into(decay_mm: f64, part: &Part, t_sensor_object: &Pose) -> Self {
        let obstacle = heights(part, t_sensor_object);
        let settled = settle(&obstacle, decay_mm);
        Self { obstacle, settled }
    }

    /// Position, whether it touches the part, and the part's normal, of every marker.
    pub fn markers(&self) -> impl Iterator<Item = (DVec3, bool, DVec3)> + '_ {
        (0..SIDE * SIDE).map(|k| {
            let (row, col) = (k / SIDE * FINE, k % SIDE * FINE);
            let node = row * NODES + col;
            let (height, normal) = self.obstacle[node];
            let settled = self.settled[node];
            let touches = height > 0.0 && settled - height < 1e-9;
            (node_mm(row, col, REST_MM - settled), touches, normal)
        })
    }
}

fn node_mm(row: usize, col: usize, z: f64) -> DVec3 {
    let half = (NODES - 1) as f64 * 0.5;
    DVec3::new((col as f64 - half) * STEP_MM, (row as f64 - half) * STEP_MM, z)
}

/// Smallest z of the part over every node, as a height above the rest plane.
fn heights(part: &Part, pose: &Pose) -> Vec<(f64, DVec3)> {
    let mut out = vec![(f64::NEG_INFINITY, DVec3::ZERO); NODES * NODES];
    let half = (NODES - 1) as f64 * 0.5;
    let range = |low: f64, high: f64| {
        let first = (low / STEP_MM + half).ceil().max(0.0) as usize;
        first..(high / STEP_MM + half + 1.0).floor().clamp(0.0, NODES as f64) as usize
    };
    let back = pose.inverse();
    for corners in part.mesh.corners() {
        let facet = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        let c = corners.map(|p| pose.transform_point(p));
        let (low, high) = (c[0].min(c[1]).min(c[2]), c[0].max(c[1]).max(c[2]));
        for row in range(low.y, high.y) {
            for col in range(low.x, high.x) {
                let at = node_mm(row, col, 0.0).truncate();
                let [a, b, d] = c.map(|p| p.truncate() - at);
                let (u, v, w) = (b.perp_dot(d), d.perp_dot(a), a.perp_dot(b));
                let sum = u + v + w;
                let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
                if inside && sum != 0.0 {
                    let height = REST_MM - (u * c[0].z + v * c[1].z + w * c[2].z) / sum;
                    let place = &mut out[row * NODES + col];
                    if height > place.0 {
                        let at = back.transform_point(DVec3::new(at.x, at.y, REST_MM - height));
                        *place = (height, pose.transform_vector(part.normal(at, facet)));
                    }
                }
            }
        }
    }
    out
}

/// h - l² Δh = p, h >= obstacle, p >= 0: projected over-relaxation, the border at rest.
fn settle(obstacle: &[(f64, DVec3)], decay_mm: f64) -> Vec<f64> {
    let mut h: Vec<f64> = obstacle.iter().map(|(o, _)| o.max(0.0)).collect();
    let k = (decay_mm / STEP_MM) * (decay_mm / STEP_MM);
    let jacobi = 4.0 * k / (1.0 + 4.0 * k);
    let (over, sweeps) =
        if decay_mm > PITCH_MM { (2.0 / (1.0 + (1.0 - jacobi * jacobi).sqrt()), 160) } else { (1.6, 120) };
    let at = |h: &[f64], row: isize, col: isize| {
        // Beyond the border the gel goes on as it is.
        let clamp = |x: isize| x.clamp(0, NODES as isize - 1) as usize;
        h[clamp(row) * NODES + clamp(col)]
    };
    for _ in 0..sweeps {
        for row in 0..NODES as isize {
            for col in 0..NODES as isize {
                let n = row as usize * NODES + col as usize;
                let around =
                    at(&h, row - 1, col) + at(&h, row + 1, col) + at(&h, row, col - 1) + at(&h, row, col + 1);
                let free = k * around / (1.0 + 4.0 * k);
                h[n] = (h[n] + over * (free - h[n])).max(obstacle[n].0.max(0.0));
            }
        }
    }
    h
}
