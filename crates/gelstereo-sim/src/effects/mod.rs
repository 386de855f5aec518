//! Effects of a real gel, print and camera beyond the rigid imprint; each acts only when a scene lists
//! it.
//!
//! An absent effect costs nothing and draws no random number. Each random stream is keyed by (seed,
//! effect's name), so the bits of the other effects do not depend on it. Gel: [`Shoulder`], [`Spread`],
//! [`Drag`], or [`ElasticLayer`] in their place, with [`Relaxation`] and [`LargeStrain`]. Print:
//! [`Misprint`], [`Wear`], [`Specks`]. Images, in this order: [`Grain`], [`UnevenLight`],
//! [`MotionBlur`], [`Defocus`], [`Smears`], [`ShotNoise`], [`SensorNoise`], [`Jpeg`]. Transport:
//! [`DroppedFrames`]. Lens distortion and refraction belong to the rig.

mod blur;
mod drag;
mod drops;
mod elastic_layer;
mod grain;
mod jpeg;
mod large_strain;
mod light;
mod misprint;
mod motion_blur;
mod noise;
mod optics;
mod relaxation;
mod shot;
mod shoulder;
mod smear;
mod specks;
mod spread;
mod wear;

pub use blur::Defocus;
pub use drag::Drag;
pub use drops::DroppedFrames;
pub use elastic_layer::ElasticLayer;
pub use grain::Grain;
pub use jpeg::Jpeg;
pub use large_strain::LargeStrain;
pub use light::UnevenLight;
pub use misprint::Misprint;
pub use motion_blur::MotionBlur;
pub use noise::SensorNoise;
pub use relaxation::Relaxation;
pub use shot::ShotNoise;
pub use shoulder::Shoulder;
pub use smear::{Patch, Smears, Views};
pub use specks::Specks;
pub use spread::Spread;
pub use wear::Wear;

pub(crate) use blur::Blur;
pub(crate) use drag::{Grip, Pull};
pub(crate) use grain::Texture;
pub(crate) use jpeg::Codec;
pub(crate) use light::Gain;
pub(crate) use misprint::{Bridge, Print};
pub(crate) use noise::{Noise, RUN};
pub(crate) use optics::{Optics, ellipse_bias_px};
pub(crate) use shot::Shots;
pub(crate) use shoulder::Sag;
pub(crate) use smear::SmearsOfView;
pub(crate) use specks::Speck;
pub(crate) use spread::Spreading;
pub(crate) use wear::Worn;

use crate::plan::{Bound, Effect, Facts, Switch};
use crate::scene::{Gel, SceneError};

