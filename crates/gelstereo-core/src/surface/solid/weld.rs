//! Mesh topology, with vertices at the same position merged.

use super::report::SolidReport;
use crate::math::DVec3;
use crate::stop::{Stop, Stopped, ask};
use crate::surface::{TriangleMesh, area_vector};
use alloc::vec::Vec;

/// No edge: the triangle is ignored.
pub(super) const NONE: u32 = u32::MAX;

/// Role of a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// It has an area.
    Face,
    /// Three collinear corners: it connects its neighbours but is not a surface itself.
    Cap,
    /// Ignored: two corners at one position, or a duplicate.
    Left,
}

/// One triangle's side along an edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Use {
    pub triangle: u32,
    /// The side goes from this corner to the next one.
    pub corner: u8,
    /// Whether it runs from the edge's first end to its second.
    pub forward: bool,
}

/// Vertices, triangles and edges of a mesh with coincident vertices merged.
pub(super) struct Welded {
    pub vertices_mm: Vec<DVec3>,
    /// Corners of every triangle.
    pub corners: Vec<[u32; 3]>,
    pub kinds: Vec<Kind>,
    /// Ends of every edge, ascending.
    pub edges: Vec<[u32; 2]>,
    /// The edges from each corner of a triangle to the next, or [`NONE`].
    pub edges_of: Vec<[u32; 3]>,
    uses: Vec<Use>,
    /// Start of each edge's uses, and the end of the last one.
    first_use: Vec<u32>,
}

/// Sides sorted between two stop checks: some milliseconds.
const SORTED_AT_ONCE: usize = 1 << 16;

impl Welded {
    pub fn new(mesh: &TriangleMesh, stop: Stop<'_>) -> Result<Self, Stopped> {
        ask(stop, 0)?;
        let (vertices_mm, names) = weld(mesh.vertices_mm());
        let corners: Vec<[u32; 3]> = mesh.triangles().iter().map(|t| t.map(|i| names[i as usize])).collect();
        ask(stop, 0)?;
        let mut kinds = kinds(&vertices_mm, &corners);
        leave_repetitions(&corners, &mut kinds);
        ask(stop, 0)?;
        let mut sides = sides(&corners, &kinds);
        let key = |(ends, side): &([u32; 2], Use)| (*ends, side.triangle, side.corner);
        for run in sides.chunks_mut(SORTED_AT_ONCE) {
            ask(stop, 0)?;
            run.sort_unstable_by_key(key);
        }
        ask(stop, 0)?;
        // The stable sort merges the sorted runs.
        sides.sort_by_key(key);
        ask(stop, 0)?;
        let (mut edges, mut first_use) = (Vec::new(), Vec::new());
        let mut edges_of = alloc::vec![[NONE; 3]; corners.len()];
        for (place, (ends, side)) in sides.iter().enumerate() {
            if edges.last() != Some(ends) {
                edges.push(*ends);
                first_use.push(place as u32);
            }
            edges_of[side.triangle as usize][usize::from(side.corner)] = edges.len() as u32 - 1;
        }
        first_use.push(sides.len() as u32);
        let uses = sides.into_iter().map(|(_, side)| side).collect();
        Ok(Self { vertices_mm, corners, kinds, edges, edges_of, uses, first_use })
    }

    /// The triangle sides along an edge.
    pub fn uses(&self, edge: usize) -> &[Use] {
        &self.uses[self.first_use[edge] as usize..self.first_use[edge + 1] as usize]
    }

    /// The three corner positions of a triangle.
    pub fn places(&self, triangle: usize) -> [DVec3; 3] {
        self.corners[triangle].map(|i| self.vertices_mm[i as usize])
    }

    pub fn report(&self) -> SolidReport {
        let mut report = SolidReport { triangles: self.corners.len(), ..SolidReport::default() };
        for (triangle, &kind) in self.kinds.iter().enumerate() {
            let [a, b, c] = self.corners[triangle];
            let collapsed = a == b || b == c || c == a;
            match kind {
                Kind::Face => {}
                Kind::Left if !collapsed => report.duplicates += 1,
                Kind::Cap | Kind::Left => report.degenerate += 1,
            }
        }
        for edge in 0..self.edges.len() {
            let uses = self.uses(edge);
            let forward = uses.iter().filter(|side| side.forward).count();
            match uses.len() {
                1 => report.boundary_edges += 1,
                n if 2 * forward != n => report.clashing_edges += 1,
                _ => {}
            }
            report.crowded_edges += usize::from(uses.len() > 2);
        }
        report.volume_mm3 = self.volume_mm3();
        report
    }

