//! Six parts as meshes by their dimensions: long axis z, tip at z = 0, the rest beyond it at z > 0.

use gelstereo_core::math::DVec3;
use gelstereo_core::surface::TriangleMesh;
use std::f64::consts::TAU;

/// A mesh with its name.
pub struct Part {
    pub name: &'static str,
    pub mesh: TriangleMesh,
    /// Whether it is gripped by its flat faces only.
    pub is_flat: bool,
    /// The normal of the surface that the facets stand for, from a point of the mesh and its facet's normal.
    exact: fn(DVec3, DVec3) -> DVec3,
}

impl Part {
    pub fn new(
        name: &'static str,
        is_flat: bool,
        mesh: TriangleMesh,
        exact: fn(DVec3, DVec3) -> DVec3,
    ) -> Self {
        Self { name, mesh, is_flat, exact }
    }

    /// Outward normal, object frame, at a point of the facet with this normal.
    pub fn normal(&self, point_mm: DVec3, facet: DVec3) -> DVec3 {
        (self.exact)(point_mm, facet)
    }
}

fn flat(_: DVec3, facet: DVec3) -> DVec3 {
    facet
}

fn round(point: DVec3, facet: DVec3) -> DVec3 {
    if facet.z.abs() > 0.5 { facet } else { DVec3::new(point.x, point.y, 0.0).normalize() }
}

/// Of r = R(u), u = z / pitch - θ / 2π, the gradient r̂ + θ̂ R' / 2πr - ẑ R' / pitch.
fn helical(point: DVec3, facet: DVec3) -> DVec3 {
    let out = DVec3::new(point.x, point.y, 0.0).normalize();
    let slope = 0.5413 * PITCH_MM / (5.0 / 16.0);
    match facet.z.abs() {
        ..0.1 => out,
        0.9.. => facet,
        _ => {
            let r = point.truncate().length();
            let slope = -slope * facet.z.signum();
            (out + DVec3::Z.cross(out) * (slope / (TAU * r)) - DVec3::Z * (slope / PITCH_MM)).normalize()
        }
    }
}

/// Of the bolt's thread.
const PITCH_MM: f64 = 1.5;

pub fn parts() -> Vec<Part> {
    vec![
        Part::new("cylinder peg", false, prism(&circle(4.0, 96), 30.0), round),
        Part::new(
            "square peg",
            false,
            prism(&[[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0], [-4.0, 4.0]], 30.0),
            flat,
        ),
        Part::new("bolt M10", false, bolt(10.0, PITCH_MM, 25.5), helical),
        Part::new("key", true, key(), flat),
        Part::new("USB-A plug", true, plug(), flat),
        Part::new(
            "irregular peg",
            false,
            prism(&[[-5.0, -3.0], [4.0, -4.0], [5.5, 0.5], [1.0, 1.5], [0.5, 4.5], [-4.0, 3.0]], 30.0),
            flat,
        ),
    ]
}

fn circle(radius: f64, n: usize) -> Vec<[f64; 2]> {
    (0..n).map(|i| (TAU * i as f64 / n as f64).sin_cos()).map(|(s, c)| [radius * c, radius * s]).collect()
}

/// A prism over a polygon, counter-clockwise seen from +z; the ends are cut into ears.
pub fn prism(outline: &[[f64; 2]], length: f64) -> TriangleMesh {
    stack(&[(0.0, outline.to_vec()), (length, outline.to_vec())])
}

/// Sections with equally many corners, joined from one height to the next, closed at both ends.
fn stack(sections: &[(f64, Vec<[f64; 2]>)]) -> TriangleMesh {
    let n = sections[0].1.len();
    let vertices: Vec<DVec3> =
        sections.iter().flat_map(|(z, s)| s.iter().map(|&[x, y]| DVec3::new(x, y, *z))).collect();
    let mut triangles = Vec::new();
    for level in 0..sections.len() - 1 {
        for i in 0..n {
            let (a, b) = ((level * n + i) as u32, (level * n + (i + 1) % n) as u32);
            triangles.extend([[a, b, b + n as u32], [a, b + n as u32, a + n as u32]]);
        }
    }
    let top = ((sections.len() - 1) * n) as u32;
    for [a, b, c] in ears(&sections[0].1) {
        triangles.push([a, c, b]);
    }
    for t in ears(&sections[sections.len() - 1].1) {
        triangles.push(t.map(|i| i + top));
    }
    TriangleMesh::new(vertices, triangles).unwrap()
}

