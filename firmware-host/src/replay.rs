//! A recording computed again: the same images, settings and requests must give the same bits.

use crate::config::Config;
use crate::notes::{action_note, frame_note};
use crate::part::Part;
use crate::recording::{Item, METADATA_CONFIG, Reader, RecordingError, Topic, messages};
use crate::report::Stage;
use crate::run::HostError;
use crate::sensing::{Action, Sensing};
use crate::source::StereoPair;
use gelstereo_core::params::Params;
use gelstereo_sim::Shape;
use serde::Serialize;
use std::path::Path;

/// The first result that differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Frame of the recording, from 0.
    pub frame: u64,
    /// What was recorded.
    pub recorded: String,
    /// What was computed now.
    pub computed: String,
}

/// What came of a replay.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReplayReport {
    /// Frames that were computed again.
    pub frames: u64,
    /// Localisations that were computed again.
    pub localizations: u64,
    /// Results that differ.
    pub differing: u64,
    /// The first of them.
    pub first: Option<Difference>,
    /// Whether the recording ends before its end mark.
    pub truncated: bool,
    /// Whether other settings than the recorded ones were used.
    pub changed_params: bool,
}

impl std::fmt::Display for ReplayReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { frames, localizations, differing, .. } = self;
        if self.truncated {
            writeln!(f, "the recording is cut off; what stands before the cut was read")?;
        }
        write!(f, "{frames} frames, {localizations} localizations: ")?;
        match &self.first {
            None if *frames == 0 => write!(f, "nothing to compare"),
            None => write!(f, "same bits"),
            Some(first) => write!(
                f,
                "{differing} results differ, the first at frame {}\n  recorded {}\n  computed {}",
                first.frame, first.recorded, first.computed
            ),
        }
    }
}

/// Computes a recording again, with `params` in place of the recorded settings if they are given. `progress` hears
/// the number of frames done.
///
/// # Errors
/// [`HostError::Recording`] when the file is no recording of a run or is damaged before its end.
pub fn replay(
    path: &Path,
    params: Option<Params>,
    progress: &mut dyn FnMut(u64),
) -> Result<ReplayReport, HostError> {
    let mut reader = Reader::open(path)?;
    let mut replay = Replay::start(&mut reader, params)?;
    while let Some(item) = replay.held.take().map_or_else(|| reader.next_item(), |item| Ok(Some(item)))? {
        if let Item::Message { topic, data, .. } = item {
            replay.message(topic, &data)?;
            progress(replay.report.frames);
        }
    }
    replay.report.truncated = reader.truncated();
    Ok(replay.report)
}

struct Replay {
    sensing: Sensing,
    pair: StereoPair,
    /// The summary of the last pair, until the recorded one comes to be compared.
    computed: Option<String>,
    /// The first message, which ended the search for configuration and mesh.
    held: Option<Item>,
    report: ReplayReport,
}

impl Replay {
    fn start(reader: &mut Reader, params: Option<Params>) -> Result<Self, HostError> {
        let (mut text, mut mesh, mut held) = (None, Vec::new(), None);
        while let Some(item) = reader.next_item()? {
            match item {
                Item::Metadata(mut entries) => text = entries.remove(METADATA_CONFIG),
                Item::Attachment { data, .. } => mesh = data,
                Item::Message { .. } => {
                    held = Some(item);
                    break;
                }
            }
        }
        let text = text.ok_or(RecordingError::NoConfig)?;
        let config = Config::parse(&text, "configuration of the recording")?;
        let changed_params = params.as_ref().is_some_and(|params| *params != config.params);
        let params = params.unwrap_or_else(|| config.params.clone());
        params.validate().map_err(crate::config::ConfigError::Params)?;
        let part = match &config.part.shape {
            shape @ Shape::Mesh { .. } => Part::from_bytes(shape, mesh)?,
            shape => Part::load(shape)?,
        };
        let sensing = Sensing::new(&config.rig()?, &params, part.template(&config.part)?)?;
        let report = ReplayReport {
            frames: 0,
            localizations: 0,
            differing: 0,
            first: None,
            truncated: false,
            changed_params,
        };
        Ok(Self { sensing, pair: StereoPair::default(), computed: None, held, report })
    }

    fn message(&mut self, topic: Topic, data: &[u8]) -> Result<(), HostError> {
        let fail = |error| RecordingError::Message { topic: topic.name(), error };
        match topic {
            Topic::LeftImage => {
                self.pair.time_ns = messages::read_image(data, &mut self.pair.left).map_err(fail)?;
            }
            Topic::RightImage => {
                messages::read_image(data, &mut self.pair.right).map_err(fail)?;
                let sensed = self.sensing.process(&self.pair).map(|_| ());
                self.computed = Some(frame_note(&sensed, &self.sensing).to_string());
            }
            Topic::Frame => {
                let recorded = messages::read_string(data).map_err(fail)?;
                if let Some(computed) = self.computed.take() {
                    self.compare(recorded, computed);
                    self.report.frames += 1;
                }
            }
            Topic::Stage => self.request(messages::read_string(data).map_err(fail)?)?,
            Topic::Points | Topic::Pose | Topic::Gripper | Topic::Robot | Topic::Capture => {}
        }
        Ok(())
    }

    /// Asks again what a stage asked of the pipeline, if it did.
    fn request(&mut self, recorded: &str) -> Result<(), HostError> {
        let fail = |error: serde_json::Error| RecordingError::Content {
            place: Topic::Stage.name(),
            error: error.to_string(),
        };
        let mut note: serde_json::Value = serde_json::from_str(recorded).map_err(fail)?;
        let Some(request) = note.get_mut("request").map(serde_json::Value::take) else {
            return Ok(());
        };
        let action: Action = serde_json::from_value(request).map_err(fail)?;
        let stage: Stage = serde_json::from_value(note["stage"].take()).map_err(fail)?;
        let result = self.sensing.act(&action);
        self.report.localizations += u64::from(matches!(action, Action::Localize { .. }));
        self.compare(recorded, action_note(stage, &action, &result).to_string());
        Ok(())
    }

    fn compare(&mut self, recorded: &str, computed: String) {
        if recorded == computed {
            return;
        }
        self.report.differing += 1;
        let frame = self.report.frames;
        self.report.first.get_or_insert_with(|| Difference {
            frame,
            recorded: recorded.to_owned(),
            computed,
        });
    }
}
