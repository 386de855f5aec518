//! `gelstereo-host sense` as an operator meets it: signals, pipes, supervisors, full disks.
#![cfg(unix)]
#![allow(clippy::unwrap_used)]

use gelstereo_host::codec::frame_stream::{FrameHeader, PayloadFormat};
use gelstereo_host::source::StereoLayout;
use serde_json::Value;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Far beyond what a busy machine needs.
const LIMIT: Duration = Duration::from_secs(60);

fn host(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gelstereo-host"));
    command.current_dir(folder).args(arguments);
    command
}

struct Finished {
    code: Option<i32>,
    lines: Vec<Value>,
    log: String,
}

fn finish(command: &mut Command) -> Finished {
    let Output { status, stdout, stderr } = command.output().unwrap();
    let text = String::from_utf8(stdout).unwrap();
    let lines = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    Finished { code: status.code(), lines, log: String::from_utf8(stderr).unwrap() }
}

fn assert_replays(folder: &Path, recording: &str) {
    let Output { status, stdout, .. } = host(folder, &["replay", recording]).output().unwrap();
    let text = String::from_utf8_lossy(&stdout);
    assert!(status.success() && text.contains(": same bits") && !text.contains("cut off"), "{text}");
}

fn signal(child: &Child, name: &str) {
    assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
}

/// Reads the JSON log until a report of that kind comes.
fn await_report(log: &mut BufReader<ChildStderr>, kind: &str) -> Value {
    let begun = Instant::now();
    for line in log.lines() {
        let report: Value = serde_json::from_str(&line.unwrap()).unwrap();
        if report["report"] == kind {
            return report;
        }
        assert!(begun.elapsed() < LIMIT, "no {kind} came");
    }
    panic!("the log ended before a {kind}");
}

fn spawn_logged(command: &mut Command) -> (Child, BufReader<ChildStderr>) {
    let mut child = command.args(["--log", "json"]).stderr(Stdio::piped()).spawn().unwrap();
    let log = BufReader::new(child.stderr.take().unwrap());
    (child, log)
}

#[test]
fn a_simulated_grasp_is_felt_located_recorded_and_replays_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let sense = |recording| {
        let arguments =
            ["sense", "--frames", "150", "--jsonl", "--points", "--record", recording, "--log", "json"];
        finish(&mut host(folder.path(), &arguments))
    };
    let first = sense("first.mcap");
    assert_eq!((first.code, first.lines.len()), (Some(0), 150), "{}", first.log);
    assert_replays(folder.path(), "first.mcap");
    let touching = |line: &&Value| line["contact"]["touching"] == true;
    let touched: Vec<&Value> = first.lines.iter().filter(touching).collect();
    assert!(touched.len() > 40 && touched.len() < 120, "contact comes and goes: {}", touched.len());
    let followed = touched.iter().filter(|line| line["pose"]["tracking"] == "tracking").count();
    assert!(followed + 3 > touched.len(), "{followed} of {}", touched.len());
    let points = first.lines[0]["points_mm"].as_array().unwrap();
    assert!(points.len() == 625 && points[0].as_array().unwrap().len() == 3);
    // Both ways across, each trigger alternates.
    for trigger in ["grasp", "insertion"] {
        let words: Vec<bool> = first
            .lines
            .iter()
            .flat_map(|line| line["contact"]["crossings"].as_array().cloned().unwrap_or_default())
            .filter(|crossing| crossing["trigger"] == trigger)
            .map(|crossing| crossing["above"].as_bool().unwrap())
            .collect();
        assert!(words.iter().enumerate().all(|(i, &above)| above == (i % 2 == 0)), "{trigger}: {words:?}");
    }
    // No real clock enters a simulated recording, and an earlier one is kept.
    let second = sense("first.mcap");
    assert_eq!(second.code, Some(0), "{}", second.log);
    let bytes = |name| std::fs::read(folder.path().join(name)).unwrap();
    assert!(bytes("first.mcap") == bytes("first-2.mcap"));
    assert_eq!(first.lines, second.lines);
}

#[test]
fn signals_end_it_with_exit_code_0_and_a_closed_recording() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["-INT", "-TERM"] {
        let recording = format!("run{name}.mcap");
        let (mut child, mut log) = spawn_logged(&mut host(folder.path(), &["sense", "--record", &recording]));
        await_report(&mut log, "touch");
        signal(&child, name);
        let ended = await_report(&mut log, "ended");
        assert_eq!(ended["reason"], "stopped");
        assert_eq!(child.wait().unwrap().code(), Some(0));
        assert_replays(folder.path(), &recording);
    }
}

