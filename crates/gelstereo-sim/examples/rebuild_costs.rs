//! Times of building a simulator, anew and from one whose scene differs in one setting.
//!
//! `cargo run --release -p gelstereo-sim --example rebuild_costs`

use gelstereo_sim::effects::{Defocus, ElasticLayer, Grain, SensorNoise, ShotNoise, UnevenLight};
use gelstereo_sim::{Effects, Scene, SceneError, Shape, Simulator};
use std::time::Instant;

/// Least time of some runs, milliseconds.
fn least_ms(mut run: impl FnMut()) -> f64 {
    let time = |_| {
        let start = Instant::now();
        run();
        1e3 * start.elapsed().as_secs_f64()
    };
    (0..30).map(time).fold(f64::INFINITY, f64::min)
}

fn row(name: &str, from: &Scene, change: impl Fn(&mut Scene)) -> Result<(), SceneError> {
    let mut to = from.clone();
    change(&mut to);
    let simulator = Simulator::new(from, None)?;
    let anew = least_ms(|| drop(std::hint::black_box(Simulator::new(&to, None))));
    let replaced = least_ms(|| drop(std::hint::black_box(simulator.replaced(&to, None))));
    println!("| {name} | {anew:.2} | {replaced:.2} |");
    Ok(())
}

fn main() -> Result<(), SceneError> {
    let image = Effects {
        defocus: Some(Defocus::default()),
        uneven_light: Some(UnevenLight::default()),
        grain: Some(Grain::default()),
        shot_noise: Some(ShotNoise::default()),
        sensor_noise: Some(SensorNoise::default()),
        ..Effects::default()
    };
    let indenter = Some(Shape::Sphere { radius_mm: 4.0 });
    let gel = Effects::of_gel();
    let gel = Effects { shoulder: gel.shoulder, spread: gel.spread, drag: gel.drag, ..image.clone() };
    let approximated = Scene { indenter: indenter.clone(), effects: gel, ..Scene::default() };
    let layer = Effects { elastic_layer: Some(ElasticLayer::default()), ..image };
    let layered = Scene { indenter, effects: layer, ..Scene::default() };
    println!("| change | new, ms | replaced, ms |\n|---|---:|---:|");
    for (name, scene) in [("approximated gel", &approximated), ("elastic layer", &layered)] {
        row(&format!("{name}: nothing"), scene, |_| {})?;
        row(&format!("{name}: noise"), scene, |scene| {
            scene.effects.sensor_noise = Some(SensorNoise { sigma_levels: 3.0 });
        })?;
        row(&format!("{name}: light"), scene, |scene| {
            scene.effects.uneven_light = Some(UnevenLight { across: 0.3, ..UnevenLight::default() });
        })?;
        row(&format!("{name}: part"), scene, |scene| {
            scene.indenter = Some(Shape::Sphere { radius_mm: 3.0 });
        })?;
        row(&format!("{name}: seed"), scene, |scene| scene.seed = 9)?;
        row(&format!("{name}: thickness of the gel"), scene, |scene| scene.gel.thickness_mm = 4.0)?;
    }
    Ok(())
}
