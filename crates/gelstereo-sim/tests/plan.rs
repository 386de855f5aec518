//! Which effects are computed, and that those which are not leave no trace.
#![allow(clippy::unwrap_used)]

use gelstereo_core::camera::Camera;
use gelstereo_sim::effects::{
    Defocus, DroppedFrames, ElasticLayer, Grain, Misprint, SensorNoise, Smears, Specks, UnevenLight,
};
use gelstereo_sim::plan::Why;
use gelstereo_sim::{Asked, Effects, Plan, Scene, SceneError, Simulator, Switch, Truth};

/// Every effect there is, on a lens that distorts and behind layers.
fn full() -> Scene {
    let text = "
        indenter = { kind = \"sphere\", radius_mm = 4 }
        frame_rate_hz = 2
        [[trajectory]]
        time_s = 0
        position_mm = [5, 0, 33]
        [[trajectory]]
        time_s = 1
        position_mm = [5, 0, 31]
        shear_mm = [0.2, 0.1]
        twist_rad = 0.1
    ";
    let mut scene: Scene = toml::from_str(text).unwrap();
    scene.rig = Scene::preset("640x480-25-refraction").unwrap().rig;
    scene.gel = Scene::preset("640x480-25-refraction").unwrap().gel;
    // A quarter of the pixels, for time.
    for camera in [&mut scene.rig.left, &mut scene.rig.right] {
        *camera = Camera { width_px: 320, height_px: 240, fx_px: 300.0, fy_px: 300.0, ..camera.clone() };
        (camera.cx_px, camera.cy_px) = (159.5, 119.5);
    }
    scene.rig.left.distortion = [-0.1, 0.0, 0.001, 0.0, 0.0];
    scene.effects = Effects {
        misprint: Some(Misprint { shift_mm: 0.02, merged: vec![[3, 4, 3, 5]], ..Misprint::default() }),
        specks: Some(Specks::default()),
        grain: Some(Grain::default()),
        uneven_light: Some(UnevenLight::default()),
        smears: Some(Smears { random: 3, ..Smears::default() }),
        defocus: Some(Defocus::default()),
        sensor_noise: Some(SensorNoise::default()),
        dropped_frames: Some(DroppedFrames { frames: vec![1], ..DroppedFrames::default() }),
        ..Effects::of_gel()
    };
    scene
}

/// The scene without an effect, as someone would write it who had never heard of it.
fn never_listed(scene: &Scene, effect: &str) -> Scene {
    let mut tree = toml::Table::try_from(scene).unwrap();
    match effect {
        "refraction" => drop(tree["rig"].as_table_mut().unwrap().remove("layers")),
        "lens_distortion" => {
            for side in ["left", "right"] {
                tree["rig"][side].as_table_mut().unwrap().remove("distortion");
            }
        }
        _ => drop(tree["effects"].as_table_mut().unwrap().remove(effect)),
    }
    tree.try_into().unwrap()
}

fn switched(scene: &Scene, effect: &str, switch: &str) -> Scene {
    let mut tree = toml::Table::try_from(scene).unwrap();
    let switches = tree.entry("switches").or_insert(toml::Value::Table(toml::Table::new()));
    switches.as_table_mut().unwrap().insert(effect.into(), switch.into());
    tree.try_into().unwrap()
}

/// Truths and images of all frames that arrive.
fn bits(scene: &Scene) -> (Vec<Truth>, Vec<Vec<u8>>) {
    let mut simulator = Simulator::new(scene, None).unwrap();
    let (mut truths, mut images) = (Vec::new(), Vec::new());
    for arrived in 0..simulator.delivered() {
        let frame = simulator.frame_of(arrived).unwrap();
        let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
        simulator.moment(simulator.contact(frame).as_ref(), frame as u64, &mut truth);
        simulator.render(&truth, frame as u64, &mut left, &mut right);
        truths.push(truth);
        images.extend([left, right]);
    }
    (truths, images)
}

/// The simulator is built from the planned scene alone: where that is the scene that never listed an effect,
/// time and bits are that scene's.
#[test]
fn an_effect_that_is_off_was_never_there() {
    let scene = full();
    let names: Vec<&str> = Plan::of(&scene, None).unwrap().entries.iter().map(|entry| entry.effect).collect();
    assert!(names.len() >= 14, "{names:?}");
    leaves_no_trace(&scene, names.into_iter().filter(|&effect| effect != "ellipse_bias"));
    let mut layer = full();
    (layer.effects.shoulder, layer.effects.spread, layer.effects.drag) = (None, None, None);
    layer.effects.elastic_layer = Some(ElasticLayer::default());
    leaves_no_trace(&layer, ["elastic_layer"].into_iter());
}

fn leaves_no_trace<'a>(scene: &Scene, effects: impl Iterator<Item = &'a str>) {
    for effect in effects {
        let (off, never) = (switched(scene, effect, "off"), never_listed(scene, effect));
        assert_ne!(*scene, never, "{effect} was listed");
        assert_eq!(Plan::of(&off, None).unwrap().scene, never, "{effect}");
        assert!(bits(&off) == bits(&never), "bits without {effect}");
        assert!(bits(&off) != bits(scene), "{effect} does something");
    }
}

