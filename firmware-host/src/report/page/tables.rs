//! Tables of a run: stages, pose, truth, recording, setup.

use super::capitalized;
use super::values::{named, values};
use crate::config::Config;
use crate::recording::RecordingReport;
use crate::report::trace::TracedStage;
use crate::report::{JobReport, Localized, StageReport};
use gelstereo_core::math::{Pose, so3};
use maud::{Markup, html};
use serde::Serialize;
use serde_json::{Map, Value};

/// Fields of the report that have their own section or are in the header.
const SHOWN: [&str; 8] = ["outcome", "why", "stages", "localized", "truth", "digest", "recording", "page"];
/// Fields of the pose that are in its sentences and its table.
const SHOWN_OF_POSE: [&str; 9] = [
    "t_sensor_object",
    "t_gripper_object",
    "converged",
    "iterations",
    "inliers",
    "points",
    "rmse_mm",
    "sigma",
    "free",
];
const AXES: [&str; 6] = ["x", "y", "z", "rotation about x", "rotation about y", "rotation about z"];

/// Every stage that was started, in order.
pub(super) fn stages(stages: &[TracedStage]) -> Markup {
    html! {
        div class="wide" {
            table id="stages" {
                caption { "Times: of this computer, and of the frame source." }
                thead {
                    tr {
                        th scope="col" { "Stage" }
                        th scope="col" class="number" { "Time, s" }
                        th scope="col" class="number" { "Source time, s" }
                        th scope="col" class="number" { "Frames" }
                        th scope="col" class="number" { "Bad frames" }
                        th scope="col" { "Figures" }
                    }
                }
                tbody { @for stage in stages { (stage_row(stage)) } }
            }
        }
    }
}

fn stage_row(stage: &TracedStage) -> Markup {
    let source_s = stage
        .report
        .as_ref()
        .map(|report| report.source_s)
        .or_else(|| Some(stage.ended_ns?.saturating_sub(stage.begun_ns?) as f64 * 1e-9));
    let time =
        |time_s: Option<f64>| time_s.map_or_else(|| "unknown".to_owned(), |time_s| format!("{time_s:.3}"));
    html! {
        tr {
            th scope="row" { (stage.stage.name()) }
            td class="number" { (time(stage.report.as_ref().map(|report| report.wall_s))) }
            td class="number" { (time(source_s)) }
            td class="number" { (stage.frames) }
            td class="number" { (stage.bad_frames) }
            td { (figures(stage.report.as_ref())) }
        }
    }
}

fn figures(report: Option<&StageReport>) -> Markup {
    html! {
        @if let Some(report) = report {
            div class="figures" { @for figure in &report.figures { (named(figure.name, figure.value)) " " } }
            @for warning in &report.warnings { p class="warning" { (warning) } }
        } @else {
            "did not complete"
        }
    }
}

/// Sections for the report's contents besides outcome and stages.
pub(super) fn results(report: &JobReport) -> Markup {
    let others = further(report, &SHOWN);
    html! {
        @if let Some(localized) = &report.localized {
            section {
                h2 { "Part in the hand" }
                (pose(localized))
                (values(&Value::Object(further(localized, &SHOWN_OF_POSE))))
            }
        }
        @if let Some(truth) = &report.truth {
            section {
                h2 { "Simulated truth" }
                p {
                    "The outcome above is " @if truth.outcome_is_true { "true" } @else { "not true" } ". "
                    "Errors are those of the localized pose, or of the expected one if the part was not "
                    "localized."
                }
                (values(&serde_json::to_value(truth).unwrap_or_default()))
            }
        }
        @for (key, value) in &others {
            section { h2 { (capitalized(&key.replace('_', " "))) } (values(value)) }
        }
        @if let Some(recording) = &report.recording {
            section {
                h2 { "Recording" }
                (files(recording))
                p { "Digest of all frames: " code { (report.digest) } }
            }
        }
    }
}

