//! What a camera gives, line by line: for trials of a new camera, and for the tests with real drivers.
//!
//! ```text
//! cargo run --example camera_probe -- --list
//! cargo run --example camera_probe -- --device serial:GS0001 --size 2560x720 --frames 60
//! cargo run --example camera_probe -- --device /dev/video0 --right-device /dev/video2 --size 640x480 --json
//! ```
//!
//! Each line is a frame, an event or a timeout; the last one is the statistics. Exit code: 0 when all frames
//! came, 1 when the time was up before, 2 for an error.
#![allow(clippy::print_stdout)]

use clap::Parser;
use gelstereo_host::camera::{CameraConfig, ControlSettings, PixelFormat, Side, list};
use gelstereo_host::source::{
    CameraSource, Encoded, FrameMode, FrameSource, Gray, Next, SourceError, StereoLayout, StereoPair,
};
use serde_json::{Value, json};
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Print what a camera gives: frames with checksums, events, statistics.
#[derive(Parser)]
struct Arguments {
    /// List video nodes and end.
    #[arg(long)]
    list: bool,
    /// `serial:NUMBER` or a path.
    #[arg(long, required_unless_present = "list")]
    device: Option<String>,
    /// The right camera, where each view has its own.
    #[arg(long)]
    right_device: Option<String>,
    /// side_by_side, side_by_side_swapped, interleaved, interleaved_swapped.
    #[arg(long, default_value = "side_by_side", value_parser = word::<StereoLayout>)]
    layout: StereoLayout,
    /// mjpg, yuyv, grey, y16.
    #[arg(long, default_value = "mjpg", value_parser = word::<PixelFormat>)]
    format: PixelFormat,
    /// Size of the device's frames, pixels.
    #[arg(long, default_value = "1280x480", value_parser = size)]
    size: [u32; 2],
    /// Frame rate, Hz.
    #[arg(long, default_value_t = 30.0)]
    rate: f64,
    /// latest or every.
    #[arg(long, default_value = "every", value_parser = word::<FrameMode>)]
    mode: FrameMode,
    /// Largest time between two devices' images, ms.
    #[arg(long, default_value_t = 5.0)]
    max_skew_ms: f64,
    /// Frames that the driver can fill ahead.
    #[arg(long, default_value_t = 4)]
    buffers: u32,
    /// Frames that wait for the reader.
    #[arg(long, default_value_t = 8)]
    queue_frames: u32,
    /// Silence after which a device is started again, ms.
    #[arg(long, default_value_t = 2000)]
    stall_ms: u64,
    /// First pause before a lost device is tried again, ms.
    #[arg(long, default_value_t = 100)]
    min_retry_ms: u64,
    /// Longest such pause, ms.
    #[arg(long, default_value_t = 5000)]
    max_retry_ms: u64,
    /// Exposure, µs.
    #[arg(long)]
    exposure_us: Option<f64>,
    /// Whether the camera chooses the exposure.
    #[arg(long)]
    auto_exposure: Option<bool>,
    /// Gain.
    #[arg(long)]
    gain: Option<i64>,
    /// White balance, K.
    #[arg(long)]
    white_balance_k: Option<i64>,
    /// Any other control, NAME=VALUE.
    #[arg(long = "control", value_parser = assignment)]
    controls: Vec<(String, i64)>,
    /// Print all controls first.
    #[arg(long)]
    list_controls: bool,
    /// Frames to wait for.
    #[arg(long, default_value_t = 30)]
    frames: u64,
    /// Longest time to wait for one frame, ms; a longer wait is a line `timeout`.
    #[arg(long, default_value_t = 1000)]
    timeout_ms: u64,
    /// Longest time to run, s.
    #[arg(long, default_value_t = 60.0)]
    duration_s: f64,
    /// Time to do nothing after each frame, as a slow reader does, ms.
    #[arg(long, default_value_t = 0)]
    work_ms: u64,
    /// Write both views as PGM files, and the JPEG files as they came.
    #[arg(long, value_name = "FOLDER")]
    save: Option<PathBuf>,
    /// Lines of JSON instead of text.
    #[arg(long)]
    json: bool,
}

fn word<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_value(Value::from(text)).map_err(|error| error.to_string())
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    sides.ok_or_else(|| format!("{text} is no size; valid is such as 1280x480"))
}

fn assignment(text: &str) -> Result<(String, i64), String> {
    let parts = text.split_once('=').and_then(|(name, value)| Some((name.to_owned(), value.parse().ok()?)));
    parts.ok_or_else(|| format!("{text} is no assignment; valid is such as sharpness=2"))
}

impl Arguments {
    fn config(&self) -> CameraConfig {
        CameraConfig {
            device: self.device.clone().unwrap_or_default(),
            right_device: self.right_device.clone(),
            layout: self.layout,
            format: self.format,
            size_px: self.size,
            frame_rate_hz: self.rate,
            mode: self.mode,
            max_skew_ms: self.max_skew_ms,
            buffers: self.buffers,
            queue_frames: self.queue_frames,
            stall_timeout_ms: self.stall_ms,
            min_retry_ms: self.min_retry_ms,
            max_retry_ms: self.max_retry_ms,
            keep_encoded: true,
            controls: ControlSettings {
                exposure_us: self.exposure_us,
                auto_exposure: self.auto_exposure,
                gain: self.gain,
                white_balance_k: self.white_balance_k,
                other: self.controls.iter().cloned().collect(),
                ..ControlSettings::default()
            },
        }
    }

