//! The simulated world: a gripper on a robot, and a bench if the sensor is simulated too.
//!
//! Time advances by frames: each pair from the camera is one period later, during which gripper and robot
//! move on.

mod bench;
mod devices;
mod fixture;
mod hole;
mod peg;
mod rehearsal;

pub use bench::{Bench, BenchTruth, Place};
pub use devices::{PacedSource, SimulatedCamera, SimulatedGripper, SimulatedRobot, TimedSource};
pub use fixture::Fixture;
pub use hole::{Fit, Hole, Mouth};
pub use peg::{Peg, Section};
pub use rehearsal::Rehearsal;

use crate::config::{Config, SourceConfig};
use crate::part::PartError;
use crate::source::StereoPair;
use gelstereo_core::frames::{SensorMount, WidthError};
use gelstereo_core::math::{Pose, so3};
use gelstereo_sim::SceneError;
use std::cell::RefCell;
use std::rc::Rc;

/// Reason why the world cannot be created.
#[derive(Debug)]
pub enum WorldError {
    /// The sensor cannot be simulated.
    Scene(SceneError),
    /// The part in the holder cannot be loaded.
    Part(PartError),
    /// The gripper cannot open this wide.
    Width(WidthError),
    /// The part in the holder is not a peg that fits the simulated hole.
    NoPeg,
}

impl std::fmt::Display for WorldError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Scene(error) => write!(f, "simulated sensor: {error}"),
            Self::Part(error) => error.fmt(f),
            Self::Width(error) => error.fmt(f),
            Self::NoPeg => write!(
                f,
                "the simulated hole takes round and rectangular pegs: part.shape (or simulated.shape) must \
                 be {{ kind = \"cylinder\", .. }} or {{ kind = \"box\", .. }}, and task.insertion_axis [0, \
                 0, 1] or [0, 0, -1]"
            ),
        }
    }
}

impl std::error::Error for WorldError {}

impl From<WidthError> for WorldError {
    fn from(error: WidthError) -> Self {
        Self::Width(error)
    }
}

/// A value moving towards a target.
#[derive(Clone, Copy, Debug)]
struct Towards<T> {
    now: T,
    target: T,
    speed: f64,
}

impl<T: Copy> Towards<T> {
    const fn at_rest(now: T) -> Self {
        Self { now, target: now, speed: 0.0 }
    }
}

/// Pose of the hand at one moment.
#[derive(Clone, Copy, Debug)]
pub struct Hand {
    /// Gripper in the base frame.
    pub t_base_gripper: Pose,
    /// Sensor in the gripper frame.
    pub t_gripper_sensor: Pose,
    /// Opening width.
    pub width_mm: f64,
}

/// Largest turning speed of free moves, radians per second.
const TURN_SPEED_RAD_S: f64 = 2.0;

/// State of the simulated world.
#[derive(Debug)]
pub struct World {
    mount: SensorMount,
    period_ns: u64,
    frame: u64,
    activated: bool,
    stalled: bool,
    width_mm: Towards<f64>,
    t_base_gripper: Towards<Pose>,
    /// Part, hole and sensor; `None` with real images.
    bench: Option<Bench>,
}

impl World {
    /// From a configuration, shared by the devices.
    ///
    /// # Errors
    /// [`WorldError`].
    pub fn shared(config: &Config, place: Place) -> Result<Rc<RefCell<Self>>, WorldError> {
        let bench = match config.source {
            SourceConfig::Simulated => Some(Bench::new(config, place)?),
            _ => None,
        };
        let rate_hz = config.source.frame_rate_hz(config.simulated.frame_rate_hz);
        let (_, max_width_mm) = config.mount.kinematics.width_range_mm();
        Ok(Rc::new(RefCell::new(Self {
            mount: SensorMount {
                t_pad_sensor: config.mount.t_pad_sensor * config.simulated.mount_error.pose(),
                ..config.mount.clone()
            },
            period_ns: (1e9 / rate_hz) as u64,
            frame: 0,
            activated: false,
            stalled: false,
            width_mm: Towards::at_rest(max_width_mm),
            t_base_gripper: Towards::at_rest(config.task.grasp_pose.pose()),
            bench,
        })))
    }

    /// Advances by one period.
    fn tick(&mut self) {
        self.advance(self.period_ns as f64 * 1e-9);
    }

    /// Advances gripper and robot by `dt` seconds.
    pub fn advance(&mut self, dt: f64) {
        let width = &mut self.width_mm;
        let way = width.target - width.now;
        width.now = if way.abs() > width.speed * dt {
            width.now + way.signum() * width.speed * dt
        } else {
            width.target
        };
        let robot = &mut self.t_base_gripper;
        let way = robot.target.translation_mm - robot.now.translation_mm;
        let turn = so3::log(robot.target.rotation * robot.now.rotation.conjugate());
        let share = |way: f64, speed: f64| if way > speed * dt { speed * dt / way } else { 1.0 };
        let share = share(way.length(), robot.speed).min(share(turn.length(), TURN_SPEED_RAD_S));
        robot.now = if share < 1.0 {
            Pose {
                rotation: (so3::exp(turn * share) * robot.now.rotation).normalize(),
                translation_mm: robot.now.translation_mm + way * share,
            }
        } else {
            robot.target
        };
    }

    /// Present pose of the hand.
    ///
    /// # Errors
    /// [`WidthError`] when the gripper is at an invalid width.
    pub fn hand(&self) -> Result<Hand, WidthError> {
        Ok(Hand {
            t_base_gripper: self.t_base_gripper.now,
            t_gripper_sensor: self.mount.t_gripper_sensor(self.width_mm.now)?,
            width_mm: self.width_mm.now,
        })
    }

    /// Advances by one period and renders a stereo pair; `false` without a bench.
    fn expose(&mut self, pair: &mut StereoPair) -> Result<bool, WidthError> {
        self.tick();
        self.picture(pair)
    }

    /// Renders a stereo pair of the present moment; `false` without a bench. Time stamps are one period
    /// apart.
    ///
    /// # Errors
    /// [`WidthError`] when the gripper is at an invalid width.
    pub fn picture(&mut self, pair: &mut StereoPair) -> Result<bool, WidthError> {
        self.frame += 1;
        let hand = self.hand()?;
        let Some(bench) = &mut self.bench else { return Ok(false) };
        pair.time_ns = self.frame * self.period_ns;
        bench.expose(&hand, self.frame, pair);
        if bench.stalls() && self.width_mm.target < self.width_mm.now {
            self.width_mm.target = self.width_mm.now;
            self.stalled = true;
        }
        Ok(true)
    }

    /// Ground truth of the present moment, where it is known.
    ///
    /// # Errors
    /// [`WidthError`] when the gripper is at an invalid width.
    pub fn truth(&self) -> Result<Option<BenchTruth>, WidthError> {
        let hand = self.hand()?;
        Ok(self.bench.as_ref().map(|bench| bench.truth(&hand)))
    }
}
