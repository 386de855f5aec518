//! Bodies of triangles, and slow independent answers about them.
#![allow(dead_code, reason = "each test crate uses its own part of this")]

use gelstereo_core::math::DVec3;
use gelstereo_core::surface::TriangleMesh;

/// A box of six faces, `n` x `n` squares each, two triangles to a square, its vertices shared.
pub fn block(low: DVec3, high: DVec3, n: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut vertices = Vec::new();
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for (side, at) in [low, high].into_iter().enumerate() {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let first = vertices.len() as u32;
            for i in 0..=n {
                for j in 0..=n {
                    let mut p = DVec3::ZERO;
                    p[axis] = at[axis];
                    p[u] = if i == n { high[u] } else { low[u] + (high[u] - low[u]) * i as f64 / n as f64 };
                    p[v] = if j == n { high[v] } else { low[v] + (high[v] - low[v]) * j as f64 / n as f64 };
                    vertices.push(p);
                }
            }
            for i in 0..n as u32 {
                for j in 0..n as u32 {
                    let name = |i: u32, j: u32| first + i * (n as u32 + 1) + j;
                    let [a, b, c, d] = [name(i, j), name(i + 1, j), name(i + 1, j + 1), name(i, j + 1)];
                    let both = [[a, b, c], [a, c, d]];
                    let turned = both.map(|[a, b, c]| if side == 1 { [a, b, c] } else { [a, c, b] });
                    triangles.extend(turned);
                }
            }
        }
    }
    (vertices, triangles)
}

/// A body around the origin whose surface has a different distance from it in every direction:
/// `radius(direction, k)` of the k-th vertex of a finely divided cube. It never crosses itself.
pub fn star(n: usize, mut radius: impl FnMut(DVec3, usize) -> f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let (mut vertices, triangles) = block(DVec3::splat(-1.0), DVec3::splat(1.0), n);
    // The same place in two faces of the cube has to get the same radius.
    let mut seen: Vec<(DVec3, DVec3)> = Vec::new();
    for (k, vertex) in vertices.iter_mut().enumerate() {
        let moved = match seen.iter().find(|(from, _)| from == vertex) {
            Some(&(_, to)) => to,
            None => vertex.normalize() * radius(vertex.normalize(), k),
        };
        seen.push((*vertex, moved));
        *vertex = moved;
    }
    (vertices, triangles)
}

/// Squared distance of a point to a triangle, by barycentric coordinates and three segments. One edge is made
/// perpendicular to the other: the determinant of their products would lose the height of a sliver squared.
pub fn squared_distance(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let (along, ap) = (b - a, p - a);
    let share = |v: DVec3| v.dot(along) / along.length_squared();
    let across = |v: DVec3| v - along * share(v);
    let (height, off) = (across(c - a), across(ap));
    let w = off.dot(height) / height.length_squared();
    let v = share(ap - (c - a) * w);
    let segment = |a: DVec3, b: DVec3| {
        let share = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
        (a + (b - a) * share).distance_squared(p)
    };
    let rim = segment(a, b).min(segment(b, c)).min(segment(c, a));
    if v >= 0.0 && w >= 0.0 && v + w <= 1.0 { rim.min((off - height * w).length_squared()) } else { rim }
}

/// Distance to all triangles of a mesh, each looked at.
pub fn distance(p: DVec3, mesh: &TriangleMesh) -> f64 {
    let least = mesh.corners().map(|corners| squared_distance(p, corners)).fold(f64::INFINITY, f64::min);
    least.sqrt()
}

/// How often the surface winds around a point: 1 inside, 0 outside (solid angles of van Oosterom and Strackee
/// 1983).
pub fn winding(p: DVec3, mesh: &TriangleMesh) -> f64 {
    let angles = mesh.corners().map(|corners| {
        let [a, b, c] = corners.map(|v| v - p);
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        2.0 * a.dot(b.cross(c)).atan2(below)
    });
    angles.sum::<f64>() / (4.0 * core::f64::consts::PI)
}
