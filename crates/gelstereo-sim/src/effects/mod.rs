//! What a real gel, print and camera do beyond the rigid imprint; each effect acts only when a scene lists it.
//!
//! An effect that is absent costs nothing and draws no random number, so the others' bits do not depend on it:
//! every stream is keyed by (seed, effect's name). On the gel: [`Shoulder`], [`Spread`], [`Drag`]. In the print:
//! [`Misprint`], [`Specks`]. On the images, in this order: [`Grain`], [`UnevenLight`], [`Smears`], [`Defocus`],
//! [`SensorNoise`]. On the way: [`DroppedFrames`]. Lens distortion and refraction are the rig's own.

mod blur;
mod drag;
mod drops;
mod grain;
mod light;
mod misprint;
mod noise;
mod shoulder;
mod smear;
mod specks;
mod spread;

pub use blur::Defocus;
pub use drag::Drag;
pub use drops::DroppedFrames;
pub use grain::Grain;
pub use light::UnevenLight;
pub use misprint::Misprint;
pub use noise::SensorNoise;
pub use shoulder::Shoulder;
pub use smear::{Patch, Smears, Views};
pub use specks::Specks;
pub use spread::Spread;

pub(crate) use blur::Blur;
pub(crate) use drag::Grip;
pub(crate) use grain::Texture;
pub(crate) use light::Gain;
pub(crate) use misprint::{Bridge, Print};
pub(crate) use noise::Noise;
pub(crate) use smear::SmearsOfView;
pub(crate) use specks::Speck;

use crate::scene::{Gel, SceneError};

/// Effects; `None` is off. An empty table (`[effects.shoulder]`) turns one on with its defaults.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Effects {
    /// The gel sags softly beside the contact.
    pub shoulder: Option<Shoulder>,
    /// The gel that a part displaces moves sideways.
    pub spread: Option<Spread>,
    /// The surface follows the part's shear and twist.
    pub drag: Option<Drag>,
    /// Dots beside their places, of other sizes, or merged.
    pub misprint: Option<Misprint>,
    /// Dirt on the gel.
    pub specks: Option<Specks>,
    /// Grain of the paint.
    pub grain: Option<Grain>,
    /// Light that is not the same everywhere.
    pub uneven_light: Option<UnevenLight>,
    /// Patches that hide markers for a while.
    pub smears: Option<Smears>,
    /// Blur of the lens.
    pub defocus: Option<Defocus>,
    /// Noise of the image sensor.
    pub sensor_noise: Option<SensorNoise>,
    /// Frames that never arrive.
    pub dropped_frames: Option<DroppedFrames>,
}

impl Effects {
    /// Those that act on the gel, with their defaults: what a grasp looks like to a perfect camera.
    #[must_use]
    pub fn of_gel() -> Self {
        Self {
            shoulder: Some(Shoulder::default()),
            spread: Some(Spread::default()),
            drag: Some(Drag::default()),
            ..Self::default()
        }
    }

    /// Checks the effects that are listed.
    ///
    /// # Errors
    /// [`SceneError::Invalid`] naming the setting, or [`SceneError::NoSuchMarker`].
    pub fn validate(&self, gel: &Gel) -> Result<(), SceneError> {
        self.shoulder.as_ref().map_or(Ok(()), Shoulder::validate)?;
        self.spread.as_ref().map_or(Ok(()), Spread::validate)?;
        self.drag.as_ref().map_or(Ok(()), Drag::validate)?;
        self.misprint.as_ref().map_or(Ok(()), |misprint| misprint.validate(gel))?;
        self.specks.as_ref().map_or(Ok(()), |specks| specks.validate(gel))?;
        self.grain.as_ref().map_or(Ok(()), Grain::validate)?;
        self.uneven_light.as_ref().map_or(Ok(()), UnevenLight::validate)?;
        self.smears.as_ref().map_or(Ok(()), Smears::validate)?;
        self.defocus.as_ref().map_or(Ok(()), Defocus::validate)?;
        self.sensor_noise.as_ref().map_or(Ok(()), SensorNoise::validate)?;
        self.dropped_frames.as_ref().map_or(Ok(()), DroppedFrames::validate)
    }
}

/// A decay length that the lattice solver is made for.
fn check_decay(name: &'static str, thicknesses: f64) -> Result<(), SceneError> {
    let ok = (0.01..=4.0).contains(&thicknesses);
    SceneError::check(ok, name, thicknesses, "0.01 to 4 gel thicknesses")
}
