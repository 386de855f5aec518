//! Poses of keyframes with their joint covariance.

use super::chain::{adjoint, moved, times, times_transposed};
use crate::math::linalg::Symmetric;
use crate::math::{DVec3, Pose, solve_definite};
use crate::slip::RigidMotion;
use alloc::vec::Vec;

/// A block of a matrix: the covariance of two poses.
type Block = [[f64; 6]; 6];

const ZERO: Block = [[0.0; 6]; 6];

/// Poses X of a part, from keyframe to keyframe, each with an error in the part's frame: X exp(e). Errors of
/// a chain add up in that frame. A measured motion between two keyframes corrects all of them by their
/// covariance with it. This is the step of Gauss and Newton on the graph of poses (Grisetti et al. 2010, "A
/// tutorial on graph-based SLAM"), in the form of Kalman's update. Left out are the products of two errors:
/// for an error of 1 degree they are below 0.02 degrees.
#[derive(Clone, Debug)]
pub(super) struct JointPoses {
    limit: usize,
    /// Errors are about this point, part frame.
    about_mm: DVec3,
    /// X after a shift to this point.
    poses: Vec<Pose>,
    /// `limit` blocks a row.
    blocks: Vec<Block>,
    gains: Vec<Block>,
}

impl JointPoses {
    pub fn new(limit: usize) -> Self {
        Self {
            limit,
            about_mm: DVec3::ZERO,
            poses: Vec::with_capacity(limit),
            blocks: alloc::vec![ZERO; limit * limit],
            gains: Vec::with_capacity(limit),
        }
    }

    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Begins anew with one pose, the identity, without an error.
    pub fn start(&mut self, about_mm: DVec3) {
        self.about_mm = about_mm;
        self.poses.clear();
        self.poses.push(Pose::from_translation_mm(about_mm));
        self.blocks[0] = ZERO;
    }

    /// Adds the pose after a motion since the last one. There must be room.
    pub fn push(&mut self, motion: &RigidMotion) {
        let (n, limit) = (self.len(), self.limit);
        let Some(&last) = self.poses.last() else { return };
        let pose = motion.pose * last;
        self.poses.push(pose.normalized().unwrap_or(pose));
        let added = self.in_part(&self.poses[n], motion);
        for i in 0..n {
            self.blocks[n * limit + i] = self.blocks[(n - 1) * limit + i];
            self.blocks[i * limit + n] = self.blocks[i * limit + n - 1];
        }
        self.blocks[n * limit + n] = sum(&self.blocks[(n - 1) * limit + n - 1], &added);
    }

    /// Forgets a pose. The others are what they were.
    pub fn remove(&mut self, index: usize) {
        let (n, limit) = (self.len(), self.limit);
        for i in 0..n {
            for k in index..n - 1 {
                self.blocks[i * limit + k] = self.blocks[i * limit + k + 1];
            }
        }
        for i in index..n - 1 {
            for k in 0..n - 1 {
                self.blocks[i * limit + k] = self.blocks[(i + 1) * limit + k];
            }
        }
        self.poses.remove(index);
    }

    /// Motion from first touch to a keyframe, with its covariance about this point of the sensor frame.
    pub fn pose(&self, index: usize, about_mm: DVec3) -> RigidMotion {
        let to = adjoint(&(Pose::from_translation_mm(-about_mm) * self.poses[index]));
        let covariance = moved(&to, &self.blocks[index * self.limit + index]);
        let pose = self.poses[index] * Pose::from_translation_mm(-self.about_mm);
        RigidMotion { pose, about_mm, covariance }
    }

    /// Expected motion from keyframe `from` to `to`, with its covariance about this point of the sensor
    /// frame.
    pub fn between(&self, from: usize, to: usize, about_mm: DVec3) -> RigidMotion {
        let pose = self.poses[to] * self.poses[from].inverse();
        let carried = adjoint(&(Pose::from_translation_mm(-about_mm) * self.poses[to]));
        RigidMotion { pose, about_mm, covariance: moved(&carried, &self.difference(from, to)) }
    }

    /// Squared distance of a measured motion from the expected one, in its variances. All poses are corrected
    /// if it is below `gate`. `None` if a covariance is singular.
    pub fn measure(&mut self, from: usize, to: usize, motion: &RigidMotion, gate: f64) -> Option<f64> {
        let off = self.poses[to].inverse() * motion.pose * self.poses[from];
        let (omega, v) = off.log();
        let residual = [omega.x, omega.y, omega.z, v.x, v.y, v.z];
        let variance = sum(&self.difference(from, to), &self.in_part(&self.poses[to], motion));
        let weighted = solve_definite(&variance, &residual)?;
        let squared: f64 = residual.iter().zip(&weighted).map(|(r, w)| r * w).sum();
        if !(squared < gate) {
            return squared.is_finite().then_some(squared);
        }
        let inverse = inverse(&variance)?;
        self.gains.clear();
        for i in 0..self.len() {
            self.gains.push(difference(self.block(i, to), self.block(i, from)));
        }
        for (pose, gain) in self.poses.iter_mut().zip(&self.gains) {
            let [a, b, c, x, y, z] = gain.map(|row| row.iter().zip(&weighted).map(|(g, w)| g * w).sum());
            let corrected = *pose * Pose::exp(DVec3::new(a, b, c), DVec3::new(x, y, z));
            *pose = corrected.normalized().unwrap_or(corrected);
        }
        for i in 0..self.len() {
            let weighted = times(&self.gains[i], &inverse);
            for k in i..self.len() {
                let less = times_transposed(&weighted, &self.gains[k]);
                let block = difference(self.block(i, k), &less);
                self.blocks[i * self.limit + k] = block;
                self.blocks[k * self.limit + i] = core::array::from_fn(|a| block.map(|row| row[a]));
            }
        }
        Some(squared)
    }

