//! A running recording, used by the robot task and by continuous sensing.

use super::images::PairImages;
use super::part::{Message, Preamble};
use super::ring::Ring;
use super::shared::Shared;
use super::store::{OpenPart, files};
use super::worker::{Command, Plan, Worker, gap_message};
use super::{CaptureNote, METADATA_CLOCK, METADATA_CONFIG, METADATA_DECODER, METADATA_VERSION};
use super::{MessageSink, RecordingError, Topic, messages};
use crate::config::{RecordingConfig, RecordingMode};
use crate::source::{SourceEvent, StereoPair, epoch_ns, jpeg};
use gelstereo_core::pipeline::RestRecord;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

/// Contents of a recording besides messages; repeated in each of its files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Content {
    /// The whole configuration including the rig.
    pub config_toml: String,
    /// Names and bytes of attached files: the part's mesh.
    pub attachments: Vec<(String, Vec<u8>)>,
}

/// Clock for the log times of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogClock {
    /// The frame source's clock: a simulated run gives the same bytes every time. The source waits for
    /// the disk.
    Source,
    /// This computer's wall clock. The source never waits, and each chunk is synced to the disk.
    Wall,
}

impl LogClock {
    const fn name(self) -> &'static str {
        match self {
            Self::Source => "source",
            Self::Wall => "wall",
        }
    }
}

/// Result of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RecordingReport {
    /// Its files, in order.
    pub files: Vec<PathBuf>,
    /// Messages written.
    pub messages: u64,
    /// Messages lost because the disk was too slow.
    pub lost_messages: u64,
    /// Total size of the closed files, bytes.
    pub bytes: u64,
    /// Why it ended early, if it did. Everything written before can be replayed.
    pub fault: Option<String>,
}

/// A running recording. Disk faults end the recording and nothing else.
pub struct Recording {
    commands: Option<Sender<Command>>,
    thread: Option<JoinHandle<RecordingReport>>,
    shared: Arc<Shared>,
    clock: LogClock,
    every_nth: u64,
    pairs: u64,
    lost: u64,
    /// Lost messages not yet reported by a message in the recording.
    untold: u64,
}

