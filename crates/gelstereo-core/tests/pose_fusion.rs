//! Fusion of two estimates of one pose: laws that hold whatever the estimates are.

use gelstereo_core::math::linalg::{Symmetric, eigen};
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::register::{FusionError, PlaneContact, PoseEstimate, fuse_plane, fuse_poses};
use proptest::prelude::*;

fn vector(max: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-max..max).prop_map(DVec3::from_array)
}

fn pose(max_rad: f64, max_mm: f64) -> impl Strategy<Value = Pose> {
    (vector(max_rad), vector(max_mm)).prop_map(|(omega, v)| Pose::exp(omega, v))
}

/// Information of `rank` random measurements of turns, in mrad, and of shifts, in mm.
fn information(rank: usize) -> impl Strategy<Value = Symmetric<6>> {
    prop::collection::vec(prop::array::uniform6(-1.0..1.0f64), rank).prop_map(|rows| {
        let scale = |i: usize| if i < 3 { 1e3 } else { 10.0 };
        core::array::from_fn(|i| {
            core::array::from_fn(|j| rows.iter().map(|r| scale(i) * r[i] * r[j] * scale(j)).sum())
        })
    })
}

/// Two estimates of a pose within 0.2 rad and 2 mm of each other, which know `ranks` directions.
fn estimates(ranks: [usize; 2]) -> impl Strategy<Value = [PoseEstimate; 2]> {
    let two = (information(ranks[0]), information(ranks[1]));
    (pose(3.0, 50.0), pose(0.1, 2.0), two).prop_map(|(first, apart, two)| {
        [
            PoseEstimate { pose: first, information: two.0 },
            PoseEstimate { pose: apart * first, information: two.1 },
        ]
    })
}

fn apart(a: &Pose, b: &Pose) -> f64 {
    let (omega, v) = (*a * b.inverse()).log();
    omega.length().max(v.length() / 100.0)
}

fn close(a: &Symmetric<6>, b: &Symmetric<6>, share: f64) -> bool {
    let scale = |i: usize, j: usize| (b[i][i] * b[j][j]).sqrt() + 1e-9;
    (0..6).all(|i| (0..6).all(|j| (a[i][j] - b[i][j]).abs() <= share * scale(i, j)))
}

