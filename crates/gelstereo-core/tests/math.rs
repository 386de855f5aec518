//! Rotations, motions, eigenvectors and random numbers at the places where they lose digits.
//!
//! Constants come from mpmath with 50 digits, rounded once; `tests/test_hard_cases_math.py` compares at
//! random places.
// A test may stop at what it did not expect, and print its table.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use gelstereo_core::math::linalg::{Symmetric, eigen};
use gelstereo_core::math::random::{Stream, keyed};
use gelstereo_core::math::se3::PoseError;
use gelstereo_core::math::so3::{self, RotationError};
use gelstereo_core::math::{DMat3, DQuat, DVec3, Pose};
use proptest::prelude::*;
use std::f64::consts::PI;

const EPS: f64 = f64::EPSILON;
/// A unit vector whose components and their squares are nearly exact.
const AXIS: DVec3 = DVec3::new(1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0);

fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-limit..limit).prop_map(DVec3::from_array)
}

/// Angles from 1e-300 to 3, evenly by their logarithm.
fn small_vector() -> impl Strategy<Value = DVec3> {
    (vector(1.0), -300.0..0.0_f64).prop_map(|(v, power)| v * 10.0_f64.powf(power))
}

#[test]
fn row_01_exp_and_log_beside_pi() {
    // (θ, cos θ/2, sin θ/2) for the f64 nearest to π minus 1e-1, 1e-4, 1e-8, 1e-12.
    let table = [
        (3.041592653589793, 0.049979169270678435, 0.9987502603949663),
        (3.141492653589793, 4.9999999979333415e-05, 0.99999999875),
        (3.141592643589793, 5.000000030844985e-09, 1.0),
        (3.141592653588793, 5.001056826311279e-13, 1.0),
    ];
    for (theta, c, s) in table {
        let q = so3::exp(AXIS * theta);
        // θ/2 carries an ulp of the length, π/2 eps, which shows as an absolute error of the cosine.
        assert!((q.w - c).abs() <= 2.0 * EPS, "cos at {theta}: {:e}", q.w - c);
        assert!((DVec3::new(q.x, q.y, q.z) - AXIS * s).abs().max_element() <= 2.0 * EPS);
        let back = so3::log(q);
        assert!((back - AXIS * theta).length() <= 4.0 * EPS * PI, "log at {theta}");
    }
}

#[test]
fn row_01_log_at_exactly_pi_is_a_half_turn() {
    for axis in [DVec3::X, DVec3::Y, DVec3::Z, AXIS, -AXIS] {
        let q = DQuat::from_xyzw(axis.x, axis.y, axis.z, 0.0);
        let half_turn = so3::log(q);
        assert!((half_turn - axis * PI).length() <= 4.0 * EPS * PI);
        // Through the matrix the sign of the axis is lost; the rotation is not.
        let again = so3::from_matrix(&DMat3::from_quat(q)).unwrap();
        assert!((again.dot(q).abs() - 1.0).abs() <= 4.0 * EPS);
    }
}

