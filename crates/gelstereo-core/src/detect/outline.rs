//! The polygon within which markers are.

use crate::math::DVec2;
use alloc::vec::Vec;

/// Polygon around the gel. Only positions inside it can be markers. With no corners it accepts every
/// position.
#[derive(Clone, Debug, Default)]
pub(in crate::detect) struct Outline {
    corners_px: Vec<DVec2>,
}

/// The outline with no corners.
pub(in crate::detect) static NO_OUTLINE: Outline = Outline { corners_px: Vec::new() };

impl Outline {
    /// `corners_px` are in coordinates of the whole image. Positions are later given in a part of the image
    /// whose first pixel is `origin_px`.
    pub fn new(corners_px: &[[f64; 2]], origin_px: DVec2) -> Self {
        Self { corners_px: corners_px.iter().map(|&corner| DVec2::from_array(corner) - origin_px).collect() }
    }

    /// Whether it has no corners.
    pub fn is_empty(&self) -> bool {
        self.corners_px.is_empty()
    }

    /// Whether a position is inside: a ray from it to the right crosses an odd number of edges.
    pub fn contains(&self, at_px: DVec2) -> bool {
        let Some(&last) = self.corners_px.last() else { return true };
        let mut from = last;
        let mut inside = false;
        for &to in &self.corners_px {
            if (from.y > at_px.y) != (to.y > at_px.y) {
                let x = from.x + (at_px.y - from.y) * (to.x - from.x) / (to.y - from.y);
                inside ^= at_px.x < x;
            }
            from = to;
        }
        inside
    }
}

#[cfg(test)]
mod tests {
    use super::Outline;
    use crate::math::DVec2;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    #[test]
    fn without_corners_every_position_is_inside() {
        assert!(Outline::default().contains(DVec2::new(-3.0, 1e9)));
    }

    proptest! {
        /// Seen from a point inside, the angles of the edges add up to a whole turn; from outside, to zero.
        #[test]
        fn a_point_is_inside_if_the_edges_turn_once_around_it(
            radii in proptest::collection::vec(0.5..3.0_f64, 3..12),
            at in prop::array::uniform2(-3.0..3.0_f64),
            origin in prop::array::uniform2(-50.0..50.0_f64),
        ) {
            let turn = core::f64::consts::TAU / radii.len() as f64;
            let corner = |(k, &r): (usize, &f64)| DVec2::from_angle(turn * k as f64) * r;
            let corners: Vec<DVec2> = radii.iter().enumerate().map(corner).collect();
            let at = DVec2::from_array(at);
            let next = corners.iter().cycle().skip(1);
            let angles = corners.iter().zip(next).map(|(&a, &b)| (a - at).angle_to(b - at));
            let turns = angles.sum::<f64>() / core::f64::consts::TAU;
            let near_edge = corners.iter().zip(corners.iter().cycle().skip(1)).any(|(&a, &b)| {
                let share = ((at - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
                a.lerp(b, share).distance(at) < 1e-9
            });
            prop_assume!(!near_edge);
            let origin = DVec2::from_array(origin);
            let moved: Vec<[f64; 2]> = corners.iter().map(|&c| (c + origin).to_array()).collect();
            prop_assert_eq!(Outline::new(&moved, origin).contains(at), turns.abs() > 0.5);
        }
    }
}