#[test]
fn sigusr1_learns_the_rest_state_anew_and_the_recording_replays() {
    let folder = tempfile::tempdir().unwrap();
    let (mut child, mut log) = spawn_logged(&mut host(folder.path(), &["sense", "--record", "run.mcap"]));
    await_report(&mut log, "rest_learned");
    signal(&child, "-USR1");
    assert_eq!(await_report(&mut log, "rest_forgotten")["reason"], "asked for");
    await_report(&mut log, "rest_learned");
    await_report(&mut log, "pose");
    signal(&child, "-TERM");
    await_report(&mut log, "ended");
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert_replays(folder.path(), "run.mcap");
}

/// Images of a simulated press, and a configuration that reads them from the folder.
struct Press {
    folder: PathBuf,
    pairs: Vec<[Vec<u8>; 2]>,
    size: (u32, u32),
}

/// Simulated once for all tests. The ball touches the gel from the 15th frame on.
fn press() -> &'static Press {
    static PRESS: OnceLock<Press> = OnceLock::new();
    PRESS.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap().keep();
        let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/press_sphere.toml");
        let text = std::fs::read_to_string(scene).unwrap();
        let short = text.replace("time_s = 1.0", "time_s = 0.5").replace("time_s = 2.0", "time_s = 0.8");
        std::fs::write(folder.join("scene.toml"), short).unwrap();
        let simulated = host(&folder, &["simulate", "scene.toml", "pairs"]).output().unwrap();
        assert!(simulated.status.success(), "{}", String::from_utf8_lossy(&simulated.stderr));
        // The ball touches the gel in the fourth frame.
        let config = "rig_file = \"pairs/rig.toml\"\n\
                      sense.rest_frames = 2\n\
                      sense.localize = \"never\"\n\
                      source = { kind = \"folder\", path = \"pairs\", frame_rate_hz = 30.0 }\n";
        std::fs::write(folder.join("cell.toml"), config).unwrap();
        std::fs::write(folder.join("impatient.toml"), format!("{config}sense.max_silence_s = 1.0\n"))
            .unwrap();
        let images = |word: &str| {
            let mut names: Vec<PathBuf> = std::fs::read_dir(folder.join("pairs"))
                .unwrap()
                .map(|entry| entry.unwrap().path())
                .filter(|path| path.file_name().unwrap().to_string_lossy().starts_with(word))
                .collect();
            names.sort();
            names.iter().map(|path| image::open(path).unwrap().into_luma8()).collect::<Vec<_>>()
        };
        let (lefts, rights) = (images("left_"), images("right_"));
        let size = lefts[0].dimensions();
        let pairs = lefts.into_iter().zip(rights).map(|(l, r)| [l.into_raw(), r.into_raw()]).collect();
        Press { folder, pairs, size }
    })
}

impl Press {
    /// Side by side.
    fn joint(&self, pair: usize) -> Vec<u8> {
        let width = self.size.0 as usize;
        let [left, right] = &self.pairs[pair];
        left.chunks(width).zip(right.chunks(width)).flat_map(|(l, r)| [l, r].concat()).collect()
    }

    fn framed(&self, pair: usize) -> Vec<u8> {
        let payload = self.joint(pair);
        let header = FrameHeader {
            sequence: pair as u64,
            captured_ns: Some(1 + pair as u64 * 33_333_333),
            width_px: 2 * self.size.0,
            height_px: self.size.1,
            format: PayloadFormat::Grey8,
            layout: StereoLayout::SideBySide,
            payload_bytes: payload.len() as u32,
            payload_crc: Some(crc32fast::hash(&payload)),
        };
        [&header.encode()[..], &payload].concat()
    }

    fn sense_stream(&self, extra: &[&str], bytes: Vec<u8>) -> Finished {
        let arguments =
            [&["sense", "--config", "cell.toml", "--stream", "-", "--every", "--jsonl"], extra].concat();
        let mut command = host(&self.folder, &arguments);
        let mut child =
            command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut stdin = child.stdin.take().unwrap();
        let writer = std::thread::spawn(move || stdin.write_all(&bytes).unwrap());
        let Output { status, stdout, stderr } = child.wait_with_output().unwrap();
        writer.join().unwrap();
        let text = String::from_utf8(stdout).unwrap();
        let lines = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        Finished { code: status.code(), lines, log: String::from_utf8(stderr).unwrap() }
    }
}

