//! Light paths through flat layers, from a point to its image and back.
//!
//! Snell's law conserves n sin θ along a ray. The slope t = tan θ in air therefore gives the slope t κ in
//! every medium, κ = 1 / sqrt(n² + (n² - 1) t²). Let a point have height h before the camera (along the
//! normal) and distance ρ from the normal through the camera. Its slope is the only solution of ρ = t
//! (gap + Σ d κ), d the path's thickness in each medium. The camera sees the point where a camera without
//! layers would see the apparent point, which is nearer by Σ d (1 - κ) along the normal. See Agrawal,
//! Ramalingam, Taguchi and Chari, "A theory of multi-layer flat refractive geometry" (2012), who solve a
//! polynomial instead.

use super::Layers;
use crate::math::{DVec3, abs, sqrt};

/// Newton's method on the slope ends within this many steps, except for light grazing the first interface.
const MAX_STEPS: usize = 64;

/// A ray: origin and unit direction, opposite to the direction of light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts, millimetres.
    pub origin_mm: DVec3,
    /// Unit direction, away from the camera.
    pub direction: DVec3,
}

/// The layers before one camera, in that camera's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Refraction<'a> {
    pub(crate) layers: &'a Layers,
    /// Unit normal of the interfaces, away from the camera.
    pub(crate) normal: DVec3,
    /// Distance to the first interface, along the normal.
    pub(crate) gap_mm: f64,
}

impl Refraction<'_> {
    /// Slope in air of the light that reaches `point`; 0 for a point in air, before the first interface.
    /// `start` is an initial guess; 0 always works. `None` for total reflection.
    pub(crate) fn slope(&self, point: DVec3, start: f64) -> Option<f64> {
        let height = self.normal.dot(point);
        let below = height - self.gap_mm;
        if !(below > 0.0) {
            return Some(0.0);
        }
        let rho = (point - self.normal * height).length();
        self.solve(rho, below, start)
    }

    /// The point that a camera without layers would see at the pixel of `point`. `slope` is that of
    /// [`Self::slope`].
    pub(crate) fn apparent(&self, point: DVec3, slope: f64) -> DVec3 {
        let lift: f64 = self
            .media(self.normal.dot(point) - self.gap_mm)
            .map(|(d, n2)| d * (reduced(n2, slope) - 1.0))
            .sum();
        point + self.normal * lift
    }

    /// The vector g with d apparent = d point + normal (g · d point), by implicit differentiation of ρ =
    /// t (gap + Σ d κ).
    pub(crate) fn lift_gradient(&self, point: DVec3, slope: f64) -> DVec3 {
        let height = self.normal.dot(point);
        let mut left = height - self.gap_mm;
        if !(left > 0.0) {
            return DVec3::ZERO;
        }
        let (mut reach, mut gain, mut bend) = (self.gap_mm, self.gap_mm, 0.0);
        let mut here = 1.0; // κ of the medium in which the point lies
        for (thickness, n2) in self.stack() {
            if !(left >= 0.0) {
                break;
            }
            let (d, k) = (left.min(thickness), reduced(n2, slope));
            reach += d * k;
            gain += d * n2 * k * k * k;
            bend += d * (n2 - 1.0) * k * k * k;
            here = k;
            // A point on an interface belongs to the medium behind it.
            left = if left < thickness { -1.0 } else { left - thickness };
        }
        // The apparent height is a = gap + Σ d κ: da = κ dh - bend t dt, and gain dt = dρ - t κ dh.
        let across = (point - self.normal * height) / reach; // t times the unit vector of ρ
        let share = bend / gain;
        self.normal * (here * (1.0 + share * slope * slope) - 1.0) - across * share
    }

    /// The ray in the gel, from the last interface on, of a ray leaving the camera along `direction` (any
    /// length), and its slope in air. `None` if it does not meet the layers.
    pub(crate) fn ray(&self, direction: DVec3) -> Option<(Ray, f64)> {
        let ahead = self.normal.dot(direction);
        let across = direction / ahead - self.normal; // slope in air, a vector along the interface
        if !(ahead > 0.0 && across.is_finite()) {
            return None;
        }
        let slope = across.length();
        let (mut height, mut reach) = (self.gap_mm, self.gap_mm);
        for plate in &self.layers.plates {
            height += plate.thickness_mm;
            reach += plate.thickness_mm * reduced(plate.index * plate.index, slope);
        }
        let origin_mm = self.normal * height + across * reach;
        let index = self.layers.gel_index;
        let direction = self.normal + across * reduced(index * index, slope);
        origin_mm.is_finite().then(|| (Ray { origin_mm, direction: direction.normalize() }, slope))
    }

    /// Whether `point` lies behind the last interface.
    pub(crate) fn is_in_gel(&self, point: DVec3) -> bool {
        let plates: f64 = self.layers.plates.iter().map(|plate| plate.thickness_mm).sum();
        self.normal.dot(point) >= self.gap_mm + plates
    }

    /// The slope that reaches a point `rho` from the normal and `below` the first interface.
    ///
    /// ρ(t) is increasing and concave. Newton's method from below therefore never overshoots the root,
    /// and one step from above leads below it. `None` if the light would be parallel to the interface or
    /// does not arrive, which requires a camera touching the first interface.
    fn solve(&self, rho: f64, below: f64, start: f64) -> Option<f64> {
        let mut t = start;
        for _ in 0..MAX_STEPS {
            let (mut reach, mut gain) = (self.gap_mm, self.gap_mm);
            for (d, n2) in self.media(below) {
                let k = reduced(n2, t);
                reach += d * k;
                gain += d * n2 * k * k * k;
            }
            let step = (rho - t * reach) / gain;
            t = (t + step).max(0.0);
            // The error after a step is below 3/2 (step / t)² t.
            if abs(step) <= 1e-8 * t {
                return t.is_finite().then_some(t);
            }
        }
        None
    }

    /// Thickness and squared index of every medium between the first interface and `below` it.
    fn media(&self, below: f64) -> impl Iterator<Item = (f64, f64)> {
        let mut left = below.max(0.0);
        self.stack().map(move |(thickness, n2)| {
            let d = left.min(thickness);
            left -= d;
            (d, n2)
        })
    }

    /// Thickness and squared index of every medium behind the first interface.
    fn stack(&self) -> impl Iterator<Item = (f64, f64)> {
        let plates = self.layers.plates.iter().map(|plate| (plate.thickness_mm, plate.index * plate.index));
        let index = self.layers.gel_index;
        plates.chain(core::iter::once((f64::INFINITY, index * index)))
    }
}

/// κ: slope in a medium over slope in air. Exactly 1 in air.
fn reduced(n2: f64, slope: f64) -> f64 {
    1.0 / sqrt(n2 + (n2 - 1.0) * slope * slope)
}
