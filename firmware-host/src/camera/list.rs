//! Lists the connected video nodes and finds the device of a name.

use super::CaptureError;
use super::config::setting;
use serde::Serialize;
use std::path::{Path, PathBuf};

const SERIAL: &str = "serial:";
const CLASS: &str = "/sys/class/video4linux";
const NODES: &str = "/dev";

/// Kind of a video node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeKind {
    /// Frames in one plane; usable.
    Capture,
    /// Frames in several planes, as from camera interfaces of boards; not usable.
    Multiplanar,
    /// Metadata of frames. The frames come from another node of the same camera.
    Metadata,
    /// An output, a codec or a radio.
    Other,
    /// The node could not be opened.
    Unknown,
}

/// Video node of this computer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CameraInfo {
    /// Device node, `/dev/video0`.
    pub path: PathBuf,
    /// Name from the driver.
    pub name: String,
    /// Kind.
    pub kind: NodeKind,
    /// USB serial number.
    pub serial: Option<String>,
    /// USB vendor, four hexadecimal digits.
    pub vendor_id: Option<String>,
    /// USB product, four hexadecimal digits.
    pub product_id: Option<String>,
    /// USB manufacturer name.
    pub manufacturer: Option<String>,
    /// USB product name.
    pub product: Option<String>,
    /// Index among the nodes of one camera; frames are usually in 0.
    pub index: u32,
    /// Connection: the device in `/sys/devices`. It is the same for every camera at the same USB port.
    pub port: Option<PathBuf>,
    /// Reason why it cannot be opened.
    pub problem: Option<String>,
}

impl CameraInfo {
    /// A node with only its path known.
    fn bare(path: PathBuf) -> Self {
        Self {
            path,
            name: String::new(),
            kind: NodeKind::Unknown,
            serial: None,
            vendor_id: None,
            product_id: None,
            manufacturer: None,
            product: None,
            index: 0,
            port: None,
            problem: None,
        }
    }

    /// Whether it is the same camera as far as can be determined: same make and same serial number.
    fn is_same(&self, other: &Self) -> bool {
        let identity = |info: &Self| {
            (info.serial.clone(), info.vendor_id.clone(), info.product_id.clone(), info.name.clone())
        };
        identity(self) == identity(other)
    }

    /// Whether frames can be read from it, as far as known.
    #[must_use]
    pub fn gives_frames(&self) -> bool {
        self.kind == NodeKind::Capture || (self.kind == NodeKind::Unknown && self.index == 0)
    }
}

impl std::fmt::Display for CameraInfo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.path.display())?;
        let mut details = Vec::new();
        if !self.name.is_empty() {
            details.push(self.name.clone());
        }
        if let Some(serial) = &self.serial {
            details.push(format!("{SERIAL}{serial}"));
        }
        match self.kind {
            NodeKind::Capture => {}
            NodeKind::Multiplanar => details.push("multiplanar".to_owned()),
            NodeKind::Metadata => details.push("metadata".to_owned()),
            NodeKind::Other => details.push("no camera".to_owned()),
            NodeKind::Unknown => details.extend(self.problem.clone()),
        }
        if details.is_empty() { Ok(()) } else { write!(f, " ({})", details.join(", ")) }
    }
}

/// Lists this computer's video nodes by number. Each is opened briefly to determine its kind.
///
/// # Errors
/// [`CaptureError::Unsupported`].
pub fn list() -> Result<Vec<CameraInfo>, CaptureError> {
    if !cfg!(target_os = "linux") {
        return Err(CaptureError::Unsupported);
    }
    let mut cameras = nodes(Path::new(CLASS), Path::new(NODES));
    #[cfg(target_os = "linux")]
    cameras.iter_mut().for_each(inspect);
    Ok(cameras)
}

/// Finds the camera of a name. Only nodes with a matching serial number are opened, because opening
/// wakes a camera.
#[cfg(target_os = "linux")]
pub(super) fn find(name: &str) -> Result<CameraInfo, CaptureError> {
    let mut cameras = nodes(Path::new(CLASS), Path::new(NODES));
    if let Some(serial) = name.strip_prefix(SERIAL) {
        cameras.iter_mut().filter(|camera| camera.serial.as_deref() == Some(serial)).for_each(inspect);
    }
    select(name, &cameras)
}

/// Finds the camera that was opened earlier by this name.
#[cfg(target_os = "linux")]
pub(super) fn find_again(name: &str, before: &CameraInfo) -> Result<CameraInfo, CaptureError> {
    if name.starts_with(SERIAL) {
        return find(name);
    }
    select_again(name, before, &nodes(Path::new(CLASS), Path::new(NODES)))
}

