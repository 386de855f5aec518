//! Checks access to a device node and gives advice if this user lacks it.

use super::roots::Roots;
use std::path::Path;

/// Owner and permissions of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Permissions {
    /// Permission bits.
    pub mode: u32,
    /// Group number.
    pub gid: u32,
}

/// Whether this user may read and write a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Access {
    /// Yes.
    Allowed,
    /// No, with advice.
    Denied {
        /// Advice in one sentence, with the command or the rule.
        advice: String,
    },
    /// The node does not exist.
    Absent,
}

/// Criteria of a udev rule for a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UdevMatch<'a> {
    /// Kernel subsystem, such as `hidraw`.
    pub subsystem: &'a str,
    /// USB vendor and product, four hexadecimal digits each.
    pub usb: Option<(&'a str, &'a str)>,
}

/// Tests whether this user may read and write a node, including access control lists.
#[cfg(unix)]
#[must_use]
pub fn access(roots: &Roots, node: &Path, device: UdevMatch<'_>) -> Access {
    use rustix::fs::{Access as Wanted, access, stat};
    let Ok(found) = stat(node) else { return Access::Absent };
    if access(node, Wanted::READ_OK | Wanted::WRITE_OK).is_ok() {
        return Access::Allowed;
    }
    let permissions = Permissions { mode: found.st_mode, gid: found.st_gid };
    let group = group_name(roots, permissions.gid);
    Access::Denied { advice: advise(permissions, group.as_deref(), device, node) }
}

/// Not checked on other systems.
#[cfg(not(unix))]
#[must_use]
pub fn access(_roots: &Roots, _node: &Path, _device: UdevMatch<'_>) -> Access {
    Access::Allowed
}

/// Advice to gain access.
#[must_use]
pub fn advise(permissions: Permissions, group: Option<&str>, device: UdevMatch<'_>, node: &Path) -> String {
    const GROUP_MAY: u32 = 0o060;
    match group {
        // Never advise joining root's group.
        Some(group) if permissions.gid != 0 && permissions.mode & GROUP_MAY == GROUP_MAY => format!(
            "only the group {group} may use it: run `sudo usermod -aG {group} $USER` and log in again"
        ),
        _ => format!(
            "put this line into /etc/udev/rules.d/70-gelstereo.rules, run `sudo udevadm control --reload` \
             and plug the device in again: {}",
            udev_rule(device, node)
        ),
    }
}

fn udev_rule(device: UdevMatch<'_>, node: &Path) -> String {
    let which = match device.usb {
        Some((vendor, product)) => {
            format!("ATTRS{{idVendor}}==\"{vendor}\", ATTRS{{idProduct}}==\"{product}\"")
        }
        // A rule for the whole subsystem would also open consoles.
        None => format!("KERNEL==\"{}\"", node.file_name().unwrap_or_default().to_string_lossy()),
    };
    format!("SUBSYSTEM==\"{}\", {which}, MODE=\"0660\", TAG+=\"uaccess\"", device.subsystem)
}

fn group_name(roots: &Roots, gid: u32) -> Option<String> {
    let groups = std::fs::read_to_string(roots.etc.join("group")).ok()?;
    groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(gid)).then(|| name.to_owned())
    })
}
