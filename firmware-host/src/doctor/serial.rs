//! Lists serial ports from sysfs.

use super::roots::{Roots, link_name, names, text};
use super::usb::UsbIdentity;
use serde::Serialize;
use std::path::PathBuf;

/// A serial port that may connect a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SerialPort {
    /// Device node, `/dev/ttyUSB0`.
    pub path: PathBuf,
    /// Name below `/dev/serial/by-id` that does not depend on the order of connection.
    pub by_id: Option<PathBuf>,
    /// Kernel driver.
    pub driver: String,
    /// USB adapter, if it is one.
    pub usb: Option<UsbIdentity>,
    /// Time that the adapter waits for more bytes before it sends. FTDI only, milliseconds.
    pub latency_timer_ms: Option<u32>,
}

impl std::fmt::Display for SerialPort {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({}", self.path.display(), self.driver)?;
        if let Some(usb) = &self.usb {
            write!(f, ", {usb}")?;
        }
        if let Some(ms) = self.latency_timer_ms {
            write!(f, ", latency timer {ms} ms")?;
        }
        write!(f, ")")
    }
}

/// All serial ports with hardware, in natural order of their names.
#[must_use]
pub fn serial_ports(roots: &Roots) -> Vec<SerialPort> {
    let class = roots.sys.join("class/tty");
    names(&class).into_iter().filter_map(|name| port(roots, &name)).collect()
}

fn port(roots: &Roots, name: &str) -> Option<SerialPort> {
    let node = roots.sys.join("class/tty").join(name);
    // Consoles and pseudo-terminals have no device; most of a PC's four standard ports are placeholders.
    let driver = link_name(&node.join("device/driver"))?;
    if text(&node.join("type")).as_deref() == Some("0") {
        return None;
    }
    let path = roots.dev.join(name);
    Some(SerialPort {
        by_id: by_id(roots, name),
        path,
        driver,
        usb: UsbIdentity::above(&node.join("device")),
        latency_timer_ms: text(&node.join("device/latency_timer")).and_then(|ms| ms.parse().ok()),
    })
}

fn by_id(roots: &Roots, name: &str) -> Option<PathBuf> {
    let folder = roots.dev.join("serial/by-id");
    let link = names(&folder).into_iter().map(|link| folder.join(link));
    link.into_iter().find(|link| link_name(link).as_deref() == Some(name))
}
