//! The simulated world: a gripper on a robot, and, where the sensor is simulated too, the bench that they work at.
//!
//! Time passes by frames: each pair that the camera gives is one period later, and until then gripper and robot have
//! moved on.

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

/// Why there is no such world.
#[derive(Debug)]
pub enum WorldError {
    /// The sensor cannot be simulated.
    Scene(SceneError),
    /// What stands in the holder cannot be loaded.
    Part(PartError),
    /// The gripper cannot open so wide.
    Width(WidthError),
    /// What stands in the holder is no peg that the simulated hole takes.
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
                "the simulated hole takes round and rectangular pegs: part.shape (or simulated.shape) must be \
                 {{ kind = \"cylinder\", .. }} or {{ kind = \"box\", .. }}, and task.insertion_axis [0, 0, 1] or \
                 [0, 0, -1]"
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

/// A value that goes towards another one.
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

/// Where the hand is at one moment.
#[derive(Clone, Copy, Debug)]
pub struct Hand {
    /// Gripper in the base frame.
    pub t_base_gripper: Pose,
    /// Sensor in the gripper frame.
    pub t_gripper_sensor: Pose,
    /// Opening.
    pub width_mm: f64,
}

/// Free moves turn at most this fast, radians per second.
const TURN_SPEED_RAD_S: f64 = 2.0;

/// What is really there.
#[derive(Debug)]
pub struct World {
    mount: SensorMount,
    period_ns: u64,
    frame: u64,
    activated: bool,
    stalled: bool,
    width_mm: Towards<f64>,
    t_base_gripper: Towards<Pose>,
    /// Part, hole and sensor; real images come without.
    bench: Option<Bench>,
}

impl World {
    /// From a configuration, ready for the devices to share.
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

    /// Lets one period pass.
    fn tick(&mut self) {
        self.advance(self.period_ns as f64 * 1e-9);
    }

    /// Lets `dt` seconds pass: gripper and robot move on.
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

    /// Where the hand is at this moment.
    ///
    /// # Errors
    /// [`WidthError`] when the gripper stands where it cannot.
    pub fn hand(&self) -> Result<Hand, WidthError> {
        Ok(Hand {
            t_base_gripper: self.t_base_gripper.now,
            t_gripper_sensor: self.mount.t_gripper_sensor(self.width_mm.now)?,
            width_mm: self.width_mm.now,
        })
    }

    /// Lets one period pass and takes a picture; `false` where there is no bench to take one of.
    fn expose(&mut self, pair: &mut StereoPair) -> Result<bool, WidthError> {
        self.tick();
        self.picture(pair)
    }

    /// Takes a picture of this moment; `false` where there is no bench to take one of. Its time is that of frames which
    /// are a period apart.
    ///
    /// # Errors
    /// [`WidthError`] when the gripper stands where it cannot.
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

    /// What is really there at this moment, where anybody knows it.
    ///
    /// # Errors
    /// [`WidthError`] when the gripper stands where it cannot.
    pub fn truth(&self) -> Result<Option<BenchTruth>, WidthError> {
        let hand = self.hand()?;
        Ok(self.bench.as_ref().map(|bench| bench.truth(&hand)))
    }
}
