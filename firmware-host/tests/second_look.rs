//! Looks at a part that one grasp does not tell well enough, and the search for the hole (simulated).
#![allow(clippy::unwrap_used)]

use gelstereo_host::config::Config;
use gelstereo_host::report::JobReport;
use gelstereo_host::run::{Setup, run_with};
use std::sync::atomic::AtomicBool;

fn job(config: &Config) -> JobReport {
    let stop = AtomicBool::new(false);
    run_with(config, Setup::new(config).unwrap(), None, &stop, &mut |_| {}).unwrap()
}

#[test]
fn survey() {
    let text = std::env::var("SURVEY").unwrap_or_else(|_| "8.1 0 1 4".to_owned());
    let mut words = text.split_whitespace();
    let diameter: f64 = words.next().unwrap().parse().unwrap();
    let clearance: f64 = words.next().unwrap().parse().unwrap();
    let tries: u32 = words.next().unwrap().parse().unwrap();
    let seeds: u64 = words.next().unwrap().parse().unwrap();
    for seed in 1..=seeds {
        let mut config = Config::default();
        config.simulated.seed = seed;
        config.task.insertion_speed_mm_s = 20.0;
        config.part.spacing_mm = 0.4;
        config.simulated.hole_diameter_mm = diameter;
        if std::env::var("METHOD").is_ok() {
            config.params.register.method = gelstereo_core::params::RegisterMethod::RansacIcp;
        }
        if clearance > 0.0 {
            config.task.clearance_mm = Some(clearance);
            config.task.max_tries = tries;
        }
        let report = job(&config);
        let truth = report.truth.clone().unwrap();
        let localized = report.localized.clone();
        let (looks, forecast) = localized.map_or((0, None), |l| (l.looks, l.forecast));
        let stages: Vec<&str> = report.stages.iter().map(|s| s.stage.name()).collect();
        let time: f64 = report.stages.iter().map(|s| s.source_s).sum();
        println!(
            "{seed} {} | tip {:.3} tilt {:.4} limit {:.2} looks {looks} {forecast:?} {} {time:.1} s {}",
            report.outcome,
            truth.tip_error_mm,
            truth.tilt_error_rad,
            truth.limit_mm,
            stages.len(),
            truth.outcome_is_true
        );
    }
}
