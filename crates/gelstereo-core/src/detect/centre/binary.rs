//! The paper's centre: the mean position of a component's pixels.

use super::{CentreRung, Components};
use crate::detect::markers::Markers;
use crate::params::DetectParams;

/// Means of components, with one variance for all.
#[derive(Clone, Debug)]
pub(in crate::detect) struct BinaryCentroid {
    variance_px2: f64,
}

impl BinaryCentroid {
    /// Creates the rung from its settings.
    pub fn new(params: &DetectParams) -> Self {
        Self { variance_px2: params.centre_sigma_px * params.centre_sigma_px }
    }
}

impl CentreRung for BinaryCentroid {
    fn centre_components(&mut self, found: &mut Components<'_>, out: &mut Markers) {
        found.push_means(self.variance_px2, out);
    }

    fn window_variance_px2(&self, _: u8) -> f64 {
        self.variance_px2
    }
}
