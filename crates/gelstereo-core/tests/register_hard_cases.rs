//! Registration as a whole where it is hardest: bad input, offsets, units, free directions, duplicates,
//! repeated runs.
// A test may stop at what it did not expect, and print its table.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use crate::contact_patch;

use crate::support::poses;
use contact_patch::{Contact, Shape};
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DQuat, DVec3, Pose, so3};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Motion, RegisterError, Registrar, Registration, Template};
use proptest::prelude::*;

const EPS: f64 = f64::EPSILON;
const METHODS: [RegisterMethod; 2] = [RegisterMethod::FilterregPoint, RegisterMethod::RansacIcp];

fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-limit..limit).prop_map(DVec3::from_array)
}

fn params(method: RegisterMethod) -> RegisterParams {
    let mut params = RegisterParams { method, ..Default::default() };
    params.ransac_icp.hypotheses = 200;
    params
}

fn angle_between(a: DQuat, b: DQuat) -> f64 {
    so3::log(a * b.conjugate()).length()
}

// Row 6: patches without meaning.

#[test]
fn row_06_too_few_and_bad_points_are_refused() {
    let template = Shape::Sphere { radius_mm: 5.0 }.template(0.5);
    let top = DVec3::new(0.0, 0.0, 5.0);
    for method in METHODS {
        let mut registrar = Registrar::new(&params(method));
        let mut run = |points: &[DVec3], guess: &Pose| registrar.run(points, &template, guess).map(|_| ());
        let too_few = |found| Err(RegisterError::TooFewPoints { found, min_points: 3 });
        assert_eq!(run(&[], &Pose::IDENTITY), too_few(0));
        assert_eq!(run(&[top], &Pose::IDENTITY), too_few(1));
        let bad = [top, top, DVec3::new(f64::NAN, 0.0, 0.0)];
        assert_eq!(run(&bad, &Pose::IDENTITY), Err(RegisterError::PointNotFinite { index: 2 }));
        let nowhere = Pose::from_translation_mm(DVec3::X * f64::INFINITY);
        assert_eq!(run(&[top; 3], &nowhere), Err(RegisterError::BadGuess));
        let zero = Pose { rotation: DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), translation_mm: DVec3::ZERO };
        assert_eq!(run(&[top; 3], &zero), Err(RegisterError::BadGuess));
        let far = Pose::from_translation_mm(DVec3::Z * -20.0);
        match run(&[top; 3], &far) {
            Err(RegisterError::OutOfReach { within: 0, nearest_mm, .. }) => {
                assert!((nearest_mm - 20.0).abs() < 0.5);
            }
            other => panic!("{other:?}"),
        }
        let mut absurd = params(method);
        absurd.filterreg.min_sigma_mm = f64::NAN;
        let answer = Registrar::new(&absurd).run(&[top; 3], &template, &Pose::IDENTITY);
        assert!(matches!(answer, Err(RegisterError::Params(_))));
    }
}

#[test]
fn row_06_identical_points_get_an_answer_that_says_how_little_it_knows() {
    let template = Shape::Sphere { radius_mm: 5.0 }.template(0.5);
    for method in METHODS {
        let mut registrar = Registrar::new(&params(method));
        let found = registrar.run(&[DVec3::new(0.0, 0.3, 5.1); 4], &template, &Pose::IDENTITY).unwrap();
        // One point on one plane: its height alone.
        assert_eq!(found.free.len(), 5, "{method:?}");
        assert!(found.t_sensor_object.translation_mm.length() < 1.0);
        assert!(found.covariance().iter().flatten().all(|x| x.is_finite()));
    }
}

// Row 9: offsets and units.

#[test]
fn row_09_the_answer_moves_with_the_offset() {
    let shape = Shape::Cuboid { half_mm: DVec3::new(3.0, 4.0, 5.0) };
    let template = shape.template(0.3);
    let mut random = Stream::new(5, "offset");
    let turn = Pose::exp(DVec3::new(0.6, 0.6, 0.3), DVec3::ZERO);
    let contact = Contact::press(&shape, turn, 2.2, 0.03, &mut random);
    let guess = contact.guess(0.02, 0.3, &mut random);
    let mut registrar = Registrar::new(&params(RegisterMethod::FilterregPoint));
    let here = registrar.run(&contact.points_mm, &template, &guess).unwrap();
    for offset_mm in [1e3, 1e6, 1e9] {
        let shift = Pose::from_translation_mm(DVec3::new(offset_mm, -offset_mm, 0.5 * offset_mm));
        let moved: Vec<DVec3> = contact.points_mm.iter().map(|&p| shift.transform_point(p)).collect();
        let there = registrar.run(&moved, &template, &(shift * guess)).unwrap();
        // Adding the offset rounds every coordinate, and every translation of the iterations, by eps/2 of it.
        // The fit averages such errors and its weakest direction amplifies them by its condition, here below
        // 10; here as there coordinates of 30 mm are rounded through a hundred iterations that contract.
        let bound = 10.0 * EPS * offset_mm + 1e3 * EPS * 30.0;
        let back = shift.inverse() * there.t_sensor_object;
        for &p in &contact.points_mm {
            let q = here.t_sensor_object.inverse().transform_point(p);
            let error = back.transform_point(q).distance(p);
            assert!(error <= bound, "offset {offset_mm:e}: {error:e} > {bound:e}");
        }
    }
}

