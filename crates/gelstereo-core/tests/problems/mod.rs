//! Registration problems of which everything is known: parts pressed into gel, sensed with noise, and the
//! bound on what any method can find.
#![allow(dead_code, reason = "each user has its own part of this")]

pub mod follow;
pub mod gel;
pub mod parts;

use gel::Gel;
use gelstereo_core::math::linalg::{Symmetric, eigen};
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DMat3, DVec3, Pose, centroid};
use gelstereo_core::params::RegisterParams;
use gelstereo_core::register::Contact;
use parts::Part;

/// Distance of the untouched gel from the camera.
pub const REST_MM: f64 = 28.7;
/// Distance of the markers.
pub const PITCH_MM: f64 = 0.9;
/// Markers along each side.
pub const SIDE: usize = 25;
/// Indentation from which a marker is salient.
pub const SALIENCY_MM: f64 = 0.35;
/// A direction counts as observable when the bound knows it to this, rotations in millimetres at the patch's
/// radius.
pub const OBSERVABLE_MM: f64 = 0.06;

/// How well the sensor senses.
#[derive(Clone, Copy, Debug)]
pub struct Sensing {
    /// Noise along z; across it half of that.
    pub noise_mm: f64,
    /// Share of salient points that lie anywhere within 1.5 mm of where they should.
    pub outliers: f64,
}

impl Sensing {
    pub const GOOD: Self = Self { noise_mm: 0.03, outliers: 0.0 };
    pub const NOISY: Self = Self { noise_mm: 0.06, outliers: 0.1 };
}

/// A contact with its truth.
#[derive(Clone)]
pub struct Problem {
    /// Salient points, sensor frame.
    pub points_mm: Vec<DVec3>,
    pub covariance_mm2: Vec<Symmetric<3>>,
    /// Markers that are not salient.
    pub unpressed_mm: Vec<DVec3>,
    /// Of every salient point, the surface's normal where it truly touches, sensor frame.
    pub normals: Vec<Option<DVec3>>,
    pub t_sensor_object: Pose,
    /// Centroid and rms radius of the salient points.
    pub centre_mm: DVec3,
    pub radius_mm: f64,
}

fn unit(random: &mut Stream) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal()).normalize()
}

impl Problem {
    /// A part lying across the sensor with its tip on it, turned and pressed by chance.
    pub fn press(part: &Part, sensing: Sensing, random: &mut Stream) -> Self {
        Self::press_into(gel::SHOULDER_MM, part, sensing, random)
    }

    /// The same in a gel of that decay length.
    pub fn press_into(decay_mm: f64, part: &Part, sensing: Sensing, random: &mut Stream) -> Self {
        loop {
            let t_sensor_object = place(part, random);
            let gel = Gel::press_into(decay_mm, part, &t_sensor_object);
            let problem = Self::sense(&gel, t_sensor_object, sensing, random);
            let touching = problem.normals.iter().flatten().count();
            if touching >= 20 && (30..=300).contains(&problem.points_mm.len()) {
                return problem;
            }
        }
    }

    pub fn sense(gel: &Gel, t_sensor_object: Pose, sensing: Sensing, random: &mut Stream) -> Self {
        let sigma = DVec3::new(0.5, 0.5, 1.0) * sensing.noise_mm;
        let mut out = Self {
            points_mm: Vec::new(),
            covariance_mm2: Vec::new(),
            unpressed_mm: Vec::new(),
            normals: Vec::new(),
            t_sensor_object,
            centre_mm: DVec3::ZERO,
            radius_mm: 1.0,
        };
        let squares = (sigma * sigma).to_array();
        let covariance =
            std::array::from_fn(|i| std::array::from_fn(|j| if i == j { squares[i] } else { 0.0 }));
        for (mut p, touches, normal) in gel.markers() {
            p += sigma * DVec3::new(random.normal(), random.normal(), random.normal());
            let is_salient = REST_MM - p.z > SALIENCY_MM;
            let is_outlier = is_salient && random.uniform() < sensing.outliers;
            if is_outlier {
                p.z += 3.0 * random.uniform() - 1.5;
            }
            if is_salient {
                out.points_mm.push(p);
                out.covariance_mm2.push(covariance);
                out.normals.push((touches && !is_outlier).then_some(normal));
            } else {
                out.unpressed_mm.push(p);
            }
        }
        out.centre_mm = centroid(&out.points_mm);
        let sum: f64 = out.points_mm.iter().map(|p| p.distance_squared(out.centre_mm)).sum();
        out.radius_mm = (sum / out.points_mm.len().max(1) as f64).sqrt();
        out
    }

