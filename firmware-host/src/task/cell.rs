//! The robot cell as the stages see it: take a stereo pair, sense it, stop what must be stopped, record.

use super::error::Halt;
use super::log::Log;
use super::{Devices, TaskError};
use crate::config::Config;
use crate::report::Outcome;
use crate::sensing::{Action, Sensing};
use crate::source::{Next, SourceError, StereoPair};
use gelstereo_core::math::Pose;
use gelstereo_core::register::Registration;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Devices, pipeline and log of one task.
pub(super) struct Cell<'a> {
    pub(super) config: &'a Config,
    pub(super) devices: Devices,
    pub(super) sensing: Sensing,
    pub(super) log: Log<'a>,
    stop: &'a AtomicBool,
    pair: StereoPair,
}

/// What a frame shows of a guarded move.
pub(super) struct Felt {
    /// Mean marker motion.
    pub(super) motion_px: f64,
    /// Whether it reached the trigger, and the device was stopped.
    pub(super) triggered: bool,
}

/// What a trigger stops.
#[derive(Clone, Copy)]
pub(super) enum Stops {
    Gripper,
    Robot,
}

/// Mean marker motion that stops a device.
#[derive(Clone, Copy)]
pub(super) struct Trigger {
    pub(super) motion_px: f64,
    pub(super) stops: Stops,
    /// Its name in the recording.
    pub(super) cause: &'static str,
}

impl<'a> Cell<'a> {
    pub(super) fn new(
        config: &'a Config,
        devices: Devices,
        sensing: Sensing,
        log: Log<'a>,
        stop: &'a AtomicBool,
    ) -> Self {
        Self { config, devices, sensing, log, stop, pair: StereoPair::default() }
    }

    /// Goes on to the next stereo pair without sensing it.
    pub(super) fn take_pair(&mut self) -> Result<(), Halt> {
        let stage = self.log.stage();
        if self.stop.load(Ordering::Relaxed) {
            return Err(Halt::Outcome(Outcome::Interrupted { stage }));
        }
        let timeout = Duration::from_secs_f64(self.config.task.frame_timeout_s);
        let asked = Instant::now();
        loop {
            let left = timeout.saturating_sub(asked.elapsed());
            match self.devices.source.next_pair(left, &mut self.pair)? {
                Next::Pair => break,
                Next::Event(event) => self.log.event(&event),
                Next::End => return Err(Halt::Outcome(Outcome::SourceEnded { stage })),
            }
            if asked.elapsed() >= timeout {
                return Err(SourceError::Timeout { waited: timeout }.into());
            }
        }
        self.log.pair_came(self.pair.time_ns);
        let limit_s = self.config.task.stage_timeout_s;
        if self.log.source_s() > limit_s {
            return Err(Halt::Error(TaskError::StageTimeout { stage, limit_s }));
        }
        Ok(())
    }

    /// Goes on to the next frame that can be sensed; returns its mean marker motion in pixels.
    pub(super) fn frame(&mut self) -> Result<f64, Halt> {
        self.sense(None).map(|felt| felt.motion_px)
    }

    /// As [`Self::frame`], during a move that a trigger ends.
    pub(super) fn guarded_frame(&mut self, trigger: &Trigger) -> Result<Felt, Halt> {
        self.sense(Some(trigger))
    }

    /// The device is stopped before anything is recorded or asked of gripper and robot.
    fn sense(&mut self, trigger: Option<&Trigger>) -> Result<Felt, Halt> {
        let mut bad_frames = 0;
        loop {
            self.take_pair()?;
            let result = self.sensing.process(&self.pair).map(|_| ());
            let motion_px = self.sensing.frame().motion_px;
            let reached = trigger.filter(|trigger| result.is_ok() && motion_px >= trigger.motion_px);
            match reached.map(|trigger| trigger.stops) {
                Some(Stops::Gripper) => self.devices.gripper.stop()?,
                Some(Stops::Robot) => self.devices.robot.stop()?,
                None => {}
            }
            let (gripper, robot) = (self.devices.gripper.status()?, self.devices.robot.status()?);
            self.log.sensed(&self.pair, &gripper, &robot, &result, &self.sensing);
            if let Some(trigger) = reached {
                self.log.trigger(trigger.cause);
            }
            let Err(error) = result else {
                return Ok(Felt { motion_px, triggered: reached.is_some() });
            };
            bad_frames += 1;
            if bad_frames > self.config.task.max_bad_frames {
                let stage = self.log.stage();
                return Err(Halt::Error(TaskError::Sensing { stage, bad_frames, error }));
            }
        }
    }

    /// Moves the robot, sensing on the way.
    pub(super) fn go(&mut self, t_base_gripper: &Pose, speed_mm_s: f64) -> Result<(), Halt> {
        self.devices.robot.move_to(t_base_gripper, speed_mm_s)?;
        while self.devices.robot.status()?.moving {
            self.frame()?;
        }
        Ok(())
    }

    /// Asks something of the pipeline, and records it.
    pub(super) fn act(&mut self, action: &Action) -> Result<Option<Registration>, Halt> {
        let result = self.sensing.act(action);
        self.log.acted(action, &result, &self.sensing);
        let stage = self.log.stage();
        result.map_err(|error| Halt::Error(TaskError::Sensing { stage, bad_frames: 0, error }))
    }

    /// Time of the last stereo pair.
    pub(super) const fn time_ns(&self) -> u64 {
        self.pair.time_ns
    }
}
