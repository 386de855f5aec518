//! Root folders of system information.

use std::path::{Path, PathBuf};

/// Folders that are read. Tests use others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Roots {
    /// `/sys`.
    pub sys: PathBuf,
    /// `/dev`.
    pub dev: PathBuf,
    /// `/etc`.
    pub etc: PathBuf,
    /// `/run`.
    pub run: PathBuf,
}

impl Default for Roots {
    fn default() -> Self {
        let at = |name: &str| PathBuf::from(name);
        Self { sys: at("/sys"), dev: at("/dev"), etc: at("/etc"), run: at("/run") }
    }
}

/// Text of a file without its line end; `None` if it is missing or empty.
pub(super) fn text(path: &Path) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    Some(text.trim().to_owned()).filter(|text| !text.is_empty())
}

/// Names in a folder, in natural order.
pub(super) fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort_by(|a, b| crate::source::compare_names(a, b));
    names
}

/// Last part of a link's target: the driver of a device.
pub(super) fn link_name(link: &Path) -> Option<String> {
    let target = std::fs::read_link(link).ok()?;
    Some(target.file_name()?.to_string_lossy().into_owned())
}