    /// The truth turned about the patch's centroid and shifted, both in random directions.
    pub fn guess(&self, angle_rad: f64, shift_mm: f64, random: &mut Stream) -> Pose {
        let (axis, direction) = (unit(random), unit(random));
        let about = Pose::from_translation_mm(self.centre_mm);
        about * Pose::exp(axis * angle_rad, direction * shift_mm) * about.inverse() * self.t_sensor_object
    }

    /// Cramér-Rao: information about (ρ ω, v) about the centroid of the points that truly touch, their true
    /// normals and their noise known.
    pub fn bound(&self) -> Symmetric<6> {
        let mut sum = [[0.0; 6]; 6];
        for ((&x, c), normal) in self.points_mm.iter().zip(&self.covariance_mm2).zip(&self.normals) {
            let Some(n) = *normal else { continue };
            let variance = n.dot(DMat3::from_cols_array_2d(c) * n);
            let m = (x - self.centre_mm).cross(n) / self.radius_mm;
            let j = [m.x, m.y, m.z, n.x, n.y, n.z];
            for (row, a) in sum.iter_mut().zip(j) {
                row.iter_mut().zip(j).for_each(|(s, b)| *s += a * b / variance);
            }
        }
        sum
    }

    /// Twist (ρ ω, v) about the patch's centroid from a pose to the truth.
    pub fn error(&self, pose: &Pose) -> [f64; 6] {
        let about = Pose::from_translation_mm(self.centre_mm);
        let motion = about.inverse() * self.t_sensor_object * pose.inverse() * about;
        let (w, v) = motion.log();
        let w = w * self.radius_mm;
        [w.x, w.y, w.z, v.x, v.y, v.z]
    }

    /// How a pose does over the observable directions.
    pub fn score(&self, pose: &Pose) -> Score {
        let spectrum = eigen(&self.bound());
        let error = self.error(pose);
        let mut out = Score { observable: 0, squared: 0.0, angle_rad: 0.0, shift_mm: 0.0 };
        let mut kept = [0.0; 6];
        for (value, u) in spectrum.values.iter().zip(&spectrum.vectors) {
            if *value * OBSERVABLE_MM * OBSERVABLE_MM < 1.0 {
                continue;
            }
            let along: f64 = u.iter().zip(error).map(|(a, b)| a * b).sum();
            out.observable += 1;
            out.squared += value * along * along;
            kept.iter_mut().zip(u).for_each(|(k, u)| *k += along * u);
        }
        out.angle_rad = DVec3::new(kept[0], kept[1], kept[2]).length() / self.radius_mm;
        out.shift_mm = DVec3::new(kept[3], kept[4], kept[5]).length();
        out
    }
}

/// Error over the observable directions.
#[derive(Clone, Copy, Debug)]
pub struct Score {
    pub observable: usize,
    /// Sum over them of the error over the bound, squared.
    pub squared: f64,
    pub angle_rad: f64,
    pub shift_mm: f64,
}

impl Score {
    pub fn is_success(&self) -> bool {
        self.angle_rad <= 2.0_f64.to_radians() && self.shift_mm <= 0.3
    }
}

/// The long axis across the gel, the tip within 4 mm of the middle, a face or any side down, 0.8 to 1.4 mm
/// deep.
fn place(part: &Part, random: &mut Stream) -> Pose {
    let turn = |axis: DVec3, angle: f64| Pose::exp(axis * angle, DVec3::ZERO);
    let mut between = |low: f64, high: f64| low + (high - low) * random.uniform();
    let roll = if part.is_flat {
        let face = if between(0.0, 1.0) < 0.5 { 0.0 } else { std::f64::consts::PI };
        std::f64::consts::FRAC_PI_2 + face + between(-0.1, 0.1)
    } else {
        between(0.0, std::f64::consts::TAU)
    };
    let (yaw, tilt) = (between(0.0, std::f64::consts::TAU), between(-0.06, 0.06));
    // z of the part along x of the sensor.
    let lying = turn(DVec3::Y, std::f64::consts::FRAC_PI_2 + tilt);
    let mut pose = turn(DVec3::Z, yaw) * lying * turn(DVec3::Z, roll);
    let tip = DVec3::new(between(-4.0, 4.0), between(-4.0, 4.0), 0.0);
    pose.translation_mm = tip - turn(DVec3::Z, yaw).transform_vector(DVec3::X) * between(0.0, 4.0);
    let over = |p: &DVec3| p.x.abs() < 10.0 && p.y.abs() < 10.0;
    let depth_mm = between(0.8, 1.4);
    let nearest = samples(part)
        .map(|p| pose.transform_point(p))
        .filter(over)
        .fold(f64::INFINITY, |low, p| low.min(p.z));
    pose.translation_mm.z += REST_MM - depth_mm - nearest;
    pose
}

