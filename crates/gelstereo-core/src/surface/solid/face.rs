//! A triangle prepared for nearest-point queries.

use super::normals::longest;
use super::weld::{Welded, lengths_squared};
use crate::math::{DVec3, sqrt};
use alloc::vec::Vec;

/// The feature that holds the nearest point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Site {
    /// Inside the face at this position in tree order.
    Face(u32),
    /// Between the ends of this edge.
    Edge(u32),
    /// At this vertex.
    Vertex(u32),
}

/// Best candidate: least squared distance, then lowest triangle index.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub squared_mm2: f64,
    pub triangle: u32,
    pub site: Site,
}

/// An edge prepared for projection.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    /// Ends, ascending, so that both adjacent faces compute the same bits.
    pub ends: [u32; 2],
    /// 1 / |b - a|².
    pub inverse_squared: f64,
}

impl Edge {
    pub fn new(ends: [u32; 2], vertices_mm: &[DVec3]) -> Self {
        let [a, b] = ends.map(|i| vertices_mm[i as usize]);
        Self { ends, inverse_squared: 1.0 / a.distance_squared(b) }
    }

    /// Squared distance and site; `name` is the edge's own index.
    #[inline]
    pub fn nearest(&self, name: u32, vertices_mm: &[DVec3], p_mm: DVec3) -> (f64, Site) {
        let [a, b] = self.ends.map(|i| vertices_mm[i as usize]);
        let (from_a, along) = (p_mm - a, b - a);
        let share = from_a.dot(along) * self.inverse_squared;
        if share <= 0.0 {
            (from_a.length_squared(), Site::Vertex(self.ends[0]))
        } else if share >= 1.0 {
            ((p_mm - b).length_squared(), Site::Vertex(self.ends[1]))
        } else {
            ((from_a - along * share).length_squared(), Site::Edge(name))
        }
    }

    /// Nearest point of the edge's line, relative to the edge's first end.
    pub fn foot(&self, vertices_mm: &[DVec3], p_mm: DVec3) -> DVec3 {
        let [a, b] = self.ends.map(|i| vertices_mm[i as usize]);
        let along = b - a;
        along * ((p_mm - a).dot(along) * self.inverse_squared)
    }
}

/// A triangle in its own frame: x along its longest edge from `origin_mm`, y in the plane towards the
/// third corner, z along the normal. The longest edge keeps the frame of a sliver accurate to rounding;
/// barycentric coordinates would lose all digits.
///
/// It fills two cache lines: the first holds plane and indices, the second data needed only near the plane.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(128))]
pub(super) struct Face {
    pub origin_mm: DVec3,
    pub normal: DVec3,
    /// Edges, the longest first.
    edges: [u32; 3],
    pub triangle: u32,
    along: DVec3,
    length_mm: f64,
    /// Inward unit normals (x, y) of the second and third edge.
    second: [f64; 2],
    third: [f64; 2],
}

const _: () = assert!(size_of::<Face>() == 128);

/// A line through an edge must hit one of its two faces despite rounding.
const ON_EDGE_MM: f64 = 1e-9;

impl Face {
    /// A triangle with an area and this unit normal.
    pub fn new(welded: &Welded, triangle: usize, normal: DVec3) -> Self {
        let first = longest(welded, triangle);
        let turn = |k: usize| (first + k) % 3;
        let places = welded.places(triangle);
        let [a, b, c] = [0, 1, 2].map(|k| places[turn(k)]);
        let length_mm = sqrt(lengths_squared(&places)[first]);
        let along = (b - a) / length_mm;
        let across = normal.cross(along);
        let (x, y) = (along.dot(c - a), across.dot(c - a));
        let inward = |dx: f64, dy: f64| {
            let length = sqrt(dx * dx + dy * dy);
            [-dy / length, dx / length]
        };
        Self {
            origin_mm: a,
            normal,
            edges: [0, 1, 2].map(|k| welded.edges_of[triangle][turn(k)]),
            triangle: triangle as u32,
            along,
            length_mm,
            second: inward(x - length_mm, y),
            third: inward(-x, -y),
        }
    }

    /// Signed height of a point above the plane, mm.
    #[inline]
    pub fn height_mm(&self, p_mm: DVec3) -> f64 {
        self.normal.dot(p_mm - self.origin_mm)
    }

    /// Whether a point in the plane is within the triangle.
    #[inline]
    pub fn contains(&self, p_mm: DVec3) -> bool {
        let q = p_mm - self.origin_mm;
        let (x, y) = (self.along.dot(q), self.normal.cross(self.along).dot(q));
        let beyond = x - self.length_mm;
        let inside = [y, self.second[0] * beyond + self.second[1] * y, self.third[0] * x + self.third[1] * y];
        inside.into_iter().all(|side| side >= -ON_EDGE_MM)
    }

    /// Squared distance and site, unless it exceeds `limit_mm2`. `place` is this face's own position.
    #[inline]
    pub fn nearest(
        &self,
        place: u32,
        (edges, vertices_mm): (&[Edge], &[DVec3]),
        p_mm: DVec3,
        limit_mm2: f64,
    ) -> Option<Found> {
        let q = p_mm - self.origin_mm;
        let z = self.normal.dot(q);
        let z_squared = z * z;
        if z_squared > limit_mm2 {
            return None;
        }
        let (x, y) = (self.along.dot(q), self.normal.cross(self.along).dot(q));
        let beyond = x - self.length_mm;
        let inside = [y, self.second[0] * beyond + self.second[1] * y, self.third[0] * x + self.third[1] * y];
        let outside = smaller(smaller(inside[0], inside[1]), inside[2]);
        if outside >= 0.0 {
            return Some(Found { squared_mm2: z_squared, triangle: self.triangle, site: Site::Face(place) });
        }
        if z_squared + outside * outside > limit_mm2 {
            return None;
        }
        Some(self.nearest_on_edges((edges, vertices_mm), p_mm, inside))
    }

    /// For a point outside these edges: the nearest point of a convex shape is on an edge that faces the
    /// point.
    #[inline(never)]
    fn nearest_on_edges(
        &self,
        (edges, vertices_mm): (&[Edge], &[DVec3]),
        p_mm: DVec3,
        inside: [f64; 3],
    ) -> Found {
        let mut best = (f64::INFINITY, Site::Vertex(0));
        for (&name, side) in self.edges.iter().zip(inside) {
            if side < 0.0 {
                let found = edges[name as usize].nearest(name, vertices_mm, p_mm);
                if found.0 < best.0 {
                    best = found;
                }
            }
        }
        Found { squared_mm2: best.0, triangle: self.triangle, site: best.1 }
    }
}

/// The smaller value; a single instruction, unlike `f64::min`.
#[inline]
fn smaller(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// All edges, prepared for queries.
pub(super) fn edges(welded: &Welded) -> Vec<Edge> {
    welded.edges.iter().map(|&ends| Edge::new(ends, &welded.vertices_mm)).collect()
}
