//! Mean marker motion over time, with stages and triggers.

use crate::report::Stage;
use crate::report::trace::{Sample, Trace, TracedStage};
use maud::{Markup, html};
use std::fmt::Write;

const WIDTH: f64 = 960.0;
const HEIGHT: f64 = 330.0;
const LEFT: f64 = 52.0;
const RIGHT: f64 = 24.0;
const BOTTOM: f64 = 44.0;
/// Space for three lines of stage names.
const TOP: f64 = 58.0;
const NAME_LINES: usize = 3;
const TRIGGER_LINES: usize = 3;
const LINE_HEIGHT: f64 = 16.0;
/// Approximate width of a letter in the plot's 12 px font.
const LETTER_WIDTH: f64 = 7.0;
/// Narrower bands would look like lines.
const MIN_BAND_WIDTH: f64 = 4.0;
/// Approximate number of grid lines.
const GRID_LINES: f64 = 5.0;

/// Motion at which a stage's trigger fires.
pub(super) struct Threshold {
    pub(super) stage: Stage,
    pub(super) motion_px: f64,
}

/// Maps time and motion to plot coordinates.
struct Scale {
    begin_ns: u64,
    span_s: f64,
    max_px: f64,
}

impl Scale {
    fn of(samples: &[Sample], thresholds: &[Threshold]) -> Option<Self> {
        let (first, last) = (samples.first()?, samples.last()?);
        let span_s = seconds(first.time_ns, last.time_ns).max(1e-3);
        let largest_px = samples
            .iter()
            .filter_map(|sample| sample.motion_px)
            .chain(thresholds.iter().map(|threshold| threshold.motion_px))
            .filter(|motion_px| motion_px.is_finite())
            .fold(1.0, f64::max);
        Some(Self { begin_ns: first.time_ns, span_s, max_px: 1.1 * largest_px })
    }

    fn x(&self, time_ns: u64) -> f64 {
        let share = (seconds(self.begin_ns, time_ns) / self.span_s).min(1.0);
        share.mul_add(WIDTH - LEFT - RIGHT, LEFT)
    }

    fn y(&self, motion_px: f64) -> f64 {
        (motion_px / self.max_px).mul_add(TOP - (HEIGHT - BOTTOM), HEIGHT - BOTTOM)
    }
}

fn seconds(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}

/// The plot with its caption.
pub(super) fn motion(trace: &Trace, thresholds: &[Threshold]) -> Markup {
    let samples: Vec<Sample> = trace.motion().collect();
    let Some(scale) = Scale::of(&samples, thresholds) else {
        return html! { p { "No frame was sensed." } };
    };
    let label = "Mean marker motion in pixels over the frame source's time in seconds, stage by stage";
    html! {
        figure {
            svg class="plot" role="img" aria-label=(label) viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } {
                title { (label) }
                (bands(trace.stages(), &scale, &samples))
                (grid(&scale))
                (threshold_lines(trace.stages(), &scale, thresholds))
                (triggers(trace, &scale))
                (curve(&samples, &scale))
            }
            figcaption {
                "Mean motion of the seen markers in the left image since the reference, px, over the frame \
                 source's time since the first sensed frame, s. Level lines: the motion at which the stage's \
                 trigger acts. Dashed: a trigger that acted, or the end. Ticks below the axis: frames that \
                 could not be sensed."
            }
        }
    }
}

/// Shades every other stage, with its name above.
fn bands(stages: &[TracedStage], scale: &Scale, samples: &[Sample]) -> Markup {
    let last_ns = samples.last().map_or(scale.begin_ns, |sample| sample.time_ns);
    let spans: Vec<(&TracedStage, f64, f64)> = stages
        .iter()
        .filter(|stage| stage.ended_ns.is_some_and(|ended_ns| ended_ns >= scale.begin_ns))
        .filter(|stage| stage.frames > 0 || stage.begun_ns.is_some_and(|begun_ns| begun_ns >= scale.begin_ns))
        .map(|stage| {
            let begin = scale.x(stage.begun_ns.unwrap_or(scale.begin_ns));
            (stage, begin, scale.x(stage.ended_ns.unwrap_or(last_ns)))
        })
        .collect();
    let lines = name_lines(&spans);
    let shaded = shaded(&spans);
    html! {
        @for ((stage, begin, end), (line, is_shaded)) in spans.iter().zip(lines.into_iter().zip(shaded)) {
            @if is_shaded {
                rect class="band" x=(tenths(*begin)) y=(TOP) width=(tenths((end - begin).max(1.0)))
                    height=(HEIGHT - BOTTOM - TOP) {}
            }
            @let x = tenths(*begin);
            line class="grid" x1=(x) x2=(x) y1=(name_y(line)) y2=(HEIGHT - BOTTOM) {}
            text x=(tenths(begin + 3.0)) y=(name_y(line)) { (stage.stage.name()) }
        }
    }
}

/// Selects every other stage among those wide enough to be visible.
fn shaded(spans: &[(&TracedStage, f64, f64)]) -> Vec<bool> {
    let mut wide = 0;
    let is_shaded = |(_, begin, end): &(&TracedStage, f64, f64)| {
        wide += usize::from(end - begin > MIN_BAND_WIDTH);
        end - begin > MIN_BAND_WIDTH && wide % 2 == 1
    };
    spans.iter().map(is_shaded).collect()
}

