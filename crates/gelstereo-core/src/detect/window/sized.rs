//! One eye for markers of any kind.

use super::classifier::{Eye, Spot};
use super::size::MarkerSize;
use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::Polarity;

/// An eye with as many lanes as windows of its kind need.
#[derive(Clone, Copy, Debug)]
pub(in crate::detect) enum Eyes {
    Small(Eye<16>),
    Large(Eye<32>),
}

impl Eyes {
    /// As [`Eye::new`].
    pub fn new(size: MarkerSize, polarity: Polarity) -> Self {
        if size.is_small() {
            Self::Small(Eye::new(size, polarity))
        } else {
            Self::Large(Eye::new(size, polarity))
        }
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
}
