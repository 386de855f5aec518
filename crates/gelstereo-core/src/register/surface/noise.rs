//! How much a point counts at a distance from the part, and how well the distance is explained.
//!
//! The gel lies on the part or hangs beside it, and never lies in it. Coarse looks are for convergence: their weights
//! have one width and no exponential. The last steps and the evidence are for the answer: every marker is a draw from a
//! mixture of contact, free gel and outlier. Markers that are not salient have their own shares; at the rim of a contact
//! some of them touch, and without them the salient ones would be those that noise has raised.

use crate::math::{exp, sqrt};

/// No contact is this many standard deviations off: its density, e^-32 of the greatest, is far below that of outliers.
const NEVER: f64 = 8.0;
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
    /// exp(-r² / 2), 0 where there is never contact.
    near: f64,
    /// erfc(|r| / √2).
    tail: f64,
}

impl Bell {
    /// Where there is never contact.
    pub const NONE: Self = Self { near: 0.0, tail: 0.0 };

    #[inline]
    pub fn at(d_mm: f64, sigma_mm: f64) -> Self {
        let r = (d_mm / sigma_mm).abs();
        if r > NEVER {
            return Self::NONE;
        }
        let near = exp(-0.5 * r * r);
        Self { near, tail: tail(r, near) }
    }
}

/// Shares of the mixture that a marker is drawn from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mixture {
    pub contact: f64,
    /// Density of free gel outside of the part and of outliers, per mm.
    free: f64,
    stray: f64,
    /// Whether free gel ends at `reach_mm`.
    reach_mm: f64,
}

impl Mixture {
    /// `contact` of the points that are no outliers touch; the others hang up to `reach_mm` over the part;
    /// outliers are spread over `stray_mm`.
    #[inline]
    pub fn new(contact: f64, outliers: f64, (reach_mm, stray_mm): (f64, f64)) -> Self {
        let good = 1.0 - outliers;
        Self {
            contact: contact * good,
            free: (1.0 - contact) * good / reach_mm,
            stray: outliers.max(1e-4) / stray_mm,
            reach_mm,
        }
    }

    /// Probability that the marker touches, and the mixture's density, per mm.
    #[inline]
    pub fn at(&self, d_mm: f64, sigma_mm: f64, bell: Bell) -> (f64, f64) {
        let touch = self.contact / (sigma_mm * sqrt(core::f64::consts::TAU)) * bell.near;
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
        let good = self.free * exp(-0.5 * r * r);
        (good / (good + self.stray), good + self.stray)
    }

    /// Over the part, out of reach of contact.
    #[inline]
    pub fn free_density(&self) -> f64 {
        self.free + self.stray
    }
}

/// erfc(r / √2) from r ≥ 0 and exp(-r²/2), to 1 % (Karagiannidis and Lioumpas 2007).
fn tail(r: f64, near: f64) -> f64 {
    if r < 1e-3 {
        return 1.0;
    }
    let x = r * core::f64::consts::FRAC_1_SQRT_2;
    (1.0 - exp(-1.98 * x)) * near / (1.135 * 1.772_453_850_905_516 * x)
}
