//! Where results go: a recording, publishers, lines of JSON.

use super::line::FrameLine;
use super::report::Report;
use crate::publish::{Outlet, Overflow, Publisher};
use crate::recording::{CaptureNote, MessageSink, Recording, RecordingReport, Topic, messages};
use crate::source::{SourceEvent, StereoPair};
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// How long lines may still be written at the end.
const LAST_LINES: Duration = Duration::from_secs(2);

/// Lines of JSON on their way.
#[derive(Debug)]
pub struct Lines {
    /// Takes lines without their end.
    pub outlet: Outlet<String>,
    /// Whether a line has the points of all markers.
    pub with_points: bool,
    /// Whether a full queue drops lines; else sensing waits for the reader.
    pub may_drop: bool,
}

/// All outputs. One that fails takes no more; the others go on.
#[derive(Default)]
pub struct Outputs {
    /// A recording that replays.
    pub recording: Option<Recording>,
    /// Live listeners.
    pub publishers: Vec<Publisher>,
    /// One line a frame.
    pub lines: Option<Lines>,
}

/// What became of the outputs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Closed {
    /// The recording, if there was one.
    pub recording: Option<RecordingReport>,
    /// Why lines were lost, if they were.
    pub lines: Option<String>,
}

impl Outputs {
    /// What they are, in words.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let recording = self.recording.as_ref().map(|_| "a recording".to_owned());
        let published = self.publishers.iter().map(|p| format!("{} ({})", p.protocol().name(), p.address()));
        let lines = self.lines.as_ref().map(|_| "standard output".to_owned());
        recording.into_iter().chain(published).chain(lines).collect()
    }

    /// One message to the recording and the publishers.
    pub fn message(&mut self, topic: Topic, time_ns: u64, message: &[u8]) {
        self.recording.iter_mut().for_each(|recording| recording.write(topic, time_ns, message));
        self.publish(topic, time_ns, message);
    }

    /// A message of text, made only if anybody takes it.
    pub fn text(&mut self, topic: Topic, time_ns: u64, text: impl FnOnce() -> String) {
        if self.recording.is_some() || !self.publishers.is_empty() {
            self.message(topic, time_ns, &messages::string(&text()));
        }
    }

    /// A pair's images and how it was captured.
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

    /// What happened to the source.
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

    /// A frame's line; `stop` ends the wait for a slow reader.
    pub fn line(&self, line: &FrameLine, stop: &AtomicBool) {
        let Some(lines) = &self.lines else { return };
        let overflow = if lines.may_drop { Overflow::DropOldest } else { Overflow::WaitUnless(stop) };
        let text = serde_json::json!(line).to_string();
        let bytes = text.len();
        lines.outlet.push(text, bytes, overflow);
    }

    /// Messages and lines that were dropped since nobody took them in time.
    #[must_use]
    pub fn dropped(&self) -> BTreeMap<String, u64> {
        let published = self.publishers.iter().map(|p| (p.protocol().name().to_owned(), p.dropped()));
        let lines = self.lines.iter().map(|lines| ("standard output".to_owned(), lines.outlet.dropped()));
        published.chain(lines).collect()
    }

    /// Outputs that failed, each reported once: they are taken out.
    pub fn take_failed(&mut self) -> Vec<Report> {
        let mut failed = Vec::new();
        let mut lost = |output: &str, reason| {
            failed.push(Report::OutputLost { output: output.to_owned(), reason });
        };
        if let Some(reason) = self.recording.as_ref().and_then(MessageSink::fault) {
            lost("the recording", reason);
            // What it wrote is closed as well as the disk lets it; the fault is known already.
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

    /// Closes all, within seconds.
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
