//! From a contact to the pose of the part. The build script runs this too, for the digests to expect.

use crate::sensing::Outcome;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::Params;
use gelstereo_core::pipeline::{Frame, Touch};
use gelstereo_core::register::{Registrar, Registration, Template};

/// Registration, and its scratch memory.
pub struct Locator {
    registrar: Registrar,
    touch: Touch,
    template: Template,
}

impl Locator {
    /// Of a part whose template was made from its mesh beforehand, as bytes.
    pub fn new(params: &Params, template: &[u8]) -> Outcome<Self> {
        let template = Template::from_bytes(template)?;
        Ok(Self { registrar: Registrar::new(&params.register), touch: Touch::default(), template })
    }

    /// The part's pose from a frame in which it touches, and a guess.
    pub fn locate(&mut self, frame: &Frame, guess: &Pose) -> Outcome<Registration> {
        Ok(self.registrar.register(&self.touch.of(frame), &self.template, guess)?)
    }
}

/// A guess that is off by some 3 degrees and 0.25 mm.
pub fn guess(t_sensor_part: &Pose) -> Pose {
    let about = t_sensor_part.translation_mm;
    let turn = Pose::exp(DVec3::new(0.02, -0.03, 0.04), DVec3::ZERO);
    let turned = Pose::from_translation_mm(about) * turn * Pose::from_translation_mm(-about);
    Pose::from_translation_mm(DVec3::new(0.2, -0.1, 0.1)) * turned * *t_sensor_part
}
