//! The rungs on the part's surface: how often and how exactly they find simulated contacts, and where they
//! are hardest.
//!
//! Rates over more contacts: `cargo run --release --features serde --example starts`.
// A test may stop at what it did not expect, and print its table.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use crate::problems;

use crate::support::poses;
use gelstereo_core::math::linalg::{Symmetric, eigen};
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DMat3, DQuat, DVec3, Pose, so3};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Contact, RegisterError, Registrar, Registration, Template};
use problems::gel::Gel;
use problems::parts::{Part, parts};
use problems::{CLASSES, Problem, Sensing, Tally};
use proptest::prelude::*;
use std::sync::OnceLock;

const RUNGS: [RegisterMethod; 2] = [RegisterMethod::SurfaceClose, RegisterMethod::SurfaceSearch];

fn params(method: RegisterMethod) -> RegisterParams {
    RegisterParams { method, ..Default::default() }
}

/// The parts and their templates, made once.
fn stock() -> &'static [(Part, Template)] {
    static STOCK: OnceLock<Vec<(Part, Template)>> = OnceLock::new();
    STOCK.get_or_init(|| {
        let with = |part: Part| {
            let template = Template::from_mesh(&part.mesh, 0.4, 1).unwrap();
            let template = template.with_field(Template::DEFAULT_CELL_MM, Template::DEFAULT_REACH_MM);
            (part, template)
        };
        parts().into_iter().map(with).collect()
    })
}

fn some(name: &str) -> &'static (Part, Template) {
    stock().iter().find(|(part, _)| part.name == name).unwrap()
}

fn register(method: RegisterMethod, problem: &Problem, template: &Template, guess: &Pose) -> Registration {
    Registrar::new(&params(method)).register(&problem.contact(), template, guess).unwrap()
}

#[test]
fn search_finds_contacts_from_near_and_far() {
    // Four binomial standard deviations of 48 runs, 7 and 11 %, below the 98 and 96 % that 120 runs of others
    // give.
    for (class, floor) in [(&CLASSES[1], 0.9), (&CLASSES[3], 0.85)] {
        let mut all = Tally::default();
        for (part, template) in stock() {
            let mut registrar = Registrar::new(&class.params(&params(RegisterMethod::SurfaceSearch)));
            let mut random = Stream::new(11, part.name);
            for _ in 0..8 {
                let problem = Problem::press(part, class.sensing, &mut random);
                let guess = problem.guess_within(class, &mut random);
                let found = registrar.register(&problem.contact(), template, &guess).ok();
                all.count(found.map(|found| problem.score(&found.t_sensor_object)), 0.0);
            }
        }
        println!("{} {all}", class.name);
        assert!(all.share() >= floor && all.median() < 1.5, "{} {all}", class.name);
    }
}

#[test]
fn one_start_finds_a_close_contact_to_the_bound() {
    let mut all = Tally::default();
    for (part, template) in &stock()[..2] {
        let mut random = Stream::new(12, part.name);
        for _ in 0..12 {
            let problem = Problem::press(part, Sensing::GOOD, &mut random);
            let guess = problem.guess(0.02, 0.2, &mut random);
            let found = register(RegisterMethod::SurfaceClose, &problem, template, &guess);
            all.count(Some(problem.score(&found.t_sensor_object)), 0.0);
        }
    }
    println!("{all}");
    assert!(all.share() > 0.9 && all.median() < 1.3, "{all}");
}

#[test]
fn markers_that_nothing_presses_tell_where_a_thread_ends() {
    let (part, template) = some("bolt M10");
    let mut random = Stream::new(13, "thread");
    let (mut with, mut without) = (0, 0);
    for _ in 0..6 {
        let problem = Problem::press(part, Sensing::GOOD, &mut random);
        // One pitch along the thread.
        let slide = problem.t_sensor_object.transform_vector(DVec3::Z * 1.5);
        let guess = Pose::from_translation_mm(slide) * problem.t_sensor_object;
        let found = register(RegisterMethod::SurfaceSearch, &problem, template, &guess);
        with += usize::from(problem.score(&found.t_sensor_object).is_success());
        let blind = Contact { unpressed_mm: &[], ..problem.contact() };
        let found = Registrar::new(&params(RegisterMethod::SurfaceSearch));
        let found = { found }.register(&blind, template, &guess).unwrap();
        without += usize::from(problem.score(&found.t_sensor_object).is_success());
    }
    println!("with {with}, without {without} of 6");
    assert!(with >= 4 && with > without, "with {with}, without {without}");
}

