//! Force and torque with their covariance.

use crate::math::DVec3;
use crate::math::linalg::Symmetric;

/// Force and torque that the part exerts on the gel, in the sensor frame.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Wrench {
    /// Force, newtons.
    pub force_n: DVec3,
    /// Torque about [`Self::about_mm`], newton millimetres.
    pub torque_nmm: DVec3,
    /// Point of reference, millimetres: the centroid of the rest markers, unless moved.
    pub about_mm: DVec3,
    /// Covariance of force and torque: N², N² mm and N² mm².
    pub covariance: Symmetric<6>,
    /// Mean square of the motion that the layer does not explain, over its variance: 1 where it explains all
    /// but noise. Above 1, the covariance is that much wider.
    pub misfit: f64,
    /// Cells with unknown tractions.
    pub cells: usize,
    /// Markers whose motion was used.
    pub markers: usize,
    /// Whether the contact reaches the lattice's border. Forces beyond it are missing.
    pub is_cut: bool,
}

impl Wrench {
    /// The same wrench about another point (sensor frame, millimetres).
    #[must_use]
    pub fn about(&self, point_mm: DVec3) -> Self {
        let arm_mm = self.about_mm - point_mm;
        // Torque' = torque + arm x force.
        let cross = crate::math::so3::hat(arm_mm);
        let mut moved = *self;
        moved.torque_nmm += arm_mm.cross(self.force_n);
        moved.about_mm = point_mm;
        let mut half = self.covariance;
        for i in 0..3 {
            for k in 0..6 {
                half[3 + i][k] += (0..3).map(|j| cross.col(j)[i] * self.covariance[j][k]).sum::<f64>();
            }
        }
        moved.covariance = half;
        for i in 0..6 {
            for k in 0..3 {
                moved.covariance[i][3 + k] += (0..3).map(|j| cross.col(j)[k] * half[i][j]).sum::<f64>();
            }
        }
        moved
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn wrench(force: [f64; 3], torque: [f64; 3], root: &[f64]) -> Wrench {
        let entry = |i: usize, k: usize| (0..6).map(|j| root[6 * i + j] * root[6 * k + j]).sum();
        Wrench {
            force_n: DVec3::from_array(force),
            torque_nmm: DVec3::from_array(torque),
            about_mm: DVec3::ZERO,
            covariance: core::array::from_fn(|i| core::array::from_fn(|k| entry(i, k))),
            misfit: 1.0,
            cells: 9,
            markers: 81,
            is_cut: false,
        }
    }

    proptest! {
        /// Moved there and back again, nothing has changed; and a force through a point has no torque about
        /// it.
        #[test]
        fn a_wrench_moves_there_and_back(
            force in prop::array::uniform3(-5.0..5.0_f64),
            torque in prop::array::uniform3(-5.0..5.0_f64),
            point in prop::array::uniform3(-9.0..9.0_f64),
            root in prop::collection::vec(-1.0..1.0_f64, 36),
        ) {
            let start = wrench(force, torque, &root);
            let point = DVec3::from_array(point);
            let back = start.about(point).about(DVec3::ZERO);
            prop_assert!((back.torque_nmm - start.torque_nmm).length() < 1e-12);
            for i in 0..6 {
                for k in 0..6 {
                    prop_assert!((back.covariance[i][k] - start.covariance[i][k]).abs() < 1e-9);
                }
            }
            let through = Wrench { torque_nmm: point.cross(start.force_n), ..start };
            prop_assert!(through.about(point).torque_nmm.length() < 1e-12);
        }

        /// Of a known force and no torque, the moved torque's covariance is that of arm x force.
        #[test]
        fn the_torque_of_an_arm_has_the_forces_covariance(
            arm in prop::array::uniform3(-9.0..9.0_f64), sigma in prop::array::uniform3(0.1..2.0_f64),
        ) {
            let mut start = wrench([0.0; 3], [0.0; 3], &[0.0; 36]);
            (0..3).for_each(|i| start.covariance[i][i] = sigma[i] * sigma[i]);
            let [x, y, z] = arm;
            // Torque about a point at -arm: (y fz - z fy, z fx - x fz, x fy - y fx).
            let moved = start.about(-DVec3::from_array(arm));
            let square = |a: f64| a * a;
            prop_assert!(
                (moved.covariance[3][3] - square(y * sigma[2]) - square(z * sigma[1])).abs() < 1e-9
            );
            prop_assert!((moved.covariance[4][0] - z * square(sigma[0])).abs() < 1e-9);
            prop_assert!((moved.covariance[0][4] - moved.covariance[4][0]).abs() < 1e-12);
            prop_assert!((moved.covariance[3][4] + x * y * square(sigma[2])).abs() < 1e-9);
        }
    }
}
