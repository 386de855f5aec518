//! Control access through kernel calls: list, read, write and read back.

use super::abi::{self, ExtControl, Plain, QueryExtCtrl, QueryMenu};
use super::controls::{Control, ControlKind, ControlWrite, MenuItem, control_name};
use super::device::Device;
use super::{CaptureError, ControlSettings};
use std::os::fd::AsFd;

const TYPE_INTEGER: u32 = 1;
const TYPE_BOOLEAN: u32 = 2;
const TYPE_MENU: u32 = 3;
const TYPE_BUTTON: u32 = 4;
const TYPE_INTEGER64: u32 = 5;
const TYPE_BITMASK: u32 = 8;
const TYPE_INTEGER_MENU: u32 = 9;

/// More controls than any device has. It bounds the loop for a driver whose list never ends.
const MAX_CONTROLS: usize = 1024;

/// Controls of a device that hold one number, with their values.
pub(super) fn controls(device: &Device) -> Vec<Control> {
    let mut controls = Vec::new();
    let mut query = QueryExtCtrl::zeroed();
    for _ in 0..MAX_CONTROLS {
        query = QueryExtCtrl { id: query.id | abi::CTRL_FLAG_NEXT_CTRL, ..QueryExtCtrl::zeroed() };
        if device.call(&abi::QUERY_EXT_CTRL, &mut query).is_err() {
            break;
        }
        controls.extend(describe(device, &query));
    }
    controls
}

/// `None` for titles, texts and arrays.
fn describe(device: &Device, query: &QueryExtCtrl) -> Option<Control> {
    let kind = match query.kind {
        TYPE_INTEGER | TYPE_INTEGER64 => ControlKind::Integer,
        TYPE_BOOLEAN => ControlKind::Boolean,
        TYPE_MENU | TYPE_INTEGER_MENU => ControlKind::Menu,
        TYPE_BUTTON => ControlKind::Button,
        TYPE_BITMASK => ControlKind::Bitmask,
        _ => return None,
    };
    let has = |flag: u32| query.flags & flag != 0;
    if has(abi::CTRL_FLAG_DISABLED) || query.dimensions > 0 {
        return None;
    }
    let mut control = Control {
        id: query.id,
        name: control_name(&abi::text(&query.name)),
        kind,
        minimum: query.minimum,
        maximum: query.maximum,
        step: query.step,
        default: query.default,
        value: None,
        read_only: has(abi::CTRL_FLAG_READ_ONLY),
        inactive: has(abi::CTRL_FLAG_INACTIVE),
        menu: Vec::new(),
        wide: query.kind == TYPE_INTEGER64,
    };
    if kind == ControlKind::Menu {
        control.menu = menu(device, query);
    }
    if kind != ControlKind::Button && !has(abi::CTRL_FLAG_WRITE_ONLY) {
        control.value = read(device, &control);
    }
    Some(control)
}

fn menu(device: &Device, query: &QueryExtCtrl) -> Vec<MenuItem> {
    let last = query.maximum.min(query.minimum.saturating_add(255));
    let indices = (query.minimum..=last).filter_map(|index| u32::try_from(index).ok());
    indices
        .filter_map(|index| {
            let mut item = QueryMenu { id: query.id, index, ..QueryMenu::zeroed() };
            // Drivers leave out items that the device does not have.
            device.call(&abi::QUERYMENU, &mut item).ok()?;
            let field = item.name;
            let name = if query.kind == TYPE_INTEGER_MENU {
                i64::from_ne_bytes(*field.first_chunk()?).to_string()
            } else {
                abi::text(&field)
            };
            Some(MenuItem { index: i64::from(index), name })
        })
        .collect()
}

fn read(device: &Device, control: &Control) -> Option<i64> {
    let mut argument = ExtControl { id: control.id, ..ExtControl::zeroed() };
    abi::get_control(device.as_fd(), &mut argument).ok()?;
    Some(number(control, argument.value))
}

/// 32-bit numbers occupy the first four of the eight bytes.
fn number(control: &Control, value: [u8; 8]) -> i64 {
    let [a, b, c, d, ..] = value;
    match (control.wide, control.kind) {
        (true, _) => i64::from_ne_bytes(value),
        (false, ControlKind::Bitmask) => i64::from(u32::from_ne_bytes([a, b, c, d])),
        (false, _) => i64::from(i32::from_ne_bytes([a, b, c, d])),
    }
}

fn bytes(control: &Control, value: i64) -> [u8; 8] {
    if control.wide {
        return value.to_ne_bytes();
    }
    // After the range check the value fits 32 bits, signed or, for bit masks, unsigned.
    let [a, b, c, d] = (value as i32).to_ne_bytes();
    [a, b, c, d, 0, 0, 0, 0]
}

/// Writes the settings and reads them back.
pub(super) fn apply(device: &Device, settings: &ControlSettings) -> Result<(), CaptureError> {
    if *settings == ControlSettings::default() {
        return Ok(());
    }
    let plan = settings.plan(&controls(device))?;
    plan.iter().try_for_each(|write| apply_one(device, write))
}

fn apply_one(device: &Device, ControlWrite { control, value }: &ControlWrite) -> Result<(), CaptureError> {
    let refused =
        |answer: String| CaptureError::ControlRefused { name: control.name.clone(), value: *value, answer };
    let mut argument = ExtControl { id: control.id, value: bytes(control, *value), ..ExtControl::zeroed() };
    abi::set_control(device.as_fd(), &mut argument).map_err(|error| refused(error.to_string()))?;
    if control.kind == ControlKind::Button || control.value.is_none() {
        return Ok(());
    }
    match read(device, control) {
        Some(found) if found == *value => Ok(()),
        Some(found) => Err(refused(format!("it has {found} afterwards"))),
        None => Err(refused("it cannot be read back".to_owned())),
    }
}
