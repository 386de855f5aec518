//! A thread per real device, so that a slow response delays neither the pipeline nor the other device.
//!
//! The task requests one status per frame. Commands take precedence over pending status requests, and
//! stops over both. While nothing moves, the thread also polls by itself, so that a device with a
//! watchdog stays connected during long computations. While something moves it does not: if the task
//! hangs, the device receives nothing and its watchdog stops it.

use crate::gripper::{Gripper, GripperError, GripperStatus};
use crate::robot::{Robot, RobotError, RobotStatus};
use gelstereo_core::math::Pose;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Interval between status requests of a device at rest; a Robotiq gripper needs one per second.
const KEEP_ALIVE: Duration = Duration::from_millis(200);
/// Longest command. Retries take at most two seconds; longer means that the driver hangs.
const MAX_COMMAND: Duration = Duration::from_secs(5);

/// A device as driven by its thread.
pub trait Driver: Send + 'static {
    /// Status of the device.
    type Status: Copy + Send;
    /// Reason why the device does not carry out a request.
    type Error: Clone + Send;

    /// Reads the present state.
    ///
    /// # Errors
    /// The device's error.
    fn ask_status(&mut self) -> Result<Self::Status, Self::Error>;

    /// Stops the device.
    ///
    /// # Errors
    /// The device's error.
    fn ask_stop(&mut self) -> Result<(), Self::Error>;

    /// Time when the last bytes to the device were on the wire, nanoseconds of `CLOCK_MONOTONIC`.
    fn wire_ns(&self) -> Option<u64>;

    /// Whether the device is moving, by its status.
    fn moves(status: &Self::Status) -> bool;

    /// The error for a device that has not responded for this long.
    fn silent(name: &str, waited: Duration) -> Self::Error;
}

impl Driver for Box<dyn Gripper + Send> {
    type Status = GripperStatus;
    type Error = GripperError;

    fn ask_status(&mut self) -> Result<GripperStatus, GripperError> {
        self.status()
    }

    fn ask_stop(&mut self) -> Result<(), GripperError> {
        self.stop()
    }

    fn wire_ns(&self) -> Option<u64> {
        self.sent_ns()
    }

    fn moves(status: &GripperStatus) -> bool {
        status.moving
    }

    fn silent(name: &str, waited: Duration) -> GripperError {
        GripperError::Silent { port: name.to_owned(), waited_ms: waited.as_millis() as u64 }
    }
}

impl Driver for Box<dyn Robot + Send> {
    type Status = RobotStatus;
    type Error = RobotError;

    fn ask_status(&mut self) -> Result<RobotStatus, RobotError> {
        self.status()
    }

    fn ask_stop(&mut self) -> Result<(), RobotError> {
        self.stop()
    }

    fn wire_ns(&self) -> Option<u64> {
        self.sent_ns()
    }

    fn moves(status: &RobotStatus) -> bool {
        status.moving
    }

    fn silent(name: &str, waited: Duration) -> RobotError {
        RobotError::Silent { address: name.to_owned(), waited_ms: waited.as_millis() as u64 }
    }
}

type Command<D> = Box<dyn FnOnce(&mut D) -> Result<(), <D as Driver>::Error> + Send>;

/// Messages between task and thread.
struct Mailbox<D: Driver> {
    command: Option<Command<D>>,
    stop: bool,
    wants_status: bool,
    /// Time since which a requested status is pending.
    unanswered: Option<Instant>,
    closed: bool,
    /// Result of the last command or stop.
    done: Option<Result<(), D::Error>>,
    sent_ns: Option<u64>,
    /// The last status; `None` between a command and the next status.
    status: Option<Result<D::Status, D::Error>>,
}

impl<D: Driver> Mailbox<D> {
    /// Requests a status unless one is pending.
    fn want_status(&mut self) {
        if self.unanswered.is_none() {
            (self.wants_status, self.unanswered) = (true, Some(Instant::now()));
        }
    }
}

/// State of one device, shared with its thread.
struct Shared<D: Driver> {
    mailbox: Mutex<Mailbox<D>>,
    changed: Condvar,
}

impl<D: Driver> Shared<D> {
    fn lock(&self) -> MutexGuard<'_, Mailbox<D>> {
        self.mailbox.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Handle to a device and its thread.
pub struct DriverThread<D: Driver> {
    shared: Arc<Shared<D>>,
    thread: Option<JoinHandle<()>>,
    name: String,
    max_silence: Duration,
    stop_posted: bool,
}

impl<D: Driver> DriverThread<D> {
    /// Starts the thread. A status pending for longer than `max_silence` is an error that contains `name`.
    ///
    /// # Errors
    /// The system's error when no thread can be started.
    pub fn start(driver: D, name: &str, max_silence: Duration) -> std::io::Result<Self> {
        let mailbox = Mailbox {
            command: None,
            stop: false,
            wants_status: false,
            unanswered: None,
            closed: false,
            done: None,
            sent_ns: None,
            status: None,
        };
        let shared = Arc::new(Shared { mailbox: Mutex::new(mailbox), changed: Condvar::new() });
        let served = Arc::clone(&shared);
        let thread =
            std::thread::Builder::new().name("driver".to_owned()).spawn(move || serve(driver, &served))?;
        Ok(Self { shared, thread: Some(thread), name: name.to_owned(), max_silence, stop_posted: false })
    }

    /// Sends a command and waits until the driver has carried it out.
    fn call(
        &self,
        command: impl FnOnce(&mut D) -> Result<(), D::Error> + Send + 'static,
    ) -> Result<(), D::Error> {
        let mut mailbox = self.shared.lock();
        mailbox.command = Some(Box::new(command));
        mailbox.done = None;
        self.shared.changed.notify_all();
        self.wait(mailbox, MAX_COMMAND)
    }

