//! A peg and a hole of the same cross-section without chamfer, both rigid.

use super::peg::{Peg, Section};
use gelstereo_core::math::{DVec3, Pose, sqrt};

/// Outline of a hole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mouth {
    /// A disc.
    Round {
        /// Diameter.
        diameter_mm: f64,
    },
    /// Two pairs of parallel walls.
    Rectangle {
        /// Unit normals of the wall pairs, base frame.
        normals: [DVec3; 2],
        /// Distance between the walls of each pair.
        size_mm: [f64; 2],
    },
}

/// A hole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hole {
    /// Centre of its rim, base frame.
    pub rim_mm: DVec3,
    /// Unit direction into it, base frame.
    pub inwards: DVec3,
    /// Outline of the hole.
    pub mouth: Mouth,
    /// Depth of its bottom below the rim.
    pub depth_mm: f64,
}

/// Position of a peg relative to a hole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Depth of the tip below the rim; negative above it.
    pub depth_mm: f64,
    /// Depth that it can reach in this posture: 0 if it meets the rim, less than the hole's depth if it
    /// wedges.
    pub limit_mm: f64,
    /// Distance of the tip's centre from the hole's axis.
    pub lateral_mm: f64,
    /// Angle between the axes.
    pub tilt_rad: f64,
}

impl Hole {
    /// Position of the peg, and the depth that it can reach along the hole's axis without turning or
    /// shifting. It fits while both the tip and the section at the rim stay within the hole.
    #[must_use]
    pub fn fit(&self, peg: &Peg, t_base_object: &Pose) -> Fit {
        let axis = t_base_object.transform_vector(peg.axis);
        let tip = t_base_object.transform_point(peg.axis * peg.half_length_mm) - self.rim_mm;
        let cosine = axis.dot(self.inwards);
        let across = axis - self.inwards * cosine;
        let sine = across.length();
        let offset = tip - self.inwards * tip.dot(self.inwards);
        let tilt_rad = gelstereo_core::math::atan2(sine, cosine);
        let corners = match peg.section {
            Section::Round { .. } => Vec::new(),
            Section::Rectangle { .. } => {
                let from_rim = |corner| t_base_object.transform_point(corner) - self.rim_mm;
                peg.tip_corners_mm().into_iter().map(from_rim).collect()
            }
        };
        // The lowest point of the tip's edge meets the bottom.
        let depth_mm = match peg.section {
            Section::Round { radius_mm } => tip.dot(self.inwards) + radius_mm * sine,
            Section::Rectangle { .. } => {
                corners.iter().map(|corner| corner.dot(self.inwards)).fold(f64::NEG_INFINITY, f64::max)
            }
        };
        let fit = |limit_mm| Fit { depth_mm, limit_mm, lateral_mm: offset.length(), tilt_rad };
        if cosine <= 0.0 {
            return fit(0.0);
        }
        let slope = across / cosine;
        let limit_mm = match (peg.section, self.mouth) {
            (Section::Round { radius_mm }, Mouth::Round { diameter_mm }) => {
                let room_mm = 0.5 * diameter_mm - radius_mm / cosine;
                if offset.length() <= room_mm { leaves_disc(offset, slope, room_mm) } else { 0.0 }
            }
            (Section::Rectangle { .. }, Mouth::Rectangle { normals, size_mm }) => {
                let sides = normals.into_iter().zip(size_mm);
                let walls = sides.map(|(normal, size_mm)| Walls { normal, half_mm: 0.5 * size_mm });
                let all = walls.map(|walls| walls.limit_mm(&corners, slope, self.inwards, depth_mm));
                all.fold(f64::INFINITY, f64::min)
            }
            // Holes of another section than the part's do not occur.
            _ => 0.0,
        };
        fit(limit_mm.min(self.depth_mm))
    }
}

/// Two parallel walls, symmetric about the hole's axis.
struct Walls {
    normal: DVec3,
    half_mm: f64,
}

impl Walls {
    /// Depth of the tip's lowest corner at which a prism meets the walls. Where the corner q is h below
    /// the rim, its long edge passes the rim at q - h t, with t the tilt's tangent.
    fn limit_mm(&self, corners: &[DVec3], slope: DVec3, inwards: DVec3, lowest_mm: f64) -> f64 {
        let leaves = corners.iter().map(|corner| {
            let (at, along) = (self.normal.dot(*corner), self.normal.dot(slope));
            if !(at.abs() <= self.half_mm) {
                return 0.0;
            }
            let above_lowest_mm = lowest_mm - corner.dot(inwards);
            above_lowest_mm + leaves_walls(at, along, self.half_mm)
        });
        leaves.fold(f64::INFINITY, f64::min)
    }
}

