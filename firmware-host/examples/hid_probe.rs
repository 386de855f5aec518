//! What HID devices answer, line by line: for trials of a camera or light, and for the tests with real
//! drivers.
//!
//! ```text
//! cargo run --example hid_probe -- list
//! cargo run --example hid_probe -- tara firmware exposure exposure=12000 mode=master calibration=intrinsic
//! cargo run --example hid_probe -- blink1 --serial SN1 version set=200,100,50 color fade=0,0,0,500
//! cargo run --example hid_probe -- led thingm0:red:led0 0.5
//! cargo run --example hid_probe -- settings cell.toml
//! ```
//!
//! Each line is the JSON of one answer. Exit code: 0, or 2 for an error, which goes to stderr.
#![allow(clippy::print_stdout)]

use clap::{Parser, Subcommand};
use gelstereo_host::codec::blink1::{Led, Rgb};
use gelstereo_host::codec::tara::{CalibrationFile, Exposure, StreamMode};
use gelstereo_host::config::Config;
use gelstereo_host::hid::{Blink1Light, KernelLed, TaraControl, kernel_leds, list};
use gelstereo_host::light::{LightOn, set_up_camera};
use serde_json::{Value, json};
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

/// Talk to HID devices.
#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    device: Device,
}

#[derive(Subcommand)]
enum Device {
    /// List HID devices and the kernel's lights.
    List,
    /// An e-con Tara: firmware, unique_id, exposure[=US], mode[=master|trigger], hdr[=0|1],
    /// calibration=intrinsic|extrinsic.
    Tara {
        /// Serial number, if there are several.
        #[arg(long)]
        serial: Option<String>,
        /// What to do, in this order.
        commands: Vec<String>,
    },
    /// A blink(1): version, color, set=R,G,B, fade=R,G,B,MS.
    Blink1 {
        /// Serial number, if there are several.
        #[arg(long)]
        serial: Option<String>,
        /// What to do, in this order.
        commands: Vec<String>,
    },
    /// Make the settings of `[light]` and `[camera_hid]`, wait for the end of standard input, switch the
    /// light off.
    Settings {
        /// Configuration of `gelstereo-host`.
        config: PathBuf,
    },
    /// A light of the kernel.
    Led {
        /// Its name in /sys/class/leds.
        name: String,
        /// 0 to 1.
        brightness: f64,
    },
}

fn tara(device: &mut TaraControl, command: &str) -> Result<Value, Box<dyn Error>> {
    let exposure = |exposure: Exposure| json!({ "exposure_us": exposure.us() });
    let mode = |mode| json!({ "mode": if mode == StreamMode::Master { "master" } else { "trigger" } });
    Ok(match command.split_once('=').unwrap_or((command, "")) {
        ("firmware", "") => json!({ "firmware": device.firmware()?.to_string() }),
        ("unique_id", "") => json!({ "unique_id": device.unique_id()? }),
        ("exposure", "") => exposure(device.exposure()?),
        ("exposure", us) => exposure(device.set_exposure(Exposure::from_us(us.parse()?)?)?),
        ("mode", "") => mode(device.stream_mode()?),
        ("mode", "master") => mode(device.set_stream_mode(StreamMode::Master)?),
        ("mode", "trigger") => mode(device.set_stream_mode(StreamMode::Trigger)?),
        ("hdr", "") => json!({ "hdr": device.hdr()? }),
        ("hdr", on) => json!({ "hdr": device.set_hdr(on == "1")? }),
        ("calibration", "intrinsic") => text(&device.calibration(CalibrationFile::Intrinsic)?),
        ("calibration", "extrinsic") => text(&device.calibration(CalibrationFile::Extrinsic)?),
        _ => return Err(format!("{command} is no command of a Tara").into()),
    })
}

fn text(file: &[u8]) -> Value {
    json!({ "calibration": String::from_utf8_lossy(file) })
}

fn numbers<const N: usize>(text: &str) -> Result<[u32; N], Box<dyn Error>> {
    let numbers: Vec<u32> = text.split(',').map(str::parse).collect::<Result<_, _>>()?;
    numbers.try_into().map_err(|_| format!("{text} is not {N} numbers").into())
}

fn rgb(levels: [u32; 3]) -> Result<Rgb, Box<dyn Error>> {
    let [red, green, blue] = levels.map(u8::try_from);
    Ok(Rgb { red: red?, green: green?, blue: blue? })
}

fn blink1(device: &mut Blink1Light, command: &str) -> Result<Value, Box<dyn Error>> {
    Ok(match command.split_once('=').unwrap_or((command, "")) {
        ("version", "") => {
            let version = device.version()?;
            json!({ "version": [version.major, version.minor] })
        }
        ("color", "") => {
            let Rgb { red, green, blue } = device.color(Led::All)?;
            json!({ "color": [red, green, blue] })
        }
        ("set", color) => {
            device.set(rgb(numbers(color)?)?)?;
            json!({ "set": color })
        }
        ("fade", values) => {
            let [red, green, blue, fade_ms] = numbers(values)?;
            device.fade(rgb([red, green, blue])?, fade_ms)?;
            json!({ "fade": values })
        }
        _ => return Err(format!("{command} is no command of a blink(1)").into()),
    })
}

fn run(device: Device) -> Result<(), Box<dyn Error>> {
    match device {
        Device::List => {
            for info in list()? {
                println!(
                    "{}",
                    json!({
                        "path": info.path, "vendor": info.vendor, "product": info.product,
                        "serial": info.serial, "name": info.name, "interface": info.interface,
                        "descriptor_bytes": info.descriptor_bytes,
                    })
                );
            }
            println!("{}", json!({ "leds": kernel_leds() }));
        }
        Device::Tara { serial, commands } => {
            let mut device = TaraControl::open(serial.as_deref())?;
            for command in commands {
                println!("{}", tara(&mut device, &command)?);
            }
        }
        Device::Blink1 { serial, commands } => {
            let mut device = Blink1Light::open(serial.as_deref())?;
            for command in commands {
                println!("{}", blink1(&mut device, &command)?);
            }
        }
        Device::Settings { config } => {
            let config = Config::load(&config)?;
            set_up_camera(&config.camera_hid)?;
            let light = LightOn::new(&config.light)?;
            println!("{}", json!({ "line": "on" }));
            std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
            light.off()?;
            println!("{}", json!({ "line": "off" }));
        }
        Device::Led { name, brightness } => {
            let led = KernelLed::open(&name)?;
            led.set(brightness)?;
            println!("{}", json!({ "brightness": led.brightness()? }));
        }
    }
    Ok(())
}

fn main() -> ExitCode {
    match run(Arguments::parse().device) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}