fn name_y(line: usize) -> f64 {
    (line as f64).mul_add(-LINE_HEIGHT, TOP - 6.0)
}

/// Line of each name: the lowest on which it does not overlap the previous name.
fn name_lines(spans: &[(&TracedStage, f64, f64)]) -> Vec<usize> {
    let mut ends = [f64::NEG_INFINITY; NAME_LINES];
    spans
        .iter()
        .map(|(stage, begin, _)| {
            let line = ends.iter().position(|end| end < begin).unwrap_or(NAME_LINES - 1);
            ends[line] = (stage.stage.name().len() as f64 + 1.0).mul_add(LETTER_WIDTH, *begin);
            line
        })
        .collect()
}

fn grid(scale: &Scale) -> Markup {
    let (step_px, step_s) = (round_step(scale.max_px), round_step(scale.span_s));
    let levels = (0..).map(|i| f64::from(i) * step_px).take_while(|&level| level <= scale.max_px);
    let times = (0..).map(|i| f64::from(i) * step_s).take_while(|&time_s| time_s <= scale.span_s);
    let bottom = HEIGHT - BOTTOM;
    html! {
        @for level in levels {
            @let y = tenths(scale.y(level));
            line class="grid" x1=(LEFT) x2=(WIDTH - RIGHT) y1=(y) y2=(y) {}
            text class="faint" text-anchor="end" x=(LEFT - 6.0) y=(tenths(scale.y(level) + 4.0)) {
                (rounded(level, step_px))
            }
        }
        @for time_s in times {
            @let x = scale.x(scale.begin_ns + (time_s * 1e9) as u64);
            text class="faint" text-anchor="middle" x=(tenths(x)) y=(bottom + 24.0) {
                (rounded(time_s, step_s))
            }
        }
        text class="faint" x="8" y=(TOP - 6.0) { "px" }
        text class="faint" text-anchor="end" x=(WIDTH - RIGHT) y=(HEIGHT - 4.0) { "s" }
    }
}

/// 1, 2 or 5 times a power of ten, for about [`GRID_LINES`] lines.
fn round_step(range: f64) -> f64 {
    let rough = range / GRID_LINES;
    let power = 10_f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|factor| factor * power >= rough).unwrap_or(10.0);
    factor * power
}

/// Formats with as many decimals as the step needs.
fn rounded(value: f64, step: f64) -> String {
    let decimals = (-step.log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{value:.decimals$}")
}

fn threshold_lines(stages: &[TracedStage], scale: &Scale, thresholds: &[Threshold]) -> Markup {
    let lines = stages.iter().flat_map(|stage| {
        thresholds.iter().filter(move |threshold| threshold.stage == stage.stage).filter_map(
            move |threshold| {
                Some((scale.x(stage.begun_ns?), scale.x(stage.ended_ns?), scale.y(threshold.motion_px)))
            },
        )
    });
    html! {
        @for (begin, end, y) in lines {
            line class="threshold" x1=(tenths(begin)) x2=(tenths(end)) y1=(tenths(y)) y2=(tenths(y)) {}
        }
    }
}

fn triggers(trace: &Trace, scale: &Scale) -> Markup {
    let shown = trace.triggers().iter().filter(|trigger| trigger.time_ns >= scale.begin_ns);
    html! {
        @for (number, trigger) in shown.enumerate() {
            @let x = scale.x(trigger.time_ns);
            // Names are placed beside their line, within the picture.
            @let anchor = if x > 0.5 * WIDTH { "end" } else { "start" };
            @let beside = if x > 0.5 * WIDTH { -4.0 } else { 4.0 };
            line class="trigger" x1=(tenths(x)) x2=(tenths(x)) y1=(TOP) y2=(HEIGHT - BOTTOM) {}
            text text-anchor=(anchor) x=(tenths(x + beside)) y=(trigger_y(number)) { (trigger.cause) }
        }
    }
}

/// Neighbours get different heights, since triggers may follow each other closely.
fn trigger_y(number: usize) -> f64 {
    ((number % TRIGGER_LINES) as f64).mul_add(LINE_HEIGHT, TOP + 14.0)
}

/// The curve, interrupted at frames that could not be processed; each of these gets a tick.
fn curve(samples: &[Sample], scale: &Scale) -> Markup {
    let (mut path, mut ticks, mut pen_down) = (String::new(), String::new(), false);
    let bottom = HEIGHT - BOTTOM;
    for sample in samples {
        let x = scale.x(sample.time_ns);
        // Writing to a string cannot fail.
        match sample.motion_px.filter(|motion_px| motion_px.is_finite()) {
            Some(motion_px) => {
                let command = if pen_down { 'L' } else { 'M' };
                let _ = write!(path, "{command}{x:.1} {:.1}", scale.y(motion_px));
            }
            None => {
                let _ = write!(ticks, "M{x:.1} {bottom:.1}v7");
            }
        }
        pen_down = sample.motion_px.is_some();
    }
    html! {
        path class="curve" d=(path) {}
        @if !ticks.is_empty() { path class="missing" d=(ticks) {} }
    }
}

fn tenths(value: f64) -> String {
    format!("{value:.1}")
}
