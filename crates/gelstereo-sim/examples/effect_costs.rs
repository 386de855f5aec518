//! What every effect costs: `cargo run --release -p gelstereo-sim --example effect_costs`.
//!
//! For each effect, alone on a default sensor under a ball that drags and twists the gel: the least time of a field (all
//! positions in both images) and of a stereo frame (the same, rendered) with and without it, and what its cost model
//! says. `effect_costs NAME on 3` runs three frames with that effect and nothing else, `off` without it, for callgrind to
//! count: the difference between two numbers of frames does not depend on the machine's load.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use gelstereo_core::math::{DVec3, Pose};
use gelstereo_sim::effects::{
    Defocus, Drag, Grain, Jpeg, Misprint, Patch, SensorNoise, ShotNoise, Shoulder, Smears, Specks, Spread,
    UnevenLight, Wear,
};
use gelstereo_sim::{ContactState, Effects, Keyframe, Scene, Shape, Simulator, Switch, Truth};
use std::time::Instant;

const NAMES: [&str; 17] = [
    "shoulder",
    "spread",
    "drag",
    "misprint",
    "specks",
    "grain",
    "uneven_light",
    "smears",
    "defocus",
    "sensor_noise",
    "refraction",
    "lens_distortion",
    "ellipse_bias",
    "wear",
    "shot_noise",
    "jpeg",
    "usual_image",
];

/// The scene with one effect, and with the shoulder where an effect needs heights beside the contact.
fn scene(effect: &str) -> Scene {
    let sensor = if effect == "refraction" { "640x480-25-refraction" } else { "640x480-25" };
    let mut scene = Scene::preset(sensor).unwrap();
    let centre = scene.gel.centre_mm;
    let t_sensor_object =
        Pose::from_translation_mm(DVec3::new(centre[0], centre[1], scene.gel.surface_mm + 2.5));
    let contact = ContactState { t_sensor_object, shear_mm: [0.3, 0.1], twist_rad: 0.1 };
    scene.indenter = Some(Shape::Sphere { radius_mm: 4.0 });
    scene.trajectory = vec![Keyframe { time_s: 0.0, contact }];
    scene.switches.ellipse_bias = (effect != "ellipse_bias").then_some(Switch::Off);
    let effects = &mut scene.effects;
    let patch = Patch { centre_px: [350.0, 220.0], ..Patch::default() };
    match effect {
        "shoulder" => effects.shoulder = Some(Shoulder::default()),
        "spread" => effects.spread = Some(Spread::default()),
        "drag" => effects.drag = Some(Drag::default()),
        "misprint" => effects.misprint = Some(Misprint { shift_mm: 0.03, ..Misprint::default() }),
        "specks" => effects.specks = Some(Specks { count: 20, ..Specks::default() }),
        "grain" => effects.grain = Some(Grain::default()),
        "uneven_light" => effects.uneven_light = Some(UnevenLight::default()),
        "smears" => effects.smears = Some(Smears { patches: vec![patch], ..Smears::default() }),
        "defocus" => effects.defocus = Some(Defocus::default()),
        "wear" => effects.wear = Some(Wear::default()),
        "shot_noise" => effects.shot_noise = Some(ShotNoise::default()),
        "jpeg" => effects.jpeg = Some(Jpeg::default()),
        // What most benchmarks of the project have.
        "usual_image" => {
            *effects = Effects {
                grain: Some(Grain::default()),
                uneven_light: Some(UnevenLight::default()),
                defocus: Some(Defocus::default()),
                sensor_noise: Some(SensorNoise::default()),
                ..Effects::default()
            }
        }
        "sensor_noise" => effects.sensor_noise = Some(SensorNoise::default()),
        "lens_distortion" => {
            scene.rig.left.distortion[0] = -0.1;
            scene.rig.right.distortion[0] = -0.1;
        }
        _ => {}
    }
    scene
}

/// The same scene without it.
fn without(effect: &str) -> Scene {
    let mut plain = Scene { effects: Effects::default(), ..scene(effect) };
    plain.rig.layers = None;
    plain.rig.left.distortion[0] = 0.0;
    plain.rig.right.distortion[0] = 0.0;
    plain.switches.ellipse_bias = Some(Switch::Off);
    plain
}

/// Least times of a field and of a rendered frame, microseconds.
fn least_us(scene: &Scene, frames: u64) -> [f64; 2] {
    let mut simulator = Simulator::new(scene, None).unwrap();
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    let contact = simulator.contact(0);
    let mut least = [f64::INFINITY; 2];
    for frame in 0..frames {
        let start = Instant::now();
        simulator.moment(contact.as_ref(), frame, &mut truth);
        least[0] = least[0].min(1e6 * start.elapsed().as_secs_f64());
        simulator.render(&truth, frame, &mut left, &mut right);
        least[1] = least[1].min(1e6 * start.elapsed().as_secs_f64());
    }
    least
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    if let [effect, switch, frames] = &words[..] {
        let scene = if switch == "on" { scene(effect) } else { without(effect) };
        let [field, frame] = least_us(&scene, frames.parse().unwrap());
        println!("{effect}: {field:.0} us a field, {frame:.0} us a frame");
        return;
    }
    println!(
        "{:16} {:>10} {:>10} {:>10} {:>10}  us",
        "effect", "field on", "field off", "frame on", "frame off"
    );
    for effect in NAMES {
        let (on, off) = (least_us(&scene(effect), 100), least_us(&without(effect), 100));
        let plan = gelstereo_sim::Plan::of(&scene(effect), None).unwrap();
        let model =
            plan.entries.iter().find(|entry| entry.effect == effect).map_or(0.0, |entry| entry.cost_ns);
        println!(
            "{effect:16} {:10.0} {:10.0} {:10.0} {:10.0}  model {:.0}",
            on[0],
            off[0],
            on[1],
            off[1],
            1e-3 * model
        );
    }
}