    fn block(&self, i: usize, k: usize) -> &Block {
        &self.blocks[i * self.limit + k]
    }

    /// Covariance of the difference of two errors.
    fn difference(&self, from: usize, to: usize) -> Symmetric<6> {
        let own = sum(self.block(from, from), self.block(to, to));
        difference(&own, &sum(self.block(from, to), self.block(to, from)))
    }

    /// Covariance of a motion that ends at a pose, in the part's frame.
    fn in_part(&self, pose: &Pose, motion: &RigidMotion) -> Symmetric<6> {
        let to = adjoint(&(pose.inverse() * Pose::from_translation_mm(motion.about_mm)));
        moved(&to, &motion.covariance)
    }
}

fn sum(a: &Block, b: &Block) -> Block {
    core::array::from_fn(|i| core::array::from_fn(|k| a[i][k] + b[i][k]))
}

fn difference(a: &Block, b: &Block) -> Block {
    core::array::from_fn(|i| core::array::from_fn(|k| a[i][k] - b[i][k]))
}

/// Inverse of a positive definite matrix.
fn inverse(matrix: &Symmetric<6>) -> Option<Block> {
    let mut columns = ZERO;
    for (k, column) in columns.iter_mut().enumerate() {
        *column = solve_definite(matrix, &core::array::from_fn(|i| f64::from(u8::from(i == k))))?;
    }
    Some(columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn motion(shift_mm: DVec3, variances: [f64; 6]) -> RigidMotion {
        let covariance =
            core::array::from_fn(|i| core::array::from_fn(|k| if i == k { variances[i] } else { 0.0 }));
        RigidMotion { pose: Pose::from_translation_mm(shift_mm), about_mm: DVec3::ZERO, covariance }
    }

    /// Four poses after one another, with these variances of x.
    fn chain(variances: [f64; 3]) -> JointPoses {
        let mut joint = JointPoses::new(4);
        joint.start(DVec3::ZERO);
        for x in variances {
            joint.push(&motion(DVec3::ZERO, [1e-6, 1e-6, 1e-6, x, 1e-4, 1e-4]));
        }
        joint
    }

    proptest! {
        /// Along x, the least squares of a chain with one loop: each step takes its share of the misfit.
        #[test]
        fn a_misfit_is_spread_by_variance(
            steps in prop::array::uniform3(1e-4..1e-2_f64), measured in 1e-5..1e-2_f64, off in -0.1..0.1_f64,
        ) {
            let mut joint = chain(steps);
            let loop_mm = motion(DVec3::X * off, [1.0, 1.0, 1.0, measured, 1.0, 1.0]);
            let squared = joint.measure(1, 3, &loop_mm, f64::INFINITY).unwrap();
            let sum = steps[1] + steps[2] + measured;
            prop_assert!((squared - off * off / sum).abs() < 1e-9 * squared.max(1.0));
            let expected = [0.0, 0.0, off * steps[1] / sum, off * (steps[1] + steps[2]) / sum];
            let loose = [0.0, steps[0], steps[0] + steps[1], steps[0] + steps[1] + steps[2]];
            let shared = [0.0, 0.0, steps[1], steps[1] + steps[2]];
            for i in 0..4 {
                let found = joint.pose(i, DVec3::ZERO);
                prop_assert!((found.pose.translation_mm - DVec3::X * expected[i]).length() < 1e-12);
                let variance = loose[i] - shared[i] * shared[i] / sum;
                prop_assert!((found.covariance[3][3] - variance).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_motion_beyond_the_gate_changes_nothing() {
        let mut joint = chain([1e-4; 3]);
        let before = joint.pose(3, DVec3::X);
        let far = motion(DVec3::X, [1.0, 1.0, 1.0, 1e-4, 1.0, 1.0]);
        assert!(joint.measure(0, 3, &far, 30.0).unwrap() > 1000.0);
        assert_eq!(joint.pose(3, DVec3::X), before);
    }

    #[test]
    fn a_pose_that_is_forgotten_leaves_the_others() {
        let mut joint = chain([1e-4, 2e-4, 3e-4]);
        joint.measure(0, 3, &motion(DVec3::X * 0.01, [1.0, 1.0, 1.0, 1e-4, 1.0, 1.0]), 30.0).unwrap();
        let [first, last] = [1, 3].map(|i| joint.pose(i, DVec3::Y));
        let between = joint.between(1, 3, DVec3::Y);
        joint.remove(2);
        assert_eq!((joint.len(), joint.pose(1, DVec3::Y), joint.pose(2, DVec3::Y)), (3, first, last));
        assert_eq!(joint.between(1, 2, DVec3::Y), between);
    }
}