#[test]
fn what_is_claimed_of_the_error_holds() {
    // Normalised error squared over the determined directions: its mean over N runs of d directions is 1
    // within 4 sqrt(2 / N d) for exact covariances. The shoulder is modelled, not known: a quarter as much
    // again is allowed. On a part with edges a row of shoulder beside one may pass for the face beyond it,
    // and no covariance knows of that.
    let (part, template) = &stock()[0];
    for sensing in [Sensing::GOOD, Sensing::NOISY] {
        let (mut squared, mut directions) = (0.0, 0);
        let mut random = Stream::new(14, part.name);
        for _ in 0..80 {
            let problem = Problem::press(part, sensing, &mut random);
            let guess = problem.guess(0.01, 0.1, &mut random);
            let found = register(RegisterMethod::SurfaceClose, &problem, template, &guess);
            if !problem.score(&found.t_sensor_object).is_success() {
                continue;
            }
            let seen = &found.observability;
            let error = problem.error(&found.t_sensor_object);
            for (value, u) in seen.values.iter().zip(&seen.directions) {
                // A direction known no better than the guess says is the guess's.
                if value.recip() < 0.05 * 0.05 {
                    let along: f64 = u.iter().zip(error).map(|(a, b)| a * b).sum();
                    squared += value * along * along;
                    directions += 1;
                }
            }
        }
        let nees = squared / f64::from(directions);
        let band = 4.0 * (2.0 / f64::from(directions)).sqrt();
        println!("{sensing:?}: normalised error squared {nees:.2} over {directions} directions");
        assert!(nees > 1.0 - band && nees < 1.25 + band, "{sensing:?}: {nees}");
    }
}

#[test]
fn noise_that_is_larger_than_said_shows_in_the_covariance() {
    let (part, template) = &stock()[0];
    let mut random = Stream::new(16, part.name);
    let (mut ratio, mut count) = (0.0, 0);
    for _ in 0..20 {
        let mut problem = Problem::press(part, Sensing::GOOD, &mut random);
        let guess = problem.guess(0.01, 0.1, &mut random);
        let strongest = |problem: &Problem| {
            let found = register(RegisterMethod::SurfaceClose, problem, template, &guess);
            found.observability.values.into_iter().fold(0.0, f64::max)
        };
        let right = strongest(&problem);
        // Half the standard deviation would tell four times as much.
        problem.covariance_mm2.iter_mut().flatten().flatten().for_each(|x| *x *= 0.25);
        ratio += strongest(&problem) / right;
        count += 1;
    }
    let mean = ratio / f64::from(count);
    println!("tells {mean:.2} times as much");
    assert!(mean < 2.0, "{mean}");
}

#[test]
fn a_spent_budget_leaves_a_valid_answer() {
    let (part, template) = some("square peg");
    let mut random = Stream::new(15, "budget");
    let problem = Problem::press(part, Sensing::GOOD, &mut random);
    let guess = problem.guess(0.1, 0.5, &mut random);
    let mut last = f64::NEG_INFINITY;
    for budget in [1, 1000, 10_000, 30_000, 100_000, 1_000_000] {
        let mut settings = params(RegisterMethod::SurfaceSearch);
        settings.surface_search.budget = budget;
        let found = Registrar::new(&settings).register(&problem.contact(), template, &guess).unwrap();
        assert!(
            found.t_sensor_object.rotation.is_finite() && found.t_sensor_object.translation_mm.is_finite()
        );
        assert!(found.covariance().iter().flatten().all(|x| x.is_finite()));
        // Nothing is said to be all when there was no time to look.
        assert!(found.alternatives.is_cut() || budget > 30_000, "{budget}");
        last = found.log_likelihood.unwrap();
    }
    let all = register(RegisterMethod::SurfaceSearch, &problem, template, &guess);
    assert_eq!(all.log_likelihood, Some(last));
}

