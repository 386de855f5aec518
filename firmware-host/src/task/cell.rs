//! Robot cell interface of the stages: takes and processes stereo pairs, stops devices, and records.

use super::TaskError;
use super::devices::{Devices, Stops};
use super::error::Halt;
use super::latency::{FrameTimes, LatencyMeter, LatencyReport};
use super::log::Log;
use super::noise::Triggers;
use super::watch::{Guard, Watch};
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
    /// Part pose at the goal (`t_base_object`).
    pub(super) goal: Pose,
    pub(super) triggers: Triggers,
    stop: &'a AtomicBool,
    watch: Watch,
    latency: LatencyMeter,
    pair: StereoPair,
    times: FrameTimes,
}

/// Interval between status requests to gripper and robot while no image arrives. Detecting a silent
/// device, and feeding its watchdog, must not depend on the camera.
const DEVICE_CHECK: Duration = Duration::from_millis(100);
/// Longest delay in noticing a stop request; shorter than the frame period of any sensor of this kind.
const SLICE: Duration = Duration::from_millis(10);

/// Result of a frame during a guarded move.
pub(super) struct Felt {
    /// Mean marker motion.
    pub(super) motion_px: f64,
    /// Whether the motion reached the trigger and the device was stopped.
    pub(super) triggered: bool,
}

/// Mean marker motion at which a device is stopped.
#[derive(Clone, Copy)]
pub(super) struct Trigger {
    pub(super) motion_px: f64,
    pub(super) stops: Stops,
    /// Name in the recording.
    pub(super) cause: &'static str,
}

impl<'a> Cell<'a> {
    pub(super) fn new(
        config: &'a Config,
        devices: Devices,
        sensing: Sensing,
        goal: Pose,
        log: Log<'a>,
        stop: &'a AtomicBool,
    ) -> Self {
        Self {
            config,
            devices,
            sensing,
            log,
            goal,
            triggers: Triggers::in_pixels(config),
            stop,
            watch: Watch::new(config),
            latency: LatencyMeter::default(),
            pair: StereoPair::default(),
            times: FrameTimes::default(),
        }
    }

    /// Activates the gripper and waits until its fingers stand still. Frames meanwhile show neither rest
    /// nor contact and are skipped.
    pub(super) fn activate_gripper(&mut self) -> Result<(), Halt> {
        let task = &self.config.task;
        self.watch.moves(task, Guard::Free, task.opening_speed_mm_s);
        self.devices.gripper.activate()?;
        while self.moves()? {
            self.skip_pair()?;
        }
        Ok(())
    }

    /// Starts a finger motion with the task's closing force.
    pub(super) fn move_gripper(&mut self, width_mm: f64, speed_mm_s: f64, guard: Guard) -> Result<(), Halt> {
        let task = &self.config.task;
        self.watch.moves(task, guard, speed_mm_s);
        Ok(self.devices.gripper.move_to(width_mm, speed_mm_s, task.closing_force)?)
    }

    /// Starts a robot motion.
    pub(super) fn move_robot(
        &mut self,
        t_base_gripper: &Pose,
        speed_mm_s: f64,
        guard: Guard,
    ) -> Result<(), Halt> {
        self.watch.moves(&self.config.task, guard, speed_mm_s);
        Ok(self.devices.robot.move_to(t_base_gripper, speed_mm_s)?)
    }

    /// Whether the fingers or the robot are moving.
    pub(super) fn moves(&mut self) -> Result<bool, Halt> {
        // Polls both every time, to feed the watchdog of a moving robot.
        let (gripper, robot) = (self.devices.gripper.status()?, self.devices.robot.status()?);
        let moving = gripper.moving || robot.moving;
        if !moving {
            self.watch.rests();
        }
        Ok(moving)
    }

    /// Skips the next stereo pair without processing it.
    pub(super) fn skip_pair(&mut self) -> Result<(), Halt> {
        self.take_pair()?;
        self.log.let_go(&self.pair);
        Ok(())
    }

    /// Fetches the next stereo pair without processing it.
    fn take_pair(&mut self) -> Result<(), Halt> {
        let stage = self.log.stage();
        self.wait_for_pair()?;
        self.times = FrameTimes::received(&self.pair.capture);
        self.log.pair_came(self.pair.time_ns);
        let limit_s = self.config.task.stage_timeout_s;
        if self.log.source_s() > limit_s {
            return Err(Halt::Error(TaskError::StageTimeout { stage, limit_s }));
        }
        Ok(())
    }