/// Triangles of a simple polygon by clipping ears.
fn ears(outline: &[[f64; 2]]) -> Vec<[u32; 3]> {
    let cross = |a: u32, b: u32, c: u32| {
        let [a, b, c] = [a, b, c].map(|i| outline[i as usize]);
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let mut left: Vec<u32> = (0..outline.len() as u32).collect();
    let mut out = Vec::new();
    while left.len() > 3 {
        let n = left.len();
        let ear = (0..n).find(|&i| {
            let (a, b, c) = (left[(i + n - 1) % n], left[i], left[(i + 1) % n]);
            cross(a, b, c) > 1e-12
                && left.iter().all(|&p| {
                    [a, b, c].contains(&p)
                        || cross(a, b, p) < 0.0
                        || cross(b, c, p) < 0.0
                        || cross(c, a, p) < 0.0
                })
        });
        let i = ear.unwrap_or(0);
        out.push([left[(i + n - 1) % n], left[i], left[(i + 1) % n]]);
        left.remove(i);
    }
    out.push([left[0], left[1], left[2]]);
    out
}

/// A metric thread: flanks of 60 degrees, crests an eighth and roots a quarter of the pitch wide.
fn bolt(diameter: f64, pitch: f64, length: f64) -> TriangleMesh {
    let depth = 0.5413 * pitch;
    let profile = |turns: f64| {
        let u = turns.rem_euclid(1.0);
        // Half crest, flank of 5/16, root of 1/4, flank, half crest.
        let (crest, flank) = (1.0 / 16.0, 5.0 / 16.0);
        let from_crest = u.min(1.0 - u);
        ((from_crest - crest) / flank).clamp(0.0, 1.0) * depth
    };
    let (around, steps) = (48, (length / pitch * 16.0) as usize);
    let sections: Vec<_> = (0..=steps)
        .map(|k| {
            let z = length * k as f64 / steps as f64;
            let ring = (0..around)
                .map(|i| {
                    let turn = i as f64 / around as f64;
                    let r = 0.5 * diameter - profile(z / pitch - turn);
                    let (s, c) = (TAU * turn).sin_cos();
                    [r * c, r * s]
                })
                .collect();
            (z, ring)
        })
        .collect();
    stack(&sections)
}

/// A blade of 2.2 x 8 mm with teeth along one side, a groove along both faces and a wider bow.
fn key() -> TriangleMesh {
    let section = |width: f64, tooth: f64| {
        let (w, t, g) = (0.5 * width, 1.1, 0.6);
        let (left, right) = (-w + tooth, w);
        // Counter-clockwise: lower face with its groove, then the upper.
        vec![
            [left, -t],
            [-0.6, -t],
            [-0.2, -t + g],
            [0.9, -t + g],
            [1.3, -t],
            [right, -t],
            [right, t],
            [2.4, t],
            [2.1, t - g],
            [1.2, t - g],
            [0.9, t],
            [left, t],
        ]
    };
    let profile = [
        (0.0, 8.0, 2.0),
        (1.5, 8.0, 0.4),
        (3.5, 8.0, 2.4),
        (4.5, 8.0, 2.4),
        (6.5, 8.0, 0.8),
        (8.5, 8.0, 1.8),
        (9.5, 8.0, 1.8),
        (11.5, 8.0, 0.2),
        (13.5, 8.0, 1.4),
        (14.5, 8.0, 1.4),
        (16.0, 8.0, 0.0),
        (21.0, 8.0, 0.0),
        (21.4, 20.0, 0.0),
        (36.0, 20.0, 0.0),
    ];
    stack(&profile.map(|(z, width, tooth)| (z, section(width, tooth))))
}

/// A shell of 12 x 4.5 mm with two windows in each broad face, and a moulded handle.
fn plug() -> TriangleMesh {
    let section = |half_width: f64, half_height: f64, window: f64| {
        let (w, h, r) = (half_width, half_height, 0.5);
        let side = |sign: f64| {
            let half = [
                [-w + r, -h],
                [-3.6, -h],
                [-3.6 + 1e-3, -h + window],
                [-1.4 - 1e-3, -h + window],
                [-1.4, -h],
                [1.4, -h],
                [1.4 + 1e-3, -h + window],
                [3.6 - 1e-3, -h + window],
                [3.6, -h],
                [w - r, -h],
                [w, -h + r],
            ];
            half.map(|[x, y]| [sign * x, sign * y])
        };
        let mut out: Vec<[f64; 2]> = side(1.0).to_vec();
        out.extend(side(-1.0));
        out
    };
    stack(&[
        (0.0, section(6.0, 2.25, 0.0)),
        (5.2, section(6.0, 2.25, 0.0)),
        (5.21, section(6.0, 2.25, 1.0)),
        (7.5, section(6.0, 2.25, 1.0)),
        (7.51, section(6.0, 2.25, 0.0)),
        (18.8, section(6.0, 2.25, 0.0)),
        (18.9, section(7.5, 4.0, 0.0)),
        (38.0, section(7.5, 4.0, 0.0)),
    ])
}
