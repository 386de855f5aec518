//! Contact patches with known truth: shapes, their templates, and where markers come to lie on them.
#![allow(dead_code)] // Every test file uses its own part of this.

use gelstereo_core::math::linalg::Symmetric;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose, centroid};
use gelstereo_core::register::Template;
use gelstereo_core::surface::TriangleMesh;

/// Distance of the untouched gel from the camera.
pub const REST_MM: f64 = 28.7;
/// Distance of the markers.
pub const PITCH_MM: f64 = 0.9;
/// Indentation from which a marker is in contact.
pub const SALIENCY_MM: f64 = 0.35;

/// A convex body with a closed form for everything that a test asks.
#[derive(Clone, Copy, Debug)]
pub enum Shape {
    /// Around the origin.
    Sphere { radius_mm: f64 },
    /// Around the z axis, of elliptic section, without end faces.
    Cylinder { a_mm: f64, b_mm: f64, half_length_mm: f64 },
    /// Around the origin.
    Cuboid { half_mm: DVec3 },
}

impl Shape {
    /// Distance along a ray to where it enters, and the outward normal there.
    pub fn enter(&self, origin: DVec3, direction: DVec3) -> Option<(f64, DVec3)> {
        let quadric = |scale: DVec3| {
            let (o, d) = (origin * scale, direction * scale);
            let (a, b, c) = (d.length_squared(), o.dot(d), o.length_squared() - 1.0);
            let root = b * b - a * c;
            (root > 0.0).then(|| {
                let t = (-b - root.sqrt()) / a;
                (t, ((origin + direction * t) * scale * scale).normalize())
            })
        };
        match *self {
            Self::Sphere { radius_mm } => quadric(DVec3::splat(1.0 / radius_mm)),
            Self::Cylinder { a_mm, b_mm, half_length_mm } => quadric(DVec3::new(1.0 / a_mm, 1.0 / b_mm, 0.0))
                .filter(|(t, _)| (origin + direction * *t).z.abs() < half_length_mm),
            Self::Cuboid { half_mm } => {
                let low = (-half_mm * direction.signum() - origin) / direction;
                let high = (half_mm * direction.signum() - origin) / direction;
                let axis = low.max_position();
                let mut normal = DVec3::ZERO;
                normal[axis] = -direction[axis].signum();
                (low[axis] < high.min_element()).then_some((low[axis], normal))
            }
        }
    }

    /// Points and outward normals on the exact surface, about `spacing_mm` apart.
    pub fn template(&self, spacing_mm: f64) -> Template {
        let (points, normals) = match *self {
            Self::Sphere { radius_mm } => fibonacci(radius_mm, spacing_mm),
            Self::Cylinder { a_mm, b_mm, half_length_mm } => rings(a_mm, b_mm, half_length_mm, spacing_mm),
            Self::Cuboid { half_mm } => {
                return Template::from_mesh(&cuboid(half_mm), spacing_mm, 1).unwrap();
            }
        };
        Template::new(&points, &normals, spacing_mm).unwrap()
    }
}

fn fibonacci(radius_mm: f64, spacing_mm: f64) -> (Vec<DVec3>, Vec<DVec3>) {
    let count = (4.0 * std::f64::consts::PI * (radius_mm / spacing_mm).powi(2)) as usize;
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let normal = |k: usize| {
        let z = 1.0 - (2 * k + 1) as f64 / count as f64;
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * (golden * k as f64).cos(), r * (golden * k as f64).sin(), z)
    };
    (0..count).map(|k| (normal(k) * radius_mm, normal(k))).unzip()
}

fn rings(a: f64, b: f64, half_length: f64, spacing: f64) -> (Vec<DVec3>, Vec<DVec3>) {
    let around = (std::f64::consts::TAU * 0.5 * (a + b) / spacing) as usize;
    let along = (2.0 * half_length / spacing) as usize;
    let mut out = (Vec::new(), Vec::new());
    for i in 0..=along {
        for j in 0..around {
            // Every other ring is turned by half a step.
            let angle = std::f64::consts::TAU * (j as f64 + 0.5 * (i % 2) as f64) / around as f64;
            let (s, c) = angle.sin_cos();
            let z = -half_length + 2.0 * half_length * i as f64 / along as f64;
            out.0.push(DVec3::new(a * c, b * s, z));
            out.1.push(DVec3::new(c / a, s / b, 0.0).normalize());
        }
    }
    out
}

