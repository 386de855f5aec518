//! A contact on a surface that is known, from points of a made surface.
#![allow(clippy::unwrap_used)]

use gelstereo_core::math::linalg::Symmetric;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, DVec3, Pose};
use gelstereo_core::motion::{KnownSurface, Recognition, RecognitionStatus, SurfacePoint};

const SIGMA_MM: f64 = 0.004;
const SPACING_MM: f64 = 0.9;

/// A smooth surface without symmetry.
fn lump(p: DVec2) -> f64 {
    0.05 * p.x * p.x + 0.09 * p.y * p.y + 0.012 * p.x * p.x * p.y + 0.4 * (1.1 * p.x + 0.4 * p.y + 0.2).sin()
}

/// Waves along x, of a period of 2.5 mm, which end nowhere.
fn waves(p: DVec2) -> f64 {
    0.2 * (p.x * core::f64::consts::TAU / 2.5).sin() + 0.06 * p.y * p.y
}

fn point(height: fn(DVec2) -> f64, p: DVec2, random: &mut Stream) -> SurfacePoint {
    let step = 1e-5;
    let slope = |d: DVec2| (height(p + d) - height(p - d)) / (2.0 * step);
    let noise = |random: &mut Stream| SIGMA_MM * random.normal();
    let (tilt_x, tilt_y) = (noise(random) / SPACING_MM, noise(random) / SPACING_MM);
    let (x, y) = (slope(DVec2::X * step), slope(DVec2::Y * step));
    let normal = DVec3::new(x + tilt_x, y + tilt_y, -1.0).normalize();
    let point_mm = DVec3::new(p.x, p.y, 30.0 + height(p) + noise(random));
    SurfacePoint { point_mm, normal, variance_mm2: SIGMA_MM * SIGMA_MM }
}

/// Points of a square, this far apart.
fn square(
    height: fn(DVec2) -> f64,
    centre: DVec2,
    half_mm: f64,
    step_mm: f64,
    seed: u64,
) -> Vec<SurfacePoint> {
    let mut random = Stream::new(seed, "recognize");
    let count = (2.0 * half_mm / step_mm) as i32;
    let at = |i: i32| step_mm * (f64::from(i) - f64::from(count) / 2.0);
    let all = (0..=count).flat_map(|i| (0..=count).map(move |k| (i, k)));
    all.map(|(i, k)| point(height, centre + DVec2::new(at(i), at(k)), &mut random)).collect()
}

fn moved(points: &[SurfacePoint], pose: &Pose) -> Vec<SurfacePoint> {
    let one = |p: &SurfacePoint| SurfacePoint {
        point_mm: pose.transform_point(p.point_mm),
        normal: pose.transform_vector(p.normal),
        ..*p
    };
    points.iter().map(one).collect()
}

fn about(centre_mm: DVec3, omega: [f64; 3], v_mm: [f64; 3]) -> Pose {
    let to = Pose::from_translation_mm(centre_mm);
    to * Pose::exp(DVec3::from_array(omega), DVec3::from_array(v_mm)) * to.inverse()
}

fn recognize(known: &[SurfacePoint], contact: &[SurfacePoint], guess: &Pose, sigma: [f64; 2]) -> Recognition {
    let known = KnownSurface { points: known, spacing_mm: SPACING_MM, surface_sigma_mm: 0.002 };
    known.recognize(contact, guess, sigma).unwrap()
}

/// Squared error, normalised by the covariance, by elimination.
fn squared_error(found: &Recognition, truth: &Pose) -> f64 {
    let motion = found.t_contact_part;
    let to = Pose::from_translation_mm(-motion.about_mm);
    let (omega, v) = (to * *truth * motion.pose.inverse() * to.inverse()).log();
    let mut b = [omega.x, omega.y, omega.z, v.x, v.y, v.z];
    let mut a: Symmetric<6> = motion.covariance;
    for i in 0..6 {
        for j in i + 1..6 {
            let share = a[j][i] / a[i][i];
            (i..6).for_each(|k| a[j][k] -= share * a[i][k]);
            b[j] -= share * b[i];
        }
    }
    (0..6).map(|i| b[i] * b[i] / a[i][i]).sum()
}