/// Points all over the triangles, dense enough to find what is nearest to the camera.
fn samples(part: &Part) -> impl Iterator<Item = DVec3> + '_ {
    part.mesh.corners().flat_map(|[a, b, c]| {
        let n = ((b - a).length().max((c - a).length()).max((c - b).length()) / 0.5).ceil().max(1.0) as usize;
        (0..=n).flat_map(move |i| {
            (0..=n - i).map(move |j| a + (b - a) * (i as f64 / n as f64) + (c - a) * (j as f64 / n as f64))
        })
    })
}

/// How far off guesses are, and how well is sensed.
#[derive(Clone, Copy, Debug)]
pub struct Class {
    pub name: &'static str,
    pub angle_deg: f64,
    pub shift_mm: f64,
    pub sensing: Sensing,
}

pub const CLASSES: [Class; 4] = [
    Class { name: "5/1", angle_deg: 5.0, shift_mm: 1.0, sensing: Sensing::GOOD },
    Class { name: "10/2", angle_deg: 10.0, shift_mm: 2.0, sensing: Sensing::GOOD },
    Class { name: "noisy", angle_deg: 10.0, shift_mm: 2.0, sensing: Sensing::NOISY },
    Class { name: "30/5", angle_deg: 30.0, shift_mm: 5.0, sensing: Sensing::GOOD },
];

impl Class {
    /// The settings of someone who knows how many outliers there are, and nothing else.
    pub fn params(&self, params: &RegisterParams) -> RegisterParams {
        let mut params = params.clone();
        params.advanced.outlier_share = self.sensing.outliers.max(0.02);
        params
    }
}

impl Problem {
    pub fn contact(&self) -> Contact<'_> {
        Contact {
            covariance_mm2: Some(&self.covariance_mm2),
            unpressed_mm: &self.unpressed_mm,
            decay_mm: gel::SHOULDER_MM,
            ..Contact::new(&self.points_mm)
        }
    }

    /// Off by an angle and a shift that are uniform up to those of the class.
    pub fn guess_within(&self, class: &Class, random: &mut Stream) -> Pose {
        let angle = class.angle_deg.to_radians() * random.uniform();
        let shift_mm = class.shift_mm * random.uniform();
        self.guess(angle, shift_mm, random)
    }
}

/// What came of some runs.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    pub runs: usize,
    pub found: usize,
    squared: f64,
    directions: usize,
    ratios: Vec<f64>,
    times_ms: Vec<f64>,
}

impl Tally {
    pub fn count(&mut self, score: Option<Score>, time_ms: f64) {
        self.runs += 1;
        self.times_ms.push(time_ms);
        if let Some(score) = score.filter(Score::is_success) {
            self.found += 1;
            self.squared += score.squared;
            self.directions += score.observable;
            self.ratios.push((score.squared / score.observable as f64).sqrt());
        }
    }

    pub fn add(&mut self, other: &Self) {
        self.runs += other.runs;
        self.found += other.found;
        self.squared += other.squared;
        self.directions += other.directions;
        self.ratios.extend(&other.ratios);
        self.times_ms.extend(&other.times_ms);
    }

    pub fn share(&self) -> f64 {
        self.found as f64 / self.runs as f64
    }

    /// Median error over the bound.
    pub fn median(&self) -> f64 {
        quantile(&self.ratios, 0.5)
    }
}

impl std::fmt::Display for Tally {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let rms = (self.squared / self.directions.max(1) as f64).sqrt();
        write!(
            f,
            "{:5.1} % x{rms:.2} ({:.2}) {:.2} ms ({:.2})",
            100.0 * self.share(),
            self.median(),
            quantile(&self.times_ms, 0.5),
            quantile(&self.times_ms, 0.99)
        )
    }
}

fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get((share * sorted.len() as f64) as usize).copied().unwrap_or(f64::NAN)
}