    /// Waits in short slices, so that stop requests and silent devices are noticed promptly.
    fn wait_for_pair(&mut self) -> Result<(), Halt> {
        let (stage, patience, asked) = (self.log.stage(), self.watch.patience(), Instant::now());
        let mut next_check = DEVICE_CHECK;
        loop {
            if self.stop.load(Ordering::Relaxed) {
                return Err(Halt::Outcome(Outcome::Interrupted { stage }));
            }
            let slice = patience.saturating_sub(asked.elapsed()).min(SLICE);
            match self.devices.source.next_pair(slice, &mut self.pair) {
                Ok(Next::Pair) => return Ok(()),
                Ok(Next::Event(event)) => self.log.event(&event),
                Ok(Next::End) => return Err(Halt::Outcome(Outcome::SourceEnded { stage })),
                Err(SourceError::Timeout { .. }) => {}
                Err(error) => return Err(error.into()),
            }
            let silent = asked.elapsed();
            if silent >= patience {
                return Err(match self.watch.moving() {
                    true => Halt::Error(TaskError::CameraSilent { stage, silent }),
                    false => SourceError::Timeout { waited: silent }.into(),
                });
            }
            if silent >= next_check {
                self.moves()?;
                next_check += DEVICE_CHECK;
            }
        }
    }

    /// Advances to the next frame that can be processed; returns its mean marker motion in pixels.
    pub(super) fn frame(&mut self) -> Result<f64, Halt> {
        self.sense(None).map(|felt| felt.motion_px)
    }

    /// As [`Self::frame`], during a move that is ended by a trigger.
    pub(super) fn guarded_frame(&mut self, trigger: &Trigger) -> Result<Felt, Halt> {
        self.sense(Some(trigger))
    }

    /// Stops the device before recording anything or requesting the status of gripper and robot.
    fn sense(&mut self, trigger: Option<&Trigger>) -> Result<Felt, Halt> {
        let mut bad_frames = 0;
        loop {
            self.take_pair()?;
            let result = self.sensing.process(&self.pair).map(|_| ());
            self.times.sensed();
            let motion_px = self.sensing.frame().motion_px;
            let reached = trigger.filter(|trigger| result.is_ok() && motion_px >= trigger.motion_px);
            if let Some(trigger) = reached {
                let wire_ns = self.devices.stop_one(trigger.stops)?;
                self.latency.stop(trigger.cause, &self.times, wire_ns, self.pair.capture.dropped);
            }
            self.latency.frame(&self.times);
            let (gripper, robot) = (self.devices.gripper.status()?, self.devices.robot.status()?);
            self.log.sensed(&self.pair, &gripper, &robot, &result, &self.sensing);
            if let Some(trigger) = reached {
                self.log.trigger(trigger.cause);
            }
            self.watch.check_result(self.log.stage(), self.times.image_to_sensed())?;
            if !(gripper.moving || robot.moving) {
                self.watch.rests();
            }
            // The frame's recorded result stays unchanged, so that a replay is identical. Lost markers
            // matter only while waiting for a trigger: opening fingers shake the gel.
            let waits = trigger.is_some() && reached.is_none();
            let result = if waits { result.and_then(|()| self.sensing.check_seen()) } else { result };
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

    /// Moves the robot along a free path, processing frames meanwhile.
    pub(super) fn go(&mut self, t_base_gripper: &Pose, speed_mm_s: f64) -> Result<(), Halt> {
        self.move_robot(t_base_gripper, speed_mm_s, Guard::Free)?;
        while self.devices.robot.status()?.moving {
            self.frame()?;
        }
        Ok(())
    }

    /// Runs a pipeline action and records it.
    pub(super) fn act(&mut self, action: &Action) -> Result<Option<Registration>, Halt> {
        let result = self.sensing.act(action);
        self.log.acted(action, &result, &self.sensing);
        let stage = self.log.stage();
        result.map_err(|error| Halt::Error(TaskError::Sensing { stage, bad_frames: 0, error }))
    }

    pub(super) fn latency(&self) -> LatencyReport {
        self.latency.report()
    }

    /// Time of the last stereo pair.
    pub(super) const fn time_ns(&self) -> u64 {
        self.pair.time_ns
    }
}
