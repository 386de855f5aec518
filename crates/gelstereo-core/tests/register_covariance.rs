//! Whether a found pose is as far from the truth as its covariance says.
//!
//! NEES (Bar-Shalom, Li and Kirubarajan 2001, 5.4): the error squared in standard deviations over the directions that the
//! result calls determined. With a right covariance it is chi-square of as many degrees.
// A test may stop at what it did not expect, and print its table.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

mod problems;

use gelstereo_core::math::random::Stream;
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Contact, Registrar, Registration, Template};
use problems::gel::SOFT_MM;
use problems::parts::{Part, parts};
use problems::{CLASSES, Problem, Sensing};

/// Normal deviates of 95 %, and of a false alarm in ten thousand.
const USUAL: f64 = 1.645;
const RARE: f64 = 3.719;

/// Quantile of chi-square by Wilson and Hilferty (1931), right to a percent from three degrees on and high below.
fn chi_square(degrees: usize, deviate: f64) -> f64 {
    let k = degrees as f64;
    let root = 1.0 - 2.0 / (9.0 * k) + deviate * (2.0 / (9.0 * k)).sqrt();
    k * root * root * root
}

/// The most of `count` answers that lie outside where one in twenty should, but for one time in ten thousand.
fn most_outside(count: usize) -> usize {
    let (mean, variance) = (0.05 * count as f64, 0.05 * 0.95 * count as f64);
    // Half a count for continuity, and Cornish and Fisher's (1938) for the skew of the binomial.
    (mean + RARE * variance.sqrt() + 0.9 * (RARE * RARE - 1.0) / 6.0 + 0.5) as usize
}

/// What came of some answers.
#[derive(Debug, Default)]
struct Nees {
    squared: f64,
    directions: usize,
    answers: usize,
    outside: usize,
}

impl Nees {
    fn add(&mut self, problem: &Problem, found: &Registration) {
        let seen = &found.observability;
        let error = problem.error(&found.t_sensor_object);
        let (mut squared, mut directions) = (0.0, 0);
        for (value, u) in seen.values.iter().zip(&seen.directions).filter(|(value, _)| **value > 0.0) {
            let along: f64 = u.iter().zip(error).map(|(a, b)| a * b).sum();
            squared += value * along * along;
            directions += 1;
        }
        if directions > 0 {
            self.squared += squared;
            self.directions += directions;
            self.answers += 1;
            self.outside += usize::from(squared > chi_square(directions, USUAL));
        }
    }

    fn mean(&self) -> f64 {
        self.squared / self.directions as f64
    }
}

impl std::fmt::Display for Nees {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { directions, answers, outside, .. } = self;
        write!(f, "NEES {:.2} over {directions} directions, {outside} of {answers} outside", self.mean())
    }
}

fn template(part: &Part) -> Template {
    let template = Template::from_mesh(&part.mesh, 0.4, 1).unwrap();
    template.with_field(Template::DEFAULT_CELL_MM, Template::DEFAULT_REACH_MM)
}

/// Contacts of every part, each searched for with each of these budgets; what came of those that succeeded.
fn search(name: &str, sensing: Sensing, contacts: usize, budgets: &[u32]) -> Vec<Nees> {
    let mut all: Vec<Nees> = budgets.iter().map(|_| Nees::default()).collect();
    for part in parts() {
        let template = template(&part);
        let mut random = Stream::new(31, part.name);
        let mut own = Nees::default();
        for _ in 0..contacts {
            let problem = Problem::press_into(SOFT_MM, &part, sensing, &mut random);
            let contact = Contact { decay_mm: SOFT_MM, ..problem.contact() };
            let guess = problem.guess_within(&CLASSES[0], &mut random);
            for (tally, &budget) in all.iter_mut().zip(budgets) {
                let method = RegisterMethod::SurfaceSearch;
                let params = RegisterParams { method, budget, ..Default::default() };
                let found = Registrar::new(&params).register(&contact, &template, &guess).unwrap();
                if problem.score(&found.t_sensor_object).is_success() {
                    tally.add(&problem, &found);
                    own.add(&problem, &found);
                }
            }
        }
        println!("{name}, {}: {own}", part.name);
    }
    for (tally, budget) in all.iter().zip(budgets) {
        println!("{name}, budget {budget}: {tally}");
    }
    all
}

#[test]
fn found_poses_err_as_their_covariance_says() {
    for (name, sensing, contacts) in [("good", Sensing::GOOD, 8), ("noisy", Sensing::NOISY, 5)] {
        let all = search(name, sensing, contacts, &[1_000_000]);
        let most = most_outside(all[0].answers);
        assert!(all[0].outside <= most, "{name}: {}, at most {most}", all[0]);
    }
}

#[test]
fn poses_that_a_budget_stopped_err_no_more_than_their_covariance_says() {
    for (budget, tally) in
        [15_000, 60_000, 150_000].iter().zip(search("stopped", Sensing::GOOD, 4, &[15_000, 60_000, 150_000]))
    {
        let most = most_outside(tally.answers);
        assert!(tally.outside <= most, "{budget}: {tally}, at most {most}");
        let degrees = tally.directions;
        assert!(tally.mean() <= chi_square(degrees, RARE) / degrees as f64, "{budget}: {tally}");
    }
}
