//! On an elastic layer too nothing is allocated after the first frame.
#![allow(clippy::unwrap_used)]

use crate::common;
use crate::counting;

use common::{press, simulator, with_effects};
use counting::ALLOCATIONS;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_sim::effects::{ElasticLayer, LargeStrain, Relaxation};
use gelstereo_sim::{ContactState, Effects, Keyframe, OtherPart, Shape, Truth};

#[test]
fn row_35_frames_on_a_layer_allocate_nothing_after_the_first() {
    let effects = Effects {
        elastic_layer: Some(ElasticLayer::default()),
        relaxation: Some(Relaxation::default()),
        large_strain: Some(LargeStrain::default()),
        ..Effects::default()
    };
    let mut scene = with_effects(Shape::Sphere { radius_mm: 4.0 }, effects);
    scene.trajectory = [(0.0, -0.5, 0.0), (0.1, 0.6, 0.1), (0.2, 1.5, 0.3)]
        .map(|(time_s, depth, shear)| Keyframe {
            time_s,
            contact: ContactState {
                shear_mm: [shear, 0.0],
                ..press(&scene, DVec3::ZERO, DVec2::new(shear, 0.0), depth)
            },
        })
        .into();
    // The other part comes later, and stays.
    let other = scene.trajectory.iter().skip(1).copied().map(|mut key| {
        key.contact.t_sensor_object.translation_mm.y += 6.0;
        key
    });
    scene.others =
        vec![OtherPart { indenter: Shape::Sphere { radius_mm: 4.0 }, trajectory: other.collect() }];
    let mut simulator = simulator(&scene);
    let mut truth = Truth::default();
    // Nothing touches in the first frame.
    simulator.moment(simulator.contact(0).as_ref(), 0, &mut truth);
    let before = ALLOCATIONS.get();
    for frame in 1..simulator.frames() {
        let contact = simulator.contact(frame);
        simulator.moment(contact.as_ref(), frame as u64, &mut truth);
    }
    assert_eq!(ALLOCATIONS.get(), before);
}
