//! After the first frame nothing is allocated, whatever acts.
#![allow(clippy::unwrap_used)]

use crate::counting;

use counting::ALLOCATIONS;
use gelstereo_sim::{Scene, Simulator, Truth};

/// Allocations of every frame but the first.
fn later_allocations(mut simulator: Simulator) -> usize {
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    let mut before = 0;
    for frame in 0..simulator.frames() {
        let contact = simulator.contact(frame);
        simulator.moment(contact.as_ref(), frame as u64, &mut truth);
        simulator.render(&truth, frame as u64, &mut left, &mut right);
        if frame == 0 {
            before = ALLOCATIONS.get();
        }
    }
    ALLOCATIONS.get() - before
}

#[test]
fn row_35_frames_after_the_first_allocate_nothing() {
    let mut scene: Scene = toml::from_str(include_str!("../../../scenes/grasp_cylinder.toml")).unwrap();
    scene.trajectory[0].time_s = 0.8; // few frames will do; the first does not touch
    scene.trajectory[2].contact.twist_rad = 0.1;
    let mesh = scene.indenter.as_ref().and_then(|shape| shape.mesh(0.05)).unwrap();
    let solid = Simulator::new(&scene, None).unwrap();
    scene.indenter = Some(gelstereo_sim::Shape::Mesh { path: "peg.stl".into(), units: "mm".into() });
    let meshed = Simulator::new(&scene, Some(&mesh)).unwrap();
    let mut rough: Scene = toml::from_str(include_str!("../../../scenes/rough_ride.toml")).unwrap();
    rough.rig.layers = Scene::preset("640x480-25-refraction").unwrap().rig.layers;
    let rough = Simulator::new(&rough, None).unwrap();
    let quick: Scene = toml::from_str(include_str!("../../../scenes/quick_slip.toml")).unwrap();
    let quick = Simulator::new(&quick, None).unwrap();
    assert!(ALLOCATIONS.get() > 0, "the counter counts");
    let counts = [solid, meshed, rough, quick].map(later_allocations);
    assert_eq!(counts, [0, 0, 0, 0]);
}