    /// One line. As text: the kind, then each field with its name.
    fn say(&self, kind: &str, fields: &Value) {
        if self.json {
            let mut line = json!({ "line": kind });
            if let (Some(line), Some(fields)) = (line.as_object_mut(), fields.as_object()) {
                line.extend(fields.clone());
            }
            println!("{line}");
            return;
        }
        let fields = fields.as_object().into_iter().flatten();
        let words: Vec<_> = fields.map(|(name, value)| format!("{name}={value}")).collect();
        println!("{kind} {}", words.join(" "));
    }
}

fn checksum(bytes: &[u8]) -> String {
    format!("{:08x}", crc32fast::hash(bytes))
}

fn described(pair: &StereoPair) -> Value {
    let capture = &pair.capture;
    let mut fields = json!({
        "sequence": capture.sequence,
        "driver_ns": capture.driver_ns,
        "received_ns": capture.received_ns,
        "dropped": capture.dropped,
        "skew_ns": capture.skew_ns,
        "stale": pair.stale,
        "size": [pair.left.width, pair.left.height],
        "left": checksum(&pair.left.pixels),
        "right": checksum(&pair.right.pixels),
    });
    match &pair.encoded {
        Encoded::None => {}
        Encoded::Joint { jpeg, .. } => {
            fields["jpeg"] = json!(checksum(jpeg));
            fields["jpeg_bytes"] = json!(jpeg.len());
        }
        Encoded::Separate { left_jpeg, right_jpeg } => {
            fields["left_jpeg"] = json!(checksum(left_jpeg));
            fields["right_jpeg"] = json!(checksum(right_jpeg));
        }
    }
    fields
}

fn save(folder: &std::path::Path, pair: &StereoPair) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    let number = pair.capture.sequence;
    let pgm = |image: &Gray| {
        [format!("P5 {} {} 255\n", image.width, image.height).as_bytes(), &image.pixels].concat()
    };
    std::fs::write(folder.join(format!("left_{number:06}.pgm")), pgm(&pair.left))?;
    std::fs::write(folder.join(format!("right_{number:06}.pgm")), pgm(&pair.right))?;
    match &pair.encoded {
        Encoded::None => Ok(()),
        Encoded::Joint { jpeg, .. } => std::fs::write(folder.join(format!("joint_{number:06}.jpg")), jpeg),
        Encoded::Separate { left_jpeg, right_jpeg } => {
            std::fs::write(folder.join(format!("left_{number:06}.jpg")), left_jpeg)?;
            std::fs::write(folder.join(format!("right_{number:06}.jpg")), right_jpeg)
        }
    }
}

fn run(arguments: &Arguments) -> Result<bool, Box<dyn Error>> {
    if arguments.list {
        for camera in list()? {
            if arguments.json {
                arguments.say("camera", &serde_json::to_value(&camera)?)
            } else {
                println!("{camera}")
            }
        }
        return Ok(true);
    }
    let begun = Instant::now();
    let mut source = CameraSource::open(&arguments.config())?;
    arguments
        .say("opened", &json!({ "ms": begun.elapsed().as_millis() as u64, "devices": source.devices() }));
    if arguments.list_controls {
        for control in source.controls(Side::Left)? {
            arguments.say("control", &serde_json::to_value(&control)?);
        }
    }
    let timeout = Duration::from_millis(arguments.timeout_ms);
    let mut pair = StereoPair::default();
    let (mut frames, mut longest_ms) = (0, 0.0f64);
    while frames < arguments.frames && begun.elapsed().as_secs_f64() < arguments.duration_s {
        let asked = Instant::now();
        let next = source.next_pair(timeout, &mut pair);
        longest_ms = longest_ms.max(asked.elapsed().as_secs_f64() * 1e3);
        match next {
            Ok(Next::Pair) => {
                frames += 1;
                arguments.say("frame", &described(&pair));
                if let Some(folder) = &arguments.save {
                    save(folder, &pair)?;
                }
                std::thread::sleep(Duration::from_millis(arguments.work_ms));
            }
            Ok(Next::Event(event)) => {
                let mut fields = serde_json::to_value(&event)?;
                fields["text"] = json!(event.to_string());
                fields["stale"] = json!(pair.stale);
                arguments.say("event", &fields);
            }
            Ok(Next::End) => break,
            Err(SourceError::Timeout { waited }) => {
                let fields = json!({ "waited_ms": waited.as_millis() as u64, "stale": pair.stale });
                arguments.say("timeout", &fields);
            }
            Err(error) => return Err(error.into()),
        }
    }
    let mut statistics = serde_json::to_value(source.statistics())?;
    statistics["longest_call_ms"] = json!(longest_ms);
    let closing = Instant::now();
    drop(source);
    statistics["close_ms"] = json!(closing.elapsed().as_secs_f64() * 1e3);
    arguments.say("statistics", &statistics);
    Ok(frames >= arguments.frames)
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match run(&arguments) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}
