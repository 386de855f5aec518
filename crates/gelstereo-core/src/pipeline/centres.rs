//! Covariances of the centres in each image, with the effect of gel that folds within the dots.

use super::epipolar::variance_px2;
use super::{Frame, Pipeline, centres, scaled};
use crate::math::DVec3;
use crate::math::linalg::Symmetric;
use crate::rig::View;
use alloc::vec::Vec;

impl Pipeline {
    /// Covariances of the last frame's positions in both images, px², about the images of the dots' centres;
    /// the lists of `out` are cleared first, and stay empty if `frame` is not the last one.
    ///
    /// They include what an image alone cannot show: noise measured from both views, and gel that folds
    /// within the dot. For a marker that is not seen they are from when it last was. Folds move a dot's
    /// positions in both images alike: to combine the views, use [`Frame::covariance_mm2`].
    pub fn centre_covariances_px2(&self, frame: &Frame, out: [&mut Vec<Symmetric<2>>; 2]) {
        let [in_left, in_right] = out;
        in_left.clear();
        in_right.clear();
        if frame.index + 1 != self.frames || frame.covariance_mm2.len() != self.covariance_mm2.len() {
            return;
        }
        let (left, right) = (centres(self.left.labelled()), centres(self.right.labelled()));
        let ready = self.triangulator.ready();
        for (i, (after, before)) in frame.covariance_mm2.iter().zip(&self.covariance_mm2).enumerate() {
            let widening = ready.point(i, &left.at(i), &right.at(i)).map_or(self.epipolar.scale, |stereo| {
                self.epipolar.widening(i, stereo.epipolar_px, variance_px2(left, right, i))
            });
            let bend_mm2: Symmetric<3> =
                core::array::from_fn(|i| core::array::from_fn(|j| after[i][j] - before[i][j]));
            for (view, centres, out) in
                [(View::Left, left, &mut *in_left), (View::Right, right, &mut *in_right)]
            {
                let mut covariance_px2 = scaled(&centres.covariance_px2[i], widening);
                if let Ok(seen) = ready.view(view).project_with_jacobian(frame.points_mm[i], 0.0) {
                    add_image(&mut covariance_px2, &bend_mm2, &seen.jacobian);
                }
                out.push(covariance_px2);
            }
        }
    }
}

/// Adds J B Jᵀ.
fn add_image(covariance_px2: &mut Symmetric<2>, bend_mm2: &Symmetric<3>, [column, row]: &[DVec3; 2]) {
    let times = |v: &DVec3| DVec3::from_array(bend_mm2.map(|line| DVec3::from_array(line).dot(*v)));
    let (of_column, of_row) = (times(column), times(row));
    let both = row.dot(of_column);
    covariance_px2[0][0] += column.dot(of_column);
    covariance_px2[0][1] += both;
    covariance_px2[1][0] += both;
    covariance_px2[1][1] += row.dot(of_row);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::abs;

    /// A fold that may move a dot by a step to either side moves its image by the step's image.
    #[test]
    fn a_fold_in_space_widens_a_centre_by_its_image() {
        let jacobian = [DVec3::new(17.0, 0.1, 3.0), DVec3::new(-0.2, 18.0, 2.0)];
        let step_mm = DVec3::new(2e-4, -3e-4, 7e-4);
        let fold_mm2 = step_mm.to_array().map(|a| step_mm.to_array().map(|b| a * b));
        let stated = [[1e-4, 2e-5], [2e-5, 3e-4]];
        let mut widened = stated;
        add_image(&mut widened, &fold_mm2, &jacobian);
        let moved_px = jacobian.map(|row| row.dot(step_mm));
        for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            assert!(abs(widened[i][j] - stated[i][j] - moved_px[i] * moved_px[j]) < 1e-12, "{i} {j}");
        }
    }
}
