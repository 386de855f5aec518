//! Lists HID devices from sysfs.

use super::HidError;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

const CLASS: &str = "/sys/class/hidraw";

/// A HID device as described by the kernel. A USB device with several HID interfaces is listed once per
/// interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HidInfo {
    /// Device node, such as `/dev/hidraw0`.
    pub path: PathBuf,
    /// USB vendor.
    pub vendor: u16,
    /// USB product.
    pub product: u16,
    /// Serial number; empty if the device has none.
    pub serial: String,
    /// Names of maker and product.
    pub name: String,
    /// Number of the USB interface; `None` for devices on other buses.
    pub interface: Option<u8>,
    /// Length of the report descriptor, which distinguishes the interfaces of one device.
    pub descriptor_bytes: usize,
}

impl fmt::Display for HidInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04x}:{:04x} \"{}\"", self.vendor, self.product, self.name)?;
        if !self.serial.is_empty() {
            write!(f, " serial {}", self.serial)?;
        }
        write!(f, " at {}", self.path.display())
    }
}

/// Criteria that select a HID device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HidSelector {
    /// USB vendor.
    pub vendor: u16,
    /// USB product.
    pub product: u16,
    /// Serial number, to select one of several.
    pub serial: Option<String>,
    /// Length of the report descriptor, if the device has several interfaces.
    pub descriptor_bytes: Option<usize>,
}

impl fmt::Display for HidSelector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04x}:{:04x}", self.vendor, self.product)?;
        if let Some(serial) = &self.serial {
            write!(f, " with serial number {serial}")?;
        }
        if let Some(bytes) = self.descriptor_bytes {
            write!(f, " with a report descriptor of {bytes} bytes")?;
        }
        Ok(())
    }
}

impl HidSelector {
    /// Whether a device matches.
    #[must_use]
    pub fn fits(&self, device: &HidInfo) -> bool {
        (device.vendor, device.product) == (self.vendor, self.product)
            && self.serial.as_ref().is_none_or(|serial| *serial == device.serial)
            && self.descriptor_bytes.is_none_or(|bytes| bytes == device.descriptor_bytes)
    }

    /// Finds the one matching device.
    ///
    /// # Errors
    /// [`HidError::NotFound`], [`HidError::Ambiguous`] or [`HidError::Io`].
    pub fn find(&self) -> Result<HidInfo, HidError> {
        let all = list()?;
        let mut fitting: Vec<_> = all.iter().filter(|device| self.fits(device)).cloned().collect();
        match (fitting.pop(), fitting.is_empty()) {
            (Some(device), true) => Ok(device),
            (Some(device), false) => {
                fitting.push(device);
                Err(HidError::Ambiguous { found: fitting })
            }
            (None, _) => Err(HidError::NotFound { wanted: self.clone(), found: all }),
        }
    }
}

/// All HID devices, in order of node number. A device that disappears meanwhile is omitted.
///
/// # Errors
/// [`HidError::Io`] if the kernel's list cannot be read. A missing list means that there are no devices.
pub fn list() -> Result<Vec<HidInfo>, HidError> {
    let class = Path::new(CLASS);
    let entries = match fs::read_dir(class) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(HidError::Io { action: "list", path: class.to_owned(), error }),
    };
    let mut numbered: Vec<(u32, HidInfo)> = entries
        .filter_map(|entry| {
            let name = entry.ok()?.file_name().into_string().ok()?;
            let number = name.strip_prefix("hidraw")?.parse().ok()?;
            Some((number, describe(&class.join(&name).join("device"), Path::new("/dev").join(&name))?))
        })
        .collect();
    numbered.sort_by_key(|(number, _)| *number);
    Ok(numbered.into_iter().map(|(_, device)| device).collect())
}

fn describe(device: &Path, path: PathBuf) -> Option<HidInfo> {
    let uevent = fs::read_to_string(device.join("uevent")).ok()?;
    let property = |key: &str| {
        uevent.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('=')).unwrap_or_default()
    };
    let mut identity = property("HID_ID").split(':').skip(1).map(|hex| u32::from_str_radix(hex, 16));
    let mut next = || u16::try_from(identity.next()?.ok()?).ok();
    let interface = fs::read_to_string(device.join("../bInterfaceNumber")).ok();
    Some(HidInfo {
        path,
        vendor: next()?,
        product: next()?,
        serial: property("HID_UNIQ").to_owned(),
        name: property("HID_NAME").to_owned(),
        interface: interface.and_then(|hex| u8::from_str_radix(hex.trim(), 16).ok()),
        descriptor_bytes: fs::read(device.join("report_descriptor")).ok()?.len(),
    })
}
