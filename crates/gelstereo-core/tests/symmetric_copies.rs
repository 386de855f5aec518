//! Poses that show a part alike are one answer.
// A test may stop at what it did not expect.
#![allow(clippy::unwrap_used)]

use crate::problems;

use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose, so3};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Registrar, Symmetry, Template};
use problems::gel::Gel;
use problems::parts::{Part, parts};
use problems::{Problem, REST_MM, Sensing};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

fn part(name: &str) -> (Part, Template) {
    let part = parts().into_iter().find(|part| part.name == name).unwrap();
    let template = Template::from_mesh(&part.mesh, 0.4, 1).unwrap();
    (part, template)
}

fn axis(direction: DVec3, order: Option<u32>) -> Symmetry {
    Symmetry::new(direction, DVec3::new(0.5, -0.25, 2.0), order).unwrap()
}

/// All that turns about these axes make, by putting two together until no new ones come.
fn group(symmetries: &[Symmetry]) -> Vec<Pose> {
    let mut all = vec![Pose::IDENTITY];
    let mut next = 0;
    while next < all.len() {
        for symmetry in symmetries {
            let made = all[next] * symmetry.turned(TAU / f64::from(symmetry.order.unwrap()));
            let is_known = |old: &Pose| old.rotation.dot(made.rotation).abs() > 1.0 - 1e-9;
            if !all.iter().any(is_known) {
                all.push(made);
            }
        }
        next += 1;
        assert!(all.len() <= 60);
    }
    all
}

fn angle(one: &Pose, other: &Pose) -> f64 {
    let dot = one.rotation.dot(other.rotation).abs();
    2.0 * dot.min(1.0).acos()
}

#[test]
fn the_nearest_copy_is_that_of_the_whole_group() {
    let (_, template) = part("square peg");
    let cube: Vec<Symmetry> = [DVec3::X, DVec3::Y, DVec3::Z]
        .map(|a| axis(a, Some(4)))
        .into_iter()
        .chain(
            [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]
                .map(|(y, z)| axis(DVec3::new(1.0, y, z), Some(3))),
        )
        .chain(
            [
                (1.0, 1.0, 0.0),
                (1.0, -1.0, 0.0),
                (1.0, 0.0, 1.0),
                (1.0, 0.0, -1.0),
                (0.0, 1.0, 1.0),
                (0.0, 1.0, -1.0),
            ]
            .map(|(x, y, z)| axis(DVec3::new(x, y, z), Some(2))),
        )
        .collect();
    for (symmetries, size) in [
        (vec![axis(DVec3::Z, Some(6))], 6),
        // Declared by what makes the group alone, and by all of its axes.
        (vec![axis(DVec3::Z, Some(4)), axis(DVec3::X, Some(2))], 8),
        (cube, 24),
    ] {
        let all = group(&symmetries);
        assert_eq!(all.len(), size);
        let template = template.clone().with_symmetries(symmetries);
        let mut random = Stream::new(5, "copies");
        let mut pose = || {
            let mut v = || DVec3::new(random.normal(), random.normal(), random.normal());
            Pose { rotation: so3::exp(v() * 2.0), translation_mm: v() * 30.0 }
        };
        for _ in 0..300 {
            let (found, guess) = (pose(), pose());
            let nearest = template.nearest_copy(&found, &guess);
            let least = all.iter().map(|turn| angle(&(found * *turn), &guess)).fold(f64::INFINITY, f64::min);
            // The angle's cosine is good to a few eps; beside 0 its arc is good to the root of that.
            assert!((angle(&nearest, &guess) - least).abs() < 1e-7, "{size}");
            // And it is a copy: the centre stays, and the turn is one of the group's.
            let turn = found.inverse() * nearest;
            let centre = DVec3::new(0.5, -0.25, 2.0);
            assert!(turn.transform_point(centre).distance(centre) < 1e-12);
            assert!(all.iter().any(|known| angle(known, &turn) < 1e-7), "{size}");
        }
    }
}

#[test]
fn a_round_part_keeps_the_spin_of_the_guess() {
    let (_, template) = part("square peg");
    let template = template.with_symmetries(vec![axis(DVec3::Z, None)]);
    let mut random = Stream::new(6, "spin");
    for _ in 0..100 {
        let mut v = || DVec3::new(random.normal(), random.normal(), random.normal());
        let (found, guess) = (Pose::exp(v(), v()), Pose::exp(v(), v()));
        let nearest = template.nearest_copy(&found, &guess);
        // What is left of the turn has no part about the axis, and no turn makes it smaller.
        let left = so3::log((guess.rotation.conjugate() * nearest.rotation).normalize());
        assert!(left.z.abs() < 1e-9 || (left.length() - PI).abs() < 1e-9, "{left}");
        for spin in [-0.1, 0.1, 1.0, 3.0] {
            let other = nearest * axis(DVec3::Z, None).turned(spin);
            assert!(angle(&other, &guess) >= angle(&nearest, &guess) - 1e-9);
        }
    }
}

