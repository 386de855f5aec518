//! Looks at a part that one grasp does not tell well enough, and the search for the hole (simulated: noise 2
//! grey levels, blur 0.8 px, gel with shoulder, spread, drag).
#![allow(clippy::unwrap_used)]

use crate::quick_world;

use gelstereo_core::params::RegisterMethod;
use gelstereo_host::report::{JobReport, Outcome, Stage};
use quick_world::{quick, run};

fn count(report: &JobReport, stage: Stage) -> usize {
    report.stages.iter().filter(|s| s.stage == stage).count()
}

/// A hole of 0.02 mm more than the peg: one contact tells the peg's place across the closing direction to 5
/// um.
fn tight(seed: u64, max_looks: u32) -> JobReport {
    let mut config = quick(seed);
    config.simulated.hole_diameter_mm = 8.012;
    config.task.clearance_mm = Some(0.012);
    config.task.max_looks = max_looks;
    // The simulated robot is exact, and the simulated holder holds the peg but along the closing direction.
    (config.task.look_sigma_mm, config.task.look_sigma_rad) = (0.001, 1e-4);
    run(&config)
}

#[test]
fn a_tight_hole_is_declined_after_one_look_and_met_after_another() {
    for seed in 1..=3 {
        let once = tight(seed, 1);
        assert!(matches!(once.outcome, Outcome::Declined { looks: 1, .. }), "seed {seed}: {}", once.outcome);
        let localized = once.localized.unwrap();
        assert!(localized.forecast.unwrap().weakest.starts_with("slide along"), "seed {seed}");
        assert_eq!(once.stages.last().unwrap().stage, Stage::Localize, "nothing moves after that");
        let again = tight(seed, 3);
        assert!(matches!(again.outcome, Outcome::Inserted { .. }), "seed {seed}: {}", again.outcome);
        assert_eq!(count(&again, Stage::Localize), again.localized.unwrap().looks as usize);
        assert!(again.truth.unwrap().outcome_is_true);
    }
}

/// RANSAC and ICP are off by more than their covariance says.
#[test]
fn a_peg_that_jams_is_inserted_by_a_search_around_the_hole() {
    for seed in [2, 8] {
        let mut config = quick(seed);
        config.params.register.method = RegisterMethod::RansacIcp;
        config.task.clearance_mm = Some(0.2);
        let once = run(&config);
        assert!(matches!(once.outcome, Outcome::Jammed { .. }), "seed {seed}: {}", once.outcome);
        config.task.max_tries = 19;
        let report = run(&config);
        assert!(matches!(report.outcome, Outcome::Inserted { .. }), "seed {seed}: {}", report.outcome);
        let truth = report.truth.clone().unwrap();
        assert!(truth.outcome_is_true && truth.tip_error_mm > 0.1, "seed {seed}: {truth:?}");
        assert!((2..=19).contains(&count(&report, Stage::Insert)), "seed {seed}");
    }
}

/// Without a clearance nothing is predicted, and a clearance that is wide changes nothing of what the job
/// does.
#[test]
fn a_wide_hole_is_met_after_one_look_with_the_same_frames() {
    let plain = run(&quick(1));
    let mut config = quick(1);
    config.task.clearance_mm = Some(0.2);
    let predicted = run(&config);
    assert_eq!(plain.digest, predicted.digest);
    assert!(plain.localized.unwrap().forecast.is_none());
    assert!(predicted.localized.unwrap().forecast.unwrap().chance > 0.999);
}