fn fused(a: &PoseEstimate, b: &PoseEstimate) -> gelstereo_core::register::FusedPose {
    fuse_poses(a, b).expect("both are valid")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn the_order_of_two_looks_changes_nothing([a, b] in estimates([8, 8])) {
        let (ab, ba) = (fused(&a, &b), fused(&b, &a));
        prop_assert!(apart(&ab.estimate.pose, &ba.estimate.pose) < 1e-9);
        prop_assert!(close(&ab.estimate.information, &ba.estimate.information, 1e-7));
        prop_assert!((ab.squared_distance - ba.squared_distance).abs() <= 1e-9 * (1.0 + ab.squared_distance));
    }

    #[test]
    fn fusion_does_not_depend_on_the_frame([a, b] in estimates([8, 8]), t_c_a in pose(3.0, 30.0)) {
        let here = fused(&a, &b).estimate.in_frame(&t_c_a);
        let there = fused(&a.in_frame(&t_c_a), &b.in_frame(&t_c_a)).estimate;
        prop_assert!(apart(&here.pose, &there.pose) < 1e-8);
        prop_assert!(close(&here.information, &there.information, 1e-6));
    }

    #[test]
    fn equal_poses_add_their_information(a in estimates([8, 8])) {
        let b = PoseEstimate { pose: a[0].pose, information: a[1].information };
        let found = fused(&a[0], &b);
        let sum = core::array::from_fn(|i| {
            core::array::from_fn(|j| a[0].information[i][j] + b.information[i][j])
        });
        prop_assert!(apart(&found.estimate.pose, &b.pose) < 1e-12 && found.squared_distance < 1e-12);
        prop_assert!(close(&found.estimate.information, &sum, 1e-12));
    }

    #[test]
    fn who_knows_nothing_changes_nothing([a, b] in estimates([8, 0])) {
        for found in [fused(&a, &b), fused(&b, &a)] {
            prop_assert!(apart(&found.estimate.pose, &a.pose) < 1e-10);
            prop_assert!(close(&found.estimate.information, &a.information, 1e-8));
        }
    }

    /// What three measurements leave free, three others may tell: all of the pose is then known, at no
    /// distance.
    #[test]
    fn two_partial_looks_make_a_whole([a, b] in estimates([3, 3])) {
        // Where two of the directions are nearly alike, the pose at no distance is too far away for
        // Gauss-Newton, which then says so.
        let sum: Symmetric<6> = core::array::from_fn(|i| {
            core::array::from_fn(|j| a.information[i][j] + b.information[i][j])
        });
        let scaled: Symmetric<6> = core::array::from_fn(|i| {
            core::array::from_fn(|j| sum[i][j] / (sum[i][i] * sum[j][j]).sqrt())
        });
        prop_assume!(eigen(&scaled).values[0] > 0.03);
        let found = fused(&a, &b);
        prop_assert!(found.squared_distance < 1e-6, "{}", found.squared_distance);
    }

    /// Two looks that know three directions each: either at rest, or refused.
    #[test]
    fn what_does_not_come_to_rest_is_no_answer([a, b] in estimates([3, 3])) {
        match fuse_poses(&a, &b) {
            // Three and three measurements can all be met; what is at rest elsewhere is a local minimum.
            Ok(found) => prop_assert!(found.squared_distance.is_finite()),
            Err(error) => prop_assert!(matches!(error, FusionError::NotConverged { .. }), "{error}"),
        }
    }

    /// A peg that slides freely along its axis stays where the first look has it, wherever the robot's base
    /// is.
    #[test]
    fn what_is_free_stays_free_through_a_far_frame(t_base_part in pose(3.0, 600.0), turn in 0.1..3.0f64) {
        let rows = |angle: f64| -> [[f64; 6]; 4] {
            let (c, s) = (angle.cos(), angle.sin());
            // Places across the axis at two heights, and along the normal of the contact alone.
            [(0.0, -5.0), (0.0, 5.0), (5.0, 0.0), (-5.0, 0.0)].map(|(x, y)| [x, y, 0.0, c, s, 0.0])
        };
        let look = |angle: f64, pose: Pose| {
            let rows = rows(angle);
            let information = core::array::from_fn(|i| {
                core::array::from_fn(|j| rows.iter().map(|r| 1e6 * r[i] * r[j]).sum())
            });
            PoseEstimate { pose, information }.in_frame(&t_base_part).in_frame(&t_base_part.inverse())
        };
        let first = look(0.0, Pose::IDENTITY);
        let second = look(turn, Pose::from_translation_mm(DVec3::new(0.01, 0.01, 3.0)));
        let found = fused(&first, &second).estimate.pose;
        prop_assert!(found.translation_mm.z.abs() < 1e-3, "{}", found.translation_mm);
    }

    #[test]
    fn a_disturbance_adds_its_covariance(a in estimates([10, 0]), point in vector(40.0)) {
        // Known to no more than this, along every direction: the closed form on the other side needs an
        // inverse.
        let mut a = a[0];
        (0..6).for_each(|i| a.information[i][i] += if i < 3 { 1e4 } else { 1.0 });
        let (sigma_rad, sigma_mm) = (DVec3::new(2e-3, 1e-3, 0.0), DVec3::new(0.05, 0.6, 0.0));
        let found = a.disturbed(point, sigma_rad, sigma_mm);
        let about = Pose::from_translation_mm(-point);
        let covariance = |e: &PoseEstimate| inverse(&e.in_frame(&about).information);
        let (before, after) = (covariance(&a), covariance(&found));
        for i in 0..6 {
            for j in 0..6 {
                let sigma = if i < 3 { sigma_rad[i] } else { sigma_mm[i - 3] };
                let expected = before[i][j] + if i == j { sigma * sigma } else { 0.0 };
                let scale = (after[i][i] * after[j][j]).sqrt();
                prop_assert!((after[i][j] - expected).abs() < 1e-6 * scale, "{i} {j}");
            }
        }
        prop_assert!(apart(&found.pose, &a.pose) < 1e-14);
    }
}

