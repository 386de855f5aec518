//! Response of a pixel behind a blurring lens: the lens's Gaussian, integrated over the pixel's square.

use gelstereo_core::math::{ceil, erf, exp, sqrt};

/// The weights along one axis; the weights of the two axes multiply.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lens {
    pub(crate) sigma_px: f64,
}

impl Lens {
    /// Weight of a point `x_px` from the pixel's centre.
    pub(crate) fn point(self, x_px: f64) -> f64 {
        self.below(x_px + 0.5) - self.below(x_px - 0.5)
    }

    /// Weight of everything below `x_px`: the integral of [`Self::point`].
    pub(crate) fn edge(self, x_px: f64) -> f64 {
        self.ramp(x_px + 0.5) - self.ramp(x_px - 0.5)
    }

    /// Weight of a pixel of uniform brightness, `x_px` away: the mean of [`Self::point`] over it.
    pub(crate) fn pixel(self, x_px: f64) -> f64 {
        self.edge(x_px + 0.5) - self.edge(x_px - 0.5)
    }

    /// Variance along one axis, px²: the Gaussian's plus the square's.
    pub(crate) fn variance_px2(self) -> f64 {
        self.sigma_px * self.sigma_px + 1.0 / 12.0
    }

    /// Distance from a pixel's centre at which weights are cut off along each axis. Each side loses 2e-5
    /// of the weight at the usual 0.8 px, and 9e-5 at most.
    pub(crate) fn reach_px(self) -> f64 {
        0.5 + 3.75 * self.sigma_px
    }

    /// The same in whole pixels.
    pub(crate) fn reach(self) -> usize {
        ceil(self.reach_px()) as usize
    }

    /// The normal distribution function.
    fn below(self, x_px: f64) -> f64 {
        0.5 + 0.5 * erf(x_px / (self.sigma_px * core::f64::consts::SQRT_2))
    }

    /// Its integral.
    fn ramp(self, x_px: f64) -> f64 {
        let t = x_px / self.sigma_px;
        x_px * self.below(x_px) + self.sigma_px * exp(-0.5 * t * t) / sqrt(core::f64::consts::TAU)
    }
}
