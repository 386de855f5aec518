//! What is connected, who may use it, how fast camera and disk are, and whether `run` would start.

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

/// What was found.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosis {
    /// Whether `run` would start with this configuration.
    pub run_would_start: bool,
    /// Point by point.
    pub findings: Vec<Finding>,
    /// What is connected.
    pub connected: Inventory,
}

/// Looks at the computer and what is connected, and checks the configuration. Nothing moves; a camera is opened for some
/// seconds, the configured one or `camera`.
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
