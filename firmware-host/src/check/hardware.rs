//! Checks which hardware a configuration needs and whether it is present.

use crate::camera::{self, CameraConfig, CaptureError};
use crate::codec::{blink1, tara};
use crate::config::{CameraHidConfig, Config, LightConfig, RobotConfig, SourceConfig};
use crate::finding::Finding;
use crate::gripper::GripperConfig;
use crate::hid::{HidError, HidSelector, kernel_leds};
use std::path::Path;

/// One finding for each device: camera, its HID settings, light, gripper and robot.
pub(super) fn examine(config: &Config) -> Vec<Finding> {
    let mut findings = camera(&config.source);
    findings.extend(camera_hid(&config.camera_hid));
    findings.push(light(&config.light));
    findings.push(gripper(&config.gripper));
    findings.push(robot(&config.robot));
    findings
}

const SIMULATED: &str = "simulated, needs no hardware";

fn camera(source: &SourceConfig) -> Vec<Finding> {
    const SUBJECT: &str = "camera";
    match source {
        SourceConfig::Simulated => vec![Finding::ok(SUBJECT, SIMULATED)],
        SourceConfig::Folder { path, .. } => {
            vec![Finding::ok(SUBJECT, format!("none needed: images come from {}", path.display()))]
        }
        SourceConfig::Camera(camera) => cameras(camera),
        SourceConfig::Stream(stream) => {
            vec![Finding::ok(SUBJECT, format!("none needed: frames come through {}", stream.name()))]
        }
    }
}

/// Does not open an existing port: all devices are opened together later.
fn gripper(config: &GripperConfig) -> Finding {
    const SUBJECT: &str = "gripper";
    let Some(port) = config.port() else {
        return Finding::ok(SUBJECT, SIMULATED);
    };
    if port.starts_with("tcp://") {
        return Finding::ok(SUBJECT, format!("needs {port}"));
    }
    if Path::new(port).exists() {
        return Finding::ok(SUBJECT, format!("needs {port}: it is there"));
    }
    Finding::wrong(SUBJECT, format!("needs {port}: there is no such port"))
        .with_advice("plug in its adapter; `gelstereo-host doctor` lists the serial ports that are there")
}

fn robot(config: &RobotConfig) -> Finding {
    match config {
        RobotConfig::Simulated => Finding::ok("robot", SIMULATED),
        RobotConfig::Bridge { address, .. } => Finding::ok("robot", format!("needs a bridge at {address}")),
    }
}

fn cameras(config: &CameraConfig) -> Vec<Finding> {
    let present = camera::list();
    let find = |name: &String| match &present {
        Ok(present) => found("camera", name, camera::select(name, present)),
        Err(error) => Finding::wrong("camera", error.to_string()),
    };
    std::iter::once(&config.device).chain(&config.right_device).map(find).collect()
}

fn found(subject: &'static str, name: &str, result: Result<camera::CameraInfo, CaptureError>) -> Finding {
    match result {
        Ok(info) => Finding::ok(subject, format!("needs {name}: found {info}")),
        Err(error) => Finding::wrong(subject, format!("needs {name}: {error}")),
    }
}

fn camera_hid(config: &CameraHidConfig) -> Option<Finding> {
    match config {
        CameraHidConfig::None => None,
        CameraHidConfig::Tara { serial, .. } => {
            let wanted =
                hid(tara::VENDOR, tara::PRODUCT, serial.clone(), Some(tara::CONTROL_DESCRIPTOR_BYTES));
            Some(by_hid("camera by HID", "an e-con Tara", &wanted))
        }
    }
}

fn light(config: &LightConfig) -> Finding {
    const SUBJECT: &str = "light";
    match config {
        LightConfig::None => Finding::ok(SUBJECT, "none is switched by the host"),
        LightConfig::Blink1 { serial, .. } => {
            let wanted = hid(blink1::VENDOR, blink1::PRODUCT, serial.clone(), None);
            by_hid(SUBJECT, "a blink(1)", &wanted)
        }
        LightConfig::Led { name, .. } => {
            let present = kernel_leds();
            if present.iter().any(|led| led == name) {
                return Finding::ok(SUBJECT, format!("needs {name}: found /sys/class/leds/{name}"));
            }
            let error = HidError::NoLed { wanted: name.clone(), found: present };
            Finding::wrong(SUBJECT, format!("needs {name}: {error}"))
        }
    }
}

fn hid(vendor: u16, product: u16, serial: Option<String>, descriptor_bytes: Option<usize>) -> HidSelector {
    HidSelector { vendor, product, serial, descriptor_bytes }
}

fn by_hid(subject: &'static str, what: &str, wanted: &HidSelector) -> Finding {
    match wanted.find() {
        Ok(device) => Finding::ok(subject, format!("needs {what}: found {device}")),
        Err(error) => Finding::wrong(subject, format!("needs {what}: {error}")),
    }
}
