//! Triggers in sigmas of the sensor's noise, in whole tasks of the simulated world.
#![allow(clippy::unwrap_used)]

use crate::quick_world;

use gelstereo_host::config::{Config, ConfigError};
use gelstereo_host::report::{JobReport, Stage};
use quick_world::{quick, run};

fn figure(report: &JobReport, stage: Stage, name: &str) -> f64 {
    let stage = report.stages.iter().find(|s| s.stage == stage).unwrap();
    stage.figures.iter().find(|f| f.name == name).unwrap().value
}

/// A trigger of 0.02 px stops the fingers at the first touch: the gel is pressed, and the motion is far above
/// the noise. At 2 mm/s some 60 frames without contact come before it, of which none is taken for a touch.
#[test]
fn a_touch_far_below_10_px_stops_the_fingers_and_noise_does_not() {
    let mut frames_before = 0.0;
    for seed in 1..5 {
        let mut config = quick(seed);
        config.task.closing_speed_mm_s = 2.0;
        config.task.grasp_trigger_sigmas = Some(8.0);
        // The task ends after the grasp: so light a touch is not localized.
        config.params.register.advanced.max_iterations = 1;
        let report = run(&config);
        let rest = |name| figure(&report, Stage::Rest, name);
        let close = |name| figure(&report, Stage::Close, name);
        let (trigger_px, motion_px) = (rest("grasp_trigger_px"), close("motion_px"));
        assert!(
            trigger_px < 0.05 && trigger_px <= motion_px && motion_px < 1.0,
            "{trigger_px} {motion_px} px"
        );
        let sigmas = (motion_px - rest("noise_level_px")) / rest("noise_sigma_px");
        assert!(sigmas > 15.0 && close("pressed_mm") > 0.02, "seed {seed}: {sigmas} {}", close("pressed_mm"));
        frames_before +=
            (config.task.open_width_mm - close("width_mm")) / 2.0 * config.simulated.frame_rate_hz;
    }
    assert!(frames_before > 200.0, "{frames_before}");
}

#[test]
fn too_few_sigmas_are_a_typed_error() {
    for (key, name) in [
        ("grasp_trigger_sigmas", "task.grasp_trigger_sigmas"),
        ("insertion_trigger_sigmas", "task.insertion_trigger_sigmas"),
    ] {
        for bad in ["7.2", "-8", "nan", "inf"] {
            let config = Config::parse(&format!("[task]\n{key} = {bad}"), "cell.toml").unwrap();
            let error = config.validate().unwrap_err();
            let ConfigError::Value { name: found, valid, .. } = &error else {
                panic!("{key} = {bad}: {error}")
            };
            assert_eq!((*found, *valid), (name, "7.3 to 1000000"), "{key} = {bad}");
        }
        let good = Config::parse(&format!("[task]\n{key} = 8"), "cell.toml").unwrap();
        good.validate().unwrap();
    }
}
