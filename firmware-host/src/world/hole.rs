//! A round peg and a round hole without chamfer, both rigid.

use gelstereo_core::math::{DVec3, Pose, sqrt};

/// A round hole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hole {
    /// Middle of its rim, base frame.
    pub rim_mm: DVec3,
    /// Unit direction into it, base frame.
    pub inwards: DVec3,
    /// Diameter.
    pub diameter_mm: f64,
    /// Depth of its bottom below the rim.
    pub depth_mm: f64,
}

/// A round peg; its tip is at +`axis` in its own frame, whose origin is its middle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peg {
    /// Radius.
    pub radius_mm: f64,
    /// Half its length.
    pub half_length_mm: f64,
    /// Unit direction towards the tip.
    pub axis: DVec3,
}

/// How a peg stands to a hole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// How far the tip is below the rim; negative above it.
    pub depth_mm: f64,
    /// How far it can go in this posture: 0 when it meets the rim, less than the hole's depth when it wedges.
    pub limit_mm: f64,
    /// Distance of the middle of the tip from the hole's axis.
    pub lateral_mm: f64,
    /// Angle between the axes.
    pub tilt_rad: f64,
}

impl Hole {
    /// Where the peg is, and how far it can go along the hole's axis without turning or shifting.
    ///
    /// At depth h the peg's axis passes the rim at e - h t from the hole's axis, with e the tip's offset and t the
    /// tilt's tangent; its section there is an ellipse of half width r / cos(tilt). It fits while both the tip and the
    /// section at the rim stay within the hole.
    #[must_use]
    pub fn fit(&self, peg: &Peg, t_base_object: &Pose) -> Fit {
        let axis = t_base_object.transform_vector(peg.axis);
        let tip = t_base_object.transform_point(peg.axis * peg.half_length_mm) - self.rim_mm;
        let cosine = axis.dot(self.inwards);
        let sine = (axis - self.inwards * cosine).length();
        let offset = tip - self.inwards * tip.dot(self.inwards);
        let tilt_rad = gelstereo_core::math::atan2(sine, cosine);
        // The lowest point of the tip's edge is what meets the bottom.
        let depth_mm = tip.dot(self.inwards) + peg.radius_mm * sine;
        let fit = |limit_mm| Fit { depth_mm, limit_mm, lateral_mm: offset.length(), tilt_rad };
        if cosine <= 0.0 {
            return fit(0.0);
        }
        let room = 0.5 * self.diameter_mm - peg.radius_mm / cosine;
        if !(offset.length() <= room) {
            return fit(0.0);
        }
        let slope = (axis - self.inwards * cosine) / cosine;
        fit(leaves_disc(offset, slope, room).min(self.depth_mm))
    }
}

/// Largest h with |e - h t| <= room, given |e| <= room.
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

    const HOLE: Hole = Hole { rim_mm: DVec3::ZERO, inwards: DVec3::NEG_Z, diameter_mm: 8.2, depth_mm: 10.0 };
    const PEG: Peg = Peg { radius_mm: 4.0, half_length_mm: 20.0, axis: DVec3::NEG_Z };

    /// A peg whose tip's middle stands at `x` and `height_mm` above the rim, leaning by `tilt` about y.
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

    /// A centred tip and tilt α wedge where h tan α = D / 2 - r / cos α.
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
}