fn digests(lines: &[Value]) -> Vec<&str> {
    lines.iter().map(|line| line["digest"].as_str().unwrap_or("none")).collect()
}

#[test]
fn a_stream_a_headerless_stream_and_a_folder_give_the_same_results() {
    let press = press();
    let arguments = ["sense", "--config", "cell.toml", "--jsonl"];
    let folder = finish(&mut host(&press.folder, &arguments));
    assert_eq!((folder.code, folder.lines.len()), (Some(0), press.pairs.len()), "{}", folder.log);
    let all = 0..press.pairs.len();
    let framed =
        press.sense_stream(&["--record", "stream.mcap"], all.clone().flat_map(|k| press.framed(k)).collect());
    assert_eq!(framed.code, Some(0), "{}", framed.log);
    assert_eq!(digests(&framed.lines), digests(&folder.lines));
    assert_replays(&press.folder, "stream.mcap");
    let size = format!("{}x{}", 2 * press.size.0, press.size.1);
    let raw = press.sense_stream(&["--raw-size", &size], all.flat_map(|k| press.joint(k)).collect());
    assert_eq!(raw.code, Some(0), "{}", raw.log);
    assert_eq!(digests(&raw.lines), digests(&folder.lines));
    assert!(folder.lines.iter().any(|line| line["contact"]["touching"] == true), "the sphere presses");
}

/// Bad frames and rubbish between frames are told, and what comes after them is sensed.
#[test]
fn bad_frames_are_told_and_sensing_goes_on() {
    let press = press();
    let black = {
        let header = FrameHeader {
            sequence: 3,
            captured_ns: Some(99_999_999),
            width_px: 2 * press.size.0,
            height_px: press.size.1,
            format: PayloadFormat::Grey8,
            layout: StereoLayout::SideBySide,
            payload_bytes: 2 * press.size.0 * press.size.1,
            payload_crc: None,
        };
        [header.encode().to_vec(), vec![0; header.payload_bytes as usize]].concat()
    };
    let bytes =
        [press.framed(0), press.framed(1), b"rubbish".to_vec(), press.framed(2), black, press.framed(4)]
            .concat();
    let found = press.sense_stream(&["--log", "json", "--record", "bad.mcap"], bytes);
    assert_eq!(found.code, Some(0), "{}", found.log);
    let good: Vec<bool> = found.lines.iter().map(|line| line["digest"].is_string()).collect();
    assert_eq!(good, [true, true, true, false, true], "{}", found.log);
    assert!(found.lines[3]["error"].is_string());
    assert!(found.log.contains("7 bytes belong to no frame") && found.log.contains("\"bad_frame\""));
    assert_replays(&press.folder, "bad.mcap");
}

/// systemd's side of the protocol, as its manual page sd_notify(3) has it.
#[cfg(target_os = "linux")]
#[test]
fn systemd_hears_ready_watchdog_status_and_stopping() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let socket = std::os::unix::net::UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(LIMIT)).unwrap();
    let mut child = host(folder.path(), &["sense", "--health-file", "health.json"])
        .env("NOTIFY_SOCKET", &path)
        .env("WATCHDOG_USEC", "600000")
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut buffer = [0; 4096];
    let mut hear = || {
        let count = loop {
            match socket.recv(&mut buffer) {
                // A signal that some other test's child sends ends the wait early.
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                count => break count.unwrap(),
            }
        };
        String::from_utf8_lossy(&buffer[..count]).into_owned()
    };
    assert_eq!(hear().trim_end(), "READY=1");
    let (mut alive, mut status) = (Vec::new(), None);
    while alive.len() < 10 || status.is_none() {
        let text = hear();
        match text.trim_end() {
            "WATCHDOG=1" => alive.push(Instant::now()),
            text => status = Some(text.strip_prefix("STATUS=").unwrap().to_owned()),
        }
    }
    // Three times within the limit, on a machine that may be busy: on average at least.
    let span = *alive.last().unwrap() - alive[0];
    assert!(span < 9 * Duration::from_millis(600), "{span:?}");
    assert!(status.unwrap().contains(" Hz, latency "));
    let health = host(folder.path(), &["health", "health.json"]).output().unwrap();
    let text = String::from_utf8_lossy(&health.stdout);
    assert!(health.status.success() && text.starts_with("well: "), "{text}");
    signal(&child, "-TERM");
    let begun = Instant::now();
    while hear().trim_end() != "STOPPING=1" {
        assert!(begun.elapsed() < LIMIT);
    }
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let gone = host(folder.path(), &["health", "health.json"]).output().unwrap();
    assert_eq!(gone.status.code(), Some(1), "no file, not well");
}

