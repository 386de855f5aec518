//! Normals of faces, and pseudo-normals of edges and vertices, which give the sign of the distance
//! everywhere (Baerentzen and Aanaes 2005).

use super::weld::{Kind, Welded, lengths_squared};
use crate::math::{DVec3, atan2, sqrt};
use crate::stop::{Stop, Stopped, ask};
use crate::surface::area_vector;
use alloc::vec::Vec;

/// Largest number of consecutive triangles without area to cross in search of a face.
const LOOKED_THROUGH: usize = 16;

/// Outward unit normals; zero where there is none.
pub(super) struct Normals {
    /// Of every triangle.
    pub faces: Vec<DVec3>,
    pub edges: Vec<DVec3>,
    pub vertices: Vec<DVec3>,
}

pub(super) fn normals(welded: &Welded, stop: Stop<'_>) -> Result<Normals, Stopped> {
    let faces: Vec<DVec3> = (0..welded.corners.len())
        .map(|t| {
            ask(stop, t)?;
            Ok(match welded.kinds[t] {
                Kind::Face => face_normal(welded, t),
                Kind::Cap | Kind::Left => DVec3::ZERO,
            })
        })
        .collect::<Result<_, Stopped>>()?;
    let edges = (0..welded.edges.len())
        .map(|edge| ask(stop, edge).map(|()| edge_normal(welded, &faces, edge)))
        .collect::<Result<_, Stopped>>()?;
    let vertices = vertex_normals(welded, &faces, stop)?;
    Ok(Normals { faces, edges, vertices })
}

/// The unit vector, or zero when it has no direction.
pub(super) fn unit(v: DVec3) -> DVec3 {
    let largest = v.abs().max_element();
    if largest > 0.0 && largest.is_finite() {
        let scaled = v / largest;
        scaled / sqrt(scaled.length_squared())
    } else {
        DVec3::ZERO
    }
}

/// Made orthogonal to the longest edge: for a sliver the cross product is not, by rounding over its height.
fn face_normal(welded: &Welded, triangle: usize) -> DVec3 {
    let (places, first) = (welded.places(triangle), longest(welded, triangle));
    let along = unit(places[(first + 1) % 3] - places[first]);
    let normal = unit(area_vector(&places));
    unit(normal - along * normal.dot(along))
}

/// Every face has the angle π at an edge, so all weights are equal.
fn edge_normal(welded: &Welded, faces: &[DVec3], edge: usize) -> DVec3 {
    let mut sum = DVec3::ZERO;
    for side in welded.uses(edge) {
        let triangle = side.triangle as usize;
        sum += match welded.kinds[triangle] {
            Kind::Face => faces[triangle],
            // At a cap's long edge, uses the faces across both short edges; at a short edge, the face
            // across the long one.
            Kind::Cap if usize::from(side.corner) == longest(welded, triangle) => {
                let others = [1, 2].map(|k| (usize::from(side.corner) + k) % 3);
                unit(others.iter().map(|&k| across(welded, faces, triangle, k)).sum())
            }
            Kind::Cap | Kind::Left => behind(welded, faces, triangle),
        };
    }
    // The normals of two faces back to back cancel, and a sum of rounding errors has no direction.
    if sum.length_squared() > 1e-24 { unit(sum) } else { first_face(welded, faces, edge) }
}

fn first_face(welded: &Welded, faces: &[DVec3], edge: usize) -> DVec3 {
    let mut normals = welded.uses(edge).iter().map(|side| faces[side.triangle as usize]);
    normals.find(|&n| n != DVec3::ZERO).unwrap_or(DVec3::ZERO)
}

/// Normal of the triangle on the other side of an edge; zero if it has no area.
fn across(welded: &Welded, faces: &[DVec3], triangle: usize, corner: usize) -> DVec3 {
    other(welded, triangle, corner).map_or(DVec3::ZERO, |t| faces[t])
}

fn other(welded: &Welded, triangle: usize, corner: usize) -> Option<usize> {
    let edge = welded.edges_of[triangle][corner];
    welded.uses(edge as usize).iter().map(|side| side.triangle as usize).find(|&t| t != triangle)
}

/// Normal of the face next to a cap, across the cap's longest edge.
fn behind(welded: &Welded, faces: &[DVec3], cap: usize) -> DVec3 {
    let mut at = cap;
    for _ in 0..LOOKED_THROUGH {
        match other(welded, at, longest(welded, at)) {
            Some(next) if welded.kinds[next] == Kind::Face => return faces[next],
            Some(next) => at = next,
            None => break,
        }
    }
    DVec3::ZERO
}

/// The corner at which the longest edge starts; the first of equals.
pub(super) fn longest(welded: &Welded, triangle: usize) -> usize {
    let [a, b, c] = lengths_squared(&welded.places(triangle));
    if a >= b && a >= c {
        0
    } else if b >= c {
        1
    } else {
        2
    }
}

/// Sums of the faces' normals, weighted by their angles at the vertex.
fn vertex_normals(welded: &Welded, faces: &[DVec3], stop: Stop<'_>) -> Result<Vec<DVec3>, Stopped> {
    let mut sums = alloc::vec![DVec3::ZERO; welded.vertices_mm.len()];
    let mut first = sums.clone();
    for triangle in 0..welded.corners.len() {
        ask(stop, triangle)?;
        let normal = match welded.kinds[triangle] {
            Kind::Face => faces[triangle],
            Kind::Cap => behind(welded, faces, triangle),
            Kind::Left => continue,
        };
        let places = welded.places(triangle);
        for corner in 0..3 {
            let at = places[corner];
            let (to, from) = (places[(corner + 1) % 3] - at, places[(corner + 2) % 3] - at);
            let angle = atan2(sqrt(to.cross(from).length_squared()), to.dot(from));
            let vertex = welded.corners[triangle][corner] as usize;
            sums[vertex] += normal * angle;
            if first[vertex] == DVec3::ZERO {
                first[vertex] = normal;
            }
        }
    }
    let mean =
        |(&sum, &first): (&DVec3, &DVec3)| if sum.length_squared() > 1e-24 { unit(sum) } else { first };
    Ok(sums.iter().zip(&first).map(mean).collect())
}
