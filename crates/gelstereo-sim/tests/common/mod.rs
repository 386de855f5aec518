//! Scenes and poses that several test files use.
#![allow(dead_code, clippy::unwrap_used)]

use gelstereo_core::math::{DVec2, DVec3, Pose, so3};
use gelstereo_sim::{ContactState, Effects, Scene, Shape, Simulator, Truth};

/// The default gel under a part, with the rigid imprint only.
pub fn rigid(indenter: Shape) -> Scene {
    Scene { indenter: Some(indenter), ..Scene::default() }
}

pub fn with_effects(indenter: Shape, effects: Effects) -> Scene {
    Scene { indenter: Some(indenter), effects, ..Scene::default() }
}

pub fn simulator(scene: &Scene) -> Simulator {
    Simulator::new(scene, None).unwrap()
}

pub fn truth(scene: &Scene, contact: Option<&ContactState>) -> Truth {
    let mut truth = Truth::default();
    simulator(scene).truth(contact, &mut truth);
    truth
}

pub fn rest(scene: &Scene) -> Truth {
    truth(scene, None)
}

/// The object's origin over the gel's centre, moved sideways by `offset`, and turned; pressed `press_mm`
/// deep.
pub fn press(scene: &Scene, rotation: DVec3, offset: DVec2, press_mm: f64) -> ContactState {
    let at = DVec2::from_array(scene.gel.centre_mm) + offset;
    let pose = Pose { rotation: so3::exp(rotation), translation_mm: at.extend(0.0) };
    ContactState::pressed(simulator(scene).pressed(pose, press_mm).unwrap())
}

/// Both views of the rest frame.
pub fn images(scene: &Scene, frame: u64) -> [Vec<u8>; 2] {
    let mut simulator = simulator(scene);
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    simulator.truth(None, &mut truth);
    simulator.render(&truth, frame, &mut left, &mut right);
    [left, right]
}

pub fn xy(p: DVec3) -> DVec2 {
    p.truncate()
}
