use super::*;
use crate::math::random::Stream;
use crate::math::{cos, sin};

/// A grid of points on an elliptic cylinder a = R (1 + e), b = R, from 10 to 80 degrees of the ellipse's
/// angle and 4 mm long. Normals are exact; their stated variance follows from the noise of the points.
fn ellipse(ellipticity: f64, sigma_mm: f64) -> (Observability, Symmetric<6>) {
    let (a, b) = (4.0 * (1.0 + ellipticity), 4.0);
    let at = |k: usize| (0.175 + 1.22 * (k % 9) as f64 / 8.0, (k / 9) as f64 - 2.0);
    let points: [DVec3; 45] = core::array::from_fn(|k| {
        let (angle, z) = at(k);
        DVec3::new(a * cos(angle), b * sin(angle), z)
    });
    let frame = PatchFrame::new(&points, 0.1);
    let mut system = System::new(frame.radius_mm, sigma_mm);
    for (k, &point) in points.iter().enumerate() {
        let (angle, _) = at(k);
        system.add(&Sighting {
            lever: point - frame.centre_mm,
            normal: DVec3::new(cos(angle) / a, sin(angle) / b, 0.0).normalize(),
            residual: 0.0,
            weight: 1.0,
            normal_variance: (sigma_mm / 4.0) * (sigma_mm / 4.0),
        });
    }
    (system.observe(frame.centre_mm), system.hessian.whole())
}

#[test]
fn row_11_information_grows_smoothly_from_a_circle() {
    // A spin by δ moves the surface along its normal by e R sin 2φ δ to first order: information grows as e².
    let sigma_mm = 1e-5;
    let (round, _) = ellipse(0.0, sigma_mm);
    assert_eq!(round.free_count(), 2);
    let (at_1e3, _) = ellipse(1e-3, sigma_mm);
    assert_eq!(at_1e3.free_count(), 1);
    for ellipticity in [1e-3, 2e-3, 5e-3, 1e-2] {
        let (seen, hessian) = ellipse(ellipticity, sigma_mm);
        let exact = linalg::eigen(&hessian).values[1] / (sigma_mm * sigma_mm);
        let ratio = seen.values[1] / exact;
        // The noise correction reduces λ by the share N / λ, at most 1 / limit for a determined direction.
        assert!(ratio <= 1.0 && ratio > 0.99, "{ratio}");
        let growth = seen.values[1] / at_1e3.values[1] / (ellipticity / 1e-3) / (ellipticity / 1e-3);
        assert!((growth - 1.0).abs() < 10.0 * ellipticity + 0.01, "{growth} at {ellipticity}");
    }
}

#[test]
fn row_11_a_direction_is_free_exactly_when_its_noise_explains_it() {
    // The same ellipse, 4 µm off a circle, with increasing noise: the direction becomes free once and
    // stays free.
    let counts = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1].map(|sigma_mm| ellipse(1e-3, sigma_mm).0.free_count());
    assert!(counts.is_sorted() && counts[0] == 1 && counts[5] == 2, "{counts:?}");
}

/// Information about a slide, per point, of a round rod with rings of slope ±0.04, under noise of points
/// and normals.
fn told_of_a_slide(sigma_mm: f64, tau: f64, random: &mut Stream) -> f64 {
    let angle = |k: usize| 0.175 + 1.22 * (k % 9) as f64 / 8.0;
    let points: [DVec3; 45] =
        core::array::from_fn(|k| DVec3::new(4.0 * cos(angle(k)), 4.0 * sin(angle(k)), (k / 9) as f64 - 2.0));
    let frame = PatchFrame::new(&points, 0.1);
    let mut system = System::new(frame.radius_mm, sigma_mm);
    for (k, &point) in points.iter().enumerate() {
        let slope = if k / 9 % 2 == 0 { 0.04 } else { -0.04 };
        let normal = DVec3::new(cos(angle(k)), sin(angle(k)), slope).normalize();
        let mut across = |size: f64| {
            let error = DVec3::new(random.normal(), random.normal(), random.normal()) * size;
            error - normal * normal.dot(error)
        };
        let lever = point - frame.centre_mm + across(sigma_mm);
        let normal = normal + across(tau);
        system.add(&Sighting { lever, normal, residual: 0.0, weight: 1.0, normal_variance: tau * tau });
    }
    let seen = system.observe(frame.centre_mm);
    let along = |u: &Vector6| u[5] * u[5];
    let told: f64 = seen.directions.iter().zip(seen.values).map(|(u, value)| value * along(u)).sum();
    told * sigma_mm * sigma_mm / 45.0
}

