//! The binary as a robot engineer meets it: signals, closed pipes, bad input, exit codes.
#![cfg(unix)]
#![allow(clippy::unwrap_used)]

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn host(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gelstereo-host"));
    command.current_dir(folder).args(arguments);
    command
}

fn output(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let Output { status, stdout, stderr } = host(folder, arguments).output().unwrap();
    let text = [stdout, stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
    (status.code(), text)
}

/// Stopped while the fingers close so slowly that they would for minutes.
#[test]
fn a_signal_ends_the_job_with_a_recording_that_replays() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("slow.toml"), "[task]\nclosing_speed_mm_s = 0.1\n").unwrap();
    for signal in ["-INT", "-TERM"] {
        let mut child = host(folder.path(), &["run", "--config", "slow.toml", "--record", "run.mcap"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        assert!(lines.by_ref().any(|line| line.unwrap().starts_with("rest")), "the rest stage is over");
        assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
        let rest: Vec<String> = lines.map(Result::unwrap).collect();
        assert_eq!(child.wait().unwrap().code(), Some(1), "{rest:?}");
        assert_eq!(rest[0], "done      interrupted during close");
        let (code, text) = output(folder.path(), &["replay", "run.mcap"]);
        assert!(code == Some(0) && text.contains(": same bits"), "{text}");
        assert!(!text.contains("cut off"), "{text}");
    }
}

#[test]
fn bad_input_is_an_error_in_words_with_code_2() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    write("binary.toml", &[0xff, 0xfe, 0x00]);
    write("unknown.toml", b"[task]\nspeed = 3\n");
    write("seconds.toml", b"[task]\nframe_timeout_s = 1e300\n");
    write("rate.toml", b"[simulated]\nframe_rate_hz = 1e-300\n");
    write("scene.toml", b"");
    write("file", b"");
    let cases: [(&[&str], &str); 14] = [
        (&["run", "--config", "missing.toml"], "cannot read missing.toml: "),
        (&["run", "--config", "."], "cannot read .: "),
        (&["run", "--config", "binary.toml"], "cannot read binary.toml: "),
        (&["check", "--config", "unknown.toml"], "unknown.toml, line 2: there is no setting `task.speed`"),
        (&["run", "--config", "seconds.toml"], "valid is 0.001 to 3600 s"),
        (&["run", "--config", "rate.toml"], "valid is 0.1 to 1000 Hz"),
        (&["run", "--record", "file/run.mcap"], "cannot create the folder of file/run.mcap: "),
        (&["run", "--record", "."], "recording.path is \".\", which names no file"),
        (&["replay", "missing.mcap"], "cannot open missing.mcap: "),
        (&["replay", "."], "cannot be written or read: Is a directory"),
        (&["replay", "unknown.toml"], "this is not an intact MCAP recording: "),
        (&["replay", "file"], "the recording holds no config_toml"),
        (&["simulate", "missing.toml", "pairs"], "cannot read missing.toml: "),
        (&["simulate", "scene.toml", "file/pairs"], "cannot write file/pairs: "),
    ];
    for (arguments, words) in cases {
        let (code, text) = output(folder.path(), arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {text}");
        assert!(text.starts_with("gelstereo-host: ") && text.contains(words), "{arguments:?}: {text}");
    }
}

/// Standard output of a command that ends in an error, as JSON, and the error on stderr.
fn broken_off(folder: &Path, arguments: &[&str]) -> (serde_json::Value, String) {
    let Output { status, stdout, stderr } = host(folder, arguments).output().unwrap();
    let errors = String::from_utf8(stderr).unwrap();
    assert_eq!(status.code(), Some(2), "{errors}");
    let error = errors.lines().last().unwrap().strip_prefix("gelstereo-host: ").unwrap();
    (serde_json::from_slice(&stdout).unwrap(), error.to_owned())
}

#[test]
fn a_job_that_breaks_off_has_a_json_summary_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let slow = "[task]\nclosing_speed_mm_s = 0.01\ninsertion_speed_mm_s = 20.0\nstage_timeout_s = 1.0\n";
    std::fs::write(folder.path().join("slow.toml"), slow).unwrap();
    let common = ["--config", "slow.toml", "--record", "run.mcap", "--json"];
    let timeout = serde_json::json!({ "kind": "error", "cause": "stage_timeout" });

    let (summary, error) = broken_off(folder.path(), &[&["run"][..], &common].concat());
    assert!(error.starts_with("close did not end within 1 s") && summary["why"] == error, "{error}");
    assert_eq!(summary["outcome"], timeout);
    let stages = summary["stages"].as_array().unwrap();
    assert_eq!(stages.iter().map(|stage| &stage["stage"]).collect::<Vec<_>>(), ["open", "rest"]);
    assert_eq!(summary["page"]["path"], "run.html");

    // The way down to the goal takes more than a second.
    let (summary, error) =
        broken_off(folder.path(), &[&["teach", "--output", "goal.json"][..], &common].concat());
    assert!(error.starts_with("open did not end within 1 s") && summary["why"] == error, "{error}");
    assert_eq!(summary["outcome"], timeout);

    let (summary, error) = broken_off(folder.path(), &["run", "--config", "missing.toml", "--json"]);
    assert_eq!(summary["outcome"], serde_json::json!({ "kind": "error", "cause": "config" }));
    assert!(summary["why"] == error && summary["stages"] == serde_json::json!([]), "{summary}");
}

#[test]
fn help_shows_examples_and_exit_codes() {
    let folder = tempfile::tempdir().unwrap();
    let (code, text) = output(folder.path(), &["--help"]);
    assert!(code == Some(0) && text.contains("Examples:") && text.contains("Exit code: 0"), "{text}");
}

/// A device that takes nothing stands for a full disk and for a pipe that nobody reads.
#[cfg(target_os = "linux")]
#[test]
fn output_that_cannot_be_written_is_an_error_not_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let full = || std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    for arguments in [&["check", "--print-default"][..], &["run", "--record", "run.mcap"]] {
        let result = host(folder.path(), arguments).stdout(full()).output().unwrap();
        let text = String::from_utf8_lossy(&result.stderr);
        assert_eq!(result.status.code(), Some(2), "{text}");
        assert!(text.contains("standard output cannot be written: No space left"), "{text}");
    }
    let (code, text) = output(folder.path(), &["replay", "run.mcap"]);
    assert_eq!(code, Some(0), "the job went on to its end: {text}");
    let (code, text) = output(folder.path(), &["run", "--record", "/dev/full"]);
    assert!(
        code == Some(2) && text.contains("the recording cannot be written or read: No space left"),
        "nothing was recorded and nothing has moved: {text}"
    );
}
