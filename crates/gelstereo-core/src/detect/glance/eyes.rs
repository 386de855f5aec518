//! One eye for markers of any kind.

use super::{Eye, Kind, Spot};
use crate::detect::band::BandNoise;
use crate::detect::fit::Noise;
use crate::image::GrayView;
use crate::math::DVec2;

/// An eye with as many lanes as windows of its kind need.
#[derive(Clone, Copy, Debug)]
pub(in crate::detect) enum Eyes {
    Small(Eye<16>),
    Large(Eye<32>),
}

impl Eyes {
    /// As [`Eye::new`].
    pub fn new(kind: Kind, flip: u8) -> Self {
        if kind.is_small() { Self::Small(Eye::new(kind, flip)) } else { Self::Large(Eye::new(kind, flip)) }
    }

    /// As [`Eye::centre`].
    pub fn centre(&self, image: GrayView<'_>, at_px: DVec2) -> Option<Spot> {
        match self {
            Self::Small(eye) => eye.centre(image, at_px),
            Self::Large(eye) => eye.centre(image, at_px),
        }
    }

    /// As [`Eye::single`].
    pub fn single(&self, image: GrayView<'_>, at_px: DVec2) -> Option<Spot> {
        match self {
            Self::Small(eye) => eye.single(image, at_px),
            Self::Large(eye) => eye.single(image, at_px),
        }
    }

    /// As [`BandNoise::learn`].
    pub fn learn(
        &self,
        learned: &mut BandNoise,
        image: GrayView<'_>,
        noise: &Noise,
        centres_px: &[DVec2],
        bands: &[u8],
    ) {
        match self {
            Self::Small(eye) => learned.learn(image, eye, noise, centres_px, bands),
            Self::Large(eye) => learned.learn(image, eye, noise, centres_px, bands),
        }
    }
}