proptest! {
    #[test]
    fn row_02_log_undoes_exp_to_a_few_ulp_at_every_scale(omega in small_vector()) {
        let back = so3::log(so3::exp(omega));
        // sin, quotient, two products, atan2 and a quotient: below ten roundings of half an ulp each. The
        // last term is a denormal's own step.
        let bound = 5.0 * EPS * omega.length() + 1e-322;
        prop_assert!((back - omega).abs().max_element() <= bound, "{omega} {back}");
    }

    #[test]
    fn row_03_jacobian_times_inverse_is_identity(omega in vector(3.6)) {
        let product = so3::left_jacobian(omega) * so3::left_jacobian_inverse(omega);
        let error =
            (product - DMat3::IDENTITY).to_cols_array().into_iter().fold(0.0_f64, |m, e| m.max(e.abs()));
        // Both grow as θ / 2 / sin(θ/2), their condition, towards 2π; below 6.3 that stays under 200.
        let half = 0.5 * omega.length();
        let condition = (half / half.sin()).abs().max(1.0);
        prop_assert!(error <= 16.0 * EPS * condition, "{error:e} {condition}");
    }

    #[test]
    fn row_04_a_quaternion_and_its_opposite_are_one(
        v in vector(1.0), w in -1.0..1.0_f64, power in -140.0..140.0_f64,
    ) {
        let q = DQuat::from_xyzw(v.x, v.y, v.z, w) * 10.0_f64.powf(power);
        let (a, b) = (so3::canonical(q).unwrap(), so3::canonical(-q).unwrap());
        prop_assert_eq!(a, b);
        prop_assert!(a.w >= 0.0 && (a.length() - 1.0).abs() <= 2.0 * EPS);
        prop_assert_eq!(so3::log(a), so3::log(-a));
        // At half a turn w is 0 and tells nothing.
        let half = DQuat::from_xyzw(v.x, v.y, v.z, 0.0);
        let (one, other) = (so3::canonical(half).unwrap(), so3::canonical(-half).unwrap());
        prop_assert_eq!(one, DQuat::from_xyzw(other.x, other.y, other.z, one.w));
    }

    #[test]
    fn exp_and_log_of_motions_undo_each_other(omega in vector(1.8), v in vector(100.0)) {
        let (omega_back, v_back) = Pose::exp(omega, v).log();
        prop_assert!((omega_back - omega).length() <= 8.0 * EPS * omega.length().max(1e-300));
        // V and V⁻¹ have a condition of at most θ / 2 / sin(θ/2) < 2 up to |ω| = 3.12 < π.
        prop_assert!((v_back - v).length() <= 64.0 * EPS * v.length(), "{v} {v_back}");
    }

    #[test]
    fn matrices_and_quaternions_name_the_same_rotation(omega in vector(1.8)) {
        let q = so3::canonical(so3::exp(omega)).unwrap();
        let back = so3::from_matrix(&DMat3::from_quat(q)).unwrap();
        prop_assert!((back - q).length() <= 8.0 * EPS);
    }

    #[test]
    fn eigenvectors_rebuild_the_matrix(
        entries in prop::array::uniform21(-1.0..1.0_f64), powers in prop::array::uniform6(-6.0..6.0_f64),
    ) {
        let scale = powers.map(|p| 10.0_f64.powf(p));
        let at = |i: usize, j: usize| {
            let (i, j) = (i.min(j), i.max(j));
            entries[i * (11 - i) / 2 + j] * scale[i] * scale[j]
        };
        let matrix: Symmetric<6> = std::array::from_fn(|i| std::array::from_fn(|j| at(i, j)));
        let found = eigen(&matrix);
        prop_assert!(found.values.is_sorted());
        let largest = found.values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        for i in 0..6 {
            for j in 0..6 {
                let rebuilt: f64 =
                    (0..6).map(|k| found.values[k] * found.vectors[k][i] * found.vectors[k][j]).sum();
                // Six sweeps of fifteen rotations, each a few roundings of the largest entry.
                prop_assert!((rebuilt - matrix[i][j]).abs() <= 200.0 * EPS * largest);
                let dot: f64 = (0..6).map(|k| found.vectors[i][k] * found.vectors[j][k]).sum();
                prop_assert!((dot - f64::from(u8::from(i == j))).abs() <= 200.0 * EPS);
            }
        }
    }

    #[test]
    fn eigen_always_returns_whatever_it_is_given(entries in prop::array::uniform16(any::<f64>())) {
        let matrix: Symmetric<4> =
            std::array::from_fn(|i| std::array::from_fn(|j| entries[4 * i.min(j) + i.max(j)]));
        let _ = eigen(&matrix);
    }
}

