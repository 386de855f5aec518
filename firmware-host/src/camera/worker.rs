//! Device thread: keeps the device streaming and passes frames and events to the mailbox.
//!
//! A driver may take seconds to reply: a control transfer over USB may take up to five. Only this thread
//! waits for it, so the reader never does.

use super::abi;
use super::session::{Session, Wait, Wanted};
use super::{
    Backoff, CameraConfig, CameraInfo, CaptureError, Control, ControlSettings, Mailbox, Message, RawFrame,
    SequenceCheck, Side, TimestampCheck,
};
use crate::source::{SourceEvent, monotonic_ns};
use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::time::{Duration, Instant};

/// Opening takes several control transfers of up to five seconds each.
const OPEN_TIMEOUT: Duration = Duration::from_secs(20);
/// One control takes a write and a read.
const CONTROL_TIMEOUT: Duration = Duration::from_secs(12);
/// Wait for the thread to end; a stream stuck in a driver that does not reply is then abandoned.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(3);
/// Longest interval between polls; also the resolution at which silence is measured.
const TICK: Duration = Duration::from_millis(100);

type Reply<T> = SyncSender<Result<T, CaptureError>>;

enum Command {
    Controls(Reply<Vec<Control>>),
    Set(ControlSettings, Reply<()>),
}

/// Reader's handle to a device thread. Dropping it closes the device.
#[derive(Debug)]
pub(crate) struct CameraHandle {
    /// Description of the device at opening.
    pub info: CameraInfo,
    commands: Sender<Command>,
    /// Closed to end the thread; written to when a command is waiting.
    wake: Option<UnixStream>,
    /// Its sender is dropped when the thread ends.
    ended: Receiver<()>,
}

impl CameraHandle {
    /// Opens a device and starts its thread.
    pub fn open(
        side: Side,
        device: &str,
        config: &CameraConfig,
        mailbox: &Arc<Mailbox>,
    ) -> Result<Self, CaptureError> {
        let failed = |error| CaptureError::Call { device: device.to_owned(), call: "socketpair", error };
        let (wake, woken) = UnixStream::pair().map_err(failed)?;
        woken.set_nonblocking(true).map_err(failed)?;
        let (commands, inbox) = mpsc::channel();
        let (opened_sender, opened) = mpsc::sync_channel(1);
        let (end_sender, ended) = mpsc::channel();
        let worker = Worker {
            side,
            wanted: Wanted {
                device: device.to_owned(),
                config: config.clone(),
                controls: config.controls.clone(),
                before: None,
            },
            backoff: Backoff::new(
                Duration::from_millis(config.min_retry_ms),
                Duration::from_millis(config.max_retry_ms),
            ),
            mailbox: Arc::clone(mailbox),
            commands: inbox,
            woken,
            _ended: end_sender,
        };
        std::thread::Builder::new()
            .name(format!("camera {device}"))
            .spawn(move || worker.run(&opened_sender))
            .map_err(|error| CaptureError::Call { device: device.to_owned(), call: "thread", error })?;
        let info = receive(&opened, device, OPEN_TIMEOUT)?;
        Ok(Self { info, commands, wake: Some(wake), ended })
    }

    /// All controls with their values.
    pub fn controls(&self) -> Result<Vec<Control>, CaptureError> {
        self.ask(Command::Controls)
    }

    /// Sets controls now and whenever the device is reopened.
    pub fn set(&self, settings: ControlSettings) -> Result<(), CaptureError> {
        self.ask(|reply| Command::Set(settings, reply))
    }

    fn ask<T>(&self, command: impl FnOnce(Reply<T>) -> Command) -> Result<T, CaptureError> {
        let device = &self.info.path.display().to_string();
        let (reply, answer) = mpsc::sync_channel(1);
        let sent = self.commands.send(command(reply)).is_ok();
        let woken = self.wake.as_ref().is_some_and(|mut wake| wake.write_all(&[0]).is_ok());
        if !(sent && woken) {
            return Err(CaptureError::Ended { device: device.clone() });
        }
        receive(&answer, device, CONTROL_TIMEOUT)
    }
}

