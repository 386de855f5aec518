//! Outputs for results: a recording, publishers and JSON lines.

use super::line::FrameLine;
use super::report::Report;
use crate::publish::{Outlet, Overflow, Publisher};
use crate::recording::{CaptureNote, MessageSink, Recording, RecordingReport, Topic, messages};
use crate::source::{SourceEvent, StereoPair};
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Longest time for writing the remaining lines at the end.
const LAST_LINES: Duration = Duration::from_secs(2);

/// Queue of JSON lines.
#[derive(Debug)]
pub struct Lines {
    /// Takes lines without line terminators.
    pub outlet: Outlet<String>,
    /// Whether a line includes the points of all markers.
    pub with_points: bool,
    /// Whether a full queue drops lines; otherwise sensing waits for the reader.
    pub may_drop: bool,
}

/// All outputs. One that fails is removed; the others continue.
#[derive(Default)]
pub struct Outputs {
    /// A recording that can be replayed.
    pub recording: Option<Recording>,
    /// Publishers for live subscribers.
    pub publishers: Vec<Publisher>,
    /// JSON, one line per frame.
    pub lines: Option<Lines>,
}

/// How the outputs were closed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Closed {
    /// The recording, if there was one.
    pub recording: Option<RecordingReport>,
    /// Why lines were lost, if any were.
    pub lines: Option<String>,
}

impl Outputs {
    /// Names of the outputs.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let recording = self.recording.as_ref().map(|_| "a recording".to_owned());
        let published = self.publishers.iter().map(|p| format!("{} ({})", p.protocol().name(), p.address()));
        let lines = self.lines.as_ref().map(|_| "standard output".to_owned());
        recording.into_iter().chain(published).chain(lines).collect()
    }

    /// Writes one message to the recording and the publishers.
    pub fn message(&mut self, topic: Topic, time_ns: u64, message: &[u8]) {
        self.recording.iter_mut().for_each(|recording| recording.write(topic, time_ns, message));
        self.publish(topic, time_ns, message);
    }

    /// Writes a text message; the text is built only if an output takes it.
    pub fn text(&mut self, topic: Topic, time_ns: u64, text: impl FnOnce() -> String) {
        if self.recording.is_some() || !self.publishers.is_empty() {
            self.message(topic, time_ns, &messages::string(&text()));
        }
    }

    /// Writes a pair's images and capture data.
    pub fn pair(&mut self, pair: &StereoPair) {
        let time_ns = pair.time_ns;
        self.recording.iter_mut().for_each(|recording| recording.write_pair(pair));
        if self.publishers.is_empty() {
            return;
        }
        let left = messages::image(time_ns, messages::SENSOR_FRAME, &pair.left);
        self.publish(Topic::LeftImage, time_ns, &left);
        let right = messages::image(time_ns, messages::RIGHT_FRAME, &pair.right);
        self.publish(Topic::RightImage, time_ns, &right);
        let note = serde_json::json!(CaptureNote::new(pair, true)).to_string();
        self.publish(Topic::Capture, time_ns, &messages::string(&note));
    }

    /// Records an event of the source.
    pub fn event(&mut self, time_ns: u64, event: &SourceEvent) {
        self.recording.iter_mut().for_each(|recording| recording.event(time_ns, event));
        if !self.publishers.is_empty() {
            let note = serde_json::json!(event).to_string();
            self.publish(Topic::Capture, time_ns, &messages::string(&note));
        }
    }

    fn publish(&mut self, topic: Topic, time_ns: u64, message: &[u8]) {
        self.publishers.iter_mut().for_each(|publisher| publisher.write(topic, time_ns, message));
    }

    /// Writes a frame's line; `stop` ends the wait for a slow reader.
    pub fn line(&self, line: &FrameLine, stop: &AtomicBool) {
        let Some(lines) = &self.lines else { return };
        let overflow = if lines.may_drop { Overflow::DropOldest } else { Overflow::WaitUnless(stop) };
        let text = serde_json::json!(line).to_string();
        let bytes = text.len();
        lines.outlet.push(text, bytes, overflow);
    }

    /// Numbers of messages and lines dropped because of slow readers.
    #[must_use]
    pub fn dropped(&self) -> BTreeMap<String, u64> {
        let published = self.publishers.iter().map(|p| (p.protocol().name().to_owned(), p.dropped()));
        let lines = self.lines.iter().map(|lines| ("standard output".to_owned(), lines.outlet.dropped()));
        published.chain(lines).collect()
    }

    /// Removes outputs that failed, and reports each once.
    pub fn take_failed(&mut self) -> Vec<Report> {
        let mut failed = Vec::new();
        let mut lost = |output: &str, reason| {
            failed.push(Report::OutputLost { output: output.to_owned(), reason });
        };
        if let Some(reason) = self.recording.as_ref().and_then(MessageSink::fault) {
            lost("the recording", reason);
            // Closes what was written as far as the disk allows; the fault is already reported.
            let _ = self.recording.take().map(Recording::finish);
        }
        self.publishers.retain(|publisher| {
            publisher.fault().is_none_or(|reason| {
                lost(publisher.protocol().name(), reason);
                false
            })
        });
        if let Some(reason) = self.lines.as_ref().and_then(|lines| lines.outlet.fault()) {
            lost("standard output", reason);
            self.lines = None;
        }
        failed
    }

    /// Closes all outputs within seconds.
    #[must_use]
    pub fn finish(&mut self) -> Closed {
        for publisher in self.publishers.drain(..) {
            publisher.finish();
        }
        let lines = self.lines.take().and_then(|lines| {
            let unsent = lines.outlet.finish(LAST_LINES);
            (unsent > 0).then(|| format!("{unsent} lines were not read"))
        });
        Closed { recording: self.recording.take().map(Recording::finish), lines }
    }
}