/// N of the module documentation equals what noise of points and normals adds to Σ J Jᵀ, entry by entry.
#[test]
fn row_11_noise_adds_what_it_is_said_to_add() {
    let (sigma_mm, tau, radius_mm, runs) = (0.1, 0.05, 2.0, 4000);
    let mut random = Stream::new(4, "noise");
    let mut error = |n: DVec3, size: f64| {
        let e = DVec3::new(random.normal(), random.normal(), random.normal()) * size;
        e - n * n.dot(e)
    };
    let sighting =
        |lever, normal| Sighting { lever, normal, residual: 0.0, weight: 1.0, normal_variance: tau * tau };
    for (lever, normal) in [
        (DVec3::new(1.5, -2.0, 0.3), DVec3::new(0.1, 0.2, -1.0).normalize()),
        (DVec3::new(0.1, 0.0, -0.2), DVec3::new(1.0, 0.5, 0.3).normalize()),
    ] {
        let mut exact = System::new(radius_mm, sigma_mm);
        exact.add(&sighting(lever, normal));
        let noise = exact.noise.whole();
        let (mut sum, mut squares) = ([[0.0; 6]; 6], [[0.0; 6]; 6]);
        for _ in 0..runs {
            // δn and δx separately, as in N: their joint effect is of fourth order.
            let turn = error(normal, tau);
            let shifted = stack(error(normal, sigma_mm).cross(normal) / radius_mm, DVec3::ZERO);
            let by_turn = stack(lever.cross(turn) / radius_mm, turn);
            let delta: Vector6 = core::array::from_fn(|k| by_turn[k] + shifted[k]);
            for i in 0..6 {
                for j in 0..6 {
                    let product = delta[i] * delta[j];
                    sum[i][j] += product / f64::from(runs);
                    squares[i][j] += product * product / f64::from(runs);
                }
            }
        }
        for i in 0..6 {
            for j in 0..6 {
                let deviation = sqrt(squares[i][j] / f64::from(runs));
                let apart = (sum[i][j] - noise[i][j]).abs();
                assert!(apart <= 5.0 * deviation + 1e-15, "{i} {j}: {} {}", sum[i][j], noise[i][j]);
            }
        }
    }
}

#[test]
fn row_11_what_is_told_of_a_weak_direction_is_right_on_average() {
    let (tau, runs) = (0.02, 400);
    let mut random = Stream::new(3, "unbiased");
    let exact = told_of_a_slide(1e-9, 1e-9, &mut random);
    let mean = (0..runs).map(|_| told_of_a_slide(0.02, tau, &mut random)).sum::<f64>() / f64::from(runs);
    // Mean over 45 points and all runs of (slope + noise)² minus the noise variance, a quarter of slope².
    let variance = tau * tau;
    let deviation = sqrt((4.0 * exact * variance + 2.0 * variance * variance) / (45.0 * f64::from(runs)));
    assert!((mean - exact).abs() < 4.0 * deviation, "{mean:e}, exact {exact:e} ± {deviation:e}");
}

