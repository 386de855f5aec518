//! Normals of the smooth surface that the facets of a part stand for.
//!
//! Facet normals would determine even the spin of a cylinder, to the angle of a facet: by the meshing and
//! not by the part.

use crate::math::{DVec3, abs, sqrt};
use crate::stop::{Stop, Stopped, ask};
use crate::surface::{Closest, Solid};
use alloc::vec::Vec;

/// Faces that meet at less than 32 degrees are one smooth surface: a cylinder of 12 facets is one, a
/// hexagon has edges.
pub(super) const CREASE_COS: f64 = 0.85;
/// Least distance that defines a direction.
const MIN_MM: f64 = 1e-3;

/// Normals at the corners of every triangle, of the smooth surface on that triangle's side of its creases.
#[derive(Clone, Debug)]
pub(in crate::register) struct Relief {
    corners: Vec<[DVec3; 3]>,
    /// Largest rotation of the normal over an edge of the triangle, rad/mm.
    curvatures_per_mm: Vec<f64>,
}

/// Normal of the smooth surface, and its curvature.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slope {
    pub normal: DVec3,
    pub curvature_per_mm: f64,
}

impl Relief {
    pub fn new(solid: &Solid, stop: Stop<'_>) -> Result<Self, Stopped> {
        let (places, triangles) = (solid.vertices_mm(), solid.triangles());
        let around = Around::new(places.len(), triangles);
        let mut out = Self { corners: Vec::new(), curvatures_per_mm: Vec::new() };
        for (k, triangle) in triangles.iter().enumerate() {
            ask(stop, k)?;
            let own = solid.face_normal(k as u32);
            let corner = |v: u32| {
                let mut sum = DVec3::ZERO;
                for &j in around.of(v) {
                    let normal = solid.face_normal(j);
                    if normal.dot(own) > CREASE_COS {
                        sum += normal * angle_at(places, &triangles[j as usize], v);
                    }
                }
                let length = sqrt(sum.length_squared());
                if length > 0.0 { sum / length } else { own }
            };
            let normals = triangle.map(corner);
            let turn = (0..3).map(|i| {
                let j = (i + 1) % 3;
                let way = places[triangle[i] as usize].distance_squared(places[triangle[j] as usize]);
                if way > 0.0 { normals[i].distance_squared(normals[j]) / way } else { 0.0 }
            });
            out.curvatures_per_mm.push(sqrt(turn.fold(0.0, f64::max)));
            out.corners.push(normals);
        }
        Ok(out)
    }

    /// From surface samples that stand for two triangles each.
    pub fn of_samples(normals: &[DVec3], curvatures_per_mm: &[f64]) -> Self {
        let twice = |k: usize| k / 2;
        Self {
            corners: (0..2 * normals.len()).map(|k| [normals[twice(k)]; 3]).collect(),
            curvatures_per_mm: (0..2 * normals.len()).map(|k| curvatures_per_mm[twice(k)]).collect(),
        }
    }

    /// Slope at the nearest point of a position `offset_mm` away from it, for a gel of scale `gel_scale`.
    pub(super) fn slope(&self, solid: &Solid, found: &Closest, offset_mm: DVec3, gel_scale: f64) -> Slope {
        let k = found.triangle as usize;
        let curvature_per_mm = self.curvatures_per_mm[k];
        let corners = solid.triangles()[k].map(|v| solid.vertices_mm()[v as usize]);
        let smooth =
            interpolate(&self.corners[k], &corners, found.point_mm, solid.face_normal(found.triangle));
        // Beyond an edge the distance grows away from the edge; nearer than [`MIN_MM`] its direction is
        // undefined.
        if found.normal.dot(smooth) < 0.99 && abs(found.distance_mm) > MIN_MM * gel_scale {
            return Slope { normal: offset_mm / found.distance_mm, curvature_per_mm };
        }
        Slope { normal: smooth, curvature_per_mm }
    }
}

/// Barycentric interpolation of three unit vectors at a point of the triangle.
fn interpolate(normals: &[DVec3; 3], [a, b, c]: &[DVec3; 3], at: DVec3, face: DVec3) -> DVec3 {
    if normals[0] == normals[1] && normals[1] == normals[2] {
        return normals[0];
    }
    let [u, v, w] = [(*b - at).cross(*c - at), (*c - at).cross(*a - at), (*a - at).cross(*b - at)]
        .map(|x| x.dot(face).max(0.0));
    let sum = normals[0] * u + normals[1] * v + normals[2] * w;
    let length = sqrt(sum.length_squared());
    if length > 0.0 { sum / length } else { face }
}

fn angle_at(places: &[DVec3], triangle: &[u32; 3], vertex: u32) -> f64 {
    let at = triangle.iter().position(|&v| v == vertex).unwrap_or(0);
    let [a, b, c] = [0, 1, 2].map(|k| places[triangle[(at + k) % 3] as usize]);
    let (to, from) = (b - a, c - a);
    crate::math::atan2(sqrt(to.cross(from).length_squared()), to.dot(from))
}

/// The triangles at every vertex.
struct Around {
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl Around {
    fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let mut starts = alloc::vec![0_u32; vertices + 1];
        for &v in triangles.iter().flatten() {
            starts[v as usize + 1] += 1;
        }
        for k in 0..vertices {
            starts[k + 1] += starts[k];
        }
        let mut next = starts.clone();
        let mut of = alloc::vec![0; triangles.len() * 3];
        for (k, triangle) in triangles.iter().enumerate() {
            for &v in triangle {
                of[next[v as usize] as usize] = k as u32;
                next[v as usize] += 1;
            }
        }
        Self { starts, triangles: of }
    }

    fn of(&self, vertex: u32) -> &[u32] {
        &self.triangles[self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }
}
