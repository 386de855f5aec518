//! A taught goal against one that is given, with an error of the mount that the task does not know
//! (simulated).
#![allow(clippy::unwrap_used)]

use crate::quick_world;

use gelstereo_core::params::Params;
use gelstereo_host::config::{Config, PoseConfig};
use gelstereo_host::report::{JobReport, Outcome, Stage, Trace};
use gelstereo_host::run::{Setup, run_with, teach_with};
use gelstereo_host::task::Sinks;
use gelstereo_host::taught::{Taught, TaughtError};
use quick_world::{quick, run};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// The sensor stands 0.3 mm and 5 mrad from where the mount says.
fn with_mount_error(preset: &str, seed: u64) -> Config {
    let mut config = Config { preset: preset.to_owned(), ..quick(seed) };
    config.params = Params::preset(preset).unwrap();
    let (side_mm, turn_rad) = (0.3 / 3.0_f64.sqrt(), 0.005 / 3.0_f64.sqrt());
    config.simulated.mount_error =
        PoseConfig { position_mm: [side_mm; 3], rotation_rad: [turn_rad, -turn_rad, turn_rad] };
    config
}

/// Teaches the goal with a part that is placed by this seed; saves the lesson, if there is one.
fn teach(config: &Config, seed: u64, path: &Path) -> JobReport {
    let mut config = config.clone();
    config.simulated.seed = seed;
    let stop = AtomicBool::new(false);
    let setup = Setup::for_teaching(&config).unwrap();
    let sinks = Sinks { recording: None, trace: &mut Trace::default(), progress: &mut |_| {} };
    let teaching = teach_with(&config, setup, sinks, false, &stop).unwrap();
    if let Some(taught) = teaching.taught {
        taught.save(path).unwrap();
    }
    teaching.report
}

fn inserted(report: &JobReport) -> bool {
    matches!(report.outcome, Outcome::Inserted { .. })
}

fn offset_mm(report: &JobReport) -> f64 {
    report.truth.as_ref().unwrap().hole_offset_mm
}

#[test]
fn a_taught_goal_cancels_an_error_of_the_mount() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("goal.json");
    let given = with_mount_error("balanced", 2);
    let report = teach(&given, 5, &path);
    assert!(matches!(report.outcome, Outcome::Taught { .. }), "{}", report.why);
    use Stage::{Close, Localize, Open, Rest, Retreat};
    assert_eq!(
        report.stages.iter().map(|stage| stage.stage).collect::<Vec<_>>(),
        [Open, Rest, Close, Localize, Retreat]
    );
    let mut taught = given.clone();
    taught.task.taught = Some(path);
    let (given, taught) = (run(&given), run(&taught));
    assert!(!inserted(&given) && offset_mm(&given) > 0.15, "{}: {}", given.why, offset_mm(&given));
    assert!(inserted(&taught) && offset_mm(&taught) < 0.1, "{}: {}", taught.why, offset_mm(&taught));
}

#[test]
fn a_taught_goal_belongs_to_its_settings_and_its_version() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("goal.json");
    let mut config = with_mount_error("balanced", 1);
    teach(&config, 5, &path);
    let taught = Taught::load(&path).unwrap();
    taught.save(&path).unwrap();
    assert_eq!(Taught::load(&path).unwrap(), taught, "every bit is kept");

    config.task.taught = Some(path.clone());
    config.params = Params::preset("paper").unwrap();
    let error = Setup::new(&config).err().unwrap().to_string();
    assert!(error.contains("does not fit this configuration") && error.contains("other settings"), "{error}");

    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replacen("\"version\": 1", "\"version\": 2", 1)).unwrap();
    assert!(matches!(Taught::load(&path), Err(TaughtError::Version { found: 2, .. })));
    std::fs::write(&path, "{").unwrap();
    assert!(matches!(Taught::load(&path), Err(TaughtError::Parse { .. })));
    let missing = Taught::load(&folder.path().join("none.json")).unwrap_err().to_string();
    assert!(missing.starts_with("cannot read the taught goal"), "{missing}");
}

/// `GELSTEREO_SEEDS=24 cargo test -p gelstereo-host --test all -- teach:: --ignored --nocapture` prints
/// docs/task.md's table.
#[test]
#[ignore = "takes minutes: make test-long"]
fn taught_and_given_goals_over_many_seeds() {
    let seeds: u64 = std::env::var("GELSTEREO_SEEDS").map_or(24, |text| text.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("goal.json");
    for preset in ["paper", "balanced"] {
        let mut rows = ["given, mount exact", "given", "taught"].map(|goal| (goal, Vec::new()));
        let mut declined_lessons = 0;
        for seed in 1..=seeds {
            let wrong = with_mount_error(preset, seed);
            let mut exact = wrong.clone();
            exact.simulated.mount_error = PoseConfig::default();
            let mut taught = wrong.clone();
            // As a person would, who places the part again.
            let mut lesson = 1000 + seed;
            while !matches!(teach(&wrong, lesson, &path).outcome, Outcome::Taught { .. }) {
                declined_lessons += 1;
                lesson += 1000;
            }
            taught.task.taught = Some(path.clone());
            for (config, (_, reports)) in [exact, wrong, taught].iter().zip(&mut rows) {
                // A jam at this speed can shake all markers off: the task breaks off then.
                let stop = AtomicBool::new(false);
                let report = run_with(config, Setup::new(config).unwrap(), None, &stop, &mut |_| {});
                reports.extend(report.ok());
            }
        }
        for (goal, reports) in &rows {
            println!("| {preset} | {goal} | {}", row(reports, seeds));
        }
        println!("{preset}: {declined_lessons} lessons were declined");
    }
}

/// Cells of the table: inserted, not localized, broken off, median and largest offset.
fn row(reports: &[JobReport], seeds: u64) -> String {
    let count = |wanted: fn(&JobReport) -> bool| reports.iter().filter(|report| wanted(report)).count();
    let lost = |report: &JobReport| matches!(report.outcome, Outcome::NotLocalized { .. });
    let offsets_mm = reports.iter().filter(|report| !lost(report)).map(offset_mm);
    let mut offsets_mm: Vec<f64> = offsets_mm.collect();
    offsets_mm.sort_by(f64::total_cmp);
    let (median_mm, max_mm) = (offsets_mm[offsets_mm.len() / 2], offsets_mm[offsets_mm.len() - 1]);
    let broken_off = seeds as usize - reports.len();
    format!(
        "{} of {seeds} | {} | {broken_off} | {median_mm:.3} | {max_mm:.3} |",
        count(inserted),
        count(lost)
    )
}
