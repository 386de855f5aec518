//! The whole job in the simulated world (simulated: noise 2 grey levels, blur 0.8 px, gel with shoulder, spread, drag).
#![allow(clippy::unwrap_used)]

use gelstereo_host::config::Config;
use gelstereo_host::recording::{Item, Reader, Recorder, SharedBuffer, Topic};
use gelstereo_host::report::{JobReport, Outcome, Stage};
use gelstereo_host::run::{Setup, recorded_config, run_with};
use gelstereo_sim::Shape;
use std::io::Cursor;
use std::sync::atomic::AtomicBool;

fn job(config: &Config) -> JobReport {
    let stop = AtomicBool::new(false);
    run_with(config, Setup::new(config).unwrap(), None, &stop, &mut |_| {}).unwrap()
}

fn figure(report: &JobReport, stage: Stage, name: &str) -> f64 {
    let stage = report.stages.iter().find(|s| s.stage == stage).unwrap();
    stage.figures.iter().find(|f| f.name == name).unwrap().value
}

/// A world that is quick to run: the way down takes half the frames, the template has a third of the points.
fn quick(seed: u64) -> Config {
    let mut config = Config::default();
    config.simulated.seed = seed;
    config.task.insertion_speed_mm_s = 20.0;
    config.part.spacing_mm = 0.4;
    config
}

#[test]
fn the_embedded_default_inserts_the_peg() {
    let report = job(&Config::default());
    assert!(matches!(report.outcome, Outcome::Inserted { .. }), "{}", report.outcome);
    let stages: Vec<Stage> = report.stages.iter().map(|s| s.stage).collect();
    use Stage::{Align, Close, Insert, Localize, Open, Rest};
    assert_eq!(stages, [Open, Rest, Close, Localize, Align, Insert]);
    assert!(figure(&report, Stage::Close, "motion_px") >= 10.0);
    assert!(figure(&report, Stage::Insert, "motion_px") >= 5.0);
    let localized = report.localized.unwrap();
    assert_eq!(
        localized.free.len(),
        2,
        "a cylinder slides along and spins about its axis: {:?}",
        localized.free
    );
    assert!(localized.free[0].starts_with("slide along z") && localized.free[1].starts_with("spin about z"));
    // What the contact leaves free keeps the expectation's uncertainty.
    assert!((localized.axial_sigma_mm - 0.6).abs() < 0.01);
    let truth = report.truth.unwrap();
    assert!(truth.outcome_is_true && truth.inserted_mm == 10.0);
    // The clearance is 0.1 mm to each side.
    assert!(truth.tip_error_mm < 0.1, "{} mm", truth.tip_error_mm);
}

/// Holds a report's outcome against peg and hole; returns whether the peg went in.
fn judged(config: &Config, report: &JobReport) -> bool {
    let seed = config.simulated.seed;
    let truth = report.truth.clone().unwrap();
    assert!(truth.outcome_is_true, "seed {seed}: {} but {truth:?}", report.outcome);
    // By the clearance alone: a tip that is off by more than 0.1 mm meets the rim.
    let room_mm = 0.5 * config.simulated.hole_diameter_mm - 4.0;
    let inserted = matches!(report.outcome, Outcome::Inserted { .. });
    if inserted {
        assert!(truth.inserted_mm == 10.0 && truth.tip_error_mm <= room_mm, "seed {seed}: {truth:?}");
    }
    if matches!(report.outcome, Outcome::Jammed { .. }) {
        let leaned_mm = truth.tip_error_mm + truth.inserted_mm.max(0.0) * truth.tilt_error_rad;
        assert!(leaned_mm > 0.9 * room_mm, "seed {seed}: {truth:?}");
    }
    inserted
}

#[test]
fn ten_pegs_go_in_and_the_outcome_says_so() {
    for seed in 1..=10 {
        let config = quick(seed);
        let report = job(&config);
        assert!(judged(&config, &report), "seed {seed}: {}", report.outcome);
    }
}