/// Whatever the budget, the answer is the same again and its covariance inverts its information; one start
/// that takes no step has not converged.
#[test]
fn a_budget_stops_every_rung_and_what_it_returns_is_what_it_says() {
    let mut random = Stream::new(24, "budgets");
    for name in ["square peg", "key"] {
        let (part, template) = some(name);
        let problem = Problem::press(part, Sensing::GOOD, &mut random);
        let guess = problem.guess(0.05, 0.5, &mut random);
        for method in RUNGS {
            for budget in [1, 3_000, 30_000] {
                let mut settings = params(method);
                settings.surface_search.budget = budget;
                let found = Registrar::new(&settings).register(&problem.contact(), template, &guess).unwrap();
                if budget == 1 && method != RegisterMethod::SurfaceSearch {
                    assert!(!found.converged, "{name} {method:?}");
                }
                // Covariance and information are each other's inverse over what is determined, at any pose.
                let (information, covariance) = (found.information, found.determined_covariance());
                let trace: f64 = (0..6).map(|k| product(&information, &covariance)[k][k]).sum();
                let determined = 6 - found.free.len();
                assert!((trace - determined as f64).abs() < 1e-6, "{name} {method:?} {budget}: {trace}");
                assert!(eigen(&covariance).values[0] >= -16.0 * f64::EPSILON * eigen(&covariance).values[5]);
                let again = Registrar::new(&settings).register(&problem.contact(), template, &guess).unwrap();
                assert_eq!(again.digest(), found.digest());
            }
        }
    }
}

fn product(a: &Symmetric<6>, b: &Symmetric<6>) -> Symmetric<6> {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..6).map(|k| a[i][k] * b[k][j]).sum()))
}

#[test]
fn alternatives_are_about_as_likely_and_elsewhere() {
    let (part, template) = some("bolt M10");
    let mut random = Stream::new(16, "alternatives");
    let mut count = 0;
    for _ in 0..10 {
        let problem = Problem::press(part, Sensing::GOOD, &mut random);
        let guess = problem.guess(0.1, 1.0, &mut random);
        let blind = Contact { unpressed_mm: &[], ..problem.contact() };
        let settings = params(RegisterMethod::SurfaceSearch);
        let found = Registrar::new(&settings).register(&blind, template, &guess).unwrap();
        let best = found.log_likelihood.unwrap();
        assert!(found.alternatives.is_sorted_by(|a, b| a.log_likelihood >= b.log_likelihood));
        let centre_mm = problem.points_mm.iter().sum::<DVec3>() / problem.points_mm.len() as f64;
        for other in found.alternatives.iter() {
            count += 1;
            assert!(other.log_likelihood <= best && other.log_likelihood >= best - 4.7);
            // A turn about the centroid and its shift; the information is about the origin, and linear.
            let apart = other.t_sensor_object * found.t_sensor_object.inverse();
            let turn = apart.log().0;
            let shift = apart.transform_point(centre_mm) - centre_mm - turn.cross(centre_mm);
            let z = [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z];
            let squared: f64 = (0..6)
                .flat_map(|i| (0..6).map(move |j| (i, j)))
                .map(|(i, j)| z[i] * found.information[i][j] * z[j])
                .sum();
            // Five standard deviations, to rounding.
            assert!(squared > 24.99, "{squared}");
        }
    }
    // Half of a thread's contacts have another pitch that is as likely (tests/test_localize_thread.py).
    assert!(count >= 2, "{count} alternatives of 10 contacts");
}

// Row 6.

