//! Recordings whose writer was killed, or whose disk was full: real processes, a real file system.
//!
//! `GELSTEREO_KILLS` sets how often a process is killed.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

use gelstereo_host::config::RecordingConfig;
use gelstereo_host::recording::{
    Content, Item, LogClock, MessageSink, Reader, Recording, Topic, messages, recover,
};
use gelstereo_host::replay::replay;
use gelstereo_host::source::{Gray, StereoPair};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

fn kills() -> u64 {
    std::env::var("GELSTEREO_KILLS").ok().and_then(|text| text.parse().ok()).unwrap_or(3)
}

/// Delays that spread evenly over a second, in another order than that of time.
fn delay_ms(kill: u64) -> u64 {
    (kill * 618 + 137) % 1000
}

fn spawn_run(folder: &Path) -> Child {
    // Fingers that close so slowly that the job lasts for minutes.
    std::fs::write(folder.join("slow.toml"), "[task]\nclosing_speed_mm_s = 0.1\n").unwrap();
    Command::new(env!("CARGO_BIN_EXE_gelstereo-host"))
        .current_dir(folder)
        .args(["run", "--config", "slow.toml", "--record", "run.mcap"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// Kills as `kill -9` does, some time after the rest frame.
fn killed_run(folder: &Path, delay: Duration) -> Vec<u8> {
    let mut child = spawn_run(folder);
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.by_ref().any(|line| line.unwrap().starts_with("rest")), "the rest stage is over");
    std::thread::sleep(delay);
    child.kill().unwrap();
    child.wait().unwrap();
    std::fs::read(folder.join("run.mcap")).unwrap()
}

/// Also cut at many places: an unfinished file has no index, and maybe a piece of a chunk at its end.
#[test]
fn a_killed_run_replays_with_the_same_bits_up_to_its_last_message() {
    let folder = tempfile::tempdir().unwrap();
    let (path, fixed) = (folder.path().join("run.mcap"), folder.path().join("fixed.mcap"));
    let mut longest = Vec::new();
    for kill in 0..kills() {
        let bytes = killed_run(folder.path(), Duration::from_millis(delay_ms(kill)));
        let report = replay(&[&path], None, &mut |_| {}).unwrap();
        // The last half second of the source's clock may be missing.
        let missing = report.frames == 0 && delay_ms(kill) > 500;
        assert!(report.truncated && report.differing == 0 && !missing, "kill {kill}: {report}");
        // A simulated run repeats itself: what a kill leaves is the beginning of what a later one leaves.
        let (short, long) = if bytes.len() < longest.len() { (&bytes, &longest) } else { (&longest, &bytes) };
        assert!(long.starts_with(short), "kill {kill}");

        let recovered = recover(&path, &fixed).unwrap();
        assert!(!recovered.complete && recovered.damaged_chunks == 0, "kill {kill}: {recovered:?}");
        let again = replay(&[&fixed], None, &mut |_| {}).unwrap();
        assert!(
            !again.truncated && again.frames == report.frames && again.differing == 0,
            "kill {kill}: {again}"
        );
        std::fs::remove_file(&fixed).unwrap();
        if bytes.len() > longest.len() {
            longest = bytes;
        }
    }
    let mut last = 0;
    for step in 1..=10 {
        std::fs::write(&path, &longest[..longest.len() * step / 10]).unwrap();
        let report = replay(&[&path], None, &mut |_| {}).unwrap();
        assert!(
            report.truncated && report.differing == 0 && report.frames >= last,
            "{step} tenths: {report}"
        );
        last = report.frames;
    }
    assert!(last > 10, "{last} frames");
}

fn live_recording(folder: &Path) -> Recording {
    let settings = RecordingConfig { path: folder.join("live.mcap"), ..RecordingConfig::default() };
    let content = Content { config_toml: String::new(), attachments: Vec::new() };
    Recording::create(&settings, content, LogClock::Wall).unwrap()
}

/// Not a test of its own: the process that [`at_most_a_second_is_lost`] kills. It records 200 pairs a second
/// on the wall clock, and prints the number of each.
#[test]
#[ignore = "runs as a child of another test"]
fn child_that_records() {
    let Some(folder) = std::env::var_os("GELSTEREO_CHILD_FOLDER") else { return };
    let mut recording = live_recording(Path::new(&folder));
    let image = Gray { width: 64, height: 48, pixels: (0..64 * 48).map(|i| (i * 7 % 251) as u8).collect() };
    let mut pair = StereoPair { left: image.clone(), right: image, ..StereoPair::default() };
    for frame in 0_u64.. {
        pair.time_ns = frame * 5_000_000;
        recording.write_pair(&pair);
        recording.write(Topic::Frame, pair.time_ns, &messages::string(&frame.to_string()));
        writeln!(std::io::stdout(), "frame {frame}").unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Frames of a file, up to its cut.
fn frames(path: &Path) -> u64 {
    let mut reader = Reader::open(path).unwrap();
    let mut count = 0;
    while let Some(item) = reader.next_item().unwrap() {
        if let Item::Message { topic: Topic::Frame, data, .. } = item {
            assert_eq!(messages::read_string(&data).unwrap(), count.to_string());
            count += 1;
        }
    }
    count
}

#[test]
fn at_most_a_second_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    for kill in 0..kills() {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--ignored", "--exact", "faults::child_that_records", "--nocapture"])
            .env("GELSTEREO_CHILD_FOLDER", folder.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let numbers = std::thread::spawn(move || {
            let numbers = lines.map_while(Result::ok);
            numbers.filter_map(|line| line.rsplit_once("frame ")?.1.parse::<u64>().ok()).last()
        });
        std::thread::sleep(Duration::from_millis(1200 + delay_ms(kill)));
        child.kill().unwrap();
        child.wait().unwrap();
        let written = numbers.join().unwrap().map_or(0, |last| last + 1);
        let kept = frames(&folder.path().join("live.mcap"));
        // 200 frames are a second at the full rate; a busy machine records fewer in it.
        assert!(kept <= written && written - kept <= 200, "kill {kill}: {kept} of {written} frames are kept");
    }
}

/// A file system of 3 MB. `None` where this user may not mount one.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(folder: &Path) -> Option<Self> {
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", "size=3m", "tmpfs"])
            .arg(folder)
            .stderr(Stdio::null())
            .status();
        mounted.is_ok_and(|status| status.success()).then(|| Self(folder.to_owned()))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn a_full_file_system_ends_the_recording_and_not_the_job() {
    let (small, large) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let Some(_disk) = SmallDisk::mount(small.path()) else {
        writeln!(std::io::stderr(), "skipped: this user may not mount a tmpfs").unwrap();
        return;
    };
    let path = small.path().join("run.mcap");
    let output = Command::new(env!("CARGO_BIN_EXE_gelstereo-host"))
        .args(["run", "--json", "--record"])
        .arg(&path)
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(
        errors.contains("the job went on to its end, but its recording ended early: ")
            && errors.contains("No space left"),
        "{errors}"
    );
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["outcome"]["kind"], "inserted");
    assert!(report["recording"]["fault"].as_str().unwrap().contains("No space left"));

    let again = replay(&[&path], None, &mut |_| {}).unwrap();
    assert!(again.truncated && again.frames > 0 && again.differing == 0, "{again}");
    let fixed = large.path().join("fixed.mcap");
    recover(&path, &fixed).unwrap();
    assert_eq!(replay(&[&fixed], None, &mut |_| {}).unwrap().frames, again.frames);
    // On the full disk there is no room for the copy, and the broken file stays as it was.
    let before = std::fs::read(&path).unwrap();
    assert!(recover(&path, &small.path().join("fixed.mcap")).is_err());
    assert_eq!(std::fs::read(&path).unwrap(), before);
}
