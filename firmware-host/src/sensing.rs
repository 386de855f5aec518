//! Facade over pipeline, registration and template, shared by the job and the replay.

use crate::source::{StereoPair, monotonic_ns};
use gelstereo_core::force::Compliance;
use gelstereo_core::image::ImageError;
use gelstereo_core::math::linalg::{Symmetric, eigen};
use gelstereo_core::math::{DMat3, DQuat, DVec3, Pose, so3};
use gelstereo_core::params::Params;
use gelstereo_core::pipeline::{Frame, Pace, Pipeline, PipelineError, PitchCheck, RestRecord, Touch};
use gelstereo_core::register::{Localizer, RegisterError, Registrar, Registration, Template, TrackingStatus};
use gelstereo_core::rig::Rig;
use gelstereo_core::track::MarkerState;
use serde::{Deserialize, Serialize};

/// Reason why sensing gave no result.
#[derive(Debug)]
pub enum SensingError {
    /// A buffer is not a valid image.
    Image(ImageError),
    /// Error of the pipeline.
    Pipeline(PipelineError),
    /// Error of the registration.
    Register(RegisterError),
    /// A part was to be tracked before any expected pose was given.
    NoExpectation,
    /// Too few markers are visible for a meaningful mean motion.
    Lost {
        /// Number of markers seen.
        seen: usize,
        /// Number of lattice markers.
        markers: usize,
    },
}

impl std::fmt::Display for SensingError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Image(error) => error.fmt(f),
            Self::Pipeline(error) => error.fmt(f),
            Self::Register(error) => write!(f, "registration: {error}"),
            Self::NoExpectation => {
                write!(f, "a part cannot be followed before `expect` says where to look for it")
            }
            Self::Lost { seen, markers } => write!(
                f,
                "{seen} of {markers} markers are seen, half are needed; did the part slip or the light go \
                out?"
            ),
        }
    }
}

impl std::error::Error for SensingError {}

/// Pipeline actions besides frames. They are recorded, so that a replay can repeat them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "action", deny_unknown_fields)]
pub enum Action {
    /// The next frame becomes the rest frame.
    Reset,
    /// The last frame becomes the reference of motion.
    MarkReference,
    /// Registers the last frame's contact, starting from this guess of `t_sensor_object`.
    Localize {
        /// Unit quaternion x y z w; stored as such because a conversion to a matrix would change its last
        /// bits.
        rotation_xyzw: [f64; 4],
        /// Translation.
        translation_mm: [f64; 3],
    },
    /// Sets the expected pose (`t_sensor_object`); the next `Follow` searches from it.
    Expect {
        /// Unit quaternion x y z w.
        rotation_xyzw: [f64; 4],
        /// Translation.
        translation_mm: [f64; 3],
    },
    /// Localizes the last frame's contact, starting from the previous pose.
    Follow,
}

impl Action {
    /// Registration from a guess.
    #[must_use]
    pub fn localize(guess: &Pose) -> Self {
        Self::Localize {
            rotation_xyzw: guess.rotation.to_array(),
            translation_mm: guess.translation_mm.to_array(),
        }
    }

    /// Expected pose of the part.
    #[must_use]
    pub fn expect(t_sensor_object: &Pose) -> Self {
        Self::Expect {
            rotation_xyzw: t_sensor_object.rotation.to_array(),
            translation_mm: t_sensor_object.translation_mm.to_array(),
        }
    }
}

/// The sensing stages and their state between frames.
#[derive(Clone, Debug)]
pub struct Sensing {
    pipeline: Pipeline,
    registrar: Registrar,
    /// Tracks the part from frame to frame, once an expected pose is given.
    localizer: Option<Localizer>,
    tracking: Option<TrackingStatus>,
    template: Template,
    frame: Frame,
    touch: Touch,
    deadline_ms: Option<f64>,
    /// This computer's, learned from frames with a deadline.
    pace: Pace,
    /// Limit of the last frame.
    work_limit: Option<u64>,
}

impl Sensing {
    /// For this rig and template.
    ///
    /// # Errors
    /// [`SensingError::Pipeline`].
    pub fn new(rig: &Rig, params: &Params, template: Template) -> Result<Self, SensingError> {
        Ok(Self {
            pipeline: Pipeline::new(rig, params).map_err(SensingError::Pipeline)?,
            registrar: Registrar::new(&params.register),
            localizer: None,
            tracking: None,
            template,
            frame: Frame::default(),
            touch: Touch::default(),
            deadline_ms: None,
            pace: Pace::default(),
            work_limit: None,
        })
    }