/// The twelve triangles of a box.
pub fn cuboid(half_mm: DVec3) -> TriangleMesh {
    let vertex = |k: u32| {
        let sign = |bit: u32| if k >> bit & 1 == 1 { 1.0 } else { -1.0 };
        half_mm * DVec3::new(sign(0), sign(1), sign(2))
    };
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    TriangleMesh::new((0..8).map(vertex).collect(), triangles).unwrap()
}

/// A contact with its truth.
pub struct Contact {
    /// Salient points, sensor frame, with noise.
    pub points_mm: Vec<DVec3>,
    /// Outward normals of the surface at the true points, sensor frame.
    pub normals: Vec<DVec3>,
    /// The true pose.
    pub t_sensor_object: Pose,
}

impl Contact {
    /// Presses a shape, turned as `turn` says, `depth_mm` into the gel about (4, 0) mm. Markers on a 25 x 25
    /// lattice move along z onto the shape; those moved by more than the saliency are the patch.
    pub fn press(shape: &Shape, turn: Pose, depth_mm: f64, noise_mm: f64, random: &mut Stream) -> Self {
        let shift = DVec3::new(4.0 + random.uniform() - 0.5, random.uniform() - 0.5, 0.0);
        let mut t_sensor_object = Pose::from_translation_mm(shift) * turn;
        let first = lattice(0.05 * PITCH_MM, 401, shift)
            .filter_map(|p| height(shape, &t_sensor_object, p))
            .fold(f64::INFINITY, |low, (z, _)| low.min(z));
        t_sensor_object.translation_mm.z += REST_MM - depth_mm - first;
        let mut contact = Self { points_mm: Vec::new(), normals: Vec::new(), t_sensor_object };
        for p in lattice(PITCH_MM, 25, DVec3::X * 4.0) {
            if let Some((z, normal)) = height(shape, &t_sensor_object, p)
                && z < REST_MM - SALIENCY_MM
            {
                let noise = DVec3::new(random.normal(), random.normal(), random.normal()) * noise_mm;
                contact.points_mm.push(DVec3::new(p.x, p.y, z) + noise);
                contact.normals.push(normal);
            }
        }
        contact
    }

    /// The truth turned by `angle_rad` about the patch's centroid and shifted by `shift_mm`, both in random
    /// directions.
    pub fn guess(&self, angle_rad: f64, shift_mm: f64, random: &mut Stream) -> Pose {
        let mut unit = || DVec3::new(random.normal(), random.normal(), random.normal()).normalize();
        let (axis, direction) = (unit(), unit());
        let about = Pose::from_translation_mm(centroid(&self.points_mm));
        let motion = about * Pose::exp(axis * angle_rad, direction * shift_mm) * about.inverse();
        motion * self.t_sensor_object
    }

    /// Information of the patch at the truth, about its centroid: the Cramér-Rao bound for points that are
    /// known to `sigma_mm` along exact normals.
    pub fn bound(&self, sigma_mm: f64) -> Symmetric<6> {
        let c = centroid(&self.points_mm);
        let mut sum = [[0.0; 6]; 6];
        for (&x, &n) in self.points_mm.iter().zip(&self.normals) {
            let m = (x - c).cross(n);
            let j = [m.x, m.y, m.z, n.x, n.y, n.z];
            for (row, a) in sum.iter_mut().zip(j) {
                row.iter_mut().zip(j).for_each(|(s, b)| *s += a * b / (sigma_mm * sigma_mm));
            }
        }
        sum
    }

    /// Twist (ω, v) about the patch's centroid from a pose to the truth.
    pub fn error(&self, pose: &Pose) -> [f64; 6] {
        let about = Pose::from_translation_mm(centroid(&self.points_mm));
        let motion = about.inverse() * self.t_sensor_object * pose.inverse() * about;
        let (w, v) = motion.log();
        [w.x, w.y, w.z, v.x, v.y, v.z]
    }
}

fn lattice(pitch: f64, side: i32, centre: DVec3) -> impl Iterator<Item = DVec3> {
    let half = f64::from(side - 1) / 2.0;
    (0..side).flat_map(move |i| {
        (0..side).map(move |j| {
            DVec3::new(f64::from(j) - half, f64::from(i) - half, 0.0) * pitch
                + DVec3::new(centre.x, centre.y, 0.0)
        })
    })
}

fn height(shape: &Shape, t_sensor_object: &Pose, p: DVec3) -> Option<(f64, DVec3)> {
    let back = t_sensor_object.inverse();
    // From far in front of the part, so that the ray enters.
    let origin = DVec3::new(p.x, p.y, -100.0);
    let (t, normal) = shape.enter(back.transform_point(origin), back.transform_vector(DVec3::Z))?;
    Some((t - 100.0, t_sensor_object.transform_vector(normal)))
}