#[test]
fn row_09_the_same_problem_in_metres() {
    let shape = Shape::Cylinder { a_mm: 4.0, b_mm: 4.0, half_length_mm: 10.0 };
    let template = shape.template(0.4);
    let mut random = Stream::new(6, "metres");
    let contact = Contact::press(&shape, Pose::exp(DVec3::Y * 1.5, DVec3::ZERO), 1.0, 0.03, &mut random);
    let guess = contact.guess(0.03, 0.3, &mut random);
    // A power of two scales every product without rounding, so that the answer has to agree to the last
    // iterations; a thousandth is the metre itself, and a thousand the micrometre.
    for scale in [1.0 / 1024.0, 1e-3, 1024.0, 1e3] {
        let scaled = |v: &[DVec3]| v.iter().map(|&p| p * scale).collect::<Vec<_>>();
        let small =
            Template::new(&scaled(template.points_mm()), template.normals(), template.spacing_mm() * scale)
                .unwrap();
        for method in METHODS {
            let mm = params(method);
            let mut m = mm.clone();
            m.point_sigma_mm *= scale;
            m.filterreg.max_sigma_mm *= scale;
            m.filterreg.min_sigma_mm *= scale;
            m.advanced.max_distance_mm *= scale;
            m.advanced.search_radius_mm *= scale;
            let small_guess = Pose { translation_mm: guess.translation_mm * scale, ..guess };
            let a = Registrar::new(&mm).run(&contact.points_mm, &template, &guess).unwrap();
            let b = Registrar::new(&m).run(&scaled(&contact.points_mm), &small, &small_guess).unwrap();
            let distance =
                (b.t_sensor_object.translation_mm / scale).distance(a.t_sensor_object.translation_mm);
            let angle = angle_between(b.t_sensor_object.rotation, a.t_sensor_object.rotation);
            // Round-off of coordinates of 30 mm, through a hundred iterations that contract.
            let bound = 1e3 * EPS * 30.0;
            assert!(distance <= bound && angle <= bound, "{method:?} {scale}: {distance:e} mm {angle:e} rad");
            assert_eq!((a.iterations, a.inliers), (b.iterations, b.inliers));
            // As they are named, but for the places of axes.
            let named = |found: &Registration| -> Vec<String> {
                let said = found.free.iter().map(ToString::to_string);
                said.map(|said| said.split(" through").next().unwrap_or_default().to_owned()).collect()
            };
            assert_eq!(named(&a), named(&b), "{method:?} {scale}");
        }
    }
}

// Row 10: what a contact leaves free.

#[test]
fn row_10_free_directions_are_named_in_the_objects_own_axes() {
    let plate = Shape::Cuboid { half_mm: DVec3::new(20.0, 20.0, 3.0) };
    let cases = [
        (plate, DVec3::new(0.0, 0.0, 0.2), vec!["slide along x", "slide along y", "spin about z"]),
        (Shape::Sphere { radius_mm: 5.0 }, DVec3::X, ["x", "y", "z"].map(|_| "spin about ").to_vec()),
    ];
    for (shape, turn, expected) in cases {
        let mut random = Stream::new(2, "free");
        // Points without noise, for the closed form.
        let contact = Contact::press(&shape, Pose::exp(turn, DVec3::ZERO), 0.9, 0.0, &mut random);
        let mut registrar = Registrar::new(&params(RegisterMethod::FilterregPoint));
        let found =
            registrar.run(&contact.points_mm, &shape.template(0.3), &contact.t_sensor_object).unwrap();
        let said: Vec<String> = found.free.iter().map(ToString::to_string).collect();
        assert_eq!(said.len(), expected.len(), "{said:?}");
        assert!(said.iter().zip(&expected).all(|(s, e)| s.starts_with(e)), "{said:?}");
        // The axes of a sphere pass through the origin. Normals read off samples 0.3 mm apart are as if
        // points were 0.15 mm off, their mean 0.15 / √n, and from a patch of radius ρ this is projected to a
        // centre R away: three times that.
        let n = contact.points_mm.len() as f64;
        let bound = 3.0 * 0.15 / n.sqrt() * 5.0 / found.observability.radius_mm;
        for direction in found.free.iter().filter(|_| !matches!(shape, Shape::Cuboid { .. })) {
            if let Motion::Screw { through_mm, pitch_mm_per_rad, .. } = direction.motion() {
                assert!(through_mm.length() < bound && pitch_mm_per_rad.abs() < bound, "{direction}");
            }
        }
    }
}

