//! Lights driven by the kernel's LED class: switched by writing a number to a file, without a protocol.

use super::HidError;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

const CLASS: &str = "/sys/class/leds";

/// A light of the kernel's LED class, such as `thingm0:red:led0` of the driver hid-led.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KernelLed {
    folder: PathBuf,
    /// Full brightness.
    max: u32,
}

/// Names of the kernel's LED class devices.
#[must_use]
pub fn kernel_leds() -> Vec<String> {
    let entries = fs::read_dir(CLASS).into_iter().flatten().flatten();
    let mut names: Vec<_> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    names
}

impl KernelLed {
    /// Finds a light by its name in `/sys/class/leds`.
    ///
    /// # Errors
    /// [`HidError::NoLed`] or [`HidError::Io`].
    pub fn open(name: &str) -> Result<Self, HidError> {
        let found = kernel_leds();
        if !found.iter().any(|led| led == name) {
            return Err(HidError::NoLed { wanted: name.to_owned(), found });
        }
        let folder = Path::new(CLASS).join(name);
        let max = read_number(&folder.join("max_brightness"))?;
        Ok(Self { folder, max })
    }

    /// Sets the brightness, 0 (off) to 1 (full); values outside are clamped.
    ///
    /// # Errors
    /// [`HidError::PermissionDenied`] or [`HidError::Io`].
    pub fn set(&self, brightness: f64) -> Result<(), HidError> {
        let level = (brightness.clamp(0.0, 1.0) * f64::from(self.max)).round() as u32;
        let path = self.folder.join("brightness");
        match fs::write(&path, level.to_string()) {
            Ok(()) => Ok(()),
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => Err(HidError::PermissionDenied {
                path,
                rule: "SUBSYSTEM==\"leds\", ACTION==\"add\", RUN+=\"/bin/chgrp plugdev /sys%p/brightness\", \
                       RUN+=\"/bin/chmod g+w /sys%p/brightness\""
                    .to_owned(),
            }),
            Err(error) => Err(HidError::Io { action: "write", path, error }),
        }
    }

    /// Present brightness, 0 to 1.
    ///
    /// # Errors
    /// [`HidError::Io`].
    pub fn brightness(&self) -> Result<f64, HidError> {
        Ok(f64::from(read_number(&self.folder.join("brightness"))?) / f64::from(self.max.max(1)))
    }
}

fn read_number(path: &Path) -> Result<u32, HidError> {
    fs::read_to_string(path)
        .and_then(|text| {
            text.trim().parse().map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
        })
        .map_err(|error| HidError::Io { action: "read", path: path.to_owned(), error })
}