    /// Sends a stop without waiting for it.
    fn post_stop(&mut self) {
        let mut mailbox = self.shared.lock();
        (mailbox.stop, mailbox.done) = (true, None);
        self.stop_posted = true;
        self.shared.changed.notify_all();
    }

    fn stop_and_wait(&mut self) -> Result<(), D::Error> {
        if !std::mem::take(&mut self.stop_posted) {
            self.post_stop();
            self.stop_posted = false;
        }
        self.wait(self.shared.lock(), MAX_COMMAND)
    }

    fn wait(&self, mailbox: MutexGuard<'_, Mailbox<D>>, limit: Duration) -> Result<(), D::Error> {
        let waiting = |mailbox: &mut Mailbox<D>| mailbox.done.is_none();
        let waited = self.shared.changed.wait_timeout_while(mailbox, limit, waiting);
        let (mut mailbox, _) = waited.unwrap_or_else(PoisonError::into_inner);
        mailbox.done.take().unwrap_or_else(|| Err(D::silent(&self.name, limit)))
    }

    /// Returns the last status and requests the next one. Waits only for the first status after a command.
    fn last_status(&self) -> Result<D::Status, D::Error> {
        let mut mailbox = self.shared.lock();
        if let Some(since) = mailbox.unanswered.filter(|since| since.elapsed() > self.max_silence) {
            return Err(D::silent(&self.name, since.elapsed()));
        }
        mailbox.want_status();
        self.shared.changed.notify_all();
        let waiting = |mailbox: &mut Mailbox<D>| mailbox.status.is_none();
        let waited = self.shared.changed.wait_timeout_while(mailbox, self.max_silence, waiting);
        let (mailbox, _) = waited.unwrap_or_else(PoisonError::into_inner);
        mailbox.status.clone().unwrap_or_else(|| Err(D::silent(&self.name, self.max_silence)))
    }

    fn last_sent_ns(&self) -> Option<u64> {
        self.shared.lock().sent_ns
    }
}

impl<D: Driver> Drop for DriverThread<D> {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            // The panic of a driver thread is ignored.
            let _ = thread.join();
        }
    }
}

/// Next action of the thread.
enum Next<D: Driver> {
    Stop,
    Command(Command<D>),
    Status,
    Close,
}

fn serve<D: Driver>(mut driver: D, shared: &Shared<D>) {
    loop {
        match next(shared) {
            Next::Close => return,
            Next::Stop => answer(shared, driver.ask_stop(), driver.wire_ns()),
            Next::Command(command) => {
                let result = command(&mut driver);
                answer(shared, result, driver.wire_ns());
            }
            Next::Status => {
                let status = driver.ask_status();
                let mut mailbox = shared.lock();
                (mailbox.status, mailbox.unanswered) = (Some(status), None);
                shared.changed.notify_all();
            }
        }
    }
}

/// Waits for the next action. A device at rest is polled for its status.
fn next<D: Driver>(shared: &Shared<D>) -> Next<D> {
    let idle = |mailbox: &mut Mailbox<D>| {
        !(mailbox.stop || mailbox.command.is_some() || mailbox.wants_status || mailbox.closed)
    };
    loop {
        let waited = shared.changed.wait_timeout_while(shared.lock(), KEEP_ALIVE, idle);
        let (mut mailbox, timeout) = waited.unwrap_or_else(PoisonError::into_inner);
        if std::mem::take(&mut mailbox.stop) {
            return Next::Stop;
        } else if let Some(command) = mailbox.command.take() {
            return Next::Command(command);
        } else if mailbox.closed {
            return Next::Close;
        }
        let at_rest = matches!(&mailbox.status, Some(Ok(status)) if !D::moves(status));
        if std::mem::take(&mut mailbox.wants_status) || (timeout.timed_out() && at_rest) {
            return Next::Status;
        }
    }
}

/// Discards the status from before a command: it is no longer valid.
fn answer<D: Driver>(shared: &Shared<D>, result: Result<(), D::Error>, sent_ns: Option<u64>) {
    let mut mailbox = shared.lock();
    (mailbox.done, mailbox.sent_ns, mailbox.status) = (Some(result), sent_ns, None);
    mailbox.want_status();
    shared.changed.notify_all();
}

impl Gripper for DriverThread<Box<dyn Gripper + Send>> {
    fn activate(&mut self) -> Result<(), GripperError> {
        self.call(|driver| driver.activate())
    }

    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, force: f64) -> Result<(), GripperError> {
        self.call(move |driver| driver.move_to(width_mm, speed_mm_s, force))
    }

    fn begin_stop(&mut self) {
        self.post_stop();
    }

    fn stop(&mut self) -> Result<(), GripperError> {
        self.stop_and_wait()
    }

    fn status(&mut self) -> Result<GripperStatus, GripperError> {
        self.last_status()
    }

    fn sent_ns(&self) -> Option<u64> {
        self.last_sent_ns()
    }
}

impl Robot for DriverThread<Box<dyn Robot + Send>> {
    fn move_to(&mut self, t_base_gripper: &Pose, speed_mm_s: f64) -> Result<(), RobotError> {
        let goal = *t_base_gripper;
        self.call(move |driver| driver.move_to(&goal, speed_mm_s))
    }

    fn begin_stop(&mut self) {
        self.post_stop();
    }

    fn stop(&mut self) -> Result<(), RobotError> {
        self.stop_and_wait()
    }

    fn status(&mut self) -> Result<RobotStatus, RobotError> {
        self.last_status()
    }

    fn sent_ns(&self) -> Option<u64> {
        self.last_sent_ns()
    }
}
