//! The page of a run: what it says, what it escapes, and what happens when it cannot be written.
#![allow(clippy::unwrap_used)]

use gelstereo_host::config::Config;
use gelstereo_host::recording::RecordingReport;
use gelstereo_host::report::{
    Figure, JobReport, Localized, Outcome, Stage, StageReport, Trace, TruthReport, page,
};
use gelstereo_host::run::run;
use gelstereo_host::source::{Gray, StereoPair};
use gelstereo_host::task::LatencyReport;
use proptest::prelude::*;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// A run that inserts quickly, recorded in a folder.
fn quick(folder: &Path) -> Config {
    let mut config = Config::default();
    config.task.insertion_speed_mm_s = 20.0;
    config.part.spacing_mm = 0.4;
    config.recording.path = folder.join("run.mcap");
    config
}

#[test]
fn a_run_has_a_page_with_its_stages_and_its_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let config = quick(folder.path());
    let report = run(&config, &AtomicBool::new(false), &mut |_| {}).unwrap();
    let text = std::fs::read_to_string(folder.path().join("run.html")).unwrap();
    assert_eq!(report.page.unwrap().fault, None);
    let sentence = report.outcome.to_string();
    assert!(
        sentence.starts_with("inserted: felt") && text.contains(&sentence["inserted: ".len()..]),
        "{sentence}"
    );
    for stage in &report.stages {
        assert!(
            text.contains(&format!("<th scope=\"row\">{}</th>", stage.stage.name())),
            "{:?}",
            stage.stage
        );
    }
    assert_eq!(text.matches("data:image/png;base64,").count(), report.stages.len());
    assert!(text.contains("grasp") && text.contains("slide along z"));
}

#[test]
fn a_page_that_cannot_be_written_is_a_fault_and_the_outcome_stays() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("run.html")).unwrap();
    let report = run(&quick(folder.path()), &AtomicBool::new(false), &mut |_| {}).unwrap();
    assert!(matches!(report.outcome, Outcome::Inserted { .. }), "{}", report.outcome);
    let fault = report.page.unwrap().fault.unwrap();
    assert!(fault.contains("run.html cannot be written: "), "{fault}");
    assert_eq!(report.recording.unwrap().fault, None);
}

#[test]
fn without_the_setting_there_is_no_page() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = quick(folder.path());
    config.recording.report = false;
    let stop = AtomicBool::new(true);
    let report = run(&config, &stop, &mut |_| {}).unwrap();
    assert_eq!(report.page, None);
    assert!(!folder.path().join("run.html").exists());
}

#[test]
fn a_job_that_broke_off_has_a_page_that_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = quick(folder.path());
    config.task.closing_speed_mm_s = 0.1;
    config.task.stage_timeout_s = 1.0;
    let error = run(&config, &AtomicBool::new(false), &mut |_| {}).err().unwrap().to_string();
    let text = std::fs::read_to_string(folder.path().join("run.html")).unwrap();
    assert!(error.starts_with("close did not end within 1 s") && text.contains(&error), "{error}");
    assert!(text.contains("did not complete"), "the stage that broke off is in the table");
}

/// A report whose every text is this one.
fn report_of(text: &str) -> JobReport {
    let stage = Stage::Localize;
    let figures = vec![Figure { name: "motion_px", value: f64::NAN }];
    let rows = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    JobReport {
        outcome: Outcome::NotLocalized { reason: text.to_owned() },
        why: text.to_owned(),
        stages: vec![StageReport {
            stage,
            wall_s: 0.0,
            source_s: 0.0,
            frames: 0,
            bad_frames: 0,
            figures,
            warnings: vec![text.to_owned()],
        }],
        localized: Some(Localized {
            t_sensor_object: rows,
            t_gripper_object: rows,
            converged: true,
            iterations: 1,
            inliers: 1,
            points: 1,
            rmse_mm: 0.0,
            sigma: [0.0; 6],
            axial_sigma_mm: 0.0,
            free: vec![text.to_owned()],
            looks: 1,
            touches: 0,
            forecast: None,
        }),
        truth: Some(TruthReport {
            lateral_error_mm: 0.0,
            tip_error_mm: f64::INFINITY,
            tilt_error_rad: 0.0,
            axial_error_mm: 0.0,
            inserted_mm: 0.0,
            limit_mm: 0.0,
            hole_offset_mm: 0.0,
            hole_tilt_rad: 0.0,
            outcome_is_true: false,
        }),
        latency: LatencyReport::default(),
        digest: text.to_owned(),
        recording: Some(RecordingReport {
            files: vec![text.into()],
            fault: Some(text.to_owned()),
            lost_messages: 1,
            ..RecordingReport::default()
        }),
        light_fault: Some(text.to_owned()),
        page: None,
    }
}

fn page_of(text: &str) -> String {
    let mut config = Config::default();
    config.recording.path = Path::new("folder").join(text).with_extension("mcap");
    config.rig_file = Some(text.into());
    let mut trace = Trace::default();
    let pair = StereoPair { left: Gray { width: 2, height: 2, pixels: vec![0; 4] }, ..StereoPair::default() };
    trace.begin(Stage::Localize);
    trace.passed(&pair);
    trace.trigger(text);
    trace.finish();
    let ended = page(&config, &trace, Ok(&report_of(text)));
    ended + &page(&config, &trace, Err(&text))
}

/// Characters by which a text could end what it stands in.
fn marks(page: &str) -> [usize; 3] {
    ['<', '>', '"'].map(|mark| page.chars().filter(|&found| found == mark).count())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// No text of a run adds an element or an attribute to the page, or ends one.
    #[test]
    fn hostile_texts_are_escaped(text in "[<>&\"'a-z=/!-]{1,40}") {
        let (hostile, plain) = (page_of(&text), page_of("plain"));
        // TOML may write a text in other quotation marks, but these are escaped as well.
        prop_assert_eq!(marks(&hostile), marks(&plain), "{}", text);
        let escaped = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
        let escaped = escaped.replace('"', "&quot;");
        prop_assert!(hostile.contains(&format!("localized: {escaped}.")), "{}", text);
    }
}
