//! Diagnosis: connected devices, permissions, camera and disk speed, and whether `run` would start.

mod access;
mod capture;
mod clock;
mod devices;
mod disk;
mod processor;
mod roots;
mod serial;
mod usb;

pub use access::{Access, Permissions, UdevMatch, advise};
pub use devices::{CameraEntry, Inventory};
pub use roots::Roots;
pub use serial::{SerialPort, serial_ports};
pub use usb::UsbIdentity;

use crate::camera::CameraConfig;
use crate::check;
use crate::config::{Config, SourceConfig};
use crate::finding::{Finding, all_right};
use serde::Serialize;

/// Result of the diagnosis.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosis {
    /// Whether `run` would start with this configuration.
    pub run_would_start: bool,
    /// Individual findings.
    pub findings: Vec<Finding>,
    /// Connected devices.
    pub connected: Inventory,
}

/// Examines the computer and its devices and checks the configuration. Nothing moves; the configured
/// camera or `camera` is opened for some seconds.
#[must_use]
pub fn examine(config: &Config, camera: Option<&CameraConfig>, roots: &Roots) -> Diagnosis {
    let (connected, mut findings) = devices::examine(roots);
    let configured = match &config.source {
        SourceConfig::Camera(camera) => Some(camera),
        _ => None,
    };
    findings.extend(camera.or(configured).map(capture::examine));
    findings.push(disk::examine(config));
    findings.extend(clock::examine(roots));
    findings.push(processor::examine(roots));
    findings.extend(check::check(config));
    Diagnosis { run_would_start: all_right(&findings), findings, connected }
}
