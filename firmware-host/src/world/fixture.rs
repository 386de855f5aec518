//! A square face of the cell that a held part may touch, with a solid block behind it.

use super::peg::Peg;
use crate::config::EdgeConfig;
use gelstereo_core::math::{DVec3, Pose};

/// The block; its thickness equals the width of its face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fixture {
    /// Centre of the face, base frame.
    pub middle_mm: DVec3,
    /// Unit direction out of the block, base frame.
    pub normal: DVec3,
    /// Unit directions of its width and height, base frame.
    pub sides: [DVec3; 2],
    /// Width and height of the face.
    pub size_mm: f64,
}

impl Fixture {
    /// The face as configured, moved by `offset_mm` along its normal.
    #[must_use]
    pub fn of(edge: &EdgeConfig, offset_mm: f64) -> Self {
        let normal = edge.unit_normal();
        let middle_mm = edge.middle_mm() + normal * offset_mm;
        Self { middle_mm, normal, sides: edge.sides(), size_mm: edge.size_mm }
    }

    /// Depth of the part behind the face; 0 where it does not reach it. Only the prism's long edges are
    /// tested, because its extreme points in front of a face lie on them. The face must therefore be
    /// larger than the side of the part that touches it.
    #[must_use]
    pub fn penetration_mm(&self, peg: &Peg, t_base_object: &Pose) -> f64 {
        let length_mm = peg.axis * (2.0 * peg.half_length_mm);
        let deepest = peg
            .tip_corners_mm()
            .into_iter()
            .filter_map(|tip_mm| {
                let tip = t_base_object.transform_point(tip_mm) - self.middle_mm;
                let head = t_base_object.transform_point(tip_mm - length_mm) - self.middle_mm;
                self.deepest_of_line(tip, head)
            })
            .fold(0.0, f64::max);
        if deepest < self.size_mm { deepest } else { 0.0 }
    }

    /// Largest depth of a line, given relative to the face's centre, within the face's outline; `None` if
    /// the line misses it.
    fn deepest_of_line(&self, from: DVec3, to: DVec3) -> Option<f64> {
        let (mut begin, mut end) = (0.0_f64, 1.0_f64);
        for side in self.sides {
            let (at, way, half) = (side.dot(from), side.dot(to - from), 0.5 * self.size_mm);
            if way == 0.0 {
                if at.abs() > half {
                    return None;
                }
                continue;
            }
            let (a, b) = ((-half - at) / way, (half - at) / way);
            (begin, end) = (begin.max(a.min(b)), end.min(a.max(b)));
        }
        let depth = |share: f64| -self.normal.dot(from + (to - from) * share);
        (begin <= end).then(|| depth(begin).max(depth(end)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gelstereo_core::math::so3;
    use gelstereo_sim::Shape;

    /// The face is at y = 0, faces -y, and extends from z = -10 to 10 mm.
    const WALL: Fixture =
        Fixture { middle_mm: DVec3::ZERO, normal: DVec3::NEG_Y, sides: [DVec3::X, DVec3::Z], size_mm: 20.0 };

    fn penetration_mm(shape: &Shape, tip_mm: DVec3, tilt: DVec3) -> f64 {
        let rotation = so3::exp(tilt);
        let peg = Peg::of(shape, DVec3::NEG_Z).expect("a peg");
        let tip = rotation * (peg.axis * peg.half_length_mm);
        WALL.penetration_mm(&peg, &Pose { rotation, translation_mm: tip_mm - tip })
    }

    #[test]
    fn a_part_before_the_face_is_held_back_by_what_it_would_go_in() {
        for (shape, half_mm) in [
            (Shape::Box { size_mm: [6.0, 30.0, 30.0] }, 15.0),
            (Shape::Cylinder { radius_mm: 4.0, length_mm: 40.0 }, 4.0),
        ] {
            let at = |y: f64| penetration_mm(&shape, DVec3::new(1.0, y, 0.0), DVec3::ZERO);
            assert_eq!(at(-half_mm - 0.5), 0.0);
            assert!((at(-half_mm + 0.3) - 0.3).abs() < 1e-3, "{}", at(-half_mm + 0.3));
            let aside = penetration_mm(&shape, DVec3::new(30.0, -half_mm + 0.3, 0.0), DVec3::ZERO);
            let above = penetration_mm(&shape, DVec3::new(0.0, -half_mm + 0.3, 11.0), DVec3::ZERO);
            assert_eq!([aside, above], [0.0, 0.0]);
        }
    }

    /// A part that leans towards the wall touches the block's top edge, 10 mm above its tip; one that
    /// leans away touches with its tip.
    #[test]
    fn a_part_that_leans_touches_with_its_tip_or_at_the_top_edge() {
        let shape = Shape::Box { size_mm: [6.0, 30.0, 30.0] };
        let lean: f64 = 0.02;
        let tip_mm = DVec3::new(0.0, -15.0, 0.0);
        let away = penetration_mm(&shape, tip_mm, DVec3::X * lean);
        let towards = penetration_mm(&shape, tip_mm, DVec3::NEG_X * lean);
        let (sine, cosine) = (gelstereo_core::math::sin(lean), gelstereo_core::math::cos(lean));
        let corner = 15.0 * (cosine - 1.0);
        assert!((away - corner.max(0.0)).abs() < 1e-9, "{away}");
        // From the corner, which the lean lowers by 15 sin, up to the top edge.
        let climbed = (10.0 + 15.0 * sine) * sine / cosine;
        assert!((towards - (corner + climbed)).abs() < 1e-9, "{towards} against {}", corner + climbed);
    }
}
