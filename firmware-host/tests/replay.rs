//! Recordings computed again, whole, cut and damaged.
#![allow(clippy::unwrap_used)]

use gelstereo_core::params::{Centre, Params};
use gelstereo_host::config::{Config, RecordingConfig, RecordingMode};
use gelstereo_host::recording::RecordingError;
use gelstereo_host::replay::{ReplayReport, replay};
use gelstereo_host::report::Outcome;
use gelstereo_host::run::{HostError, run};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

fn record(folder: &Path) -> (PathBuf, u64) {
    let mut config = Config::default();
    config.task.insertion_speed_mm_s = 20.0;
    let path = folder.join("new folder/run.mcap");
    config.recording.path.clone_from(&path);
    let report = run(&config, &AtomicBool::new(false), &mut |_| {}).unwrap();
    (path, report.stages.iter().map(|s| s.frames).sum())
}

fn again(path: &Path, params: Option<Params>) -> Result<ReplayReport, HostError> {
    replay(&[path], params, &mut |_| {})
}

/// One recording for all of this, because making it is the slow part.
#[test]
fn a_recording_gives_the_same_bits_and_a_damaged_one_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (path, frames) = record(folder.path());
    let whole = again(&path, None).unwrap();
    assert!(!whole.truncated && !whole.changed_params);
    assert_eq!((whole.frames, whole.localizations, whole.differing), (frames, 1, 0), "{whole}");
    assert_eq!(whole.to_string(), format!("{frames} frames, 1 localizations: same bits"));

    let mut params = Params::preset("balanced").unwrap();
    params.detect.centre = Centre::Binary;
    let changed = again(&path, Some(params)).unwrap();
    assert!(changed.changed_params && changed.differing > 0 && changed.first.is_some());
    assert!(changed.to_string().contains("results differ, the first at frame"), "{changed}");

    let bytes = std::fs::read(&path).unwrap();
    let cut_path = folder.path().join("cut.mcap");
    std::fs::write(&cut_path, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let cut = again(&cut_path, None).unwrap();
    assert!(cut.truncated && cut.differing == 0 && cut.first.is_none());
    // Every frame has the same size to a few per cent: what stands before the cut is not lost.
    assert!(cut.frames >= frames * 11 / 20 && cut.frames < frames, "{} of {frames}", cut.frames);
    assert!(cut.to_string().starts_with("the recording is cut off"));

    // Between the configuration and the end of the first frame's chunk there is nothing to compare yet.
    std::fs::write(&cut_path, &bytes[..20_000]).unwrap();
    let early = again(&cut_path, None).unwrap();
    assert!(early.truncated && early.frames == 0, "{early}");

    let mut damaged = bytes;
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x40;
    std::fs::write(&cut_path, &damaged).unwrap();
    let result = again(&cut_path, None);
    let noticed = match &result {
        Err(HostError::Recording(RecordingError::Format(_) | RecordingError::Content { .. })) => true,
        Ok(report) => report.differing > 0,
        Err(_) => false,
    };
    assert!(noticed, "{result:?}");
}

/// The job on a sensor with a hexagonal print: the peg is grasped, located and inserted, with slip and with
/// contact by pressure, and a replay gives the same bits.
#[test]
fn a_job_on_a_hexagonal_print_gives_the_same_bits() {
    let text = "
        preset = \"balanced\"
        [task]
        insertion_speed_mm_s = 20.0
        [simulated.gel]
        layout = \"hexagonal\"
        rows = 25
        cols = 23
        [params.lattice]
        layout = \"hexagonal\"
        [params.contact]
        saliency = \"pressure\"
        [params.slip]
        method = \"rigid\"
    ";
    let folder = tempfile::tempdir().unwrap();
    let mut config = Config::parse(text, "cell.toml").unwrap();
    config.recording.path = folder.path().join("run.mcap");
    let report = run(&config, &AtomicBool::new(false), &mut |_| {}).unwrap();
    assert!(matches!(report.outcome, Outcome::Inserted { .. }), "{}", report.why);
    let frames = report.stages.iter().map(|stage| stage.frames).sum::<u64>();
    let found = again(&config.recording.path, None).unwrap();
    assert_eq!((found.frames, found.localizations, found.differing), (frames, 1, 0), "{found}");
}

/// A job recorded with these settings, and how many frames it had.
fn recorded(recording: RecordingConfig) -> (Vec<PathBuf>, u64) {
    let mut config = Config { recording, ..Config::default() };
    config.task.insertion_speed_mm_s = 20.0;
    let report = run(&config, &AtomicBool::new(false), &mut |_| {}).unwrap();
    let recording = report.recording.unwrap();
    assert_eq!(recording.fault, None);
    (recording.files, report.stages.iter().map(|s| s.frames).sum())
}

