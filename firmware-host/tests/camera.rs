//! Cameras in the configuration, and in the simulated world.
#![allow(clippy::unwrap_used)]

use gelstereo_host::camera::{CameraConfig, ControlSettings, PixelFormat};
use gelstereo_host::check::check;
use gelstereo_host::config::{Config, SourceConfig};
use gelstereo_host::gripper::Gripper;
use gelstereo_host::run::Setup;
use gelstereo_host::source::{
    FrameMode, FrameSource, Next, SourceError, SourceEvent, StereoLayout, StereoPair,
};
use gelstereo_host::world::{Place, SimulatedGripper, TimedSource, World};
use gelstereo_sim::Scene;
use std::rc::Rc;
use std::time::Duration;

fn with_rig(text: &str) -> Config {
    let mut config = Config::parse(text, "cell.toml").unwrap();
    config.rig = Some(Scene::default_rig());
    config
}

fn refusal(settings: &str) -> String {
    let text = format!("[source]\nkind = \"camera\"\n{settings}\n");
    match Config::parse(&text, "cell.toml") {
        Err(error) => error.to_string(),
        Ok(mut config) => {
            config.rig = Some(Scene::default_rig());
            config.validate().unwrap_err().to_string()
        }
    }
}

#[test]
fn a_camera_is_configured_and_written_back() {
    let text = r#"
        [source]
        kind = "camera"
        device = "serial:GS0001"
        layout = "interleaved_swapped"
        format = "y16"
        size_px = [640, 480]
        frame_rate_hz = 60
        mode = "every"
        [source.controls]
        exposure_us = 8000
        other = { sharpness = 2 }
    "#;
    let config = with_rig(text);
    config.validate().unwrap();
    let expected = CameraConfig {
        device: "serial:GS0001".to_owned(),
        layout: StereoLayout::InterleavedSwapped,
        format: PixelFormat::Y16,
        size_px: [640, 480],
        frame_rate_hz: 60.0,
        mode: FrameMode::Every,
        controls: ControlSettings {
            exposure_us: Some(8000.0),
            other: [("sharpness".to_owned(), 2)].into(),
            ..ControlSettings::default()
        },
        ..CameraConfig::default()
    };
    assert_eq!(expected.view_size_px(), (640, 480));
    assert_eq!(config.source, SourceConfig::Camera(expected));
    assert_eq!(Config::parse(&config.to_toml().unwrap(), "").unwrap(), config);
}

#[test]
fn every_setting_of_a_camera_is_checked() {
    let device = "device = \"/dev/video0\"\n";
    let cases = [
        ("", "source.device is \"\"; valid is serial: and the USB serial number, or a path"),
        ("device = \"0\"", "source.device is \"0\"; valid is serial:"),
        ("size_px = [0, 480]", "source.size_px is [0, 480]; valid is 1 to 8192 pixels each"),
        ("size_px = [1281, 480]", "two views in one frame need an even width"),
        ("format = \"y16\"", "layout must be interleaved"),
        ("layout = \"interleaved\"", "JPEG mixes neighbours"),
        ("frame_rate_hz = 0", "source.frame_rate_hz is 0; valid is 0.1 to 1000 Hz"),
        ("frame_rate_hz = nan", "source.frame_rate_hz is NaN"),
        ("right_device = \"\"", "source.right_device is \"\""),
        ("right_device = \"/dev/video0\"", "valid is another device than `device`, or nothing"),
        ("right_device = \"/dev/video2\"\nmax_skew_ms = 17", "at most half a frame's period"),
        ("right_device = \"/dev/video2\"\nmax_skew_ms = nan", "source.max_skew_ms is NaN"),
        ("buffers = 33", "source.buffers is 33; valid is 2 to 32 frames"),
        ("queue_frames = 257", "source.queue_frames is 257; valid is 1 to 256 frames"),
        ("stall_timeout_ms = 0", "source.stall_timeout_ms is 0; valid is 10 to 3600000 ms"),
        ("stall_timeout_ms = 66", "at least two frames' periods"),
        ("min_retry_ms = 9", "source.min_retry_ms is 9"),
        ("max_retry_ms = 99", "source.max_retry_ms is 99; valid is at least min_retry_ms"),
        ("controls = { exposure_us = 0 }", "source.controls.exposure_us is 0; valid is 100 to 10000000 us"),
        ("controls = { exposure_us = 100, auto_exposure = true }", "false, or no exposure_us"),
        ("controls = { white_balance_k = 4600, auto_white_balance = true }", "no white_balance_k"),
        ("controls = { sharpness = 2 }", "sharpness"),
        ("colour = true", "colour"),
        ("format = \"rgb\"", "\"rgb\""),
    ];
    for (settings, words) in cases {
        let named = if settings.is_empty() || settings.starts_with("device") { "" } else { device };
        let found = refusal(&format!("{named}{settings}"));
        assert!(found.contains(words), "{settings}: {found}");
    }
}