    /// With the gel's compliance matrix, in place of the elastic layer of `force`.
    ///
    /// # Errors
    /// [`SensingError::Pipeline`] if it is of another lattice or gel.
    pub fn with_compliance(self, compliance: Option<Compliance>) -> Result<Self, SensingError> {
        let pipeline = self.pipeline.with_compliance(compliance).map_err(SensingError::Pipeline)?;
        Ok(Self { pipeline, ..self })
    }

    /// With a time in which each frame must be sensed.
    #[must_use]
    pub fn with_deadline(self, deadline_ms: Option<f64>) -> Self {
        Self { deadline_ms, ..self }
    }

    /// The last good frame.
    #[must_use]
    pub const fn frame(&self) -> &Frame {
        &self.frame
    }

    /// The part's template.
    #[must_use]
    pub const fn template(&self) -> &Template {
        &self.template
    }

    /// Tracking status of the last [`Action::Follow`]; `None` if it gave no pose.
    #[must_use]
    pub const fn tracking(&self) -> Option<TrackingStatus> {
        self.tracking
    }

    /// The print's pitch at rest beside its setting; `None` before the rest frame.
    #[must_use]
    pub fn pitch_check(&self) -> Option<PitchCheck> {
        self.pipeline.pitch_check()
    }

    /// State with which a later run can start under contact; `None` before the rest frame.
    #[must_use]
    pub fn rest_record(&self) -> Option<RestRecord> {
        self.pipeline.rest_record()
    }

    /// Starts from a recorded rest frame.
    ///
    /// # Errors
    /// [`SensingError::Pipeline`] when it was made with another rig or other settings.
    pub fn resume(&mut self, record: &RestRecord) -> Result<(), SensingError> {
        self.pipeline.resume(record).map_err(SensingError::Pipeline)
    }

    /// Processes one stereo pair, within the deadline if there is one.
    ///
    /// # Errors
    /// [`SensingError`].
    pub fn process(&mut self, pair: &StereoPair) -> Result<&Frame, SensingError> {
        let begun_ns = monotonic_ns();
        // Without a known pace there is no limit yet, but the cheaper methods are prepared.
        let limit = |deadline_ms: f64| self.pace.limit((1e6 * deadline_ms) as u64).unwrap_or(u64::MAX);
        self.process_within(pair, self.deadline_ms.map(limit))?;
        if self.deadline_ms.is_some() && self.frame.index > 0 {
            self.pace.observe(self.frame.work, monotonic_ns().saturating_sub(begun_ns));
        }
        Ok(&self.frame)
    }

    /// Processes one stereo pair with this limit of work, as recorded with an earlier one.
    ///
    /// # Errors
    /// [`SensingError`].
    pub fn process_within(&mut self, pair: &StereoPair, limit: Option<u64>) -> Result<&Frame, SensingError> {
        self.work_limit = limit;
        let left = pair.left.view().map_err(SensingError::Image)?;
        let right = pair.right.view().map_err(SensingError::Image)?;
        self.pipeline.process_within(left, right, limit, &mut self.frame).map_err(SensingError::Pipeline)?;
        Ok(&self.frame)
    }

    /// Limit of work of the last frame; `None` without a deadline.
    #[must_use]
    pub const fn work_limit(&self) -> Option<u64> {
        self.work_limit
    }

    /// Checks whether the last good frame shows enough markers to act on.
    ///
    /// # Errors
    /// [`SensingError::Lost`] if fewer than half of the markers are visible. Frames of simulated tasks
    /// showed 92 % or more (154 frames, 13 x 13 markers). Where a part dragged the gel by half a pitch
    /// between frames, they showed 0 to 24 %, with an initial mean motion of 0 px.
    pub fn check_seen(&self) -> Result<(), SensingError> {
        let markers = self.frame.state.len();
        let seen = self.frame.state.iter().filter(|&&state| state == MarkerState::Seen).count();
        if 2 * seen >= markers { Ok(()) } else { Err(SensingError::Lost { seen, markers }) }
    }

    /// Runs an action; only a localization has a result.
    ///
    /// # Errors
    /// [`SensingError::Register`] or [`SensingError::NoExpectation`].
    pub fn act(&mut self, action: &Action) -> Result<Option<Registration>, SensingError> {
        match action {
            Action::Reset => self.pipeline.reset(),
            Action::MarkReference => self.pipeline.mark_reference(),
            Action::Localize { rotation_xyzw, translation_mm } => {
                let guess = pose(rotation_xyzw, translation_mm);
                return self
                    .registrar
                    .register(&self.touch.of(&self.frame), &self.template, &guess)
                    .map(Some)
                    .map_err(SensingError::Register);
            }
            Action::Expect { rotation_xyzw, translation_mm } => {
                let expected = pose(rotation_xyzw, translation_mm);
                self.localizer = Some(Localizer::new(&self.pipeline.params().register, &expected));
            }
            Action::Follow => return self.follow().map(Some),
        }
        Ok(None)
    }