/// Of a plane askew in the object's frame the first slide is along the coordinate axis that lies in it.
#[test]
fn row_10_slides_lie_as_near_to_the_objects_axes_as_they_can() {
    let plate = Shape::Cuboid { half_mm: DVec3::new(20.0, 20.0, 3.0) };
    let straight = plate.template(0.3);
    let contact = Contact::press(&plate, Pose::IDENTITY, 0.9, 0.0, &mut Stream::new(22, "askew"));
    // (axis of the turn, its cosine): 3-4-5 triangles, so that the names are exact.
    let cases = [
        (DVec3::Y, 0.8, ["slide along y", "slide along (0.80, 0.00, -0.60)"]),
        (DVec3::Y, 0.6, ["slide along y", "slide along (-0.60, 0.00, 0.80)"]),
        (DVec3::X, 0.8, ["slide along x", "slide along (0.00, 0.80, 0.60)"]),
    ];
    for (axis, cosine, expected) in cases {
        let turn = Pose::exp(axis * f64::acos(cosine), DVec3::ZERO);
        let askew = |v: &[DVec3]| v.iter().map(|&p| turn.transform_vector(p)).collect::<Vec<_>>();
        let template = Template::new(&askew(straight.points_mm()), &askew(straight.normals()), 0.3).unwrap();
        let guess = contact.t_sensor_object * turn.inverse();
        let found = Registrar::new(&params(RegisterMethod::FilterregPoint))
            .run(&contact.points_mm, &template, &guess)
            .unwrap();
        let said: Vec<String> = found.free.iter().map(ToString::to_string).collect();
        assert_eq!(&said[..2], expected, "{said:?}");
    }
}

#[test]
fn row_10_covariance_is_finite_and_inverts_the_information_where_it_can() {
    let mut random = Stream::new(3, "covariance");
    for (shape, turn) in [
        (Shape::Cylinder { a_mm: 4.0, b_mm: 4.0, half_length_mm: 12.0 }, DVec3::Y * 1.5),
        (Shape::Cuboid { half_mm: DVec3::new(3.0, 4.0, 5.0) }, DVec3::new(0.05, 0.8, 0.3)),
        (Shape::Sphere { radius_mm: 5.0 }, DVec3::ZERO),
    ] {
        let contact = Contact::press(&shape, Pose::exp(turn, DVec3::ZERO), 1.5, 0.03, &mut random);
        let mut registrar = Registrar::new(&params(RegisterMethod::FilterregPoint));
        let found =
            registrar.run(&contact.points_mm, &shape.template(0.3), &contact.t_sensor_object).unwrap();
        let (information, covariance) = (found.information, found.determined_covariance());
        let product = |a: &[[f64; 6]; 6], b: &[[f64; 6]; 6]| -> [[f64; 6]; 6] {
            std::array::from_fn(|i| std::array::from_fn(|j| (0..6).map(|k| a[i][k] * b[k][j]).sum()))
        };
        // I C I = I: C is an inverse over the determined directions. Rotations are about the camera, 30 mm
        // away, so the entries span 30² per side: a condition of about 30⁴.
        let again = product(&product(&information, &covariance), &information);
        let largest = information.iter().flatten().fold(0.0_f64, |m, x| m.max(x.abs()));
        for i in 0..6 {
            for j in 0..6 {
                assert!((again[i][j] - information[i][j]).abs() <= EPS * 30.0_f64.powi(4) * largest);
                assert!(covariance[i][j].is_finite() && covariance[i][j] == covariance[j][i]);
            }
        }
    }
}

