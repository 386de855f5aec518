//! An effect that is off is one that the scene never had: the same simulator, bit by bit, and so the same
//! work.
#![allow(clippy::unwrap_used)]

use crate::counting;
use crate::every_effect;

use counting::ALLOCATIONS;
use every_effect::{names, switched_off, with, without};
use gelstereo_sim::{Scene, Simulator, Truth};

/// As seen by cameras of a quarter of the size, which take less time.
fn small(scene: Scene) -> Scene {
    let mut scene = scene;
    for camera in [&mut scene.rig.left, &mut scene.rig.right] {
        for length in [&mut camera.fx_px, &mut camera.fy_px, &mut camera.cx_px, &mut camera.cy_px] {
            *length *= 0.25;
        }
        camera.width_px /= 4;
        camera.height_px /= 4;
    }
    scene
}

/// Everything that a simulator holds but its plan: tables, textures, scratch, settings.
fn state(simulator: &Simulator) -> String {
    let all = format!("{simulator:?}");
    all[all.find("surface_mm: ").unwrap()..].to_owned()
}

/// What there is to tell of the first frames of a scene.
#[derive(PartialEq)]
struct Run {
    frames: Vec<(Truth, Vec<u8>, Vec<u8>)>,
    built: String,
    left: String,
    allocations: usize,
}

fn run(scene: &Scene) -> Run {
    let mut simulator = Simulator::new(scene, None).unwrap();
    let built = state(&simulator);
    let mut frames = Vec::new();
    let before = ALLOCATIONS.get();
    for frame in 0..simulator.delivered().max(3) as u64 {
        let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
        simulator.moment(simulator.contact(0).as_ref(), frame, &mut truth);
        simulator.render(&truth, frame, &mut left, &mut right);
        frames.push((truth, left, right));
    }
    let allocations = ALLOCATIONS.get() - before;
    Run { frames, built, left: state(&simulator), allocations }
}

/// One test for all of them, so that nobody else allocates meanwhile.
#[test]
fn an_effect_that_is_off_leaves_the_simulator_of_a_scene_without_it() {
    let names = names();
    assert!(names.len() > 20);
    for effect in names {
        let [on, off, never] = [with, switched_off, without].map(|scene| run(&small(scene(effect))));
        // Streams are keyed by seed, effect and frame and made anew for each image; what else is drawn, is
        // drawn into tables and textures, which the state shows. So equal states draw the same numbers.
        assert!(off.built == never.built, "{effect}: not built the same");
        assert!(off.frames == never.frames, "{effect}: other bits");
        assert!(off.left == never.left, "{effect}: leaves something behind");
        assert_eq!(off.allocations, never.allocations, "{effect}");
        // And the comparison would tell: an effect that is on is built, but for one that moves a choice
        // between two formulas.
        assert!(on.built != never.built, "{effect} is seen nowhere");
    }
}
