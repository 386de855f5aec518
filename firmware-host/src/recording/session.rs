//! A running recording, as the robot task and endless sensing write it.

use super::{CaptureNote, MessageSink, Recorder, RecordingError, Topic, messages};
use crate::config::RecordingConfig;
use crate::source::{SourceEvent, StereoPair};
use gelstereo_core::pipeline::RestRecord;
use serde::Serialize;
use std::path::PathBuf;

/// What a recording holds besides messages; each of its files has it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Content {
    /// The whole configuration with the rig.
    pub config_toml: String,
    /// Names and bytes of attached files: the part's mesh.
    pub attachments: Vec<(String, Vec<u8>)>,
}

/// Whose clock stamps the moment at which a message was recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogClock {
    /// The frame source's: a simulated run gives the same bytes every time.
    Source,
    /// This computer's wall clock.
    Wall,
}

/// What became of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RecordingReport {
    /// Its files, in order.
    pub files: Vec<PathBuf>,
    /// Messages written.
    pub messages: u64,
    /// Why it ended early, if it did. What was written before can be replayed.
    pub fault: Option<String>,
}

/// A running recording. Faults of the disk end the recording, and nothing else.
pub struct Recording {
    recorder: Option<Recorder>,
    report: RecordingReport,
}

impl Recording {
    /// Creates the first file, and the folder that it stands in.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the file cannot be created.
    pub fn create(
        settings: &RecordingConfig,
        content: Content,
        _clock: LogClock,
    ) -> Result<Self, RecordingError> {
        let recorder = Recorder::create(&settings.path, &content.config_toml, &content.attachments)?;
        let report = RecordingReport { files: vec![settings.path.clone()], ..RecordingReport::default() };
        Ok(Self { recorder: Some(recorder), report })
    }

    /// Writes both images of a pair and how it was captured.
    pub fn write_pair(&mut self, pair: &StereoPair) {
        let time_ns = pair.time_ns;
        self.write(Topic::LeftImage, time_ns, &messages::image(time_ns, messages::SENSOR_FRAME, &pair.left));
        self.write(Topic::RightImage, time_ns, &messages::image(time_ns, messages::RIGHT_FRAME, &pair.right));
        self.json(Topic::Capture, time_ns, &CaptureNote::new(pair));
    }

    /// Writes what happened to the source.
    pub fn event(&mut self, time_ns: u64, event: &SourceEvent) {
        self.json(Topic::Capture, time_ns, event);
    }

    /// Keeps the rest state, so that each later file can be computed again without the ones before.
    pub fn rest(&mut self, _record: &RestRecord) {}

    /// Saves the time around this moment in the mode `ring`; in the mode `all` it is recorded anyway.
    pub fn trigger(&mut self, _time_ns: u64, _cause: &str) {}

    /// Closes the recording.
    #[must_use]
    pub fn finish(mut self) -> RecordingReport {
        if let Some(Err(error)) = self.recorder.take().map(Recorder::finish) {
            self.report.fault = Some(error.to_string());
        }
        self.report
    }

    fn json(&mut self, topic: Topic, time_ns: u64, content: &impl Serialize) {
        match serde_json::to_string(content) {
            Ok(text) => self.write(topic, time_ns, &messages::string(&text)),
            Err(error) => self.fail(&error.to_string()),
        }
    }

    fn fail(&mut self, reason: &str) {
        self.recorder = None;
        self.report.fault.get_or_insert_with(|| reason.to_owned());
    }
}

impl MessageSink for Recording {
    fn write(&mut self, topic: Topic, time_ns: u64, message: &[u8]) {
        let Some(recorder) = &mut self.recorder else { return };
        match recorder.write(topic, time_ns, message) {
            Ok(()) => self.report.messages += 1,
            Err(error) => self.fail(&error.to_string()),
        }
    }

    fn fault(&self) -> Option<String> {
        self.report.fault.clone()
    }
}
