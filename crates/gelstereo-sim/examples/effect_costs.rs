//! What every effect costs: `cargo run --release -p gelstereo-sim --example effect_costs`.
//!
//! For each effect, alone on a default sensor under a ball that drags and twists the gel: the shortest time
//! of a field (all markers in space), of the same with both views of it, and of a stereo frame (the same,
//! rendered) while it is on, while it is off, and in a scene that never had it; and what its cost model says.
//!
//! `effect_costs count` counts instructions instead, by callgrind: of a scene's third and fourth frame, so
//! that what a scene takes to begin is left out. They do not depend on the machine's load. `effect_costs
//! count docs/simulator.md` writes them into the manual between its markers. `effect_costs NAME on 3` is what
//! callgrind sees: three frames.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

#[path = "../tests/every_effect/mod.rs"]
mod every_effect;

use every_effect::{names, switched_off, usual_image, with, without};
use gelstereo_sim::{Plan, Scene, Simulator, Truth};
use std::process::Command;
use std::time::Instant;

/// More rows of the table: scenes without an effect of their own.
const SCENES: [&str; 2] = ["no effect", "usual image"];

const SWITCHES: [&str; 3] = ["on", "off", "never"];

fn scene(name: &str, switch: &str) -> Scene {
    match (name, switch) {
        ("no effect", _) | ("usual image", "off" | "never") => without(""),
        ("usual image", _) => usual_image(),
        (_, "on") => with(name),
        (_, "off") => switched_off(name),
        _ => without(name),
    }
}

/// Runs some frames; shortest times of the markers in both views and of a rendered frame, microseconds.
fn least_us(scene: &Scene, frames: u64) -> [f64; 2] {
    let mut simulator = Simulator::new(scene, None).unwrap();
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    let contact = simulator.contact(0);
    let mut shortest = [f64::INFINITY; 2];
    for frame in 0..frames {
        let start = Instant::now();
        simulator.moment(contact.as_ref(), frame, &mut truth);
        shortest[0] = shortest[0].min(1e6 * start.elapsed().as_secs_f64());
        simulator.render(&truth, frame, &mut left, &mut right);
        shortest[1] = shortest[1].min(1e6 * start.elapsed().as_secs_f64());
    }
    shortest
}

/// Least time of the markers in space alone, microseconds.
fn least_field_us(scene: &Scene, frames: u64) -> f64 {
    let (mut simulator, mut truth) = (Simulator::new(scene, None).unwrap(), Truth::default());
    let contact = simulator.contact(0);
    let mut shortest = f64::INFINITY;
    for frame in 0..frames {
        let start = Instant::now();
        simulator.field(contact.as_ref(), frame, &mut truth);
        shortest = shortest.min(1e6 * start.elapsed().as_secs_f64());
    }
    shortest
}

/// What the plan says of an effect's time, microseconds.
fn model_us(name: &str) -> f64 {
    let plan = Plan::of(&scene(name, "on"), None).unwrap();
    let entries = plan.entries.iter().filter(|entry| entry.effect == name);
    // (A sum of nothing is -0.)
    entries.fold(0.0, |sum, entry| sum + 1e-3 * entry.cost_ns)
}

/// Instructions of a run, by callgrind.
fn instructions(name: &str, switch: &str, frames: u64) -> f64 {
    let own = std::env::current_exe().unwrap();
    let mut valgrind = Command::new("valgrind");
    valgrind.args(["--tool=callgrind", "--callgrind-out-file=/dev/null"]).arg(own);
    let output = valgrind.args([name, switch, &frames.to_string()]).output();
    let output = output.expect("valgrind counts the instructions: install it");
    let text = String::from_utf8(output.stderr).unwrap();
    let total = text.lines().find_map(|line| line.split("Collected :").nth(1));
    total.unwrap_or_else(|| panic!("valgrind says: {text}")).trim().parse().unwrap()
}

/// Of a stereo frame.
fn per_frame(name: &str, switch: &str) -> f64 {
    0.5 * (instructions(name, switch, 4) - instructions(name, switch, 2))
}

/// The table of instructions, as Markdown.
fn counted() -> String {
    let mut known: Vec<(Scene, f64)> = Vec::new();
    let mut lines = vec![
        "| effect | on | off | never there | costs | its model |".to_owned(),
        "| --- | ---: | ---: | ---: | ---: | ---: |".to_owned(),
    ];
    for name in SCENES.into_iter().chain(names()) {
        // Scenes that are the same take the same; but what is off is counted each time.
        let [on, off, never] = SWITCHES.map(|switch| {
            let scene = scene(name, switch);
            let found = known.iter().find(|(other, _)| *other == scene).map(|&(_, count)| count);
            let count = found.unwrap_or_else(|| per_frame(name, switch));
            known.push((scene, count));
            1e-6 * count
        });
        // 4 instructions to a nanosecond.
        let model = 4e-3 * model_us(name);
        let line = match name {
            "no effect" => format!("| {name} | {on:.2} | | | | |"),
            "usual image" => format!("| {name} | {on:.2} | | {never:.2} | {:+.2} | |", on - never),
            _ => format!("| `{name}` | {on:.2} | {off:.2} | {never:.2} | {:+.2} | {model:.2} |", on - never),
        };
        println!("{line}");
        lines.push(line);
    }
    lines.join("\n")
}

/// Puts text between the manual's markers.
fn write_between(page: &str, text: &str) {
    let old = std::fs::read_to_string(page).unwrap();
    let (begin, end) = ("<!-- begin effect costs -->", "<!-- end effect costs -->");
    let (head, rest) = old.split_once(begin).expect("the page has no place for the table");
    let (_, tail) = rest.split_once(end).expect("the page's place for the table has no end");
    std::fs::write(page, format!("{head}{begin}\n{text}\n{end}{tail}")).unwrap();
}

fn print_times() {
    print!("{:16}", "effect");
    for what in ["field", "views", "images"] {
        SWITCHES.iter().for_each(|switch| print!(" {what:>8} {switch:>5}"));
    }
    println!("  model  (least of 100, us)");
    for name in SCENES.into_iter().chain(names()) {
        let times = SWITCHES.map(|switch| {
            let scene = scene(name, switch);
            let [views, images] = least_us(&scene, 100);
            [least_field_us(&scene, 100), views, images]
        });
        let columns = [0, 1, 2].map(|k| times.map(|us| format!("{:14.0}", us[k])).join(" "));
        println!("{name:16} {}  {:.0}", columns.join(" "), model_us(name));
    }
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match &words[..] {
        [] => print_times(),
        ["count"] => drop(counted()),
        ["count", page] => write_between(page, &counted()),
        [name, switch, frames] => {
            let [field, frame] = least_us(&scene(name, switch), frames.parse().unwrap());
            println!("{name}: {field:.0} us in both views, {frame:.0} us a frame");
        }
        _ => panic!("valid is nothing, count, count PAGE, or NAME on|off|never FRAMES"),
    }
}