/// Gauss-Jordan with pivots.
fn inverse(matrix: &Symmetric<6>) -> Symmetric<6> {
    let mut a: [[f64; 12]; 6] = core::array::from_fn(|i| {
        core::array::from_fn(|j| if j < 6 { matrix[i][j] } else { f64::from(u8::from(j - 6 == i)) })
    });
    for column in 0..6 {
        let pivot = (column..6).max_by(|&i, &j| a[i][column].abs().total_cmp(&a[j][column].abs()));
        a.swap(column, pivot.expect("there are rows left"));
        let lead = a[column][column];
        a[column].iter_mut().for_each(|x| *x /= lead);
        let row = a[column];
        for (i, other) in a.iter_mut().enumerate().filter(|(i, _)| *i != column) {
            let factor = other[column];
            assert!(i < 6);
            other.iter_mut().zip(row).for_each(|(x, r)| *x -= factor * r);
        }
    }
    core::array::from_fn(|i| core::array::from_fn(|j| a[i][j + 6]))
}

#[test]
fn what_is_no_estimate_is_refused_by_name() {
    let information: Symmetric<6> =
        core::array::from_fn(|i| core::array::from_fn(|j| f64::from(u8::from(i == j))));
    let good = PoseEstimate { pose: Pose::IDENTITY, information };
    let with = |i: usize, j: usize, value: f64| {
        let mut bad = good;
        bad.information[i][j] = value;
        bad
    };
    assert_eq!(fuse_poses(&good, &with(2, 3, f64::NAN)), Err(FusionError::NotFinite { index: 1 }));
    assert_eq!(fuse_poses(&with(0, 1, 0.5), &good), Err(FusionError::Information { index: 0 }));
    assert_eq!(fuse_poses(&good, &with(4, 4, -1.0)), Err(FusionError::Information { index: 1 }));
    let mut indefinite = with(0, 1, 2.0);
    indefinite.information[1][0] = 2.0;
    assert_eq!(fuse_poses(&indefinite, &good), Err(FusionError::Information { index: 0 }));
    let turned = PoseEstimate { pose: Pose::exp(DVec3::Z * 1.5, DVec3::ZERO), information };
    let error = fuse_poses(&good, &turned).expect_err("a quarter turn is another copy of the part");
    assert!(error.to_string().contains("1.500 rad") && error.to_string().contains("copies"), "{error}");
}

fn plane() -> impl Strategy<Value = PlaneContact> {
    (vector(20.0), vector(1.0), -3.0..3.0f64, 0.01..0.3f64).prop_filter_map(
        "a direction",
        |(point_mm, direction, offset_mm, sigma_mm)| {
            let normal = direction.try_normalize()?;
            Some(PlaneContact { point_mm, normal, offset_mm, sigma_mm })
        },
    )
}

