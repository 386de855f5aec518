//! Weight of a point at a distance from the part, and likelihood of that distance.
//!
//! The gel is on the part or free beside it, and never inside it. Coarse passes are for convergence: their
//! weights have one width and no exponential. In the final steps and the evidence, every marker is a draw
//! from a mixture of contact, free gel and outliers. Markers that are not salient have their own shares.
//! Some of them are in contact at the rim; without them, only markers raised by noise would be used there.

use crate::math::{exp_nonpositive, ln};
use core::f64::consts::FRAC_1_SQRT_2;
use core::ops::RangeInclusive;

/// Standard deviations from which contact is excluded: its density, e^-32 of the maximum, is far below
/// that of outliers.
const NEVER: f64 = 8.0;
/// 1 / √(2 π).
const FRAC_1_SQRT_TAU: f64 = 0.398_942_280_401_432_7;
/// Smallest outlier share, even where no outliers are expected: a frame has some 600 markers, and one of
/// them may be wrong.
pub(super) const MIN_OUTLIERS: f64 = 1e-3;
/// Outliers are distributed over this range.
pub(super) const STRAY_MM: f64 = 3.0;

/// Weight and cost of a point in a coarse pass, at r = d / s: Geman and McClure's (1985) outside, Huber's
/// (1964) inside.
#[inline]
pub(super) fn coarse_pressed(r: f64) -> (f64, f64) {
    if r > 0.0 {
        let w = 1.0 / (1.0 + r * r);
        (w * w, r * r * w)
    } else {
        coarse_unpressed(r)
    }
}

/// The same for an unpressed marker. Deep inside the part its weight is zero: outliers occur there, too.
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

/// Depth inside the part, in widths, from which a point of a coarse pass is an outlier.
const DEEP: f64 = 3.0;

/// Normal density and tail at a distance, independent of the shares: one distance is used with many shares.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bell {
    /// Density of contact, per mm; 0 where contact is excluded.
    pub density: f64,
    /// erfc(|r| / √2).
    tail: f64,
}

impl Bell {
    /// Contact is excluded.
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

/// Distribution of markers that are not in contact.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loose {
    /// Inlier share.
    good: f64,
    /// Density of free gel, per mm, without contact.
    free: f64,
    /// Density of outliers, per mm.
    stray: f64,
    /// Largest height of free gel over the part.
    reach_mm: f64,
}

impl Loose {
    /// Inliers are free up to `reach_mm` over the part; outliers are distributed over `stray_mm`.
    pub fn new(outliers: f64, reach_mm: f64, stray_mm: f64) -> Self {
        let good = 1.0 - outliers;
        Self { good, free: good / reach_mm, stray: outliers.max(MIN_OUTLIERS) / stray_mm, reach_mm }
    }

    /// The mixture for a share `contact` of the inliers in contact.
    #[inline]
    pub fn with(&self, contact: f64) -> Mixture {
        let Self { good, free, stray, reach_mm } = *self;
        Mixture { contact: contact * good, free: (1.0 - contact) * free, stray, reach_mm }
    }
}

/// Mixture from which a marker is drawn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mixture {
    contact: f64,
    /// Densities of free gel outside the part and of outliers, per mm.
    free: f64,
    stray: f64,
    /// Largest height of free gel over the part.
    reach_mm: f64,
}

impl Mixture {
    /// Contact probability of the marker, and the mixture's density, per mm, at a distance with its bell.
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

    /// Weight of a marker that cannot be in contact, and the mixture's density. The weight pushes it out
    /// of the part.
    #[inline]
    pub fn free(&self, d_mm: f64, sigma_mm: f64) -> (f64, f64) {
        if d_mm >= 0.0 {
            return (0.0, self.free_density());
        }
        let r = d_mm / sigma_mm;
        let good = self.free * exp_nonpositive(-0.5 * r * r);
        (good / (good + self.stray), good + self.stray)
    }

    /// Density over the part, out of reach of contact.
    #[inline]
    pub fn free_density(&self) -> f64 {
        self.free + self.stray
    }
}

/// Negative logarithm of a product of densities, taken for several factors at once, since logarithms are
/// slow.
pub(super) struct Likelihood {
    product: f64,
    cost: f64,
}

impl Likelihood {
    /// Range of the product without a logarithm.
    const ONE_LOGARITHM: RangeInclusive<f64> = 1e-100..=1e100;

    /// Starts from a previous cost.
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

/// erfc(r / √2) / exp(-r²/2) for r ≥ 0, accurate to 2.5e-5 of erfc (Abramowitz and Stegun 7.1.25).
#[inline]
fn scaled_tail(r: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.47047 * FRAC_1_SQRT_2 * r);
    t * (0.348_024_2 + t * (-0.095_879_8 + t * 0.747_855_6))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{erfc, exp};

    /// The density of free gel is uniform from the part to its reach, blurred by noise: half at the part's
    /// surface.
    #[test]
    fn free_gel_begins_at_the_part() {
        let (sigma_mm, reach_mm) = (0.03, 4.0);
        let mixture = Loose::new(0.1, reach_mm, 10.0).with(0.0);
        let stray = mixture.at(2.0 * reach_mm, Bell::NONE).1;
        for k in -70..=70 {
            let r = 0.1 * f64::from(k);
            let (touches, all) = mixture.at(r * sigma_mm, Bell::at(r * sigma_mm, sigma_mm));
            let expected = 0.9 / reach_mm * 0.5 * erfc(-r * FRAC_1_SQRT_2);
            assert_eq!(touches, 0.0);
            // The tail's own error.
            assert!((all - stray - expected).abs() < 2.5e-5 * 0.9 / reach_mm, "{r}: {all} {expected}");
        }
    }

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