/// A producer that stalls: the host says so, counts as unwell after a while, and still stops at once.
#[test]
fn a_stalled_producer_is_told_and_makes_it_unwell() {
    let press = press();
    let arguments = ["sense", "--config", "cell.toml", "--stream", "-", "--health-file", "health.json"];
    let (mut child, mut log) = spawn_logged(host(&press.folder, &arguments).stdin(Stdio::piped()));
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(&press.framed(0)).unwrap();
    let event = await_report(&mut log, "source");
    assert_eq!((&event["event"], &event["level"]), (&"stalled".into(), &"warning".into()));
    let begun = Instant::now();
    while await_report(&mut log, "status")["trouble"].is_null() {
        assert!(begun.elapsed() < LIMIT);
    }
    let health = host(&press.folder, &["health", "health.json"]).output().unwrap();
    let text = String::from_utf8_lossy(&health.stderr);
    assert!(health.status.code() == Some(1) && text.contains("no good frame for"), "{text}");
    signal(&child, "-TERM");
    assert_eq!(await_report(&mut log, "ended")["reason"], "stopped");
    assert_eq!(child.wait().unwrap().code(), Some(0));
    drop(stdin);
}

/// `| head` is the usual way to look at a stream of lines.
#[test]
fn a_reader_that_goes_away_ends_it_and_one_that_sleeps_does_not_keep_it_from_stopping() {
    let folder = tempfile::tempdir().unwrap();
    let (mut child, mut log) =
        spawn_logged(host(folder.path(), &["sense", "--jsonl"]).stdout(Stdio::piped()));
    let mut first = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut first).unwrap();
    assert!(first.starts_with('{'));
    assert_eq!(await_report(&mut log, "ended")["reason"], "no output is left");
    assert_eq!(child.wait().unwrap().code(), Some(1));

    let (mut child, mut log) =
        spawn_logged(host(folder.path(), &["sense", "--jsonl", "--points"]).stdout(Stdio::piped()));
    // Nobody reads: pipe and queue fill up, and the simulated world waits.
    await_report(&mut log, "rest_learned");
    std::thread::sleep(Duration::from_secs(3));
    signal(&child, "-TERM");
    await_report(&mut log, "ended");
    assert!(child.wait().unwrap().code().is_some(), "it ended by itself");
}

/// A limit on the size of files stands for a full disk.
#[test]
fn a_full_disk_ends_the_recording_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let command = "trap '' XFSZ; ulimit -f 4000; exec \"$0\" \"$@\"";
    let arguments = ["sense", "--frames", "150", "--jsonl", "--record", "run.mcap", "--log", "json"];
    let host = env!("CARGO_BIN_EXE_gelstereo-host");
    let found =
        finish(Command::new("sh").current_dir(folder.path()).args(["-c", command, host]).args(arguments));
    assert_eq!(found.lines.len(), 150, "{}", found.log);
    assert!(found.log.contains("\"output_lost\"") && found.log.contains("File too large"), "{}", found.log);
    assert_eq!(found.code, Some(1));
}

#[test]
fn bad_arguments_are_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("sense.toml"), "[sense]\nmax_silence_s = -1\n").unwrap();
    std::fs::write(folder.path().join("raw.toml"), "source = { kind = \"stream\", raw_size_px = [3, 2] }\n")
        .unwrap();
    let cases: [(&[&str], &str); 5] = [
        (&["sense", "--raw-size", "640x480"], "--stream <PATH>"),
        (&["sense", "--stream", "-", "--raw-size", "640"], "valid is width x height"),
        (&["sense", "--stream", "-"], "real images need the rig that took them"),
        (&["sense", "--config", "sense.toml"], "sense.max_silence_s is -1; valid is 0.001 to 3600 s"),
        (&["check", "--config", "raw.toml"], "real images need the rig"),
    ];
    for (arguments, words) in cases {
        let found = finish(&mut host(folder.path(), arguments));
        assert!(found.code == Some(2) && found.log.contains(words), "{arguments:?}: {}", found.log);
    }
}
