//! Recordings computed again, whole, cut and damaged.
#![allow(clippy::unwrap_used)]

use gelstereo_core::params::{Centre, Params};
use gelstereo_host::config::Config;
use gelstereo_host::recording::RecordingError;
use gelstereo_host::replay::{ReplayReport, replay};
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
