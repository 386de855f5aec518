//! Replays a recording: the same images, settings and actions must give the same bits.

use crate::compliance;
use crate::config::{Config, RecordingMode};
use crate::notes::{action_note, frame_note};
use crate::part::Part;
use crate::recording::{
    ATTACHMENT_COMPLIANCE, ATTACHMENT_REST, CaptureNote, ImageDecoder, Item, METADATA_CONFIG,
    METADATA_DECODER, METADATA_PART, Reader, RecordingError, Topic, messages, pixel_crc,
};
use crate::report::Stage;
use crate::run::HostError;
use crate::sensing::{Action, Sensing};
use crate::source::{StereoPair, jpeg};
use gelstereo_core::params::Params;
use gelstereo_core::pipeline::RestRecord;
use gelstereo_sim::Shape;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// The first result that differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Frame of the recording, from 0.
    pub frame: u64,
    /// The recorded result.
    pub recorded: String,
    /// The recomputed result.
    pub computed: String,
}

/// Result of a replay.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReplayReport {
    /// Number of frames recomputed.
    pub frames: u64,
    /// Number of localisations recomputed.
    pub localizations: u64,
    /// Number of results that differ.
    pub differing: u64,
    /// The first difference.
    pub first: Option<Difference>,
    /// Pairs whose decoded pixels differ from the recorded ones: then the decoder differs, not the pipeline.
    pub other_pixels: u64,
    /// The JPEG decoder named in the recording, if it is not the present one.
    pub other_decoder: Option<String>,
    /// Whether the recording lacks its end mark.
    pub truncated: bool,
    /// Whether other settings than the recorded ones were used.
    pub changed_params: bool,
    /// Why bit-identical results cannot be expected, if so.
    pub inexact: Option<String>,
}

impl ReplayReport {
    /// Whether something was recomputed, and differences occur only where they are expected.
    #[must_use]
    pub fn is_good(&self) -> bool {
        let may_differ = self.changed_params || self.inexact.is_some();
        self.frames > 0 && self.other_pixels == 0 && (self.differing == 0 || may_differ)
    }
}