#[test]
fn information_and_covariance_are_inverse_where_all_is_determined() {
    let mut system = System::new(2.0, 0.03);
    for k in 0..12 {
        let t = f64::from(k);
        let lever = DVec3::new(2.0 * cos(t), 2.0 * sin(t), cos(3.0 * t));
        let normal = DVec3::new(sin(5.0 * t), cos(2.0 * t), 0.7).normalize();
        system.add(&Sighting { lever, normal, residual: 0.0, weight: 1.0, normal_variance: 0.0 });
    }
    let seen = system.observe(DVec3::new(4.0, -1.0, 28.0));
    assert_eq!(seen.free_count(), 0);
    let (information, covariance) = (seen.information(), seen.determined_covariance());
    for i in 0..6 {
        for j in 0..6 {
            let product: f64 = (0..6).map(|k| information[i][k] * covariance[k][j]).sum();
            let identity = f64::from(u8::from(i == j));
            // Condition number about the origin: (28 / 2)⁴ times that about the centre.
            assert!((product - identity).abs() < 1e5 * 100.0 * f64::EPSILON, "{i} {j} {product}");
        }
    }
}

#[test]
fn a_solved_step_reaches_the_planes() {
    let (omega, v) = (DVec3::new(1e-3, -2e-3, 5e-4), DVec3::new(0.01, 0.02, -0.03));
    let mut system = System::new(2.0, 1e-3);
    for k in 0..12 {
        let t = f64::from(k);
        let lever = DVec3::new(2.0 * cos(t), 2.0 * sin(t), cos(3.0 * t));
        let normal = DVec3::new(sin(5.0 * t), cos(2.0 * t), 0.7).normalize();
        let residual = normal.dot(v + omega.cross(lever));
        system.add(&Sighting { lever, normal, residual, weight: 1.0, normal_variance: 0.0 });
    }
    let spectrum = linalg::eigen(&system.hessian.whole());
    let (omega_found, v_found) = system.solve(&spectrum, 1.0);
    assert!((omega_found - omega).length() < 1e-13 && (v_found - v).length() < 1e-13);
    // Limited to a hundredth of a millimetre: the same direction, but shorter.
    let (omega_short, v_short) = system.solve(&spectrum, 0.01);
    let moved = sqrt(4.0 * omega_short.length_squared() + v_short.length_squared());
    assert!((moved - 0.01).abs() < 1e-15 && v_short.dot(v) > 0.0);
}

/// The covariance of determined directions grows by that of the shift, and free ones stay free.
#[test]
fn an_offset_of_all_points_adds_its_variance() {
    let (seen, _) = ellipse(0.0, 0.01);
    let direction = DVec3::new(cos(0.8), sin(0.8), 0.0);
    let with = seen.with_offset(direction, 0.3);
    assert_eq!((seen.free_count(), with.free_count()), (2, 2));
    let [before, after] = [seen, with].map(|seen| seen.determined_covariance());
    // What remains of the shift without its part along free directions.
    let mut shift = stack(DVec3::ZERO, direction);
    for (u, _) in seen.directions.iter().zip(seen.values).filter(|(_, value)| *value == 0.0) {
        let along = dot(u, &shift);
        shift.iter_mut().zip(u).for_each(|(shift, u)| *shift -= along * u);
    }
    let (omega, v) = seen.motion(&shift);
    let moved = stack(omega, v - omega.cross(seen.centre_mm));
    let size = dot(&moved, &moved);
    assert!(size > 0.9, "{size}");
    for i in 0..6 {
        for k in 0..6 {
            let expected = before[i][k] + 0.09 * moved[i] * moved[k];
            assert!((after[i][k] - expected).abs() < 1e-9 * size, "{i} {k} {} {expected}", after[i][k]);
        }
    }
    let prior = GuessSigma { turn_rad: 0.2, shift_mm: 2.0 };
    let [given, same] = [seen, seen.with_offset(direction, 0.0)].map(|seen| seen.covariance(&prior));
    for (a, b) in given.iter().flatten().zip(same.iter().flatten()) {
        assert!((a - b).abs() < 1e-9 * (1.0 + a.abs()), "{a} {b}");
    }
}
