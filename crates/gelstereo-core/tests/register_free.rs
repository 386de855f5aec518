//! What a contact leaves free stays where it was guessed, for a search that starts all around the guess, too
//! (row 10). Simulated contacts, noise 0.03 mm along z.
// A test may stop at what it did not expect.
#![allow(clippy::unwrap_used)]

use crate::problems;
use crate::solids;

use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{RegisterMethod, RegisterParams, SurfaceSearchParams};
use gelstereo_core::register::{Registrar, Registration, Template};
use gelstereo_core::surface::TriangleMesh;
use problems::gel::Gel;
use problems::parts::{Part, parts};
use problems::{Problem, REST_MM, Sensing};

fn template(part: &Part) -> Template {
    Template::from_mesh(&part.mesh, 0.4, 1).unwrap()
}

/// Facets of 3 degrees and less.
fn ball_of(radius_mm: f64) -> Part {
    let (vertices, triangles) = solids::star(32, |_, _| radius_mm);
    Part::new("ball", false, TriangleMesh::new(vertices, triangles).unwrap(), |p, _| p.normalize())
}

/// A cylinder that lies along x from there.
fn lying(from_mm: f64) -> Pose {
    let turn = Pose::exp(DVec3::Y * std::f64::consts::FRAC_PI_2, DVec3::ZERO);
    Pose { translation_mm: DVec3::new(from_mm, 0.0, REST_MM + 4.0 - 1.0), ..turn }
}

fn search(problem: &Problem, template: &Template, guess: &Pose) -> Registration {
    let params = RegisterParams { method: RegisterMethod::SurfaceSearch, ..RegisterParams::default() };
    Registrar::new(&params).register(&problem.contact(), template, guess).unwrap()
}

/// How far the pose is from another along what is free, mm over the patch.
fn along_free_mm(found: &Registration, other: &Pose) -> f64 {
    let seen = &found.observability;
    let motion = found.t_sensor_object * other.inverse();
    let (omega, _) = motion.log();
    let v = motion.transform_point(seen.centre_mm) - seen.centre_mm;
    let z = [(omega * seen.radius_mm).to_array(), v.to_array()].concat();
    let free = seen.directions.iter().zip(seen.values).filter(|(_, value)| *value == 0.0);
    free.map(|(u, _)| u.iter().zip(&z).map(|(u, z)| u * z).sum::<f64>().powi(2)).sum::<f64>().sqrt()
}

#[test]
fn row_10_a_search_leaves_what_is_free_at_its_guess() {
    let cylinder = parts().remove(0);
    let ball = ball_of(5.0);
    let above = Pose::from_translation_mm(DVec3::new(0.0, 0.0, REST_MM + 5.0 - 1.0));
    // From border to border, so that no end is felt.
    for (part, pose, free) in [(&cylinder, lying(-15.0), 2), (&ball, above, 3)] {
        let template = template(part);
        let gel = Gel::press(part, &pose);
        let mut random = Stream::new(31, part.name);
        for _ in 0..6 {
            let problem = Problem::sense(&gel, pose, Sensing::GOOD, &mut random);
            let guess = problem.guess(0.15, 1.0, &mut random);
            let found = search(&problem, &template, &guess);
            assert_eq!(found.free.len(), free, "{}: {:?}", part.name, found.free);
            assert!(problem.score(&found.t_sensor_object).is_success(), "{}", part.name);
            let along_mm = along_free_mm(&found, &guess);
            // What is free is asked again there, and of other readings.
            assert!(along_mm < 1e-4, "{}: {along_mm} mm along what is free", part.name);
        }
    }
}

/// Where the guess would take the part's end into the contact, the markers say no: its slide is not free that
/// far.
#[test]
fn row_10_what_is_free_here_is_not_taken_to_where_it_is_not() {
    let part = parts().remove(0);
    let template = template(&part);
    let pose = lying(-12.0);
    let mut random = Stream::new(32, "end");
    let problem = Problem::sense(&Gel::press(&part, &pose), pose, Sensing::GOOD, &mut random);
    let guess = lying(-6.5);
    let found = search(&problem, &template, &guess);
    // Two columns of markers, at -10.8 and -9.9 mm, are pressed: the end is beyond them, but for the part of
    // a pitch that hides in the gel's own shoulder.
    let end_mm = found.t_sensor_object.translation_mm.x;
    assert!(end_mm < -9.0, "{end_mm}, free: {:?}", found.free);
    assert!(found.log_odds.unwrap() > 0.0);
}

/// Rounding does not choose among the axes of a ball, so that the first one is the same in every frame.
#[test]
fn row_10_spins_of_a_ball_are_named_in_the_order_of_the_axes() {
    let ball = ball_of(5.0);
    let template = template(&ball);
    let pose = Pose::from_translation_mm(DVec3::new(0.3, -0.2, REST_MM + 5.0 - 1.0));
    let gel = Gel::press(&ball, &pose);
    let mut random = Stream::new(33, "order");
    for _ in 0..10 {
        let problem = Problem::sense(&gel, pose, Sensing::GOOD, &mut random);
        let found = search(&problem, &template, &pose);
        let said: Vec<String> = found.free.iter().map(ToString::to_string).collect();
        let expected = ["x", "y", "z"].map(|axis| format!("spin about {axis}"));
        assert!(said.iter().zip(&expected).all(|(said, e)| said.starts_with(e)), "{said:?}");
    }
}

/// What was registered before leaves no trace, wherever a budget stops the search.
#[test]
fn an_answer_does_not_depend_on_the_contact_before() {
    let [cylinder, ball] = [parts().remove(0), ball_of(5.0)];
    let above = Pose::from_translation_mm(DVec3::new(0.0, 0.0, REST_MM + 5.0 - 1.0));
    let mut random = Stream::new(34, "before");
    let mut sensed = |part: &Part, pose: Pose| {
        let problem = Problem::sense(&Gel::press(part, &pose), pose, Sensing::GOOD, &mut random);
        let guess = problem.guess(0.1, 0.5, &mut random);
        (problem, template(part), guess)
    };
    let (first, second) = (sensed(&cylinder, lying(-15.0)), sensed(&ball, above));
    for budget in (1..100).map(|k| 1500 * k) {
        let params = RegisterParams {
            method: RegisterMethod::SurfaceSearch,
            surface_search: SurfaceSearchParams { budget, ..Default::default() },
            ..Default::default()
        };
        let answer = |registrar: &mut Registrar, (problem, template, guess): &(Problem, Template, Pose)| {
            registrar.register(&problem.contact(), template, guess).unwrap()
        };
        let alone = answer(&mut Registrar::new(&params), &second);
        let mut registrar = Registrar::new(&params);
        answer(&mut registrar, &first);
        assert_eq!(answer(&mut registrar, &second), alone, "budget {budget}");
    }
}
