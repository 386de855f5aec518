//! Each effect in a scene of its own, for tests and for the example `effect_costs`: their names are the
//! library's list.
#![allow(dead_code, clippy::unwrap_used)]

use gelstereo_core::math::{DVec3, Pose};
use gelstereo_sim::effects::{
    Defocus, Drag, DroppedFrames, ElasticLayer, Grain, Jpeg, LargeStrain, Misprint, MotionBlur, Patch,
    Relaxation, SensorNoise, ShotNoise, Shoulder, Smears, Specks, Spread, UnevenLight, Wear,
};
use gelstereo_sim::{ContactState, Effects, GelKeyframe, Keyframe, Scene, Shape, Switch, Switches};

/// Names of all effects.
pub fn names() -> Vec<&'static str> {
    Switches::default().all().map(|(name, _)| name).collect()
}

/// The same scene that never had the effect: a default sensor under a ball that drags and twists the gel.
pub fn without(effect: &str) -> Scene {
    let sensor = if effect == "refraction" { "640x480-25-refraction" } else { "640x480-25" };
    let mut scene = Scene::preset(sensor).unwrap();
    let centre = scene.gel.centre_mm;
    let t_sensor_object =
        Pose::from_translation_mm(DVec3::new(centre[0], centre[1], scene.gel.surface_mm + 2.5));
    let contact = ContactState { t_sensor_object, shear_mm: [0.3, 0.1], twist_rad: 0.1 };
    scene.indenter = Some(Shape::Sphere { radius_mm: 4.0 });
    scene.trajectory = vec![Keyframe { time_s: 0.0, contact }];
    scene.rig.layers = None;
    scene.switches.ellipse_bias = Some(Switch::Off);
    match effect {
        "relaxation" | "large_strain" => scene.effects.elastic_layer = Some(ElasticLayer::default()),
        // Otherwise nothing of the ball's smooth way would be seen to move: the gel is shaken by 2 mm/s.
        "motion_blur" => {
            let at = |k: u32| GelKeyframe {
                time_s: 0.5 * f64::from(k),
                shift_mm: [f64::from(k % 2), 0.0],
                rotation_rad: 0.0,
            };
            scene.gel_motion = (0..20).map(at).collect();
        }
        _ => {}
    }
    scene
}

/// A scene with the effect and nothing that it does not need.
pub fn with(effect: &str) -> Scene {
    let mut scene = without(effect);
    let effects = &mut scene.effects;
    let patch = Patch { centre_px: [350.0, 220.0], ..Patch::default() };
    match effect {
        "shoulder" => effects.shoulder = Some(Shoulder::default()),
        "spread" => effects.spread = Some(Spread::default()),
        "drag" => effects.drag = Some(Drag::default()),
        "elastic_layer" => effects.elastic_layer = Some(ElasticLayer::default()),
        "relaxation" => effects.relaxation = Some(Relaxation::default()),
        "large_strain" => effects.large_strain = Some(LargeStrain::default()),
        "misprint" => effects.misprint = Some(Misprint { shift_mm: 0.03, ..Misprint::default() }),
        "wear" => effects.wear = Some(Wear::default()),
        "specks" => effects.specks = Some(Specks { count: 20, ..Specks::default() }),
        "grain" => effects.grain = Some(Grain::default()),
        "uneven_light" => effects.uneven_light = Some(UnevenLight::default()),
        "smears" => effects.smears = Some(Smears { patches: vec![patch], ..Smears::default() }),
        "motion_blur" => effects.motion_blur = Some(MotionBlur::default()),
        "defocus" => effects.defocus = Some(Defocus::default()),
        "shot_noise" => effects.shot_noise = Some(ShotNoise::default()),
        "sensor_noise" => effects.sensor_noise = Some(SensorNoise::default()),
        "jpeg" => effects.jpeg = Some(Jpeg::default()),
        "dropped_frames" => effects.dropped_frames = Some(DroppedFrames::default()),
        "refraction" => {
            scene.rig.layers = Scene::preset("640x480-25-refraction").unwrap().rig.layers;
        }
        "lens_distortion" => {
            scene.rig.left.distortion[0] = -0.1;
            scene.rig.right.distortion[0] = -0.1;
        }
        "ellipse_bias" => scene.switches.ellipse_bias = None,
        _ => panic!("{effect} has no scene here"),
    }
    scene
}

/// The scene with the effect, which is switched off.
pub fn switched_off(effect: &str) -> Scene {
    let mut scene = with(effect);
    *scene.switches.get_mut(effect).unwrap() = Some(Switch::Off);
    scene
}

/// What most benchmarks of the project have.
pub fn usual_image() -> Scene {
    let effects = Effects {
        grain: Some(Grain::default()),
        uneven_light: Some(UnevenLight::default()),
        defocus: Some(Defocus::default()),
        sensor_noise: Some(SensorNoise::default()),
        ..Effects::default()
    };
    Scene { effects, ..without("") }
}
