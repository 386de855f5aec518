//! Offset of the centroid of a tilted disc's image from the image of the disc's centre.

use super::RigView;
use crate::camera::{Camera, CameraError};
use crate::math::{DVec2, DVec3};

/// A printed dot: the disc |s| <= 1 under s -> centre + along s.x + across s.y (sensor frame, millimetres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Its centre.
    pub centre_mm: DVec3,
    /// Two conjugate half diameters; for a stretched disc along the lattice's row and column.
    pub half_mm: [DVec3; 2],
}

impl RigView<'_> {
    /// Centroid of a disc's image minus the image of its centre, to second order in the radius. Subtract
    /// it from a measured centre.
    ///
    /// Without distortion the image is an ellipse. Its centre is the image of the pole, with respect to
    /// the disc, of the vanishing line: the disc's centre moved by -Σ h (h · ∇ ln z) over both half
    /// diameters h, z the depth of the apparent point. That is f r² sin a cos a / z² for a tilt a
    /// (Heikkilä and Silvén 1997). Distortion adds half its second derivatives times the disc's mean
    /// square, and the shift of the centroid by unequal magnification.
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
    /// Shift of an ellipse's centroid by the lens's second derivatives. `halves` are its half diameters
    /// in normalised coordinates about `point`.
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
        // Gradient of the log determinant of the Jacobian: regions of larger magnification have more area.
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