impl std::fmt::Display for ReplayReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { frames, localizations, differing, .. } = self;
        if self.truncated {
            writeln!(f, "the recording is cut off; what stands before the cut was read")?;
        }
        if let Some(reason) = &self.inexact {
            writeln!(f, "other bits are to be expected: {reason}")?;
        }
        if self.other_pixels > 0 {
            let theirs = self.other_decoder.as_deref().unwrap_or(jpeg::DECODER);
            writeln!(
                f,
                "{} pairs have other pixels than when they were recorded: decoder {}, then {theirs}",
                self.other_pixels,
                jpeg::DECODER
            )?;
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

/// Replays a recording, with `params` in place of the recorded settings if given. `parts` are its files,
/// in any order. `progress` receives the number of frames done.
///
/// # Errors
/// [`HostError::Recording`] when a file is not a recording of a run or is damaged before its end, or the
/// parts do not belong together.
pub fn replay<P: AsRef<Path>>(
    parts: &[P],
    params: Option<Params>,
    progress: &mut dyn FnMut(u64),
) -> Result<ReplayReport, HostError> {
    let mut openings = Vec::new();
    for path in parts {
        openings.push(Opening::read(path.as_ref())?);
    }
    openings.sort_by_key(|opening| opening.part);
    let mut openings = openings.into_iter();
    let Some(mut opening) = openings.next() else { return Err(RecordingError::NoConfig.into()) };
    let mut replay = Replay::start(&mut opening, params)?;
    loop {
        while let Some(item) = opening.next_item()? {
            if let Item::Message { topic, data, .. } = item {
                replay.message(topic, &data)?;
                progress(replay.report.frames);
            }
        }
        let truncated = opening.reader.truncated();
        replay.report.truncated |= truncated;
        let Some(next) = openings.next() else { break };
        replay.follow(&opening, &next, truncated)?;
        opening = next;
    }
    Ok(replay.report)
}

/// An open file and the content before its first message.
struct Opening {
    reader: Reader,
    config_toml: String,
    decoder: Option<String>,
    part: u32,
    attachments: BTreeMap<String, Vec<u8>>,
    /// The first message, which was read while opening.
    held: Option<Item>,
}

impl Opening {
    fn read(path: &Path) -> Result<Self, HostError> {
        let mut reader = Reader::open(path)?;
        let (mut metadata, mut attachments, mut held) = (BTreeMap::new(), BTreeMap::new(), None);
        while let Some(item) = reader.next_item()? {
            match item {
                Item::Metadata(entries) => metadata = entries,
                Item::Attachment { name, data } => {
                    attachments.insert(name, data);
                }
                Item::Message { .. } => {
                    held = Some(item);
                    break;
                }
            }
        }
        let config_toml = metadata.remove(METADATA_CONFIG).ok_or(RecordingError::NoConfig)?;
        let part = metadata.get(METADATA_PART).and_then(|part| part.parse().ok()).unwrap_or(0);
        let decoder = metadata.remove(METADATA_DECODER);
        Ok(Self { reader, config_toml, decoder, part, attachments, held })
    }

    fn next_item(&mut self) -> Result<Option<Item>, RecordingError> {
        self.held.take().map_or_else(|| self.reader.next_item(), |item| Ok(Some(item)))
    }
}

struct Replay {
    sensing: Sensing,
    mode: RecordingMode,
    decoder: ImageDecoder,
    pair: StereoPair,
    /// Recorded capture data of the pair whose images come next.
    capture: Option<CaptureNote>,
    /// Whether a pair waits for its recorded note.
    is_complete: bool,
    report: ReplayReport,
}

impl Replay {
    fn start(opening: &mut Opening, params: Option<Params>) -> Result<Self, HostError> {
        let config = Config::parse(&opening.config_toml, "configuration of the recording")?;
        let changed_params = params.as_ref().is_some_and(|params| *params != config.params);
        let params = params.unwrap_or_else(|| config.params.clone());
        params.validate().map_err(crate::config::ConfigError::Params)?;
        let compliance = compliance::attached(&config, opening.attachments.remove(ATTACHMENT_COMPLIANCE))?;
        let part = match &config.part.shape {
            shape @ Shape::Mesh { .. } => {
                let mut attachments = std::mem::take(&mut opening.attachments);
                opening.attachments.extend(attachments.remove_entry(ATTACHMENT_REST));
                Part::from_bytes(shape, attachments.into_values().next().unwrap_or_default())?
            }
            shape => Part::load(shape)?,
        };
        let sensing = Sensing::new(&config.rig()?, &params, part.template(&config.part)?)?
            .with_compliance(compliance)?;
        let every_nth = config.recording.every_nth;
        let thinned = format!("only one of {every_nth} pairs has its images in the recording");
        let report = ReplayReport {
            frames: 0,
            localizations: 0,
            differing: 0,
            first: None,
            other_pixels: 0,
            other_decoder: opening.decoder.clone().filter(|decoder| decoder != jpeg::DECODER),
            truncated: false,
            changed_params,
            inexact: (every_nth > 1).then_some(thinned),
        };
        let mut replay = Self {
            sensing,
            mode: config.recording.mode,
            decoder: ImageDecoder::default(),
            pair: StereoPair::default(),
            capture: None,
            is_complete: false,
            report,
        };
        if opening.part > 0 || opening.attachments.contains_key(ATTACHMENT_REST) {
            replay.resume(opening)?;
        }
        Ok(replay)
    }

    /// Starts in the middle of a run, from the rest state in the file.
    fn resume(&mut self, opening: &Opening) -> Result<(), HostError> {
        self.expect_differences("the recording begins in the middle of a run");
        let Some(rest) = opening.attachments.get(ATTACHMENT_REST) else { return Ok(()) };
        let fail = |error: String| RecordingError::Content { place: ATTACHMENT_REST, error };
        let record: RestRecord = serde_json::from_slice(rest).map_err(|error| fail(error.to_string()))?;
        if self.report.changed_params {
            // A rest record is valid only for its own settings; with others the first pair is the rest frame.
            return Ok(());
        }
        Ok(self.sensing.resume(&record)?)
    }

    /// Continues from one file to the next.
    fn follow(&mut self, last: &Opening, next: &Opening, truncated: bool) -> Result<(), HostError> {
        if next.config_toml != last.config_toml || next.part == last.part {
            let error = format!(
                "part {} does not belong to the recording of part {}; give the parts of one recording",
                next.part, last.part
            );
            return Err(RecordingError::Content { place: "a part", error }.into());
        }
        let gap = truncated || next.part != last.part + 1;
        if gap || self.mode == RecordingMode::Ring {
            self.resume(next)?;
        }
        Ok(())
    }

    fn expect_differences(&mut self, reason: &str) {
        self.report.inexact.get_or_insert_with(|| reason.to_owned());
    }

    fn message(&mut self, topic: Topic, data: &[u8]) -> Result<(), HostError> {
        let fail = |error| RecordingError::Message { topic: topic.name(), error };
        match topic {
            Topic::LeftImage
            | Topic::RightImage
            | Topic::LeftCompressed
            | Topic::RightCompressed
            | Topic::StereoCompressed => {
                let layout = self.capture.as_ref().and_then(|note| note.layout).unwrap_or_default();
                if self.decoder.take(topic, data, layout, &mut self.pair)? {
                    self.pair_is_complete();
                }
            }
            Topic::Capture => self.captured(messages::read_string(data).map_err(fail)?)?,
            Topic::Frame => {
                let recorded = messages::read_string(data).map_err(fail)?;
                if core::mem::take(&mut self.is_complete) {
                    let computed = self.sense(recorded)?;
                    self.compare(recorded, computed);
                    self.report.frames += 1;
                }
            }
            Topic::Stage => self.request(messages::read_string(data).map_err(fail)?)?,
            Topic::Points
            | Topic::Wrench
            | Topic::Pose
            | Topic::Gripper
            | Topic::Robot
            | Topic::Contact
            | Topic::Slip => {}
        }
        Ok(())
    }

    fn pair_is_complete(&mut self) {
        if let Some(note) = self.capture.take() {
            let same = pixel_crc(&self.pair.left) == note.left_crc32
                && pixel_crc(&self.pair.right) == note.right_crc32;
            self.report.other_pixels += u64::from(!same);
        }
        self.is_complete = true;
    }

    /// Senses the complete pair, with the limit of work that was recorded with it.
    fn sense(&mut self, recorded: &str) -> Result<String, HostError> {
        let note: serde_json::Value = serde_json::from_str(recorded).map_err(|error| {
            RecordingError::Content { place: Topic::Frame.name(), error: error.to_string() }
        })?;
        let limit = note.get("work_limit").and_then(serde_json::Value::as_u64);
        let sensed = self.sensing.process_within(&self.pair, limit).map(|_| ());
        Ok(frame_note(&sensed, &self.sensing).to_string())
    }

    /// Takes the capture data of the next pair, or an event of the source or the recording.
    fn captured(&mut self, recorded: &str) -> Result<(), HostError> {
        let fail = |error: serde_json::Error| RecordingError::Content {
            place: Topic::Capture.name(),
            error: error.to_string(),
        };
        let note: serde_json::Value = serde_json::from_str(recorded).map_err(fail)?;
        match note.get("event") {
            None => self.capture = Some(serde_json::from_value(note).map_err(fail)?),
            Some(event) if event == "recording_gap" => {
                self.expect_differences("the disk was too slow, and messages are missing");
            }
            Some(_) => {}
        }
        Ok(())
    }

    /// Repeats the pipeline action of a stage message, if it has one.
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
        self.report.localizations += u64::from(matches!(action, Action::Localize { .. } | Action::Follow));
        self.compare(recorded, action_note(stage, &action, &result, self.sensing.tracking()).to_string());
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::sync::atomic::AtomicBool;

    /// Replay reports changed pixels of either view, pair by pair.
    #[test]
    fn changed_pixels_of_either_view_are_reported() {
        let folder = tempfile::tempdir().unwrap();
        let mut config = Config::default();
        config.task.insertion_speed_mm_s = 20.0;
        config.recording.path = folder.path().join("run.mcap");
        crate::run::run(&config, &AtomicBool::new(false), &mut |_| {}).unwrap();
        for (left, right) in [(false, false), (true, false), (false, true)] {
            let mut opening = Opening::read(&config.recording.path).unwrap();
            let mut replay = Replay::start(&mut opening, None).unwrap();
            while replay.report.frames < 5 {
                let Some(Item::Message { topic, data, .. }) = opening.next_item().unwrap() else { continue };
                replay.message(topic, &data).unwrap();
                if let (Topic::Capture, Some(note)) = (topic, &mut replay.capture) {
                    let views = [(&mut note.left_crc32, left), (&mut note.right_crc32, right)];
                    views.into_iter().filter(|view| view.1).for_each(|(crc32, _)| crc32.push('0'));
                }
            }
            assert_eq!(replay.report.other_pixels, if left || right { 5 } else { 0 });
            assert_eq!(replay.report.differing, 0, "the pixels are as recorded");
        }
    }
}
