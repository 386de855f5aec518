//! A run as one self-contained HTML page.

mod picture;
mod plot;
mod tables;
mod values;

use super::trace::{Trace, TracedStage};
use super::{JobReport, Outcome, Stage};
use crate::config::Config;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use plot::Threshold;
use std::fmt::Display;

const STYLE: &str = include_str!("style.css");

/// Renders the page of a run that ended with a report or broke off.
#[must_use]
pub fn page(config: &Config, trace: &Trace, ending: Result<&JobReport, &dyn Display>) -> String {
    let sentence = sentence(ending);
    let name = config.recording.path.file_name().unwrap_or_default().to_string_lossy();
    let title = format!("{name}: {}", heading(ending));
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                header {
                    h1 { (title) }
                    p id="outcome" class=(class(ending)) { (sentence) }
                }
                main { (body(config, trace, ending.ok())) }
                footer { p { "Written by gelstereo-host " (env!("CARGO_PKG_VERSION")) "." } }
            }
        }
    };
    markup.into_string()
}

fn body(config: &Config, trace: &Trace, report: Option<&JobReport>) -> Markup {
    html! {
        section {
            h2 { "Stages" }
            (tables::stages(trace.stages()))
        }
        section {
            h2 { "Marker motion" }
            (plot::motion(trace, &thresholds(config)))
        }
        @if let Some(report) = report {
            (tables::results(report))
        }
        section {
            h2 { "Pictures" }
            p { "The last left image of each stage." }
            div class="pictures" {
                @for stage in trace.stages() { (pictured(stage)) }
            }
        }
        section {
            h2 { "Setup" }
            (tables::setup(config))
            @if let Ok(text) = config.to_toml() {
                details { summary { "All settings" } pre { (text) } }
            }
        }
    }
}

fn pictured(stage: &TracedStage) -> Markup {
    html! {
        @if let Some(picture) = &stage.picture { (picture::figure(stage.stage, picture)) }
        @else { p { (stage.stage.name()) ": no picture was kept." } }
    }
}

/// Why the run ended, in one sentence.
fn sentence(ending: Result<&JobReport, &dyn Display>) -> String {
    match ending {
        Ok(report) => format!("{}.", capitalized(&report.outcome.to_string())),
        Err(error) => format!("The job broke off: {error}."),
    }
}

/// The outcome's kind in words.
fn heading(ending: Result<&JobReport, &dyn Display>) -> String {
    let Ok(report) = ending else { return "broke off".to_owned() };
    let outcome = serde_json::to_value(&report.outcome).unwrap_or_default();
    outcome.get("kind").and_then(|kind| kind.as_str()).unwrap_or("ended").replace('_', " ")
}

fn class(ending: Result<&JobReport, &dyn Display>) -> &'static str {
    match ending {
        Ok(report) if matches!(report.outcome, Outcome::Inserted { .. }) => "good",
        Ok(_) => "other",
        Err(_) => "bad",
    }
}

fn capitalized(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

fn thresholds(config: &Config) -> [Threshold; 2] {
    let contact = &config.params.contact;
    [
        Threshold { stage: Stage::Close, motion_px: contact.grasp_trigger_px },
        Threshold { stage: Stage::Insert, motion_px: contact.insertion_trigger_px },
    ]
}