/// Opens a node briefly to determine its kind.
#[cfg(target_os = "linux")]
fn inspect(camera: &mut CameraInfo) {
    match super::device::kind(&camera.path) {
        Ok(kind) => camera.kind = kind,
        Err(error) => camera.problem = Some(error.to_string()),
    }
}

/// Formats and sizes of a camera in words; empty if it cannot be queried.
#[must_use]
pub fn offers(path: &Path) -> Vec<String> {
    #[cfg(target_os = "linux")]
    if let Ok(device) = super::device::Device::open(path, &path.display().to_string()) {
        return device.offers();
    }
    #[cfg(not(target_os = "linux"))]
    let _ = path;
    Vec::new()
}

/// Nodes listed by the kernel, with the attributes of their USB devices.
fn nodes(class: &Path, dev: &Path) -> Vec<CameraInfo> {
    // Without the folder there is no video driver and therefore no camera.
    let entries = std::fs::read_dir(class).into_iter().flatten().flatten();
    let mut cameras: Vec<_> = entries
        .filter(|entry| number(&entry.path()).is_some())
        .map(|entry| {
            let node = entry.path();
            let mut camera = CameraInfo::bare(dev.join(entry.file_name()));
            camera.name = attribute(&node, "name").unwrap_or_default();
            camera.index = attribute(&node, "index").and_then(|text| text.parse().ok()).unwrap_or(0);
            // `device` is the USB interface; its parent is the USB device.
            camera.port = node.join("device").canonicalize().ok();
            let folders = camera.port.iter().flat_map(|device| device.ancestors());
            let usb = folders.map(Path::to_owned).find(|folder| folder.join("idVendor").exists());
            if let Some(usb) = &usb {
                camera.serial = attribute(usb, "serial");
                camera.vendor_id = attribute(usb, "idVendor");
                camera.product_id = attribute(usb, "idProduct");
                camera.manufacturer = attribute(usb, "manufacturer");
                camera.product = attribute(usb, "product");
            }
            camera
        })
        .collect();
    cameras.sort_by_key(|camera| number(&camera.path));
    cameras
}

fn attribute(folder: &Path, name: &str) -> Option<String> {
    let text = std::fs::read_to_string(folder.join(name)).ok()?;
    let text = text.trim();
    (!text.is_empty()).then(|| text.to_owned())
}

/// Number of a node: 12 for `/dev/video12`.
fn number(path: &Path) -> Option<u32> {
    path.file_name()?.to_str()?.strip_prefix("video")?.parse().ok()
}

/// Rejects an invalid device name.
pub(super) fn check_name(setting_name: &'static str, name: &str) -> Result<(), CaptureError> {
    let serial = name.strip_prefix(SERIAL);
    if serial.is_some_and(|serial| !serial.is_empty()) || name.starts_with('/') {
        return Ok(());
    }
    let valid = "serial: and the USB serial number, or a path such as /dev/video0 or /dev/v4l/by-id/..";
    Err(setting(setting_name, format!("\"{name}\""), valid))
}

/// Finds the camera of a name. A path may be a link to the node.
///
/// # Errors
/// [`CaptureError::Setting`], [`CaptureError::NotFound`] and [`CaptureError::Ambiguous`], which list the
/// cameras present.
pub fn select(name: &str, cameras: &[CameraInfo]) -> Result<CameraInfo, CaptureError> {
    check_name("device", name)?;
    let present = || cameras.iter().filter(|camera| camera.gives_frames()).cloned().collect();
    let not_found = || CaptureError::NotFound { name: name.to_owned(), present: present() };
    let Some(serial) = name.strip_prefix(SERIAL) else {
        let path = Path::new(name).canonicalize().map_err(|_| not_found())?;
        let known = cameras.iter().find(|camera| camera.path == path).cloned();
        return Ok(known.unwrap_or_else(|| CameraInfo::bare(path)));
    };
    let mut matches: Vec<_> = cameras
        .iter()
        .filter(|camera| camera.serial.as_deref() == Some(serial) && camera.gives_frames())
        .cloned()
        .collect();
    match matches.len() {
        0 => Err(not_found()),
        1 => Ok(matches.remove(0)),
        _ => Err(CaptureError::Ambiguous { name: name.to_owned(), matches }),
    }
}

