//! Half-space contacts with closed-form solutions.
//!
//! Near a contact, a layer behaves as a half-space if it is much thicker than the contact is wide.
//! Markers are too far from the contact for that, so these solutions are references and quick estimates.
//! Tractions are in units of Young's modulus, and forces in Young's modulus times mm². Equations: K. L.
//! Johnson, Contact Mechanics (1985), chapters 3, 4, 5 and 7.

use core::f64::consts::PI;
use gelstereo_core::math::{DVec2, asin, cbrt, sqrt};

/// A half-space with its Poisson's ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    /// Poisson's ratio, 0 to 0.5.
    pub poisson_ratio: f64,
}

impl HalfSpace {
    /// E / (1 - ν²), over E.
    #[must_use]
    pub fn plane_modulus(&self) -> f64 {
        1.0 / (1.0 - self.poisson_ratio * self.poisson_ratio)
    }

    /// Shear modulus over E.
    #[must_use]
    pub fn shear_modulus(&self) -> f64 {
        0.5 / (1.0 + self.poisson_ratio)
    }

    /// Motion under a unit force into the surface at distance `r_mm` > 0: into the surface and outwards
    /// (Boussinesq).
    #[must_use]
    pub fn boussinesq_mm(&self, r_mm: f64) -> [f64; 2] {
        [1.0 / (PI * self.plane_modulus() * r_mm), self.outwards(1.0, r_mm)]
    }

    /// Motion under a unit force along x, at offset `at_mm` from it: along x, along y and into the
    /// surface (Cerruti).
    #[must_use]
    pub fn cerruti_mm(&self, at_mm: DVec2) -> [f64; 3] {
        let (nu, r) = (self.poisson_ratio, at_mm.length());
        let (scale, direction) = (1.0 / (2.0 * PI * self.shear_modulus() * r), at_mm / r);
        [
            scale * (1.0 - nu + nu * direction.x * direction.x),
            scale * nu * direction.x * direction.y,
            -self.outwards(1.0, r) * direction.x,
        ]
    }

    /// Outward motion at a distance from an axially symmetric load, with `force` acting within that
    /// distance.
    fn outwards(&self, force: f64, r_mm: f64) -> f64 {
        let nu = self.poisson_ratio;
        -(1.0 + nu) * (1.0 - 2.0 * nu) * force / (2.0 * PI * r_mm)
    }
}

/// A ball pressed into a half-space (Hertz).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hertz {
    /// The half-space.
    pub half_space: HalfSpace,
    /// The ball's radius, mm.
    pub radius_mm: f64,
    /// Indentation depth, mm.
    pub depth_mm: f64,
}

impl Hertz {
    /// Radius of the contact, mm.
    #[must_use]
    pub fn contact_mm(&self) -> f64 {
        sqrt(self.radius_mm * self.depth_mm)
    }

    /// Force over Young's modulus, mm².
    #[must_use]
    pub fn force_mm2(&self) -> f64 {
        4.0 / 3.0 * self.half_space.plane_modulus() * self.contact_mm() * self.depth_mm
    }

    /// Pressure at a distance from the axis.
    #[must_use]
    pub fn pressure(&self, r_mm: f64) -> f64 {
        let a = self.contact_mm();
        1.5 * self.force_mm2() / (PI * a * a) * sqrt((1.0 - r_mm * r_mm / (a * a)).max(0.0))
    }

    /// Motion of the surface at a distance from the axis, mm: into the surface and outwards.
    #[must_use]
    pub fn surface_mm(&self, r_mm: f64) -> [f64; 2] {
        let (a, r) = (self.contact_mm(), r_mm);
        let share = 1.0 - (r * r / (a * a)).min(1.0);
        let force = self.force_mm2() * (1.0 - share * sqrt(share));
        let aside = if r > 0.0 { self.half_space.outwards(force, r) } else { 0.0 };
        if r <= a {
            return [self.depth_mm - 0.5 * r * r / self.radius_mm, aside];
        }
        let sink = (2.0 * a * a - r * r) * asin(a / r) + a * sqrt(r * r - a * a);
        [sink / (PI * self.radius_mm), aside]
    }
}

