//! A long run at speed: memory, file handles and marker identities stay what they were.
//!
//! `GELSTEREO_LONG_FRAMES` sets how many frames go through the pipeline and two recordings; 24 hours at 30 Hz
//! have 2,592,000. Without it the run is short, and shows only that the test itself works. Every tenth pair
//! is recorded, every result is.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

use gelstereo_core::math::{DVec2, DVec3, Pose};
use gelstereo_core::track::MarkerState;
use gelstereo_host::config::{Config, RecordingConfig, RecordingMode};
use gelstereo_host::notes::frame_note;
use gelstereo_host::part::Part;
use gelstereo_host::recording::{
    Content, LogClock, MessageSink, Recording, Store, Topic, messages, part_path,
};
use gelstereo_host::run::recorded_config;
use gelstereo_host::sensing::Sensing;
use gelstereo_host::source::{Gray, StereoPair};
use gelstereo_sim::effects::SensorNoise;
use gelstereo_sim::{ContactState, Effects, Keyframe, Scene, Shape, Simulator, Truth};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

const PERIOD_NS: u64 = 33_333_333;
/// Pairs that are looped: a ball that presses and leaves.
const LOOP: usize = 24;
/// Growth after the first fifth of the run that is no leak: buffers that grow with the largest chunk so far.
const MAX_GROWTH_KB: u64 = 16_000;

fn frames() -> u64 {
    std::env::var("GELSTEREO_LONG_FRAMES").ok().and_then(|text| text.parse().ok()).unwrap_or(240)
}

/// The rest frame, then a press and its release.
fn looped() -> Vec<StereoPair> {
    let at = |time_s: f64, z_mm: f64| Keyframe {
        time_s,
        contact: ContactState {
            t_sensor_object: Pose::from_translation_mm(DVec3::new(4.0, 0.0, z_mm)),
            shear_mm: [0.0; 2],
            twist_rad: 0.0,
        },
    };
    let last_s = (LOOP - 1) as f64 / 30.0;
    let effects = Effects { sensor_noise: Some(SensorNoise::default()), ..Effects::of_gel() };
    let scene = Scene {
        indenter: Some(Shape::Sphere { radius_mm: 4.0 }),
        trajectory: vec![at(0.0, 34.0), at(0.5 * last_s, 31.5), at(last_s, 34.0)],
        effects,
        ..Scene::default()
    };
    let mut simulator = Simulator::new(&scene, None).unwrap();
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    let image = |pixels: &[u8]| Gray { width: 640, height: 480, pixels: pixels.to_vec() };
    (0..LOOP)
        .map(|frame| {
            let contact = simulator.contact(frame);
            simulator.moment(contact.as_ref(), frame as u64, &mut truth);
            simulator.render(&truth, frame as u64, &mut left, &mut right);
            StereoPair { left: image(&left), right: image(&right), ..StereoPair::default() }
        })
        .collect()
}

/// Files of which only the last two stay, so that a day fits a disk.
fn recording(folder: &Path, name: &str, mode: RecordingMode, config: &Config) -> Recording {
    let path = folder.join(name);
    let settings = RecordingConfig {
        path: path.clone(),
        mode,
        // Compressing every image would take most of the time of a day at speed.
        every_nth: 10,
        split_mb: 40,
        ring_s: 1.0,
        ring_after_s: 0.5,
        ..RecordingConfig::default()
    };
    let content = Content { config_toml: recorded_config(config).unwrap(), attachments: Vec::new() };
    let open = move |part: u32| {
        if let Some(old) = part.checked_sub(2) {
            std::fs::remove_file(part_path(&path, old)).unwrap();
        }
        let path: PathBuf = part_path(&path, part);
        let file: Box<dyn Store> = Box::new(File::create(&path).unwrap());
        Ok((path, file))
    };
    Recording::with_stores(&settings, content, LogClock::Source, Box::new(open)).unwrap()
}

fn resident_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

fn handles() -> usize {
    std::fs::read_dir("/proc/self/fd").unwrap().count()
}

/// How far any marker is from where it was at this place of the loop before.
fn worst_px(now: &[DVec2], before: &[DVec2]) -> f64 {
    assert_eq!(now.len(), before.len());
    now.iter().zip(before).map(|(a, b)| (*a - *b).length()).fold(0.0, f64::max)
}

#[test]
fn a_long_run_keeps_memory_handles_and_identities() {
    let (config, folder, pairs, count) =
        (Config::default(), tempfile::tempdir().unwrap(), looped(), frames());
    let template = Part::load(&config.part.shape).unwrap().template(&config.part).unwrap();
    let mut sensing = Sensing::new(&config.rig().unwrap(), &config.params, template).unwrap();
    let mut recordings = [("all.mcap", RecordingMode::All), ("ring.mcap", RecordingMode::Ring)]
        .map(|(name, mode)| recording(folder.path(), name, mode, &config));
    let mut places: Vec<Vec<DVec2>> = Vec::new();
    let (mut pair, mut settled, mut worst, mut lost) = (StereoPair::default(), None, 0.0_f64, 0_u64);
    for frame in 0..count {
        let at = (frame % LOOP as u64) as usize;
        pair.left.clone_from(&pairs[at].left);
        pair.right.clone_from(&pairs[at].right);
        pair.time_ns = frame * PERIOD_NS;
        pair.capture.sequence = frame;
        let sensed = sensing.process(&pair).map(|_| ());
        assert!(sensed.is_ok(), "frame {frame}: {sensed:?}");
        let note = messages::string(&frame_note(&sensed, &sensing).to_string());
        let points = messages::points(pair.time_ns, sensing.frame());
        for recording in &mut recordings {
            recording.write_pair(&pair);
            recording.write(Topic::Frame, pair.time_ns, &note);
            recording.write(Topic::Points, pair.time_ns, &points);
        }
        // At 30 Hz nothing piles up; here the disk sets the pace.
        while recordings.iter().any(|recording| recording.queued_bytes() > 2_000_000) {
            std::thread::yield_now();
        }
        if frame % 600 == 300 {
            recordings[1].trigger(pair.time_ns, "long run");
        }
        let result = sensing.frame();
        lost += result.state.iter().filter(|&&state| state == MarkerState::Lost).count() as u64;
        match places.get(at) {
            None => places.push(result.left_px.clone()),
            Some(before) => worst = worst.max(worst_px(&result.left_px, before)),
        }
        if frame == count / 5 {
            settled = Some((resident_kb(), handles()));
        }
    }
    let (before_kb, before_handles) = settled.unwrap();
    let (after_kb, after_handles) = (resident_kb(), handles());
    let parts = recordings.map(|recording| {
        let report = recording.finish();
        assert_eq!((report.fault, report.lost_messages), (None, 0));
        report.files.len()
    });
    writeln!(
        std::io::stderr(),
        "{count} frames ({:.2} h at 30 Hz), {parts:?} files; resident {before_kb} kB after a fifth, \
         {after_kb} kB at the end; {before_handles} and {after_handles} handles; markers within {worst:.3} \
         px of the first loop",
        count as f64 / 30.0 / 3600.0
    )
    .unwrap();
    assert!(after_kb < before_kb + MAX_GROWTH_KB, "{before_kb} kB grew to {after_kb} kB");
    // A file may be open or not when they are counted.
    assert!(after_handles <= before_handles + 1, "{before_handles} handles became {after_handles}");
    // Half a pitch of about 20 px away would be another marker.
    assert!(lost == 0 && worst < 2.0, "{lost} markers lost, {worst} px from their places");
}
