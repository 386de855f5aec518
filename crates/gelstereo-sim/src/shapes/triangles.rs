//! Watertight triangle meshes of the solids.

use super::{BOARD_THICKNESS_MM, Shape};
use alloc::vec::Vec;
use core::f64::consts::PI;
use gelstereo_core::math::{DVec3, acos, ceil, cos, sin};
use gelstereo_core::surface::TriangleMesh;

/// Maximum of segments per turn, whatever the tolerance.
const MAX_SEGMENTS: usize = 512;

impl Shape {
    /// Closed surface with outward normals whose distance to the solid is at most `tolerance_mm` (as far
    /// as 512 segments a turn allow); `None` for a mesh file and for dimensions that [`Self::validate`]
    /// rejects.
    #[must_use]
    pub fn mesh(&self, tolerance_mm: f64) -> Option<TriangleMesh> {
        self.validate().ok()?;
        let (vertices, triangles) = match self {
            Self::Sphere { radius_mm } => sphere(*radius_mm, tolerance_mm),
            Self::Cylinder { radius_mm, length_mm } => cylinder(*radius_mm, *length_mm, tolerance_mm),
            Self::Box { size_mm } => cuboid(DVec3::from_array(*size_mm) * 0.5),
            Self::Board { size_mm, block_mm, protrusion_mm } => board(*size_mm, *block_mm, *protrusion_mm),
            Self::Mesh { .. } => return None,
        };
        TriangleMesh::new(vertices, triangles).ok()
    }
}

type Triangles = (Vec<DVec3>, Vec<[u32; 3]>);

/// Segments of a turn for which a chord stays within the tolerance: r (1 - cos(π / n)) <= tolerance.
fn segments(radius: f64, tolerance: f64) -> usize {
    let n = ceil(PI / acos(1.0 - (tolerance / radius).clamp(1e-9, 0.5)));
    (n as usize).clamp(8, MAX_SEGMENTS)
}

/// Adds the ring of quads between two rings of `n` vertices that start at `a` and `b`; `b` is the upper
/// one when the ring turns counter-clockwise seen from above.
fn belt(a: u32, b: u32, n: u32, triangles: &mut Vec<[u32; 3]>) {
    for i in 0..n {
        let j = (i + 1) % n;
        triangles.extend([[a + i, a + j, b + j], [a + i, b + j, b + i]]);
    }
}

/// Adds the fan between a ring of `n` vertices that starts at `ring` and the vertex `tip`.
fn fan(ring: u32, n: u32, tip: u32, tip_above: bool, triangles: &mut Vec<[u32; 3]>) {
    triangles.extend((0..n).map(|i| {
        let j = (i + 1) % n;
        if tip_above { [ring + i, ring + j, tip] } else { [ring + j, ring + i, tip] }
    }));
}

fn ring(radius: f64, z: f64, n: usize) -> impl Iterator<Item = DVec3> {
    (0..n).map(move |i| {
        let angle = 2.0 * PI * i as f64 / n as f64;
        DVec3::new(radius * cos(angle), radius * sin(angle), z)
    })
}

fn sphere(radius: f64, tolerance: f64) -> Triangles {
    // The chord errors of both directions add up, so each gets half of the tolerance.
    let n = segments(radius, 0.5 * tolerance).next_multiple_of(2);
    let bands = n / 2;
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for band in 1..bands {
        let latitude = PI * (band as f64 / bands as f64 - 0.5);
        vertices.extend(ring(radius * cos(latitude), radius * sin(latitude), n));
    }
    vertices.extend([DVec3::new(0.0, 0.0, -radius), DVec3::new(0.0, 0.0, radius)]);
    let (n, rings) = (n as u32, bands as u32 - 1);
    fan(0, n, rings * n, false, &mut triangles);
    for band in 1..rings {
        belt((band - 1) * n, band * n, n, &mut triangles);
    }
    fan((rings - 1) * n, n, rings * n + 1, true, &mut triangles);
    (vertices, triangles)
}

fn cylinder(radius: f64, length: f64, tolerance: f64) -> Triangles {
    let n = segments(radius, tolerance);
    let half = 0.5 * length;
    let mut vertices: Vec<DVec3> = ring(radius, -half, n).chain(ring(radius, half, n)).collect();
    vertices.extend([DVec3::new(0.0, 0.0, -half), DVec3::new(0.0, 0.0, half)]);
    let (n, mut triangles) = (n as u32, Vec::new());
    belt(0, n, n, &mut triangles);
    fan(0, n, 2 * n, false, &mut triangles);
    fan(n, n, 2 * n + 1, true, &mut triangles);
    (vertices, triangles)
}

/// The four corners of a rectangle about the z axis, counter-clockwise seen from above.
fn rectangle(x: f64, y: f64, z: f64) -> [DVec3; 4] {
    [DVec3::new(-x, -y, z), DVec3::new(x, -y, z), DVec3::new(x, y, z), DVec3::new(-x, y, z)]
}

fn cuboid(half: DVec3) -> Triangles {
    let mut vertices = rectangle(half.x, half.y, -half.z).to_vec();
    vertices.extend(rectangle(half.x, half.y, half.z));
    let mut triangles = Vec::new();
    belt(0, 4, 4, &mut triangles);
    triangles.extend([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]);
    (vertices, triangles)
}

fn board([w, h]: [f64; 2], [bw, bh]: [f64; 2], protrusion: f64) -> Triangles {
    let mut vertices = rectangle(0.5 * w, 0.5 * h, -BOARD_THICKNESS_MM).to_vec();
    vertices.extend(rectangle(0.5 * w, 0.5 * h, 0.0));
    vertices.extend(rectangle(0.5 * bw, 0.5 * bh, 0.0));
    vertices.extend(rectangle(0.5 * bw, 0.5 * bh, protrusion));
    let mut triangles = Vec::new();
    // Plate's sides, its top around the block, the block's sides; then bottom and top.
    belt(0, 4, 4, &mut triangles);
    belt(4, 8, 4, &mut triangles);
    belt(8, 12, 4, &mut triangles);
    triangles.extend([[0, 2, 1], [0, 3, 2], [12, 13, 14], [12, 14, 15]]);
    (vertices, triangles)
}