/// Largest h with |e - h t| <= room, given |e| <= room, in one dimension.
fn leaves_walls(e: f64, t: f64, room: f64) -> f64 {
    if t == 0.0 { f64::INFINITY } else { (e + room * t.signum()) / t }
}

/// Largest h with |e - h t| <= room, given |e| <= room. At depth h the axis of a round peg passes the rim
/// at e - h t from the hole's axis, with e the tip's offset and t the tilt's tangent. Its section there
/// is an ellipse of half width r / cos(tilt).
fn leaves_disc(e: DVec3, t: DVec3, room: f64) -> f64 {
    let a = t.length_squared();
    if a == 0.0 {
        return f64::INFINITY;
    }
    // a h² - 2 b h + c = 0 has one root of each sign, because c <= 0.
    let (b, c) = (e.dot(t), e.length_squared() - room * room);
    (b + sqrt((b * b - a * c).max(0.0))) / a
}

#[cfg(test)]
mod tests {
    use super::*;
    use gelstereo_core::math::so3;

    const HOLE: Hole = Hole {
        rim_mm: DVec3::ZERO,
        inwards: DVec3::NEG_Z,
        mouth: Mouth::Round { diameter_mm: 8.2 },
        depth_mm: 10.0,
    };
    const PEG: Peg =
        Peg { section: Section::Round { radius_mm: 4.0 }, half_length_mm: 20.0, axis: DVec3::NEG_Z };
    const SLOT: Hole =
        Hole { mouth: Mouth::Rectangle { normals: [DVec3::X, DVec3::Y], size_mm: [6.2, 30.4] }, ..HOLE };
    const BLADE: Peg = Peg { section: Section::Rectangle { half_mm: [3.0, 15.0] }, ..PEG };

    /// A peg with its tip's centre at `x` and `height_mm` above the rim, leaning by `tilt` about y.
    fn posture(x: f64, tilt: f64, height_mm: f64) -> Pose {
        let rotation = so3::exp(DVec3::Y * tilt);
        let tip = DVec3::new(x, 0.0, height_mm);
        Pose { rotation, translation_mm: tip - rotation * (PEG.axis * PEG.half_length_mm) }
    }

    #[test]
    fn an_upright_peg_goes_to_the_bottom_up_to_the_clearance_and_no_further_out() {
        for (x, limit_mm) in [(0.0, 10.0), (0.0999, 10.0), (-0.0999, 10.0), (0.1001, 0.0), (9.0, 0.0)] {
            let fit = HOLE.fit(&PEG, &posture(x, 0.0, 3.0));
            assert_eq!(fit.limit_mm, limit_mm, "at {x} mm");
            assert!((fit.depth_mm + 3.0).abs() < 1e-12 && (fit.lateral_mm - x.abs()).abs() < 1e-12);
        }
    }

    /// A centred tip with tilt α wedges where h tan α = D / 2 - r / cos α.
    #[test]
    fn a_leaning_peg_wedges_where_its_shaft_meets_the_rim() {
        let tilt: f64 = 0.012;
        let wedge = (4.1 - 4.0 / gelstereo_core::math::cos(tilt)) / gelstereo_core::math::tan(tilt);
        assert!(wedge < 10.0);
        for sign in [1.0, -1.0] {
            let fit = HOLE.fit(&PEG, &posture(0.0, sign * tilt, 1.0));
            assert!((fit.limit_mm - wedge).abs() < 1e-9, "{} against {wedge}", fit.limit_mm);
            assert!((fit.tilt_rad - tilt).abs() < 1e-12);
        }
    }

    #[test]
    fn a_peg_upside_down_does_not_fit() {
        assert_eq!(HOLE.fit(&PEG, &posture(0.0, core::f64::consts::PI, 1.0)).limit_mm, 0.0);
    }

    /// The blade with its tip at (x, y) and `height_mm` above the rim, after a turn.
    fn blade(x: f64, y: f64, turn: DVec3, height_mm: f64) -> Pose {
        let rotation = so3::exp(turn);
        let tip = DVec3::new(x, y, height_mm);
        Pose { rotation, translation_mm: tip - rotation * (BLADE.axis * BLADE.half_length_mm) }
    }

