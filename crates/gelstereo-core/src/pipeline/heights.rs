//! Uncertainty of the heights of one frame.

use crate::contact;
use crate::math::DVec3;
use crate::math::linalg::Symmetric;
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Variances of the heights above rest, and which markers are known well enough for contact detection.
#[derive(Clone, Debug, Default)]
pub(super) struct Heights {
    pub variance_mm2: Vec<f64>,
    pub state: Vec<MarkerState>,
    scratch: Vec<f64>,
}

impl Heights {
    /// From the covariances of this frame's points, the variances at rest, and the rest plane's normal.
    pub fn judge(
        &mut self,
        covariance_mm2: &[Symmetric<3>],
        rest_variance_mm2: &[f64],
        normal: DVec3,
        state: &[MarkerState],
    ) {
        let now = covariance_mm2.iter().map(|covariance| contact::variance_along(covariance, normal));
        self.variance_mm2.clear();
        self.variance_mm2.extend(now.zip(rest_variance_mm2).map(|(now, rest)| now + *rest));
        contact::known_states(&self.variance_mm2, state, &mut self.scratch, &mut self.state);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A height is a difference of two frames: its variance is the sum of theirs, along the rest surface's
    /// normal.
    #[test]
    fn a_height_has_the_variances_of_both_frames() {
        let normal = DVec3::new(0.6, 0.0, -0.8);
        let covariance_mm2 = [[4.0, 0.5, 0.1], [0.5, 3.0, 0.2], [0.1, 0.2, 9.0]];
        let now_mm2 = contact::variance_along(&covariance_mm2, normal);
        let mut heights = Heights::default();
        heights.judge(&[covariance_mm2; 3], &[1.0, 2.0, 8.0], normal, &[MarkerState::Seen; 3]);
        assert_eq!(heights.variance_mm2, [now_mm2 + 1.0, now_mm2 + 2.0, now_mm2 + 8.0]);
    }
}