/// Near half a turn the trace tells w badly: another of the four numbers has to be taken from the diagonal.
#[test]
fn row_04_a_matrix_gives_its_quaternion_back_at_every_angle() {
    let axes = (0..27).map(|n| DVec3::new(f64::from(n % 3), f64::from(n / 3 % 3), f64::from(n / 9)) - 1.0);
    let off_half_a_turn = (0..=120).map(|k| PI - 10.0_f64.powf(-0.1 * f64::from(k)));
    let angles: Vec<f64> = (0..=600).map(|k| PI * f64::from(k) / 600.0).chain(off_half_a_turn).collect();
    for axis in axes.filter(|a| *a != DVec3::ZERO).map(DVec3::normalize) {
        for &angle in &angles {
            let q = so3::canonical(so3::exp(axis * angle)).unwrap();
            let back = so3::from_matrix(&DMat3::from_quat(q)).unwrap();
            // Entries of the matrix are good to 3 U; the largest of the four numbers is at least 1/2, so that
            // the others, sums of two entries over four times it, are good to 6 U, three of them to 10 U
            // together. Both lengths add 2 U.
            let apart = (back - q).length().min((back + q).length());
            assert!(apart <= 7.0 * EPS, "{axis} {angle}: {apart:e}");
        }
    }
}

#[test]
fn row_02_exp_keeps_the_first_order_at_every_power_of_ten() {
    for (power, mantissa) in (-14..=-4).flat_map(|power| [1.0, 1.9, 5.0].map(|mantissa| (power, mantissa))) {
        let omega = AXIS * (mantissa * 10.0_f64.powi(power));
        let q = so3::exp(omega);
        // sin(θ/2)/θ = 1/2 - θ²/48 + ...; the next term is below an ulp from 5e-4 down.
        let series = omega * (0.5 - omega.length_squared() / 48.0);
        assert!((DVec3::new(q.x, q.y, q.z) - series).abs().max_element() <= 2.0 * EPS * omega.length());
    }
}

#[test]
fn row_03_left_jacobian_beside_zero() {
    // (θ, (1 - cos θ)/θ², (θ - sin θ)/θ³, (1 - θ/2 cot θ/2)/θ²)
    let table = [
        (1e-8, 0.5, 0.16666666666666666, 0.08333333333333333),
        (1e-4, 0.49999999958333335, 0.16666666658333334, 0.08333333334722222),
        (1.5, 0.4130056881476876, 0.14889037433953942, 0.08663572826131866),
        (3.0, 0.2211102774000495, 0.10588444414593084, 0.09929197039400237),
    ];
    for (theta, b, c, d) in table {
        let v = so3::left_jacobian(DVec3::new(theta, 0.0, 0.0));
        let w = so3::left_jacobian_inverse(DVec3::new(theta, 0.0, 0.0));
        // Off the diagonal a coefficient stands alone, times θ: relative accuracy. On it, it is added to 1.
        assert!((v.y_axis.z / theta - b).abs() <= 3.0 * EPS * b, "b at {theta}");
        assert!((v.y_axis.y - (1.0 - theta * theta * c)).abs() <= 3.0 * EPS, "c at {theta}");
        assert!((w.y_axis.y - (1.0 - theta * theta * d)).abs() <= 3.0 * EPS, "d at {theta}");
        assert_eq!((v.x_axis.x, w.x_axis.x), (1.0, 1.0));
    }
}

#[test]
fn row_04_quaternions_without_a_direction_are_refused() {
    let refused = |x, y, z, w| so3::canonical(DQuat::from_xyzw(x, y, z, w));
    assert_eq!(refused(0.0, 0.0, 0.0, 0.0), Err(RotationError::ZeroNorm { norm: 0.0 }));
    assert!(matches!(refused(1e-200, 0.0, 0.0, -1e-200), Err(RotationError::ZeroNorm { .. })));
    assert_eq!(refused(f64::NAN, 0.0, 0.0, 1.0), Err(RotationError::NotFinite));
    assert_eq!(refused(0.0, f64::INFINITY, 0.0, 1.0), Err(RotationError::NotFinite));
    assert_eq!(refused(0.0, 0.0, 1e300, 0.0).unwrap(), DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0));
}

