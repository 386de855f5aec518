//! How often and how exactly registration finds six parts from starts near and far, and how long it takes.
//!
//! ```text
//! starts [method] [contacts per part and class]      surface_search 20
//! ```
//!
//! Every line is a part, every column a class of starts: contacts found to 2 degrees and 0.3 mm over the
//! directions that the contact determines, the error of those over the Cramér-Rao bound (root mean square and
//! median), and the least of five times. Simulated, noise 0.03 mm along z, 0.015 mm across; "noisy" twice
//! that with a tenth of outliers.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "it is a program for the bench")]

#[path = "../tests/problems/mod.rs"]
mod problems;

use gelstereo_core::math::random::Stream;
use gelstereo_core::params::RegisterParams;
use gelstereo_core::register::{Registrar, Template};
use problems::parts::{Part, parts};
use problems::{CLASSES, Class, Problem, Tally};
use std::time::Instant;

fn main() {
    let mut words = std::env::args().skip(1);
    let method = words.next().unwrap_or_else(|| "surface_search".into());
    let contacts = words.next().map_or(20, |n| n.parse().unwrap());
    let params: RegisterParams = toml::from_str(&format!("method = \"{method}\"")).unwrap();
    let mut totals = CLASSES.map(|_| Tally::default());
    for part in parts() {
        let template = Template::from_mesh(&part.mesh, Template::DEFAULT_SPACING_MM, 1).unwrap();
        let template = template.with_field(Template::DEFAULT_CELL_MM, Template::DEFAULT_REACH_MM);
        print!("{:14}", part.name);
        for (class, total) in CLASSES.iter().zip(&mut totals) {
            let tally = run(&part, &template, class, &params, contacts);
            print!(" | {} {tally}", class.name);
            total.add(&tally);
        }
        println!();
    }
    for (class, total) in CLASSES.iter().zip(&totals) {
        println!("{:8} {total}", class.name);
    }
}

fn run(part: &Part, template: &Template, class: &Class, params: &RegisterParams, contacts: usize) -> Tally {
    let mut registrar = Registrar::new(&class.params(params));
    let mut random = Stream::new(3, part.name);
    let mut tally = Tally::default();
    for _ in 0..contacts {
        let problem = Problem::press(part, class.sensing, &mut random);
        let guess = problem.guess_within(class, &mut random);
        let mut least = f64::INFINITY;
        let mut found = None;
        for _ in 0..5 {
            let start = Instant::now();
            found = registrar.register(&problem.contact(), template, &guess).ok();
            least = least.min(start.elapsed().as_secs_f64() * 1e3);
        }
        tally.count(found.map(|found| problem.score(&found.t_sensor_object)), least);
    }
    tally
}