#[test]
fn a_camera_needs_its_rig_and_to_be_there() {
    let text = "[source]\nkind = \"camera\"\ndevice = \"serial:no such number\"\n";
    let missing = Config::parse(text, "").unwrap().validate().unwrap_err().to_string();
    assert!(missing.contains("a camera needs its rig: add rig_file"), "{missing}");
    let findings = check(&with_rig(text));
    let devices = findings.iter().find(|finding| finding.subject == "devices").unwrap();
    let problem = devices.found.clone();
    if cfg!(target_os = "linux") {
        assert!(
            problem.starts_with("there is no camera serial:no such number; connected are: "),
            "{problem}"
        );
    } else {
        assert!(problem.contains("standard input"), "{problem}");
    }
}

#[test]
fn a_camera_too_slow_for_the_tasks_moves_is_good_for_sensing() {
    let text = "[source]\nkind = \"camera\"\ndevice = \"/dev/no-camera\"\nframe_rate_hz = 4.0\n";
    let slow = with_rig(text);
    slow.validate().unwrap();
    let refused =
        [Setup::new(&slow), Setup::for_teaching(&slow)].map(|setup| setup.err().unwrap().to_string());
    for words in refused {
        assert!(words.contains("task.closing_speed_mm_s allows no two periods of 4 Hz"), "{words}");
    }
    let findings = check(&slow);
    let task = findings.iter().find(|finding| finding.subject == "task").unwrap();
    assert!(task.found.contains("task.max_blind_travel_mm is 3 mm, 150 ms at 20 mm/s"), "{}", task.found);
    // For sensing the camera is opened, and only then missed.
    let sensing = Setup::without_robot(&slow).err().unwrap().to_string();
    assert!(!sensing.contains("task."), "{sensing}");

    let moves = "[task]\nclosing_speed_mm_s = 5.0\ninsertion_speed_mm_s = 5.0\nmove_speed_mm_s = 200.0\n";
    with_rig(&format!("{text}{moves}")).validate_task().unwrap();
}

/// Pairs at these times; `None` is an event.
struct Times(std::vec::IntoIter<Option<u64>>);

impl FrameSource for Times {
    fn next_pair(&mut self, _timeout: Duration, pair: &mut StereoPair) -> Result<Next, SourceError> {
        Ok(match self.0.next() {
            None => Next::End,
            Some(None) => Next::Event(SourceEvent::Connected { device: String::new() }),
            Some(Some(time_ns)) => {
                pair.time_ns = time_ns;
                Next::Pair
            }
        })
    }
}

/// 10 mm/s for the time that the camera's timestamps say, whatever frames were lost; at most 1 s of an
/// interruption.
#[test]
fn the_simulated_gripper_moves_by_the_cameras_clock() {
    let config = with_rig("[source]\nkind = \"camera\"\ndevice = \"/dev/video0\"\nframe_rate_hz = 100\n");
    let world = World::shared(&config, Place::Holder).unwrap();
    let mut gripper = SimulatedGripper(Rc::clone(&world));
    gripper.activate().unwrap();
    let start_mm = gripper.status().unwrap().width_mm;
    gripper.move_to(start_mm - 50.0, 10.0, 0.5).unwrap();
    let ms = |ms: u64| Some(7_000_000_000 + ms * 1_000_000);
    let times = vec![ms(0), None, ms(10), ms(25), ms(40), None, ms(100), ms(600), ms(60_000)];
    let mut source = TimedSource::new(Box::new(Times(times.into_iter())), world);
    let mut moved_mm = Vec::new();
    let mut pair = StereoPair::default();
    while source.next_pair(Duration::ZERO, &mut pair).unwrap() != Next::End {
        moved_mm.push(start_mm - gripper.status().unwrap().width_mm);
    }
    // 25 ms are two periods and a half, the rest of which is not lost.
    let expected = [0.0, 0.0, 0.1, 0.2, 0.4, 0.4, 1.0, 6.0, 16.0];
    assert_eq!(moved_mm.len(), expected.len());
    for (found, expected) in moved_mm.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-9, "{moved_mm:?}");
    }
}