#[test]
fn row_04_half_turns_about_an_axis_have_one_quaternion_whatever_its_sign() {
    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
        for sign in [1.0, -1.0] {
            let q = axis * sign;
            let found = so3::canonical(DQuat::from_xyzw(q.x, q.y, q.z, 0.0)).unwrap();
            assert_eq!(DVec3::new(found.x, found.y, found.z), axis);
        }
    }
}

#[test]
fn row_04_single_precision_is_a_rotation_and_a_stretch_of_a_millionth_is_none() {
    let exact = DMat3::from_quat(so3::exp(DVec3::new(0.3, -0.5, 0.7)));
    let single = DMat3::from_cols_array(&exact.to_cols_array().map(|x| f64::from(x as f32)));
    let apart = so3::from_matrix(&single).unwrap().dot(so3::from_matrix(&exact).unwrap());
    assert!((apart - 1.0).abs() < 1e-14);
    let refused = so3::from_matrix(&(exact * (1.0 + 1e-6)));
    assert!(matches!(refused, Err(RotationError::NotOrthonormal { deviation, .. }) if deviation < 3e-6));
    let mirrored = so3::from_matrix(&-exact);
    assert!(matches!(mirrored, Err(RotationError::NotOrthonormal { determinant, .. }) if determinant < -0.9));
}

#[test]
fn rows_give_their_motion_back_and_what_is_none_is_refused_by_name() {
    let pose = Pose::exp(DVec3::new(0.3, -0.5, 0.7), DVec3::new(1.0, -2.0, 3.0));
    let rows = pose.to_rows();
    let back = Pose::from_rows(&rows).unwrap();
    assert_eq!(back.translation_mm, pose.translation_mm);
    assert!((back.rotation - pose.rotation).length() <= 7.0 * EPS);
    let p = DVec3::new(4.0, 5.0, -6.0);
    let by_rows =
        DVec3::from_array(std::array::from_fn(|i| DVec3::from_slice(&rows[i][..3]).dot(p) + rows[i][3]));
    assert!(
        (by_rows - pose.transform_point(p)).length()
            <= 8.0 * EPS * (p.length() + pose.translation_mm.length())
    );
    let with = |i: usize, j: usize, x: f64| {
        let mut rows = rows;
        rows[i][j] = x;
        Pose::from_rows(&rows)
    };
    for j in 0..3 {
        assert!(matches!(with(3, j, 1e-9), Err(PoseError::LastRow(_))));
        for column in [0, 3] {
            let refused = with(j, column, f64::INFINITY);
            assert_eq!(refused, Err(PoseError::NotFinite { row: j, column, value: f64::INFINITY, count: 1 }));
        }
    }
    assert!(matches!(with(3, 3, 2.0), Err(PoseError::LastRow(_))));
    let lost = Pose::from_translation_mm(DVec3::X * f64::INFINITY);
    assert_eq!(lost.normalized(), Err(PoseError::TranslationNotFinite));
}

#[test]
fn huge_twists_stay_finite() {
    for size in [1e150, 1e200, 1e300] {
        let pose = Pose::exp(DVec3::new(size, -size, 0.0), DVec3::ONE);
        assert!(pose.rotation.is_finite() && (pose.rotation.length() - 1.0).abs() < 4.0 * EPS);
    }
}

#[test]
fn eigenvalues_of_a_graded_matrix_keep_their_own_digits() {
    // D A D with A well conditioned and D graded: every eigenvalue is determined to cond(A) eps of itself.
    // A = [[1, 1/2], [1/2, 1]], D = diag(1, 1e-10): the small eigenvalue is 0.75e-20 (1 + 0.25e-20).
    let found = eigen(&[[1.0, 0.5e-10], [0.5e-10, 1e-20]]);
    assert!((found.values[0] / 0.75e-20 - 1.0).abs() <= 4.0 * EPS, "{:e}", found.values[0]);
}

#[test]
fn streams_depend_on_seed_and_name_alone() {
    let first = |seed, name: &str| Stream::new(seed, name).next_u64();
    assert_eq!(first(1, "a"), first(1, "a"));
    assert_ne!(first(1, "a"), first(1, "b"));
    assert_ne!(first(1, "a"), first(2, "a"));
}

