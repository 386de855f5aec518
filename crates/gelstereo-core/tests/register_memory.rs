//! What the surface rungs keep from run to run changes no answer (hard case 34).
// A test may stop at what it did not expect.
#![allow(clippy::unwrap_used)]

use crate::problems;

use gelstereo_core::math::random::Stream;
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::Registrar;
use problems::follow::part;
use problems::{Problem, Sensing};

const RUNGS: [RegisterMethod; 2] = [RegisterMethod::SurfaceClose, RegisterMethod::SurfaceSearch];

fn params(method: RegisterMethod) -> RegisterParams {
    RegisterParams { method, ..Default::default() }
}

#[test]
fn row_34_surface_rungs_give_the_same_bits_whatever_ran_between() {
    let (part, template) = &part("key");
    let mut random = Stream::new(21, "bits");
    let (a, b) =
        (Problem::press(part, Sensing::GOOD, &mut random), Problem::press(part, Sensing::NOISY, &mut random));
    for method in RUNGS {
        let mut registrar = Registrar::new(&params(method));
        let mut digest =
            |p: &Problem| registrar.register(&p.contact(), template, &p.t_sensor_object).unwrap().digest();
        let (first, other, again) = (digest(&a), digest(&b), digest(&a));
        assert_eq!(first, again);
        assert_ne!(first, other);
    }
}

#[test]
fn row_34_other_settings_in_the_same_memory_give_the_bits_of_a_new_registrar() {
    let (part, template) = &part("key");
    let problem = Problem::press(part, Sensing::NOISY, &mut Stream::new(22, "settings"));
    let mut kept = Registrar::new(&params(RUNGS[0]));
    // Every rung after every other one.
    for k in 0..RUNGS.len() * RUNGS.len() {
        let settings = params(RUNGS[(k + k / RUNGS.len()) % RUNGS.len()]);
        kept.set_params(&settings);
        let digest = |registrar: &mut Registrar| {
            registrar.register(&problem.contact(), template, &problem.t_sensor_object).unwrap().digest()
        };
        assert_eq!(digest(&mut kept), digest(&mut Registrar::new(&settings)), "{:?}", settings.method);
    }
}
