//! The odds of a search tell a part from noise (simulated; noise 0.03 mm, and 0.06 mm with 10 % outliers).
// A test may stop at what it did not expect.
#![allow(clippy::unwrap_used)]

use crate::problems;

use gelstereo_core::math::random::Stream;
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Contact, Registrar};
use problems::follow::part;
use problems::gel::SOFT_MM;
use problems::{Problem, REST_MM, Sensing};

fn search() -> Registrar {
    Registrar::new(&RegisterParams { method: RegisterMethod::SurfaceSearch, ..Default::default() })
}

/// Some pose always fits noise a little, and a search finds it.
#[test]
fn noise_is_no_part_to_a_search() {
    let mut believed = 0;
    for name in ["square peg", "irregular peg"] {
        let (part, template) = part(name);
        let (mut random, mut registrar) = (Stream::new(61, part.name), search());
        for _ in 0..40 {
            let mut problem = Problem::press(&part, Sensing::GOOD, &mut random);
            problem.points_mm.iter_mut().for_each(|p| p.z = REST_MM - 0.4 - 1.3 * random.uniform());
            // Few enough that one face takes a good share of them.
            problem.points_mm.truncate(28);
            let found = registrar.register(
                &Contact::new(&problem.points_mm),
                &template,
                &problem.guess(0.2, 1.0, &mut random),
            );
            believed += usize::from(found.unwrap().log_odds.unwrap() > 0.0);
        }
    }
    // Of 80.
    assert!(believed <= 2, "{believed}");
}

/// Of three salient markers two do not seem to be.
fn hide(problem: &mut Problem) {
    let points_mm = core::mem::take(&mut problem.points_mm);
    for (k, p) in points_mm.into_iter().enumerate() {
        if k % 3 == 0 { &mut problem.points_mm } else { &mut problem.unpressed_mm }.push(p);
    }
    problem.covariance_mm2.truncate(problem.points_mm.len());
}

/// Noise hides which markers touch, and puts many of those that nothing seems to press in the part.
#[test]
fn noise_and_outliers_do_not_hide_a_part_from_a_search() {
    let (mut count, mut doubted) = (0, 0);
    for name in ["key", "USB-A plug", "square peg"] {
        let (part, template) = part(name);
        let (mut random, mut registrar) = (Stream::new(62, part.name), search());
        for _ in 0..8 {
            let mut problem = Problem::press_into(SOFT_MM, &part, Sensing::NOISY, &mut random);
            hide(&mut problem);
            let contact = Contact { decay_mm: SOFT_MM, ..problem.contact() };
            let guess = problem.guess(0.1, 0.5, &mut random);
            let found = registrar.register(&contact, &template, &guess).unwrap();
            if problem.score(&found.t_sensor_object).is_success() {
                count += 1;
                doubted += usize::from(found.log_odds.unwrap() <= 0.0);
            }
        }
    }
    // Of 24.
    assert!(count >= 20 && doubted <= 2, "{doubted} of {count}");
}
