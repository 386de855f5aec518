//! Descriptions of cameras and of their controls.

use gelstereo_host::camera as host;
use pyo3::prelude::*;

/// A video node of this computer.
#[pyclass(frozen, module = "gelstereo.cameras", get_all)]
pub struct CameraInfo {
    /// Path of the device node.
    path: String,
    /// Name given by the driver.
    name: String,
    /// "capture" (delivers frames), "metadata", "multiplanar", "other", or "unknown" if it cannot be opened.
    kind: String,
    /// USB serial number.
    serial: Option<String>,
    /// USB vendor, four hexadecimal digits.
    vendor_id: Option<String>,
    /// USB product, four hexadecimal digits.
    product_id: Option<String>,
    /// USB manufacturer in words.
    manufacturer: Option<String>,
    /// USB product in words.
    product: Option<String>,
    /// Index of the node among those of one camera; frames are usually in 0.
    index: u32,
    /// Its device in ``/sys/devices``. A camera at the same USB port has the same one.
    port: Option<String>,
    /// Why it cannot be opened.
    problem: Option<String>,
}

impl CameraInfo {
    pub fn new(info: &host::CameraInfo) -> Self {
        let kind = match info.kind {
            host::NodeKind::Capture => "capture",
            host::NodeKind::Multiplanar => "multiplanar",
            host::NodeKind::Metadata => "metadata",
            host::NodeKind::Other => "other",
            host::NodeKind::Unknown => "unknown",
        };
        Self {
            path: info.path.display().to_string(),
            name: info.name.clone(),
            kind: kind.to_owned(),
            serial: info.serial.clone(),
            vendor_id: info.vendor_id.clone(),
            product_id: info.product_id.clone(),
            manufacturer: info.manufacturer.clone(),
            product: info.product.clone(),
            index: info.index,
            port: info.port.as_ref().map(|port| port.display().to_string()),
            problem: info.problem.clone(),
        }
    }
}

#[pymethods]
impl CameraInfo {
    fn __repr__(&self) -> String {
        let serial = self.serial.as_ref().map(|serial| format!(", serial={serial:?}")).unwrap_or_default();
        format!("CameraInfo(path={:?}, name={:?}, kind={:?}{serial})", self.path, self.name, self.kind)
    }
}

/// A control of a camera, as described by its driver.
#[pyclass(frozen, module = "gelstereo.cameras", get_all)]
pub struct CameraControl {
    /// Name, as shown by ``v4l2-ctl``.
    name: String,
    /// "integer", "boolean", "menu", "button" or "bitmask".
    kind: String,
    /// Smallest value.
    minimum: i64,
    /// Largest value.
    maximum: i64,
    /// Step between valid values.
    step: u64,
    /// Default of the driver.
    default: i64,
    /// Present value; None if it cannot be read.
    value: Option<i64>,
    /// Whether it cannot be written.
    read_only: bool,
    /// Whether another control, such as an automatic one, disables it at present.
    inactive: bool,
    /// Items of a menu: value and name.
    menu: Vec<(i64, String)>,
}

impl CameraControl {
    pub fn new(control: host::Control) -> Self {
        let kind = match control.kind {
            host::ControlKind::Integer => "integer",
            host::ControlKind::Boolean => "boolean",
            host::ControlKind::Menu => "menu",
            host::ControlKind::Button => "button",
            host::ControlKind::Bitmask => "bitmask",
        };
        Self {
            name: control.name,
            kind: kind.to_owned(),
            minimum: control.minimum,
            maximum: control.maximum,
            step: control.step,
            default: control.default,
            value: control.value,
            read_only: control.read_only,
            inactive: control.inactive,
            menu: control.menu.into_iter().map(|item| (item.index, item.name)).collect(),
        }
    }
}

#[pymethods]
impl CameraControl {
    fn __repr__(&self) -> String {
        let value = self.value.map_or_else(|| "None".to_owned(), |value| value.to_string());
        format!(
            "CameraControl(name={:?}, value={value}, minimum={}, maximum={}, step={})",
            self.name, self.minimum, self.maximum, self.step
        )
    }
}