/// Fields of a part of the report that are not shown elsewhere.
fn further(part: &impl Serialize, shown: &[&str]) -> Map<String, Value> {
    let fields = match serde_json::to_value(part) {
        Ok(Value::Object(fields)) => fields,
        _ => Map::new(),
    };
    fields.into_iter().filter(|(key, value)| !shown.contains(&key.as_str()) && !value.is_null()).collect()
}

fn pose(localized: &Localized) -> Markup {
    let free = if localized.free.is_empty() {
        "The contact determines all six directions.".to_owned()
    } else {
        format!("The contact leaves free: {}.", localized.free.join("; "))
    };
    let (hand, sensor) = (coordinates(&localized.t_gripper_object), coordinates(&localized.t_sensor_object));
    html! {
        p id="free" { (free) }
        p {
            "Registration " @if localized.converged { "converged" } @else { "did not converge" } " in "
            (localized.iterations) " iterations. The template explains " (localized.inliers) " of "
            (localized.points) " points with a residual of " (format!("{:.4}", localized.rmse_mm)) " mm."
        }
        div class="wide" {
            table id="pose" {
                caption {
                    "Pose of the part. Sigma: standard deviation, about the axes of the sensor frame. A "
                    "direction that the contact leaves free has the sigma that was expected beforehand."
                }
                thead {
                    tr {
                        th scope="col" { "Coordinate" }
                        th scope="col" class="number" { "In the gripper" }
                        th scope="col" class="number" { "In the sensor" }
                        th scope="col" class="number" { "Sigma" }
                        th scope="col" { "Unit" }
                    }
                }
                tbody {
                    @for (i, axis) in AXES.iter().enumerate() {
                        @let to_unit = if i < 3 { 1.0 } else { 180.0 / std::f64::consts::PI };
                        tr {
                            th scope="row" { (axis) }
                            td class="number" { (coordinate(hand, i)) }
                            td class="number" { (coordinate(sensor, i)) }
                            td class="number" { (format!("{:.4}", localized.sigma[i] * to_unit)) }
                            td class="unit" { @if i < 3 { "mm" } @else { "deg" } }
                        }
                    }
                }
            }
        }
    }
}

/// Position in millimetres and rotation vector in degrees; `None` for an invalid pose.
fn coordinates(rows: &[[f64; 4]; 4]) -> Option<[f64; 6]> {
    let pose = Pose::from_rows(rows).ok()?;
    let (p, r) = (pose.translation_mm, so3::log(pose.rotation));
    Some([p.x, p.y, p.z, r.x.to_degrees(), r.y.to_degrees(), r.z.to_degrees()])
}

fn coordinate(found: Option<[f64; 6]>, index: usize) -> String {
    // Adding zero turns -0.0 into 0.0.
    found.map_or_else(|| "unknown".to_owned(), |values| format!("{:.3}", values[index] + 0.0))
}

fn files(recording: &RecordingReport) -> Markup {
    html! {
        ul { @for file in &recording.files { li { code { (file.display()) } } } }
        p { (recording.messages) " messages, " (format!("{:.1}", recording.bytes as f64 * 1e-6)) " MB." }
        @if recording.lost_messages > 0 {
            p { (recording.lost_messages) " messages were not recorded, because the disk was too slow." }
        }
        @if let Some(fault) = &recording.fault { p { "It ended early: " (fault) "." } }
    }
}

/// Setup of the run.
pub(super) fn setup(config: &Config) -> Markup {
    let lines = [
        ("Frame source", kind(&config.source)),
        ("Gripper", kind(&config.gripper)),
        ("Robot", kind(&config.robot)),
        ("Part", kind(&config.part.shape)),
        ("Preset", config.preset.clone()),
    ];
    html! {
        table {
            thead { tr { th scope="col" { "What" } th scope="col" { "Kind" } } }
            tbody { @for (what, kind) in &lines { tr { th scope="row" { (what) } td { (kind) } } } }
        }
    }
}

/// The `kind` of a setting in the configuration.
fn kind(setting: &impl Serialize) -> String {
    let value = serde_json::to_value(setting).unwrap_or_default();
    value.get("kind").and_then(Value::as_str).unwrap_or("unknown").to_owned()
}
