//! Scenes as files.
#![allow(clippy::unwrap_used)]

mod common;

use gelstereo_core::math::{DVec2, DVec3, so3};
use gelstereo_sim::{Effects, Scene, SceneError, Simulator, Truth};

const GALLERY: [(&str, &str); 3] = [
    ("press_sphere", include_str!("../../../scenes/press_sphere.toml")),
    ("grasp_cylinder", include_str!("../../../scenes/grasp_cylinder.toml")),
    ("board_0_8", include_str!("../../../scenes/board_0_8.toml")),
];

const SMALL: &str = "
[indenter]
kind = \"sphere\"
radius_mm = 4
[[trajectory]]
time_s = 0
position_mm = [4, 0, 32.7]
[[trajectory]]
time_s = 0.1
position_mm = [4, 0, 31.7]
rotation_rad = [0, 0, 1]
";

fn scene(text: &str) -> Scene {
    toml::from_str(text).unwrap()
}

fn refusal(text: &str) -> String {
    match toml::from_str::<Scene>(text) {
        Err(error) => error.to_string(),
        Ok(scene) => scene.validate().unwrap_err().to_string(),
    }
}

#[test]
fn an_empty_file_is_the_default_scene() {
    assert_eq!(scene(""), Scene::default());
    assert_eq!(Scene::default().validate(), Ok(()));
    assert_eq!(scene("").effects, Effects::default());
}

#[test]
fn the_gallery_runs_and_presses_the_gel() {
    for (name, text) in GALLERY {
        let mut simulator = Simulator::new(&scene(text), None).unwrap();
        let mut truth = Truth::default();
        let deepest = (0..simulator.frames()).map(|frame| {
            let contact = simulator.contact(frame);
            simulator.truth(contact.as_ref(), &mut truth);
            let seen = |p: &DVec2| (5.0..634.0).contains(&p.x) && (5.0..474.0).contains(&p.y);
            assert!(
                truth.left_px.iter().chain(&truth.right_px).all(seen),
                "{name}: frame {frame} loses dots"
            );
            truth.indentation_mm.iter().fold(0.0_f64, |deep, &h| deep.max(h))
        });
        let deepest = deepest.fold(0.0_f64, f64::max);
        assert!((0.79..=2.0 + 1e-9).contains(&deepest), "{name}: {deepest} mm");
        simulator.truth(simulator.contact(0).as_ref(), &mut truth);
        assert!(!truth.in_contact.contains(&true), "{name} starts untouched");
    }
}

#[test]
fn a_written_scene_reads_back() {
    for (name, text) in GALLERY {
        let first = scene(text);
        let mut second = scene(&toml::to_string(&first).unwrap());
        for (a, b) in first.trajectory.iter().zip(&mut second.trajectory) {
            // A rotation vector's quaternion comes back to an ulp.
            let [qa, qb] = [a, &*b].map(|k| k.contact.t_sensor_object.rotation);
            assert!((qa - qb).length() < 1e-15, "{name}");
            b.contact = a.contact;
        }
        assert_eq!(first, second, "{name}");
    }
}

#[test]
fn poses_between_keyframes() {
    let simulator = Simulator::new(&scene(SMALL), None).unwrap();
    assert_eq!(simulator.frames(), 4);
    let pose = |frame| simulator.contact(frame).unwrap().t_sensor_object;
    assert_eq!(pose(0).translation_mm, DVec3::new(4.0, 0.0, 32.7));
    let third = pose(1);
    assert!((third.translation_mm - DVec3::new(4.0, 0.0, 32.7 - 1.0 / 3.0)).length() < 1e-12);
    assert!((so3::log(third.rotation) - DVec3::new(0.0, 0.0, 1.0 / 3.0)).length() < 1e-12);
    assert!((pose(3).translation_mm.z - 31.7).abs() < 1e-12);
    assert_eq!(pose(1000), pose(3 + 1), "the last keyframe holds on");
    assert!(Simulator::new(&Scene::default(), None).unwrap().contact(0).is_none());
}

#[test]
fn mistakes_are_named_with_what_would_be_valid() {
    let cases = [
        ("sed = 3", "unknown field `sed`"),
        ("[effects]\nblurr = {}", "unknown field `blurr`"),
        ("[effects.drag]\ndecay_mm = 3", "unknown field `decay_mm`"),
        ("[indenter]\nkind = \"ball\"", "unknown variant `ball`"),
        ("[indenter]\nkind = \"sphere\"\nradius_mm = -1", "indenter.radius_mm is -1; valid is above 0"),
        ("[gel]\ndot_radius_mm = 0.5", "below half of gel.pitch_mm"),
        ("[gel]\nsurface_mm = 3", "valid is above gel.thickness_mm"),
        ("[gel]\nmissing = [[25, 0]]", "25 rows and 25 columns"),
        ("[gel]\ndark_level = 200", "below gel.bright_level"),
        ("[effects.shoulder]\ndecay_thicknesses = 0", "0.01 to 4 gel thicknesses"),
        ("[effects.sensor_noise]\nsigma_levels = nan", "sensor_noise.sigma_levels is NaN"),
        ("frame_rate_hz = 0", "above 0, at most 10000 Hz"),
        ("[[trajectory]]\ntime_s = 0\nposition_mm = [0, 0, 30]", "there is no indenter"),
        ("[[trajectory]]\ntime_s = 0\nposition_mm = [0, 0, 30]\npress_mm = 1", "unknown field `press_mm`"),
    ];
    for (text, expected) in cases {
        let found = refusal(text);
        assert!(found.contains(expected), "{text:?} gave {found:?}");
    }
}

#[test]
fn keyframes_must_follow_each_other() {
    let mut late = scene(SMALL);
    late.trajectory[1].time_s = 0.0;
    let expected = SceneError::KeyframeTime { list: "trajectory", keyframe: 1, time_s: 0.0, after_s: 0.0 };
    assert_eq!(late.validate(), Err(expected));
    late.trajectory[1].time_s = f64::NAN;
    assert!(late.validate().is_err());
}

#[test]
fn a_mesh_file_needs_its_triangles_and_a_ball_none() {
    let file = scene("[indenter]\nkind = \"mesh\"\npath = \"key.stl\"\nunits = \"mm\"");
    let needed = Simulator::new(&file, None).unwrap_err();
    assert!(needed.to_string().contains("\"key.stl\""), "{needed}");
    let ball = scene(SMALL);
    let mesh = ball.indenter.as_ref().and_then(|shape| shape.mesh(0.1)).unwrap();
    assert_eq!(Simulator::new(&ball, Some(&mesh)).unwrap_err(), SceneError::MeshNotNeeded);
    assert!(Simulator::new(&file, Some(&mesh)).is_ok());
}