/// Finds the camera that was found earlier by this path. Its node has another number if it was
/// reconnected before the old node was closed; then the same camera at the same port is used.
#[cfg(target_os = "linux")]
fn select_again(name: &str, before: &CameraInfo, cameras: &[CameraInfo]) -> Result<CameraInfo, CaptureError> {
    let at_path = select(name, cameras);
    if let Ok(found) = &at_path
        && found.is_same(before)
    {
        return at_path;
    }
    let at_port = |camera: &&CameraInfo| camera.port == before.port && camera.index == before.index;
    if let Some(found) = cameras.iter().filter(at_port).find(|camera| camera.is_same(before)) {
        return Ok(found.clone());
    }
    at_path.and_then(|found| {
        let (expected, found) = (before.to_string(), found.to_string());
        Err(CaptureError::Replaced { expected, found })
    })
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::fs;

    /// Adds a camera with the nodes created by uvcvideo: frames, then metadata.
    fn plug(root: &Path, port: &str, serial: &str, first: u32) {
        let usb = root.join("devices/usb1").join(port);
        let interface = usb.join(format!("{port}:1.0"));
        for (name, text) in
            [("idVendor", "2560"), ("idProduct", "c114"), ("serial", serial), ("product", "Tara")]
        {
            fs::create_dir_all(&interface).unwrap();
            fs::write(usb.join(name), format!("{text}\n")).unwrap();
        }
        for index in 0..2 {
            let node = root.join("class").join(format!("video{}", first + index));
            fs::create_dir_all(&node).unwrap();
            fs::write(node.join("name"), "Tara: Tara\n").unwrap();
            fs::write(node.join("index"), format!("{index}\n")).unwrap();
            std::os::unix::fs::symlink(&interface, node.join("device")).unwrap();
        }
    }

    fn listed(root: &Path) -> Vec<CameraInfo> {
        nodes(&root.join("class"), &root.join("dev"))
    }

    #[test]
    fn cameras_are_found_by_serial_number_and_by_path() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        plug(root, "1-1", "GS0001", 0);
        plug(root, "1-2", "GS0002", 9);
        let cameras = listed(root);
        assert_eq!(cameras.iter().map(|c| number(&c.path).unwrap()).collect::<Vec<_>>(), [0, 1, 9, 10]);
        let second = select("serial:GS0002", &cameras).unwrap();
        assert_eq!(second.path, root.join("dev/video9"));
        assert_eq!((second.vendor_id.as_deref(), second.product.as_deref()), (Some("2560"), Some("Tara")));
        // Find by a link such as udev creates.
        fs::create_dir_all(root.join("dev")).unwrap();
        fs::write(root.join("dev/video9"), "").unwrap();
        std::os::unix::fs::symlink(root.join("dev/video9"), root.join("link")).unwrap();
        assert_eq!(select(root.join("link").to_str().unwrap(), &cameras).unwrap(), second);
    }

    #[test]
    fn absence_and_ambiguity_list_what_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        assert!(listed(root).is_empty());
        plug(root, "1-1", "GS0001", 0);
        plug(root, "1-2", "GS0001", 2);
        let cameras = listed(root);
        let several = select("serial:GS0001", &cameras).unwrap_err().to_string();
        assert!(several.contains("dev/video0 (Tara: Tara, serial:GS0001)"), "{several}");
        assert!(several.contains("dev/video2 (") && several.contains("by-path"), "{several}");
        let none = select("serial:GS0009", &cameras).unwrap_err().to_string();
        assert!(
            none.contains("there is no camera serial:GS0009; connected are: ") && none.contains("dev/video2")
        );
        assert!(!none.contains("video1"), "metadata nodes are no cameras: {none}");
        let gone = select("/dev/no-such-video", &[]).unwrap_err().to_string();
        assert_eq!(gone, "there is no camera /dev/no-such-video; connected are: none");
        let odd = select("0", &cameras).unwrap_err().to_string();
        assert!(odd.starts_with("device is \"0\"; valid is serial:"), "{odd}");
    }

    #[test]
    fn a_camera_that_was_lost_is_found_by_its_path_or_at_its_port() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        fs::create_dir_all(root.join("dev")).unwrap();
        let node = |number: u32| root.join(format!("dev/video{number}"));
        plug(root, "1-1", "GS0001", 0);
        fs::write(node(0), "").unwrap();
        let (name, before) = (node(0).to_str().unwrap().to_owned(), listed(root).remove(0));
        let again = || select_again(&name, &before, &listed(root));
        assert_eq!(again().unwrap(), before);
        // Reconnect with another number.
        let unplug = |first: u32| {
            for number in first..first + 2 {
                fs::remove_dir_all(root.join(format!("class/video{number}"))).unwrap();
            }
        };
        unplug(0);
        fs::remove_file(node(0)).unwrap();
        assert!(matches!(again(), Err(CaptureError::NotFound { .. })));
        plug(root, "1-1", "GS0001", 4);
        assert_eq!(again().unwrap().path, node(4));
        // Another camera takes its port, then its number.
        unplug(4);
        plug(root, "1-1", "GS0009", 4);
        assert!(matches!(again(), Err(CaptureError::NotFound { .. })));
        plug(root, "1-2", "GS0008", 0);
        fs::write(node(0), "").unwrap();
        let refused = again().unwrap_err().to_string();
        assert!(refused.contains("serial:GS0008") && refused.contains("serial:GS0001"), "{refused}");
    }
}