#[test]
fn random_numbers_have_the_moments_of_their_laws() {
    const N: usize = 100_000;
    let mut stream = Stream::new(3, "moments");
    let (mut uniform, mut mean, mut variance, mut fourth) = (0.0, 0.0, 0.0, 0.0);
    let mut bins = [0_usize; 7];
    for _ in 0..N {
        uniform += stream.uniform() / N as f64;
        let x = stream.normal();
        mean += x / N as f64;
        variance += x * x / N as f64;
        fourth += x.powi(4) / N as f64;
        bins[stream.below(7)] += 1;
    }
    // Five standard deviations of each mean: √(1/12N), √(1/N), √(2/N), √(96/N); bins √(N 6/49).
    let n = N as f64;
    assert!((uniform - 0.5).abs() < 5.0 * (1.0 / 12.0 / n).sqrt());
    assert!(mean.abs() < 5.0 * (1.0 / n).sqrt());
    assert!((variance - 1.0).abs() < 5.0 * (2.0 / n).sqrt());
    assert!((fourth - 3.0).abs() < 5.0 * (96.0 / n).sqrt());
    assert!(bins.iter().all(|&b| (b as f64 - n / 7.0).abs() < 5.0 * (n * 6.0 / 49.0).sqrt()));
}

#[cfg(feature = "serde")]
mod poses_in_files {
    use gelstereo_core::math::{DVec3, Pose};
    use proptest::prelude::*;

    #[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize)]
    struct File {
        pose: Pose,
    }

    proptest! {
        /// A rig that is saved and loaded gives the same bits in every later result.
        #[test]
        fn come_back_with_the_same_bits(twist in prop::array::uniform6(-3.0..3.0_f64)) {
            let [a, b, c, x, y, z] = twist;
            let file = File { pose: Pose::exp(DVec3::new(a, b, c), DVec3::new(x, y, z) * 10.0) };
            let back: File = toml::from_str(&toml::to_string(&file).unwrap()).unwrap();
            prop_assert_eq!(back, file);
        }
    }

    #[test]
    fn may_be_rows_and_typed_quaternions_are_normalised() {
        let rows = "pose = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]";
        let typed = "pose = { rotation_xyzw = [0, 0, 0.7071, 0.7071], translation_mm = [1, 2, 3] }";
        let rows: File = toml::from_str(rows).unwrap();
        let typed: File = toml::from_str(typed).unwrap();
        assert!(rows.pose.rotation.dot(typed.pose.rotation) > 1.0 - 1e-15);
        assert_eq!(rows.pose.translation_mm, typed.pose.translation_mm);
        // Twelve digits were typed, too, and not written by this type.
        let typed =
            "pose = { rotation_xyzw = [0, 0, 0.707106781187, 0.707106781187], translation_mm = [1, 2, 3] }";
        let typed: File = toml::from_str(typed).unwrap();
        assert!((typed.pose.rotation.length() - 1.0).abs() <= f64::EPSILON);
    }

    #[test]
    fn that_are_none_say_what_one_is() {
        for (bad, words) in [
            ("pose = 3", "rotation_xyzw"),
            ("pose = { rotation_xyzw = [0, 0, 0, 0], translation_mm = [0, 0, 0] }", "norm"),
            ("pose = [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]", "no rotation"),
        ] {
            let message = toml::from_str::<File>(bad).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }
}

#[test]
fn keyed_numbers_are_those_of_splitmix64() {
    // The first of the sequence from 0, as its authors' program prints them.
    let printed = [0xE220_A839_7B1D_CDAF_u64, 0x6E78_9E6A_A1B9_65F4, 0x06C4_5D18_8009_454F];
    assert_eq!([0, 1, 2].map(|index| keyed(0, index)), printed);
    // From any place of the sequence: a key is its state.
    assert_eq!(keyed(0x9E37_79B9_7F4A_7C15, 1), printed[2]);
}
