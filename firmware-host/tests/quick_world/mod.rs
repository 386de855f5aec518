//! A simulated world that is quick to run, for the tests of the task.

use gelstereo_host::config::Config;
use gelstereo_host::report::JobReport;
use gelstereo_host::run::{Setup, run_with};
use std::sync::atomic::AtomicBool;

/// The embedded default with this seed; the way down takes half the frames, the template has a third of the
/// points.
pub fn quick(seed: u64) -> Config {
    let mut config = Config::default();
    config.simulated.seed = seed;
    config.task.insertion_speed_mm_s = 20.0;
    config.part.spacing_mm = 0.4;
    config
}

/// Runs the task to its end, without a recording.
pub fn run(config: &Config) -> JobReport {
    run_with(config, Setup::new(config).unwrap(), None, &AtomicBool::new(false), &mut |_| {}).unwrap()
}