#[test]
fn a_round_part_may_stand_on_its_head() {
    // As detection lists it: the round axis, and one of those across.
    let (_, template) = part("square peg");
    let round = axis(DVec3::Z, None);
    let template = template.with_symmetries(vec![round, axis(DVec3::X, Some(2))]);
    let mut random = Stream::new(9, "head");
    for _ in 0..100 {
        let mut v = || DVec3::new(random.normal(), random.normal(), random.normal());
        let (found, guess) = (Pose::exp(v() * 2.0, v()), Pose::exp(v(), v()));
        let nearest = template.nearest_copy(&found, &guess);
        for flip in [Pose::IDENTITY, axis(DVec3::X, Some(2)).turned(PI)] {
            for k in 0..36 {
                let other = found * flip * round.turned(TAU * f64::from(k) / 36.0);
                assert!(angle(&other, &guess) >= angle(&nearest, &guess) - 1e-7);
            }
        }
    }
}

#[test]
fn a_guess_a_quarter_turn_on_gets_its_own_copy_and_no_other_as_an_alternative() {
    let (part, bare) = part("square peg");
    // As found in its surface, and as declared.
    let found = bare.clone().with_symmetries(bare.find_symmetries(0.02));
    assert_eq!(found.symmetries()[0].order, Some(4));
    let settings = RegisterParams { method: RegisterMethod::SurfaceSearch, ..Default::default() };
    let mut random = Stream::new(7, "quarter");
    let (mut bare_copies, mut runs) = (0, 0);
    for k in 0..6 {
        let problem = Problem::press(&part, Sensing::GOOD, &mut random);
        let quarter = found.symmetries()[0].turned(f64::from(k % 4) * FRAC_PI_2);
        let near = problem.guess(0.05, 0.3, &mut random);
        let guess = near * quarter;
        let answer = Registrar::new(&settings).register(&problem.contact(), &found, &guess).unwrap();
        let pose = answer.t_sensor_object;
        assert!(angle(&pose, &guess) < 0.2, "the copy nearest to the guess");
        assert!(problem.score(&(pose * quarter.inverse())).is_success());
        for other in answer.alternatives.iter() {
            let copy = found.nearest_copy(&other.t_sensor_object, &pose);
            let apart = copy * pose.inverse();
            let moved = problem.points_mm.iter().map(|&p| apart.transform_point(p).distance(p));
            assert!(moved.fold(0.0, f64::max) > 0.02, "a copy is no alternative");
        }
        // From half way between two copies both are found, unless it is known that they are one.
        let between = near * found.symmetries()[0].turned(0.25 * PI);
        let wide = RegisterParams { start_sigma_deg: 30.0, ..settings.clone() };
        let count = |template: &Template| {
            let answer = Registrar::new(&wide).register(&problem.contact(), template, &between).unwrap();
            answer.alternatives.len()
        };
        bare_copies += count(&bare);
        runs += count(&found);
    }
    assert!(runs < bare_copies, "{runs} alternatives with symmetries, {bare_copies} without");
}

#[test]
fn row_10_the_parts_own_turns_are_named() {
    let (part, bare) = part("cylinder peg");
    let lying = Pose::exp(DVec3::Y * FRAC_PI_2, DVec3::ZERO);
    let t_sensor_object = Pose { translation_mm: DVec3::new(-15.0, 0.0, REST_MM + 3.0), ..lying };
    let gel = Gel::press(&part, &t_sensor_object);
    let problem = Problem::sense(&gel, t_sensor_object, Sensing::GOOD, &mut Stream::new(8, "named"));
    let declared = Symmetry::new(DVec3::Z, DVec3::ZERO, None).unwrap();
    let round = bare.clone().with_symmetries(vec![declared]);
    for method in
        [RegisterMethod::FilterregPoint, RegisterMethod::SurfaceClose, RegisterMethod::SurfaceSearch]
    {
        let settings = RegisterParams { method, ..Default::default() };
        let said = |template: &Template, guess: &Pose| {
            let found = Registrar::new(&settings).register(&problem.contact(), template, guess).unwrap();
            let words: Vec<String> = found.free.iter().map(ToString::to_string).collect();
            (words, found)
        };
        let (words, _) = said(&bare, &t_sensor_object);
        assert!(words.iter().all(|word| !word.contains("own")), "{method:?} {words:?}");
        let spun = t_sensor_object * declared.turned(2.0);
        let (words, found) = said(&round, &spun);
        assert_eq!(words, ["slide along z", "spin about z, the part's own axis"], "{method:?}");
        assert!(found.free[1].is_own && !found.free[0].is_own);
        // It is a turn of the part: along it no point leaves the surface.
        let direction = found.free[1];
        let p = DVec3::new(4.0, 0.0, 11.0);
        let moved = direction.v + direction.omega.cross(p - direction.centre_mm);
        assert!(moved.distance(DVec3::new(0.0, 4.0, 0.0)) < 1e-9, "{method:?} {moved}");
        // And it stays where the guess had it, two radians away from the other guess.
        assert!(angle(&found.t_sensor_object, &spun) < 0.03, "{method:?}");
    }
}