#[test]
fn row_06_contacts_without_meaning_are_refused_by_the_surface_rungs() {
    let (part, template) = some("square peg");
    let problem = Problem::press(part, Sensing::GOOD, &mut Stream::new(17, "bad"));
    let points = Template::new(template.points_mm(), template.normals(), 0.4).unwrap();
    for method in RUNGS {
        let run = |contact: &Contact<'_>, template: &Template, guess: &Pose| {
            Registrar::new(&params(method)).register(contact, template, guess).map(|_| ())
        };
        let (good, truth) = (problem.contact(), problem.t_sensor_object);
        assert_eq!(run(&good, &points, &truth), Err(RegisterError::NoSurface));
        for found in 0..3 {
            let covariance_mm2 = Some(&problem.covariance_mm2[..found]);
            let few = Contact { points_mm: &problem.points_mm[..found], covariance_mm2, ..good };
            assert_eq!(
                run(&few, template, &truth),
                Err(RegisterError::TooFewPoints { found, min_points: 3 })
            );
        }
        let uneven = Contact { covariance_mm2: Some(&problem.covariance_mm2[1..]), ..good };
        assert!(matches!(run(&uneven, template, &truth), Err(RegisterError::Covariances { .. })));
        for bad in [f64::NAN, -1e-3, 0.0] {
            let mut covariances = problem.covariance_mm2.clone();
            covariances[3] = [[bad, 0.0, 0.0], [0.0, bad, 0.0], [0.0, 0.0, bad]];
            let bad = Contact { covariance_mm2: Some(&covariances), ..good };
            assert_eq!(run(&bad, template, &truth), Err(RegisterError::BadCovariance { index: 3 }));
        }
        let lost = [DVec3::ZERO, DVec3::NAN];
        let lost = Contact { unpressed_mm: &lost, ..good };
        assert_eq!(run(&lost, template, &truth), Err(RegisterError::MarkerNotFinite { index: 1 }));
        let still = Contact { press_direction: DVec3::ZERO, ..good };
        assert_eq!(run(&still, template, &truth), Err(RegisterError::PressDirection));
        let far = Pose::from_translation_mm(DVec3::X * 100.0) * truth;
        assert!(matches!(run(&good, template, &far), Err(RegisterError::OutOfReach { within: 0, .. })));
    }
}

// Row 32.

/// Variance 4e-4 mm² and, along one of the axes or askew, (0, 1, 1), another one.
fn thin(way: usize, least: f64) -> Symmetric<3> {
    let (a, b) = (2e-4 + 0.5 * least, 0.5 * least - 2e-4);
    let mut c = [[4e-4, 0.0, 0.0], [0.0, 4e-4, 0.0], [0.0, 0.0, 4e-4]];
    match way {
        0..3 => c[way][way] = least,
        _ => (c[1], c[2]) = ([0.0, a, b], [0.0, b, a]),
    }
    c
}