    fn follow(&mut self) -> Result<Registration, SensingError> {
        self.tracking = None;
        let localizer = self.localizer.as_mut().ok_or(SensingError::NoExpectation)?;
        let located = localizer.run(&self.touch.of(&self.frame), &self.template);
        let located = located.map_err(SensingError::Register)?;
        self.tracking = Some(located.tracking);
        Ok(located.registration)
    }
}

fn pose(rotation_xyzw: &[f64; 4], translation_mm: &[f64; 3]) -> Pose {
    Pose { rotation: DQuat::from_array(*rotation_xyzw), translation_mm: DVec3::from_array(*translation_mm) }
}

/// Converts a covariance from [`covariance`] to metres and radians for ROS.
#[must_use]
pub fn in_metres(covariance_mm: &Symmetric<6>) -> Symmetric<6> {
    let unit = |i: usize| if i < 3 { 1e-3 } else { 1.0 };
    core::array::from_fn(|i| core::array::from_fn(|j| unit(i) * covariance_mm[i][j] * unit(j)))
}

/// Covariance of the part's position and rotation in ROS order (x y z of its origin, then rotations about
/// the axes of the sensor frame), millimetres and radians.
///
/// The information of the contact and of the prior are added. A direction that the contact leaves free
/// thus has the variance of the prior: large but finite, as ROS filters require.
#[must_use]
pub fn covariance(
    information: &Symmetric<6>,
    t_sensor_object: &Pose,
    prior_sigma_mm: f64,
    prior_sigma_rad: f64,
) -> Symmetric<6> {
    // A perturbation exp(ω, v) moves the part's origin p by δp = v + ω x p: v = δp + [p]x ω.
    let p = so3::hat(t_sensor_object.translation_mm);
    // Rows (ω, v), columns (δp, ω), in units of the prior's sigmas, so that the sum is well scaled.
    let jacobian: [[f64; 6]; 6] = core::array::from_fn(|row| {
        core::array::from_fn(|col| match (row < 3, col < 3) {
            (true, true) => 0.0,
            (true, false) => prior_sigma_rad * f64::from(u8::from(row == col - 3)),
            (false, true) => prior_sigma_mm * f64::from(u8::from(row - 3 == col)),
            (false, false) => prior_sigma_rad * entry(&p, row - 3, col - 3),
        })
    });
    let scale = |i: usize| if i < 3 { prior_sigma_mm } else { prior_sigma_rad };
    let sum: Symmetric<6> = core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            let contact: f64 = (0..6)
                .flat_map(|a| (0..6).map(move |b| (a, b)))
                .map(|(a, b)| jacobian[a][i] * information[a][b] * jacobian[b][j])
                .sum();
            contact + f64::from(u8::from(i == j))
        })
    });
    let eigen = eigen(&sum);
    core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            // No eigenvalue is below 1, the prior's own.
            let inverse: f64 =
                (0..6).map(|k| eigen.vectors[k][i] * eigen.vectors[k][j] / eigen.values[k].max(1.0)).sum();
            scale(i) * inverse * scale(j)
        })
    })
}

fn entry(matrix: &DMat3, row: usize, col: usize) -> f64 {
    matrix.col(col)[row]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_contact_the_covariance_is_the_expectation() {
        let far = Pose::from_translation_mm(DVec3::new(4.0, 0.0, 32.0));
        let c = covariance(&[[0.0; 6]; 6], &far, 0.5, 0.02);
        for (i, row) in c.iter().enumerate() {
            for (j, &value) in row.iter().enumerate() {
                let sigma: f64 = if i < 3 { 0.5 } else { 0.02 };
                let expected = if i == j { sigma * sigma } else { 0.0 };
                assert!((value - expected).abs() < 1e-15, "{i} {j}: {value}");
            }
        }
    }

    /// Sensor-frame rotation with a sigma of 1 mrad and translation v of 0.01 mm: a part 30 mm away has a
    /// lateral variance of 0.01² + (30 * 0.001)².
    #[test]
    fn a_rotation_about_the_sensor_moves_a_far_part() {
        let far = Pose::from_translation_mm(DVec3::new(0.0, 0.0, 30.0));
        let information = core::array::from_fn(|i| {
            core::array::from_fn(|j| match (i == j, i < 3) {
                (true, true) => 1e6,
                (true, false) => 1e4,
                _ => 0.0,
            })
        });
        let c = covariance(&information, &far, 1e3, 1e3);
        assert!(
            (c[0][0] - 1e-3).abs() < 1e-9 && (c[2][2] - 1e-4).abs() < 1e-9 && (c[3][3] - 1e-6).abs() < 1e-12
        );
        assert!((c[0][4] - 30.0 * 1e-6).abs() < 1e-9, "x grows with the turn about y: {}", c[0][4]);
    }
}