#[test]
fn row_10_ransac_leaves_free_directions_at_the_guess() {
    let shape = Shape::Cylinder { a_mm: 4.0, b_mm: 4.0, half_length_mm: 12.0 };
    let template = shape.template(0.3);
    let mut random = Stream::new(12, "ransac");
    for seed in 0..10 {
        let contact = Contact::press(&shape, Pose::exp(DVec3::Y * 1.5, DVec3::ZERO), 1.0, 0.03, &mut random);
        let guess = contact.guess(0.05, 0.5, &mut random);
        let mut settings = params(RegisterMethod::RansacIcp);
        settings.ransac_icp.seed = seed;
        let found = Registrar::new(&settings).run(&contact.points_mm, &template, &guess).unwrap();
        // Along and about the cylinder's axis, z of the object.
        let (omega, v_mm) = (found.t_sensor_object.inverse() * guess).log();
        // The guess is 0.5 mm and 0.05 rad off. Undone by the least motion of the patch, its axis's shift
        // turns it by up to 0.5 mm over the radius, and its tilt slides it by up to 0.05 of the radius; ICP
        // draws it on by a spacing at most.
        let bound = (0.5 / 4.0 + 0.05, 0.05 * 4.0 + 0.3);
        assert!(omega.z.abs() < bound.0 && v_mm.z.abs() < bound.1, "{seed}: {} rad {} mm", omega.z, v_mm.z);
    }
}

#[test]
fn row_10_point_to_point_converges_though_it_creeps_along_free_directions() {
    let plate = Shape::Cuboid { half_mm: DVec3::new(15.0, 15.0, 3.0) };
    for (shape, turn) in [(Shape::Sphere { radius_mm: 5.0 }, DVec3::X), (plate, DVec3::new(0.05, 0.03, 0.3))]
    {
        let template = shape.template(0.3);
        let mut random = Stream::new(11, "creep");
        for _ in 0..5 {
            let contact = Contact::press(&shape, Pose::exp(turn, DVec3::ZERO), 1.1, 0.03, &mut random);
            let guess = contact.guess(0.08, 1.0, &mut random);
            let settings = params(RegisterMethod::FilterregPoint);
            let found = Registrar::new(&settings).run(&contact.points_mm, &template, &guess).unwrap();
            // A millimetre off at first, and every step closes at least half of what is left: 2^-12 mm is the
            // tolerance. Sampling lets some steps close less.
            assert!(found.converged && found.iterations < 30, "{} iterations", found.iterations);
        }
    }
}

// Row 12: duplicates.

#[test]
fn row_12_a_template_of_duplicates_registers() {
    let sphere = Shape::Sphere { radius_mm: 5.0 };
    let once = sphere.template(0.5);
    let twice: Vec<DVec3> = once.points_mm().iter().flat_map(|&p| [p; 40]).collect();
    let normals: Vec<DVec3> = once.normals().iter().flat_map(|&n| [n; 40]).collect();
    let template = Template::new(&twice, &normals, 0.5).unwrap();
    let mut random = Stream::new(9, "duplicates");
    let contact = Contact::press(&sphere, Pose::IDENTITY, 1.0, 0.0, &mut random);
    for method in METHODS {
        let found = Registrar::new(&params(method))
            .run(&contact.points_mm, &template, &contact.t_sensor_object)
            .unwrap();
        assert_eq!(found.inliers, found.points);
    }
}

// Row 34: same input, same bits.

#[test]
fn row_34_two_runs_have_the_same_bits_whatever_ran_between() {
    let shape = Shape::Cuboid { half_mm: DVec3::new(3.0, 4.0, 5.0) };
    let template = shape.template(0.4);
    let mut random = Stream::new(10, "bits");
    let press = |turn: DVec3, random: &mut Stream| {
        Contact::press(&shape, Pose::exp(turn, DVec3::ZERO), 1.5, 0.03, random)
    };
    let a = press(DVec3::new(0.05, 0.8, 0.3), &mut random);
    let b = press(DVec3::new(0.03, 0.05, 0.3), &mut random);
    for method in METHODS {
        let mut registrar = Registrar::new(&params(method));
        let mut digest =
            |c: &Contact| registrar.run(&c.points_mm, &template, &c.t_sensor_object).unwrap().digest();
        let (first, other, again) = (digest(&a), digest(&b), digest(&a));
        assert_eq!(first, again);
        assert_ne!(first, other);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_patch_gets_a_finite_answer_or_an_error(
        points in prop::collection::vec(
            prop::array::uniform3(prop_oneof![-6.0..6.0_f64, any::<f64>(), Just(4.0)]), 0..30,
        ),
        omega in vector(3.0), v in vector(8.0), method in 0..METHODS.len(),
    ) {
        let points: Vec<DVec3> = points.into_iter().map(DVec3::from_array).collect();
        let template = Shape::Cuboid { half_mm: DVec3::new(3.0, 4.0, 5.0) }.template(0.8);
        if let Ok(found) =
            Registrar::new(&params(METHODS[method])).run(&points, &template, &Pose::exp(omega, v))
        {
            prop_assert!(poses::is_finite(&found));
            prop_assert!(found.rmse_mm.is_finite() && found.inliers >= 3);
        }
    }
}