    fn volume_mm3(&self) -> f64 {
        // Relative to a vertex, so that an offset of the part does not cost precision.
        let origin = self.vertices_mm[0];
        let faces = (0..self.corners.len()).filter(|&t| self.kinds[t] == Kind::Face);
        faces
            .map(|t| {
                let places = self.places(t).map(|p| p - origin);
                places[0].dot(area_vector(&places)) / 3.0
            })
            .sum()
    }
}

/// The distinct positions in ascending order, and the index of every vertex among them.
fn weld(vertices_mm: &[DVec3]) -> (Vec<DVec3>, Vec<u32>) {
    // Adding 0.0 turns -0.0 into 0.0.
    let key = |i: u32| (vertices_mm[i as usize] + 0.0).to_array();
    let mut order: Vec<u32> = (0..vertices_mm.len() as u32).collect();
    order.sort_unstable_by(|&i, &j| {
        let (a, b) = (key(i), key(j));
        a[0].total_cmp(&b[0])
            .then_with(|| a[1].total_cmp(&b[1]))
            .then_with(|| a[2].total_cmp(&b[2]))
            .then(i.cmp(&j))
    });
    let mut places: Vec<DVec3> = Vec::with_capacity(vertices_mm.len());
    let mut names = alloc::vec![0; vertices_mm.len()];
    for i in order {
        let place = DVec3::from_array(key(i));
        if places.last() != Some(&place) {
            places.push(place);
        }
        names[i as usize] = places.len() as u32 - 1;
    }
    (places, names)
}

fn kinds(vertices_mm: &[DVec3], corners: &[[u32; 3]]) -> Vec<Kind> {
    let kind = |&[a, b, c]: &[u32; 3]| {
        if a == b || b == c || c == a {
            return Kind::Left;
        }
        let places = [a, b, c].map(|i| vertices_mm[i as usize]);
        // Coordinates are exact to half a unit in the last place. A height of 64 such units fixes the
        // normal to a few hundredths.
        let largest = places.iter().fold(0.0_f64, |most, p| most.max(p.abs().max_element()));
        let rounding_mm = 64.0 * f64::EPSILON * largest;
        let longest_squared = lengths_squared(&places).into_iter().fold(0.0, f64::max);
        let height_squared = 4.0 * area_vector(&places).length_squared() / longest_squared;
        if height_squared > rounding_mm * rounding_mm { Kind::Face } else { Kind::Cap }
    };
    corners.iter().map(kind).collect()
}

/// Squared lengths of the edges from each corner to the next.
pub(super) fn lengths_squared([a, b, c]: &[DVec3; 3]) -> [f64; 3] {
    [a.distance_squared(*b), b.distance_squared(*c), c.distance_squared(*a)]
}

/// Ignores duplicates: of triangles with the same corners and orientation, only the first is kept.
fn leave_repetitions(corners: &[[u32; 3]], kinds: &mut [Kind]) {
    let turned = |[a, b, c]: [u32; 3]| {
        if a < b && a < c {
            [a, b, c]
        } else if b < c {
            [b, c, a]
        } else {
            [c, a, b]
        }
    };
    let mut order: Vec<([u32; 3], usize)> =
        corners.iter().enumerate().map(|(t, &names)| (turned(names), t)).collect();
    order.sort_unstable();
    for pair in order.windows(2) {
        if pair[0].0 == pair[1].0 {
            kinds[pair[1].1] = Kind::Left;
        }
    }
}

fn sides(corners: &[[u32; 3]], kinds: &[Kind]) -> Vec<([u32; 2], Use)> {
    let mut sides = Vec::with_capacity(3 * corners.len());
    for (triangle, names) in corners.iter().enumerate() {
        if kinds[triangle] == Kind::Left {
            continue;
        }
        for corner in 0..3 {
            let (from, to) = (names[corner], names[(corner + 1) % 3]);
            let side = Use { triangle: triangle as u32, corner: corner as u8, forward: from < to };
            sides.push(([from.min(to), from.max(to)], side));
        }
    }
    sides
}