/// Contacts on a surface without symmetry are found where they are, within their covariance, however the
/// guess is off.
#[test]
fn contacts_are_found_where_they_are() {
    let (mut found, mut squares) = (0, 0.0);
    let count = 40;
    for seed in 0..count {
        let mut random = Stream::new(seed, "where");
        let mut several = |sigma: f64| [0; 3].map(|_| sigma * random.normal());
        let truth = Pose::exp(DVec3::from_array(several(0.5)), DVec3::from_array(several(5.0)));
        let [x, y, _] = several(0.8).map(|x| x.clamp(-1.5, 1.5));
        let known = square(lump, DVec2::ZERO, 4.5, 0.3, seed);
        let contact = moved(&square(lump, DVec2::new(x, y), 2.2, SPACING_MM, seed ^ 1), &truth);
        let middle = contact.iter().map(|p| p.point_mm).sum::<DVec3>() / contact.len() as f64;
        let guess = about(middle, several(0.06), several(0.3)) * truth;
        let recognition = recognize(&known, &contact, &guess, [0.06, 0.3]);
        let squared = squared_error(&recognition, &truth);
        squares += squared / count as f64;
        if recognition.status == RecognitionStatus::Found {
            found += 1;
            assert!(recognition.determined >= 5 && recognition.matched >= 20, "{recognition:?}");
            assert!(squared < 30.0, "{seed}: {squared}");
        }
    }
    // A guess of 3 standard deviations leads to a misfit once or twice.
    assert!(found >= 37 && (3.0..7.5).contains(&squares), "{found} {squares}");
}

/// Half way between two periods both poses are equally likely: one is returned, and the other with it.
#[test]
fn a_surface_that_repeats_is_ambiguous() {
    let known = square(waves, DVec2::ZERO, 7.0, 0.3, 1);
    let contact = square(waves, DVec2::ZERO, 2.2, SPACING_MM, 2);
    let halfway = Pose::from_translation_mm(DVec3::X * 1.25);
    let found = recognize(&known, &contact, &halfway, [0.02, 1.0]);
    assert_eq!(found.status, RecognitionStatus::Ambiguous);
    let x_mm = |pose: &Pose| pose.transform_point(DVec3::Z * 30.0).x;
    let (first, second) = (x_mm(&found.t_contact_part.pose), x_mm(&found.other.unwrap()));
    assert!(((first - second).abs() - 2.5).abs() < 0.1, "{first} {second}");
    // A guess that is sure of one decides.
    assert_eq!(recognize(&known, &contact, &Pose::IDENTITY, [0.02, 0.2]).status, RecognitionStatus::Found);
}

#[test]
fn another_surface_is_not_recognized() {
    let known = square(lump, DVec2::ZERO, 4.5, 0.3, 1);
    let contact = square(waves, DVec2::ZERO, 2.2, SPACING_MM, 2);
    assert!(recognize(&known, &contact, &Pose::IDENTITY, [0.06, 0.3]).status != RecognitionStatus::Found);
    // Far from the known points.
    let away = square(lump, DVec2::X * 9.0, 2.2, SPACING_MM, 3);
    assert_eq!(recognize(&known, &away, &Pose::IDENTITY, [0.06, 0.3]).status, RecognitionStatus::TooLittle);
    // Invalid numbers.
    let surface = KnownSurface { points: &known, spacing_mm: SPACING_MM, surface_sigma_mm: 0.0 };
    for sigma in [[0.0, 1.0], [1.0, f64::NAN]] {
        assert_eq!(surface.recognize(&contact, &Pose::IDENTITY, sigma), None);
    }
    assert_eq!(surface.recognize(&[], &Pose::IDENTITY, [0.1, 0.1]), None);
    let mut bad = contact;
    bad[3].variance_mm2 = 0.0;
    assert_eq!(surface.recognize(&bad, &Pose::IDENTITY, [0.1, 0.1]), None);
}
