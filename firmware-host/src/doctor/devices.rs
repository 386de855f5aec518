//! Lists connected cameras, serial ports and HID devices, and checks whether this user may use them.

use super::access::{Access, UdevMatch, access};
use super::roots::{Roots, link_name};
use super::serial::{SerialPort, serial_ports};
use crate::camera::{self, CameraInfo, NodeKind};
use crate::codec::{blink1, tara};
use crate::finding::Finding;
use crate::hid::{self, HidInfo};
use serde::Serialize;
use std::path::Path;

/// A camera with its data from sysfs and the driver.
#[derive(Clone, Debug, Serialize)]
pub struct CameraEntry {
    /// Name, path and serial number.
    #[serde(flatten)]
    pub info: CameraInfo,
    /// Kernel driver.
    pub driver: Option<String>,
    /// Formats and sizes, as far as the camera could be queried.
    pub formats: Vec<String>,
}

/// Connected devices.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Inventory {
    /// Video nodes.
    pub cameras: Vec<CameraEntry>,
    /// Serial ports.
    pub serial_ports: Vec<SerialPort>,
    /// Descriptions of HID devices.
    pub hid_devices: Vec<String>,
}

/// Findings about all devices.
pub(super) fn examine(roots: &Roots) -> (Inventory, Vec<Finding>) {
    let mut findings = Vec::new();
    let cameras = cameras(roots, &mut findings);
    let ports = serial_ports(roots);
    findings.extend(serial_findings(roots, &ports));
    let hid_devices = hid_devices(roots, &mut findings);
    (Inventory { cameras, serial_ports: ports, hid_devices }, findings)
}

fn cameras(roots: &Roots, findings: &mut Vec<Finding>) -> Vec<CameraEntry> {
    const SUBJECT: &str = "cameras";
    let listed = match camera::list() {
        Ok(listed) => listed,
        Err(error) => {
            findings.push(Finding::warn(SUBJECT, error.to_string(), "feed frames through a stream instead"));
            return Vec::new();
        }
    };
    let entries: Vec<CameraEntry> = listed
        .into_iter()
        .map(|info| {
            let node = info.path.file_name().unwrap_or_default();
            let driver = link_name(&roots.sys.join("class/video4linux").join(node).join("device/driver"));
            let formats = if info.gives_frames() { camera::offers(&info.path) } else { Vec::new() };
            CameraEntry { info, driver, formats }
        })
        .collect();
    let usable = entries.iter().filter(|entry| entry.info.kind != NodeKind::Metadata);
    let before = findings.len();
    findings.extend(usable.map(|entry| camera_finding(roots, entry)));
    if findings.len() == before {
        findings.push(Finding::ok(SUBJECT, "none is connected (no /dev/video*)"));
    }
    entries
}

fn camera_finding(roots: &Roots, entry: &CameraEntry) -> Finding {
    const SUBJECT: &str = "cameras";
    let info = &entry.info;
    let mut found = info.to_string();
    if let Some(driver) = &entry.driver {
        found += &format!(", driver {driver}");
    }
    if !entry.formats.is_empty() {
        found += &format!(", offers {}", entry.formats.join("; "));
    }
    let usb = info.vendor_id.as_deref().zip(info.product_id.as_deref());
    match access(roots, &info.path, UdevMatch { subsystem: "video4linux", usb }) {
        Access::Denied { advice } => Finding::warn(SUBJECT, found, advice),
        Access::Allowed | Access::Absent if info.kind == NodeKind::Multiplanar => {
            Finding::warn(SUBJECT, found, "it cannot be opened directly; feed its frames through a stream")
        }
        _ => Finding::ok(SUBJECT, found),
    }
}

/// Findings about the serial ports, with those that this user may not use.
pub(super) fn serial_findings(roots: &Roots, ports: &[SerialPort]) -> Vec<Finding> {
    const SUBJECT: &str = "serial ports";
    if ports.is_empty() {
        return vec![Finding::ok(SUBJECT, "none is connected")];
    }
    ports.iter().map(|port| serial_finding(roots, port)).collect()
}

/// Grippers polled at 100 Hz and more cannot wait for the usual 16 ms.
const MAX_LATENCY_TIMER_MS: u32 = 2;

fn serial_finding(roots: &Roots, port: &SerialPort) -> Finding {
    const SUBJECT: &str = "serial ports";
    let usb = port.usb.as_ref().map(|usb| (usb.vendor_id.as_str(), usb.product_id.as_str()));
    if let Access::Denied { advice } = access(roots, &port.path, UdevMatch { subsystem: "tty", usb }) {
        return Finding::warn(SUBJECT, port.to_string(), advice);
    }
    match port.latency_timer_ms {
        Some(ms) if ms > MAX_LATENCY_TIMER_MS => {
            let name = port.path.file_name().unwrap_or_default().to_string_lossy();
            let advice = format!(
                "answers come up to {ms} ms late: run `echo 1 | sudo tee \
                /sys/class/tty/{name}/device/latency_timer`"
            );
            Finding::warn(SUBJECT, port.to_string(), advice)
        }
        _ => Finding::ok(SUBJECT, port.to_string()),
    }
}

fn hid_devices(roots: &Roots, findings: &mut Vec<Finding>) -> Vec<String> {
    const SUBJECT: &str = "HID devices";
    let listed = match hid::list() {
        Ok(listed) => listed,
        Err(error) => {
            findings.push(Finding::warn(SUBJECT, error.to_string(), "is /sys mounted?"));
            return Vec::new();
        }
    };
    if listed.is_empty() {
        findings.push(Finding::ok(SUBJECT, "none is connected (no /dev/hidraw*)"));
    }
    findings.extend(listed.iter().map(|device| hid_finding(roots, device, &device.path)));
    listed.iter().map(ToString::to_string).collect()
}

fn hid_finding(roots: &Roots, device: &HidInfo, node: &Path) -> Finding {
    const SUBJECT: &str = "HID devices";
    let (vendor, product) = (format!("{:04x}", device.vendor), format!("{:04x}", device.product));
    let known = [(tara::VENDOR, tara::PRODUCT), (blink1::VENDOR, blink1::PRODUCT)]
        .contains(&(device.vendor, device.product));
    match access(roots, node, UdevMatch { subsystem: "hidraw", usb: Some((&vendor, &product)) }) {
        // Keyboards and mice are irrelevant here.
        Access::Denied { advice } if known => Finding::warn(SUBJECT, device.to_string(), advice),
        _ => Finding::ok(SUBJECT, device.to_string()),
    }
}