    #[test]
    fn an_upright_box_goes_in_up_to_half_the_clearance_along_each_of_its_sides() {
        let limit = |x: f64, y: f64| SLOT.fit(&BLADE, &blade(x, y, DVec3::ZERO, 3.0)).limit_mm;
        assert_eq!([limit(0.0, 0.0), limit(0.0999, 0.1999), limit(-0.0999, -0.1999)], [10.0; 3]);
        assert_eq!([limit(0.1001, 0.0), limit(0.0, 0.2001), limit(0.0, -9.0)], [0.0; 3]);
    }

    /// A spin by α moves the corner (3, 15) to 3 cos α + 15 sin α along x.
    #[test]
    fn a_box_that_is_spun_meets_the_rim_with_its_corners() {
        let largest = 0.1 / 15.0;
        for (spin, limit_mm) in [(0.99 * largest, 10.0), (1.02 * largest, 0.0)] {
            for sign in [1.0, -1.0] {
                let pose = blade(0.0, 0.0, DVec3::Z * (sign * spin), 1.0);
                assert_eq!(SLOT.fit(&BLADE, &pose).limit_mm, limit_mm, "spun by {spin}");
            }
        }
    }

    /// Its edges stay within half the clearance c about the tip's centre down to a depth of c / tan α.
    #[test]
    fn a_box_that_leans_wedges_where_its_flank_meets_the_rim() {
        let lean: f64 = 0.015;
        let (sine, cosine) = (gelstereo_core::math::sin(lean), gelstereo_core::math::cos(lean));
        for sign in [1.0, -1.0] {
            let fit = SLOT.fit(&BLADE, &blade(0.0, 0.0, DVec3::Y * (sign * lean), 1.0));
            // The corner that is lower by 3 sin α leans away from the wall; the other one meets it first.
            let higher = 3.1 - 3.0 * cosine;
            let lower = higher * cosine / sine;
            assert!(fit.limit_mm >= lower - 1e-9 && fit.limit_mm <= lower + 6.0 * sine + 1e-9, "{fit:?}");
            assert!((fit.depth_mm - (3.0 * sine - 1.0)).abs() < 1e-9 && (fit.tilt_rad - lean).abs() < 1e-12);
        }
        assert_eq!(SLOT.fit(&BLADE, &blade(0.0, 0.0, DVec3::X * 0.001, 1.0)).limit_mm, 10.0);
    }

    /// Sampled flank points below the rim are between the walls up to the limit and not beyond it.
    #[test]
    fn the_limit_of_a_box_is_that_of_its_points() {
        let mut stream = gelstereo_core::math::random::Stream::new(4, "blades");
        let mut within = |limit: f64| (2.0 * stream.uniform() - 1.0) * limit;
        let mut wedged = 0;
        for _ in 0..300 {
            let turn = DVec3::new(within(0.02), within(0.02), within(0.006));
            let pose = blade(within(0.08), within(0.15), turn, 1.0);
            let fit = SLOT.fit(&BLADE, &pose);
            let worst = |depth_mm: f64| {
                let lowered = Pose::from_translation_mm(DVec3::NEG_Z * (depth_mm - fit.depth_mm)) * pose;
                let points = BLADE
                    .tip_corners_mm()
                    .into_iter()
                    .flat_map(|corner| (0..4000).map(move |k| corner + DVec3::Z * (f64::from(k) * 0.01)));
                let below = points.map(|p| lowered.transform_point(p)).filter(|p| p.z <= 0.0);
                below.map(|p| (p.x.abs() - 3.1).max(p.y.abs() - 15.2)).fold(f64::NEG_INFINITY, f64::max)
            };
            if fit.limit_mm > 0.2 {
                assert!(worst(fit.limit_mm - 0.1) <= 1e-9, "{fit:?}");
            }
            if fit.limit_mm > 0.0 && fit.limit_mm < 9.8 {
                assert!(worst(fit.limit_mm + 0.1) > 0.0, "{fit:?}");
                wedged += 1;
            }
        }
        assert!(wedged > 20, "{wedged}");
    }

    #[test]
    fn a_hole_of_another_section_takes_nothing() {
        assert_eq!(HOLE.fit(&BLADE, &blade(0.0, 0.0, DVec3::ZERO, 1.0)).limit_mm, 0.0);
    }
}