/// Every second covariance has a direction without variance, or one below 0 by rounding: the answer is that
/// of covariances which have a millionth there, and finite where nothing else is wrong with the surface,
/// either. One that is negative beyond rounding is refused.
#[test]
fn row_32_singular_and_slightly_negative_covariances_are_taken_and_negative_ones_refused() {
    let (part, template) = some("square peg");
    let problem = Problem::press(part, Sensing::GOOD, &mut Stream::new(25, "singular"));
    let guess = problem.guess(0.02, 0.2, &mut Stream::new(26, "singular"));
    for method in RUNGS {
        let run = |covariances: &[Symmetric<3>], surface_sigma_mm: f64| {
            let contact = Contact { covariance_mm2: Some(covariances), ..problem.contact() };
            let mut params = params(method);
            params.advanced.surface_sigma_mm = surface_sigma_mm;
            Registrar::new(&params).register(&contact, template, &guess)
        };
        let mixed = |ways: [usize; 2], least: f64| {
            let mut covariances = problem.covariance_mm2.clone();
            for (k, c) in covariances.iter_mut().enumerate().filter(|(k, _)| k % 2 == 0) {
                *c = thin(ways[k / 2 % 2], least);
            }
            covariances
        };
        let near = run(&mixed([0, 3], 4e-10), 0.003).unwrap();
        for least in [0.0, -4e-17, -4e-14] {
            let found = run(&mixed([0, 3], least), 0.003).unwrap();
            let (omega, v_mm) = (found.t_sensor_object * near.t_sensor_object.inverse()).log();
            // To what steps end at, seen from 30 mm away.
            assert!(omega.length() * 30.0 + v_mm.length() < 0.03, "{method:?} {least:e}: {omega} {v_mm}");
            // Along the gel's own normal, on a surface without an error of its own.
            for found in [found, run(&mixed([2, 3], least), 1e-9).unwrap()] {
                let known =
                    found.information.iter().chain(&found.covariance()).flatten().all(|x| x.is_finite());
                assert!(known && found.log_likelihood.is_some_and(f64::is_finite), "{method:?} {least:e}");
            }
        }
        for way in 0..4 {
            let mut covariances = problem.covariance_mm2.clone();
            covariances[3] = thin(way, -4e-6);
            let refused = run(&covariances, 0.003).map(|_| ());
            assert_eq!(refused, Err(RegisterError::BadCovariance { index: 3 }), "{method:?} {way}");
        }
    }
}

// Row 9.

#[test]
fn row_09_surface_rungs_move_with_the_offset_and_the_turn() {
    let (part, template) = some("irregular peg");
    let mut random = Stream::new(18, "motion");
    let problem = Problem::press(part, Sensing::GOOD, &mut random);
    let guess = problem.guess(0.02, 0.2, &mut random);
    let turned = Pose { rotation: so3::exp(DVec3::new(0.3, -0.8, 2.0)), translation_mm: DVec3::ONE * 7.0 };
    let shift = |mm: f64| Pose::from_translation_mm(DVec3::new(mm, -mm, 0.5 * mm));
    for method in RUNGS {
        let here = register(method, &problem, template, &guess);
        for (motion, size_mm) in [(turned, 40.0), (shift(1e3), 1e3), (shift(1e6), 1e6), (shift(1e9), 1e9)] {
            // Starts lie around the guess along the sensor's axes.
            if method == RegisterMethod::SurfaceSearch && motion == turned {
                continue;
            }
            let there = moved(&problem, &motion);
            let contact =
                Contact { press_direction: motion.transform_vector(DVec3::NEG_Z), ..there.contact() };
            let found =
                Registrar::new(&params(method)).register(&contact, template, &(motion * guess)).unwrap();
            // Steps shorter than a hundredth of σ are not told apart; coordinates are rounded to eps of their
            // size.
            let bound_mm = 0.01 * 0.03 * 10.0 + 10.0 * f64::EPSILON * size_mm;
            let back = motion.inverse() * found.t_sensor_object;
            let worst = problem.points_mm.iter().map(|&p| {
                let x = here.t_sensor_object.inverse().transform_point(p);
                back.transform_point(x).distance(p)
            });
            let worst = worst.fold(0.0, f64::max);
            assert!(worst <= bound_mm, "{method:?} {size_mm:e}: {worst:e} > {bound_mm:e}");
        }
    }
}

/// All that was sensed, moved.
fn moved(problem: &Problem, motion: &Pose) -> Problem {
    let r = DMat3::from_quat(motion.rotation);
    let point = |p: &DVec3| motion.transform_point(*p);
    let covariance = |c: &Symmetric<3>| {
        let turned = r * DMat3::from_cols_array_2d(c) * r.transpose();
        turned.to_cols_array_2d()
    };
    Problem {
        points_mm: problem.points_mm.iter().map(point).collect(),
        covariance_mm2: problem.covariance_mm2.iter().map(covariance).collect(),
        unpressed_mm: problem.unpressed_mm.iter().map(point).collect(),
        ..problem.clone()
    }
}