fn receive<T>(
    answer: &Receiver<Result<T, CaptureError>>,
    device: &str,
    timeout: Duration,
) -> Result<T, CaptureError> {
    let device = device.to_owned();
    match answer.recv_timeout(timeout) {
        Ok(result) => result,
        Err(RecvTimeoutError::Timeout) => Err(CaptureError::NoAnswer { device, waited: timeout }),
        Err(RecvTimeoutError::Disconnected) => Err(CaptureError::Ended { device }),
    }
}

impl Drop for CameraHandle {
    fn drop(&mut self) {
        self.wake = None;
        // The device is free once the thread has ended.
        let _ = self.ended.recv_timeout(CLOSE_TIMEOUT);
    }
}

/// Reason for the end of a stream.
enum End {
    /// The reader has closed the handle.
    Closed,
    Fault(CaptureError),
    Silent(Duration),
}

struct Worker {
    side: Side,
    wanted: Wanted,
    backoff: Backoff,
    mailbox: Arc<Mailbox>,
    commands: Receiver<Command>,
    woken: UnixStream,
    _ended: Sender<()>,
}

/// Reports the end of the thread, also after a panic.
struct LastWord(Side, Arc<Mailbox>);

impl Drop for LastWord {
    fn drop(&mut self) {
        self.1.put(self.0, Message::Ended);
    }
}

impl Worker {
    fn run(mut self, opened: &SyncSender<Result<CameraInfo, CaptureError>>) {
        let _last_word = LastWord(self.side, Arc::clone(&self.mailbox));
        let mut session = match Session::open(&self.wanted) {
            Ok(session) => session,
            Err(error) => {
                let _ = opened.send(Err(error));
                return;
            }
        };
        self.wanted.before = Some(session.info.clone());
        let _ = opened.send(Ok(session.info.clone()));
        loop {
            let device = session.info.to_string();
            self.tell(SourceEvent::Connected { device: device.clone() });
            let end = self.stream(&mut session);
            let reason = match end {
                End::Closed => return,
                End::Silent(silence) => {
                    let silent_ms = silence.as_millis() as u64;
                    self.tell(SourceEvent::Stalled { device: device.clone(), silent_ms });
                    None
                }
                End::Fault(error) => Some(error.reason()),
            };
            match self.reconnect(&device, session, reason) {
                Some(again) => session = again,
                None => return,
            }
        }
    }

    /// Reopens the device, however long it takes; `None` if the reader has closed the handle.
    ///
    /// The old session is closed after the first pause rather than at once: uvcvideo of kernel 6.1
    /// crashes (null pointer in `media_device_unregister_entity`) if an unplugged camera is closed while
    /// its removal is in progress.
    fn reconnect(&mut self, device: &str, old: Session, mut reason: Option<String>) -> Option<Session> {
        let mut old = Some(old);
        loop {
            let pause = self.backoff.pause();
            if let Some(reason) = reason.take() {
                let retry_in_ms = pause.as_millis() as u64;
                self.tell(SourceEvent::Disconnected { device: device.to_owned(), reason, retry_in_ms });
            }
            if !self.rest(pause) {
                return None;
            }
            drop(old.take());
            match Session::open(&self.wanted) {
                Ok(session) => return Some(session),
                Err(error) => reason = Some(error.reason()),
            }
        }
    }

    fn tell(&self, event: SourceEvent) {
        self.mailbox.put(self.side, Message::Event(event));
    }

    /// Passes on frames until the stream ends.
    fn stream(&mut self, session: &mut Session) -> End {
        let rate_hz = self.wanted.config.frame_rate_hz;
        let mut stream =
            Stream { sequence: SequenceCheck::new(rate_hz), clock: TimestampCheck::default(), lost: 0 };
        let limit = self.wanted.config.stall_timeout();
        let mut heard = Instant::now();
        loop {
            match session.wait(self.woken.as_fd(), TICK.min(limit)) {
                Ok(Wait::Woken) => {
                    if !self.serve(Some(session)) {
                        return End::Closed;
                    }
                }
                Ok(Wait::Frame) => match self.fetch(session, &mut stream) {
                    Ok(true) => heard = Instant::now(),
                    Ok(false) => {}
                    Err(error) => return End::Fault(error),
                },
                Ok(Wait::Nothing) => {}
                Err(error) => return End::Fault(error),
            }
            if heard.elapsed() >= limit {
                return End::Silent(heard.elapsed());
            }
        }
    }

