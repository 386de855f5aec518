//! How much a point counts at a distance from the part, and how well the distance is explained.
//!
//! The gel lies on the part or hangs beside it, and never lies in it. Coarse looks are for convergence: their weights
//! have one width and no exponential. The last steps and the evidence are for the answer: every marker is a draw from a
//! mixture of contact, free gel and outlier. Markers that are not salient have their own shares; at the rim of a contact
//! some of them touch, and without them the salient ones would be those that noise has raised.

use crate::math::{exp_nonpositive, ln};
use core::f64::consts::FRAC_1_SQRT_2;
use core::ops::RangeInclusive;

/// No contact is this many standard deviations off: its density, e^-32 of the greatest, is far below that of outliers.
const NEVER: f64 = 8.0;
/// 1 / √(2 π).
const FRAC_1_SQRT_TAU: f64 = 0.398_942_280_401_432_7;
/// There may be some even where none are expected.
pub(super) const MIN_OUTLIERS: f64 = 1e-4;
/// Outliers are spread over this much.
pub(super) const STRAY_MM: f64 = 3.0;

/// Weight and cost of a point of a coarse look, at r = d / s: outside Geman and McClure's (1985), inside Huber's (1964).
#[inline]
pub(super) fn coarse_pressed(r: f64) -> (f64, f64) {
    if r > 0.0 {
        let w = 1.0 / (1.0 + r * r);
        (w * w, r * r * w)
    } else {
        coarse_unpressed(r)
    }
}

/// The same for a marker that nothing presses. Deep in the part it says no more: outliers are there, too.
#[inline]
pub(super) fn coarse_unpressed(r: f64) -> (f64, f64) {
    if r > 0.0 {
        (0.0, 0.0)
    } else if r > -1.0 {
        (1.0, r * r)
    } else if r > -DEEP {
        (-1.0 / r, -2.0 * r - 1.0)
    } else {
        (0.0, 2.0 * DEEP - 1.0)
    }
}

/// Widths within the part from which a coarse look takes a point for an outlier.
const DEEP: f64 = 3.0;

/// What a normal distribution says of a distance, whatever the shares: of one distance shares are asked for again and again.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bell {
    /// Density of contact, per mm, 0 where there is never any.
    pub density: f64,
    /// erfc(|r| / √2).
    tail: f64,
}

impl Bell {
    /// Where there is never contact.
    pub const NONE: Self = Self { density: 0.0, tail: 0.0 };

    #[inline]
    pub fn at(d_mm: f64, sigma_mm: f64) -> Self {
        let per_mm = 1.0 / sigma_mm;
        let r = d_mm.abs() * per_mm;
        if r > NEVER {
            return Self::NONE;
        }
        let near = exp_nonpositive(-0.5 * r * r);
        Self { density: near * (per_mm * FRAC_1_SQRT_TAU), tail: near * scaled_tail(r) }
    }
}

/// Where markers are that do not touch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loose {
    /// Share of those that are no outliers.
    good: f64,
    /// Density of free gel, per mm, of nothing else.
    free: f64,
    /// Density of outliers, per mm.
    stray: f64,
    /// Free gel ends there.
    reach_mm: f64,
}

impl Loose {
    /// What is no outlier hangs up to `reach_mm` over the part; outliers are spread over `stray_mm`.
    pub fn new(outliers: f64, (reach_mm, stray_mm): (f64, f64)) -> Self {
        let good = 1.0 - outliers;
        Self { good, free: good / reach_mm, stray: outliers.max(MIN_OUTLIERS) / stray_mm, reach_mm }
    }

    /// `contact` of the points that are no outliers touch.
    #[inline]
    pub fn with(&self, contact: f64) -> Mixture {
        let Self { good, free, stray, reach_mm } = *self;
        Mixture { contact: contact * good, free: (1.0 - contact) * free, stray, reach_mm }
    }
}

/// Shares of the mixture that a marker is drawn from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mixture {
    contact: f64,
    /// Density of free gel outside of the part and of outliers, per mm.
    free: f64,
    stray: f64,
    /// Free gel ends there.
    reach_mm: f64,
}

impl Mixture {
    /// Probability that the marker touches, and the mixture's density, per mm, at a distance of which the bell is.
    #[inline]
    pub fn at(&self, d_mm: f64, bell: Bell) -> (f64, f64) {
        let touch = self.contact * bell.density;
        let free = if d_mm >= self.reach_mm {
            0.0
        } else if d_mm >= 0.0 {
            self.free * (1.0 - 0.5 * bell.tail)
        } else {
            0.5 * self.free * bell.tail
        };
        let all = touch + free + self.stray;
        (touch / all, all)
    }

    /// Weight of a marker that cannot touch, and the mixture's density; with the weight it is pushed out of the part, if it
    /// is within.
    #[inline]
    pub fn free(&self, d_mm: f64, sigma_mm: f64) -> (f64, f64) {
        if d_mm >= 0.0 {
            return (0.0, self.free_density());
        }
        let r = d_mm / sigma_mm;
        let good = self.free * exp_nonpositive(-0.5 * r * r);
        (good / (good + self.stray), good + self.stray)
    }

    /// Over the part, out of reach of contact.
    #[inline]
    pub fn free_density(&self) -> f64 {
        self.free + self.stray
    }
}

/// The negative logarithm of a product of densities; of several factors at once, for logarithms take long.
pub(super) struct Likelihood {
    product: f64,
    cost: f64,
}

impl Likelihood {
    /// Factors are multiplied as far as this.
    const ONE_LOGARITHM: RangeInclusive<f64> = 1e-100..=1e100;

    /// Of something that costs so much before.
    pub fn after(cost: f64) -> Self {
        Self { product: 1.0, cost }
    }

    #[inline]
    pub fn times(&mut self, density: f64) {
        self.product *= density;
        if !Self::ONE_LOGARITHM.contains(&self.product) {
            self.cost -= ln(self.product);
            self.product = 1.0;
        }
    }

    pub fn cost(&self) -> f64 {
        self.cost - ln(self.product)
    }
}

/// erfc(r / √2) / exp(-r²/2) for r ≥ 0, so that erfc is right to 2.5e-5 (Abramowitz and Stegun 7.1.25).
#[inline]
fn scaled_tail(r: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.47047 * FRAC_1_SQRT_2 * r);
    t * (0.348_024_2 + t * (-0.095_879_8 + t * 0.747_855_6))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{erfc, exp};

    #[test]
    fn a_bell_is_the_normal_law_and_its_tail() {
        let sigma_mm = 0.03;
        for k in 0..=800 {
            let r = 0.01 * f64::from(k);
            let bell = Bell::at(-r * sigma_mm, sigma_mm);
            let density = exp(-0.5 * r * r) * FRAC_1_SQRT_TAU / sigma_mm;
            assert!((bell.density / density - 1.0).abs() < 1e-13, "{r}");
            assert!((bell.tail - erfc(r * FRAC_1_SQRT_2)).abs() < 2.5e-5, "{r}");
        }
        assert_eq!(Bell::at(8.01 * sigma_mm, sigma_mm).density, 0.0);
    }
}
