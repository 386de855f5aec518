//! Finds the USB device of a node.

use super::roots::text;
use serde::Serialize;
use std::path::Path;

/// Identity reported by a USB device.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct UsbIdentity {
    /// Vendor, four hexadecimal digits.
    pub vendor_id: String,
    /// Product, four hexadecimal digits.
    pub product_id: String,
    /// Serial number.
    pub serial: Option<String>,
    /// Manufacturer name.
    pub manufacturer: Option<String>,
    /// Product name.
    pub product: Option<String>,
}

impl UsbIdentity {
    /// Identity of the USB device above a sysfs folder, whose links are resolved.
    #[must_use]
    pub fn above(folder: &Path) -> Option<Self> {
        let folder = folder.canonicalize().ok()?;
        let usb = folder.ancestors().find(|folder| folder.join("idVendor").exists())?;
        Some(Self {
            vendor_id: text(&usb.join("idVendor"))?,
            product_id: text(&usb.join("idProduct"))?,
            serial: text(&usb.join("serial")),
            manufacturer: text(&usb.join("manufacturer")),
            product: text(&usb.join("product")),
        })
    }
}

impl std::fmt::Display for UsbIdentity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}", self.vendor_id, self.product_id)?;
        for words in [&self.manufacturer, &self.product].into_iter().flatten() {
            write!(f, " {words}")?;
        }
        match &self.serial {
            Some(serial) => write!(f, " serial {serial}"),
            None => Ok(()),
        }
    }
}
