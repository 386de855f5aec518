//! Where the image of a tilted disc has its centre: not where the disc's centre is seen.

use crate::math::DVec3;

/// The point that is seen in the centre of a disc's image, for a disc of `radius_mm` about `centre_mm` with unit
/// `normal` (both in the camera's frame); without distortion exactly.
///
/// A circle's image is an ellipse. Its centre is the image of the pole, with respect to the circle, of the line that
/// vanishes (the disc's plane cut by the plane z = 0): centre - r² / z (e_z - n (n · e_z)). To first order the image
/// moves by f r² sin a cos a / z² for a tilt a. To correct a measured centre, take off the difference of the two projections.
#[must_use]
pub fn seen_centre_mm(centre_mm: DVec3, normal: DVec3, radius_mm: f64) -> DVec3 {
    let tangential = DVec3::Z - normal * normal.z;
    centre_mm - tangential * (radius_mm * radius_mm / centre_mm.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::random::Stream;

    /// The middle of an ellipse's extent along x is its centre's x, and likewise y: extremes of 20 000 points of the rim
    /// are right to the square of their spacing, 1e-7 of the radius.
    #[test]
    fn it_is_the_centre_of_the_projected_rim() {
        let mut random = Stream::new(3, "discs");
        let mut largest = 0.0_f64;
        for _ in 0..50 {
            let mut signed = || 2.0 * random.uniform() - 1.0;
            let centre = DVec3::new(10.0 * signed(), 10.0 * signed(), 27.0 + 2.0 * signed());
            let normal = DVec3::new(signed(), signed(), -1.0).normalize();
            let radius = 0.3 + 0.2 * signed();
            let across = normal.any_orthonormal_vector() * radius;
            let along = normal.cross(across);
            let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
            for k in 0..20_000 {
                let t = f64::from(k) * core::f64::consts::TAU / 20_000.0;
                let rim = centre + across * crate::math::cos(t) + along * crate::math::sin(t);
                for (axis, x) in [rim.x / rim.z, rim.y / rim.z].into_iter().enumerate() {
                    (low[axis], high[axis]) = (low[axis].min(x), high[axis].max(x));
                }
            }
            let seen = seen_centre_mm(centre, normal, radius);
            for (axis, found) in [seen.x / seen.z, seen.y / seen.z].into_iter().enumerate() {
                assert!((found - 0.5 * (low[axis] + high[axis])).abs() < 1e-9);
                largest = largest.max((found - centre.to_array()[axis] / centre.z).abs());
            }
        }
        assert!(560.0 * largest > 0.03, "nothing was tested: {largest:e}");
    }
}