/// A rigid flat cylinder pressed end on into a half-space without friction, or twisted on it while
/// sticking.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlatPunch {
    /// The half-space.
    pub half_space: HalfSpace,
    /// The cylinder's radius, mm.
    pub radius_mm: f64,
}

impl FlatPunch {
    /// Force per mm of depth, over Young's modulus, mm² per mm.
    #[must_use]
    pub fn stiffness_mm(&self) -> f64 {
        2.0 * self.half_space.plane_modulus() * self.radius_mm
    }

    /// Motion of the surface at a distance from the axis per mm of depth: into the surface and outwards.
    #[must_use]
    pub fn surface_per_mm(&self, r_mm: f64) -> [f64; 2] {
        let (a, r) = (self.radius_mm, r_mm);
        let force = self.stiffness_mm() * (1.0 - sqrt((1.0 - r * r / (a * a)).max(0.0)));
        let aside = if r > 0.0 { self.half_space.outwards(force, r) } else { 0.0 };
        [if r <= a { 1.0 } else { 2.0 / PI * asin(a / r) }, aside]
    }

    /// Torque per rad of twist, over Young's modulus, mm³ (Reissner and Sagoci).
    #[must_use]
    pub fn torque_mm3(&self) -> f64 {
        let a = self.radius_mm;
        16.0 / 3.0 * self.half_space.shear_modulus() * a * a * a
    }

    /// Motion of the surface about the axis per rad of twist.
    #[must_use]
    pub fn twisted_mm(&self, r_mm: f64) -> f64 {
        let (a, r) = (self.radius_mm, r_mm);
        if r <= a { r } else { 2.0 / PI * (r * asin(a / r) - a * sqrt(1.0 - a * a / (r * r))) }
    }
}

/// A ball that is pressed and then pulled aside by less than full slip (Cattaneo; Mindlin). The solution
/// neglects that slip is not parallel to the pull everywhere. This is exact at ν = 0 and a small error
/// otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CattaneoMindlin {
    /// The ball, pressed.
    pub hertz: Hertz,
    /// Coulomb's coefficient of friction.
    pub friction: f64,
    /// How far the ball is pulled along x, mm.
    pub shift_mm: f64,
}

impl CattaneoMindlin {
    /// Shift at full slip.
    #[must_use]
    pub fn slip_mm(&self) -> f64 {
        let HalfSpace { poisson_ratio } = self.hertz.half_space;
        let (g, a) = (self.hertz.half_space.shear_modulus(), self.hertz.contact_mm());
        3.0 * (2.0 - poisson_ratio) * self.friction * self.hertz.force_mm2() / (16.0 * g * a)
    }

    /// Radius of the sticking zone; 0 at full slip.
    #[must_use]
    pub fn stuck_mm(&self) -> f64 {
        self.hertz.contact_mm() * sqrt((1.0 - self.shift_mm / self.slip_mm()).max(0.0))
    }

    /// Traction along x at a distance from the axis.
    #[must_use]
    pub fn traction(&self, r_mm: f64) -> f64 {
        let (a, c) = (self.hertz.contact_mm(), self.stuck_mm());
        let inner =
            if r_mm < c { c / a * self.hertz.pressure(0.0) * sqrt(1.0 - r_mm * r_mm / (c * c)) } else { 0.0 };
        self.friction * (self.hertz.pressure(r_mm) - inner)
    }

    /// Force along x over Young's modulus, mm².
    #[must_use]
    pub fn force_mm2(&self) -> f64 {
        let share = self.stuck_mm() / self.hertz.contact_mm();
        self.friction * self.hertz.force_mm2() * (1.0 - share * share * share)
    }

    /// Shift for a force along x: the inverse of [`Self::force_mm2`].
    #[must_use]
    pub fn shift_of_force_mm(&self, force_mm2: f64) -> f64 {
        let share = (1.0 - force_mm2 / (self.friction * self.hertz.force_mm2())).max(0.0);
        let root = cbrt(share);
        self.slip_mm() * (1.0 - root * root)
    }
}