    /// Passes on the oldest frame; `false` if there is none.
    fn fetch(&mut self, session: &mut Session, stream: &mut Stream) -> Result<bool, CaptureError> {
        let mut bytes = self.mailbox.spare();
        let Some(frame) = session.fetch(&mut bytes)? else {
            self.mailbox.give_back(bytes);
            return Ok(false);
        };
        let read_ns = monotonic_ns();
        let damaged = match (frame.damaged, bytes.is_empty()) {
            (true, _) => Some("the driver marks it as damaged"),
            (false, true) => Some("it has no bytes"),
            (false, false) => None,
        };
        // The timestamp of a corrupt frame is meaningless.
        let stamp = damaged.is_none().then(|| stream.clock.step(frame.driver_ns, read_ns));
        let time_ns = stamp.as_ref().map_or(read_ns, |stamp| stamp.time_ns);
        let step = stream.sequence.step(frame.number, time_ns);
        if let Some(expected) = step.expected() {
            self.tell(SourceEvent::Sequence { expected, found: step.sequence });
        }
        if let Some(event) = stamp.and_then(|stamp| stamp.event(step.sequence)) {
            self.tell(event);
        }
        stream.lost += step.lost();
        if let Some(reason) = damaged {
            self.tell(SourceEvent::Corrupt { sequence: step.sequence, reason: reason.to_owned() });
            stream.lost += 1;
            self.mailbox.give_back(bytes);
            return Ok(true);
        }
        self.backoff.reset();
        let dropped = std::mem::take(&mut stream.lost);
        let frame = RawFrame { shape: session.shape, sequence: step.sequence, time_ns, dropped, bytes };
        self.mailbox.put(self.side, Message::Frame(frame));
        Ok(true)
    }

    /// Waits; `false` if the reader has closed the handle.
    fn rest(&mut self, pause: Duration) -> bool {
        let begun = Instant::now();
        loop {
            let left = pause.saturating_sub(begun.elapsed());
            if left.is_zero() {
                return true;
            }
            // Rounded up, so that the last millisecond is not spent polling.
            match abi::poll(None, self.woken.as_fd(), left + Duration::from_millis(1)) {
                Ok(ready) if ready.woken && !self.serve(None) => return false,
                Ok(_) => {}
                Err(_) => std::thread::sleep(left.min(TICK)),
            }
        }
    }

    /// Processes commands; `false` if the reader has closed the handle.
    fn serve(&mut self, session: Option<&Session>) -> bool {
        let mut bytes = [0; 64];
        if matches!(self.woken.read(&mut bytes), Ok(0)) {
            return false;
        }
        let gone = || CaptureError::Disconnected { device: self.wanted.device.clone() };
        let mut merged = None;
        while let Ok(command) = self.commands.try_recv() {
            // The caller may have stopped waiting.
            match command {
                Command::Controls(reply) => {
                    let _ = reply.send(session.map(Session::controls).ok_or_else(gone));
                }
                Command::Set(settings, reply) => {
                    let done = session.ok_or_else(gone).and_then(|session| session.apply(&settings));
                    if done.is_ok() {
                        merged.get_or_insert_with(|| self.wanted.controls.clone()).merge(&settings);
                    }
                    let _ = reply.send(done);
                }
            }
        }
        if let Some(merged) = merged {
            self.wanted.controls = merged;
        }
        true
    }
}

/// State kept from frame to frame of one stream.
struct Stream {
    sequence: SequenceCheck,
    clock: TimestampCheck,
    /// Frames lost since the last one passed on.
    lost: u64,
}
