//! The thread that writes a recording, so that the robot never waits for a disk.

use super::images::{ImageEncoder, PairImages};
use super::part::{Message, PartFile, Preamble};
use super::ring::Ring;
use super::session::LogClock;
use super::shared::Shared;
use super::store::OpenPart;
use super::{METADATA_PART, RecordingError, RecordingReport, Topic, messages};
use crate::config::ImageFormat;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// Longest chunk on the recording's clock. A power cut loses at most this time plus the disk's delay.
const CHUNK_TIME: Duration = Duration::from_millis(500);

/// Commands for the thread.
pub(super) enum Command {
    Message(Message),
    /// Images of the pair whose `begins_pair` message came before.
    Images {
        log_ns: u64,
        time_ns: u64,
        images: PairImages,
    },
    /// The rest state, as an attachment of later files.
    Rest(Vec<u8>),
    /// Keep the time around this moment.
    Trigger {
        log_ns: u64,
    },
}

impl Command {
    /// Size in memory, bytes.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Message(message) => message.data.len(),
            Self::Images { images, .. } => images.bytes(),
            Self::Rest(bytes) => bytes.len(),
            Self::Trigger { .. } => 0,
        }
    }
}

/// Settings of the thread.
pub(super) struct Plan {
    pub open: OpenPart,
    pub preamble: Preamble,
    pub clock: LogClock,
    pub images: ImageFormat,
    pub split_bytes: u64,
    pub ring: Option<Ring>,
    pub after_ns: u64,
}

/// The thread's state.
pub(super) struct Worker {
    plan: Plan,
    encoder: ImageEncoder,
    part: u32,
    file: Option<PartFile>,
    /// Start of the open chunk on the messages' clock and on this computer's.
    chunk: Option<(u64, Instant)>,
    /// In the mode `ring`: time until which the open file is written.
    until_ns: u64,
    report: RecordingReport,
}

impl Worker {
    pub fn new(plan: Plan) -> Self {
        let encoder = ImageEncoder::new(plan.images);
        let report = RecordingReport::default();
        Self { plan, encoder, part: 0, file: None, chunk: None, until_ns: 0, report }
    }

    /// Opens the first file, unless a trigger will.
    pub fn start(&mut self) -> Result<(), RecordingError> {
        if self.plan.ring.is_none() { self.begin_part() } else { Ok(()) }
    }

    /// Writes until all senders are gone, then closes the recording.
    pub fn run(mut self, commands: &Receiver<Command>, shared: &Arc<Shared>) -> RecordingReport {
        let mut result = Ok(());
        while result.is_ok() {
            match commands.recv_timeout(self.patience()) {
                Ok(command) => {
                    let bytes = command.bytes();
                    result = self.take(command);
                    shared.written(bytes);
                }
                Err(RecvTimeoutError::Timeout) => result = self.flush(),
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        if let Err(error) = result.and_then(|()| self.end_part()) {
            self.report.fault = Some(error.to_string());
            shared.fail(&error.to_string());
        }
        self.report
    }

    /// How long the open chunk may still wait for messages.
    fn patience(&self) -> Duration {
        match (self.plan.clock, self.chunk) {
            (LogClock::Wall, Some((_, begun))) => CHUNK_TIME.saturating_sub(begun.elapsed()),
            // The source's clock does not advance while nothing arrives.
            _ => Duration::from_secs(3600),
        }
    }

    fn take(&mut self, command: Command) -> Result<(), RecordingError> {
        match command {
            Command::Message(message) => self.message(message),
            Command::Images { log_ns, time_ns, images } => {
                for (topic, data) in self.encoder.messages(time_ns, &images) {
                    self.message(Message { topic, log_ns, publish_ns: time_ns, data, begins_pair: false })?;
                }
                Ok(())
            }
            Command::Rest(bytes) => {
                let name = super::ATTACHMENT_REST;
                let attachments = &mut self.plan.preamble.attachments;
                attachments.retain(|(other, _)| other != name);
                attachments.push((name.to_owned(), bytes));
                Ok(())
            }
            Command::Trigger { log_ns } => self.trigger(log_ns),
        }
    }

    fn message(&mut self, message: Message) -> Result<(), RecordingError> {
        if self.plan.ring.is_some() && self.file.is_some() && message.log_ns > self.until_ns {
            self.end_part()?;
        }
        if let (Some(ring), None) = (&mut self.plan.ring, &self.file) {
            ring.push(message);
            return Ok(());
        }
        let full = self.file.as_ref().is_some_and(|file| file.bytes() >= self.plan.split_bytes);
        if full && message.begins_pair {
            self.end_part()?;
            self.begin_part()?;
        }
        self.write(&message)
    }

    fn write(&mut self, message: &Message) -> Result<(), RecordingError> {
        let Some(file) = &mut self.file else { return Ok(()) };
        file.write(message)?;
        self.report.messages += 1;
        let (begun_ns, begun) = *self.chunk.get_or_insert((message.log_ns, Instant::now()));
        let over = match self.plan.clock {
            LogClock::Source => u128::from(message.log_ns.saturating_sub(begun_ns)) >= CHUNK_TIME.as_nanos(),
            LogClock::Wall => begun.elapsed() >= CHUNK_TIME,
        };
        // Stage messages are few, and the most important part of a truncated recording.
        if over || message.topic == Topic::Stage { self.flush() } else { Ok(()) }
    }

    fn trigger(&mut self, log_ns: u64) -> Result<(), RecordingError> {
        let Some(ring) = &mut self.plan.ring else { return Ok(()) };
        self.until_ns = log_ns.saturating_add(self.plan.after_ns);
        if self.file.is_some() {
            return Ok(());
        }
        let kept = ring.take();
        self.begin_part()?;
        kept.iter().try_for_each(|message| self.write(message))?;
        self.flush()
    }

    fn begin_part(&mut self) -> Result<(), RecordingError> {
        let (path, store) = (self.plan.open)(self.part)?;
        self.plan.preamble.metadata.insert(METADATA_PART.to_owned(), self.part.to_string());
        self.part += 1;
        let durable = self.plan.clock == LogClock::Wall;
        self.file = Some(PartFile::begin(store, &self.plan.preamble, durable)?);
        self.report.files.push(path);
        Ok(())
    }

    fn flush(&mut self) -> Result<(), RecordingError> {
        self.chunk = None;
        self.file.as_mut().map_or(Ok(()), PartFile::flush)
    }

    fn end_part(&mut self) -> Result<(), RecordingError> {
        self.chunk = None;
        if let Some(file) = self.file.take() {
            self.report.bytes += file.finish()?;
        }
        Ok(())
    }
}

/// A message that reports how many messages were lost.
pub(super) fn gap_message(log_ns: u64, time_ns: u64, lost: u64) -> Message {
    let note = serde_json::json!({ "event": "recording_gap", "lost_messages": lost });
    let data = messages::string(&note.to_string());
    Message { topic: Topic::Capture, log_ns, publish_ns: time_ns, data, begins_pair: false }
}
