//! Image of a blurred disc and its derivatives, by distance from its centre.

use crate::math::{ceil, cos, exp};
use alloc::vec::Vec;
use core::f64::consts::PI;

/// Nodes per blur: with linear interpolation the share is accurate to 1 / 32² / 8 · 0.24 = 3e-5.
const PER_BLUR: f64 = 32.0;
/// Blurs beyond the edge at which nothing is left: Φ(-6) = 1e-9.
const REACH: f64 = 6.0;

/// Blurs at which the Gaussian is below 1e-17 of its height.
const TOO_FAR: f64 = 9.0;

/// Values of a blurred disc of contrast 1 at one distance from its centre.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Share {
    /// Share of the contrast.
    pub inside: f64,
    /// Its derivatives with respect to distance, radius and blur, 1/px.
    pub by_distance: f64,
    pub by_radius: f64,
    pub by_blur: f64,
}

/// Limits on nodes and on angles of half a turn, for the radii and blurs in use.
const MAX_NODES: usize = 1408;
const MAX_ANGLES: usize = 160;

/// A table of [`Share`] over the distance.
#[derive(Clone, Debug, Default)]
pub(super) struct Disc {
    step_px: f64,
    nodes: Vec<Share>,
    cosines: Vec<f64>,
}

impl Disc {
    /// Computes the table for a disc of this radius with Gaussian blur.
    ///
    /// Increasing the radius adds a ring. With d² + r² - 2 d r cos t the squared distance to its points,
    /// dS/dr is the integral of the Gaussian over the ring. dS/dd is minus the integral of the Gaussian
    /// times cos t, for the outline's normal. Both are sums over equal angles, which converge quickly for
    /// periodic functions. S is the integral of dS/dd, and dS/db = b ∇²S.
    pub fn draw(&mut self, radius_px: f64, blur_px: f64) {
        let step_px = blur_px / PER_BLUR;
        let count = (ceil((radius_px + REACH * blur_px) / step_px) as usize + 2).min(MAX_NODES);
        // Half a turn: the other half is its mirror image.
        let angles = (ceil(4.0 * radius_px / blur_px) as usize + 8).min(MAX_ANGLES);
        let per_blur2 = 1.0 / (blur_px * blur_px);
        let scale = radius_px * per_blur2 / angles as f64;
        let too_far2 = (TOO_FAR * blur_px) * (TOO_FAR * blur_px);
        self.step_px = step_px;
        self.cosines.clear();
        self.cosines.reserve(MAX_ANGLES);
        self.cosines.extend((0..angles).map(|k| cos(PI * (k as f64 + 0.5) / angles as f64)));
        self.nodes.clear();
        self.nodes.reserve(MAX_NODES);
        for k in 0..count {
            let d = k as f64 * step_px;
            let (mut even, mut odd) = (0.0, 0.0);
            // Cosines decrease, so distances increase: all later points are even farther.
            for cosine in &self.cosines {
                let apart2 = d * d + radius_px * radius_px - 2.0 * d * radius_px * cosine;
                if apart2 > too_far2 {
                    break;
                }
                let density = exp(-0.5 * apart2 * per_blur2);
                even += density;
                odd += density * cosine;
            }
            let (by_radius, by_distance) = (scale * even, -scale * odd);
            self.nodes.push(Share { by_radius, by_distance, ..Share::default() });
        }
        let nodes = &mut self.nodes;
        for k in (0..count - 1).rev() {
            let mean = 0.5 * (nodes[k].by_distance + nodes[k + 1].by_distance);
            nodes[k].inside = nodes[k + 1].inside - mean * step_px;
        }
        for k in 1..count - 1 {
            let bend = (nodes[k + 1].by_distance - nodes[k - 1].by_distance) / (2.0 * step_px);
            nodes[k].by_blur = blur_px * (bend + nodes[k].by_distance / (k as f64 * step_px));
        }
        nodes[0].by_blur = nodes[1].by_blur;
    }

    pub fn at(&self, distance_px: f64) -> Share {
        let place = distance_px / self.step_px;
        let first = place as usize;
        if first + 1 >= self.nodes.len() {
            return Share::default();
        }
        let (a, b, part) = (&self.nodes[first], &self.nodes[first + 1], place - first as f64);
        let between = |a: f64, b: f64| a + (b - a) * part;
        Share {
            inside: between(a.inside, b.inside),
            by_distance: between(a.by_distance, b.by_distance),
            by_radius: between(a.by_radius, b.by_radius),
            by_blur: between(a.by_blur, b.by_blur),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::hypot;

    /// The share by brute force: the disc's points on a fine grid, weighted by the Gaussian.
    fn sampled(radius_px: f64, blur_px: f64, distance_px: f64) -> f64 {
        let (step, half) = (0.02, (radius_px / 0.02) as i32 + 1);
        let mut sum = 0.0;
        for y in -half..=half {
            for x in -half..=half {
                let (x, y) = (f64::from(x) * step, f64::from(y) * step);
                if hypot(x, y) <= radius_px {
                    let apart2 = (x - distance_px) * (x - distance_px) + y * y;
                    sum += exp(-0.5 * apart2 / (blur_px * blur_px));
                }
            }
        }
        sum * step * step / (2.0 * PI * blur_px * blur_px)
    }

    fn disc(radius_px: f64, blur_px: f64) -> Disc {
        let mut disc = Disc::default();
        disc.draw(radius_px, blur_px);
        disc
    }

    /// Tolerance: the error of counting grid points is about the outline's length times step^1.5 over the
    /// area.
    #[test]
    fn shares_and_derivatives_are_those_of_a_sampled_disc() {
        let h = 0.01;
        for (radius, blur) in [(1.5, 0.95), (4.25, 0.6), (4.25, 1.5)] {
            let [here, larger, smaller] = [radius, radius + h, radius - h].map(|r| disc(r, blur));
            let [wider, sharper] = [blur + h, blur - h].map(|b| disc(radius, b));
            for distance in [0.0, 0.7, radius - 0.4, radius, radius + 0.8] {
                let share = here.at(distance);
                assert!((share.inside - sampled(radius, blur, distance)).abs() < 2e-3);
                let slope = |a: &Disc, b: &Disc| (a.at(distance).inside - b.at(distance).inside) / (2.0 * h);
                assert!((share.by_radius - slope(&larger, &smaller)).abs() < 2e-3);
                assert!((share.by_blur - slope(&wider, &sharper)).abs() < 2e-3);
            }
        }
    }
}
