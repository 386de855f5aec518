//! What tests of localization from frame to frame share.

use super::gel::Gel;
use super::parts::{Part, parts};
use super::{Problem, REST_MM, Sensing};
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Localizer, Located, Template};

/// Those that follow.
pub const METHODS: [RegisterMethod; 2] = [RegisterMethod::SurfaceClose, RegisterMethod::SurfaceSearch];

pub fn part(name: &str) -> (Part, Template) {
    let part = parts().into_iter().find(|part| part.name == name).unwrap();
    let template = Template::from_mesh(&part.mesh, 0.4, 1).unwrap();
    (part, template)
}

pub fn localizer(method: RegisterMethod, expected: &Pose) -> Localizer {
    Localizer::new(&RegisterParams { method, ..Default::default() }, expected)
}

pub fn sense(gel: &Gel, pose: Pose, random: &mut Stream) -> Problem {
    Problem::sense(gel, pose, Sensing::GOOD, random)
}

/// Turned about the middle of the gel, and shifted.
pub fn moved(pose: Pose, omega: DVec3, shift_mm: DVec3) -> Pose {
    let about = Pose::from_translation_mm(DVec3::new(0.0, 0.0, REST_MM));
    about * Pose::exp(omega, shift_mm) * about.inverse() * pose
}

/// To 2 degrees and 0.3 mm, or where a weak contact does not tell that, to five times the Cramér-Rao bound.
pub fn is_right(problem: &Problem, located: &Located) -> bool {
    let score = problem.score(&located.registration.t_sensor_object);
    score.is_success() || score.squared < 25.0 * score.observable as f64
}
