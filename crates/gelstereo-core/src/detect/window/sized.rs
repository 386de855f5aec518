//! Window classifier for markers of any size.

use super::classifier::{WindowClassifier, WindowMarker};
use super::size::MarkerSize;
use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::Polarity;

/// Window classifier with the number of lanes that its windows need.
#[derive(Clone, Copy, Debug)]
pub(in crate::detect) enum SizedClassifier {
    Small(WindowClassifier<16>),
    Large(WindowClassifier<32>),
}

impl SizedClassifier {
    /// As [`WindowClassifier::new`].
    pub fn new(size: MarkerSize, polarity: Polarity) -> Self {
        if size.is_small() {
            Self::Small(WindowClassifier::new(size, polarity))
        } else {
            Self::Large(WindowClassifier::new(size, polarity))
        }
    }

    /// As [`WindowClassifier::centre`].
    pub fn centre(&self, image: GrayView<'_>, at_px: DVec2) -> Option<WindowMarker> {
        match self {
            Self::Small(classifier) => classifier.centre(image, at_px),
            Self::Large(classifier) => classifier.centre(image, at_px),
        }
    }

    /// As [`WindowClassifier::single`].
    pub fn single(&self, image: GrayView<'_>, at_px: DVec2) -> Option<WindowMarker> {
        match self {
            Self::Small(classifier) => classifier.single(image, at_px),
            Self::Large(classifier) => classifier.single(image, at_px),
        }
    }
}
