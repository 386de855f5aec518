//! Where the image of a tilted disc has its centre: not where the disc's centre is seen.

use super::RigView;
use crate::camera::{Camera, CameraError};
use crate::math::{DVec2, DVec3};

/// A printed dot: the disc |s| <= 1 under s -> centre + along s.x + across s.y (sensor frame, millimetres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Its centre.
    pub centre_mm: DVec3,
    /// Two conjugate half diameters: of a stretched disc those along the lattice's row and column.
    pub half_mm: [DVec3; 2],
}

impl RigView<'_> {
    /// Centre (centroid) of a disc's image less the image of its centre, to second order in its radius. Take it off a measured
    /// centre.
    ///
    /// Without distortion the image is an ellipse, whose centre is the image of the pole, with respect to the disc, of the
    /// line that vanishes: the disc's centre moved by -Σ h (h · ∇ ln z) over both half diameters h, z the depth of the point
    /// that is seen without layers. That is f r² sin a cos a / z² for a tilt a (Heikkilä and Silvén 1997). A lens that bends
    /// adds half its second derivatives times the mean square of the disc, and the centroid of what it stretches.
    ///
    /// # Errors
    /// As [`Self::project`], for the disc's centre.
    pub fn disc_bias_px(&self, disc: &Disc) -> Result<DVec2, CameraError> {
        let seen = self.seen(disc.centre_mm)?;
        let pole = disc.half_mm.map(|half| half * -half.dot(seen.depth_gradient) / seen.apparent.z);
        let moved = pole[0] + pole[1];
        let rows = seen.jacobian;
        let bias_px = DVec2::new(rows[0].dot(moved), rows[1].dot(moved));
        let halves = disc.half_mm.map(|half| seen.normalised(half));
        Ok(bias_px + self.camera().bend_px(seen.apparent, halves))
    }
}

impl Camera {
    /// What the lens's second derivatives move the centroid of an ellipse by, which has these half diameters (normalised
    /// coordinates) about a point seen.
    fn bend_px(&self, point: DVec3, halves: [DVec2; 2]) -> DVec2 {
        if self.distortion == [0.0; 5] {
            return DVec2::ZERO;
        }
        let p = DVec2::new(point.x / point.z, point.y / point.z);
        // Mean squares over the ellipse.
        let [a, b] = halves;
        let square = [a.x * a.x + b.x * b.x, a.x * a.y + b.x * b.y, a.y * a.y + b.y * b.y].map(|s| 0.25 * s);
        let [xxx, xxy, xyy, yyy] = self.distortion_bend(p);
        let (xx, xy, _, yy) = self.distortion_jacobian(p);
        let half_bend = DVec2::new(
            0.5 * (xxx * square[0] + 2.0 * xxy * square[1] + xyy * square[2]),
            0.5 * (xxy * square[0] + 2.0 * xyy * square[1] + yyy * square[2]),
        );
        // Gradient of the logarithm of the Jacobian's determinant: where the lens stretches more there is more area.
        let determinant = xx * yy - xy * xy;
        let stretch = DVec2::new(yy * xxx - 2.0 * xy * xxy + xx * xyy, yy * xxy - 2.0 * xy * xyy + xx * yyy)
            / determinant;
        let shift = DVec2::new(
            square[0] * stretch.x + square[1] * stretch.y,
            square[1] * stretch.x + square[2] * stretch.y,
        );
        let turned = DVec2::new(xx * shift.x + xy * shift.y, xy * shift.x + yy * shift.y);
        (half_bend + turned) * DVec2::new(self.fx_px, self.fy_px)
    }
}