/// With the shoulder's markers among the patch, as the paper's saliency has it, registration is biased and not every
/// peg goes in: the outcome must be right whatever happens.
#[test]
fn failures_of_ten_pegs_are_told_as_what_they_are() {
    let inserted = (11..=20).filter(|&seed| {
        let mut config = quick(seed);
        config.params.contact.patch_share = 0.0;
        judged(&config, &job(&config))
    });
    let inserted = inserted.count();
    assert!(inserted < 10, "no peg failed: this test no longer shows anything");
}

#[test]
fn a_hole_that_is_too_small_is_felt_at_the_rim() {
    let mut config = quick(1);
    config.simulated.hole_diameter_mm = 7.9;
    let report = job(&config);
    let truth = report.truth.clone().unwrap();
    assert!(matches!(report.outcome, Outcome::Jammed { .. }), "{}", report.outcome);
    assert_eq!(truth.limit_mm, 0.0);
    let motion_px = figure(&report, Stage::Insert, "motion_px");
    // One frame at 20 mm/s and 30 Hz moves the hand 0.67 mm, 13 px at f / z = 19.5 px/mm if all markers follow.
    assert!((5.0..18.0).contains(&motion_px), "stopped at {motion_px} px");
}

/// The job expects the 8 mm peg, but a thicker one stands there: whatever registration makes of it, the trigger stops
/// the robot at the rim.
#[test]
fn a_wrong_template_is_stopped_by_the_trigger() {
    let mut config = quick(1);
    config.simulated.shape = Some(Shape::Cylinder { radius_mm: 4.5, length_mm: 40.0 });
    let report = job(&config);
    assert!(
        matches!(report.outcome, Outcome::Jammed { .. } | Outcome::NotLocalized { .. }),
        "{}",
        report.outcome
    );
    assert!(report.truth.unwrap().outcome_is_true);
}

#[test]
fn fingers_that_close_on_nothing_grasp_nothing() {
    let mut config = quick(1);
    config.task.part_pose.position_mm[1] += 40.0;
    config.simulated.offset_mm = 0.0;
    let report = job(&config);
    assert!(matches!(report.outcome, Outcome::NotGrasped { .. }), "{}", report.outcome);
    assert_eq!(report.stages.last().unwrap().stage, Stage::Rest, "the unfinished stage is not reported");
}

fn recorded(config: &Config, stop: &AtomicBool) -> (JobReport, Vec<u8>) {
    let buffer = SharedBuffer::default();
    let text = recorded_config(config).unwrap();
    let recorder = Recorder::new(Box::new(buffer.clone()), &text, &[]).unwrap();
    let setup = Setup::new(config).unwrap();
    let report = run_with(config, setup, Some(recorder), stop, &mut |_| {}).unwrap();
    (report, buffer.bytes())
}

#[test]
fn a_simulated_run_is_the_same_to_the_last_byte_of_its_recording() {
    let stop = AtomicBool::new(false);
    let (first, first_bytes) = recorded(&quick(3), &stop);
    let (second, second_bytes) = recorded(&quick(3), &stop);
    assert_eq!(first.digest, second.digest);
    assert!(first_bytes.len() > 1_000_000 && first_bytes == second_bytes);
    let (other, _) = recorded(&quick(4), &stop);
    assert_ne!(first.digest, other.digest, "the digest sees another seed");
}

#[test]
fn an_interrupted_job_closes_its_recording() {
    let (report, bytes) = recorded(&quick(1), &AtomicBool::new(true));
    assert_eq!(report.outcome, Outcome::Interrupted { stage: Stage::Open });
    let mut reader = Reader::new(Box::new(Cursor::new(bytes)));
    let mut last = None;
    while let Some(item) = reader.next_item().unwrap() {
        last = Some(item);
    }
    assert!(!reader.truncated());
    let Some(Item::Message { topic: Topic::Stage, data, .. }) = last else { panic!("{last:?}") };
    assert!(String::from_utf8_lossy(&data).contains("interrupted"));
}
