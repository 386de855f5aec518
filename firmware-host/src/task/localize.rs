//! Localizes the part in the hand and decides whether the pose can be used.

use super::TaskError;
use super::belief::Belief;
use super::cell::Cell;
use super::error::Halt;
use super::log::figure;
use crate::recording::{Topic, messages};
use crate::report::{Forecast, Localized, Stage};
use crate::sensing::{self, Action};
use gelstereo_core::math::linalg::Symmetric;
use gelstereo_core::math::{Pose, sqrt};
use gelstereo_core::register::{PoseEstimate, Registration};

/// Largest number of frames that are registered. Of 1887 simulated contacts 8 did not converge. Two of 100
/// simulated tasks failed so, with shorter steps than now; both converged from the next frame.
const MAX_FRAMES: u32 = 3;

/// The part in the hand.
#[derive(Clone, Debug)]
pub(super) struct Held {
    /// Maps part coordinates to gripper coordinates.
    pub(super) t_gripper_object: Pose,
    /// The same pose with its information and the alternative poses, from all looks.
    pub(super) belief: Belief,
    /// Estimate from the last contact alone.
    pub(super) contact: PoseEstimate,
    /// Figures of the localization.
    pub(super) localized: Localized,
    /// Faces that the part has touched; if not empty, the part is out of its holder, if any.
    pub(super) touched: Vec<TouchedSide>,
}

impl Held {
    /// The same part after a look that has not been made yet.
    pub(super) fn expecting(&self, belief: Belief, touched: Option<TouchedSide>) -> Self {
        let mut expected = self.clone();
        expected.belief = belief;
        expected.touched.extend(touched);
        expected
    }
}

/// A side of the part that touched a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TouchedSide {
    /// Index into `task.edges`.
    pub(super) edge: usize,
    pub(super) side: Side,
}

/// A side of the held part that no finger covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    /// Towards +y of the gripper.
    Left,
    /// Towards -y of the gripper.
    Right,
    /// The end that is inserted.
    End,
}

impl Side {
    pub(super) const ALL: [Self; 3] = [Self::Left, Self::Right, Self::End];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Left => "left side",
            Self::Right => "right side",
            Self::End => "end",
        }
    }
}

/// Result of a localization.
pub(super) enum Localization {
    /// Align and insert with this pose.
    Go(Box<Held>),
    /// No pose was found.
    Declined {
        /// The reason, in words.
        reason: String,
    },
    /// The pose is too uncertain for the hole.
    TooUncertain {
        /// Figures of the localization.
        localized: Box<Localized>,
        /// Forecast of the insertion.
        forecast: Forecast,
    },
}

/// Registers the contact to the part's template, starting from the part's expected pose in the gripper frame.
pub(super) fn localize(cell: &mut Cell, expected_t_gripper_object: &Pose) -> Result<Localization, Halt> {
    cell.log.begin(Stage::Localize);
    let width_mm = cell.devices.gripper.status()?.width_mm;
    let t_gripper_sensor = cell.config.mount.t_gripper_sensor(width_mm)?;
    let guess = t_gripper_sensor.inverse() * *expected_t_gripper_object;
    let (found, frames) = match register(cell, &guess)? {
        Ok(found) => found,
        Err(reason) => return Ok(Localization::Declined { reason }),
    };
    let t_gripper_object = t_gripper_sensor * found.t_sensor_object;
    let localized = evidence(cell, &found, &t_gripper_object);
    cell.log.end(vec![
        figure("frames", f64::from(frames)),
        figure("points", found.points as f64),
        figure("inliers", found.inliers as f64),
        figure("iterations", f64::from(found.iterations)),
        figure("rmse_mm", found.rmse_mm),
        figure("axial_sigma_mm", localized.axial_sigma_mm),
        figure("free", found.free.len() as f64),
    ]);
    let belief = Belief::of(&found).in_frame(&t_gripper_sensor);
    let contact = *belief.likeliest();
    Ok(Localization::Go(Box::new(Held { t_gripper_object, belief, contact, localized, touched: Vec::new() })))
}

/// Registers the last frame's contact, or that of one of the next frames if that one's registration fails.
/// Returns the registration and the number of frames that it took, or the last frame's failure.
fn register(cell: &mut Cell, guess: &Pose) -> Result<Result<(Registration, u32), String>, Halt> {
    let mut frames = 1;
    loop {
        let reason = match cell.act(&Action::localize(guess)) {
            Ok(Some(found)) if found.converged => return Ok(Ok((found, frames))),
            Ok(Some(found)) => format!("registration did not converge in {} iterations", found.iterations),
            Ok(None) => "registration gave nothing".to_owned(),
            Err(Halt::Error(TaskError::Sensing { error, .. })) => error.to_string(),
            Err(halt) => return Err(halt),
        };
        if frames == MAX_FRAMES {
            return Ok(Err(format!("{reason} (tried on {MAX_FRAMES} frames)")));
        }
        cell.frame()?;
        frames += 1;
    }
}

/// Collects the figures of a registration, and records the pose with its covariance.
fn evidence(cell: &mut Cell, found: &Registration, t_gripper_object: &Pose) -> Localized {
    let task = &cell.config.task;
    let covariance = sensing::covariance(
        &found.information,
        &found.t_sensor_object,
        task.part_sigma_mm,
        task.part_sigma_rad,
    );
    let time_ns = cell.time_ns();
    cell.log.record(Topic::Pose, || {
        let metres = sensing::in_metres(&covariance);
        messages::pose_with_covariance(time_ns, &found.t_sensor_object, &metres)
    });
    let axis = found.t_sensor_object.transform_vector(cell.config.insertion_axis());
    Localized {
        t_sensor_object: found.t_sensor_object.to_rows(),
        t_gripper_object: t_gripper_object.to_rows(),
        converged: found.converged,
        iterations: found.iterations,
        inliers: found.inliers,
        points: found.points,
        rmse_mm: found.rmse_mm,
        sigma: core::array::from_fn(|i| sqrt(covariance[i][i])),
        axial_sigma_mm: sigma_along(&covariance, axis.to_array()),
        free: found.free.iter().map(ToString::to_string).collect(),
        looks: 1,
        touches: 0,
        forecast: None,
    }
}

/// Standard deviation of the part's origin along a unit direction.
fn sigma_along(covariance: &Symmetric<6>, axis: [f64; 3]) -> f64 {
    let variance: f64 = (0..3)
        .flat_map(|i| (0..3).map(move |j| (i, j)))
        .map(|(i, j)| axis[i] * covariance[i][j] * axis[j])
        .sum();
    sqrt(variance)
}