#[test]
fn the_order_of_points_changes_the_answer_by_less_than_a_step() {
    let (part, template) = some("square peg");
    let mut random = Stream::new(19, "order");
    let problem = Problem::press(part, Sensing::GOOD, &mut random);
    let guess = problem.guess(0.02, 0.2, &mut random);
    let here = register(RegisterMethod::SurfaceClose, &problem, template, &guess);
    let mut other = problem.clone();
    other.points_mm.reverse();
    other.unpressed_mm.reverse();
    let there = register(RegisterMethod::SurfaceClose, &other, template, &guess);
    for &p in &problem.points_mm {
        let x = here.t_sensor_object.inverse().transform_point(p);
        assert!(there.t_sensor_object.transform_point(x).distance(p) < 0.003);
    }
}

// Row 10.

#[test]
fn row_10_surface_rungs_name_the_free_directions_of_facets_as_those_of_the_cylinder() {
    let (part, template) = some("cylinder peg");
    let turn = Pose::exp(DVec3::Y * std::f64::consts::FRAC_PI_2, DVec3::ZERO);
    // From border to border, so that no end is felt.
    let at = DVec3::new(-15.0, 0.0, problems::REST_MM + 4.0 - 1.0);
    let t_sensor_object = Pose { translation_mm: at, ..turn };
    let gel = Gel::press(part, &t_sensor_object);
    let mut random = Stream::new(20, "cylinder");
    let problem = Problem::sense(&gel, t_sensor_object, Sensing::GOOD, &mut random);
    for method in RUNGS {
        let found = register(method, &problem, template, &t_sensor_object);
        let said: Vec<String> = found.free.iter().map(ToString::to_string).collect();
        assert_eq!(said.len(), 2, "{method:?} {said:?}");
        assert!(said[0].starts_with("slide along z") && said[1].starts_with("spin about z"), "{said:?}");
        // And they stay where they were guessed; within half a facet distances change with the spin, too.
        let (omega, v) = (found.t_sensor_object.inverse() * t_sensor_object).log();
        assert!(
            omega.z.abs() < std::f64::consts::PI / 96.0 && v.z.abs() < 0.05,
            "{method:?}: {} rad, {} mm",
            omega.z,
            v.z
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_contact_gets_a_finite_answer_or_an_error(
        points in prop::collection::vec(
            prop::array::uniform3(prop_oneof![-6.0..6.0_f64, any::<f64>(), Just(4.0)]), 0..30,
        ),
        rest in prop::collection::vec(prop::array::uniform3(-9.0..9.0_f64), 0..30),
        omega in prop::array::uniform3(-3.0..3.0_f64), v in prop::array::uniform3(-8.0..8.0_f64),
        method in 0..2_usize,
    ) {
        let points: Vec<DVec3> = points.into_iter().map(DVec3::from_array).collect();
        let rest: Vec<DVec3> = rest.into_iter().map(DVec3::from_array).collect();
        let (_, template) = some("square peg");
        let guess = Pose::exp(DVec3::from_array(omega), DVec3::from_array(v));
        let contact = Contact { unpressed_mm: &rest, ..Contact::new(&points) };
        let mut settings = params(RUNGS[method]);
        settings.surface_search.starts = 16;
        if let Ok(found) = Registrar::new(&settings).register(&contact, template, &guess) {
            prop_assert!(poses::is_finite(&found));
            prop_assert!(found.rmse_mm.is_finite() && found.log_likelihood.is_some_and(f64::is_finite));
        }
    }
}

#[test]
fn identical_points_say_how_little_they_know() {
    let (_, template) = some("square peg");
    for method in RUNGS {
        let points = [DVec3::new(0.0, 4.05, 9.0); 4];
        let guess = Pose { rotation: DQuat::IDENTITY, translation_mm: DVec3::ZERO };
        let contact = Contact { press_direction: DVec3::Y, ..Contact::new(&points) };
        let found = Registrar::new(&params(method)).register(&contact, template, &guess).unwrap();
        assert_eq!(found.free.len(), 5, "{method:?}");
        assert!(found.t_sensor_object.translation_mm.length() < 1.0);
    }
}