/// The single list of effects: generates the fields of [`Effects`] and [`Switches`], and their methods.
macro_rules! effects {
    ($($(#[doc = $doc:literal])* $name:ident: $effect:ident,)*) => {
        /// Effects; `None` is off. An empty table (`[effects.shoulder]`) turns one on with its defaults.
        #[derive(Clone, Debug, Default, PartialEq)]
        #[cfg_attr(
            feature = "serde",
            derive(serde::Serialize, serde::Deserialize),
            serde(default, deny_unknown_fields)
        )]
        pub struct Effects {
            $($(#[doc = $doc])* pub $name: Option<$effect>,)*
        }

        impl Effects {
            /// Checks the listed effects.
            ///
            /// # Errors
            /// [`SceneError::Invalid`] naming the setting, [`SceneError::NoSuchMarker`], or
            /// [`SceneError::TwoModels`].
            pub fn validate(&self, gel: &Gel) -> Result<(), SceneError> {
                self.check_models()?;
                self.listed().try_for_each(|(_, effect)| effect.validate(gel))
            }

            /// The listed effects with their names.
            pub(crate) fn listed(&self) -> impl Iterator<Item = (&'static str, &dyn Effect)> {
                let all = [$((stringify!($name), self.$name.as_ref().map(|effect| effect as &dyn Effect)),)*];
                all.into_iter().filter_map(|(name, effect)| Some((name, effect?)))
            }

            /// Removes the effects whose names are off.
            pub(crate) fn remove(&mut self, off: &impl Fn(&str) -> bool) {
                $(if off(stringify!($name)) {
                    self.$name = None;
                })*
            }
        }

        /// Switches of the effects, `[switches]` in a file: `{ grain = "off" }`. Without a switch an
        /// effect is on, or auto if the scene states its requirements (`asked`).
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        #[cfg_attr(
            feature = "serde",
            derive(serde::Serialize, serde::Deserialize),
            serde(default, deny_unknown_fields)
        )]
        pub struct Switches {
            $($(#[doc = $doc])* pub $name: Option<Switch>,)*
            /// Refraction in the layers before the markers (`rig.layers`).
            pub refraction: Option<Switch>,
            /// Distortion of the lenses.
            pub lens_distortion: Option<Switch>,
            /// The centroid of a tilted disc's image is offset from the image of its centre.
            pub ellipse_bias: Option<Switch>,
        }

        impl Switches {
            /// Every switch with its effect's name.
            pub fn all(&self) -> impl Iterator<Item = (&'static str, Option<Switch>)> {
                let own = [self.refraction, self.lens_distortion, self.ellipse_bias];
                let own = Optics::ALL.into_iter().map(Optics::name).zip(own);
                [$((stringify!($name), self.$name),)*].into_iter().chain(own)
            }

            /// Mutable switch of an effect; `None` if no effect has that name.
            pub fn get_mut(&mut self, effect: &str) -> Option<&mut Option<Switch>> {
                let own = [&mut self.refraction, &mut self.lens_distortion, &mut self.ellipse_bias];
                let mut own = Optics::ALL.into_iter().map(Optics::name).zip(own);
                match effect {
                    $(stringify!($name) => Some(&mut self.$name),)*
                    _ => own.find(|(name, _)| *name == effect).map(|(_, switch)| switch),
                }
            }

            /// The switch of an effect; `None` if it is not set.
            #[must_use]
            pub fn of(&self, effect: &str) -> Option<Switch> {
                self.all().find(|&(name, _)| name == effect).and_then(|(_, switch)| switch)
            }
        }
    };
}

effects! {
    /// Soft shoulder of the gel beside the contact.
    shoulder: Shoulder,
    /// Sideways motion of the gel that a part displaces.
    spread: Spread,
    /// Motion of the surface with the part's shear and twist.
    drag: Drag,
    /// Gel as an elastic layer; replaces shoulder, spread and drag.
    elastic_layer: ElasticLayer,
    /// Viscoelastic relaxation of the elastic layer under load, and creep after release.
    relaxation: Relaxation,
    /// Large strains: contact with the displaced surface of the elastic layer.
    large_strain: LargeStrain,
    /// Printing errors: displaced dots, dots of other sizes, merged dots.
    misprint: Misprint,
    /// Wear: dots shrink from their rims.
    wear: Wear,
    /// Round specks of dust on the gel.
    specks: Specks,
    /// Grain of the paint.
    grain: Grain,
    /// Uneven illumination.
    uneven_light: UnevenLight,
    /// Patches of glare or dirt that hide markers temporarily.
    smears: Smears,
    /// Motion blur during the exposure.
    motion_blur: MotionBlur,
    /// Defocus blur of the lens.
    defocus: Defocus,
    /// Photon shot noise.
    shot_noise: ShotNoise,
    /// Gaussian noise of the image sensor, independent of brightness.
    sensor_noise: SensorNoise,
    /// JPEG compression of the images.
    jpeg: Jpeg,
    /// Dropped frames.
    dropped_frames: DroppedFrames,
}

impl Effects {
    /// Rejects approximations listed with the elastic layer, and refinements listed without it.
    fn check_models(&self) -> Result<(), SceneError> {
        let approximations = [
            ("shoulder", self.shoulder.is_some()),
            ("spread", self.spread.is_some()),
            ("drag", self.drag.is_some()),
        ];
        match approximations.into_iter().find(|&(_, listed)| listed && self.elastic_layer.is_some()) {
            Some((effect, _)) => return Err(SceneError::TwoModels { effect }),
            None if self.elastic_layer.is_some() => return Ok(()),
            None => {}
        }
        let refinements =
            [("relaxation", self.relaxation.is_some()), ("large_strain", self.large_strain.is_some())];
        match refinements.into_iter().find(|&(_, listed)| listed) {
            Some((effect, _)) => Err(SceneError::NeedsLayer { effect }),
            None => Ok(()),
        }
    }

    /// The gel effects with their defaults: a grasp as a perfect camera sees it.
    #[must_use]
    pub fn of_gel() -> Self {
        Self {
            shoulder: Some(Shoulder::default()),
            spread: Some(Spread::default()),
            drag: Some(Drag::default()),
            ..Self::default()
        }
    }
}

/// Checks that a decay length is within the lattice solver's range.
fn check_decay(name: &'static str, thicknesses: f64) -> Result<(), SceneError> {
    let ok = (0.01..=4.0).contains(&thicknesses);
    SceneError::check(ok, name, thicknesses, "0.01 to 4 gel thicknesses")
}

/// Upper bound of a refinement of the elastic layer: the full range of the layer's motion.
fn within_layer(facts: &Facts<'_>) -> Bound {
    let Some(layer) = &facts.scene.effects.elastic_layer else { return Bound::NONE };
    facts.moved(2.0 * layer.sideways_mm(facts), 2.0 * facts.touch.depth_mm)
}

/// Cells of the elastic layer.
fn cells_of_layer(facts: &Facts<'_>) -> f64 {
    facts.scene.effects.elastic_layer.as_ref().map_or(0.0, |layer| {
        let (_, grid, _) = layer.cells(&facts.scene.gel);
        (grid.rows * grid.cols) as f64
    })
}
