//! Inputs, scratch memory and pose updates shared by the rungs on the template's samples.

use super::soft::SoftMatch;
use crate::math::{DVec3, Pose, sqrt};
use crate::params::RegisterParams;
use crate::register::error::{MIN_PATCH, RegisterError};
use crate::register::template::Template;
use crate::stop::{Stop, ask_often};
use alloc::vec::Vec;

/// The final state of a stage.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outcome {
    pub t_sensor_object: Pose,
    pub converged: bool,
    pub iterations: u32,
}

/// One patch and one template, with the settings: the input of every stage.
#[derive(Clone, Copy)]
pub(in crate::register) struct Problem<'a> {
    pub params: &'a RegisterParams,
    pub points_mm: &'a [DVec3],
    pub template: &'a Template,
    pub stop: Stop<'a>,
}

/// Vectors shared and reused by the stages.
#[derive(Clone, Debug, Default)]
pub(in crate::register) struct Scratch {
    /// The patch in the object's frame, at the current pose.
    pub placed: Vec<DVec3>,
    /// Sources and targets of a rigid fit, and their weights.
    pub sources: Vec<DVec3>,
    pub targets: Vec<DVec3>,
    pub weights: Vec<f64>,
    pub soft: Vec<SoftMatch>,
}

impl Scratch {
    /// Places the patch in the object's frame. Subtracts the translation first, so that a common offset
    /// does not cost precision.
    pub fn place(&mut self, points_mm: &[DVec3], t_sensor_object: &Pose) {
        let back = t_sensor_object.rotation.conjugate();
        self.placed.clear();
        self.placed.extend(points_mm.iter().map(|&p| back * (p - t_sensor_object.translation_mm)));
    }

    pub fn clear_pairs(&mut self) {
        self.sources.clear();
        self.targets.clear();
        self.weights.clear();
        self.soft.clear();
    }

    /// Largest displacement of a patch point by a motion in the object's frame. NaN for an invalid
    /// motion, which a maximum would hide and report as a short step.
    pub fn largest_move_mm(&self, motion: &Pose) -> f64 {
        let squared = |p: &DVec3| motion.transform_point(*p).distance_squared(*p);
        sqrt(self.placed.iter().map(squared).fold(0.0, |largest, d| if d <= largest { largest } else { d }))
    }
}

/// The pose after moving the patch by `motion` in the object's frame: T D⁻¹.
pub(super) fn compose(t_sensor_object: &Pose, motion: &Pose) -> Pose {
    let product = *t_sensor_object * motion.inverse();
    product.normalized().unwrap_or(*t_sensor_object)
}

/// Rejects a placed patch with too few points within `reach_mm` of the template.
pub(super) fn check_reach(
    problem: &Problem<'_>,
    placed: &[DVec3],
    reach_mm: f64,
) -> Result<(), RegisterError> {
    let (mut within, mut nearest) = (0, f64::INFINITY);
    for (step, &point) in placed.iter().enumerate() {
        ask_often(problem.stop, step)?;
        if let Some((_, distance_squared)) = problem.template.tree().nearest(point) {
            within += usize::from(distance_squared <= reach_mm * reach_mm);
            nearest = nearest.min(distance_squared);
        }
    }
    if within >= MIN_PATCH {
        return Ok(());
    }
    Err(RegisterError::OutOfReach { within, min_points: MIN_PATCH, nearest_mm: sqrt(nearest), reach_mm })
}
