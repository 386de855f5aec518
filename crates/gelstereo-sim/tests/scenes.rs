//! Scenes as files.
#![allow(clippy::unwrap_used)]

use gelstereo_core::math::{DVec2, DVec3, so3};
use gelstereo_sim::{Effects, Scene, SceneError, Sight, Simulator, Truth};

const GALLERY: [(&str, &str); 4] = [
    ("press_sphere", include_str!("../../../scenes/press_sphere.toml")),
    ("grasp_cylinder", include_str!("../../../scenes/grasp_cylinder.toml")),
    ("board_0_8", include_str!("../../../scenes/board_0_8.toml")),
    ("board_0_8_refraction", include_str!("../../../scenes/board_0_8_refraction.toml")),
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

/// Everything that can go wrong at once.
const ROUGH: &str = include_str!("../../../scenes/rough_ride.toml");

#[test]
fn the_rough_ride_does_what_its_file_says() {
    let mut simulator = Simulator::new(&scene(ROUGH), None).unwrap();
    assert_eq!(simulator.frames(), 46);
    assert!((38..=44).contains(&simulator.delivered()), "{}", simulator.delivered());
    let (mut truth, mut seen, mut fastest, mut before) = (Truth::default(), [0; 6], 0.0_f64, Vec::new());
    for arrived in 0..simulator.delivered() {
        let frame = simulator.frame_of(arrived).unwrap();
        let contact = simulator.contact(frame);
        simulator.moment(contact.as_ref(), frame as u64, &mut truth);
        truth.left_dots.iter().for_each(|dot| seen[dot.sight as usize] += 1);
        let steps = truth.points_mm.iter().zip(&before).map(|(a, b): (&DVec3, &DVec3)| (*a - *b).length());
        fastest = steps.fold(fastest, f64::max);
        before.clone_from(&truth.points_mm);
    }
    let [whole, cut, merged, covered, outside, not_printed] = seen;
    assert!(
        whole > 20_000 && cut > 0 && merged > 100 && covered > 0 && outside > 0 && not_printed == 0,
        "{seen:?}"
    );
    assert!(fastest > 1.2 * 0.9, "{fastest} mm in one frame");
}

#[test]
fn presets_are_sensors_that_see_their_lattice() {
    assert_eq!(Scene::preset("640x480-25"), Some(Scene::default()));
    assert_eq!(Scene::preset("640x480"), None);
    let mut truth = Truth::default();
    for name in Scene::PRESETS {
        let scene = Scene::preset(name).unwrap();
        let (size, rest) = name.split_once('-').unwrap();
        let markers: usize = rest.split('-').next().unwrap().parse().unwrap();
        let camera = &scene.rig.right;
        assert_eq!(format!("{}x{}", camera.width_px, camera.height_px), size);
        assert_eq!((scene.gel.rows, scene.gel.cols), (markers, markers));
        assert_eq!(scene.rig.layers.is_some(), name.ends_with("refraction"));
        Simulator::new(&scene, None).unwrap().truth(None, &mut truth);
        let dots = truth.left_dots.iter().chain(&truth.right_dots);
        assert!(dots.clone().all(|dot| dot.sight == Sight::Whole), "{name}");
        assert!(dots.clone().all(|dot| dot.contrast_levels == 120.0), "{name}");
    }
    let file = scene(include_str!("../../../scenes/board_0_8_refraction.toml"));
    let preset = Scene::preset("640x480-25-refraction").unwrap();
    assert_eq!((file.rig, file.gel), (preset.rig, preset.gel));
}

#[test]
fn a_written_scene_reads_back() {
    for (name, text) in GALLERY.into_iter().chain([("rough_ride", ROUGH)]) {
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
        (
            "[indenter]\nkind = \"sphere\"\nradius_mm = -1",
            "indenter.radius_mm is -1; valid is 0.001 to 1000 mm",
        ),
        ("[gel]\ndot_radius_mm = 0.5", "below half of gel.pitch_mm"),
        ("[gel]\nsurface_mm = 3", "valid is above gel.thickness_mm"),
        ("[gel]\nmissing = [[25, 0]]", "25 rows and 25 columns"),
        ("[gel]\ndark_level = 200", "below gel.bright_level"),
        ("[effects.shoulder]\ndecay_thicknesses = 0", "0.01 to 4 gel thicknesses"),
        ("[effects.sensor_noise]\nsigma_levels = nan", "sensor_noise.sigma_levels is NaN"),
        ("frame_rate_hz = 0", "above 0, at most 10000 Hz"),
        ("[[trajectory]]\ntime_s = 0\nposition_mm = [0, 0, 30]", "there is no indenter"),
        ("[[trajectory]]\ntime_s = 0\nposition_mm = [0, 0, 30]\npress_mm = 1", "unknown field `press_mm`"),
        ("[[gel_motion]]\ntime_s = 1\n[[gel_motion]]\ntime_s = 1", "keyframe 1 of gel_motion is at 1 s"),
        ("[[gel_motion]]\ntime_s = 1\nshift_mm = [1e9, 0]", "gel_motion.shift_mm is 1000000000"),
        ("[effects.misprint]\nshift_mm = 0.3", "0 to a quarter of gel.pitch_mm"),
        ("[effects.misprint]\nradius_share = nan", "misprint.radius_share is NaN"),
        ("[effects.misprint]\nmerged = [[0, 0, 0, 25]]", "marker [0, 25]"),
        ("[effects.misprint]\nmerged = [[0, 0, 1, 1]]", "1: neighbours along a row or a column"),
        ("[effects.specks]\nradius_mm = [0.2, 0.1]", "the smaller one first"),
        ("[effects.specks]\nradius_mm = [0.2, 1]", "at most half of gel.pitch_mm"),
        ("[effects.smears]\nrandom = 5000", "0 to 1000 patches"),
        ("[[effects.smears.patches]]\nhalf_size_px = [0, 3]", "0.5 to 10000 px"),
        ("[[effects.smears.patches]]\nfrom_s = 2\nuntil_s = 1", "after from_s"),
        ("[[effects.smears.patches]]\nviews = \"top\"", "unknown variant `top`"),
        ("[effects.dropped_frames]\nrate = 1", "0 to 0.95"),
        ("[effects.uneven_light]\ngain = -1", "0 to 10"),
    ];
    for (text, expected) in cases {
        let found = refusal(text);
        assert!(found.contains(expected), "{text:?} gave {found:?}");
    }
}

#[test]
fn the_gels_surface_lies_behind_the_layers() {
    let mut near = Scene::preset("640x480-25-refraction").unwrap();
    near.gel.surface_mm = 22.9;
    let found = near.validate().unwrap_err();
    assert!(
        matches!(found, SceneError::BeforeGel { row: 0, col: 0, within_mm } if (within_mm + 0.1).abs() < 1e-9)
    );
    assert!(found.to_string().contains("behind the last interface"), "{found}");
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