impl Recording {
    /// Creates the first file and its folder. In the mode `ring` the file is created by a trigger.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the file cannot be created.
    pub fn create(
        settings: &RecordingConfig,
        content: Content,
        clock: LogClock,
    ) -> Result<Self, RecordingError> {
        let path = &settings.path;
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|error| RecordingError::Io {
                path: path.clone(),
                doing: "create the folder of",
                error,
            })?;
        }
        Self::with_stores(settings, content, clock, files(path.clone()))
    }

    /// Writes to custom stores instead of files.
    ///
    /// # Errors
    /// [`RecordingError`] when the first part cannot be opened.
    pub fn with_stores(
        settings: &RecordingConfig,
        content: Content,
        clock: LogClock,
        open: OpenPart,
    ) -> Result<Self, RecordingError> {
        let metadata = [
            (METADATA_CONFIG, content.config_toml.as_str()),
            (METADATA_VERSION, env!("CARGO_PKG_VERSION")),
            (METADATA_CLOCK, clock.name()),
            (METADATA_DECODER, jpeg::DECODER),
        ];
        let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        let nanoseconds = |seconds: f64| (seconds * 1e9) as u64;
        let ring = Ring::new(nanoseconds(settings.ring_s), (settings.ring_mb as usize) * 1_000_000);
        let mut worker = Worker::new(Plan {
            open,
            preamble: Preamble { metadata, attachments: content.attachments },
            clock,
            images: settings.images,
            split_bytes: u64::from(settings.split_mb) * 1_000_000,
            ring: (settings.mode == RecordingMode::Ring).then_some(ring),
            after_ns: nanoseconds(settings.ring_after_s),
        });
        worker.start()?;
        let shared = Arc::new(Shared::default());
        let (commands, received) = channel();
        let thread = {
            let shared = Arc::clone(&shared);
            std::thread::Builder::new()
                .name("recording".to_owned())
                .spawn(move || {
                    let _told = TellsOfPanic(Arc::clone(&shared));
                    worker.run(&received, &shared)
                })
                .map_err(RecordingError::Disk)?
        };
        Ok(Self {
            commands: Some(commands),
            thread: Some(thread),
            shared,
            clock,
            every_nth: u64::from(settings.every_nth.max(1)),
            pairs: 0,
            lost: 0,
            untold: 0,
        })
    }

    /// Writes a pair's capture data and, for every nth pair, its images. Results of the pair follow.
    pub fn write_pair(&mut self, pair: &StereoPair) {
        let keeps_images = self.pairs.is_multiple_of(self.every_nth);
        self.pairs += 1;
        let (log_ns, time_ns) = (self.log_ns(pair.time_ns), pair.time_ns);
        self.json(time_ns, &CaptureNote::new(pair, keeps_images), true);
        if keeps_images {
            self.send(Command::Images { log_ns, time_ns, images: PairImages::of(pair) }, time_ns);
        }
    }

    /// Writes an event of the source.
    pub fn event(&mut self, time_ns: u64, event: &SourceEvent) {
        self.json(time_ns, event, false);
    }

    /// Keeps the rest state, so that each later file can be replayed without the earlier ones.
    pub fn rest(&mut self, record: &RestRecord) {
        match serde_json::to_vec(record) {
            Ok(bytes) => self.send(Command::Rest(bytes), 0),
            Err(error) => self.shared.fail(&error.to_string()),
        }
    }

    /// In the mode `ring`, saves the time around this moment; in the mode `all` it is recorded anyway.
    pub fn trigger(&mut self, time_ns: u64, cause: &str) {
        self.json(time_ns, &serde_json::json!({ "event": "trigger", "cause": cause }), false);
        let log_ns = self.log_ns(time_ns);
        self.send(Command::Trigger { log_ns }, time_ns);
    }

    /// Bytes waiting for the disk.
    #[must_use]
    pub fn queued_bytes(&self) -> usize {
        self.shared.queued_bytes()
    }

    /// Messages lost so far because the disk was too slow.
    #[must_use]
    pub const fn lost_messages(&self) -> u64 {
        self.lost
    }

    /// Closes the recording.
    #[must_use]
    pub fn finish(mut self) -> RecordingReport {
        self.close()
    }

    fn close(&mut self) -> RecordingReport {
        self.commands = None;
        let mut report = match self.thread.take().map(JoinHandle::join) {
            Some(Ok(report)) => report,
            Some(Err(_)) | None => RecordingReport::default(),
        };
        report.lost_messages = self.lost;
        report.fault = report.fault.or_else(|| self.shared.fault());
        report
    }

    fn log_ns(&self, time_ns: u64) -> u64 {
        match self.clock {
            LogClock::Source => time_ns,
            LogClock::Wall => epoch_ns(),
        }
    }

    fn json(&mut self, time_ns: u64, content: &impl Serialize, begins_pair: bool) {
        match serde_json::to_string(content) {
            Ok(text) => {
                let (topic, log_ns) = (Topic::Capture, self.log_ns(time_ns));
                let data = messages::string(&text);
                let message = Message { topic, log_ns, publish_ns: time_ns, data, begins_pair };
                self.send(Command::Message(message), time_ns);
            }
            Err(error) => self.shared.fail(&error.to_string()),
        }
    }

    fn send(&mut self, command: Command, time_ns: u64) {
        if self.untold > 0 {
            let gap = Command::Message(gap_message(self.log_ns(time_ns), time_ns, self.untold));
            if self.offer(gap) {
                self.untold = 0;
            }
        }
        if !self.offer(command) && self.shared.fault().is_none() {
            self.lost += 1;
            self.untold += 1;
        }
    }

    fn offer(&self, command: Command) -> bool {
        let bytes = command.bytes();
        let fits = self.shared.queue(bytes, self.clock == LogClock::Source);
        fits && self.commands.as_ref().is_some_and(|commands| commands.send(command).is_ok())
    }
}

impl MessageSink for Recording {
    fn write(&mut self, topic: Topic, time_ns: u64, message: &[u8]) {
        let (log_ns, data) = (self.log_ns(time_ns), message.to_vec());
        let message = Message { topic, log_ns, publish_ns: time_ns, data, begins_pair: false };
        self.send(Command::Message(message), time_ns);
    }

    fn fault(&self) -> Option<String> {
        self.shared.fault()
    }
}

/// Releases a source that waits for a writer thread that panicked.
struct TellsOfPanic(Arc<Shared>);

impl Drop for TellsOfPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.fail("the recording's thread has panicked");
        }
    }
}

impl Drop for Recording {
    /// Closes a recording that was not finished explicitly.
    fn drop(&mut self) {
        self.close();
    }
}