/// The plane moved so that the point of the part is so far from it.
fn at_distance(contact: PlaneContact, pose: &Pose, distance_mm: f64) -> PlaneContact {
    let along = contact.normal.dot(pose.transform_point(contact.point_mm));
    PlaneContact { offset_mm: along - distance_mm, ..contact }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    /// In one dimension: two measurements of a distance that differ by δ are δ² / (σ₁² + σ₂²) apart.
    #[test]
    fn a_plane_weighs_against_what_was_known(
        a in estimates([10, 0]), contact in plane(), distance_mm in -0.02..0.02f64,
    ) {
        let mut a = a[0];
        (0..6).for_each(|i| a.information[i][i] += if i < 3 { 1e6 } else { 1e2 });
        let contact = at_distance(contact, &a.pose, distance_mm);
        let found = fuse_plane(&a, &contact).expect("valid");
        let turn = a.pose.transform_point(contact.point_mm).cross(contact.normal);
        let row: Vec<f64> = turn.to_array().into_iter().chain(contact.normal.to_array()).collect();
        let covariance = inverse(&a.information);
        let known: f64 =
            (0..6).map(|i| (0..6).map(|j| row[i] * covariance[i][j] * row[j]).sum::<f64>()).sum();
        let sum = known + contact.sigma_mm * contact.sigma_mm;
        let expected = distance_mm * distance_mm / sum;
        // The turns are below 1e-3 rad: what is not linear is a thousandth.
        prop_assert!((found.squared_distance - expected).abs() < 1e-2 * expected + 1e-12);
        let left =
            contact.normal.dot(found.estimate.pose.transform_point(contact.point_mm)) - contact.offset_mm;
        let weighed = distance_mm * contact.sigma_mm * contact.sigma_mm / sum;
        prop_assert!((left - weighed).abs() < 1e-2 * distance_mm.abs() + 1e-9, "{left} against {weighed}");
    }

    /// A plane is known along one direction: what is free across it stays where it was.
    #[test]
    fn a_plane_moves_a_free_part_along_its_normal_alone(
        pose in pose(3.0, 50.0), contact in plane(), distance_mm in -2.0..2.0f64,
    ) {
        let turns =
            core::array::from_fn(|i| core::array::from_fn(|j| if i == j && i < 3 { 1e8 } else { 0.0 }));
        let centre = pose.transform_point(contact.point_mm);
        let about = PoseEstimate { pose: Pose::from_translation_mm(-centre) * pose, information: turns };
        let known = about.in_frame(&Pose::from_translation_mm(centre));
        let contact = at_distance(contact, &pose, distance_mm);
        let found = fuse_plane(&known, &contact).expect("valid");
        let moved = found.estimate.pose.transform_point(contact.point_mm) - centre;
        prop_assert!((moved + contact.normal * distance_mm).length() < 1e-6, "{moved}");
        prop_assert!(found.squared_distance < 1e-9);
    }

    #[test]
    fn a_plane_does_not_depend_on_the_frame(
        a in estimates([10, 0]), contact in plane(), distance_mm in -0.5..0.5f64, t_c_a in pose(3.0, 30.0),
    ) {
        let contact = at_distance(contact, &a[0].pose, distance_mm);
        let normal = t_c_a.transform_vector(contact.normal);
        let offset_mm = contact.offset_mm + normal.dot(t_c_a.translation_mm);
        let there = fuse_plane(&a[0].in_frame(&t_c_a), &PlaneContact { normal, offset_mm, ..contact });
        let here = fuse_plane(&a[0], &contact).expect("valid").estimate.in_frame(&t_c_a);
        let there = there.expect("valid").estimate;
        prop_assert!(apart(&here.pose, &there.pose) < 1e-7);
        prop_assert!(close(&here.information, &there.information, 1e-6));
    }
}

#[test]
fn what_is_no_plane_is_refused_by_name() {
    let known = PoseEstimate { pose: Pose::IDENTITY, information: [[0.0; 6]; 6] };
    let good = PlaneContact { point_mm: DVec3::ZERO, normal: DVec3::Y, offset_mm: 1.0, sigma_mm: 0.1 };
    let cases = [
        (PlaneContact { normal: DVec3::Y * 2.0, ..good }, "the length of normal"),
        (PlaneContact { sigma_mm: 0.0, ..good }, "sigma_mm"),
        (PlaneContact { sigma_mm: f64::NAN, ..good }, "sigma_mm"),
        (PlaneContact { offset_mm: f64::INFINITY, ..good }, "offset_mm"),
        (PlaneContact { point_mm: DVec3::X * f64::NAN, ..good }, "a component of point_mm"),
    ];
    for (bad, name) in cases {
        let error = fuse_plane(&known, &bad).expect_err("not valid").to_string();
        assert!(error.starts_with(name), "{error}");
    }
    let found = fuse_plane(&known, &good).expect("valid").estimate.pose;
    assert!((found.translation_mm - DVec3::Y).length() < 1e-12, "nothing else was known");
}