#[test]
fn parts_give_the_same_bits_together_and_can_be_computed_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let (mut files, frames) =
        recorded(RecordingConfig { path: path.clone(), split_mb: 5, ..RecordingConfig::default() });
    let names: Vec<_> = files.iter().map(|file| file.file_name().unwrap().to_string_lossy()).collect();
    assert!(names.len() > 2 && names[..2] == ["run.mcap", "run_0001.mcap"], "{names:?}");
    files.reverse();
    let together = replay(&files, None, &mut |_| {}).unwrap();
    assert!(together.is_good() && together.inexact.is_none(), "{together}");
    assert_eq!((together.frames, together.localizations, together.differing), (frames, 1, 0));

    let mut sum = 0;
    for file in &files {
        let alone = replay(&[file], None, &mut |_| {}).unwrap();
        assert!(alone.is_good() && alone.other_pixels == 0 && !alone.truncated, "{alone}");
        assert_eq!(alone.inexact.is_some(), *file != path, "{alone}");
        sum += alone.frames;
    }
    assert_eq!(sum, frames);
    let gap = replay(&[&path, &files[0]], None, &mut |_| {}).unwrap();
    assert!(gap.is_good() && gap.inexact.is_some(), "{gap}");
    // A truncated part is reported even if the parts after it are whole.
    let (bytes, cut_path) = (std::fs::read(&path).unwrap(), folder.path().join("cut.mcap"));
    std::fs::write(&cut_path, &bytes[..bytes.len() / 2]).unwrap();
    let cut = replay(&[&cut_path, &files[files.len() - 2]], None, &mut |_| {}).unwrap();
    assert!(cut.truncated && cut.inexact.is_some(), "{cut}");
    let twice = replay(&[&path, &path], None, &mut |_| {}).unwrap_err().to_string();
    assert!(twice.contains("part 0 does not belong to the recording of part 0"), "{twice}");
}

#[test]
fn a_ring_keeps_what_its_replay_needs() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ring.mcap");
    let (mode, ring_s, ring_after_s) = (RecordingMode::Ring, 0.3, 0.2);
    let settings = RecordingConfig { path, mode, ring_s, ring_after_s, ..RecordingConfig::default() };
    let (files, frames) = recorded(settings);
    // The grasp, the insertion, and the end of the retreat.
    assert_eq!(files.len(), 3);
    let report = replay(&files, None, &mut |_| {}).unwrap();
    assert!(report.is_good() && report.frames > 20 && report.frames < frames, "{report}");
    assert!(report.to_string().contains("begins in the middle of a run"), "{report}");
}

/// The recorded limits of work decide, not a clock.
#[test]
fn a_run_with_deadlines_is_computed_again_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    for (deadline_ms, degrades) in [(0.01, true), (1000.0, false)] {
        let mut config = Config { deadline_ms: Some(deadline_ms), ..Config::default() };
        config.task.insertion_speed_mm_s = 20.0;
        config.recording.path.clone_from(&path);
        run(&config, &AtomicBool::new(false), &mut |_| {}).unwrap();
        let notes = frame_notes(&path);
        let limited = notes.iter().filter(|note| note["work_limit"].is_u64()).count();
        let degraded = notes.iter().filter(|note| note["degraded"] == true).count();
        assert_eq!(limited, notes.len());
        assert_eq!(degraded > notes.len() / 2, degrades, "{degraded} of {}", notes.len());
        let report = again(&path, None).unwrap();
        assert_eq!((report.frames, report.differing), (notes.len() as u64, 0), "{report}");
    }
}

fn frame_notes(path: &Path) -> Vec<serde_json::Value> {
    let bytes = std::fs::read(path).unwrap();
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let of_frames = messages.filter(|message| message.channel.topic == "/gelstereo/frame");
    // A string in CDR: encapsulation, length, bytes and a zero.
    of_frames
        .map(|message| serde_json::from_slice(&message.data[8..message.data.len() - 1]).unwrap())
        .collect()
}

#[test]
fn every_third_pair_can_be_computed_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("thin.mcap");
    let (files, frames) = recorded(RecordingConfig { path, every_nth: 3, ..RecordingConfig::default() });
    let report = replay(&files, None, &mut |_| {}).unwrap();
    assert!(report.is_good() && report.frames == frames.div_ceil(3), "{report}");
    assert!(report.inexact.unwrap().contains("one of 3 pairs"));
}

#[test]
fn what_is_no_recording_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notes.mcap");
    std::fs::write(&path, "not a recording at all, but long enough").unwrap();
    assert!(matches!(again(&path, None), Err(HostError::Recording(RecordingError::Format(_)))));
    std::fs::write(&path, []).unwrap();
    assert!(matches!(again(&path, None), Err(HostError::Recording(RecordingError::NoConfig))));
    let missing = again(&folder.path().join("missing.mcap"), None).unwrap_err().to_string();
    assert!(missing.starts_with("cannot open ") && missing.contains("missing.mcap"), "{missing}");
}