/// The same by its bound: what is asked does not depend on it.
#[test]
fn what_is_asked_decides() {
    let points = Scene { asked: Some(Asked::Points { tolerance_um: 0.0 }), ..full() };
    let plan = Plan::of(&points, None).unwrap();
    let on: Vec<&str> = plan.entries.iter().filter(|entry| entry.on).map(|entry| entry.effect).collect();
    assert_eq!(on, ["shoulder", "spread", "drag", "misprint", "dropped_frames"]);
    assert!(plan.entries.iter().all(|entry| entry.on || entry.why == Why::WithinTolerance { sum: 0.0 }));
    let positions = Scene { asked: Some(Asked::Positions { tolerance_px: 0.0 }), ..full() };
    let on =
        Plan::of(&positions, None).unwrap().entries.into_iter().filter(|entry| entry.on).map(|e| e.effect);
    let rig = ["refraction", "lens_distortion", "ellipse_bias"];
    let expected = ["shoulder", "spread", "drag", "misprint", "dropped_frames"].into_iter().chain(rig);
    assert!(on.eq(expected));
    // Points and positions are then those of the whole scene, bit for bit.
    let (whole, planned) = (bits(&full()).0, bits(&positions).0);
    for (whole, planned) in whole.iter().zip(&planned) {
        assert_eq!((&whole.points_mm, &whole.left_px), (&planned.points_mm, &planned.left_px));
    }
    // A part that never touches does nothing to the gel.
    let mut away = positions.clone();
    away.effects.misprint = None;
    away.trajectory.truncate(1);
    let plan = Plan::of(&away, None).unwrap();
    assert!(plan.entries[..3].iter().all(|entry| !entry.on && entry.bound.px == 0.0), "{plan}");
}

#[test]
fn a_scene_that_asks_nothing_is_simulated_as_it_is() {
    let scene = full();
    let plan = Plan::of(&scene, None).unwrap();
    assert_eq!(plan.scene, scene);
    assert!(plan.entries.iter().all(|entry| entry.on && entry.why == Why::NothingAsked));
    assert_eq!(plan.left_out(), 0.0);
}

#[test]
fn switches_overrule_the_bounds() {
    let asked = Scene { asked: Some(Asked::Images { tolerance_levels: 1e6 }), ..full() };
    let plan = Plan::of(&asked, None).unwrap();
    let on = |plan: &Plan| plan.entries.iter().filter(|entry| entry.on).map(|e| e.effect).collect::<Vec<_>>();
    assert_eq!(on(&plan), ["dropped_frames"], "no tolerance stands for a frame");
    let forced = switched(&switched(&asked, "grain", "on"), "dropped_frames", "off");
    let plan = Plan::of(&forced, None).unwrap();
    assert_eq!(on(&plan), ["grain"]);
    let text = plan.to_string();
    assert!(text.contains("asked: images within 1000000 levels"), "{text}");
    assert!(text.contains("the scene says so") && text.contains("within the tolerance"), "{text}");
}

#[test]
fn switches_that_make_no_sense_are_refused() {
    let error = |scene: &Scene| Plan::of(scene, None).unwrap_err();
    let scene = Scene::default();
    assert_eq!(error(&switched(&scene, "grain", "on")), SceneError::NothingToSwitchOn { effect: "grain" });
    assert_eq!(
        error(&switched(&scene, "refraction", "on")),
        SceneError::NothingToSwitchOn { effect: "refraction" }
    );
    let auto = switched(&scene, "ellipse_bias", "auto");
    assert_eq!(error(&auto), SceneError::NothingAsked { effect: "ellipse_bias" });
    assert!(error(&auto).to_string().contains("asked = {"), "{}", error(&auto));
    for tolerance_px in [-1.0, f64::NAN, f64::INFINITY] {
        let asked = Some(Asked::Positions { tolerance_px });
        assert!(matches!(
            error(&Scene { asked, ..scene.clone() }),
            SceneError::Invalid { name: "asked.tolerance_px", .. }
        ));
    }
    // A switch for what is not there may be off: one line for many scenes.
    assert_eq!(switched(&scene, "grain", "off").switches.grain, Some(Switch::Off));
    assert!(Plan::of(&switched(&scene, "grain", "off"), None).is_ok());
}

#[test]
fn scene_files_say_what_is_asked() {
    let read = |text: &str| toml::from_str::<Scene>(text).map_err(|error| error.to_string());
    let scene =
        read("asked = { kind = \"points\", tolerance_um = 2.5 }\n[switches]\ndrag = \"off\"").unwrap();
    assert_eq!(scene.asked, Some(Asked::Points { tolerance_um: 2.5 }));
    assert_eq!(scene.switches.drag, Some(Switch::Off));
    let again: Scene = toml::from_str(&toml::to_string(&scene).unwrap()).unwrap();
    assert_eq!(again, scene);
    for (text, hint) in [
        ("asked = { kind = \"points\", tolerance_px = 1 }", "tolerance_um"),
        ("asked = { kind = \"forces\" }", "positions"),
        ("switches = { drag = \"maybe\" }", "auto"),
        ("switches = { gravity = \"off\" }", "drag"),
    ] {
        let error = read(text).unwrap_err();
        assert!(error.contains(hint), "{error}");
    }
}
